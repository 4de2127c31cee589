"""Draw frames whose light is no standing points, solve them, count what is right, refused and wrong.

Run: python -m benchmarks.trailed [--first 1] [--frames 200] [--only straight,double] [--told]
     [--seconds 600] [--into FILE]

With ``--into`` each outcome is a line of the file, seeds that stand there already are passed over, and
the table is that of the whole file: 2,000 frames can be run in pieces, by several processes with ranges of
their own, and go on after any end. A file belongs to one state of the code, and is refused by another.

Seeds are the numbers from `--first` on: each draws its kind, path, field, depth and hint, so that a run can
be cut in pieces and any frame drawn again. Kinds: straight trails, curved ones (the field turns about a
place), jagged ones (wind, periodic error), trails with gaps, with uneven light, two exposures in one, a tube
shaken once, a start before the mount stood still, ghosts mirrored about the optical axis, diffraction
spikes, bleeding columns; and, for the stated errors, clean, dim and crowded frames. Seeds from `FIELD_SEEDS`
on also draw fields that move otherwise here than there: turning about a place in the frame, turning about a
far one, turning and drifting, breathing (the scale changes). `--only two-places` draws two exposures in one
that lie farther apart than any trail, `--only pair,turned-pair` two of 5 to 400 px, alike or down to a tenth
of the light, of a field that turned between them or didn't, `--only beside` a bright one and a faint one that
is drawn out, `--only lesser` one and one to three fainter ones, `--only fading` trails that lose most of
their light, `--only reflected` each star once more beside itself, with 1 to 12 % of its light. `--sparse`
draws fields of half a degree alone, in which few stars are identified. Every fourth seed lays its path upon a
rendered frame (bins or cut-outs, the noise brought back to what it was), the others upon stars drawn here.

**Truth** is the flux-weighted mean of the path: the place of the sky whose light, gathered during the
exposure, has its mean at the frame's geometric center. For an even straight trail that is its middle; for
two exposures in one it lies between them. A path that rests at one place for half of its light or more
has two
right answers: its mean, and where it rested (its tail may be far below the noise).

An answer is right within 3 px of the truth (binned or cut-out pixels, as solved), and wrong beyond; a
refusal is fine, and counted by its reason. The chi-square is the mean of (true error / stated sigma)² per
coordinate over the right and wrong answers: 1 when the stated sigma is honest.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from benchmarks.frames import shared_folder
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.reading import read_frame
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import project
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, gnomonic_inverse, separation_arcsec
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings
from mountnav.solving.solve import solve

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

RIGHT_PX = 3.0
SHORTEST_PX, LONGEST_PX = 5.0, 400.0
BUDGET_S = 6.0
TOLD_EVERY = 100
EPOCH_YR = 2000.0
FULL_ADU = 60_000.0
RENDERED_EVERY = 4
MAIN_SHARE = 0.8
"""Of two exposures the one that has so much of the light is as right an answer as the mean of both: the
other's images are lost in the noise of most frames."""
STEP_PX = 0.5
"""Paths are drawn in steps of this."""


@dataclass(frozen=True, slots=True)
class Path2:
    """Where a star's light falls, beside its mean place: offsets, turns, shares; each of shape (n,).

    Attributes
    ----------
    dx_px, dy_px : ndarray
    turn_rad : ndarray
        Of the field about (`axis_x_px`, `axis_y_px`).
    share : ndarray
        Of the light; their sum is 1.
    axis_x_px, axis_y_px : float
    grown : ndarray or None
        Natural logarithm of the scale over that of the mean, about the same place; None if it stays.
    rests_px : (float, float) or None
        The middle of the part that has most of the light, where that is no single step.
    """

    dx_px: Array
    dy_px: Array
    turn_rad: Array
    share: Array
    axis_x_px: float = 0.0
    axis_y_px: float = 0.0
    grown: Array | None = None
    rests_px: tuple[float, float] | None = None

    @property
    def turned(self) -> NDArray[np.complex128]:
        """What distances from the axis are multiplied by."""
        grown = np.zeros_like(self.turn_rad) if self.grown is None else self.grown
        return np.asarray(np.exp(grown + 1j * self.turn_rad))

    @property
    def common(self) -> bool:
        """Whether all stars have the same path."""
        return not self.turn_rad.any() and self.grown is None

    @property
    def rest_px(self) -> tuple[float, float] | None:
        """Where it rests for half of its light or more; None where it doesn't."""
        if self.rests_px is not None:
            return self.rests_px
        most = int(np.argmax(self.share))
        if self.share.size == 1 or self.share[most] < 0.5 or not self.common:
            return None
        return float(self.dx_px[most]), float(self.dy_px[most])

    @property
    def length_px(self) -> float:
        """Greatest extent along x or y, turns not counted."""
        return float(max(np.ptp(self.dx_px), np.ptp(self.dy_px)))


@dataclass(frozen=True, slots=True)
class Trial:
    """A drawn frame and its truth."""

    kind: str
    told: str
    frame: Frame
    hint: Hint
    scale_arcsec_px: float
    truth: Icrs
    at_x_px: float
    at_y_px: float
    rest_px: tuple[float, float] | None = None

    def error_px(self, verdict: Verdict) -> float:
        """Distance of the solved place from the truth; NaN if not solved."""
        if verdict.solution is None:
            return math.nan
        places = [(0.0, 0.0)] if self.rest_px is None else [(0.0, 0.0), self.rest_px]
        return min(
            # what rested there has its light at that distance from the mean
            separation_arcsec(verdict.solution.icrs_at(self.at_x_px + dx, self.at_y_px + dy), self.truth)
            / self.scale_arcsec_px
            for dx, dy in places
        )


