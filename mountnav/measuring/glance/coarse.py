"""The coarse plane: sums of square bins of a frame, made in strips that stay in the processor's cache."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.background import Image

_STRIP_LINES = 32
_LOW_HALF = np.uint32(0xFFFF)
#: What 1 2 1 both ways leaves of independent noise.
SMOOTHED_NOISE = 6.0 / 16.0
_LOW_LONG = np.uint64(0xFFFFFFFF)


def coarse_plane(pixels: NDArray[np.generic], bin_px: int) -> Image:
    """Sum a frame in bins; what is left over at the right and upper rim is passed over.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        Of any real type.
    bin_px : int
        1, 2 or 4.

    Returns
    -------
    ndarray of float32, shape (height // bin_px, width // bin_px)
        A bin with a missing pixel is NaN.
    """
    height, width = pixels.shape
    rows, columns = height // bin_px, width // bin_px
    plane = np.empty((rows, columns), dtype=np.float32)
    if bin_px == 1:
        plane[...] = pixels
        return plane
    pairs = pixels.dtype.kind == "u" and pixels.dtype.itemsize == 2
    for first in range(0, rows, _STRIP_LINES):
        count = min(_STRIP_LINES, rows - first)
        strip = pixels[first * bin_px : (first + count) * bin_px, : columns * bin_px]
        lines = np.ascontiguousarray(strip).reshape(count, bin_px, columns * bin_px)
        _sum_strip(lines, plane[first : first + count], bin_px, pairs=pairs)
    return plane


def _sum_strip(lines: NDArray[np.generic], out: Image, bin_px: int, *, pairs: bool) -> None:
    """Sum lines of shape (count, bin_px, columns · bin_px) over their bins."""
    if not pairs:
        total = lines[:, 0].astype(np.float32)
        for j in range(1, bin_px):
            total += lines[:, j].astype(np.float32)
        while total.shape[1] > out.shape[1]:
            total = total[:, 0::2] + total[:, 1::2]
        out[...] = total
        return
    # two pixels of 16 bits lie in one word of 32: both halves are summed without unpacking them
    words = lines.astype(np.uint16, copy=False).view(np.uint32)
    both = words & _LOW_HALF
    both += words >> np.uint32(16)
    sums = both[:, 0] + both[:, 1]
    for j in range(2, bin_px):
        sums += both[:, j]
    if bin_px == 2:
        out[...] = sums
        return
    wide = sums.view(np.uint64)
    # little end first or last, a sum of both halves is the same
    out[...] = (wide & _LOW_LONG) + (wide >> np.uint64(32))


def smooth_lightly(plane: Image) -> None:
    """Smooth a plane in place by 1 2 1 both ways, for the search in single pixels; the rim stays."""
    # 1 2 1 is 1 1 twice
    lines = plane[:-1] + plane[1:]
    lines = lines[:-1] + lines[1:]
    smooth = lines[:, :-1] + lines[:, 1:]
    smooth = smooth[:, :-1] + smooth[:, 1:]
    smooth *= np.float32(1.0 / 16.0)
    plane[1:-1, 1:-1] = smooth
