"""Sky level and noise: a mesh of clipped medians, interpolated, and straight steps in it [S23 §0.1]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.medians import median

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_SAMPLES = 128
"""Lines per half of the frame that are looked at for steps. Halved, one false source comes beside a painted
step; doubled, nothing changes."""
_REACH_PX = 8
"""Pixels on each side of a step whose medians are compared: more than a bad column, less than a gradient.
Doubled or halved, no figure changed by 3 %."""
_SHARP_SHARE = 0.55
"""Share of a step that has to happen within two columns: an amplifier's does, a roof's or a nebula's edge
doesn't. At 0.1 or 0.78 nothing changed on the frames that were tried."""
_LEAST_SIGMA = 0.3
"""Least height of a step in units of the noise per pixel: a smaller one moves no source by its error. Doubled
or halved, nothing changed on the frames that were tried."""
_ODDS_SIGMA = 8.0
"""And in units of the scatter of all columns' jumps. Halved, steps are found in a real frame that has none,
and one of 29 sources goes; doubled, nothing changed."""
_MOST_STEPS = 6
"""Steps at most in one direction: four amplifiers and overscan strips make five; more are a structured
picture. Doubled or halved, nothing changed on the frames that were tried."""
_NEIGHBORS_PX = 2
"""How far from where the sampled lines show it a step may lie by all lines. One column was the most in 8 of
261 steps at 0.7 of the noise; doubled, no figure changed."""
_PIECES = 5
"""Pieces of a line in each of which a step must have its height. Doubled or halved, no figure changed by 3
%."""


@dataclass(frozen=True, slots=True)
class LevelSteps:
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


def find_steps(image: Image) -> LevelSteps | None:
    """Find the straight lines along columns and rows at which the sky level jumps.

    Parameters
    ----------
    image : ndarray of float32, shape (height, width)
        NaN marks missing pixels.

    Returns
    -------
    LevelSteps or None
        None where nothing jumps, which is the rule.
    """
    if min(image.shape) < 16 * _REACH_PX:
        return None
    columns, rows = _places(image), _places(image.T)
    if columns.size + rows.size == 0:
        return None
    return LevelSteps(rows, columns, _offsets(image, rows, columns))


