"""Saturated pixels: from which level, the patches they form, and charge that bled from them [S23 §0.3]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Image

_CARD_SHARE = 0.995
"""Share of the header's saturation level from which a pixel is full: cards state the converter's end, which
not every pixel reaches. At 0.99 or 0.9975 nothing changed on the frames that were tried."""
_PILE_SHARE = 0.004
"""Depth of the pile-up at the frame's maximum, as a share of its height above the sky. Doubled or halved,
nothing changed on the frames that were tried."""
_PILE_PIXELS = 12
"""Pixels within that depth that make a pile-up ..."""
_PILE_PIXELS_EXACT = 4
"""... or pixels at exactly the maximum."""
_LEAST_RISE_ADU = 30.0
"""A maximum less than so many ADU above the sky is no full well. Doubled or halved, nothing changed on the
frames that were tried."""
_TYPE_SHARE = 0.985
"""Share of an integer type's range from which a pixel is full, whatever the card says. At 0.97 or 0.9925
nothing changed on the frames that were tried."""


def saturation_level(
    pixels: NDArray[np.generic], image: Image, sky: float, noise: float, card: float | None
) -> float:
    """Return the level from which pixels count as saturated; infinity if none is known.

    A card is believed as an upper bound. Otherwise, pixels that pile up at the frame's very maximum, far
    above the sky, tell of a full well or a full converter.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        As read, for the type.
    image : ndarray of float32, shape (height, width)
        The same as floats; NaN marks missing pixels.
    sky, noise : float
        Median level of the sky, and its noise per pixel.
    card : float or None
        `Frame.saturation_adu`.
    """
    level = np.inf if card is None else _CARD_SHARE * card
    if pixels.dtype.kind == "u" or (pixels.dtype.kind == "i" and pixels.dtype.itemsize <= 2):
        level = min(
            level, _TYPE_SHARE * (2.0 ** (8 * pixels.dtype.itemsize - (pixels.dtype.kind == "i")) - 1.0)
        )
    top = float(np.nanmax(image))
    if top - sky < max(_LEAST_RISE_ADU, 20.0 * noise):
        return level
    exact = int(np.count_nonzero(image == top))
    margin = _PILE_SHARE * (top - sky)
    near = int(np.count_nonzero(image >= top - margin))
    if near >= _PILE_PIXELS or exact >= _PILE_PIXELS_EXACT:
        level = min(level, top - margin)
    return level


Array = NDArray[np.float64]

_BLEED_RATIO = 3.0
"""Length over mean width of a saturated patch along a column or row from which charge has run. Doubled or
halved, nothing changed on the frames that were tried."""
_BLOCK_PX = 6
"""Length of the blocks in which a tail is followed, px. Doubled or halved, nothing changed on the frames that
were tried."""
_TAIL_RATIO = 3.0
"""Brightness of a block over that at the same distance across from which it belongs to a tail: halos and
spikes look alike both ways. Doubled or halved, nothing changed on the frames that were tried."""
_TAIL_SIGMA = 6.0
"""And in units of the noise of a block's median. Doubled or halved, nothing changed on the frames that were
tried."""
_LEAST_BLOCKS = 2
"""Blocks of the shortest tail. Doubled or halved, nothing changed on the frames that were tried."""
_GAP_BLOCKS = 1
"""Dark blocks within a tail that don't end it. Doubled or halved, nothing changed on the frames that were
tried."""
_MOST_STARS = 300
"""Saturated patches at most whose tails are followed, the largest: bounds the time. Doubled or halved,
nothing changed on the frames that were tried."""


@dataclass(frozen=True, slots=True)
class SaturatedPatch:
    """A connected patch of saturated pixels.

    Attributes
    ----------
    x_px, y_px : float
        Where its star is.
    left, right, top, bottom : int
        Its first and last columns and rows.
    radius_px : float
        Of the patch, across the line along which charge ran, if it did.
    bleeds : bool
        It is much longer than wide along a column or row.
    """

    x_px: float
    y_px: float
    left: int
    right: int
    top: int
    bottom: int
    radius_px: float
    bleeds: bool


@dataclass(frozen=True, slots=True)
class Bleed:
    """A rectangle of pixels into which charge has run; the last columns and rows are part of it."""

    left: int
    right: int
    top: int
    bottom: int

    def touches(self, x_px: Array, y_px: Array, margin_px: float) -> NDArray[np.bool_]:
        """Which positions, shape (n,), lie on it or within a margin of it."""
        return np.asarray(
            (x_px > self.left - margin_px)
            & (x_px < self.right + margin_px)
            & (y_px > self.top - margin_px)
            & (y_px < self.bottom + margin_px)
        )


def find_saturated_patches(saturated: NDArray[np.bool_], fwhm_px: float) -> list[SaturatedPatch]:
    """Find the connected patches of saturated pixels.

    A patch much longer than wide along one axis bleeds; its star is where it is widest across that axis.

    Parameters
    ----------
    saturated : ndarray of bool, shape (height, width)
        Pixels at or above the saturation level.
    """
    blobs: list[SaturatedPatch] = []
    lines = np.flatnonzero(saturated.any(axis=1))
    if lines.size == 0:
        return blobs
    # only the lines that hold saturated pixels are labelled, a clear one between any two that don't touch
    gap = np.r_[0, np.cumsum(np.minimum(np.diff(lines), 2))]
    packed = np.zeros((int(gap[-1]) + 1, saturated.shape[1]), dtype=bool)
    packed[gap] = saturated[lines]
    line_at = np.zeros(packed.shape[0], dtype=np.intp)
    line_at[gap] = lines
    labels, _ = ndimage.label(packed, structure=np.ones((3, 3)))
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        patch = labels[box] == number
        tall, wide = patch.shape
        rows, columns = np.nonzero(patch)
        x, y = float(columns.mean()), float(rows.mean())
        thin = patch.sum() / max(tall, wide)  # mean width across the longer side
        bleeds = max(tall, wide) > max(_BLEED_RATIO * thin, 3.0 * fwhm_px, 6.0)
        radius = np.sqrt(patch.sum() / np.pi)
        if bleeds:
            across = patch.sum(axis=1 if tall >= wide else 0)
            widest = np.flatnonzero(across >= 0.8 * across.max())
            middle = float(widest.mean())
            if tall >= wide:
                line = patch[round(middle)]
                x, y = float(np.flatnonzero(line).mean()) if line.any() else x, middle
            else:
                line = patch[:, round(middle)]
                x, y = middle, float(np.flatnonzero(line).mean()) if line.any() else y
            radius = 0.5 * float(across.max())
        blobs.append(
            SaturatedPatch(
                x_px=x + box[1].start,
                y_px=y + float(line_at[box[0].start]),
                left=box[1].start,
                right=box[1].stop - 1,
                top=int(line_at[box[0].start]),
                bottom=int(line_at[box[0].stop - 1]),
                radius_px=float(radius),
                bleeds=bool(bleeds),
            )
        )
    return blobs


def find_bleeds(sky_free: Image, blobs: list[SaturatedPatch], noise: float, fwhm_px: float) -> list[Bleed]:
    """Follow the charge that ran over from saturated stars, also where it no longer saturates.

    From each star the four ways along its column and row are followed in short blocks. A block belongs to a
    tail when it is far brighter than the same distance along both ways across: halos and the spikes of a
    spider look alike both ways, charge doesn't.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    noise : float
        Noise per pixel.
    """
    found: list[Bleed] = []
    largest = sorted(blobs, key=lambda blob: -(blob.right - blob.left + 1) * (blob.bottom - blob.top + 1))
    for blob in largest[:_MOST_STARS]:
        if blob.bleeds:
            found.append(Bleed(blob.left, blob.right, blob.top, blob.bottom))
        x, y = round(blob.x_px), round(blob.y_px)
        half = int(np.clip(np.ceil(blob.radius_px), 1, 20))
        ways = [_run(sky_free, x, y, half, step, upright) for upright in (True, False) for step in (1, -1)]
        for k, way in enumerate(ways):
            across = ways[2:] if k < 2 else ways[:2]
            tail = _tail(way, across, noise, max(half, round(fwhm_px)))
            if tail is None:
                continue
            first, last, low, high = tail
            near, far = (first, last) if k % 2 == 0 else (-last, -first)
            if k < 2:
                found.append(Bleed(x + low, x + high, y + near, y + far))
            else:
                found.append(Bleed(x + near, x + far, y + low, y + high))
    return found


def _run(sky_free: Image, x: int, y: int, half: int, step: int, upright: bool) -> Array:
    """Medians of blocks on the way from a star to the frame's edge, shape (blocks, 2 half + 5)."""
    picture, a, b = (sky_free, y, x) if upright else (sky_free.T, x, y)
    lines = picture[a::step] if step > 0 else picture[a::-1]
    side = half + 2
    columns = np.clip(np.arange(b - side, b + side + 1), 0, picture.shape[1] - 1)
    blocks = lines.shape[0] // _BLOCK_PX
    strip = lines[: blocks * _BLOCK_PX, columns]
    return np.asarray(np.median(strip.reshape(blocks, _BLOCK_PX, columns.size), axis=1), dtype=np.float64)


