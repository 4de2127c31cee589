"""Stars that no catalog holds: invented, but always the same ones at the same places in the sky."""

from __future__ import annotations

import astropy.units as u
import numpy as np
from astropy_healpix import HEALPix
from numpy.typing import NDArray

from mountnav.sky.coordinates import Icrs

_NSIDE = 64  # cells of 0.84 square degrees
# Magnitudes over which faint stars are spread, doubling in each. Chosen by hand.
_SPAN_MAG = 4.0
Array = NDArray[np.float64]


def faint_stars(
    center: Icrs, radius_deg: float, density_deg2: float, brightest_mag: float
) -> tuple[Array, Array, Array]:
    """Uncatalogued stars in (and somewhat beyond) a cone.

    Parameters
    ----------
    center : Icrs
        Middle of the cone.
    radius_deg : float
        Its radius.
    density_deg2 : float
        Stars per square degree.
    brightest_mag : float
        Brightest magnitude; the number doubles each magnitude, over 4 magnitudes.

    Returns
    -------
    ra_deg, dec_deg, mag : ndarray, shape (n,)
        Each cell of the sky has its own stars, seeded by the cell's number.
    """
    grid = HEALPix(nside=_NSIDE, order="nested")
    cells = _cells_near(grid, center, radius_deg)
    parts: list[tuple[Array, Array, Array]] = []
    for cell in cells:
        rng = np.random.Generator(np.random.PCG64(int(cell)))
        n = int(rng.poisson(density_deg2 * grid.pixel_area.to_value(u.deg**2)))
        along, across, rank = rng.random((3, n))
        # HEALPix cells have equal areas within as without, so even offsets are even on the sky
        lon, lat = grid.healpix_to_lonlat(np.full(n, cell), dx=along, dy=across)
        steepness = 2.0**_SPAN_MAG - 1.0
        mag = brightest_mag + np.log2(1.0 + rank * steepness)
        parts.append((lon.to_value(u.deg), lat.to_value(u.deg), mag))
    ra, dec, mag = (np.concatenate(column) for column in zip(*parts, strict=True))
    return ra, dec, mag


def _cells_near(grid: HEALPix, center: Icrs, radius_deg: float) -> NDArray[np.int64]:
    """Cells whose center lies within the cone widened by a cell's size (cone_search misses some)."""
    lon, lat = grid.healpix_to_lonlat(np.arange(grid.npix))
    ra, dec = lon.to_value(u.rad), lat.to_value(u.rad)
    ra0, dec0 = np.radians(center.ra_deg), np.radians(center.dec_deg)
    cosine = np.sin(dec0) * np.sin(dec) + np.cos(dec0) * np.cos(dec) * np.cos(ra - ra0)
    wide_deg = radius_deg + 2.0 * float(grid.pixel_resolution.to_value(u.deg))
    return np.flatnonzero(cosine > np.cos(np.radians(wide_deg)))
