"""What isn't the sky: bad columns and rows, trails of satellites and planes, bleeding charge [S23 §0.3]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Image
from mountnav.measuring.detection import Smoothed

Array = NDArray[np.float64]

_LINE_SAMPLES = 160
_LINE_OFFSET_SIGMA = 0.8
_STREAK_LEVEL_SIGMA = 4.0
_STREAK_ELONGATION = 6.0
_LEAST_STREAK_PX = 50.0
_BLEED_RATIO = 3.0


@dataclass(frozen=True, slots=True)
class Streak:
    """A long thin thing: center, unit direction, half length and half width, all in pixels of the frame."""

    x_px: float
    y_px: float
    along_x: float
    along_y: float
    half_length_px: float
    half_width_px: float

    def touches(self, x_px: Array, y_px: Array, margin_px: float) -> NDArray[np.bool_]:
        """Tell which places, shape (n,), lie on it or within a margin of it."""
        dx, dy = x_px - self.x_px, y_px - self.y_px
        along = np.abs(dx * self.along_x + dy * self.along_y)
        across = np.abs(dx * self.along_y - dy * self.along_x)
        return np.asarray(
            (along < self.half_length_px + margin_px) & (across < self.half_width_px + margin_px)
        )


@dataclass(frozen=True, slots=True)
class Blob:
    """A connected patch of saturated pixels: its place, extent, and whether charge has run along a line."""

    x_px: float
    y_px: float
    left: int
    right: int
    top: int
    bottom: int
    radius_px: float
    bleeds: bool


def bad_lines(sky_free: Image, noise: float, axis: int) -> NDArray[np.intp]:
    """Return the numbers of columns (axis 0) or rows (axis 1) whose level stands off from their neighbors'.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
    noise : float
        Noise per pixel.
    axis : int
        Along which the medians are taken.

    Returns
    -------
    ndarray of int
    """
    length = sky_free.shape[axis]
    step = max(1, length // _LINE_SAMPLES)
    sample = sky_free[::step] if axis == 0 else sky_free[:, ::step]
    middle = _midmean(sample, axis)
    off = np.abs(middle - ndimage.median_filter(middle, size=9, mode="nearest"))
    # a median of n pixels is sure to 1.25 σ/√n: short lines need a larger offset
    limit = max(_LINE_OFFSET_SIGMA, 8.0 / np.sqrt(length / step)) * noise
    lines = np.flatnonzero(off > limit)
    return lines if lines.size < 0.05 * middle.size else lines[:0]


def _midmean(sample: Image, axis: int) -> Array:
    """Mean of the middle half along an axis: as robust as wanted, and not stuck to whole numbers."""
    quarter = sample.shape[axis] // 4
    parted = np.partition(sample, (quarter, sample.shape[axis] - quarter - 1), axis=axis)
    middle = slice(quarter, sample.shape[axis] - quarter)
    return np.asarray((parted[middle] if axis == 0 else parted[:, middle]).mean(axis=axis), dtype=np.float64)


def heal_lines(sky_free: Image, good: NDArray[np.bool_], lines: NDArray[np.intp], axis: int) -> None:
    """Replace bad lines by the mean of the nearest good ones, in place, and mark their pixels as not good."""
    bad = set(lines.tolist())
    count = sky_free.shape[1 - axis]
    for line in lines.tolist():
        near = [
            next((k for k in way if k not in bad), -1)
            for way in (range(line - 1, -1, -1), range(line + 1, count))
        ]
        near = [k for k in near if k >= 0]
        if axis == 0:
            sky_free[:, line] = sky_free[:, near].mean(axis=1)
            good[:, line] = False
        else:
            sky_free[line] = sky_free[near].mean(axis=0)
            good[line] = False


def find_streaks(smoothed: Smoothed, fwhm_px: float) -> list[Streak]:
    """Find long thin connected patches of the smoothed frame.

    Parameters
    ----------
    smoothed : Smoothed
    fwhm_px : float
        The stars' width; a streak is at least twelve times as long.

    Returns
    -------
    list of Streak
    """
    labels, count = ndimage.label(smoothed.significance > _STREAK_LEVEL_SIGMA, structure=np.ones((3, 3)))
    if count == 0:
        return []
    least_px = max(_LEAST_STREAK_PX, 12.0 * fwhm_px)
    streaks = []
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        size = np.array([box[0].stop - box[0].start, box[1].stop - box[1].start]) * smoothed.bin_px
        if np.hypot(*size) < least_px:
            continue
        rows, columns = np.nonzero(labels[box] == number)
        x, y = columns * float(smoothed.bin_px), rows * float(smoothed.bin_px)
        spread = np.cov(x, y)
        across2, along2 = np.linalg.eigvalsh(spread)
        length, width = np.sqrt(12.0 * along2), np.sqrt(12.0 * max(across2, smoothed.bin_px**2 / 12.0))
        if length < least_px or length < _STREAK_ELONGATION * width:
            continue
        direction = np.linalg.eigh(spread)[1][:, 1]
        shift = (smoothed.bin_px - 1) / 2.0
        streaks.append(
            Streak(
                x_px=float(x.mean()) + box[1].start * smoothed.bin_px + shift,
                y_px=float(y.mean()) + box[0].start * smoothed.bin_px + shift,
                along_x=float(direction[0]),
                along_y=float(direction[1]),
                half_length_px=0.5 * float(length),
                half_width_px=0.5 * float(width),
            )
        )
    return streaks


def find_blobs(saturated: NDArray[np.bool_], fwhm_px: float) -> list[Blob]:
    """Find the connected patches of saturated pixels.

    A patch much longer than wide along one axis bleeds; its star is where it is widest across that axis.

    Parameters
    ----------
    saturated : ndarray of bool, shape (height, width)
    fwhm_px : float

    Returns
    -------
    list of Blob
    """
    labels, count = ndimage.label(saturated, structure=np.ones((3, 3)))
    blobs: list[Blob] = []
    if count == 0:
        return blobs
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
            Blob(
                x_px=x + box[1].start,
                y_px=y + box[0].start,
                left=box[1].start,
                right=box[1].stop - 1,
                top=box[0].start,
                bottom=box[0].stop - 1,
                radius_px=float(radius),
                bleeds=bool(bleeds),
            )
        )
    return blobs
