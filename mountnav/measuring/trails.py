"""Trails of satellites and planes, spikes of bright stars: found as lines, followed, kept [S23 §0.3]."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.detection import Smoothed

__all__ = ["Trail", "find_trails"]


Array = NDArray[np.float64]
Image = NDArray[np.float32]

_SIDE_BINS = 3
"""Distance of the two neighbors that a line has to outshine, bins: farther than a blurred trail is wide.
Halved, a painted trail is lost and 19 false sources come; doubled, no figure changed by 3 %."""
_MOST_A_LEVEL = 1500
"""Pieces at most that are kept of each length, the strongest: bounds the time."""
_SAMPLE_STEP = 7
"""Every so many sums are the sample that gives the scatter of all."""


@dataclass(frozen=True, slots=True)
class LineSegments:
    """Straight pieces that stand out, best first; each array has shape (n,), lengths in bins.

    Attributes
    ----------
    x0, y0, x1, y1 : ndarray
        The ends.
    strength : ndarray
        How far the sum along the piece rises above the higher one of its two neighbors, in units of the
        scatter of this difference.
    """

    x0: Array
    y0: Array
    x1: Array
    y1: Array
    strength: Array


def find_line_segments(picture: Image, least_length: float, threshold: float) -> LineSegments:
    """Find straight bright pieces of any direction.

    Parameters
    ----------
    picture : ndarray of float32, shape (height, width)
        Cut above, so that single bright bins don't count as lines.
    least_length : float
        Shorter pieces aren't looked for, bins.
    threshold : float
        Least strength.
    """
    first = max(3, int(np.ceil(np.log2(max(least_length, 2.0)))))
    parts: list[Array] = []
    for upright in (True, False):
        lines = picture if upright else picture.T
        for mirrored in (False, True):
            found = _steep(lines[:, ::-1] if mirrored else lines, first, threshold)
            if mirrored:
                found[:, [0, 2]] = lines.shape[1] - 1 - found[:, [0, 2]]
            parts.append(found if upright else found[:, [1, 0, 3, 2, 4]])
    rows = np.concatenate(parts)
    rows = rows[np.argsort(-rows[:, 4], kind="stable")]
    return LineSegments(*rows.T)


def _steep(picture: Image, first: int, threshold: float) -> Array:
    """Pieces that go down and right, up to 45° off the columns; rows of (x0, y0, x1, y1, strength)."""
    height, width = picture.shape
    levels = int(np.ceil(np.log2(height)))
    sums = np.zeros((2**levels, 1, width), dtype=np.float32)
    sums[:height, 0] = picture
    found = [np.zeros((0, 5))]
    for level in range(1, levels + 1):
        upper, lower = sums[0::2], sums[1::2]
        sums = np.repeat(upper, 2, axis=1)
        for slope in range(2**level):
            shift = (slope + 1) // 2
            if shift < width:
                sums[:, slope, : width - shift] += lower[:, slope // 2, shift:]
        if level >= first:
            found.append(_standing_out(sums, level, threshold, height))
    return np.concatenate(found)


def _standing_out(sums: Image, level: int, threshold: float, height: int) -> Array:
    ridge = sums[:, :, _SIDE_BINS:-_SIDE_BINS] - np.maximum(
        sums[:, :, : -2 * _SIDE_BINS], sums[:, :, 2 * _SIDE_BINS :]
    )
    sample = ridge.ravel()[::_SAMPLE_STEP]
    sample = np.sort(sample[sample != 0.0])
    if sample.size < 100:
        return np.zeros((0, 5))
    middle, low = sample[sample.size // 2], sample[int(0.158655 * sample.size)]
    scatter = max(float(middle - low), 1e-6)
    positions = np.flatnonzero(ridge > middle + threshold * scatter)
    if positions.size == 0:
        return np.zeros((0, 5))
    strength = (ridge.ravel()[positions] - middle) / scatter
    if positions.size > _MOST_A_LEVEL:
        best = np.argpartition(-strength, _MOST_A_LEVEL)[:_MOST_A_LEVEL]
        positions, strength = positions[best], strength[best]
    block, slope, x = np.unravel_index(positions, ridge.shape)
    rows = 2**level
    x0 = x + float(_SIDE_BINS)
    y0 = block * float(rows)
    y1 = np.minimum(y0 + rows - 1, height - 1.0)  # the last block may hang over the picture's edge
    return np.stack([x0, y0, x0 + slope * (y1 - y0) / (rows - 1), y1, strength], axis=1)


@dataclass(frozen=True, slots=True)
class Trail:
    """A long thin bright thing that may bend a little; lengths in pixels of the frame.

    Attributes
    ----------
    x_px, y_px : float
        Its origin, from which positions along it are counted.
    along_x, along_y : float
        Unit direction.
    bend : tuple of three float
        Offset towards the normal (-along_y, along_x) at t along: bend[0] + bend[1] t + bend[2] t².
    start_px, end_px : float
        Where along the direction it begins and ends.
    half_width_px : float
        Half of the width over which it is brighter than the sky's noise.
    height : float
        How far its ridge rises, in units of the smoothed frame's noise.
    spike : bool
        It is a bright star's own: it fades away from the star.
    """

    x_px: float
    y_px: float
    along_x: float
    along_y: float
    bend: tuple[float, float, float]
    start_px: float
    end_px: float
    half_width_px: float
    height: float
    spike: bool

    @property
    def length_px(self) -> float:
        """From end to end."""
        return self.end_px - self.start_px

    @property
    def along_axis(self) -> bool:
        """It runs exactly along a column or row: charge that ran over, or pixels that are bad."""
        ends = np.array(self.positions(np.array([self.start_px, self.end_px])))
        return bool(np.abs(ends[:, 1] - ends[:, 0]).min() < max(1.0, 0.004 * self.length_px))

    def positions(self, along_px: Array) -> tuple[Array, Array]:
        """Return x and y, each of shape (n,), of positions on its ridge."""
        side = self.bend[0] + along_px * (self.bend[1] + along_px * self.bend[2])
        x = self.x_px + along_px * self.along_x - side * self.along_y
        return x, self.y_px + along_px * self.along_y + side * self.along_x

    def touches(self, x_px: Array, y_px: Array, margin_px: float) -> NDArray[np.bool_]:
        """Which positions, shape (n,), lie on it or within a margin of it."""
        dx, dy = x_px - self.x_px, y_px - self.y_px
        along = dx * self.along_x + dy * self.along_y
        across = dy * self.along_x - dx * self.along_y
        across = across - (self.bend[0] + along * (self.bend[1] + along * self.bend[2]))
        return np.asarray(
            (along > self.start_px - margin_px)
            & (along < self.end_px + margin_px)
            & (np.abs(across) < self.half_width_px + margin_px)
        )

    def pixels(self, height_px: int, width_px: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of the pixels that it covers in a frame of a size; some may come twice."""
        along = np.arange(self.start_px - 1.0, self.end_px + 1.5, 0.7)
        across = np.arange(-self.half_width_px, self.half_width_px + 0.5, 0.7)
        middle = self.bend[0] + along * (self.bend[1] + along * self.bend[2])
        side = middle[:, None] + across[None, :]
        x = np.rint(self.x_px + along[:, None] * self.along_x - side * self.along_y).astype(int).ravel()
        y = np.rint(self.y_px + along[:, None] * self.along_y + side * self.along_x).astype(int).ravel()
        inside = (x >= 0) & (x < width_px) & (y >= 0) & (y < height_px)
        return y[inside], x[inside]