def _tail(way: Array, across: list[Array], noise: float, core_px: int) -> tuple[int, int, int, int] | None:
    """First and last distance from the star, first and last offset across, of a tail; None without one."""
    blocks = way.shape[0]
    first = -(-core_px // _BLOCK_PX)
    level = np.full(blocks, np.inf)
    for other in across:
        # the quieter way across is the star's own light; the other one may hold a neighbor
        shared = min(blocks, other.shape[0])
        level[:shared] = np.minimum(level[:shared], other[:shared].max(axis=1))
    level[~np.isfinite(level)] = 0.0
    limit = _TAIL_RATIO * np.maximum(level, 0.0) + _TAIL_SIGMA * 1.25 * noise / np.sqrt(_BLOCK_PX)
    on = way > limit[:, None]
    lit = on.any(axis=1)
    last, gap = first - 1, 0
    for k in range(first, blocks):
        if lit[k]:
            last, gap = k, 0
        else:
            gap += 1
            if gap > _GAP_BLOCKS:
                break
    if last - first + 1 < _LEAST_BLOCKS:
        return None
    columns = np.flatnonzero(on[first : last + 1].mean(axis=0) > 0.3)
    if columns.size == 0 or columns.size > 0.8 * way.shape[1] + 1:
        return None
    side = (way.shape[1] - 1) // 2
    return first * _BLOCK_PX, (last + 1) * _BLOCK_PX, int(columns[0]) - side - 1, int(columns[-1]) - side + 1
