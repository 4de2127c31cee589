"""Which index file a place on the sky belongs to: margins overlap, and each scale has the stars anew."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.readers.astrometry_net.index_file import IndexFile


def nested_pixel(healpix: int, nside: int) -> int:
    """Bring astrometry.net's pixel number to the NESTED scheme.

    Theirs is base pixel × nside² + x × nside + y; NESTED interleaves the bits of x (even) and y (odd)
    [util/healpix.c of astrometry.net; K. M. Górski et al., ApJ 622, 759 (2005), section 4.1].

    Parameters
    ----------
    healpix, nside : int
        `nside` a power of 2.

    Returns
    -------
    int
    """
    base, inside = divmod(healpix, nside * nside)
    x, y = divmod(inside, nside)
    interleaved = 0
    for bit in range(nside.bit_length()):
        interleaved |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1)
    return base * nside * nside + interleaved


def owners(files: Sequence[IndexFile], nside: int) -> NDArray[np.str_]:
    """Name the file that each pixel is taken from.

    Parameters
    ----------
    files : sequence of IndexFile
        The one that is preferred first.
    nside : int
        At least that of the files.

    Returns
    -------
    ndarray of str, shape (12 nside²,)
        NESTED; empty where no file is for it.
    """
    longest = max(len(file.path.name) for file in files)
    names = np.full(12 * nside**2, "", dtype=f"<U{longest}")
    for file in reversed(files):
        if file.healpix < 0:
            names[:] = file.path.name
            continue
        children = (nside // file.nside) ** 2
        first = nested_pixel(file.healpix, file.nside) * children
        names[first : first + children] = file.path.name
    return names


def cells_of(ra_deg: NDArray[np.float64], dec_deg: NDArray[np.float64], nside: int) -> NDArray[np.int64]:
    """Pixels of some places, NESTED.

    Parameters
    ----------
    ra_deg, dec_deg : ndarray, shape (n,)
    nside : int

    Returns
    -------
    ndarray of int, shape (n,)
    """
    from astropy import units
    from astropy_healpix import lonlat_to_healpix

    pixels: NDArray[np.int64] = lonlat_to_healpix(
        ra_deg * units.deg, dec_deg * units.deg, nside=nside, order="nested"
    )
    return pixels
