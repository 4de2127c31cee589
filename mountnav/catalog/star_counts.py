"""Star counts: a model of the Galaxy, and how deep a catalog is read for a wanted number of stars.

The model is that of J. N. Bahcall and R. M. Soneira, ApJS 44, 73 (1980), equation B1: integral counts in V
of a disk and a spheroid, said to be good to 15 % at galactic latitudes beyond 20°. Nearer to the plane it
runs to infinity, and at V < 12 it has half the stars that Tycho-2 has. So here it is taken at 20° for all
lower latitudes, and multiplied by a table of latitude and magnitude: to V = 11.5 what Tycho-2 has, deeper
what makes the sums over the whole sky right. docs/figures/narrow-fields.md has the comparison and where the
sums come from.

It knows neither dust clouds nor clusters nor the Magellanic Clouds: a square degree may have a third or three
times as many.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.stars import Catalog, KnowsDepth, Stars
from mountnav.sky.coordinates import Icrs
from mountnav.units import SKY_DEG2

Array = NDArray[np.float64]

BRIGHTEST_MAG, FAINTEST_MODELED_MAG = 2.0, 22.0
"""Beyond them the counts of the last magnitude are given."""
_LOWEST_DEG = 20.0
"""Equation B1 holds from this latitude on."""
_GRID_MAG = np.arange(BRIGHTEST_MAG, FAINTEST_MODELED_MAG + 0.125, 0.25)
"""Magnitudes at which counts are tabulated to find the one that a number is reached at: steps of 0.25 mag,
straight lines between."""

_TO_GALACTIC = np.array(
    [
        [-0.0548755604162154, -0.8734370902348850, -0.4838350155487132],
        [+0.4941094278755837, -0.4448296299600112, +0.7469822444972189],
        [-0.8676661490190047, -0.1980763734312015, +0.4559837761750669],
    ]
)
"""ICRS to galactic coordinates [The Hipparcos and Tycho Catalogues, vol. 1, section 1.5.3]."""

_LATITUDES_DEG = np.array([0.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0])
"""Galactic latitudes of the columns of `_LOG_FACTOR`."""
_MAGNITUDES = np.array([5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 11.5, 14.4, 16.4, 18.0, 20.0, 22.0])
"""V magnitudes of its rows."""
_LOG_FACTOR = np.array(
    [
        [-0.004, -0.042, -0.130, -0.121, -0.140, -0.120, 0.010, 0.120, 0.120],
        [0.057, 0.022, -0.065, -0.105, -0.100, -0.063, 0.090, 0.180, 0.211],
        [0.175, 0.073, 0.024, -0.016, -0.037, 0.039, 0.143, 0.226, 0.303],
        [0.260, 0.152, 0.102, 0.039, 0.015, 0.111, 0.207, 0.277, 0.280],
        [0.346, 0.240, 0.181, 0.111, 0.071, 0.171, 0.244, 0.291, 0.303],
        [0.421, 0.317, 0.254, 0.172, 0.120, 0.213, 0.266, 0.298, 0.298],
        [0.491, 0.399, 0.331, 0.240, 0.167, 0.243, 0.273, 0.289, 0.280],
        [0.517, 0.434, 0.364, 0.264, 0.186, 0.251, 0.270, 0.281, 0.275],
        [0.500, 0.410, 0.330, 0.220, 0.100, 0.130, 0.140, 0.150, 0.150],
        [0.650, 0.500, 0.370, 0.190, 0.050, 0.050, 0.060, 0.070, 0.080],
        [0.600, 0.450, 0.320, 0.140, 0.000, 0.000, 0.000, 0.000, 0.000],
        [0.660, 0.500, 0.360, 0.160, 0.000, 0.000, 0.000, 0.000, 0.000],
        [0.700, 0.530, 0.380, 0.170, 0.000, 0.000, 0.000, 0.000, 0.000],
    ]
)
"""Common logarithm of real over modeled counts; rows: magnitudes, columns: latitudes.

