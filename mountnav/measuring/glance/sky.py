"""Sky level and noise for the glance: medians of tiles of the coarse plane, noise from pixel differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Image

Array = NDArray[np.float64]

_TILE_PX = 64
_LEAST_TILE_BINS = 16
_SAMPLES_ACROSS = 8
_LOWER_SIGMA = 0.158655
_LAG_PX = 4
_SAMPLED_ROWS = 32
_CLIP_SIGMA = 3.0
_NEAR_SIGMA = 2.0
#: What is left of a Gaussian's rms when all beyond two sigma is cut off.
_NEAR_RMS = 0.8796
_RESTLESS = 4.0


@dataclass(frozen=True, slots=True)
class CoarseSky:
    """Level and noise of a coarse plane's bins, each of shape (tiles_y, tiles_x).

    Attributes
    ----------
    level, noise : ndarray
        In the plane's unit: sums over bins.
    tile_bins : int
        Side of a tile; the last of a row or column reaches to the plane's rim.
    """

    level: Array
    noise: Array
    tile_bins: int

    def at(self, values: Array, column: Array, row: Array) -> Array:
        """Bilinear interpolation of a mesh at places, shape (n,), counted in bins."""
        y = np.clip((row + 0.5) / self.tile_bins - 0.5, 0.0, values.shape[0] - 1.0)
        x = np.clip((column + 0.5) / self.tile_bins - 0.5, 0.0, values.shape[1] - 1.0)
        top, left = y.astype(np.intp), x.astype(np.intp)
        below, right = np.minimum(top + 1, values.shape[0] - 1), np.minimum(left + 1, values.shape[1] - 1)
        v, u = y - top, x - left
        upper = values[top, left] * (1.0 - u) + values[top, right] * u
        lower = values[below, left] * (1.0 - u) + values[below, right] * u
        return np.asarray(upper * (1.0 - v) + lower * v)

    def restless(self, column: Array, row: Array) -> NDArray[np.bool_]:
        """Tell which places, shape (n,), are far noisier than the frame's quiet parts: trees, roofs."""
        return np.asarray(self.at(self.noise, column, row) > _RESTLESS * np.percentile(self.noise, 25.0))


def coarse_sky(plane: Image, bin_px: int, *, whole_numbers: bool) -> CoarseSky:
    """Estimate the sky of a coarse plane.

    Parameters
    ----------
    plane : ndarray of float32, shape (rows, columns)
        Without missing values.
    bin_px : int
        Pixels of the frame along a bin's side.
    whole_numbers : bool
        The frame's pixels are; their samples are spread over a step, lest medians be off by half of one.

    Returns
    -------
    CoarseSky
    """
    rows, columns = plane.shape
    tile = max(_LEAST_TILE_BINS, _TILE_PX // bin_px)
    tile = min(tile, rows, columns)
    down, across = rows // tile, columns // tile
    step = max(1, tile // _SAMPLES_ACROSS)
    part = plane[: down * tile, : across * tile].reshape(down, tile, across, tile)
    samples = part[:, step // 2 :: step, :, step // 2 :: step].transpose(0, 2, 1, 3)
    ranked = samples.reshape(down * across, -1)
    if whole_numbers and bin_px == 1:
        ranked = ranked + np.random.default_rng(0).random(ranked.shape, dtype=np.float32) - np.float32(0.5)
    else:
        ranked = ranked.copy()
    ranked.sort(axis=1)
    count = ranked.shape[1]
    level = ranked[:, (count - 1) // 2].astype(np.float64)
    sigma = level - ranked[:, int(_LOWER_SIGMA * (count - 1))]
    # stars pull a median up; what lies beyond three sigma of the lower half leaves
    high = (ranked <= (level + _CLIP_SIGMA * sigma)[:, None]).sum(axis=1)
    middle = np.maximum(high - 1, 0) // 2
    level = ranked[np.arange(level.size), middle].astype(np.float64)
    sigma = level - ranked[np.arange(level.size), (_LOWER_SIGMA * (high - 1)).astype(np.intp)]
    size = (down, across)
    return CoarseSky(_evened(level.reshape(size)), _evened(sigma.reshape(size)), tile)


def _evened(mesh: Array) -> Array:
    """Take single odd tiles out."""
    if min(mesh.shape) < 3:
        return mesh
    return np.asarray(ndimage.median_filter(mesh, size=3, mode="nearest"))


def pixel_noise(pixels: NDArray[np.generic]) -> float:
    """Noise of a single pixel, from the differences of pixels near each other in some rows.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)

    Returns
    -------
    float
        In the frame's unit; never less than the rounding of whole numbers hides.
    """
    rows = pixels[:: max(1, pixels.shape[0] // _SAMPLED_ROWS)].astype(np.float32)
    away = (rows[:, _LAG_PX:] - rows[:, :-_LAG_PX]).ravel()
    away = np.abs(away[np.isfinite(away)])
    if away.size == 0:
        return 0.0
    middle = float(np.partition(away, away.size // 2)[away.size // 2]) / 0.6745
    near = away[away <= _NEAR_SIGMA * max(middle, 0.5)]
    noise = float(np.sqrt(np.mean(near.astype(np.float64) ** 2) / 2.0) / _NEAR_RMS)
    return max(noise, 0.3) if pixels.dtype.kind in "ui" else noise
