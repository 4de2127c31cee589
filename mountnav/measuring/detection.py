"""Where something stands out of the smoothed frame: peaks in units of the local noise [S23 §0.2]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from mountnav.measuring.background import Background, Image, estimate_background

Array = NDArray[np.float64]

_NEIGHBORS = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]
_SADDLE_STEPS = np.array([0.25, 0.4, 0.5, 0.6, 0.75])
_SADDLE_CONTRAST = 0.08
_MOST_PEAKS = 20_000
_TAME_SIGMA = 3.0
_SURROUND_SIGMAS = 4.0
_SCATTER_BOX_PX = 64
_SCATTER_SAMPLES = 512
_LEAST_SCATTER = 0.3


@dataclass(frozen=True, slots=True)
class Peaks:
    """Local maxima of the smoothed frame, highest first; each array has shape (n,).

    Attributes
    ----------
    x_px, y_px : ndarray
        Places in the full frame, to half a pixel or so.
    height : ndarray
        Height of the smoothed frame in units of its local noise.
    """

    x_px: Array
    y_px: Array
    height: Array


@dataclass(frozen=True, slots=True)
class Smoothed:
    """A smoothed frame in units of its noise.

    Attributes
    ----------
    significance : ndarray of float32, shape (height // bin, width // bin)
    bin_px : int
        Side of a bin in pixels of the frame, 1 or 2.
    noise_ratio : float
        The smoothed frame's noise over that of independent pixels smoothed alike; above 1 where
        neighboring pixels are correlated (debayering, JPEG).
    """

    significance: Image
    bin_px: int
    noise_ratio: float


def smooth(sky_free: Image, background: Background, sigma_px: float, bin_px: int) -> Smoothed:
    """Smooth a background-subtracted frame and divide it by its local noise.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        Without background, missing pixels zero.
    background : Background
    sigma_px : float
        Width of the Gaussian, pixels of the frame.
    bin_px : int
        1, or 2 to search in 2 × 2 bins.

    Returns
    -------
    Smoothed
    """
    height, width = sky_free.shape
    if bin_px == 2:
        even = sky_free[: height - height % 2, : width - width % 2]
        lines = even[0::2] + even[1::2]
        sky_free = (lines[:, 0::2] + lines[:, 1::2]) * np.float32(0.25)
    sigma = sigma_px / bin_px
    noise = np.maximum(background.noise_image(*sky_free.shape), np.float32(1e-20))
    smoothed = ndimage.gaussian_filter(sky_free, sigma, mode="nearest", truncate=2.5)
    # independent pixels smoothed by a Gaussian keep 1 / (2 √π σ) of their noise
    expected = 1.0 / (2.0 * np.sqrt(np.pi) * max(sigma, 0.3)) / bin_px
    # what is wider than a star (nebulae, halos, haze) goes; stars are cut low, so they leave no bowls
    tame = np.minimum(smoothed, np.float32(_TAME_SIGMA * expected) * noise)
    box = 2 * round(_SURROUND_SIGMAS * sigma) + 1
    for _ in range(2):
        tame = ndimage.uniform_filter(tame, box, mode="nearest")
    smoothed -= tame
    smoothed /= noise
    # neighbors are alike now: few samples tell as much
    scatter = estimate_background(
        smoothed, box_px=max(16, _SCATTER_BOX_PX // bin_px), look_for_steps=False, samples=_SCATTER_SAMPLES
    )
    measured = float(np.median(scatter.noise))
    scale = np.maximum(scatter.noise, _LEAST_SCATTER * expected)
    smoothed -= scatter.level_image()
    smoothed /= Background(scatter.level, scale, *smoothed.shape).noise_image(*smoothed.shape)
    return Smoothed(smoothed, bin_px, max(1.0, measured / expected))


def find_peaks(smoothed: Smoothed, threshold_sigma: float, separation_px: float) -> Peaks:
    """Return the local maxima above a threshold, without those that are mere bumps on a brighter one's side.

    Parameters
    ----------
    smoothed : Smoothed
    threshold_sigma : float
    separation_px : float
        Peaks farther apart than this (pixels of the frame) are never merged.

    Returns
    -------
    Peaks
    """
    image = smoothed.significance
    rows, columns = np.divmod(np.flatnonzero(image > threshold_sigma), image.shape[1])
    values = image[rows, columns]
    framed = np.pad(image, 1, constant_values=-np.inf)  # stars on the edge are peaks as well
    keep = np.ones(values.size, dtype=bool)
    for dy, dx in _NEIGHBORS:
        other = framed[rows + 1 + dy, columns + 1 + dx]
        # of equal neighbors (plateaus) the last in reading order stands for all
        keep &= (values > other) if (dy, dx) > (0, 0) else (values >= other)
    rows, columns, values = rows[keep], columns[keep], values[keep]
    order = np.argsort(-values, kind="stable")[:_MOST_PEAKS]
    rows, columns, heights = rows[order], columns[order], values[order].astype(np.float64)
    alone = _not_a_bump(image, rows, columns, heights, separation_px / smoothed.bin_px)
    rows, columns, heights = rows[alone], columns[alone], heights[alone]
    bin_px, shift = float(smoothed.bin_px), (smoothed.bin_px - 1) / 2.0
    x: Array = columns.astype(np.float64) * bin_px + shift
    y: Array = rows.astype(np.float64) * bin_px + shift
    return Peaks(x, y, heights)


def _not_a_bump(
    image: Image, rows: NDArray[np.intp], columns: NDArray[np.intp], heights: Array, reach: float
) -> NDArray[np.bool_]:
    """Tell which peaks are parted by a saddle from every brighter peak within reach."""
    keep = np.ones(heights.size, dtype=bool)
    if heights.size < 2:
        return keep
    pairs = KDTree(np.stack([columns, rows], axis=1)).query_pairs(reach, output_type="ndarray")
    if pairs.size == 0:
        return keep
    bright, faint = pairs.min(axis=1), pairs.max(axis=1)  # peaks come brightest first
    steps = _SADDLE_STEPS[None, :]
    y = rows[bright, None] * (1 - steps) + rows[faint, None] * steps
    x = columns[bright, None] * (1 - steps) + columns[faint, None] * steps
    along = ndimage.map_coordinates(image, [y, x], order=1, mode="nearest")
    saddle = along.min(axis=1)
    bump = heights[faint] - saddle < np.maximum(3.0, _SADDLE_CONTRAST * heights[faint])
    keep[faint[bump]] = False
    return keep