@dataclass(slots=True)
class Field:
    """What is drawn: stars, optics, sky."""

    x_px: Array
    y_px: Array
    flux: Array
    side_px: int
    fwhm_px: float
    sky_adu: float
    read_adu: float
    ghosts: list[tuple[float, float, float, float]] = field(default_factory=list)
    bleeds: bool = False


# -- paths ---------------------------------------------------------------------------------------------------


def _path(x: Array, y: Array, share: Array | None = None) -> Path2:
    """A path about its own mean."""
    share = np.ones(x.size) if share is None else share
    share = share / share.sum()
    return Path2(x - (x * share).sum(), y - (y * share).sum(), np.zeros(x.size), share)


def _length(rng: np.random.Generator, low: float = SHORTEST_PX, high: float = LONGEST_PX) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _steps(length: float) -> Array:
    return np.linspace(0.0, 1.0, max(2, math.ceil(length / STEP_PX) + 1))


def straight(rng: np.random.Generator) -> Path2:
    """One even trail in any direction."""
    length, angle = _length(rng), rng.uniform(0, math.tau)
    t = _steps(length) * length
    return _path(t * math.cos(angle), t * math.sin(angle))


def uneven(rng: np.random.Generator) -> Path2:
    """A straight trail whose light changes: cloud, or a motor that creeps and hurries."""
    length, angle = _length(rng), rng.uniform(0, math.tau)
    s = _steps(length)
    light = np.exp(rng.uniform(0.3, 1.2) * np.sin(math.tau * (rng.uniform(0.3, 2.5) * s + rng.random())))
    return _path(s * length * math.cos(angle), s * length * math.sin(angle), light)


def curved(rng: np.random.Generator, side_px: int = 1024) -> Path2:
    """The field turns about a place in or beside the frame, and may drift besides."""
    away, toward = rng.uniform(0.0, 3.0) * side_px, rng.uniform(0, math.tau)
    # the length is what the farthest corner is drawn out to
    length = _length(rng)
    swing = length / (away + 0.7 * side_px)
    drift = _length(rng, 1.0, 100.0) if rng.random() < 0.3 else 0.0
    angle = rng.uniform(0, math.tau)
    s = _steps(length + drift) - 0.5
    middle = 0.5 * (side_px - 1)
    return Path2(
        s * drift * math.cos(angle),
        s * drift * math.sin(angle),
        swing * s,
        np.full(s.size, 1.0 / s.size),
        middle + away * math.cos(toward),
        middle + away * math.sin(toward),
    )


def _field(
    rng: np.random.Generator, away_sides: tuple[float, float], *, turns: bool, grows: bool, drift: bool
) -> Path2:
    """The whole field turns or grows about a place so far from the frame's middle, and drifts, or not."""
    side_px = 1024
    away, toward = rng.uniform(*away_sides) * side_px, rng.uniform(0, math.tau)
    # what the farthest corner is drawn out to
    length = _length(rng, SHORTEST_PX, 150.0)
    swing = length / (away + 0.7 * side_px)
    along = _length(rng, 3.0, 150.0) if drift else 0.0
    angle = rng.uniform(0, math.tau)
    s = _steps(length + along) - 0.5
    how = rng.random()
    light = np.ones(s.size)
    if how < 0.2:  # cloud
        light = np.exp(rng.uniform(0.3, 1.2) * np.sin(math.tau * (rng.uniform(0.3, 2.5) * s + rng.random())))
    elif how < 0.4:  # two exposures
        light = np.where(np.abs(s) < rng.uniform(0.1, 0.45), 0.0, np.where(s < 0, 1.0, rng.uniform(0.3, 1.0)))
    light /= light.sum()
    s = s - (s * light).sum()
    middle = 0.5 * (side_px - 1)
    share = rng.uniform(0.3, 0.7) if turns and grows else 1.0
    grown = swing * (1.5 - share if turns else 1.0) * s
    if grows and rng.random() >= 0.5:
        grown = -grown
    return Path2(
        s * along * math.cos(angle),
        s * along * math.sin(angle),
        swing * share * s if turns else np.zeros(s.size),
        light,
        middle + away * math.cos(toward),
        middle + away * math.sin(toward),
        (1.0 if rng.random() < 0.5 else -1.0) * swing * (1.5 - share if turns else 1.0) * s
        if grows
        else None,
    )


def turning(rng: np.random.Generator) -> Path2:
    """The field turns about a place in the frame: what lies there are points, the corners are arcs."""
    return _field(rng, (0.0, 0.7), turns=True, grows=False, drift=False)


def turning_far(rng: np.random.Generator) -> Path2:
    """The field turns about a far place: trails whose length and direction change slowly over the frame."""
    return _field(rng, (1.0, 12.0), turns=True, grows=False, drift=rng.random() < 0.3)


def turning_drifting(rng: np.random.Generator) -> Path2:
    """The field turns about a place in or beside the frame, and drifts as much."""
    return _field(rng, (0.0, 1.5), turns=True, grows=False, drift=True)


def breathing(rng: np.random.Generator) -> Path2:
    """The scale changes (a zoom that slips, a focus that moves), and the field turns, or not."""
    return _field(rng, (0.0, 0.4), turns=rng.random() < 0.3, grows=True, drift=rng.random() < 0.3)


