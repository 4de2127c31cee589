"""A supposed line followed through the smoothed frame, piece by piece: a trail, or none [S23 §0.3]."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.trail import Trail

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Place = TypeVar("Place", float, NDArray[np.float64])

CUT_SIGMA = 3.0
"""No pixel counts for less than minus so much of the noise, nor for more in the coarse picture."""
_PIECE_PX = 20.0
_LEAST_RIDGE = 0.6
_SURE = 8.0
_COVERED = 0.7
_WIDEST_FWHM = 2.2
_SPIKE_FADES = 0.4
_SPIKE_STAR = 15.0
_WING_SIGMA = 0.7
_STEEPEST_BEND = 0.12
_MANY_PIECES = 8
_DASH_RIDGE = 2.0
_UNEVEN = (0.45, 0.9)
_UNEVEN_SHORT = (0.2, 0.7)


@dataclass(frozen=True, slots=True)
class _Line:
    """A supposed line: origin, unit direction, and bend as a `Trail` has it; bins of the picture."""

    x: float
    y: float
    along_x: float
    along_y: float
    bend: tuple[float, float, float]

    def side(self, along: Place) -> Place:
        """Its offset towards the normal at places along it."""
        return self.bend[0] + along * (self.bend[1] + along * self.bend[2])

    def slope(self, along: float) -> float:
        """How fast that grows."""
        return self.bend[1] + 2.0 * self.bend[2] * along

    def places(self, along: Array, side: Array) -> tuple[Array, Array]:
        """X and y of places so far along and beside the straight line."""
        return (
            self.x + along * self.along_x - side * self.along_y,
            self.y + along * self.along_y + side * self.along_x,
        )


class Follower:
    """Follows a supposed line through the smoothed picture; all lengths in the picture's own bins."""

    def __init__(self, picture: Image, fwhm: float, least: float, loose: float, bin_px: int) -> None:
        self.picture = picture
        self.fwhm = fwhm
        self.least = least
        self.loose = loose
        self.piece = max(6, round(_PIECE_PX / bin_px))
        # the smoothing widens what it sees
        self.seen_fwhm = float(np.hypot(fwhm, 2.83 / bin_px))
        self.inner = max(1, round(0.3 * self.seen_fwhm))
        self.gap = round(1.5 * self.seen_fwhm) + 1
        self.outer = round(2.5 * self.seen_fwhm) + 2

    def follow(self, x0: float, y0: float, x1: float, y1: float) -> Trail | None:
        """Return the trail that runs there, or None."""
        length = float(np.hypot(x1 - x0, y1 - y0))
        ux, uy = (x1 - x0) / length, (y1 - y0) / length
        line = _Line(x0, y0, ux, uy, (0.0, 0.0, 0.0))
        reach = round(self.loose) + 2
        start, end = 0.0, length
        for degree, wide in ((0, reach + 2), (1, reach), (1, 4), (2, 6), (2, 4)):
            line = replace(line, bend=self._centered(line, start, end, wide, degree))
            if degree > 0:
                run = self._run(line)
                if run is None:
                    return None
                start, end = run
            if max(abs(line.slope(t)) for t in (start, end)) > _STEEPEST_BEND:
                return None  # it slid onto another line
        return self._judged(line, start, end)

    def _strip(self, line: _Line, along: Array, across: Array) -> Array:
        """Values beside the line, shape (len(along), len(across)); NaN outside the picture."""
        x, y = (
            np.rint(place).astype(int)
            for place in line.places(along[:, None], line.side(along)[:, None] + across[None, :])
        )
        height, width = self.picture.shape
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        flat = np.clip(y, 0, height - 1) * width + np.clip(x, 0, width - 1)
        return np.where(inside, self.picture.ravel()[flat], np.nan)

    def _centered(
        self, line: _Line, start: float, end: float, wide: int, degree: int
    ) -> tuple[float, float, float]:
        """Move the line onto the ridge: the top's offset, piece by piece, fitted by a polynomial."""
        bend = line.bend
        along = np.arange(start, end + 1.0)
        across = np.arange(-wide - 2, wide + 3, dtype=float)
        strip = np.clip(np.nan_to_num(self._strip(line, along, across)), -CUT_SIGMA, 5.0)
        pieces = 1 if degree == 0 else int(np.clip(along.size / (1.5 * self.piece), degree + 2, 24))
        cuts = np.linspace(0, along.size, pieces + 1).astype(int)
        if np.diff(cuts).min() < 1:
            return bend
        profile = np.add.reduceat(strip, cuts[:-1], axis=0) / np.diff(cuts)[:, None]
        calm = (profile[:, :-2] + profile[:, 1:-1] + profile[:, 2:]) / 3.0
        top = calm.argmax(axis=1)
        index = np.arange(pieces)
        left, right = calm[index, np.maximum(top - 1, 0)], calm[index, np.minimum(top + 1, calm.shape[1] - 1)]
        peak = calm[index, top]
        curve = np.minimum(left - 2.0 * peak + right, -1e-6)
        offset = across[1:-1][top] + np.clip(0.5 * (left - right) / curve, -0.5, 0.5)
        middle = 0.5 * (along[cuts[:-1]] + along[np.minimum(cuts[1:], along.size) - 1])
        if degree == 0:
            return (bend[0] + float(offset[0]), bend[1], bend[2])
        weight = np.clip(peak - np.median(calm), 0.05, 3.0)
        for _ in range(4):
            fit = np.polynomial.polynomial.polyfit(middle, offset, degree, w=weight)
            off = np.abs(offset - np.polynomial.polynomial.polyval(middle, fit))
            weight = np.clip(peak - np.median(calm), 0.05, 3.0) / (1.0 + (off / 1.0) ** 2)
        fit = np.r_[fit, np.zeros(3 - fit.size)]
        return (bend[0] + float(fit[0]), bend[1] + float(fit[1]), bend[2] + float(fit[2]))

    def _ridge(self, line: _Line, start: float, end: float) -> tuple[Array, Array, Array]:
        """Middles of the pieces, the medians on the line, and how far these rise above the higher side's."""
        pieces = max(1, int((end - start) / self.piece))
        along = start + (np.arange(pieces * self.piece) + 0.5) * (end - start) / (pieces * self.piece)
        across = np.arange(-self.outer, self.outer + 1, dtype=float)
        strip = self._strip(line, along, across)
        strip = strip.reshape(pieces, self.piece, across.size)
        on = np.median(strip[:, :, np.abs(across) <= self.inner].mean(axis=2), axis=1)
        left = np.median(strip[:, :, across <= -self.gap].mean(axis=2), axis=1)
        right = np.median(strip[:, :, across >= self.gap].mean(axis=2), axis=1)
        middle = along.reshape(pieces, self.piece).mean(axis=1)
        return middle, on, on - np.maximum(left, right)

    def _run(self, line: _Line) -> tuple[float, float] | None:
        """Follow the line through the whole picture; return where its best stretch starts and ends."""
        middle, _, ridge = self._ridge(line, *self._in_picture(line))
        known = np.isfinite(ridge)
        if not known.any():
            return None
        score = np.where(known, np.clip(ridge, -1.5, 2.5) - 0.4, 0.0)
        total = np.cumsum(score)
        before = np.minimum.accumulate(np.r_[0.0, total[:-1]])
        last = int((total - before).argmax())
        first = int(np.r_[0.0, total[: last + 1]][: last + 1].argmin())
        while first < last and not known[first]:
            first += 1
        half = 0.5 * (middle[1] - middle[0]) if middle.size > 1 else 0.5 * self.piece
        start, end = float(middle[first] - half), float(middle[last] + half)
        if end - start < 0.8 * self.least:
            return None
        return self._to_the_edge(line, start, end)

    def _in_picture(self, line: _Line) -> tuple[float, float]:
        """Between which places along it, at most, the line is in the picture."""
        diagonal = float(np.hypot(*self.picture.shape))
        first, last = -diagonal, diagonal
        off = max(abs(line.side(t)) for t in (first, 0.0, last)) + self.outer
        height, width = self.picture.shape
        for start, way, size in ((line.x, line.along_x, width), (line.y, line.along_y, height)):
            if abs(way) < 1e-3:
                continue
            ends = sorted(((-off - start) / way, (size + off - start) / way))
            first, last = max(first, ends[0]), min(last, ends[1])
        return first, max(last, first + self.piece)

    def _to_the_edge(self, line: _Line, start: float, end: float) -> tuple[float, float]:
        """Let a stretch that comes near the picture's edge, where one side can't be seen, reach it."""
        near = self.outer + 2.0 * self.piece
        height, width = self.picture.shape
        along = np.arange(start - near, end + near + 1.0)
        x, y = line.places(along, line.side(along))
        inside = along[(x > -0.5) & (x < width - 0.5) & (y > -0.5) & (y < height - 0.5)]
        if inside.size == 0:
            return start, end
        first, last = float(inside[0]), float(inside[-1])
        return (first if first > start - near + 1.0 else start, last if last < end + near - 1.0 else end)

    def _judged(self, line: _Line, start: float, end: float) -> Trail | None:
        """Say whether the stretch is a trail: long, mostly there, as narrow as a star."""
        middle, on, ridge = self._ridge(line, start, end)
        known = np.isfinite(ridge)
        middle, on, ridge = middle[known], on[known], ridge[known]
        if end - start < self.least or ridge.size < 3:
            return None
        typical = float(np.median(ridge))
        dashes = _dashes(ridge)
        if dashes is not None:
            typical = dashes
        sure = float(np.clip(ridge, -1.5, 2.5).mean()) * np.sqrt(ridge.size) / 0.6
        covered = float(np.mean(ridge > 0.3 * min(typical, 2.0)))
        if typical < _LEAST_RIDGE or sure < _SURE or (covered < _COVERED and dashes is None):
            return None
        profile, across = self._profile(line, start, end, mean=dashes is not None)
        width = _width(profile, across, 0.5)
        if width > _WIDEST_FWHM * self.seen_fwhm + 1.0:
            return None
        wings = _width(profile, across, max(0.05, min(0.5, _WING_SIGMA / max(float(profile.max()), 1e-6))))
        spike = self._is_spike(line, middle, on)
        if not spike and dashes is None and not _even(ridge, typical):
            return None
        return Trail(
            line.x, line.y, line.along_x, line.along_y, line.bend, start, end, 0.5 * wings, typical, spike
        )

    def _profile(self, line: _Line, start: float, end: float, *, mean: bool) -> tuple[Array, Array]:
        """Median (of dashes the cut mean) across the line over its whole length, less the level beside it."""
        reach = int(np.ceil(5.0 * self.seen_fwhm)) + 4
        across = np.arange(-reach, reach + 1, dtype=float)
        strip = self._strip(line, np.arange(start, end), across)
        whole = np.isfinite(strip).all(axis=1)
        strip = strip[whole] if whole.any() else np.nan_to_num(strip)
        profile = np.clip(strip, -10.0, 10.0).mean(axis=0) if mean else np.median(strip, axis=0)
        return np.asarray(profile - np.median(np.r_[profile[:3], profile[-3:]])), across

    def _is_spike(self, line: _Line, middle: Array, on: Array) -> bool:
        """Tell whether the line fades on both sides of a bright star on it, as diffraction spikes do."""
        strip = self._strip(line, np.arange(middle[0], middle[-1] + 1.0), np.arange(-3.0, 4.0))
        bright = np.nan_to_num(strip, nan=-np.inf).max(axis=1)
        star = int(bright.argmax())
        if bright[star] < _SPIKE_STAR * max(float(np.median(on)), 1.0):
            return False
        distance = np.abs(middle - (middle[0] + star))
        order = np.argsort(distance)
        third = max(1, order.size // 3)
        near, far = on[order[1 : 1 + third]], on[order[-third:]]
        return bool(np.median(far) < _SPIKE_FADES * np.median(near)) if near.size else False


def _dashes(ridge: Array) -> float | None:
    """Height of the dashes of a blinking light, if a ridge's pieces are either of one height or dark."""
    high = float(np.percentile(ridge, 80.0))
    lit = ridge > 0.4 * high
    starts = np.flatnonzero(np.diff(np.r_[0, lit.astype(int)]) == 1)
    ends = np.flatnonzero(np.diff(np.r_[lit.astype(int), 0]) == -1)
    if high < _DASH_RIDGE or starts.size < 3 or lit.mean() > 0.85:
        return None
    lengths = ends - starts + 1
    inside = lit & np.r_[True, lit[:-1]] & np.r_[lit[1:], True]  # a dash's ends are half dark
    ridge_lit = ridge[inside] if inside.sum() >= 3 else ridge[lit]
    low, top = np.percentile(ridge_lit, [20.0, 80.0])
    typical = float(np.median(ridge_lit))
    dark = float(np.median(np.abs(ridge[~lit])))
    even = 0.5 * (top - low) < _UNEVEN_SHORT[0] * typical + _UNEVEN_SHORT[1]
    return typical if np.median(lengths) >= 2 and even and dark < 0.3 * typical + 0.4 else None


def _even(ridge: Array, typical: float) -> bool:
    """Tell whether the pieces are alike, as those of a trail are and stars in a row aren't."""
    low, high = np.percentile(ridge, [20.0, 80.0])
    share, noise = _UNEVEN if ridge.size >= _MANY_PIECES else _UNEVEN_SHORT
    return bool(0.5 * (high - low) < share * typical + noise)


def _width(profile: Array, across: Array, level: float) -> float:
    """Full width at a share of the maximum, from the top outwards."""
    top = int(np.abs(across).argmin())
    top += int(profile[max(0, top - 1) : top + 2].argmax()) - 1
    if profile[top] <= 0.0:
        return float("inf")
    below = profile < level * profile[top]
    right = np.flatnonzero(below[top:])
    left = np.flatnonzero(below[top::-1])
    a = float(right[0]) if right.size else float(profile.size - top)
    b = float(left[0]) if left.size else float(top + 1)
    return a + b - 1.0
