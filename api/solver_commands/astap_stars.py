"""What `astap` says of stars without solving: half flux diameters, lists of stars, the best focus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from api.solver_commands.image_facts import ImageFacts
from mountnav.errors import BadRequest
from mountnav.sky.wcs import places_at_pixels

if TYPE_CHECKING:
    from mountnav.measuring.hfd import StarDiameters

Array = NDArray[np.float64]

NO_STARS_HFD_PX = 21.47
"""Half flux diameter that ASTAP states where there are no stars, the most its exit code can hold."""
CSV_HEADER = "x,y,hfd,snr,flux,ra[0..360],dec[0..360]"
_FOCUS_FEWEST = 4
"""Positions that a hyperbola of three unknowns needs, and one to see how well it fits."""


def median_text(stars: StarDiameters) -> str:
    """The two lines of `-analyse`."""
    median = stars.median_px
    return f"HFD_MEDIAN={NO_STARS_HFD_PX if median is None else median:.1f}\nSTARS={len(stars)}\n"


def stars_csv(stars: StarDiameters, facts: ImageFacts, cards: Mapping[str, object]) -> str:
    """The list of `-extract`: pixels counted from 1, from the bottom row; places where a plate is known.

    Parameters
    ----------
    facts : ImageFacts
        Of their image.
    cards : mapping
        A plate of the image with its rows counted from the bottom, or cards without one.
    """
    y_px = facts.height_px - 1 - stars.y_px if facts.rows_down else stars.y_px
    try:
        ra_deg, dec_deg = places_at_pixels(cards, stars.x_px, y_px)
        places = [f",{ra:.8f},{dec:.8f}" for ra, dec in zip(ra_deg, dec_deg, strict=True)]
    except BadRequest:  # no plate, or none of a kind that is understood
        places = [""] * len(stars)
    columns = (stars.x_px + 1, y_px + 1, stars.hfd_px, stars.snr, stars.flux, places)
    lines = [CSV_HEADER]
    for x, y, hfd, snr, flux, at in zip(*columns, strict=True):
        lines.append(f"{x:.4f},{y:.4f},{hfd:.4f},{round(snr)},{round(flux)}{at}")
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class Focus:
    """A focuser's best position, by a hyperbola through diameters.

    Attributes
    ----------
    position : float
        Where the stars are smallest.
    error : float
        Mean relative deviation of the diameters from the curve.
    """

    position: float
    error: float


def best_focus(positions: Sequence[float], hfd_px: Sequence[float]) -> Focus | None:
    """Find the best focus: the least diameter of a hyperbola h = a √(1 + ((x - p) / b)²).

    Parameters
    ----------
    positions : sequence of float
        Of the focuser.
    hfd_px : sequence of float
        Median half flux diameters there.

    Returns
    -------
    Focus or None
        None from fewer than four positions, and where the curve has no least diameter between them.
    """
    x, h = np.asarray(positions, dtype=float), np.asarray(hfd_px, dtype=float)
    if np.unique(x).size < _FOCUS_FEWEST or not np.all(h > 0):
        return None
    # h² is a parabola: linear in its three unknowns; weighted so that relative errors count
    middle, width = float(x.mean()), float(np.ptp(x))
    u = (x - middle) / width
    curve = np.polyfit(u, h**2, 2, w=1.0 / h**2)
    if curve[0] <= 0.0:
        return None
    least = -0.5 * curve[1] / curve[0]
    if not u.min() <= least <= u.max() or np.polyval(curve, least) <= 0.0:
        return None
    fitted = np.sqrt(np.maximum(np.polyval(curve, u), 0.0))
    return Focus(middle + width * float(least), float(np.mean(np.abs(h / fitted - 1.0))))