def jagged(rng: np.random.Generator) -> Path2:
    """A drift with periodic error and gusts, of any share."""
    length, angle = _length(rng), rng.uniform(0, math.tau)
    count = max(80, math.ceil(3.0 * length / STEP_PX))
    s = np.linspace(0.0, 1.0, count)
    drift = s * length * rng.uniform(0.0, 1.0)
    wave = 0.5 * length * rng.uniform(0, 1) * np.sin(math.tau * (rng.uniform(0.5, 4) * s + rng.random()))
    gust = np.cumsum(rng.standard_normal((2, count)), axis=1)
    gust = ndimage.gaussian_filter1d(gust, rng.uniform(1.0, 0.05 * count), axis=1)
    gust *= rng.uniform(0.0, 0.5) * length / max(float(np.ptp(gust)), 1e-9)
    along, across = drift + wave + gust[0], gust[1]
    c, n = math.cos(angle), math.sin(angle)
    fine = np.linspace(0.0, 1.0, 4 * count)
    along, across = np.interp(fine, s, along), np.interp(fine, s, across)
    return _path(along * c - across * n, along * n + across * c)


def gap(rng: np.random.Generator) -> Path2:
    """A straight trail with one to three gaps: a cloud, a shutter."""
    length, angle = _length(rng, 20.0), rng.uniform(0, math.tau)
    s = _steps(length)
    light = np.ones(s.size)
    for _ in range(int(rng.integers(1, 4))):
        start, wide = rng.uniform(0.1, 0.8), rng.uniform(0.05, 0.3)
        light[(s > start) & (s < start + wide)] = 0.0
    return _path(s * length * math.cos(angle), s * length * math.sin(angle), light)


def double(rng: np.random.Generator) -> Path2:
    """Two (or three) exposures in one, 5 to 400 px apart, each perhaps somewhat trailed."""
    count = 2 if rng.random() < 0.8 else 3
    parts = []
    x, y = 0.0, 0.0
    for _ in range(count):
        length, angle = float(rng.choice([0.0, 0.0, rng.uniform(2, 40)])), rng.uniform(0, math.tau)
        s = _steps(length)
        weight = np.full(s.size, rng.uniform(0.25, 1.0) / s.size)
        parts.append((x + s * length * math.cos(angle), y + s * length * math.sin(angle), weight))
        away, toward = _length(rng), rng.uniform(0, math.tau)
        x, y = x + away * math.cos(toward), y + away * math.sin(toward)
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return _path(joined[0], joined[1], joined[2])


def two_places(rng: np.random.Generator) -> Path2:
    """Two exposures in one, or a slew with the shutter open: 420 to 900 px apart, each perhaps trailed."""
    share = rng.uniform(0.25, 1.0, 2)
    away, toward = rng.uniform(420.0, 900.0), rng.uniform(0, math.tau)
    parts = []
    for k, weight in enumerate(share):
        length, angle = float(rng.choice([0.0, rng.uniform(2, 40)])), rng.uniform(0, math.tau)
        s = _steps(length)
        x, y = k * away * math.cos(toward), k * away * math.sin(toward)
        parts.append(
            (
                x + s * length * math.cos(angle),
                y + s * length * math.sin(angle),
                np.full(s.size, weight / s.size),
            )
        )
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    path = _path(joined[0], joined[1], joined[2])
    brighter = parts[int(np.argmax(share))]
    middle = len(brighter[0]) // 2 + (len(parts[0][0]) if share[1] > share[0] else 0)
    return replace(path, rests_px=(float(path.dx_px[middle]), float(path.dy_px[middle])))


def pair(rng: np.random.Generator) -> Path2:
    """Two exposures in one, 5 to 400 px apart, the lesser with a tenth to all of the other's light."""
    ratio = math.exp(rng.uniform(math.log(0.1), 0.0))
    apart, toward = _length(rng), rng.uniform(0, math.tau)
    parts = []
    for k, weight in enumerate((1.0, ratio)):
        length, angle = float(rng.choice([0.0, 0.0, rng.uniform(2, 40)])), rng.uniform(0, math.tau)
        s = _steps(length) - 0.5
        parts.append(
            (
                k * apart * math.cos(toward) + s * length * math.cos(angle),
                k * apart * math.sin(toward) + s * length * math.sin(angle),
                np.full(s.size, weight / s.size),
            )
        )
    return _resting(parts, ratio)


def beside(rng: np.random.Generator) -> Path2:
    """A point or a short trail and, 8 to 45 px away, a fainter exposure that is drawn out."""
    ratio = math.exp(rng.uniform(math.log(0.13), math.log(0.5)))
    apart, toward = rng.uniform(8, 45), rng.uniform(0, math.tau)
    parts = []
    for k, weight in enumerate((1.0, ratio)):
        length = float(rng.choice([0.0, rng.uniform(2, 15)])) if k == 0 else rng.uniform(10, 45)
        angle = rng.uniform(0, math.tau)
        s = _steps(length) - 0.5
        parts.append(
            (
                k * apart * math.cos(toward) + s * length * math.cos(angle),
                k * apart * math.sin(toward) + s * length * math.sin(angle),
                np.full(s.size, weight / s.size),
            )
        )
    return _resting(parts, ratio)