Place = TypeVar("Place", float, NDArray[np.float64])

CUT_SIGMA = 3.0
"""No pixel counts for less than minus so much of the noise, nor for more in the coarse picture."""
_PIECE_PX = 20.0
"""Length of the pieces in which a line is followed, px: the median along one doesn't see single stars.
Halved, one star of 124 is lost to a painted trail; doubled, no figure changed by 3 %."""
_LEAST_RIDGE = 0.6
"""Least height of the typical piece over its sides, in noises of the smoothed frame. Chosen by hand; doubled
or halved, nothing changed on the frames that were tried."""
_LEAST_SIGNIFICANCE = 8.0
"""Least significance of all pieces together, in sigmas. Chosen by hand; doubled or halved, nothing changed on
the frames that were tried."""
_LEAST_COVERED = 0.7
"""Share of the pieces that must show the ridge, unless it is dashed. Chosen by hand; doubled or halved,
nothing changed on the frames that were tried."""
_WIDEST_FWHM = 2.2
"""Width over that of a smoothed star above which a line is no trail but a band of light. Chosen by hand;
doubled or halved, nothing changed on the frames that were tried."""
_SPIKE_FADES = 0.4
"""Far over near height of a line on a bright star below which it is the star's own spike. Chosen by hand;
doubled or halved, nothing changed on the frames that were tried."""
_SPIKE_STAR = 15.0
"""Height of that star over the line's. Chosen by hand; doubled or halved, nothing changed on the frames that
were tried."""
_WING_SIGMA = 0.7
"""The trail's full width is where it falls below so many noises. At 0.85 two more faint stars beside a
painted trail keep their pixels; at 0.4 nothing changed."""
_STEEPEST_BEND = 0.12
"""Slope against the first direction beyond which the fit slid onto another line. Chosen by hand; doubled or
halved, nothing changed on the frames that were tried."""
_MANY_PIECES = 8
"""With so many pieces their evenness is judged by the strict bound, else by the other one. Chosen by hand;
doubled or halved, nothing changed on the frames that were tried."""
_DASH_RIDGE = 2.0
"""Least height of dashes, in noises of the smoothed frame. Chosen by hand; doubled or halved, nothing changed
on the frames that were tried."""
_UNEVEN = (0.45, 0.9)
"""Half spread of the pieces' heights up to which a line is even: a share of the typical height, and noises on
top. Halved, a painted trail is lost and 19 false sources come; doubled, nothing changed on the frames that
were tried."""
_UNEVEN_SHORT = (0.2, 0.7)
"""The same for lines of few pieces, among which one star makes much, and for dashes. Chosen by hand; doubled
or halved, nothing changed on the frames that were tried."""


