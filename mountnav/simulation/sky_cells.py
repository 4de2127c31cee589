"""The invented stars of a piece of sky: as many as the Galaxy has there, always the same ones for a seed."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import astropy.units as u
import numpy as np
from astropy_healpix import healpix_to_lonlat
from numpy.typing import NDArray
from scipy.special import pdtrik

from mountnav.catalog.packed.pixels import pixel_centers
from mountnav.catalog.space_motion import motion_vectors, places, unit_vectors
from mountnav.catalog.star_counts import density_deg2
from mountnav.simulation.seeded_random import normal, salted, uniform
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]

NSIDE = 256
"""Cells of 0.052 square degrees: the density of stars is even within one."""
# Faintest star of the simulated sky, V mag. Chosen by hand; deeper, each cone costs more.
FAINTEST_MAG = 22.0
# Area of a cell, square degrees.
_CELL_DEG2 = 4.0 * np.pi * np.degrees(1.0) ** 2 / (12 * NSIDE**2)
# HEALPix resolution of the first, coarse search for cells near a place. Chosen for speed.
_COARSE_NSIDE = 64
_LAYERS = ((11.5, 14.0), (14.0, 16.0), (16.0, 18.0), (18.0, 19.5), (19.5, 20.5), (20.5, FAINTEST_MAG))
"""Stars are made layer by layer, so that the bright ones don't cost the faint ones."""
# Bins of magnitude in which stars are counted; `TYCHO_SHARE` has the same ones.
_STEP_MAG = 0.25
TYCHO_SHARE = ((11.5, 0.97), (11.75, 0.72), (12.0, 0.40), (12.25, 0.21), (12.5, 0.08), (12.75, 0.03))
"""Of the stars of that and the next quarter magnitude, how many Tycho-2 has, counted against the model."""
# Share of stars with a companion. Chosen by hand.
_DOUBLES = 0.08
# Separations of companions, arcsec, even in the logarithm. Chosen by hand: from what catalogs don't resolve
# to what they list apart.
_CLOSEST_ARCSEC, _WIDEST_ARCSEC = 0.4, 8.0
# Largest proper motion of a star that is made up, mas a year. Chosen by hand: it cuts the tail of the
# log-normal motions.
_FASTEST_MAS_YR = 1500.0


@dataclass(frozen=True, slots=True)
class SkyRows:
    """Stars as they truly are; each array has shape (n,).

    Attributes
    ----------
    ra_deg, dec_deg
        ICRS at J2016.0.
    pm_ra_cosdec_mas_yr, pm_dec_mas_yr
        Proper motion.
    v_mag, bv_mag
        Brightness in V and the color index B-V.
    identity
        uint64, one's own: chance asks for it.
    parent
        Row of the brighter star of a close pair; -1 for all others.
    separation_arcsec
        From the parent; 0 for all others.
    """

    ra_deg: Array
    dec_deg: Array
    pm_ra_cosdec_mas_yr: Array
    pm_dec_mas_yr: Array
    v_mag: Array
    bv_mag: Array
    identity: NDArray[np.uint64]
    parent: NDArray[np.int64]
    separation_arcsec: Array

    def __len__(self) -> int:
        return int(self.ra_deg.size)


def joined(parts: list[SkyRows]) -> SkyRows:
    """One list of several; the rows of parents are kept right."""
    before = np.cumsum([0] + [len(part) for part in parts[:-1]])
    return _stacked(
        [
            replace(part, parent=np.where(part.parent >= 0, part.parent + at, -1))
            for part, at in zip(parts, before, strict=True)
        ]
    )