def lesser(rng: np.random.Generator) -> Path2:
    """An exposure and one to three with a tenth to a half of its light each, 10 to 200 px away."""
    parts, light = [], []
    for k in range(1 + int(rng.choice([1, 1, 2, 3]))):
        weight = 1.0 if k == 0 else math.exp(rng.uniform(math.log(0.1), math.log(0.5)))
        length = float(rng.choice([0.0, rng.uniform(2, 12) if k == 0 else rng.uniform(5, 60)]))
        angle, toward = rng.uniform(0, math.tau), rng.uniform(0, math.tau)
        apart = 0.0 if k == 0 else _length(rng, 10.0, 200.0)
        s = _steps(length) - 0.5
        parts.append(
            (
                apart * math.cos(toward) + s * length * math.cos(angle),
                apart * math.sin(toward) + s * length * math.sin(angle),
                np.full(s.size, weight / s.size),
            )
        )
        light.append(weight)
    return _resting(parts, sum(light[1:]))


def fading(rng: np.random.Generator) -> Path2:
    """A straight trail that fades to a tenth or less (a cloud), and may begin with a rest or a shake."""
    length, angle = _length(rng, 10.0), rng.uniform(0, math.tau)
    s = _steps(length)
    light = np.exp(-rng.uniform(2.0, 6.0) * s ** rng.uniform(0.5, 2.0))
    how = rng.random()
    if how < 0.3:
        light[0] += rng.uniform(0.3, 2.0) * light.sum()
    x, y = s * length, np.zeros(s.size)
    if how > 0.7:
        swing = rng.uniform(0.02, 0.2) * length * np.exp(-6.0 * s)
        y = swing * np.sin(math.tau * rng.uniform(5, 20) * s)
    c, n = math.cos(angle), math.sin(angle)
    return _path(x * c - y * n, x * n + y * c, light)


def reflected(rng: np.random.Generator) -> Path2:
    """Each star once more beside itself, blurred, with 1 to 12 % of its light: a filter's two faces."""
    ratio, apart = math.exp(rng.uniform(math.log(0.01), math.log(0.12))), _length(rng, 8.0, 200.0)
    toward, blur = rng.uniform(0, math.tau), rng.uniform(0.0, 6.0)
    r = blur * np.sqrt((np.arange(40) + 0.5) / 40)
    turn = np.arange(40) * math.pi * (3.0 - math.sqrt(5.0))
    parts = [
        (np.zeros(1), np.zeros(1), np.ones(1)),
        (
            apart * math.cos(toward) + r * np.cos(turn),
            apart * math.sin(toward) + r * np.sin(turn),
            np.full(40, ratio / 40),
        ),
    ]
    return _resting(parts, ratio)


def _resting(parts: list[tuple[Array, Array, Array]], ratio: float) -> Path2:
    """Two exposures as a path; the first is as right an answer as the mean where it has most of the light."""
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    path = _path(joined[0], joined[1], joined[2])
    if 1.0 / (1.0 + ratio) < MAIN_SHARE:
        return path
    first = parts[0][0].size // 2
    return replace(path, rests_px=(float(path.dx_px[first]), float(path.dy_px[first])))


def turned_pair(rng: np.random.Generator) -> Path2:
    """Two exposures of points, the field turned between them, 5 to 400 px apart at the frame's middle."""
    middle, ratio = 0.5 * 1023, rng.uniform(0.25, 1.0)
    away, toward = rng.uniform(0.0, 3.0) * 1024, rng.uniform(0, math.tau)
    turn = _length(rng, 2.0, LONGEST_PX) / (away + 0.7 * 1024) * float(rng.choice([-1.0, 1.0]))
    apart, angle = _length(rng), rng.uniform(0, math.tau)
    share = np.array([1.0, ratio]) / (1.0 + ratio)
    s = np.array([0.0, 1.0]) - share[1]
    axis_x, axis_y = middle + away * math.cos(toward), middle + away * math.sin(toward)
    # how far the turn alone takes the frame's middle is a part of it
    own = complex(middle - axis_x, middle - axis_y) * 1j * turn
    drift = apart * complex(math.cos(angle), math.sin(angle)) - own
    return Path2(s * drift.real, s * drift.imag, s * turn, share, axis_x, axis_y)


def double10(rng: np.random.Generator) -> Path2:
    """Two exposures in one, about 10 px apart, alike bright or not."""
    away, toward = rng.uniform(6, 14), rng.uniform(0, math.tau)
    x, y = np.array([0.0, away * math.cos(toward)]), np.array([0.0, away * math.sin(toward)])
    return _path(x, y, np.array([1.0, rng.uniform(0.3, 1.0)]))


def shaken(rng: np.random.Generator) -> Path2:
    """A tube struck once: it swings and comes to rest."""
    swing, angle = _length(rng, 5.0, 100.0), rng.uniform(0, math.tau)
    decay, periods = rng.uniform(0.02, 0.15), rng.uniform(10, 40)
    t = np.linspace(0.0, 1.0, 4000)
    along = swing * np.exp(-t / decay) * np.cos(math.tau * periods * t)
    across = 0.3 * swing * np.exp(-t / decay) * np.sin(math.tau * periods * t)
    c, n = math.cos(angle), math.sin(angle)
    return _path(along * c - across * n, along * n + across * c)


def stop_and_go(rng: np.random.Generator) -> Path2:
    """Begun before the mount stood still, or a slew begun before the shutter closed: a point with a tail."""
    length, angle, rest = _length(rng), rng.uniform(0, math.tau), rng.uniform(0.3, 0.95)
    s = _steps(length) * length
    light = np.full(s.size, (1.0 - rest) / s.size)
    light[0] += rest
    if rng.random() < 0.3:
        other = rng.uniform(0.0, 0.5) * rest
        light[0] -= other
        light[-1] += other
    return _path(s * math.cos(angle), s * math.sin(angle), light)


