"""The count rule of the paper: enough of Ω_bl100 must find a star of Ω_star200 [S23 §2.2].

Each list holds what there is, if that is less than its name says: with a catalog of 16 stars in the frame no
more than 16 of a hundred measurements can pair. So v_min_ident is a share of the pairs that could be: as many
as the shorter of the two lists has in the frame. docs/identification.md has the figures.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.stars import Stars
from mountnav.identification.plate import Plate
from mountnav.identification.selection import spread_brightest
from mountnav.identification.settings import IdentificationSettings

Array = NDArray[np.float64]


def published_share(
    plate: Plate,
    stars: Stars,
    x_px: Array,
    y_px: Array,
    *,
    width_px: int,
    height_px: int,
    settings: IdentificationSettings,
) -> float:
    """Share of the pairs that could be which are there, as the paper counts.

    Parameters
    ----------
    plate : Plate
        The six constants that a triangle gave.
    stars : Stars
        Round the plate's center, brightest first; Ω_star200 is taken evenly from the circle round the frame.
    x_px, y_px : ndarray, shape (n,)
        Star-like measurements, brightest first; Ω_bl100 is taken evenly from them.
    width_px, height_px : int
        Size of the frame.
    settings : IdentificationSettings
        `n_confirm_measurements`, `n_confirm_stars`, `m_reg`, `region_cap`, `match_px`, `min_pairs`.

    Returns
    -------
    float
        To be compared with v_min_ident. A measurement counts once. 0 where fewer than `min_pairs` pairs
        could be: the triangle alone would fill the share.
    """
    blobs = spread_brightest(
        x_px, y_px, settings.n_confirm_measurements, regions=settings.m_reg, cap=settings.region_cap
    )
    if blobs.size == 0:
        return 0.0
    x, y = plate.pixels(*plate.project(stars.ra_deg, stars.dec_deg))
    reach_px = 0.5 * math.hypot(width_px, height_px)
    near = np.flatnonzero(np.hypot(x - plate.center_x_px, y - plate.center_y_px) <= reach_px)
    chosen = near[
        spread_brightest(
            x[near], y[near], settings.n_confirm_stars, regions=settings.m_reg, cap=settings.region_cap
        )
    ]
    x, y = x[chosen], y[chosen]
    in_frame = (x > -0.5) & (x < width_px - 0.5) & (y > -0.5) & (y < height_px - 0.5)
    possible = min(blobs.size, int(in_frame.sum()))
    if possible < settings.min_pairs:
        return 0.0
    tree = cKDTree(np.column_stack((x, y)))
    distance = np.asarray(tree.query(np.column_stack((x_px[blobs], y_px[blobs])))[0])
    return min(1.0, int((distance < settings.match_px).sum()) / possible)
