"""Try to get a wrong answer out of the blind search: random star lists, and sky lists that are spoiled.

Run: python -m benchmarks.blind_trials [10000] [--seed 11] [--budget 0.1]

Every list is searched for all over the sky, with no hint of place or scale. The truth of each is known: a
list that is no sky has no right answer; one that shows a sky may be found there (3 px, 1 % in scale) and
nowhere else. Every fiftieth list gets twenty times the budget (seconds of wall time). In turn:

even, clustered, raster   sources strewn at random: evenly, in clumps and along lines, on a raster of pixels
scrambled   a sky, its brightnesses dealt out again and some of its stars gone
bent        a sky squeezed or twisted as no camera does; right is what puts the middle within 2 % of the frame
two skies   two places in one list, each turned and scaled its own way
too faint   what a small field shows below the catalog's depth, with the few stars the catalog does hold
buried      a sky of which 70 % are no stars
sky         a plain sky, with a tenth of it false: to show that the search does find what is there
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.wrong_answers import star_list
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.star_counts import stars_round
from mountnav.frames import Hint
from mountnav.identification.blind.cache import cached_index
from mountnav.identification.blind.index import BlindIndex
from mountnav.identification.search import Reach, identify
from mountnav.identification.verification import Identified
from mountnav.measuring.measurements import Measurements
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import project
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

Array = NDArray[np.float64]

EPOCH_YR = 2026.2
PATIENT_EVERY, PATIENCE = 50, 20.0
NOT_ALL = 0.9
"""Share of a sky's stars that were seen at all."""


@dataclass(frozen=True, slots=True)
class Truth:
    """A place that a list shows, the scale it is shown at, and how far off an answer may be."""

    center: Icrs
    scale_arcsec_px: float
    right_px: float = 3.0
    right_scale: float = 0.01

    def holds(self, center: Icrs, scale_arcsec_px: float) -> bool:
        """Whether an answer is this place."""
        off_px = separation_arcsec(center, self.center) / self.scale_arcsec_px
        return off_px <= self.right_px and abs(scale_arcsec_px / self.scale_arcsec_px - 1) <= self.right_scale


@dataclass(frozen=True, slots=True)
class Trial:
    """A list with its truths; none if it is no sky."""

    kind: str
    measurements: Measurements
    truths: tuple[Truth, ...] = ()


@dataclass(slots=True)
class Tally:
    """What came of the trials of one kind."""

    right: int = 0
    wrong: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    least_refused: float = 1.0
    least_wrong: float = 1.0

    def add(self, trial: Trial, got: Identified) -> bool:
        """Count an outcome; True if the answer is wrong."""
        if got.reference is None:
            self.refused[str(got.reason)] += 1
            if not trial.truths:
                self.least_refused = min(self.least_refused, got.false_probability)
            return False
        plate = got.reference.plate
        if any(truth.holds(plate.center(), plate.scale_arcsec_px()) for truth in trial.truths):
            self.right += 1
            return False
        self.wrong += 1
        self.least_wrong = min(self.least_wrong, got.false_probability)
        return True


def anywhere(rng: np.random.Generator) -> Icrs:
    """A random place, even on the sphere."""
    return Icrs(float(rng.uniform(0, 360)), math.degrees(math.asin(rng.uniform(-1, 1))))


def frame_size(rng: np.random.Generator) -> tuple[int, int]:
    """Width and height of a frame, pixels."""
    longer = int(rng.integers(500, 4100))
    return longer, int(longer * rng.choice((1.0, 0.75, 0.667)))


def no_sky(rng: np.random.Generator, kind: str) -> Trial:
    """A list of 6 to 300 sources where no star is."""
    width, height = frame_size(rng)
    count = int(10 ** rng.uniform(math.log10(6), math.log10(300)))
    x, y = rng.uniform(0, width - 1, count), rng.uniform(0, height - 1, count)
    if kind == "clustered":
        many = rng.random(count) < 0.7
        clump = rng.integers(0, int(rng.integers(1, 6)), count)
        for axis, side in ((x, width), (y, height)):
            middles = rng.uniform(0, side, int(clump.max()) + 1)
            axis[many] = (middles[clump] + 0.07 * side * rng.standard_normal(count))[many]
        slope = rng.uniform(-1, 1)
        line = rng.random(count) < 0.15
        y[line] = 0.5 * height + slope * (x[line] - 0.5 * width) + rng.normal(0, 2, int(line.sum()))
    elif kind == "raster":
        step = float(rng.choice((8.0, 16.0, 64.0, width / 9, width / 23)))
        x, y = np.round(x / step) * step, np.round(y / step) * step
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    # no two sources are one
    _, first = np.unique(np.round(np.stack((x, y)) / 3.0), axis=1, return_index=True)
    x, y = x[first], y[first]
    return Trial(kind, star_list(x, y, rng.pareto(1.2, x.size) + 1.0, width, height))