def spiked(rng: np.random.Generator) -> Path2:
    """Diffraction spikes: four or six arms with a share of the light."""
    arms, length = int(rng.choice([4, 6])), _length(rng, 20.0, 200.0)
    angle, share = rng.uniform(0, math.tau), rng.uniform(0.03, 0.3)
    r = np.arange(1.0, length, STEP_PX)
    fade = np.exp(-2.0 * r / length)
    x, y, light = [np.zeros(1)], [np.zeros(1)], [np.array([1.0 - share])]
    for arm in range(arms):
        a = angle + math.tau * arm / arms
        x.append(r * math.cos(a))
        y.append(r * math.sin(a))
        light.append(share / arms * fade / fade.sum())
    return _path(np.concatenate(x), np.concatenate(y), np.concatenate(light))


def still(_: np.random.Generator) -> Path2:
    """Points."""
    return _path(np.zeros(1), np.zeros(1))


PATHS: dict[str, Callable[[np.random.Generator], Path2]] = {
    "straight": straight,
    "curved": curved,
    "jagged": jagged,
    "gap": gap,
    "uneven": uneven,
    "double": double,
    "double10": double10,
    "shaken": shaken,
    "stop-and-go": stop_and_go,
    "ghost": still,
    "spikes": spiked,
    "bleeds": still,
    "clean": still,
    "dim": still,
    "crowded": still,
}
MOVED = ("straight", "gap", "uneven", "jagged", "double", "double10", "stop-and-go", "shaken")
"""Kinds that may be laid upon rendered frames."""
FIELDS: dict[str, Callable[[np.random.Generator], Path2]] = {
    "turning": turning,
    "turning-far": turning_far,
    "turning-drift": turning_drifting,
    "breathing": breathing,
}
FAR: dict[str, Callable[[np.random.Generator], Path2]] = {
    "two-places": two_places,
    "pair": pair,
    "turned-pair": turned_pair,
    "beside": beside,
    "lesser": lesser,
    "fading": fading,
    "reflected": reflected,
}
"""Drawn on demand only. The brighter of two places is as right as the mean, if they are out of each other's
reach or it has `MAIN_SHARE` of the light."""
FIELD_SEEDS = 50_000
"""Seeds from here on draw these as well; below, a seed's frame is what it was when its outcome was told."""
OFTEN = ("straight", "straight", "curved", "jagged", "gap", "double")
"""Drawn besides, so that they come twice as often."""


# -- frames --------------------------------------------------------------------------------------------------


