"""The center and scale that a solver's FITS header claims, read by astropy and none of our own code."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

from astropy.io import fits
from astropy.wcs import WCS, FITSFixedWarning

from benchmarks.peers.running import Found
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec


def claimed(header: fits.Header, width_px: int, height_px: int) -> Found | None:
    """Where the frame's geometric center lies by this WCS, distortion included; None if it holds none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        wcs = WCS(header, relax=True)
    if not wcs.has_celestial:
        return None
    x, y = (width_px - 1) / 2.0, (height_px - 1) / 2.0
    ra, dec = wcs.all_pix2world([x, x - 1, x + 1, x, x], [y, y, y, y - 1, y + 1], 0)
    if not all(math.isfinite(value) for value in (*ra, *dec)):
        return None
    middle, left, right, low, high = (Icrs(float(a) % 360.0, float(d)) for a, d in zip(ra, dec, strict=True))
    # distances over two pixels; the cells of a camera are square to a fraction of a percent
    along, across = separation_arcsec(left, right) / 2.0, separation_arcsec(low, high) / 2.0
    return Found(middle, math.sqrt(along * across))


def claimed_in(path: Path, width_px: int, height_px: int) -> Found | None:
    """The same of a FITS file; None if there is no such file."""
    if not path.is_file():
        return None
    return claimed(fits.getheader(path), width_px, height_px)