def cells_near(center: Icrs, radius_deg: float) -> NDArray[np.int64]:
    """Cells that a cone may touch, and some more.

    Returns
    -------
    ndarray of int64
        Nested numbers at `NSIDE`, rising.
    """
    axis = unit_vectors(center.ra_deg, center.dec_deg)
    coarse = np.flatnonzero(axis @ pixel_centers(_COARSE_NSIDE) >= _cosine(radius_deg + 1.3))
    each = (NSIDE // _COARSE_NSIDE) ** 2
    cells = (coarse[:, None] * each + np.arange(each)).ravel()
    lon, lat = healpix_to_lonlat(cells, nside=NSIDE, order="nested")
    near = axis @ unit_vectors(lon.to_value(u.deg), lat.to_value(u.deg)) >= _cosine(radius_deg + 0.3)
    return np.asarray(cells[near], dtype=np.int64)


def invented(cells: NDArray[np.int64], seed: int, faintest_mag: float) -> SkyRows:
    """All invented stars of some cells.

    Parameters
    ----------
    cells : ndarray of int64
        Nested HEALPix numbers at `NSIDE`.
    faintest_mag : float
        V, at most `FAINTEST_MAG`.

    Returns
    -------
    SkyRows
        Where Tycho-2 is complete, none: its own stars are the sky there.
    """
    lon, lat = healpix_to_lonlat(cells, nside=NSIDE, order="nested")
    ra, dec = lon.to_value(u.deg), lat.to_value(u.deg)
    parts = [
        _layer(cells, ra, dec, seed, number)
        for number, (bright, _) in enumerate(_LAYERS)
        if bright < faintest_mag
    ]
    if not parts:
        parts = [_layer(cells[:0], ra[:0], dec[:0], seed, 0)]
    rows = joined(parts)
    rows = _some(rows, rows.v_mag <= faintest_mag)
    return _stacked([rows, _companions(rows, faintest_mag)])


def _layer(cells: NDArray[np.int64], ra_deg: Array, dec_deg: Array, seed: int, number: int) -> SkyRows:
    """The stars between two magnitudes."""
    bright, faint = _LAYERS[number]
    edges = np.arange(bright, faint + 0.5 * _STEP_MAG, _STEP_MAG)
    table = np.diff(density_deg2(ra_deg[:, None], dec_deg[:, None], edges), axis=1) * _CELL_DEG2
    left_out = dict(TYCHO_SHARE)
    table *= 1.0 - np.array([left_out.get(float(edge), 0.0) for edge in edges[:-1]])
    upto = np.concatenate([np.zeros((cells.size, 1)), np.cumsum(table, axis=1)], axis=1)
    expected = upto[:, -1]
    whose = salted(cells.astype(np.uint64), seed * 64 + number)
    # the inverse of the Poisson distribution; NaN where already nobody is the answer
    count = np.ceil(np.nan_to_num(pdtrik(uniform(whose, 1), expected), nan=0.0)).astype(np.int64)
    row = np.repeat(np.arange(cells.size), count)
    nth = np.arange(row.size) - np.repeat(np.cumsum(count) - count, count)
    identity = salted(whose[row] + nth.astype(np.uint64) * np.uint64(0xD1342543DE82EF95), 2)
    rank = uniform(identity, 3) * expected[row]
    # not one interpolation over all cells' tables end to end: its rounding would depend on the company
    mine = upto[row]
    below = np.clip((mine <= rank[:, None]).sum(axis=1) - 1, 0, edges.size - 2)
    low, high = (np.take_along_axis(mine, (below + up)[:, None], axis=1)[:, 0] for up in (0, 1))
    v_mag = edges[below] + _STEP_MAG * (rank - low) / (high - low)
    lon, lat = healpix_to_lonlat(
        cells[row], nside=NSIDE, dx=uniform(identity, 4), dy=uniform(identity, 5), order="nested"
    )
    size = 6.0 * 10.0 ** (-0.03 * (v_mag - 14.0)) * np.exp(0.8 * normal(identity, 6))
    size = np.minimum(size, _FASTEST_MAS_YR)
    angle = 2.0 * np.pi * uniform(identity, 7)
    # faint stars are of two kinds: dwarfs like the Sun far away, red ones nearby
    red = uniform(identity, 8) < np.clip(0.15 + 0.05 * (v_mag - 14.0), 0.1, 0.5)
    bv = np.where(red, 1.45 + 0.12 * normal(identity, 9), 0.68 + 0.2 * normal(identity, 9))
    return SkyRows(
        ra_deg=lon.to_value(u.deg) % 360.0,
        dec_deg=lat.to_value(u.deg),
        pm_ra_cosdec_mas_yr=size * np.sin(angle),
        pm_dec_mas_yr=size * np.cos(angle),
        v_mag=v_mag,
        bv_mag=np.clip(bv, -0.2, 1.9),
        identity=identity,
        parent=np.full(row.size, -1, dtype=np.int64),
        separation_arcsec=np.zeros(row.size),
    )


def _companions(rows: SkyRows, faintest_mag: float) -> SkyRows:
    """Fainter stars close to some of the stars, moving with them."""
    identity = salted(rows.identity, 10)
    v_mag = rows.v_mag + 3.0 * uniform(identity, 11)
    has = np.flatnonzero((uniform(identity, 12) < _DOUBLES) & (v_mag <= faintest_mag))
    identity, v_mag = identity[has], v_mag[has]
    span = np.log(_WIDEST_ARCSEC / _CLOSEST_ARCSEC)
    apart = _CLOSEST_ARCSEC * np.exp(span * uniform(identity, 13))
    angle = 2.0 * np.pi * uniform(identity, 14)
    ra, dec = shifted(rows.ra_deg[has], rows.dec_deg[has], apart * np.sin(angle), apart * np.cos(angle))
    return SkyRows(
        ra_deg=ra,
        dec_deg=dec,
        pm_ra_cosdec_mas_yr=rows.pm_ra_cosdec_mas_yr[has],
        pm_dec_mas_yr=rows.pm_dec_mas_yr[has],
        v_mag=v_mag,
        bv_mag=np.clip(rows.bv_mag[has] + 0.25, -0.2, 1.9),
        identity=identity,
        parent=has,
        separation_arcsec=apart,
    )


def shifted(ra_deg: Array, dec_deg: Array, east_arcsec: Array, north_arcsec: Array) -> tuple[Array, Array]:
    """Places a few arcseconds away; right at the poles too.

    Parameters
    ----------
    ra_deg, dec_deg, east_arcsec, north_arcsec : ndarray, shape (n,)
        Positions, and how far they are to be moved.
    """
    across = motion_vectors(ra_deg, dec_deg, east_arcsec * 1000.0, north_arcsec * 1000.0)  # of one year
    return places(unit_vectors(ra_deg, dec_deg) + across)


def _stacked(parts: list[SkyRows]) -> SkyRows:
    """One below the other, whatever their parents are."""
    return SkyRows(
        **{one.name: np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(SkyRows)}
    )


def _some(rows: SkyRows, which: NDArray[np.bool_]) -> SkyRows:
    """Some rows, none of which has a companion among the others."""
    return SkyRows(**{one.name: getattr(rows, one.name)[which] for one in fields(SkyRows)})


def _cosine(angle_deg: float) -> float:
    return float(np.cos(np.radians(min(angle_deg, 180.0))))