def drawn(field: Field, path: Path2, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Light along the paths, blurred, with noise."""
    side = field.side_px
    margin = 8
    light = np.zeros((side + 2 * margin, side + 2 * margin))

    def add(x: Array, y: Array, flux: Array) -> None:
        left, low = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        fx, fy = x - left, y - low
        for dx, dy, part in (
            (0, 0, (1 - fx) * (1 - fy)),
            (1, 0, fx * (1 - fy)),
            (0, 1, (1 - fx) * fy),
            (1, 1, fx * fy),
        ):
            column, row = left + dx + margin, low + dy + margin
            inside = (column >= 0) & (row >= 0) & (column < light.shape[1]) & (row < light.shape[0])
            flat = row[inside] * light.shape[1] + column[inside]
            light.reshape(-1)[...] += np.bincount(flat, (flux * part)[inside], minlength=light.size)

    cos, sin = path.turned.real, path.turned.imag
    reach = path.length_px + 10.0
    near = np.ones(field.x_px.size, dtype=bool)
    if path.common:
        near = (np.abs(field.x_px - side / 2) < side / 2 + reach) & (
            np.abs(field.y_px - side / 2) < side / 2 + reach
        )
    for part in np.array_split(
        np.flatnonzero(near), max(1, int(near.sum()) * path.share.size // 2_000_000 + 1)
    ):
        from_x, from_y = field.x_px[part, None] - path.axis_x_px, field.y_px[part, None] - path.axis_y_px
        x = path.axis_x_px + from_x * cos - from_y * sin + path.dx_px
        y = path.axis_y_px + from_x * sin + from_y * cos + path.dy_px
        add(x.ravel(), y.ravel(), (field.flux[part, None] * path.share).ravel())
    sigma = field.fwhm_px / 2.3548
    light = ndimage.gaussian_filter(light, sigma)
    for center_x, center_y, strength, blur in field.ghosts:
        ghost = np.zeros_like(light)
        direct, light = light, ghost
        add(2 * center_x - field.x_px, 2 * center_y - field.y_px, strength * field.flux)
        light = direct + ndimage.gaussian_filter(ghost, math.hypot(sigma, blur))
    light = light[margin:-margin, margin:-margin]
    light = light + field.sky_adu
    light = light + np.sqrt(light + field.read_adu**2) * rng.standard_normal(light.shape)
    if field.bleeds:
        for k in np.argsort(-field.flux)[:12]:
            column, row = round(float(field.x_px[k])), round(float(field.y_px[k]))
            if 1 <= column < side - 1 and 0 <= row < side:
                half = int(rng.integers(10, 300))
                light[max(0, row - half) : row + half, column - 1 : column + 2] = FULL_ADU
    return np.clip(np.rint(light + 300.0), 0, FULL_ADU).astype(np.uint16)


def field_of(kind: str, rng: np.random.Generator, optics: SimulatedOptics, center: Icrs) -> Field:
    """Catalog stars, 2 % of them lost, with 0.2 mag of scatter, and faint ones that no catalog holds."""
    side = optics.width_px
    radius_deg = 0.75 * side * optics.scale_arcsec_px / 3600.0 + 450 * optics.scale_arcsec_px / 3600.0
    stars = embedded_catalog().cone(center, radius_deg, epoch_yr=EPOCH_YR)
    x, y = project(center, optics, stars.ra_deg, stars.dec_deg)
    mag = np.where(np.isfinite(stars.mag), stars.mag, 11.5)
    keep = np.isfinite(x) & (rng.random(x.size) > 0.02)
    x, y, mag = x[keep], y[keep], mag[keep] + 0.2 * rng.standard_normal(int(keep.sum()))
    bright = max(1, int((mag < 11.0).sum()))
    deeper = {"crowded": 4.5, "dim": 2.0}.get(kind, rng.uniform(1.5, 3.5))
    count = min(20_000, rng.poisson(bright * (10 ** (0.35 * deeper) - 1.0)))
    reach = 0.5 * side + 450
    middle = 0.5 * (side - 1)
    faint_x, faint_y = middle + rng.uniform(-reach, reach, (2, count))
    faint = 11.0 + np.log10(1.0 + rng.random(count) * (10 ** (0.35 * deeper) - 1.0)) / 0.35
    tenth = math.exp(rng.uniform(math.log(4e3), math.log(2e5)))
    if kind == "dim":
        tenth = math.exp(rng.uniform(math.log(500.0), math.log(3e3)))
    flux = tenth * 10 ** (-0.4 * (np.concatenate((mag, faint)) - 10.0))
    return Field(
        np.concatenate((x, faint_x)),
        np.concatenate((y, faint_y)),
        flux,
        side,
        optics.fwhm_px,
        sky_adu=math.exp(rng.uniform(math.log(20.0), math.log(800.0))),
        read_adu=8.0,
    )


SCALES = (2.6, 3.6, 4.5, 6.0, 9.0)
"""Of the frames, arcsec per pixel."""
SPARSE_SCALES = (1.9, 2.2, 2.6, 2.6)
"""The same, where few stars are to be identified."""


def _upon_stars(
    kind: str, path: Path2, rng: np.random.Generator, scales: tuple[float, ...] = SCALES
) -> Trial:
    side = int(rng.choice([768, 1024]))
    scale = float(rng.choice(scales))
    ra, dec = rng.uniform(0, 360), math.degrees(math.asin(rng.uniform(-0.98, 0.98)))
    center = Icrs(ra, dec)
    optics = SimulatedOptics(
        side,
        side,
        scale,
        rotation_deg=float(rng.uniform(0, 360)),
        parity=int(rng.choice([-1, 1])),
        fwhm_px=float(rng.uniform(2.0, 4.5)),
    )
    drawing = field_of(kind, rng, optics, center)
    middle = 0.5 * (side - 1)
    if kind == "ghost":
        for _ in range(int(rng.integers(1, 3))):
            off_x, off_y = rng.normal(0, 0.1 * side, 2)
            drawing.ghosts.append(
                (middle + off_x, middle + off_y, math.exp(rng.uniform(-4, -0.7)), rng.uniform(0, 3))
            )
    drawing.bleeds = kind == "bleeds"
    pixels = drawn(drawing, path, rng)
    truth = center
    if not path.common:
        # the place whose mean image is the middle: the mean of the turns shrinks distances from the axis
        mean = complex((path.share * path.turned).sum())
        off = complex(middle - path.axis_x_px, middle - path.axis_y_px) / mean
        truth = _sky_at(center, optics, path.axis_x_px + off.real, path.axis_y_px + off.imag)
    hint = _hint(rng, center, scale, side)
    frame = _frame(pixels)
    told = f"{side} px of {scale}″, FWHM {optics.fwhm_px:.1f}, {path.length_px:.0f} px"
    rest = path.rest_px if kind in ("stop-and-go", *FAR) else None
    return Trial(kind, told, frame, hint, scale, truth, middle, middle, rest)


def _sky_at(center: Icrs, optics: SimulatedOptics, x: float, y: float) -> Icrs:
    """Inverse of `project` without distortion."""
    px = math.radians(optics.scale_arcsec_px / 3600.0)
    right, up = (x - 0.5 * (optics.width_px - 1)) * optics.parity, y - 0.5 * (optics.height_px - 1)
    s, c = math.sin(math.radians(optics.rotation_deg)), math.cos(math.radians(optics.rotation_deg))
    ra, dec = gnomonic_inverse(
        np.array([(up * s - right * c) * px]),
        np.array([(up * c + right * s) * px]),
        center.ra_deg,
        center.dec_deg,
    )
    return Icrs(float(ra[0]) % 360.0, float(dec[0]))


def _frame(pixels: NDArray[np.uint16]) -> Frame:
    return Frame(
        pixels=pixels,
        mid_exposure_utc=datetime(2000, 1, 1, 12, tzinfo=UTC),
        exposure_s=10.0,
        saturation_adu=FULL_ADU,
        source="drawn",
    )


def _hint(rng: np.random.Generator, center: Icrs, scale: float, side_px: int) -> Hint:
    off = rng.normal(0, 0.3, 2)
    at = displaced(center, float(off[0]) * 3600.0, float(off[1]) * 3600.0)
    told = scale * rng.uniform(0.97, 1.03)
    return Hint(at, 1.0 if rng.random() < 0.8 else 4.0, told / 1.05, told * 1.05)


@cache
def _truths() -> list[dict[str, object]]:
    folder: Path = shared_folder() / "data" / "rendered"
    entries = json.loads((folder / "truth.json").read_text())
    return [one for one in entries if one["file"][0] in "ABCE"]


@cache
def _read(name: str) -> NDArray[np.float32]:
    return read_frame(shared_folder() / "data" / "rendered" / name).pixels.astype(np.float32)


def _upon_rendered(kind: str, path: Path2, rng: np.random.Generator) -> Trial:
    truths = _truths()
    one = truths[int(rng.integers(len(truths)))]
    pixels = _read(str(one["file"]))
    ra, dec, scale = float(one["ra"]), float(one["dec"]), float(one["scale"])  # type: ignore[arg-type]
    height, width = pixels.shape
    truth = Icrs(ra, dec)
    at_x, at_y = 0.5 * (width - 1), 0.5 * (height - 1)
    if rng.random() < 0.5 or one["preset"] == "E":
        even = pixels[: height // 2 * 2, : width // 2 * 2]
        pixels = even.reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))
        at_x, at_y, scale = 0.5 * (at_x - 0.5), 0.5 * (at_y - 0.5), 2.0 * scale
    else:
        test = one["test"]
        assert isinstance(test, dict)
        inside = [
            k
            for k in range(len(test["x"]))
            if 520 < test["x"][k] < width - 520 and 520 < test["y"][k] < height - 520
        ]
        k = inside[int(rng.integers(len(inside)))]
        left, low = round(test["x"][k]) - 512, round(test["y"][k]) - 512
        pixels = pixels[low : low + 1024, left : left + 1024]
        truth = Icrs(test["ra"][k], test["dec"][k])
        at_x, at_y = test["x"][k] - left, test["y"][k] - low
    frame = replace(_frame(_laid(pixels, path, rng)), saturation_adu=None)
    hint = _hint(rng, truth, scale, pixels.shape[0])
    rest = path.rest_px if kind in ("stop-and-go", *FAR) else None
    told = f"{one['file']} {path.length_px:.0f} px"
    return Trial(kind, told, frame, hint, scale, truth, at_x, at_y, rest)


def _laid(pixels: Pixels, path: Path2, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Convolve with a path, and bring the noise back to what it was."""
    sky = float(np.median(pixels))
    noise = sky - float(np.percentile(pixels[::5, ::5], 15.8655))
    reach = math.ceil(max(np.abs(path.dx_px).max(), np.abs(path.dy_px).max())) + 2
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    left, low = np.floor(path.dx_px).astype(int), np.floor(path.dy_px).astype(int)
    fx, fy = path.dx_px - left, path.dy_px - low
    for dx, dy, part in (
        (0, 0, (1 - fx) * (1 - fy)),
        (1, 0, fx * (1 - fy)),
        (0, 1, (1 - fx) * fy),
        (1, 1, fx * fy),
    ):
        np.add.at(kernel, (low + dy + reach, left + dx + reach), path.share * part)
    wide = np.pad(pixels, reach, mode="reflect")
    shape = [fft.next_fast_len(side, real=True) for side in wide.shape]
    product = fft.rfft2(wide - sky, s=shape) * fft.rfft2(kernel.astype(np.float32), s=shape)
    image = fft.irfft2(product, s=shape)
    image = image[2 * reach : 2 * reach + pixels.shape[0], 2 * reach : 2 * reach + pixels.shape[1]]
    lost = noise**2 * max(0.0, 1.0 - float((kernel**2).sum()))
    image = image + sky + math.sqrt(lost) * rng.standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 65_535).astype(np.uint16)


