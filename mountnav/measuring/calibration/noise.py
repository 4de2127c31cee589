"""Read noise and gain from pairs of frames: what two frames alike differ by is noise alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.calibration.raw_files import FloatImage, RawFile
from mountnav.measuring.calibration.survey import PHASES

Array = NDArray[np.float64]

_PAIRS = 4
_BANDS = 8
_BAND_ROWS = 64
_BLOCK = 16
_LEAST_BLOCKS = 8
_LEAST_EXCESS = 0.05


def read_noise_adu(files: Sequence[RawFile]) -> float | None:
    """Return the noise of one pixel of one frame, from pairs of bias (or dark) frames.

    Parameters
    ----------
    files : sequence of RawFile

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
