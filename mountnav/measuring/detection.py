"""Detection: peaks of the smoothed frame above the local noise, and the stars' typical width [S23 §0.2]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from mountnav.measuring.background import Background, Image, estimate_background
from mountnav.measuring.medians import median
from mountnav.measuring.psf import FWHM_PER_SIGMA

Array = NDArray[np.float64]

_NEIGHBORS = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]
"""Steps (rows, columns) to the eight neighbors of a pixel, in file order."""
_SADDLE_STEPS = np.array([0.25, 0.4, 0.5, 0.6, 0.75])
"""Shares of the way from the brighter to the fainter peak at which the saddle between them is sought."""
_SADDLE_CONTRAST = 0.08
"""A peak has to rise above its saddle by this share of its height (and by 3 σ), or it is a bump on its
neighbor's side. Doubled, nothing changed on the frames that were tried; halved, one more star of a painted
crowd is found."""
_MOST_PEAKS = 20_000
"""Peaks at most, the highest: bounds the time in pictures of leaves. Doubled or halved, nothing changed on
the frames that were tried."""
_CUT_SIGMA = 3.0
"""The smoothed frame is cut at so many of its noises before its surroundings are averaged, so that stars
leave no bowls round them. Doubled, 20 of 732 stars of a painted crowd are lost; halved, 17 more are found,
and the surroundings of wide sources stay."""
SURROUND_SIGMAS = 4.0
"""Half side of that average over the smoothing's σ: what is wider than a star goes, and a part of the star
with it. Doubled, 7 more stars of a painted crowd are found and the noise's large hills with them; halved, 31
more sources in a tetra3 frame of 339."""
_SCATTER_BOX_PX = 64
"""Side of the cells in which the smoothed frame's own scatter is measured, px of the frame. Doubled, 42 of
732 stars of a painted crowd are lost; halved, 13: the stars themselves raise the scatter."""
_SCATTER_SAMPLES = 512
"""Pixels of such a cell that are looked at: neighbors are alike after smoothing, so that few say as much.
Doubled or halved, 7 or 3 of 732 stars of a painted crowd are lost, 18 of a tetra3 frame's 339 sources if
halved."""
_LEAST_SCATTER = 0.3
"""Least scatter of the smoothed frame that is believed, as a share of that of independent pixels: cells cut
off at zero show none. Doubled or halved, no figure changed by 3 %."""


@dataclass(frozen=True, slots=True)
class Peaks:
    """Local maxima of the smoothed frame, highest first; each array has shape (n,).

    Attributes
    ----------
    x_px, y_px : ndarray
        Positions in the full frame, to half a pixel or so.
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
        In sigmas of the noise.
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
    sigma_px : float
        Width of the Gaussian, pixels of the frame.
    bin_px : int
        1, or 2 to search in 2 × 2 bins.
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
    tame = np.minimum(smoothed, np.float32(_CUT_SIGMA * expected) * noise)
    box = 2 * round(SURROUND_SIGMAS * sigma) + 1
    for _ in range(2):
        tame = ndimage.uniform_filter(tame, box, mode="nearest")
    smoothed -= tame
    smoothed /= noise
    # neighbors are alike now: few samples say as much
    scatter = estimate_background(
        smoothed, box_px=max(16, _SCATTER_BOX_PX // bin_px), look_for_steps=False, samples=_SCATTER_SAMPLES
    )
    measured = median(scatter.noise)
    scale = np.maximum(scatter.noise, _LEAST_SCATTER * expected)
    smoothed -= scatter.level_image()
    smoothed /= Background(scatter.level, scale, *smoothed.shape).noise_image(*smoothed.shape)
    return Smoothed(smoothed, bin_px, max(1.0, measured / expected))


def find_peaks(smoothed: Smoothed, threshold_sigma: float, separation_px: float) -> Peaks:
    """Return the local maxima above a threshold, without those that are mere bumps on a brighter one's side.

    Parameters
    ----------
    separation_px : float
        Peaks farther apart than this (pixels of the frame) are never merged.
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
    """Which peaks are parted by a saddle from every brighter peak within reach."""
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


_BRIGHTEST = 200
"""Brightest peaks whose median area gives the typical width. Doubled or halved, four sources of a crowd or of
a tetra3 frame go."""
_HALF_PX = 20
"""Half side of the squares in which that area is measured, px; wider stars run out of them. Halved, stars of
FWHM 8 px are taken for narrow ones and half of them are lost; doubled, narrow ones are measured 8 % worse."""
_LEAST_HEIGHT = 8.0
"""Least height of such a peak, in units of the smoothed frame's noise. Halved, 22 of a tetra3 frame's 339
sources go; doubled, 4."""
_FALLBACK_FWHM_PX = 2.5
"""FWHM assumed where no peak can be measured, px."""
_STAR_AREA_PX = 4
"""Pixels above half maximum from which a peak is no hot pixel and no ray."""
_CLEAR_OF_NOISE = 12.0
"""Median height of the peaks over the noise per pixel below which the area is measured on smoothed
cutouts."""
_MOST_CHECKED = 6000
"""Peaks at most that are checked for being single pixels: bounds the time where hot pixels abound."""
_FEWEST_WITH_NEIGHBORS = 8
"""So many peaks with lit neighbors give the width alone; with fewer the single pixels may be the stars."""
DARK_NEIGHBORS = 0.05
"""A single pixel's eight neighbors have less than this share of its light on the mean: a star of FWHM 1.2 px
gives them 15 %. Doubled, 9 hot pixels more are flagged in a tetra3 frame; halved, one less."""
SINGLE_PIXEL_SIGMA = 12.0
"""Height over the noise from which a pixel is recognized as standing alone. Halved, 23 more of a tetra3
frame's 226 fast candidates are flagged; doubled, a frame full of hot pixels is no longer left to the full
measurement."""
_SMOOTHING_SIGMA_PX = 1.5
"""Width σ of that smoothing, px; its share of the area is taken off again."""
_RINGS = ((6.0, 10.0, 4.5), (15.0, 20.5, np.inf))
"""Inner and outer radius of the ring whose median is the ground under a peak, px, and up to which FWHM its
width is believed: wide stars need a wide ring."""


def typical_fwhm(sky_free: Image, saturated: NDArray[np.bool_], peaks: Peaks, noise: float) -> float:
    """Estimate the stars' full width at half maximum from the area above half maximum of the bright peaks.

    Hot pixels and cosmic rays cover one to three pixels; if a fair share of the peaks covers more, only those
    are asked, else the stars themselves are that small.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    saturated : ndarray of bool, shape (height, width)
        Pixels at or above the saturation level.
    noise : float
        Noise per pixel; where the peaks hardly rise above it, the area is taken from smoothed cutouts.

    Returns
    -------
    float
        Pixels.
    """
    height, width = sky_free.shape
    x, y = np.rint(peaks.x_px).astype(int), np.rint(peaks.y_px).astype(int)
    usable = (x >= _HALF_PX) & (x < width - _HALF_PX) & (y >= _HALF_PX) & (y < height - _HALF_PX)
    usable &= peaks.height > _LEAST_HEIGHT
    chosen = np.flatnonzero(usable)[:_MOST_CHECKED]
    alone = _stand_alone(sky_free, x[chosen], y[chosen], noise)
    if np.count_nonzero(~alone) >= _FEWEST_WITH_NEIGHBORS:
        chosen = chosen[~alone]
    chosen = chosen[: 2 * _BRIGHTEST]
    if chosen.size == 0:
        return _FALLBACK_FWHM_PX
    offset = np.arange(-_HALF_PX, _HALF_PX + 1)
    rows, columns = (
        y[chosen, None, None] + offset[None, :, None],
        x[chosen, None, None] + offset[None, None, :],
    )
    cutouts = sky_free[rows, columns]
    middle = slice(_HALF_PX - 1, _HALF_PX + 2)
    clean = ~saturated[rows, columns][:, middle, middle].any(axis=(1, 2))
    cutouts = cutouts[clean][:_BRIGHTEST]
    if cutouts.shape[0] == 0:
        return _FALLBACK_FWHM_PX
    # what the stars stand on (a nebula, a halo) is no part of them; wide ones need their surroundings wide
    fwhm_px = _FALLBACK_FWHM_PX
    for near, far, most in _RINGS:
        radius = np.hypot(offset[:, None], offset[None, :])
        ground = np.median(cutouts[:, (radius >= near) & (radius < far)], axis=1)
        fwhm_px = _width(cutouts - ground[:, None, None], noise)
        if fwhm_px < most:
            break
    return fwhm_px


def _stand_alone(
    sky_free: Image, x: NDArray[np.intp], y: NDArray[np.intp], noise: float
) -> NDArray[np.bool_]:
    """Which peaks are single pixels, shape (n,): no optics leaves a pixel's neighbors dark.

    Even a star of FWHM 1.2 px gives its eight neighbors 15 % of its own pixel's light on the mean.
    """
    offset = np.arange(-2, 3)
    near = sky_free[y[:, None, None] + offset[None, :, None], x[:, None, None] + offset[None, None, :]]
    index, best = np.arange(x.size), near[:, 1:4, 1:4].reshape(x.size, 9).argmax(axis=1)
    row, column = 1 + best // 3, 1 + best % 3  # the smoothed peak may be a pixel off
    top = near[index, row, column]
    around = np.zeros(x.size)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            around += near[index, row + dy, column + dx]
    neighbors = (around - top) / 8.0
    clear = top > SINGLE_PIXEL_SIGMA * noise
    return np.asarray(clear & (neighbors < DARK_NEIGHBORS * top + noise))


def _width(cutouts: Image, noise: float) -> float:
    """Median width of the patches above half maximum in the middle of cutouts."""
    middle = slice(_HALF_PX - 1, _HALF_PX + 2)
    wider2 = 0.0
    middle_heights = cutouts[:, middle, middle].max(axis=(1, 2))
    if median(middle_heights) < _CLEAR_OF_NOISE * noise:
        cutouts = ndimage.gaussian_filter(cutouts, _SMOOTHING_SIGMA_PX, axes=(1, 2), mode="nearest")
        wider2 = (FWHM_PER_SIGMA * _SMOOTHING_SIGMA_PX) ** 2
    near = cutouts[:, _HALF_PX - 2 : _HALF_PX + 3, _HALF_PX - 2 : _HALF_PX + 3].reshape(cutouts.shape[0], -1)
    top = near.max(axis=1)
    best = near.argmax(axis=1)
    above = cutouts > 0.5 * top[:, None, None]
    flat_neighbors = np.zeros((3, 3, 3), dtype=bool)
    flat_neighbors[1] = ndimage.generate_binary_structure(2, 1)
    labels, _ = ndimage.label(above, structure=flat_neighbors)
    index = np.arange(cutouts.shape[0])
    own = labels[index, _HALF_PX - 2 + best // 5, _HALF_PX - 2 + best % 5]
    patch = labels == own[:, None, None]
    area = patch.sum(axis=(1, 2))
    inside = ~(
        patch[:, 0].any(axis=1)
        | patch[:, -1].any(axis=1)
        | patch[:, :, 0].any(axis=1)
        | patch[:, :, -1].any(axis=1)
    )
    area = area[inside]
    if area.size == 0:
        return _FALLBACK_FWHM_PX
    stars = area[area >= _STAR_AREA_PX]
    if stars.size < max(3.0, 0.25 * area.size):
        stars = area[area >= 2] if (area >= 2).sum() >= max(3.0, 0.25 * area.size) else area
    return float(np.sqrt(max(1.0, 4.0 * median(stars) / np.pi - wider2)))


def first_of_twins(x_px: Array, y_px: Array, reach_px: float) -> NDArray[np.bool_]:
    """Which of several sources at the same position comes first, shape (n,)."""
    keep = np.ones(x_px.size, dtype=bool)
    if x_px.size > 1:
        pairs = KDTree(np.column_stack([x_px, y_px])).query_pairs(reach_px, output_type="ndarray")
        keep[pairs.max(axis=1)] = False
    return keep
