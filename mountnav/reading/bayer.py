"""A raw color mosaic becomes one even brightness here, without moving a star."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

_PATTERN_CARDS = ("BAYERPAT", "BAYRPAT", "CFA_PAT", "CFATYPE", "COLORTYP", "CFAIMAGE", "FILTER")
_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
_BLOCKS = 4
"""The picture is judged in 4 by 4 blocks, each with a vote, so that a nebula or a gradient doesn't decide;
chosen by hand."""
_SMALLEST_BLOCK_PX = 24
"""A block of fewer pairs of rows or columns has no vote: its levels would be known too badly; chosen by
hand."""
_BLOCK_PX = 64
"""Pairs of rows and columns that are looked at in a block; chosen: the error of a level is then about 0.02 of
the noise."""
#: By how much of the noise the phases' levels must differ; their own error is about 0.02 of it.
_SHARE_NAMED = 0.1
_SHARE_UNNAMED = 0.3
"""The same for a frame whose header names no pattern: more is asked for, since most frames are none."""
#: How alike the two green phases must be, as a part of the whole difference.
_GREENS_ALIKE = 0.35
_VOTES = 0.7
"""Share of the blocks that must vote alike; chosen by hand, what it must tell apart is in
tests/reading/test_bayer.py."""
_SAME_DIAGONAL = 0.8
"""Share of the votes that must name the same diagonal as green; likewise."""


def is_mosaic(pixels: NDArray[np.generic], header: Mapping[str, str | int | float | bool]) -> bool:
    """Tell whether a frame is a raw Bayer mosaic.

    A card is believed only if the pixels agree (many programs leave the card in after debayering or binning).
    Without a card the four phases must show the arrangement of a Bayer mosaic in most parts of the frame: two
    of them on a diagonal alike, and the same diagonal everywhere. Frames of floats without a card are
    never taken for one: they are processed already.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        The frame, ADU.
    header : mapping
        Values by keyword. Offsets (``XBAYROFF``, ``YBAYROFF``) are no matter: no phase is treated otherwise.
    """
    named = any(str(header.get(key, "")).strip().upper() in _PATTERNS for key in _PATTERN_CARDS)
    if pixels.dtype.kind == "f" and not named:
        return False
    height, width = pixels.shape
    blocks = min(_BLOCKS, height // (2 * _SMALLEST_BLOCK_PX), width // (2 * _SMALLEST_BLOCK_PX))
    if blocks < (1 if named else 2):
        return False  # one part alone may look like a mosaic by chance
    greens: list[int] = []
    tried = 0
    for band in np.array_split(np.arange(height // 2), blocks):
        for strip in np.array_split(np.arange(width // 2), blocks):
            rows = slice(2 * int(band[0]), 2 * (int(band[0]) + min(band.size, _BLOCK_PX)))
            columns = slice(2 * int(strip[0]), 2 * (int(strip[0]) + min(strip.size, _BLOCK_PX)))
            share = _SHARE_NAMED if named else _SHARE_UNNAMED
            green = _green_diagonal(pixels[rows, columns].astype(np.float32), share)
            tried += 1
            if green is not None:
                greens.append(green)
            elif tried - len(greens) > (1.0 - _VOTES) * blocks * blocks:
                return False  # the parts that are left can't make it a mosaic any more
    commonest = max(greens.count(0), greens.count(1))
    return commonest >= _VOTES * blocks * blocks and commonest >= _SAME_DIAGONAL * len(greens)


def _green_diagonal(block: NDArray[np.float32], share: float) -> int | None:
    """Tell on which diagonal a block's green pixels lie; None where it doesn't look like a mosaic.

    The phases differ by more than a share of the noise, and two on a diagonal are alike: unlike the odd
    rows, columns or slopes of other frames.
    """
    phases = np.stack([block[j::2, i::2].ravel() for j in (0, 1) for i in (0, 1)])
    finite = np.isfinite(phases)
    if not finite.all():
        phases = np.where(finite, phases, np.nan)
        if finite.mean() < 0.5 or not finite.any(axis=1).all():
            return None
    levels, noise = _levels(phases)
    span = float(np.ptp(levels))
    apart = abs(levels[0] - levels[3]), abs(levels[1] - levels[2])
    if span <= share * noise or min(apart) > _GREENS_ALIKE * span:
        return None
    return int(apart[1] < apart[0])


def _levels(phases: NDArray[np.floating]) -> tuple[NDArray[np.float64], float]:
    """Clipped means of the phases (medians of whole numbers jump), and the noise around them."""
    missing = bool(np.isnan(phases).any())
    middle = np.nanmedian(phases, axis=1) if missing else _medians(phases)
    off = np.abs(phases - middle[:, None])
    spread = 1.4826 * float(np.nanmedian(off) if missing else _medians(off.reshape(1, -1))[0])
    # few and whole counts have no spread by the median: the plain one is right there, and large enough
    noise = max(spread, 0.3 if spread > 0.5 else float(np.nanstd(phases)), 0.3)
    inside = off <= 2.5 * noise
    count = np.maximum(inside.sum(axis=1), 1)
    return np.where(inside, phases, 0.0).sum(axis=1, dtype=np.float64) / count, noise


def _medians(rows: NDArray[np.floating]) -> NDArray[np.floating]:
    """Median of each row. np.median asks for several ranks at once, which numpy has no fast way for."""
    half = rows.shape[1] // 2
    parted = np.partition(rows, half, axis=1)
    upper = parted[:, half]
    return upper if rows.shape[1] % 2 else np.asarray(0.5 * (parted[:, :half].max(axis=1) + upper))


def without_mosaic(pixels: NDArray[np.generic]) -> NDArray[np.float32]:
    """Smooth a mosaic with (1 2 1)/4 along both axes.

    Around every pixel this kernel gives each of the four phases the same total weight, a quarter, so that
    neither the sky's color nor a star's leaves a pattern, and being symmetric it moves nothing. A missing
    pixel (NaN) makes its neighbors missing too.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        The frame, ADU.

    Returns
    -------
    ndarray of float32, shape (height, width)
        The smoothed frame.
    """
    from scipy import ndimage  # expensive to import, and few frames are mosaics

    kernel = np.array([0.25, 0.5, 0.25], dtype=np.float32)
    smooth = pixels.astype(np.float32)
    # a line is buffered before it is written back: no second array is needed
    for axis in (0, 1):
        ndimage.correlate1d(smooth, kernel, axis=axis, output=smooth, mode="mirror")
    return smooth
