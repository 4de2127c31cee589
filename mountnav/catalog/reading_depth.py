"""How deep a catalog is read: the brightest stars of an area, as many as are wanted, wherever it lies."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.star_counts import mag_reaching
from mountnav.catalog.stars import Catalog, Stars
from mountnav.sky.coordinates import Icrs

DEEPEST_MAG = 12.5
"""Down to here one rule for the whole sky does; deeper, the sky's regions differ too much."""
SPARE = 1.5
"""So many times the stars wanted are asked for: the model of the Galaxy knows of no dark clouds."""
DEEPER_MAG = 1.0
"""Where there are too few all the same, the catalog is read so much deeper."""

FAINTEST_MAG = 22.0
"""No catalog that doesn't tell is deeper."""


def magnitude_for(count: float, area_deg2: float) -> float | None:
    """Magnitude down to which even a poor region of the sky holds `count` stars in an area.

    Parameters
    ----------
    count : float
    area_deg2 : float

    Returns
    -------
    float or None
        None when the whole catalog is wanted. From star counts N(V) of the whole sky, a poor region
        having two fifths of the mean.
    """
    all_sky = count / area_deg2 * 41253.0 / 0.4
    magnitude = 6.0 + (np.log10(all_sky) - 3.7) / 0.45 + 0.3
    return None if magnitude > DEEPEST_MAG else float(max(magnitude, 2.0))


def depth_for(catalog: Catalog, center: Icrs, count: float, area_deg2: float) -> float | None:
    """Magnitude down to which a catalog is read so that an area holds `count` stars.

    Parameters
    ----------
    catalog : Catalog
    center : Icrs
        Of the area, or near it.
    count : float
    area_deg2 : float

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

    Parameters
    ----------
    catalog : Catalog
    center : Icrs
    radius_deg : float
    count : int
    epoch_yr : float

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
    catalog : Catalog
    center : Icrs
    radius_deg : float
    limit : float or None
        Magnitude; None is the whole catalog.
    count : float
        So few are enough.
    epoch_yr : float

    Returns
    -------
    Stars
    """
    faintest = _faintest(catalog)
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
    return min(float(getattr(catalog, "faintest_mag", FAINTEST_MAG)), FAINTEST_MAG)


@lru_cache(maxsize=4096)
def _model_depth(ra_deg: int, dec_deg: int, density_deg2: float) -> float:
    return float(mag_reaching(float(ra_deg), float(dec_deg), density_deg2))