def _places(image: Image) -> NDArray[np.intp]:
    """Numbers of the columns at which a new level starts, in the upper half, the lower half or both."""
    height = image.shape[0]
    step = max(1, height // (2 * _SAMPLES))
    halves = (image[: height // 2 : step], image[height // 2 :: step])
    signed = [jump / limit for jump, limit in map(_jumps, halves)]
    strengths = [*map(np.abs, signed), np.abs(signed[0] + signed[1]) / np.sqrt(2.0)]
    strongest = np.max(strengths, axis=0)
    positions = []
    for _ in range(_MOST_STEPS + 1):
        best = int(strongest.argmax())
        if strongest[best] < 1.0:
            break
        column = _by_all_lines((image[: height // 2], image[height // 2 :]), best)
        upper, lower, both = (strength[best] >= 1.0 for strength in strengths)
        along = [_all_along(half, column) for half in halves]
        if (upper and along[0]) or (lower and along[1]) or (both and all(along)):
            positions.append(column)
        strongest[max(0, best - _REACH_PX) : best + _REACH_PX + 1] = 0.0
    # so many lines are no amplifiers but a structured picture
    return np.sort(np.array(positions if len(positions) <= _MOST_STEPS else [], dtype=np.intp))


def _by_all_lines(halves: tuple[Image, Image], about: int) -> int:
    """Where a sampled step starts: most columns near it are then on the right side of its middle."""
    score = np.zeros(2 * _NEIGHBORS_PX + 1)
    for part in halves:
        window = part[:, about - _REACH_PX : about + _REACH_PX]
        profile = np.array([_middle(column) for column in window.T])
        before, after = profile[: _REACH_PX - _NEIGHBORS_PX], profile[_REACH_PX + _NEIGHBORS_PX :]
        if np.isnan(before).all() or np.isnan(after).all():
            continue
        # a half without the step has no say, and a bad column no more than any other
        step = float(np.nanmean(after) - np.nanmean(before))
        middle = 0.5 * float(np.nanmean(before) + np.nanmean(after))
        beyond = np.clip(np.nan_to_num(profile - middle), -abs(step), abs(step))
        for shift in range(-_NEIGHBORS_PX, _NEIGHBORS_PX + 1):
            left, right = np.split(beyond, [_REACH_PX + shift])
            score[shift + _NEIGHBORS_PX] += step * (right.sum() - left.sum())
    return about + int(score.argmax()) - _NEIGHBORS_PX


def _all_along(part: Image, column: int) -> bool:
    """Whether a jump keeps its height along the line, as an amplifier's does and a roof's doesn't."""
    pieces = np.array_split(part, _PIECES)
    jumps = np.array([_jump(piece[:, :column], piece[:, column:]) for piece in pieces])
    typical = median(jumps)
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
    sigma = median((profile - lower)[known])
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
    sharp = (near * np.sign(jump) > _SHARP_SHARE * np.abs(jump)) & (
        (profile - np.roll(profile, 1)) * np.sign(jump) > 0.35 * np.abs(jump)
    )
    scatter = 1.4826 * median(np.abs(jump[k])) if k.size else 0.0
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


_CLIP_SIGMA = 3.0
"""Samples beyond so many sigmas of a cell's median are clipped, sigma being the width of the lower half.
Doubled, 4 of 136 faint painted stars are lost; halved, level and noise come out too low, and 115 false
sources come."""
_CLIP_ROUNDS = 3
"""How often. Doubled or halved, three sources more or less on a painted nebula, none on plain skies."""
_ENOUGH_SAMPLES = 1024
"""Pixels of a cell that are looked at: its median is then sure to 4 % of the noise. Doubled or halved,
nothing changes on frames of half a megapixel, whose cells are smaller."""
_SAMPLES_AT_ONCE = 2_000_000
"""Samples that are sorted together: bounds the memory."""
_LEAST_VALID = 0.25
"""Share of a cell's pixels that must have a value, or it is filled from its neighbors."""
_SMOOTH_PX = 17
"""Length of the running mean along a line that is taken off before the noise is measured, px: slopes go, a
star's width stays."""
_ENOUGH_LINES = 12
"""With so many lines in a cell every second one gives the noise."""
_FINE_BOX_PX = 24
"""Least side of a cell of the fine structure, px."""
_FINE_FWHM = 8.0
"""And in FWHM: a star's disc above half maximum covers 1 % of it."""
_FINE_SIGMA = 0.2
"""Level of a cell, in units of the noise per pixel, from which it is structure: it is subtracted in full at
twice this. A median of the smallest cell's samples is sure to 0.05."""
_FINE_LEAST_SHARE = 0.01
"""Share of the cells that must be structure, or there is none."""
_FINE_FIRST_ROWS = 4
"""Every so many rows of cells are measured first, to recognize plain skies, which are the rule, at a quarter
of the cost."""


@dataclass(frozen=True, slots=True)
class Background:
    """The mesh of sky levels and noises.

    Attributes
    ----------
    level, noise : ndarray, shape (cells_y, cells_x)
        Sky level and noise per pixel of each cell, in the frame's unit.
    height_px, width_px : int
        Size of the frame that the mesh covers.
    steps : LevelSteps or None
        Jumps of the level between amplifiers, which come on top of the mesh.
    """

    level: NDArray[np.float64]
    noise: NDArray[np.float64]
    height_px: int
    width_px: int
    steps: LevelSteps | None = None

    def level_image(self) -> Image:
        """Return the sky level at each pixel, shape (height, width), by cubic splines along both axes."""
        image = _spread(self.level, self.height_px, self.width_px)
        if self.steps is not None:
            self.steps.add_to(image, 1.0)
        return image

    def noise_at(self, x_px: NDArray[np.float64], y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the noise per pixel at positions, shape (n,), by bilinear interpolation."""
        rows, columns = self.noise.shape
        positions = np.stack(
            [(y_px + 0.5) * rows / self.height_px - 0.5, (x_px + 0.5) * columns / self.width_px - 0.5]
        )
        return np.asarray(ndimage.map_coordinates(self.noise, positions, order=1, mode="nearest"))

    def noise_image(self, height_px: int, width_px: int) -> Image:
        """Return the noise per pixel on a grid of any size over the same frame, bilinear."""
        return _spread(self.noise, height_px, width_px, smooth=False)


def _weights(cells: int, length: int, *, smooth: bool) -> Image:
    """Matrix (length, cells) that interpolates from cell centers to pixels, flat beyond the outer centers."""
    if cells == 1:
        return np.ones((length, 1), dtype=np.float32)
    centers = (np.arange(cells) + 0.5) * length / cells - 0.5
    positions = np.clip(np.arange(length), centers[0], centers[-1])
    unit = np.eye(cells)
    if smooth and cells >= 4:
        from scipy.interpolate import (
            CubicSpline,
        )  # expensive to import, and the fast measurement does without

        return np.asarray(CubicSpline(centers, unit, bc_type="natural")(positions), dtype=np.float32)
    return np.stack([np.interp(positions, centers, row) for row in unit], axis=1).astype(np.float32)


def _spread(mesh: NDArray[np.float64], height: int, width: int, *, smooth: bool = True) -> Image:
    rows = _weights(mesh.shape[0], height, smooth=smooth)
    columns = _weights(mesh.shape[1], width, smooth=smooth)
    return np.asarray(rows @ (mesh.astype(np.float32) @ columns.T), dtype=np.float32)


def box_for(height_px: int, width_px: int) -> int:
    """Side of a mesh cell for a frame: a sixteenth of its shorter side, between 32 and 64 pixels."""
    return int(np.clip(min(height_px, width_px) // 16, 32, 64))


def estimate_background(
    image: Image,
    *,
    box_px: int | None = None,
    step_adu: float = 0.0,
    look_for_steps: bool = True,
    samples: int = _ENOUGH_SAMPLES,
) -> Background:
    """Estimate sky level and noise of a frame.

    Each cell's samples are clipped at three sigma round their median, where sigma is the width of the lower
    half, which stars don't touch; the mesh is then freed from single odd cells by a 3 × 3 median. The noise
    is that of the samples without their running mean along the line, so that a slope isn't taken for noise.

    Parameters
    ----------
    image : ndarray of float32, shape (height, width)
        NaN marks missing pixels.
    box_px : int, optional
        Side of a cell; by the frame's size if left out.
    step_adu : float, optional
        Step of whole-numbered pixels. Samples are spread evenly over one step, always alike, since medians of
        whole numbers would be off by up to half a step, which is a whole sigma in 8-bit pictures.
    look_for_steps : bool
        Whether the level may jump between amplifiers.
    samples : int
        About how many pixels of a cell are looked at.
    """
    steps = find_steps(image) if look_for_steps else None
    if steps is not None:
        image = image.copy()
        steps.add_to(image, -1.0)
    level, noise = _mesh(image, box_px or box_for(*image.shape), step_adu, samples)
    height, width = image.shape
    return Background(_mended(level, image), _mended(noise, image), height, width, steps)


def fine_structure(sky_free: Image, background: Background, fwhm_px: float) -> Background | None:
    """Find what the coarse mesh left over: nebulae, galaxies, halos, the unresolved stars of a cluster.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        Without the coarse background, missing pixels zero.
    background : Background
        The coarse one, for its noise.
    fwhm_px : float
        The stars' width; a cell is eight times as wide, so that a star doesn't fill it.

    Returns
    -------
    Background or None
        Levels to subtract, zero where nothing is significant; None where that is nearly everywhere.
    """
    height, width = sky_free.shape
    even = sky_free[: height - height % 2, : width - width % 2]
    lines = even[0::2] + even[1::2]
    halved = (lines[:, 0::2] + lines[:, 1::2]) * np.float32(0.25)
    box = max(_FINE_BOX_PX, round(_FINE_FWHM * fwhm_px)) // 2
    # plain skies are the rule, and a few lines of cells show them
    for every in (_FINE_FIRST_ROWS, 1):
        level, own = _mesh(halved, box, 0.0, _ENOUGH_SAMPLES, noise_too=False, every=every)
        share = _clear_share(level, background, sky_free.shape)
        if np.mean(share[::every] > 0) < _FINE_LEAST_SHARE * (1.0 if every == 1 else 0.5):
            return None
    return Background(share * np.nan_to_num(level), own, *sky_free.shape)


def _clear_share(
    level: NDArray[np.float64], background: Background, size: tuple[int, int]
) -> NDArray[np.float64]:
    """How much of each cell's level is to be believed: none of what noise alone makes."""
    rows, columns = level.shape
    y, x = ((np.arange(n) + 0.5) * size / n - 0.5 for n, size in ((rows, size[0]), (columns, size[1])))
    positions = np.meshgrid(x, y)
    noise = background.noise_at(positions[0].ravel(), positions[1].ravel()).reshape(level.shape)
    strength = np.abs(np.nan_to_num(level)) / np.maximum(noise, 1e-20)
    return np.asarray(np.clip((strength - _FINE_SIGMA) / _FINE_SIGMA, 0.0, 1.0))


def _mesh(
    image: Image, box: int, step_adu: float, samples: int, *, noise_too: bool = True, every: int = 1
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Level and noise of each cell, or of the cells in every so many rows; NaN where nothing is known."""
    height, width = image.shape
    rows, columns = max(1, round(height / box)), max(1, round(width / box))
    row_edges = np.linspace(0, height, rows + 1).astype(int)
    column_edges = np.linspace(0, width, columns + 1).astype(int)
    level, noise = np.full((rows, columns), np.nan), np.full((rows, columns), np.nan)
    lines, cell_width = int(np.diff(row_edges).min()), int(np.diff(column_edges).min())
    # whole lines are read, only so many that a cell has samples enough
    step = max(1, round(lines * cell_width / samples))
    offset = np.arange(0, lines, step)
    used = np.arange(0, rows, every)
    spread = np.zeros((1, 1), dtype=np.float32)
    if step_adu > 0.0:
        even = np.random.default_rng(0).random((offset.size, width), dtype=np.float32)
        spread = np.asarray(np.float32(step_adu) * (even - np.float32(0.5)), dtype=np.float32)
    at_once = max(1, _SAMPLES_AT_ONCE // (offset.size * width))
    for start in range(0, used.size, at_once):
        some = used[start : start + at_once]
        bands = image[row_edges[some, None] + offset]
        bands += spread
        level[some], wide = _clipped(_cells(bands, column_edges, cell_width))
        if noise_too:
            bands = bands[:, ::2] if offset.size >= _ENOUGH_LINES else bands
            flat = _without_slopes(bands, level[some], wide)
            noise[some] = _clipped(_cells(flat, column_edges, cell_width))[1]
    return level, noise


def _cut(cells: NDArray[np.float64], width: int) -> Image:
    """Spread one value a cell over the pixels of a band's lines, shape (bands, 1, width)."""
    centers, positions = (np.arange(cells.shape[1]) + 0.5) * width / cells.shape[1], np.arange(width)
    wide = np.zeros((cells.shape[0], 1, width), dtype=np.float32)
    for band, row in zip(wide, cells, strict=True):
        known = np.isfinite(row)
        if known.any():
            band[0] = np.interp(positions, centers[known], row[known])
    return wide


def _without_slopes(bands: Image, level: NDArray[np.float64], sigma: NDArray[np.float64]) -> Image:
    """Take the running mean along each line away; what stands out is cut, so stars hardly count."""
    width = bands.shape[2]
    middle, reach = _cut(level, width), np.float32(_CLIP_SIGMA) * _cut(sigma, width)
    tame = np.clip(bands, middle - reach, middle + reach)
    missing = np.isnan(tame)
    if missing.any():
        tame = np.where(missing, middle, tame)
    gain = np.float32(np.sqrt(_SMOOTH_PX / (_SMOOTH_PX - 1.0)))
    return np.asarray((bands - ndimage.uniform_filter1d(tame, _SMOOTH_PX, axis=2, mode="nearest")) * gain)


def _cells(bands: Image, column_edges: NDArray[np.intp], cell_width: int) -> Image:
    """Cut bands (n, lines, width) in cells, shape (n, cells, samples)."""
    cells = np.empty((bands.shape[0], column_edges.size - 1, bands.shape[1], cell_width), dtype=np.float32)
    for i, edge in enumerate(column_edges[:-1]):
        cells[:, i] = bands[:, :, edge : edge + cell_width]
    return cells.reshape(*cells.shape[:2], -1)


def _clipped(cells: Image) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return clipped median and lower-half sigma of each cell; NaN where too few pixels are valid."""
    shape = cells.shape[:2]
    cells = cells.reshape(shape[0] * shape[1], -1)
    cells.sort(axis=1)  # NaN go to the end
    low = np.zeros(cells.shape[0], dtype=np.intp)
    count = np.full(cells.shape[0], cells.shape[1])
    if not np.isfinite(cells[:, -1]).all():
        count = _below(cells, np.full(cells.shape[0], np.inf))
    high = count
    index = np.arange(cells.shape[0])

    def at(share: float) -> NDArray[np.float64]:
        position = np.clip((low + share * (high - low - 1)).astype(int), 0, cells.shape[1] - 1)
        return np.asarray(cells[index, position], dtype=np.float64)

    for _ in range(_CLIP_ROUNDS):
        middle = at(0.5)
        reach = _CLIP_SIGMA * (middle - at(0.158655) + 1e-12)
        low, high = _below(cells, middle - reach), _below(cells, np.nextafter(middle + reach, np.inf))
    middle, sigma = at(0.5), at(0.5) - at(0.158655)
    few = count < _LEAST_VALID * cells.shape[1]
    return np.where(few, np.nan, middle).reshape(shape), np.where(few, np.nan, sigma).reshape(shape)


def _below(ranked: Image, limit: NDArray[np.float64]) -> NDArray[np.intp]:
    """How many samples of each sorted row are below the row's limit, by halving."""
    low = np.zeros(limit.size, dtype=np.intp)
    high = np.full(limit.size, ranked.shape[1], dtype=np.intp)
    index = np.arange(limit.size)
    for _ in range(ranked.shape[1].bit_length()):
        middle = (low + high) // 2
        inside = middle < high
        below = inside & (ranked[index, np.minimum(middle, ranked.shape[1] - 1)] < limit)
        low, high = np.where(below, middle + 1, low), np.where(below | ~inside, high, middle)
    return low


def _mended(mesh: NDArray[np.float64], image: Image) -> NDArray[np.float64]:
    """Fill empty cells from the nearest full one, then take single odd cells out."""
    empty = ~np.isfinite(mesh)
    if empty.all():
        return np.full_like(mesh, float(np.nanmedian(image)))
    if empty.any():
        nearest = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
        mesh = mesh[tuple(np.asarray(nearest))]
    if min(mesh.shape) < 3:
        return mesh
    # a slope that goes on beyond the frame is no odd cell: the corners of an amplifier's glow stay
    framed = np.pad(mesh, 1, mode="reflect", reflect_type="odd")
    return np.asarray(ndimage.median_filter(framed, size=3))[1:-1, 1:-1]