def sky(
    rng: np.random.Generator, width: int, height: int, field_deg: float, most: int
) -> tuple[Array, Array, Array, Truth]:
    """Stars of a random place as a camera sees them: x, y, flux, and where it is.

    A tenth of the stars is missing, magnitudes are off by 0.3, places by 0.2 px; the lens has its distortion.
    """
    optics = SimulatedOptics(
        width,
        height,
        field_deg * 3600.0 / min(width, height),
        rotation_deg=float(rng.uniform(0, 360)),
        parity=int(rng.choice((-1, 1))),
        distortion_px2=float(rng.uniform(-2, 4)) * 1e-3 / (0.25 * (width**2 + height**2)),
    )
    center = anywhere(rng)
    radius_deg = 1.02 * optics.half_diagonal_deg
    stars = stars_round(embedded_catalog(), center, radius_deg, 2 * most, epoch_yr=EPOCH_YR)
    x, y = project(center, optics, stars.ra_deg, stars.dec_deg)
    seen = (x > 0) & (x < width - 1) & (y > 0) & (y < height - 1) & (rng.random(x.size) < NOT_ALL)
    mag = np.where(np.isfinite(stars.mag), stars.mag, 12.0)[seen] + rng.normal(0, 0.3, int(seen.sum()))
    order = np.argsort(mag)[:most]
    x, y = x[seen][order], y[seen][order]
    x, y = x + rng.normal(0, 0.2, x.size), y + rng.normal(0, 0.2, y.size)
    return x, y, 10 ** (-0.4 * (mag[order] - 20.0)), Truth(center, optics.scale_arcsec_px)


