"""The binned (coarse) plane of a frame: its sums, its sky level and noise, and its peaks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.background import Image
from mountnav.measuring.measurements import RESTLESS

_STRIP_LINES = 32
"""Lines of bins that are summed together, so that they stay in the processor's cache. It changes nothing but
time."""
_LOW_HALF = np.uint32(0xFFFF)
"""Mask of the lower of two 16-bit pixels in a 32-bit word; and one less than what the upper one counts."""
_HALF_BITS = np.uint32(16)
"""Bits of a pixel in such a word."""
#: What 1 2 1 both ways leaves of independent noise.
SMOOTHED_NOISE = 6.0 / 16.0
_LOW_LONG = np.uint64(0xFFFFFFFF)
"""Mask of the lower of two 32-bit sums in a 64-bit word."""


def coarse_plane(pixels: NDArray[np.generic], bin_px: int) -> Image:
    """Sum a frame in bins; what is left over at the right and upper rim is passed over.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        Of any real type.
    bin_px : int
        1, 2 or 4.

    Returns
    -------
    ndarray of float32, shape (height // bin_px, width // bin_px)
        A bin with a missing pixel is NaN.
    """
    height, width = pixels.shape
    rows, columns = height // bin_px, width // bin_px
    plane = np.empty((rows, columns), dtype=np.float32)
    if bin_px == 1:
        plane[...] = pixels
        return plane
    pairs = pixels.dtype.kind == "u" and pixels.dtype.itemsize == 2
    for first in range(0, rows, _STRIP_LINES):
        count = min(_STRIP_LINES, rows - first)
        strip = pixels[first * bin_px : (first + count) * bin_px, : columns * bin_px]
        lines = np.ascontiguousarray(strip).reshape(count, bin_px, columns * bin_px)
        _sum_strip(lines, plane[first : first + count], bin_px, pairs=pairs)
    return plane


def in_wider_bins(plane: Image, bin_px: int, wider_px: int) -> Image:
    """Sum a plane of small bins in wider ones: of a frame of whole numbers the same as `coarse_plane` makes.

    Parameters
    ----------
    plane : ndarray of float32, shape (rows, columns)
        Sums of bins of pixels.
    bin_px, wider_px : int
        Pixels along a bin's side now, and then.

    Returns
    -------
    ndarray of float32
        The plane itself where the bins are so wide already.
    """
    if wider_px == bin_px:
        return plane
    return coarse_plane(plane, wider_px // bin_px)


def _sum_strip(lines: NDArray[np.generic], out: Image, bin_px: int, *, pairs: bool) -> None:
    """Sum lines of shape (count, bin_px, columns · bin_px) over their bins."""
    if not pairs:
        total = lines[:, 0].astype(np.float32)
        for j in range(1, bin_px):
            total += lines[:, j].astype(np.float32)
        while total.shape[1] > out.shape[1]:
            total = total[:, 0::2] + total[:, 1::2]
        out[...] = total
        return
    # two pixels of 16 bits lie in one word of 32: both halves are summed without unpacking them
    words = lines.astype(np.uint16, copy=False).view(np.uint32)
    high = words >> _HALF_BITS
    sums, highs = words[:, 0] + words[:, 1], high[:, 0] + high[:, 1]
    for j in range(2, bin_px):
        sums += words[:, j]
        highs += high[:, j]
    # the upper half counts 2^16 times in the words' sum, and once in the bin's; overflow is the same in both
    highs *= _LOW_HALF
    sums -= highs
    if bin_px == 2:
        out[...] = sums
        return
    wide = sums.view(np.uint64)
    # little end first or last, a sum of both halves is the same
    out[...] = (wide & _LOW_LONG) + (wide >> np.uint64(32))


def smooth_lightly(plane: Image) -> None:
    """Smooth a plane in place by 1 2 1 both ways, for the search in single pixels; the rim stays."""
    # 1 2 1 is 1 1 twice
    lines = plane[:-1] + plane[1:]
    lines = lines[:-1] + lines[1:]
    smooth = lines[:, :-1] + lines[:, 1:]
    smooth = smooth[:, :-1] + smooth[:, 1:]
    smooth *= np.float32(1.0 / 16.0)
    plane[1:-1, 1:-1] = smooth


Array = NDArray[np.float64]

_TILE_PX = 64
"""Side of a tile whose median is the sky's level, px of the frame. Doubled, three false sources come in a
painted field of 140; halved, stars fill the tiles and 3 of 128 are lost."""
_LEAST_TILE_BINS = 16
"""And at least so many bins. Doubled or halved, nothing changed on the frames that were tried: it counts with
bins of 4 px and smaller tiles only."""
_SAMPLES_ACROSS = 8
"""Bins along a tile's side that are looked at: 64 a tile. Halved, the level of a tile is less sure and 47
false sources come in a painted field; doubled, no more are found than the threshold promises, at four times
the cost."""
_LOWER_SIGMA = 0.158655
"""Share of a Gaussian below minus one sigma."""
_LAG_PX = 4
"""Distance of the pixels whose differences give the noise, px: nearer ones are correlated by debayering and
compression. Doubled or halved, single sources change."""
_SAMPLED_ROWS = 32
"""Rows whose differences are taken: more cost time only."""
_CLIP_SIGMA = 3.0
"""Bins beyond so many sigmas of the lower half leave before the level is taken. Halved, the level falls and
one false source in 159 comes; doubled, 2 of 128 stars are lost."""
_CUT_SIGMA = 2.0
"""Differences beyond so many sigmas leave before the noise is taken: stars. Halved, a third of the forced
fits is flagged as too poor; doubled, 12 of 126 are not found."""
#: What is left of a Gaussian's rms when all beyond two sigma is cut off.
_CUT_RMS = 0.8796


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
        """Bilinear interpolation of a mesh at positions, shape (n,), counted in bins."""
        y = np.clip((row + 0.5) / self.tile_bins - 0.5, 0.0, values.shape[0] - 1.0)
        x = np.clip((column + 0.5) / self.tile_bins - 0.5, 0.0, values.shape[1] - 1.0)
        top, left = y.astype(np.intp), x.astype(np.intp)
        below, right = np.minimum(top + 1, values.shape[0] - 1), np.minimum(left + 1, values.shape[1] - 1)
        v, u = y - top, x - left
        upper = values[top, left] * (1.0 - u) + values[top, right] * u
        lower = values[below, left] * (1.0 - u) + values[below, right] * u
        return np.asarray(upper * (1.0 - v) + lower * v)

    def restless(self, column: Array, row: Array) -> NDArray[np.bool_]:
        """Which positions, shape (n,), are far noisier than the frame's quiet parts: trees, roofs."""
        return np.asarray(self.at(self.noise, column, row) > RESTLESS * np.percentile(self.noise, 25.0))


class Summed(NamedTuple):
    """A frame summed in bins, by whoever needed that first.

    Attributes
    ----------
    plane : ndarray of float32, shape (rows, columns)
        Of whole numbers.
    bin_px : int
        Side of a bin.
    sky : CoarseSky or None
        What `coarse_sky` says of the plane.
    """

    plane: Image
    bin_px: int
    sky: CoarseSky | None = None


def coarse_sky(plane: Image, bin_px: int, *, whole_numbers: bool) -> CoarseSky:
    """Estimate the sky of a coarse plane.

    Parameters
    ----------
    plane : ndarray of float32, shape (rows, columns)
        Without missing values.
    bin_px : int
        Pixels of the frame along a bin's side.
    whole_numbers : bool
        The frame's pixels are; their samples are spread over a step, so that medians aren't off by half of
        one.
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
    height, width = mesh.shape
    wide = np.pad(mesh, 1, mode="edge")
    return median_of_nine([wide[j : j + height, i : i + width] for j in range(3) for i in range(3)])


_NINE = (
    *((1, 2), (4, 5), (7, 8), (0, 1), (3, 4), (6, 7), (1, 2), (4, 5), (7, 8), (0, 3)),
    *((5, 8), (4, 7), (3, 6), (1, 4), (2, 5), (4, 7), (4, 2), (6, 4), (4, 2)),
)
"""Which two of nine numbers are put in order, one after the other, until the fifth is the median
[Smith 1996, doi:10.1016/0923-5965(95)00049-6; the exchanges of Devillard's opt_med9]."""


def median_of_nine(values: list[Array]) -> Array:
    """Median of nine arrays of one shape, place by place: a fifth of the time of a filter for any rank."""
    nine = list(values)
    for low, high in _NINE:
        nine[low], nine[high] = np.minimum(nine[low], nine[high]), np.maximum(nine[low], nine[high])
    return np.asarray(nine[4])


def pixel_noise(pixels: NDArray[np.generic]) -> float:
    """Noise of a single pixel, from the differences of pixels near each other in some rows.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        The frame, ADU.

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
    near = away[away <= _CUT_SIGMA * max(middle, 0.5)]
    noise = float(np.sqrt(np.mean(near.astype(np.float64) ** 2) / 2.0) / _CUT_RMS)
    return max(noise, 0.3) if pixels.dtype.kind in "ui" else noise


_MOST_BINS = 8_000
"""Bins above the threshold at most in which maxima are sought, the highest: bounds the time. Halved, an
amplifier's glow leaves room for half of the stars (10 of 22)."""
_FEWEST_ON_LINE = 12
"""Peaks on a column or row below which it is not bad, however few the others have. Halved, 13 of 122 sources
of a real frame go; doubled, nothing changed on the frames that were tried."""


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
        Sums of bins of pixels.
    threshold_sigma : float
        Height of a bin above the sky, in units of its noise.

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
    """What lies on lines with far more peaks than others: bad columns and rows, shape (n,)."""
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
