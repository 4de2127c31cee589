"""Straight steps in the sky level: amplifiers of unlike bias, overscan strips [S23 §0.1]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_SAMPLES = 128
_REACH_PX = 8
_SHARP = 0.55
_LEAST_SIGMA = 0.3
_ODDS_SIGMA = 8.0
_MOST_STEPS = 6
_PIECES = 5


@dataclass(frozen=True, slots=True)
class Steps:
    """A frame cut by straight lines in blocks, each with a level of its own.

    Attributes
    ----------
    rows, columns : ndarray of int
        Where a new block starts, without 0 and without the frame's end.
    offset : ndarray, shape (len(rows) + 1, len(columns) + 1)
        Level of each block against the largest one, in the frame's unit.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    offset: Array

    def add_to(self, image: Image, sign: float) -> None:
        """Add the blocks' levels, times a sign, to an image of shape (height, width), in place."""
        row_edges = [0, *self.rows.tolist(), image.shape[0]]
        column_edges = [0, *self.columns.tolist(), image.shape[1]]
        for j in range(len(row_edges) - 1):
            for i in range(len(column_edges) - 1):
                block = image[row_edges[j] : row_edges[j + 1], column_edges[i] : column_edges[i + 1]]
                block += np.float32(sign * self.offset[j, i])


def find_steps(image: Image) -> Steps | None:
    """Find the straight lines along columns and rows at which the sky level jumps.

    Parameters
    ----------
    image : ndarray of float32, shape (height, width)
        NaN marks missing pixels.

    Returns
    -------
    Steps or None
        None where nothing jumps, which is the rule.
    """
    if min(image.shape) < 16 * _REACH_PX:
        return None
    columns, rows = _places(image), _places(image.T)
    if columns.size + rows.size == 0:
        return None
    return Steps(rows, columns, _offsets(image, rows, columns))


