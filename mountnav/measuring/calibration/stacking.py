"""Stacks of frames: a sigma-clipped mean band by band, and read noise and gain from frame pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from mountnav.measuring.calibration.inspection import PHASES
from mountnav.measuring.calibration.raw_files import FloatImage, RawFile

Array = NDArray[np.float64]

_LEAST_FOR_OWN_SCATTER = 6
"""Frames from which a pixel's own scatter is believed, beside the band's typical one."""
#: Fewer frames don't give a pixel's own scatter.
LEAST_FOR_NOISY = 5


@dataclass(frozen=True, slots=True)
class StackSettings:
    """How frames are stacked.

    Attributes
    ----------
    method : str
        "mean" of what is left after clipping, or "median" of it.
    kappa_sigma : float
        How far from the pixel's median a value may lie, in units of the scatter.
    band_mb : float
        Memory for one band of the whole stack.
    """

    method: str = "mean"
    kappa_sigma: float = 5.0
    band_mb: float = 96.0


@dataclass(frozen=True, slots=True)
class Stacked:
    """What came out besides the pixels.

    Attributes
    ----------
    rejected_share : float
        Share of all values that were clipped.
    scatter_adu : float
        Typical scatter of a pixel from frame to frame; NaN for one frame.
    """

    rejected_share: float
    scatter_adu: float


Prepare = Callable[[int, int, FloatImage], FloatImage]


def bands(height_px: int, width_px: int, frames: int, band_mb: float) -> Iterator[tuple[int, int]]:
    """Give first and last row (not included) of bands that fit the memory, of an even number of rows."""
    # the cube, its sorted copy, and what clipping needs
    bytes_a_row = 4 * width_px * max(frames, 1) * 4
    rows = max(2, int(band_mb * 1e6 / bytes_a_row) // 2 * 2)
    for first in range(0, height_px, rows):
        yield first, min(first + rows, height_px)


def stack(
    files: Sequence[RawFile],
    out: FloatImage,
    *,
    settings: StackSettings,
    prepare: Prepare | None = None,
    scatter: FloatImage | None = None,
) -> Stacked:
    """Stack frames into `out`.

    The result doesn't depend on the order of the files: all sums run over sorted values.

    Parameters
    ----------
    out : ndarray of float32, shape (height, width)
        Written; may be mapped to disk.
    prepare : callable, optional
        Given the file's number, the band's first row and its pixels, gives what is to be stacked.
    scatter : ndarray of float32, shape (height, width), optional
        Written with each pixel's scatter from frame to frame.
    """
    height, width = out.shape
    rejected = 0
    typical: list[float] = []
    for first, stop in bands(height, width, len(files), settings.band_mb):
        cube: FloatImage = np.empty((len(files), stop - first, width), dtype=np.float32)
        for number, file in enumerate(files):
            pixels = file.rows(first, stop)
            cube[number] = pixels if prepare is None else prepare(number, first, pixels)
        result = clipped(cube, settings)
        out[first:stop] = result.pixels
        rejected += result.rejected
        typical.append(result.typical_scatter)
        if scatter is not None:
            scatter[first:stop] = result.scatter
    return Stacked(rejected / (len(files) * height * width), float(np.median(typical)))


@dataclass(frozen=True, slots=True)
class Clipped:
    """A clipped band: its pixels and scatter, shape (rows, width), and how many values fell out."""

    pixels: FloatImage
    scatter: FloatImage
    rejected: int
    typical_scatter: float


def clipped(cube: FloatImage, settings: StackSettings) -> Clipped:
    """Combine a cube along its first axis; the cube is sorted in place.

    A value is dropped when it lies further from the pixel's median than κ times the scatter, which is the
    pixel's own or the band's typical one, whichever is larger: few frames tell little of a pixel's own
    scatter, and a hot pixel scatters more than its neighbors. Of two values that disagree the lower stays,
    since what falls on one of two dark frames adds.

    Parameters
    ----------
    cube : ndarray of float32, shape (frames, rows, width)
        NaN: missing.
    """
    count = cube.shape[0]
    if count == 1:
        nothing = np.full(cube.shape[1:], np.nan, dtype=np.float32)
        return Clipped(cube[0], nothing, 0, float("nan"))
    cube.sort(axis=0)
    missing = bool(np.isnan(cube[-1]).any())
    middle, own = _middle_and_scatter(cube, missing)
    known = own[np.isfinite(own)] if missing else own
    # the median of few differences is low by so much
    typical = float(np.median(known)) / (1.0 - 0.31 / count) if known.size else 0.0
    limit: FloatImage = np.full(middle.shape, settings.kappa_sigma * typical, dtype=np.float32)
    if count >= _LEAST_FOR_OWN_SCATTER:
        np.maximum(limit, settings.kappa_sigma * own, out=limit)
    if count == 2:
        keep = np.ones(cube.shape, dtype=bool)
        keep[1] = ~(cube[1] - cube[0] > np.sqrt(2.0) * limit)
    else:
        keep = np.abs(cube - middle) <= limit
    if missing:
        keep &= np.isfinite(cube)
    kept = keep.sum(axis=0)
    finite = cube.size if not missing else int(np.count_nonzero(np.isfinite(cube)))
    values = np.where(keep, cube, np.float32(0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = values.sum(axis=0, dtype=np.float64) / kept
        values -= np.where(kept > 0, mean, 0.0).astype(np.float32)
        values *= keep
        np.square(values, out=values)
        variance = values.sum(axis=0, dtype=np.float64) / np.maximum(kept - 1, 1)
    pixels = mean
    if settings.method == "median" and count > 2:
        pixels, _ = _middle_and_scatter(np.sort(np.where(keep, cube, np.nan), axis=0), missing=True)
    pixels = np.where(kept > 0, pixels, middle)
    scatter = np.sqrt(variance) if count >= LEAST_FOR_NOISY else np.full(middle.shape, np.nan)
    return Clipped(
        np.asarray(pixels, dtype=np.float32),
        np.asarray(scatter, dtype=np.float32),
        finite - int(kept.sum()),
        typical,
    )


def _middle_and_scatter(cube: FloatImage, missing: bool) -> tuple[FloatImage, FloatImage]:
    """Median of a sorted cube, and the scatter from the distance of its quartiles (of its ends if few)."""
    count = cube.shape[0]
    outer = count // 4
    width = 2.0 * float(ndtri((count - outer - 0.375) / (count + 0.25)))  # expected, by Blom's formula
    if not missing:
        middle = 0.5 * (cube[(count - 1) // 2] + cube[count // 2])
        return middle, (cube[count - 1 - outer] - cube[outer]) / np.float32(width)
    valid = np.isfinite(cube).sum(axis=0)
    last = np.maximum(valid - 1, 0)

    def at(index: NDArray[np.intp]) -> FloatImage:
        return np.asarray(np.take_along_axis(cube, index[None], axis=0)[0])

    middle = 0.5 * (at(last // 2) + at(np.minimum(valid // 2, last)))
    outer_of = valid // 4
    spread = at(last - np.minimum(outer_of, last)) - at(np.minimum(outer_of, last))
    with np.errstate(invalid="ignore", divide="ignore"):
        expected = 2.0 * ndtri((valid - outer_of - 0.375) / (valid + 0.25))
        own = np.where(valid > 1, spread / expected, np.nan)
    return middle, np.asarray(own, dtype=np.float32)


_PAIRS = 4
"""Pairs of frames at most from which noise and gain are taken."""
_BANDS = 8
"""Bands of rows of each that are looked at."""
_BAND_ROWS = 64
"""Rows of each."""
_BLOCK = 16
"""Side of the blocks whose variance is taken, px: large for the statistics, small for gradients."""
_LEAST_BLOCKS = 8
"""Blocks that are needed for a gain."""
_LEAST_EXCESS = 0.05
"""Photon noise over read noise (variances) from which a block gives the gain."""


def read_noise_adu(files: Sequence[RawFile]) -> float | None:
    """Return the noise of one pixel of one frame, from pairs of bias (or dark) frames.

    Returns
    -------
    float or None
        ADU; None for fewer than two frames.
    """
    found = []
    for one, other in _pairs(files):
        variance = [_block_moments(a - b)[1] for a, b in _phase_bands(one, other)]
        found.append(0.5 * float(np.nanmedian(np.concatenate(variance))))
    return float(np.sqrt(np.median(found))) if found else None


def gain_e_adu(files: Sequence[RawFile], zero_adu: float, read_noise: float) -> float | None:
    """Return electrons per ADU from pairs of flats, by the photons' own noise.

    In blocks of one color the second flat is scaled to the first; the variance of the difference less that
    of the read noise is a/g·(1 + a/b) with the block's levels a and b.

    Parameters
    ----------
    files : sequence of RawFile
        Flats of one filter.
    zero_adu : float
        Level of the bias.
    read_noise : float
        ADU.

    Returns
    -------
    float or None
        None for fewer than two flats, or where the photons' noise doesn't stand above the read noise.
    """
    found = []
    for one, other in _pairs(files):
        inverse = []
        for a, b in _phase_bands(one, other):
            level_a, _ = _block_moments(a - zero_adu)
            level_b, _ = _block_moments(b - zero_adu)
            ratio = level_a / level_b
            side = a.shape[0] // _BLOCK * _BLOCK, a.shape[1] // _BLOCK * _BLOCK
            scaled = (b[: side[0], : side[1]] - zero_adu) * _spread(ratio)
            _, variance = _block_moments(a[: side[0], : side[1]] - zero_adu - scaled)
            dark = read_noise**2 * (1.0 + ratio**2)
            usable = (level_a > 0) & (level_b > 0) & (variance - dark > _LEAST_EXCESS * dark)
            inverse.append(((variance - dark) / (level_a * (1.0 + ratio)))[usable])
        all_blocks = np.concatenate(inverse)
        if all_blocks.size >= _LEAST_BLOCKS:
            found.append(float(np.median(all_blocks)))
    return 1.0 / float(np.median(found)) if found else None


def _pairs(files: Sequence[RawFile]) -> list[tuple[RawFile, RawFile]]:
    return list(zip(files[:-1:2], files[1::2], strict=False))[:_PAIRS]


def _phase_bands(one: RawFile, other: RawFile) -> list[tuple[Array, Array]]:
    """Bands of both frames, each color phase of a mosaic apart."""
    height = one.facts.height_px
    rows = min(_BAND_ROWS, height) // 2 * 2
    starts = np.linspace(0, height - rows, min(_BANDS, max(1, height // rows))).astype(int) // 2 * 2
    found = []
    for start in starts:
        a, b = one.rows(int(start), int(start) + rows), other.rows(int(start), int(start) + rows)
        for row, column in PHASES:
            found.append((a[row::2, column::2].astype(float), b[row::2, column::2].astype(float)))
    return found


def _block_moments(image: Array | FloatImage) -> tuple[Array, Array]:
    """Mean and variance in blocks of 16 × 16, flat arrays; odd pixels at the ends are left out."""
    rows, columns = image.shape[0] // _BLOCK, image.shape[1] // _BLOCK
    if rows == 0 or columns == 0:
        return np.array([image.mean()]), np.array([image.var(ddof=1)])
    cut = image[: rows * _BLOCK, : columns * _BLOCK]
    blocks = cut.reshape(rows, _BLOCK, columns, _BLOCK).swapaxes(1, 2).reshape(rows * columns, -1)
    return np.asarray(blocks.mean(axis=1)).reshape(rows, columns), np.asarray(
        blocks.var(axis=1, ddof=1)
    ).reshape(rows, columns)


def _spread(blocks: Array) -> Array:
    return np.repeat(np.repeat(blocks, _BLOCK, axis=0), _BLOCK, axis=1)
