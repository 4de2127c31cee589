"""Cosmic rays: light that is sharper than any star of the frame [S23 §0.3]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Image

Array = NDArray[np.float64]

_HALF_PX = 5
"""Half side of the squares in which rays are sought beside a source, px. Doubled, 28 of 351 sources of a
field full of rays are left out in addition; below 3 px the source's own core doesn't fit in."""
_CORE_PX = 2
"""The source's own top lies within so many pixels of its position. Doubled or halved, nothing changed on the
frames that were tried."""
_NARROWEST_SHARE = 0.7
"""Width of the narrowest star over the typical one: stars differ over a frame, and may be oval. At 0.85
nothing changed on the frames that were tried; at 0.4 stars are not told from rays as well, and the median
error of C00 grows from 0.039 to 0.043 px."""
_SHARPNESS_MARGIN = 0.03
"""Room above that star's sharpness, for the noise. Doubled or halved, nothing changed on the frames that were
tried."""
_MOST_SHARP = 0.9
"""Sharpness from which stars can't be distinguished from hot pixels (FWHM below 1.6 px): nothing is sought
then. At 0.8 or 0.95 nothing changed on the frames that were tried."""
_SURE_SIGMA = 4.0
"""A pixel has to exceed the bound by so many of its own noises. Halved, 21 stars of C00 and 38 of D00 are
taken for rays; doubled, no figure changed by 3 %."""
_CLOSE_FWHM = 1.8
"""A ray nearer than this many FWHM to a star's top spoils it ... Doubled, 4 stars of a field full of rays are
flagged in addition; halved, 2 fewer."""
_CLOSE_SHARE = 0.15
"""... if it is brighter than this share of the star. Doubled or halved, nothing changed on the frames that
were tried."""
_CLEAR_SCATTER = 0.08
"""Sources whose noise is below this share of their top show how sharp the frame's own stars are. Doubled or
halved, no figure changed by 3 %."""
_FEWEST_CLEAR = 30
"""If there are so many of them. Doubled or halved, nothing changed on the frames that were tried."""
_USUAL_SIGMAS = 3.5
"""And they are clipped at so many sigmas above their middle. Doubled or halved, nothing changed on the frames
that were tried."""


def sharpest(fwhm_px: float) -> float:
    """Return the largest share of a pixel's value by which a star may rise above its two neighbors' mean.

    That of a star of 0.7 of the width, centered on the pixel: stars differ over a frame, and may be oval.
    """
    if fwhm_px <= 0.0:
        return 1.0
    return float(1.0 - np.exp(-4.0 * np.log(2.0) / (_NARROWEST_SHARE * fwhm_px) ** 2) + _SHARPNESS_MARGIN)


def _usual(rise: NDArray[np.float32], value: NDArray[np.float32], scatter: Array) -> float:
    """Return what share most of the frame's own clear sources stay below; 0 where they are too few."""
    clear = (scatter < _CLEAR_SCATTER * value) & np.isfinite(rise)
    share = rise[clear] / value[clear]
    share = share[share < _MOST_SHARP]  # single hot pixels
    if share.size < _FEWEST_CLEAR:
        return 0.0
    middle = float(np.median(share))
    # rays are above the middle: only the lower half shows how much stars differ
    return (
        middle
        + _USUAL_SIGMAS * 1.4826 * float(np.median(middle - share[share <= middle]))
        + _SHARPNESS_MARGIN
    )


def find_cosmics(
    sky_free: Image,
    good: NDArray[np.bool_],
    x_px: Array,
    y_px: Array,
    noise: Array,
    fwhm_px: float,
    gain_e_adu: float,
) -> tuple[NDArray[np.bool_], NDArray[np.intp], NDArray[np.intp]]:
    """Which sources are cosmic rays or hot pixels, and which pixels beside the other ones are.

    Stars narrower than about 1.6 px can't be distinguished from hot pixels by their shape: then nothing is
    found.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    good : ndarray of bool, shape (height, width)
        Pixels that may be used.
    x_px, y_px, noise : ndarray, shape (n,)
        Positions of the sources, and the sky noise per pixel at them.
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
    cutouts = sky_free[rows, columns]
    usable = good[rows, columns]
    inner = (slice(None), slice(1, -1), slice(1, -1))
    values = cutouts[inner]
    sky2 = (1.5 * noise * noise)[:, None, None].astype(np.float32)
    scatter = np.sqrt(sky2 + np.maximum(values, np.float32(0.0)) / np.float32(gain_e_adu))
    # along rows and along columns, each by itself: a track that follows one is sharp across
    rise = np.full(values.shape, -np.inf, dtype=np.float32)
    spoilt = not usable.all()
    for before, after in (
        ((slice(None), slice(None, -2), slice(1, -1)), (slice(None), slice(2, None), slice(1, -1))),
        ((slice(None), slice(1, -1), slice(None, -2)), (slice(None), slice(1, -1), slice(2, None))),
    ):
        fall = values - np.float32(0.5) * (cutouts[before] + cutouts[after])
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
        position = (index, top_row + dy, top_column + dx)
        bright = values[position] > 0.5 * values[index, top_row, top_column]
        struck |= sharp[position] & bright
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
