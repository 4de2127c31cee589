"""A raw color mosaic becomes one even brightness here, without moving a star."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_PATTERN_CARDS = ("BAYERPAT", "BAYRPAT", "CFA_PAT", "CFATYPE", "COLORTYP")
_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
_BLOCKS = 4
_SMALLEST_BLOCK_PX = 24


def is_mosaic(pixels: NDArray[np.generic], header: dict[str, str | int | float | bool]) -> bool:
    """Tell whether a frame is a raw Bayer mosaic.

    A card is believed only if the pixels agree (many programs leave the card in after debayering or
    binning), and a clear pattern is believed without a card.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
    header : dict

    Returns
    -------
    bool
    """
    named = any(str(header.get(key, "")).strip().upper() in _PATTERNS for key in _PATTERN_CARDS)
    if pixels.dtype.kind == "f" and not named:
        return False
    height, width = pixels.shape
    blocks = min(_BLOCKS, height // (2 * _SMALLEST_BLOCK_PX), width // (2 * _SMALLEST_BLOCK_PX))
    if blocks < 1:
        return False
    votes, orders = 0, []
    for band in np.array_split(np.arange(height // 2), blocks):
        for strip in np.array_split(np.arange(width // 2), blocks):
            rows = slice(2 * int(band[0]), 2 * int(band[0]) + 2 * min(band.size, 64))
            columns = slice(2 * int(strip[0]), 2 * int(strip[0]) + 2 * min(strip.size, 64))
            block = pixels[rows, columns].astype(np.float32)
            phases = np.stack([block[j::2, i::2].ravel() for j in (0, 1) for i in (0, 1)])
            middle = np.median(phases, axis=1)
            spread = float(np.median(np.abs(phases - middle[:, None]))) * 1.4826
            share = 0.25 if named else 0.8
            if np.ptp(middle) > max(share * spread, 2.0 if not named else 0.0):
                votes += 1
                orders.append((int(np.argmax(middle)), int(np.argmin(middle))))
    if votes < 0.7 * blocks * blocks:
        return False
    commonest = max(orders.count(order) for order in set(orders))
    return commonest >= 0.6 * len(orders)


def without_mosaic(pixels: NDArray[np.generic]) -> NDArray[np.float32]:
    """Smooth a mosaic with (1 2 1)/4 along both axes.

    Around every pixel this kernel gives each of the four phases the same total weight, a quarter, so that
    neither the sky's color nor a star's leaves a pattern, and being symmetric it moves nothing.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)

    Returns
    -------
    ndarray of float32, shape (height, width)
    """
    kernel = np.array([0.25, 0.5, 0.25], dtype=np.float32)
    smooth = ndimage.correlate1d(pixels.astype(np.float32), kernel, axis=0, mode="mirror")
    return np.asarray(ndimage.correlate1d(smooth, kernel, axis=1, mode="mirror"), dtype=np.float32)
