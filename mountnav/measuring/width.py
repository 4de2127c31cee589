"""How wide the stars of a frame are, before any profile is fitted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Image
from mountnav.measuring.detection import Peaks
from mountnav.measuring.star_shape import FWHM_PER_SIGMA

_BRIGHTEST = 200
_HALF_PX = 20
_LEAST_HEIGHT = 8.0
_FALLBACK_FWHM_PX = 2.5
_STAR_AREA_PX = 4
_CLEAR_OF_NOISE = 12.0
_MOST_ASKED = 6000
_FEWEST_WITH_NEIGHBORS = 8
_DARK_NEIGHBORS = 0.05
_SMOOTHING_SIGMA_PX = 1.5
_RINGS = ((6.0, 10.0, 4.5), (15.0, 20.5, np.inf))


def typical_fwhm(sky_free: Image, saturated: NDArray[np.bool_], peaks: Peaks, noise: float) -> float:
    """Estimate the stars' full width at half maximum from the area above half maximum of the bright peaks.

    Hot pixels and cosmic rays cover one to three pixels; if a fair share of the peaks covers more, only those
    are asked, else the stars themselves are that small.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
    saturated : ndarray of bool, shape (height, width)
    peaks : Peaks
    noise : float
        Noise per pixel; where the peaks hardly rise above it, the area is taken from smoothed stamps.

    Returns
    -------
    float
        Pixels.
    """
    height, width = sky_free.shape
    x, y = np.rint(peaks.x_px).astype(int), np.rint(peaks.y_px).astype(int)
    usable = (x >= _HALF_PX) & (x < width - _HALF_PX) & (y >= _HALF_PX) & (y < height - _HALF_PX)
    usable &= peaks.height > _LEAST_HEIGHT
    chosen = np.flatnonzero(usable)[:_MOST_ASKED]
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
    stamps = sky_free[rows, columns]
    middle = slice(_HALF_PX - 1, _HALF_PX + 2)
    clean = ~saturated[rows, columns][:, middle, middle].any(axis=(1, 2))
    stamps = stamps[clean][:_BRIGHTEST]
    if stamps.shape[0] == 0:
        return _FALLBACK_FWHM_PX
    # what the stars stand on (a nebula, a halo) is no part of them; wide ones need their surroundings wide
    fwhm_px = _FALLBACK_FWHM_PX
    for near, far, most in _RINGS:
        radius = np.hypot(offset[:, None], offset[None, :])
        ground = np.median(stamps[:, (radius >= near) & (radius < far)], axis=1)
        fwhm_px = _width(stamps - ground[:, None, None], noise)
        if fwhm_px < most:
            break
    return fwhm_px


def _stand_alone(
    sky_free: Image, x: NDArray[np.intp], y: NDArray[np.intp], noise: float
) -> NDArray[np.bool_]:
    """Tell which peaks are single pixels, shape (n,): no optics leaves a pixel's neighbors dark.

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
    clear = top > _CLEAR_OF_NOISE * noise
    return np.asarray(clear & (neighbors < _DARK_NEIGHBORS * top + noise))


def _width(stamps: Image, noise: float) -> float:
    """Median width of the patches above half maximum in the middle of stamps."""
    middle = slice(_HALF_PX - 1, _HALF_PX + 2)
    wider2 = 0.0
    middle_heights = stamps[:, middle, middle].max(axis=(1, 2))
    if float(np.median(middle_heights)) < _CLEAR_OF_NOISE * noise:
        stamps = ndimage.gaussian_filter(stamps, _SMOOTHING_SIGMA_PX, axes=(1, 2), mode="nearest")
        wider2 = (FWHM_PER_SIGMA * _SMOOTHING_SIGMA_PX) ** 2
    near = stamps[:, _HALF_PX - 2 : _HALF_PX + 3, _HALF_PX - 2 : _HALF_PX + 3].reshape(stamps.shape[0], -1)
    top = near.max(axis=1)
    best = near.argmax(axis=1)
    above = stamps > 0.5 * top[:, None, None]
    flat_neighbors = np.zeros((3, 3, 3), dtype=bool)
    flat_neighbors[1] = ndimage.generate_binary_structure(2, 1)
    labels, _ = ndimage.label(above, structure=flat_neighbors)
    index = np.arange(stamps.shape[0])
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
    return float(np.sqrt(max(1.0, 4.0 * float(np.median(stars)) / np.pi - wider2)))
