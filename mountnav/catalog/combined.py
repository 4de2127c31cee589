"""Positions of one catalog, magnitudes of another, as the paper takes UCAC4 and USNO-B1.0 [S23 §4]."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.space_motion import places, unit_vectors
from mountnav.catalog.stars import Catalog, StarFlag, Stars
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]

LEAST_ARCSEC, MOST_ARCSEC = 1.0, 4.0
"""How near a star of the other catalog must stand, whatever the stated errors."""
SIGMAS = 4.0
"""Combined position errors within which two entries are one star, between `LEAST_ARCSEC` and `MOST_ARCSEC`;
chosen: at 4 one star in 3,000 misses its partner by errors alone. Halved, one in seven does (Rayleigh)."""
ODD_MAG = 2.0
"""A star whose magnitudes differ by so much more than the others' do is another star."""
DEEPER_MAG = 3.0
"""Bands differ: the other catalog is read so much deeper than the faintest star."""


def with_magnitudes(stars: Stars, other: Catalog) -> Stars:
    """Give stars the magnitudes, and the colors, of another catalog.

    Parameters
    ----------
    stars : Stars
        Within some degrees.
    other : Catalog
        Where the magnitudes come from.

    Returns
    -------
    Stars
        The same stars in the same order: by their former magnitudes. Those that the other catalog doesn't
        have keep theirs, shifted by the median difference and flagged `StarFlag.OTHER_BAND`. If fewer than
        three are found, all keep theirs.
    """
    if len(stars) == 0:
        return stars
    vectors = unit_vectors(stars.ra_deg, stars.dec_deg)
    middle = vectors.mean(axis=1)
    middle /= np.sqrt((middle**2).sum())
    (ra_deg,), (dec_deg,) = places(middle[:, None])
    farthest = float(np.sqrt(((vectors - middle[:, None]) ** 2).sum(axis=0)).max())
    radius_deg = float(np.degrees(2.0 * np.arcsin(min(0.5 * farthest, 1.0)))) + 2.0 * MOST_ARCSEC / 3600.0
    found = other.cone(
        Icrs(float(ra_deg) % 360.0, float(dec_deg)),
        min(radius_deg, 180.0),
        epoch_yr=stars.epoch_yr,
        mag_limit=float(np.nanmax(stars.mag)) + DEEPER_MAG,
    )
    mine, theirs = _same(stars, vectors, found)
    good = (found.flags[theirs] & int(StarFlag.NO_MAGNITUDE)) == 0
    mine, theirs = mine[good], theirs[good]
    difference = found.mag[theirs] - stars.mag[mine]
    if difference.size:
        usual = np.abs(difference - np.median(difference)) < ODD_MAG
        mine, theirs, difference = mine[usual], theirs[usual], difference[usual]
    told = f"magnitudes of {found.source} ({found.band}) for {mine.size} of {len(stars)} stars"
    if mine.size < 3:
        return replace(stars, steps=(*stars.steps, f"{told}: too few, so those of {stars.source} are kept"))
    mag = stars.mag + float(np.median(difference))
    flags = stars.flags | np.uint8(StarFlag.OTHER_BAND)
    mag[mine], flags[mine] = found.mag[theirs], found.flags[theirs] | stars.flags[mine]
    color, color_name = stars.color_mag, stars.color_name
    if found.color_name:
        color, color_name = np.full(len(stars), np.nan), found.color_name
        color[mine] = found.color_mag[theirs]
    return replace(
        stars,
        mag=mag,
        band=found.band,
        flags=flags,
        color_mag=color,
        color_name=color_name,
        steps=(*stars.steps, *found.steps, told),
    )


def _same(stars: Stars, vectors: Array, found: Stars) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which stars of both lists are each other's nearest, and near enough for their errors."""
    none = np.zeros(0, dtype=np.int64)
    if len(found) == 0:
        return none, none
    there = unit_vectors(found.ra_deg, found.dec_deg)
    chord, nearest = (np.asarray(one) for one in cKDTree(there.T).query(vectors.T))
    back = np.asarray(cKDTree(vectors.T).query(there.T)[1])
    mutual = back[nearest] == np.arange(len(stars))
    own, its = (np.nan_to_num(one, nan=1.0) for one in (stars.sigma_arcsec, found.sigma_arcsec[nearest]))
    reach_arcsec = np.clip(SIGMAS * np.hypot(own, its), LEAST_ARCSEC, MOST_ARCSEC)
    chosen = np.flatnonzero(mutual & (np.degrees(chord) * 3600.0 <= reach_arcsec))
    return chosen, np.asarray(nearest[chosen], dtype=np.int64)
