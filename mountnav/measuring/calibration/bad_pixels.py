"""Pixels that can't be trusted: found in dark, flat and bias, healed from their neighbors or left out."""

from __future__ import annotations

from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.calibration.inspection import PHASES
from mountnav.measuring.calibration.raw_files import FloatImage

Map = NDArray[np.uint8]

_CELL = 64
"""Side of the cells whose median is a pixel's surroundings, px."""
#: A dark pixel that stands so many frame noises above its surroundings looks like a star.
HOT_SIGMA = 10.0
_HOT_CELL_SIGMA = 8.0
"""A hot pixel also stands so many of its cell's own scatters above it: cells near an amplifier's glow scatter
more."""
_LOW_RESPONSE, _HIGH_RESPONSE = 0.6, 1.5
"""Response over that of its color nearby below and above which a pixel is dead: a flat can't mend what it
hardly sees."""
_NOISY_RATIO = 6.0
"""Scatter from bias to bias over the typical pixel's from which a pixel is noisy."""
_NOISY_COLUMN_RATIO = 2.5
"""The same of a column's median."""
#: Never more than this share of a chip is bad: else the map is wrong, not the chip.
MOST_BAD = 0.05


class BadPixel(IntFlag):
    """Why a pixel is bad."""

    HOT = 1
    DEAD = 2
    NOISY = 4


def mark_hot(bad: Map, dark: FloatImage, least_excess: float) -> None:
    """Mark pixels whose dark signal stands above their surroundings, in place.

    Parameters
    ----------
    bad : ndarray of uint8, shape (height, width)
        Why each pixel is bad; 0: it isn't. Changed in place.
    dark : ndarray of float32, shape (height, width)
        Master dark, ADU.
    least_excess : float
        In the dark's own unit; ten noises of a single frame (`HOT_SIGMA`).
    """
    for rows, columns in _cells(dark.shape):
        cell = np.asarray(dark[rows, columns], dtype=np.float32)
        middle = _median(cell)
        spread = 1.4826 * _median(np.abs(cell - middle))
        hot = ~(cell - middle < max(least_excess, _HOT_CELL_SIGMA * spread))
        bad[rows, columns][hot] |= np.uint8(BadPixel.HOT)


def mark_dead(bad: Map, flat: FloatImage) -> None:
    """Mark pixels that respond much less or more than others of their color nearby, in place.

    Parameters
    ----------
    bad : ndarray of uint8, shape (height, width)
        Why each pixel is bad; 0: it isn't. Changed in place.
    flat : ndarray of float32, shape (height, width)
        Master flat; about 1.
    """
    for rows, columns in _cells(flat.shape):
        cell = np.asarray(flat[rows, columns], dtype=np.float32)
        for row, column in PHASES:
            part = cell[row::2, column::2]
            middle = _median(part)
            off = ~((part > _LOW_RESPONSE * middle) & (part < _HIGH_RESPONSE * middle))
            bad[rows, columns][row::2, column::2][off] |= np.uint8(BadPixel.DEAD)


def mark_noisy(bad: Map, scatter: FloatImage) -> None:
    """Mark pixels and columns that change from bias to bias much more than the typical one, in place.

    Parameters
    ----------
    bad : ndarray of uint8, shape (height, width)
        Why each pixel is bad; 0: it isn't. Changed in place.
    scatter : ndarray of float32, shape (height, width)
        Of each pixel over the frames; NaN where it isn't known: nothing is marked there.
    """
    step = max(1, scatter.shape[0] // 1024)
    sample = np.asarray(scatter[::step], dtype=np.float32)
    if not np.isfinite(sample).any():
        return
    columns = np.array([_median(column) for column in sample.T])
    typical = _median(columns)
    if typical <= 0.0:
        return
    bad[:, columns > _NOISY_COLUMN_RATIO * typical] |= np.uint8(BadPixel.NOISY)
    for rows, _ in _cells((scatter.shape[0], 1)):
        bad[rows][np.asarray(scatter[rows]) > _NOISY_RATIO * typical] |= np.uint8(BadPixel.NOISY)


def heal(pixels: FloatImage, bad: NDArray[np.bool_], step_px: int) -> tuple[int, int]:
    """Fill lone bad pixels and thin lines from their neighbors; the rest becomes NaN (missing), in place.

    A bad pixel with two good neighbors on either side along a row or a column gets the cubic through them
    (-1, 4, 4, -1)/6, with one on either side their mean; the mean of both directions where both have them.

    Parameters
    ----------
    pixels : ndarray of float32, shape (height, width)
        The frame, ADU; changed in place.
    bad : ndarray of bool, shape (height, width)
        Pixels that are to be filled.
    step_px : int
        How far the next pixel of the same color is: 1, or 2 on a Bayer mosaic.

    Returns
    -------
    healed, missing : int
        How many pixels were filled, and how many could not be.
    """
    y, x = np.nonzero(bad)
    if y.size == 0:
        return 0, 0
    height, width = pixels.shape
    total = np.zeros(y.size)
    weight = np.zeros(y.size)
    for down, right in ((0, step_px), (step_px, 0)):
        values, good = [], []
        for distance in (-2, -1, 1, 2):
            j, i = y + distance * down, x + distance * right
            inside = (j >= 0) & (j < height) & (i >= 0) & (i < width)
            j, i = np.clip(j, 0, height - 1), np.clip(i, 0, width - 1)
            value = pixels[j, i].astype(np.float64)
            fine = inside & ~bad[j, i] & np.isfinite(value)
            values.append(np.where(fine, value, 0.0))
            good.append(fine)
        near = good[1] & good[2]
        cubic = near & good[0] & good[3]
        curve = (4.0 * (values[1] + values[2]) - values[0] - values[3]) / 6.0
        filled = np.where(cubic, curve, 0.5 * (values[1] + values[2]))
        # the cubic is worth more where only one direction has it
        share = np.where(cubic, 1.0, np.where(near, 0.25, 0.0))
        total += share * filled
        weight += share
    healed = weight > 0
    pixels[y[healed], x[healed]] = (total[healed] / weight[healed]).astype(np.float32)
    pixels[y[~healed], x[~healed]] = np.nan
    return int(healed.sum()), int((~healed).sum())


def _median(values: NDArray[np.floating]) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _cells(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    height, width = shape
    return [
        (slice(top, min(top + _CELL, height)), slice(left, min(left + _CELL, width)))
        for top in range(0, height, _CELL)
        for left in range(0, width, _CELL)
    ]