@dataclass(frozen=True, slots=True)
class _Line:
    """A supposed line: origin, unit direction, and bend as a `Trail` has it; bins of the picture."""

    x: float
    y: float
    along_x: float
    along_y: float
    bend: tuple[float, float, float]

    def side(self, along: Place) -> Place:
        """Its offset towards the normal at positions along it."""
        return self.bend[0] + along * (self.bend[1] + along * self.bend[2])

    def slope(self, along: float) -> float:
        """How fast that grows."""
        return self.bend[1] + 2.0 * self.bend[2] * along

    def positions(self, along: Array, side: Array) -> tuple[Array, Array]:
        """X and y of positions so far along and beside the straight line."""
        return (
            self.x + along * self.along_x - side * self.along_y,
            self.y + along * self.along_y + side * self.along_x,
        )


class TrailFollower:
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
            np.rint(position).astype(int)
            for position in line.positions(along[:, None], line.side(along)[:, None] + across[None, :])
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
        """Between which positions along it, at most, the line is in the picture."""
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
        x, y = line.positions(along, line.side(along))
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
        if (
            typical < _LEAST_RIDGE
            or sure < _LEAST_SIGNIFICANCE
            or (covered < _LEAST_COVERED and dashes is None)
        ):
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
        """Whether the line fades on both sides of a bright star on it, as diffraction spikes do."""
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
    """Whether the pieces are alike, as those of a trail are and stars in a row aren't."""
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


_MOST_BINS = 448
"""Longest side of the coarse picture in which lines are sought, bins: the time goes with its square. Halved,
a painted trail is lost and 19 false sources come; doubled, nothing changed on the frames that were tried."""
_THRESHOLD = 6.0
"""Least strength of a piece, in units of the scatter of all pieces of its length. Doubled or halved, nothing
changed on the frames that were tried."""
_LEAST_LENGTH_PX = 50.0
"""Shortest trail, px ..."""
_LEAST_LENGTH_FWHM = 12.0
"""... and in star widths: stars in a row are as long. Doubled or halved, nothing changed on the frames that
were tried."""
_MOST_TRIALS = 25
"""Pieces at most that are followed, the strongest: bounds the time. Doubled or halved, nothing changed on the
frames that were tried."""
_MOST_FAILURES = 10
"""Failures in a row after which the search ends. Doubled or halved, nothing changed on the frames that were
tried."""
_MOST_TRAILS = 20
"""Trails at most in a frame: with more it is no sky. Doubled or halved, nothing changed on the frames that
were tried."""
_SAME_BINS = 5.0
"""Pieces that lie within so many bins of another one are the same line."""