The rows to V = 11.5 are fitted to Tycho-2. Deeper, latitudes of 20° and more go over to the bare model (on
the way by the UCAC4 stars within 0.2° of the south celestial pole), and the lower ones make up the sums over
the whole sky.
"""


def galactic(ra_deg: ArrayLike, dec_deg: ArrayLike) -> tuple[Array, Array]:
    """Galactic coordinates of positions.

    Parameters
    ----------
    ra_deg, dec_deg : array_like of equal shape
        ICRS.

    Returns
    -------
    l_deg, b_deg : ndarray
        Longitude in [0, 360) and latitude.
    """
    axes = np.tensordot(_TO_GALACTIC, unit_vectors(np.asarray(ra_deg, float), np.asarray(dec_deg, float)), 1)
    l_deg = np.degrees(np.arctan2(axes[1], axes[0])) % 360.0
    return np.where(l_deg >= 360.0, 0.0, l_deg), np.degrees(np.arctan2(axes[2], np.hypot(axes[0], axes[1])))


def density_deg2(ra_deg: ArrayLike, dec_deg: ArrayLike, mag: ArrayLike) -> Array:
    """Stars brighter than a magnitude per square degree.

    Parameters
    ----------
    ra_deg, dec_deg, mag : array_like
        ICRS places and V magnitudes, broadcast against each other; magnitudes beyond 2..22 are taken as 2
        and 22.

    Returns
    -------
    ndarray
        Of the broadcast shape.
    """
    ra, dec, mag = np.broadcast_arrays(*(np.asarray(one, float) for one in (ra_deg, dec_deg, mag)))
    l_deg, b_deg = galactic(ra, dec)
    return _density(l_deg, np.abs(b_deg), np.clip(mag, BRIGHTEST_MAG, FAINTEST_MODELED_MAG))


def mag_reaching(ra_deg: ArrayLike, dec_deg: ArrayLike, stars_deg2: ArrayLike) -> Array:
    """Magnitude down to which there are so many stars per square degree.

    Parameters
    ----------
    ra_deg, dec_deg, stars_deg2 : array_like
        ICRS places and densities, broadcast against each other.

    Returns
    -------
    ndarray
        V within 2..22; 22 also where even that isn't deep enough.
    """
    ra, dec, wanted = np.broadcast_arrays(*(np.asarray(one, float) for one in (ra_deg, dec_deg, stars_deg2)))
    l_deg, b_deg = galactic(ra, dec)
    counts = _density(l_deg[..., None], np.abs(b_deg)[..., None], np.broadcast_to(_GRID_MAG, _GRID_MAG.shape))
    table = np.log(counts).reshape(-1, _GRID_MAG.size)
    asked = np.log(np.maximum(wanted, 1e-12)).reshape(-1)
    found = np.array([np.interp(one, row, _GRID_MAG) for one, row in zip(asked, table, strict=True)])
    return found.reshape(wanted.shape)


def _density(l_deg: Array, b_deg: Array, mag: Array) -> Array:
    """The model times the factor; `b_deg` >= 0."""
    b = np.radians(np.maximum(b_deg, _LOWEST_DEG))
    toward_center = np.cos(b) * np.cos(np.radians(l_deg))
    mu = np.clip(0.03 + 0.0075 * (mag - 12.0), 0.03, 0.09)
    gamma = np.clip(0.36 - 0.04 * (mag - 12.0), 0.04, 0.36)
    faint = mag - 15.75
    disk = 925.0 * 10.0 ** (0.035 * faint) / (1.0 + 10.0 ** (-0.132 * faint)) ** 3.0
    disk = disk / (np.sin(b) - mu * toward_center) ** (3.0 - 5.0 * gamma)
    faint = mag - 17.5
    spheroid = 1050.0 * 10.0 ** (0.087 * faint) / (1.0 + 10.0 ** (-0.180 * faint)) ** 2.5
    spheroid = spheroid / (1.0 - toward_center) ** (1.45 - 0.20 * toward_center)
    return np.asarray((disk + spheroid) * 10.0 ** _log_factor(b_deg, mag))


def _log_factor(b_deg: Array, mag: Array) -> Array:
    """Between the table's nodes: linear in both."""
    row, down = _between(_MAGNITUDES, mag)
    column, right = _between(_LATITUDES_DEG, b_deg)
    low = _LOG_FACTOR[row, column] * (1.0 - right) + _LOG_FACTOR[row, column + 1] * right
    high = _LOG_FACTOR[row + 1, column] * (1.0 - right) + _LOG_FACTOR[row + 1, column + 1] * right
    return np.asarray(low * (1.0 - down) + high * down)


def _between(nodes: Array, values: Array) -> tuple[NDArray[np.intp], Array]:
    """The node below each value and how far on the way to the next one; clamped to the table."""
    below = np.clip(np.searchsorted(nodes, values, side="right") - 1, 0, nodes.size - 2)
    share = (values - nodes[below]) / (nodes[below + 1] - nodes[below])
    return below, np.clip(share, 0.0, 1.0)


