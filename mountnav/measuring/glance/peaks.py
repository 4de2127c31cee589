"""Where the coarse plane stands out: local maxima among the few bins above the sky, brightest first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.background import Image
from mountnav.measuring.glance.sky import CoarseSky

Array = NDArray[np.float64]

_MOST_BINS = 8_000
_FEWEST_ON_LINE = 12


@dataclass(frozen=True, slots=True)
class CoarsePeaks:
    """Maxima of the coarse plane, brightest first, each array of shape (n,).

    Attributes
    ----------
    x_px, y_px : ndarray
        Centroid of the 3 × 3 bins, pixels of the frame.
    flux : ndarray
        Their light above the sky.
    column, row : ndarray of int
        Of the highest bin.
    """

    x_px: Array
    y_px: Array
    flux: Array
    column: NDArray[np.intp]
    row: NDArray[np.intp]


def coarse_peaks(plane: Image, sky: CoarseSky, bin_px: int, threshold_sigma: float, most: int) -> CoarsePeaks:
    """Find the brightest maxima.

    Parameters
    ----------
    plane : ndarray of float32, shape (rows, columns)
    sky : CoarseSky
    bin_px : int
    threshold_sigma : float
        Height of a bin above the sky, in units of its noise.
    most : int

    Returns
    -------
    CoarsePeaks
        At most ``most``; none in the outermost bins.
    """
    rows, columns = plane.shape
    flat = _above(plane, sky, threshold_sigma)
    row, column = np.divmod(flat, columns)
    inside = (row > 0) & (column > 0) & (row < rows - 1) & (column < columns - 1)
    flat, row, column = flat[inside], row[inside], column[inside]
    values = plane.ravel()
    here = values[flat]
    if flat.size > _MOST_BINS:  # a crowded frame: its brightest are among its highest bins
        some = np.sort(np.argpartition(here, flat.size - _MOST_BINS)[flat.size - _MOST_BINS :])
        flat, row, column, here = flat[some], row[some], column[some], here[some]
    highest = np.ones(flat.size, dtype=bool)
    for step in (1, columns - 1, columns, columns + 1):
        # of equal neighbors the first in file order counts
        highest &= (here > values[flat - step]) & (here >= values[flat + step])
    highest &= ~(_crowded(column, highest) | _crowded(row, highest))
    flat, row, column = flat[highest], row[highest], column[highest]
    steps = np.array([dy * columns + dx for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
    level = sky.at(sky.level, column.astype(np.float64), row.astype(np.float64))
    light = values[flat[:, None] + steps].astype(np.float64) - level[:, None]
    flux = light.sum(axis=1)
    order = np.argsort(-flux, kind="stable")[:most]
    light, flux, row, column = np.maximum(light[order], 0.0), flux[order], row[order], column[order]
    total = np.maximum(light.sum(axis=1), 1e-12)
    three = light.reshape(-1, 3, 3)
    dx = (three[:, :, 2] - three[:, :, 0]).sum(axis=1) / total
    dy = (three[:, 2] - three[:, 0]).sum(axis=1) / total
    middle = 0.5 * (bin_px - 1)
    return CoarsePeaks((column + dx) * bin_px + middle, (row + dy) * bin_px + middle, flux, column, row)


def _crowded(line: NDArray[np.intp], peak: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell what lies on lines with far more peaks than others: bad columns and rows, shape (n,)."""
    if not peak.any():
        return np.zeros_like(peak)
    count = np.bincount(line[peak], minlength=int(line.max()) + 1)
    usual = float(np.mean(np.minimum(count, np.percentile(count, 90.0))))
    return np.asarray((count > _FEWEST_ON_LINE + 3.0 * usual + 6.0 * np.sqrt(usual))[line])


def _above(plane: Image, sky: CoarseSky, threshold_sigma: float) -> NDArray[np.intp]:
    """Bins above the threshold, as indices into the flattened plane."""
    rows, columns = plane.shape
    limit = (sky.level + threshold_sigma * sky.noise).astype(np.float32)
    tile, (down, across) = sky.tile_bins, limit.shape
    lines = np.repeat(limit, tile, axis=1)
    lines = np.concatenate([lines, np.repeat(lines[:, -1:], columns - across * tile, axis=1)], axis=1)
    found = []
    for i in range(down):
        first, last = i * tile, rows if i == down - 1 else (i + 1) * tile
        found.append(np.flatnonzero(plane[first:last] > lines[i]) + first * columns)
    return np.concatenate(found)