def _places(image: Image) -> NDArray[np.intp]:
    """Numbers of the columns at which a new level starts, in the upper half, the lower half or both."""
    height = image.shape[0]
    step = max(1, height // (2 * _SAMPLES))
    halves = (image[: height // 2 : step], image[height // 2 :: step])
    strengths = [np.abs(jump) / limit for jump, limit in map(_jumps, halves)]
    both = np.maximum(*strengths)
    places = []
    for _ in range(_MOST_STEPS + 1):
        best = int(both.argmax())
        if both[best] < 1.0:
            break
        if any(s[best] >= 1.0 and _all_along(h, best) for s, h in zip(strengths, halves, strict=True)):
            places.append(best)
        both[max(0, best - _REACH_PX) : best + _REACH_PX + 1] = 0.0
    # so many lines are no amplifiers but a structured picture
    return np.sort(np.array(places if len(places) <= _MOST_STEPS else [], dtype=np.intp))


def _all_along(part: Image, place: int) -> bool:
    """Tell whether a jump keeps its height along the line, as an amplifier's does and a roof's doesn't."""
    pieces = np.array_split(part, _PIECES)
    jumps = np.array([_jump(piece[:, :place], piece[:, place:]) for piece in pieces])
    typical = float(np.median(jumps))
    return bool(
        (jumps * np.sign(typical) > 0.4 * abs(typical)).all() and (np.abs(jumps) < 2.0 * abs(typical)).all()
    )


def _jumps(part: Image) -> tuple[Array, float]:
    """How far the level jumps sharply at the start of each column, else zero; and what is significant."""
    ranked = np.sort(part, axis=0)  # NaN go to the end
    count = np.isfinite(ranked).sum(axis=0)
    known = np.flatnonzero(count >= part.shape[0] // 2)
    if known.size < 4 * _REACH_PX:
        return np.zeros(part.shape[1]), 1.0
    low, high = count // 4, count - count // 4
    index = np.arange(part.shape[0])[:, None]
    middle = np.where((index >= low) & (index < high), ranked, np.float32(0.0))
    profile = middle.sum(axis=0, dtype=np.float64) / np.maximum(high - low, 1)
    lower = np.take_along_axis(ranked, (0.158655 * count).astype(int)[None, :], axis=0)[0]
    sigma = float(np.median((profile - lower)[known]))
    if sigma <= 0:
        return np.zeros(part.shape[1]), 1.0
    # columns without values continue their neighbors, so that their edges are no steps
    profile = np.interp(np.arange(part.shape[1]), known, profile[known])
    # medians, so that a bad column or a trail along one isn't a step
    calm = ndimage.median_filter(profile, size=_REACH_PX, mode="nearest")
    jump, near = np.zeros(profile.size), np.zeros(profile.size)
    half, reach = _REACH_PX // 2, _REACH_PX
    k = np.arange(2 * reach, profile.size - 2 * reach)
    after, before = calm[k + half], calm[k - half]
    # median_filter of even size n at i covers i - n/2 ... i + n/2 - 1
    slope = 0.5 * ((calm[k + half + reach] - after) + (before - calm[k - half - reach]))
    jump[k] = after - before - slope
    near[k] = 0.5 * (profile[k] + profile[k + 1] - profile[k - 1] - profile[k - 2])
    sharp = (near * np.sign(jump) > _SHARP * np.abs(jump)) & (
        (profile - np.roll(profile, 1)) * np.sign(jump) > 0.35 * np.abs(jump)
    )
    scatter = 1.4826 * float(np.median(np.abs(jump[k]))) if k.size else 0.0
    limit = max(
        _LEAST_SIGMA * sigma, _ODDS_SIGMA * scatter, _ODDS_SIGMA * sigma / np.sqrt(part.shape[0] * 6.0)
    )
    return np.where(sharp, jump, 0.0), limit


def _offsets(image: Image, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Array:
    """Levels that take the jumps between all neighboring blocks away, by least squares."""
    row_edges = np.r_[0, rows, image.shape[0]]
    column_edges = np.r_[0, columns, image.shape[1]]
    shape = (row_edges.size - 1, column_edges.size - 1)
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    equations, jumps = [], []
    for j in range(shape[0]):
        for i in range(shape[1]):
            band = image[row_edges[j] : row_edges[j + 1], column_edges[i] : column_edges[i + 1]]
            for axis in (0, 1):
                if (j, i)[axis] == 0:
                    continue
                other = (j - 1, i) if axis == 0 else (j, i - 1)
                before = image[
                    row_edges[other[0]] : row_edges[other[0] + 1],
                    column_edges[other[1]] : column_edges[other[1] + 1],
                ]
                jump = _jump(before, band) if axis == 1 else _jump(before.T, band.T)
                row = np.zeros(number.size)
                row[number[j, i]], row[number[other]] = 1.0, -1.0
                equations.append(row)
                jumps.append(jump)
    solved = np.linalg.lstsq(np.array(equations), np.array(jumps), rcond=None)[0].reshape(shape)
    area = np.diff(row_edges)[:, None] * np.diff(column_edges)[None, :]
    return np.asarray(solved - solved.flat[int(area.argmax())])


def _jump(left: Image, right: Image) -> float:
    """Level of the right block's first columns less that of the left one's last, slopes taken off."""
    reach = min(_REACH_PX, left.shape[1] // 2, right.shape[1] // 2)
    step = max(1, left.shape[0] // (2 * _SAMPLES))
    if reach < 1:
        return 0.0
    levels = [
        _middle(part[::step])
        for part in (
            left[:, -2 * reach : -reach],
            left[:, -reach:],
            right[:, :reach],
            right[:, reach : 2 * reach],
        )
    ]
    if not np.isfinite(levels).all():
        return 0.0
    return levels[2] - levels[1] - 0.5 * ((levels[1] - levels[0]) + (levels[3] - levels[2]))


def _middle(part: Image) -> float:
    """Mean of the middle half: as robust as wanted, and not stuck to whole numbers."""
    flat = np.sort(part[np.isfinite(part)], axis=None)
    quarter = flat.size // 4
    return float(flat[quarter : flat.size - quarter].mean()) if flat.size else float("nan")