def spoiled(rng: np.random.Generator, kind: str) -> Trial:
    """A list made of a sky, or of two."""
    width, height = frame_size(rng)
    field_deg = float(10 ** rng.uniform(math.log10(0.6), math.log10(35)))
    most = int(rng.integers(12, 250))
    if kind == "too faint":
        field_deg = float(rng.uniform(0.08, 0.5))
    x, y, flux, truth = sky(rng, width, height, field_deg, most)
    truths: tuple[Truth, ...] = (truth,)
    if kind == "scrambled":
        kept = rng.random(x.size) < 0.8
        x, y, flux = x[kept], y[kept], rng.permutation(flux[kept])
    elif kind == "bent":
        x, y = bent(rng, x, y, width, height)
        # such a picture has no one scale
        truths = (replace(truth, right_px=0.02 * height, right_scale=0.5),)
        inside = (x > 0) & (x < width - 1) & (y > 0) & (y < height - 1)
        x, y, flux = x[inside], y[inside], flux[inside]
    elif kind == "two skies":
        field_deg = float(10 ** rng.uniform(math.log10(0.6), math.log10(35)))
        x2, y2, flux2, other = sky(rng, width, height, field_deg, most)
        # as bright as the first ones, rank for rank
        flux2 = np.resize(np.sort(flux)[::-1], x2.size) if flux.size else flux2
        x, y, flux = (np.concatenate(two) for two in ((x, x2), (y, y2), (flux, flux2)))
        truths = (truth, other)
    junk = {"too faint": most, "buried": round(x.size * 0.7 / 0.3), "sky": x.size // 10}.get(kind, 0)
    if junk:
        low, high = (float(flux.min()), float(flux.max())) if flux.size else (1.0, 10.0)
        strange = (
            rng.choice(flux, junk) if kind != "too faint" and flux.size else rng.uniform(0.05, 1, junk) * low
        )
        strange = np.clip(strange, 0.0, high)
        x = np.concatenate((x, rng.uniform(0, width - 1, junk)))
        y = np.concatenate((y, rng.uniform(0, height - 1, junk)))
        flux = np.concatenate((flux, strange))
    return Trial(kind, star_list(x, y, flux, width, height), truths)


def bent(rng: np.random.Generator, x: Array, y: Array, width: int, height: int) -> tuple[Array, Array]:
    """A squeezed axis, or a twist that grows outwards to 5-40° at the corner; the middle keeps its place."""
    u, v = x - (width - 1) / 2, y - (height - 1) / 2
    if rng.random() < 0.5:
        u = u * rng.uniform(0.6, 0.9)
    else:
        turn = math.radians(rng.uniform(5, 40)) * np.hypot(u, v) / (0.5 * math.hypot(width, height))
        u, v = u * np.cos(turn) - v * np.sin(turn), u * np.sin(turn) + v * np.cos(turn)
    return u + (width - 1) / 2, v + (height - 1) / 2


KINDS: dict[str, Callable[[np.random.Generator, str], Trial]] = {
    "even": no_sky,
    "clustered": no_sky,
    "raster": no_sky,
    "scrambled": spoiled,
    "bent": spoiled,
    "two skies": spoiled,
    "too faint": spoiled,
    "buried": spoiled,
    "sky": spoiled,
}


def trial_of(number: int, seed: int) -> Trial:
    """The trial of a number: the same seed gives the same list."""
    kind = list(KINDS)[number % len(KINDS)]
    return KINDS[kind](np.random.default_rng((seed, number)), kind)


def run(trials: int, seed: int, budget_s: float, index: BlindIndex, tallies: dict[str, Tally]) -> None:
    """Carry out the trials; the tallies are filled as it goes."""
    for number in range(trials):
        trial = trial_of(number, seed)
        patient = number % PATIENT_EVERY == PATIENT_EVERY - 1
        got = identify(
            trial.measurements,
            embedded_catalog(),
            Hint(),
            epoch_yr=EPOCH_YR,
            budget_s=budget_s * (PATIENCE if patient else 1.0),
            reach=Reach(index=index, blind="only"),
        )
        if tallies.setdefault(trial.kind, Tally()).add(trial, got):
            where = got.reference.plate.center() if got.reference else None
            print(
                f"WRONG: trial {number} of seed {seed}, {trial.kind}, {len(trial.measurements)} sources: "
                f"{where}, true {[one.center for one in trial.truths]}, odds {got.false_probability:.1e}, "
                f"{got.detail}",
                flush=True,
            )
        if number % 1000 == 999:
            print(f"{number + 1} trials", file=sys.stderr, flush=True)


def table(tallies: dict[str, Tally]) -> list[str]:
    """Lines of a markdown table with a line of sums."""
    lines = [
        "| lists | trials | wrong | right | refused | why refused | least odds refused | least odds wrong |",
        "|---" * 8 + "|",
    ]
    for kind, one in tallies.items():
        refused = one.refused.total()
        why = ", ".join(f"{count} {reason}" for reason, count in one.refused.most_common())
        odds = [f"{value:.0e}" if value < 1.0 else "" for value in (one.least_refused, one.least_wrong)]
        lines.append(
            f"| {kind} | {one.right + one.wrong + refused} | {one.wrong} | {one.right} | {refused} | {why} | "
            f"{odds[0]} | {odds[1]} |"
        )
    wrong, right = sum(one.wrong for one in tallies.values()), sum(one.right for one in tallies.values())
    refused = sum(one.refused.total() for one in tallies.values())
    lines.append(f"| all | {wrong + right + refused} | {wrong} | {right} | {refused} | | | |")
    return lines


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("trials", type=int, nargs="?", default=10_000)
    parser.add_argument("--seed", type=int, default=11, help="another seed, other lists")
    parser.add_argument("--budget", type=float, default=0.1, help="seconds per list")
    said = parser.parse_args(words)
    index = cached_index(embedded_catalog())
    tallies: dict[str, Tally] = {}
    began, cpu = time.monotonic(), time.process_time()
    try:
        run(said.trials, said.seed, said.budget, index, tallies)
    except KeyboardInterrupt:
        print("interrupted; what was done:", file=sys.stderr)
    print("\n".join(table(tallies)))
    print(f"\n{time.process_time() - cpu:.0f} s of CPU, {time.monotonic() - began:.0f} s in all")
    return 1 if any(one.wrong for one in tallies.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