def trial(seed: int, only: tuple[str, ...] = (), *, sparse: bool = False) -> Trial:
    """The frame of a seed."""
    rng = np.random.default_rng(seed)
    kinds = only or (*PATHS, *OFTEN, *(FIELDS if seed >= FIELD_SEEDS else ()))
    kind = kinds[int(rng.integers(len(kinds)))]
    path = (PATHS | FIELDS | FAR)[kind](rng)
    if kind in MOVED and seed % RENDERED_EVERY == 0 and not sparse:
        return _upon_rendered(kind, path, rng)
    return _upon_stars(kind, path, rng, SPARSE_SCALES if sparse else SCALES)


def ways(seed: int) -> SolveSettings:
    """A glance first, as ever; every third measured in full at once."""
    return SolveSettings(glance=seed % 3 != 0, budget_s=BUDGET_S)


@dataclass(slots=True)
class Tally:
    """What came of the frames of one kind."""

    right: int = 0
    wrong: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    squares: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)

    @property
    def frames(self) -> int:
        """All of them."""
        return self.right + self.wrong + sum(self.refused.values())

    def take(self, error_px: float, sigma_px: float, reason: str) -> bool:
        """Count one; whether it was wrong."""
        if math.isnan(error_px):
            self.refused[reason] += 1
            return False
        self.squares.append(0.5 * (error_px / sigma_px) ** 2)
        self.errors.append(error_px)
        wrong = error_px > RIGHT_PX
        self.wrong += wrong
        self.right += not wrong
        return wrong

    def so_far(self, frames: int, seed: int) -> str:
        """What came until this seed, should the run be cut short."""
        chi2 = float(np.mean(self.squares)) if self.squares else math.nan
        refused = sum(self.refused.values())
        return (
            f"{frames} frames, up to seed {seed}: {self.right} right, {refused} refused, "
            f"{self.wrong} wrong, chi² {chi2:.2f}"
        )

    def row(self, name: str) -> str:
        """For the table."""
        reasons = ", ".join(f"{count} {reason}" for reason, count in self.refused.most_common(4))
        chi2 = float(np.mean(self.squares)) if self.squares else math.nan
        median = float(np.median(self.errors)) if self.errors else math.nan
        return (
            f"| {name} | {self.frames} | {self.right} | {sum(self.refused.values())} | {self.wrong} | "
            f"{median:.3f} | {chi2:.2f} | {reasons} |"
        )