DEEPEST_MAG = 12.5
"""Down to here one rule for the whole sky does; deeper, the sky's regions differ too much."""
SPARE = 1.5
"""So many times the stars wanted are asked for: the model of the Galaxy knows of no dark clouds."""
DEEPER_MAG = 1.0
"""Where there are too few all the same, the catalog is read so much deeper."""
READ_WHOLE = 2.0
"""A cone that holds at most so many times the stars wanted is read whole at once: beyond `DEEPEST_MAG` the
embedded catalog has so few that nothing is saved by reading three times, each time deeper. Doubled, twice the
stars of a deep catalog's cone are read in vain."""

_ROUNDING_MAG = 1e-9
"""So much is allowed for where a magnitude is compared with a limit: far less than a catalog's step."""

FAINTEST_READ_MAG = 22.0
"""No catalog that doesn't tell is deeper."""


def magnitude_for(count: float, area_deg2: float) -> float | None:
    """Magnitude down to which even a poor region of the sky holds `count` stars in an area.

    Returns
    -------
    float or None
        None when the whole catalog is wanted. From star counts N(V) of the whole sky, a poor region
        having two fifths of the mean.
    """
    all_sky = count / area_deg2 * SKY_DEG2 / 0.4
    magnitude = 6.0 + (np.log10(all_sky) - 3.7) / 0.45 + 0.3
    return None if magnitude > DEEPEST_MAG else float(max(magnitude, 2.0))


def depth_for(catalog: Catalog, center: Icrs, count: float, area_deg2: float) -> float | None:
    """Magnitude down to which a catalog is read so that an area holds `count` stars.

    Parameters
    ----------
    center : Icrs
        Of the area, or near it.

    Returns
    -------
    float or None
        None when the whole catalog is wanted. It follows from the place alone, not from the catalog's stars.
    """
    limit = magnitude_for(count, area_deg2)
    if limit is None:
        density = SPARE * count / area_deg2
        limit = max(DEEPEST_MAG, _model_depth(round(center.ra_deg), round(center.dec_deg), density))
    return None if limit >= _faintest(catalog) else limit


def stars_round(catalog: Catalog, center: Icrs, radius_deg: float, count: int, *, epoch_yr: float) -> Stars:
    """The brightest stars of a cone, enough to have `count` of them where the catalog has so many.

    Returns
    -------
    Stars
        More than `count` in a rich region.
    """
    limit = depth_for(catalog, center, count, np.pi * radius_deg**2)
    return stars_deep_enough(catalog, center, radius_deg, limit, count, epoch_yr=epoch_yr)


def stars_deep_enough(
    catalog: Catalog, center: Icrs, radius_deg: float, limit: float | None, count: float, *, epoch_yr: float
) -> Stars:
    """The stars of a cone to a magnitude, or deeper where these are too few.

    Parameters
    ----------
    limit : float or None
        Magnitude; None is the whole catalog.
    count : float
        So few are enough.
    """
    faintest = _faintest(catalog)
    if (
        limit is not None
        and limit >= DEEPEST_MAG
        and isinstance(catalog, PackedStore)
        and catalog.most_in(center, radius_deg) <= READ_WHOLE * count
    ):
        every = catalog.cone(center, radius_deg, epoch_yr=epoch_yr)
        while limit < faintest:
            some = every.only(every.mag <= limit + _ROUNDING_MAG)
            if len(some) >= count:
                return some
            limit += DEEPER_MAG
        return every
    while True:
        stars = catalog.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=limit)
        # what one rule for the whole sky gave was meant for its poor regions already
        if limit is None or limit < DEEPEST_MAG or len(stars) >= count:
            return stars
        limit = limit + DEEPER_MAG if limit + DEEPER_MAG < faintest else None


def _faintest(catalog: Catalog) -> float:
    """Magnitude of the faintest star of a catalog, or beyond it."""
    if isinstance(catalog, PackedStore):
        return catalog.magnitudes[1]
    if isinstance(catalog, KnowsDepth):
        return min(catalog.faintest_mag, FAINTEST_READ_MAG)
    return FAINTEST_READ_MAG


@lru_cache(maxsize=4096)
def _model_depth(ra_deg: int, dec_deg: int, density_deg2: float) -> float:
    return float(mag_reaching(float(ra_deg), float(dec_deg), density_deg2))
