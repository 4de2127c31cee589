"""Cosmic rays and hot pixels: sharper than any star of the frame [van Dokkum 2001, PASP 113, 1420].

Van Dokkum's test looks for edges sharper than the telescope can draw. Here the stars' width is known, so the
sharpest edge that a star can have is known too, and one frame is enough.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Image

Array = NDArray[np.float64]

_HALF_PX = 5
_CORE_PX = 2
_SHARPEST = 0.7
_ROOM = 0.03
_MOST_SHARP = 0.9
_SURE_SIGMA = 4.0
_CLOSE_FWHM = 1.8
_CLOSE_SHARE = 0.15
_CLEAR = 0.08
_ENOUGH = 30
_USUAL_SIGMAS = 3.5


def sharpest(fwhm_px: float) -> float:
    """Return the largest share of a pixel's value by which a star may rise above its two neighbors' mean.

    That of a star of 0.7 of the width, centered on the pixel: stars differ over a frame, and may be oval.
    """
    if fwhm_px <= 0.0:
        return 1.0
    return float(1.0 - np.exp(-4.0 * np.log(2.0) / (_SHARPEST * fwhm_px) ** 2) + _ROOM)


def _usual(rise: NDArray[np.float32], value: NDArray[np.float32], scatter: Array) -> float:
    """Return what share most of the frame's own clear sources stay below; 0 where they are too few."""
    clear = (scatter < _CLEAR * value) & np.isfinite(rise)
    share = rise[clear] / value[clear]
    share = share[share < _MOST_SHARP]  # single hot pixels
    if share.size < _ENOUGH:
        return 0.0
    middle = float(np.median(share))
    # rays are above the middle: only the lower half tells how much stars differ
    return middle + _USUAL_SIGMAS * 1.4826 * float(np.median(middle - share[share <= middle])) + _ROOM


def find_cosmics(
    sky_free: Image,
    good: NDArray[np.bool_],
    x_px: Array,
    y_px: Array,
    noise: Array,
    fwhm_px: float,
    gain_e_adu: float,
) -> tuple[NDArray[np.bool_], NDArray[np.intp], NDArray[np.intp]]:
    """Tell which sources are cosmic rays or hot pixels, and which pixels beside the other ones are.

    Stars narrower than about 1.6 px can't be told from hot pixels by their shape: then nothing is found.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
    good : ndarray of bool, shape (height, width)
    x_px, y_px, noise : ndarray, shape (n,)
        Places of the sources, and the sky noise per pixel at them.
    fwhm_px : float
        The stars' width, along the narrow side; 0 if any edge may be a star's.
    gain_e_adu : float
        Electrons per ADU.

    Returns
    -------
    struck : ndarray of bool, shape (n,)
        The source's own top is too sharp for a star, or a bright ray is close to it.
    rows, columns : ndarray of int
        Pixels too sharp for a star that lie off the tops of the sources.
    """
    none = np.zeros(0, dtype=np.intp)
    limit = sharpest(fwhm_px)  # a guess: the frame's own stars have the last word
    height, width = sky_free.shape
    if limit > _MOST_SHARP or x_px.size == 0 or min(height, width) < 2 * _HALF_PX + 3:
        return np.zeros(x_px.size, dtype=bool), none, none
    reach = _HALF_PX + 1
    offset = np.arange(-reach, reach + 1)
    rows = (
        np.clip(np.rint(y_px).astype(int), reach, height - 1 - reach)[:, None, None] + offset[None, :, None]
    )
    columns = (
        np.clip(np.rint(x_px).astype(int), reach, width - 1 - reach)[:, None, None] + offset[None, None, :]
    )
    stamps = sky_free[rows, columns]
    usable = good[rows, columns]
    inner = (slice(None), slice(1, -1), slice(1, -1))
    values = stamps[inner]
    sky2 = (1.5 * noise * noise)[:, None, None].astype(np.float32)
    scatter = np.sqrt(sky2 + np.maximum(values, np.float32(0.0)) / np.float32(gain_e_adu))
    # along rows and along columns, each by itself: a track that follows one is sharp across
    rise = np.full(values.shape, -np.inf, dtype=np.float32)
    spoilt = not usable.all()
    for before, after in (
        ((slice(None), slice(None, -2), slice(1, -1)), (slice(None), slice(2, None), slice(1, -1))),
        ((slice(None), slice(1, -1), slice(None, -2)), (slice(None), slice(1, -1), slice(2, None))),
    ):
        fall = values - np.float32(0.5) * (stamps[before] + stamps[after])
        if spoilt:
            fall[~(usable[before] & usable[after] & usable[inner])] = -np.inf
        np.maximum(rise, fall, out=rise)
    core = slice(_HALF_PX - _CORE_PX, _HALF_PX + _CORE_PX + 1)
    middle = np.where(usable[inner], values, -np.inf)[:, core, core].reshape(x_px.size, -1)
    top = middle.argmax(axis=1)
    side = 2 * _CORE_PX + 1
    index = np.arange(x_px.size)
    top_row, top_column = core.start + top // side, core.start + top % side
    tops = (index, top_row, top_column)
    limit = max(limit, _usual(rise[tops], values[tops], scatter[tops]))
    sharp = (rise > limit * values + _SURE_SIGMA * scatter) & (values > 0)
    # a ray's track: its top, or a pixel beside it, is too sharp
    struck = np.zeros(x_px.size, dtype=bool)
    for dy, dx in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)):
        place = (index, top_row + dy, top_column + dx)
        bright = values[place] > 0.5 * values[index, top_row, top_column]
        struck |= sharp[place] & bright
    which = np.flatnonzero(sharp.any(axis=(1, 2)))
    sharp, values = sharp[which], values[which]
    line = np.arange(2 * _HALF_PX + 1)
    far = np.hypot(
        line[None, :, None] - top_row[which, None, None], line[None, None, :] - top_column[which, None, None]
    )
    # a ray so near and so bright spoils the star even without its sharpest pixels
    close = sharp & (far > 1.5) & (far < max(3.0, _CLOSE_FWHM * fwhm_px))
    heights = values[np.arange(which.size), top_row[which], top_column[which]]
    struck[which] |= (close & (values > _CLOSE_SHARE * heights[:, None, None])).any(axis=(1, 2))
    # the rest of a track is less sharp than its ends
    grown = ndimage.binary_dilation(sharp & (far > 1.5), structure=np.ones((1, 3, 3), dtype=bool))
    beside = grown & (far > 1.5) & ~struck[which, None, None]
    star, j, i = np.nonzero(beside)
    return struck, rows[which[star], j + 1, 0], columns[which[star], 0, i + 1]