@dataclass(frozen=True, slots=True)
class Kept:
    """Outcomes in a file, a line each.

    Attributes
    ----------
    path : Path
    code : str
        Which state of the code made them.
    """

    path: Path
    code: str

    @classmethod
    def at(cls, path: Path) -> Kept:
        """The file of that path, begun or to be begun.

        Raises
        ------
        SystemExit
            It was made by another state of the code.
        """
        root = Path(__file__).parents[1]
        digest = hashlib.sha256()
        for source in [*sorted((root / "mountnav").rglob("*.py")), Path(__file__)]:
            digest.update(source.read_bytes())
        kept = cls(path, digest.hexdigest()[:16])
        if any(one["code"] != kept.code for one in kept.lines()):
            raise SystemExit(f"{path} was made by another state of the code: give another file")
        return kept

    def lines(self) -> list[dict[str, Any]]:
        """All that was kept; a last line that was cut short is none."""
        found = []
        if self.path.exists():
            for line in self.path.read_text().splitlines():
                try:
                    found.append(json.loads(line))
                except ValueError:
                    continue
        return found

    def add(self, seed: int, kind: str, error_px: float, sigma_px: float, reason: str) -> None:
        """Keep one."""
        one = {"seed": seed, "kind": kind, "reason": reason, "code": self.code}
        if not math.isnan(error_px):
            one |= {"error_px": error_px, "sigma_px": sigma_px}
        # a line end before it: what a killed run left half written stays a line of its own
        ended = not self.path.exists() or self.path.read_bytes()[-1:] in (b"", b"\n")
        with self.path.open("a") as file:
            file.write(("" if ended else "\n") + json.dumps(one) + "\n")

    def tallies(self) -> dict[str, Tally]:
        """What the file holds, by kind; a seed that two processes ran counts once."""
        found: dict[str, Tally] = defaultdict(Tally)
        for one in {one["seed"]: one for one in self.lines()}.values():
            error, sigma = one.get("error_px", math.nan), one.get("sigma_px", math.nan)
            if found[one["kind"]].take(error, sigma, one["reason"]):
                print(f"WRONG {one['seed']} {one['kind']}: {error:.2f} px, sigma {sigma:.3f} px")
        return found


def _summed(tallies: dict[str, Tally]) -> Tally:
    total = Tally()
    for tally in tallies.values():
        total.right += tally.right
        total.wrong += tally.wrong
        total.refused += tally.refused
        total.squares += tally.squares
        total.errors += tally.errors
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--only", default="", help="kinds, with commas")
    parser.add_argument("--sparse", action="store_true", help="fields of half a degree")
    parser.add_argument("--seconds", type=float, default=math.inf, help="of wall time, then the table")
    parser.add_argument("--told", action="store_true", help="a line for every frame")
    parser.add_argument("--into", type=Path, help="a file that keeps the outcomes, and goes on from them")
    given = parser.parse_args()
    kept = None if given.into is None else Kept.at(given.into)
    held = set() if kept is None else {one["seed"] for one in kept.lines()}
    only = tuple(one for one in given.only.split(",") if one)
    tallies: dict[str, Tally] = defaultdict(Tally)
    spent, done, until = 0.0, 0, time.monotonic() + given.seconds
    for seed in range(given.first, given.first + given.frames):
        if time.monotonic() > until:
            break
        if seed in held:
            continue
        one = trial(seed, only, sparse=given.sparse)
        done += 1
        began = time.process_time()
        verdict = solve(one.frame, embedded_catalog(), hint=one.hint, settings=ways(seed))
        spent += time.process_time() - began
        error = one.error_px(verdict)
        solution = verdict.solution
        sigma = solution.center_sigma_arcsec / one.scale_arcsec_px if solution else math.nan
        reason = verdict.reason.name if verdict.reason else ""
        wrong = tallies[one.kind].take(error, sigma, reason)
        if kept is not None:
            kept.add(seed, one.kind, error, sigma, reason)
        if done % TOLD_EVERY == 0:
            print(_summed(tallies).so_far(done, seed), flush=True)
        if wrong or given.told:
            odds = (
                f"odds {solution.false_probability:.0e}, {solution.pairs} pairs"
                if solution
                else verdict.detail
            )
            print(
                f"{'WRONG' if wrong else 'frame'} {seed} {one.kind} ({one.told}): {error:.2f} px, "
                f"sigma {sigma:.3f} px, {odds}",
                flush=True,
            )
    if kept is not None:
        tallies = kept.tallies()
    titles = ("kind", "frames", "right", "refused", "wrong", "error px (median)", "chi²", "reasons")
    print(f"\n| {' | '.join(titles)} |\n{'|---' * len(titles)}|")
    for kind in (*PATHS, *FIELDS, *FAR):
        if kind in tallies:
            print(tallies[kind].row(kind))
    print(_summed(tallies).row("all"))
    print(f"\n{spent / max(done, 1):.2f} s of one processor per frame")


if __name__ == "__main__":
    main()