def find_trails(smoothed: Smoothed, fwhm_px: float) -> list[Trail]:
    """Find the trails in a smoothed frame.

    Lines are sought in a coarse picture of the frame in which no bin counts more than a few sigma, so that
    stars hardly do; each is then followed through the smoothed frame, piece by piece, and believed if most
    pieces show a ridge of a star's width: the median along a piece doesn't see single stars.

    Parameters
    ----------
    fwhm_px : float
        The stars' width; a trail is at least twelve times as long, and 50 pixels.

    Returns
    -------
    list of Trail
        Clearest first.
    """
    picture = smoothed.significance
    share = max(2, -(-max(picture.shape) // _MOST_BINS))
    coarse = _coarse(picture, share)
    if min(coarse.shape) < 32:
        return []
    least_px = max(_LEAST_LENGTH_PX, _LEAST_LENGTH_FWHM * fwhm_px)
    segments = find_line_segments(coarse, least_px / (share * smoothed.bin_px) * 0.75, _THRESHOLD)
    follower = TrailFollower(
        picture, fwhm_px / smoothed.bin_px, least_px / smoothed.bin_px, float(share), smoothed.bin_px
    )
    kept: list[Trail] = []
    left = np.ones(segments.x0.size, dtype=bool)
    failures = 0
    for _ in range(_MOST_TRIALS):
        if not left.any() or len(kept) == _MOST_TRAILS or failures == _MOST_FAILURES:
            break
        best = int(np.flatnonzero(left)[0])  # they come best first
        trail = follower.follow(*_ends(segments, best, share))
        left &= ~_alike(segments, best)
        if trail is None or any(_on(trail, other, follower.gap) for other in kept):
            failures += trail is None
            continue
        failures = 0
        kept.append(trail)
        for fraction in (0.2, 0.5, 0.8):
            # pieces that lie on a trail we have, or run through it: only those off it stay
            x = segments.x0 + fraction * (segments.x1 - segments.x0)
            y = segments.y0 + fraction * (segments.y1 - segments.y0)
            here = np.stack([x, y]) * share + 0.5 * (share - 1)
            left &= ~trail.touches(here[0], here[1], 2.0 * share)
    return [_in_frame(trail, smoothed.bin_px) for trail in kept]


def _on(trail: Trail, other: Trail, margin: float) -> bool:
    """Whether a trail runs mostly on another one."""
    along = np.linspace(trail.start_px, trail.end_px, 21)
    return bool(other.touches(*trail.positions(along), margin).mean() > 0.4)


def _coarse(picture: Image, share: int) -> Image:
    """Mean over share × share bins of the picture, cut on both sides."""
    rows, columns = picture.shape[0] // share, picture.shape[1] // share
    cut = np.clip(picture[: rows * share, : columns * share], -CUT_SIGMA, CUT_SIGMA)
    lines = cut.reshape(rows, share, columns * share).sum(axis=1)
    return np.asarray(lines.reshape(rows, columns, share).mean(axis=2) / np.float32(share), dtype=np.float32)


def _ends(segments: LineSegments, best: int, share: int) -> tuple[float, float, float, float]:
    shift = 0.5 * (share - 1)
    x0, y0, x1, y1 = (
        float(v[best]) * share + shift for v in (segments.x0, segments.y0, segments.x1, segments.y1)
    )
    return x0, y0, x1, y1


def _alike(segments: LineSegments, best: int) -> NDArray[np.bool_]:
    """Which pieces are nearly the same as the best, or lie within it."""
    x0, y0 = segments.x0[best], segments.y0[best]
    dx, dy = segments.x1[best] - x0, segments.y1[best] - y0
    length = float(np.hypot(dx, dy))
    near = np.ones(segments.x0.size, dtype=bool)
    for x, y in ((segments.x0, segments.y0), (segments.x1, segments.y1)):
        across = np.abs((y - y0) * dx - (x - x0) * dy) / length
        along = ((x - x0) * dx + (y - y0) * dy) / length
        near &= (across < _SAME_BINS) & (along > -_SAME_BINS) & (along < length + _SAME_BINS)
    return near


def _in_frame(trail: Trail, bin_px: int) -> Trail:
    """Turn bins of the smoothed picture to pixels of the frame."""
    shift = 0.5 * (bin_px - 1)
    return Trail(
        x_px=trail.x_px * bin_px + shift,
        y_px=trail.y_px * bin_px + shift,
        along_x=trail.along_x,
        along_y=trail.along_y,
        bend=(trail.bend[0] * bin_px, trail.bend[1], trail.bend[2] / bin_px),
        start_px=trail.start_px * bin_px,
        end_px=trail.end_px * bin_px,
        half_width_px=trail.half_width_px * bin_px,
        height=trail.height,
        spike=trail.spike,
    )
