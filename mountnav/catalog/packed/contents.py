"""What a packed catalog holds, by a sample of its stars: errors and density by magnitude."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.pixels import TABLE_NSIDE, pixel_centers
from mountnav.catalog.packed.store import PackedStore
from mountnav.catalog.space_motion import places
from mountnav.sky.coordinates import Icrs
from mountnav.units import SKY_DEG2

SMALL_COUNT = 300_000
"""So many stars are looked at one by one."""
LARGE_SHARE = 0.2
"""With less of the sky covered, most places on it would be looked at in vain."""
SAMPLED_FIELDS = 48
"""Places at which a large catalog is sampled; chosen by hand. Halved, the densities shown scatter by 1.4
times as much."""
STARS_IN_A_FIELD = 1500
"""Stars that a sampled place holds on average; chosen by hand. Doubled, the summary takes twice as long."""
_STEP = 19_427
"""No divisor of the number of pixels: steps of it go over the sky evenly, and reach every pixel at last."""


@dataclass(frozen=True, slots=True)
class MagnitudeBin:
    """Stars between two whole magnitudes.

    Attributes
    ----------
    mag : int
        The brighter end.
    share : float
        Of all stars of the catalog.
    density_deg2 : float
        Stars per square degree of the sky that the catalog covers.
    sigma_arcsec : float
        Median one-sigma error per coordinate at the epoch asked.
    """

    mag: int
    share: float
    density_deg2: float
    sigma_arcsec: float


@dataclass(frozen=True, slots=True)
class Contents:
    """What a catalog holds.

    Attributes
    ----------
    sampled : int
        By how many stars the rest is told.
    with_motion : float
        Share of the stars with a proper motion.
    with_color : float
        Share of the stars with a color.
    bins : tuple of MagnitudeBin
        Brightest first; none that is empty in the sample.
    """

    sampled: int
    sky_share: float
    with_motion: float
    with_color: float
    bins: tuple[MagnitudeBin, ...]


def contents(store: PackedStore, *, epoch_yr: float) -> Contents:
    """Look at a sample of a catalog's stars.

    Parameters
    ----------
    epoch_yr : float
        Of the errors.

    Returns
    -------
    Contents
        The same for the same file.
    """
    share = min(max(store.sky_share(), 1e-9), 1.0)
    mag, sigma, motion, color = _sample(store, share, epoch_yr)
    area_deg2 = share * SKY_DEG2
    bins = []
    for low in range(int(np.floor(mag.min())), int(np.floor(mag.max())) + 1) if mag.size else ():
        inside = (mag >= low) & (mag < low + 1)
        if inside.any():
            part = float(inside.mean())
            density = part * len(store) / area_deg2
            bins.append(MagnitudeBin(low, part, density, float(np.median(sigma[inside]))))
    return Contents(
        sampled=int(mag.size),
        sky_share=share,
        with_motion=float(motion.mean()) if mag.size else math.nan,
        with_color=float(color.mean()) if mag.size else math.nan,
        bins=tuple(bins),
    )


Sample = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]


def _sample(store: PackedStore, share: float, epoch_yr: float) -> Sample:
    """Magnitude, sigma, whether a motion and whether a color is known."""
    if len(store) <= SMALL_COUNT:
        found = [store.cone(Icrs(0.0, 90.0), 180.0, epoch_yr=epoch_yr)]
    else:
        area_deg2 = STARS_IN_A_FIELD / (len(store) / (share * SKY_DEG2))
        radius_deg = math.sqrt(area_deg2 / math.pi)
        looked_at = _spread(store, radius_deg) if share > LARGE_SHARE else _bright(store)
        found = [store.cone(center, radius_deg, epoch_yr=epoch_yr) for center in looked_at]
    return (
        np.concatenate([stars.mag for stars in found]) if found else np.zeros(0),
        np.concatenate([stars.sigma_arcsec for stars in found]) if found else np.zeros(0),
        np.concatenate([np.isfinite(stars.pm_ra_cosdec_mas_yr) for stars in found])
        if found
        else np.zeros(0, bool),
        np.concatenate([np.isfinite(stars.color_mag) for stars in found]) if found else np.zeros(0, bool),
    )


def _bright(store: PackedStore) -> list[Icrs]:
    """Places of bright stars, of which there are some wherever there are any."""
    brightest, faintest, _ = store.magnitudes
    limit = brightest
    while True:
        stars = store.cone(Icrs(0.0, 90.0), 180.0, epoch_yr=store.header.epoch_yr, mag_limit=limit)
        if len(stars) >= 4 * SAMPLED_FIELDS or limit >= faintest:
            break
        limit += 0.5
    chosen = np.argsort(stars.ra_deg)[:: max(1, len(stars) // SAMPLED_FIELDS)][:SAMPLED_FIELDS]
    return [Icrs(float(stars.ra_deg[row]), float(stars.dec_deg[row])) for row in chosen]


def _spread(store: PackedStore, radius_deg: float) -> list[Icrs]:
    """Places that the catalog covers, spread over the sky."""
    centers = pixel_centers(TABLE_NSIDE)
    count = centers.shape[1]
    order = np.arange(count) * _STEP % count
    ra_deg, dec_deg = places(centers[:, order])
    found: list[Icrs] = []
    for ra, dec in zip(ra_deg.tolist(), dec_deg.tolist(), strict=True):
        if store.covers(Icrs(ra, dec), radius_deg):
            found.append(Icrs(ra, dec))
            if len(found) == SAMPLED_FIELDS:
                break
    return found
