"""Try to get a wrong answer: hints that point elsewhere, random star lists, pure noise, frames without truth.

Run: python -m benchmarks.wrong_answers [--runs 3000] [--budget 0.4] [--only abcd] [--seed 7]

Every run has a small budget of wall time, so that 3,000 of them take less than 25 minutes on one core; every
fiftieth gets 25 times as much. An answer is wrong when a frame is solved and its center is off by more than
3 px and the truth's uncertainty; solving rightly in spite of a wrong hint is fine. A list that is no sky
has no right answer.
"""

from __future__ import annotations

import argparse
import math
import random
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.frames import Known, asked, read, real, rendered, shared_folder
from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadFrame
from mountnav.frames import Frame, Hint
from mountnav.identification.search import Identified, identify
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Measurements
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.units import julian_year

PATIENT_EVERY = 50
PATIENCE = 25.0


@dataclass(frozen=True, slots=True)
class Listed:
    """A frame's measurements with what is known of the frame.

    Attributes
    ----------
    known : Known
    hint : Hint
        What a sane caller would ask with.
    measurements : Measurements
    epoch_yr : float
    """

    known: Known
    hint: Hint
    measurements: Measurements
    epoch_yr: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one run.

    Attributes
    ----------
    name : str
    result : str
        "right", "wrong", or the reason of the refusal.
    detail : str
    false_probability : float
        Claimed for the best match.
    spent_s : float
    """

    name: str
    result: str
    detail: str
    false_probability: float
    spent_s: float


def listed(shared: Path, word: str = "") -> list[Listed]:
    """Measure every shared frame, or those with a word in their path, once."""
    found = []
    for known in rendered(shared) + real(shared):
        if word not in str(known.path):
            continue
        frame = read(known)
        if isinstance(frame, BadFrame):
            continue
        try:
            measurements = measure(frame)
        except BadFrame:
            continue
        utc = frame.mid_exposure_utc
        epoch_yr = julian_year(utc) if utc is not None else 2026.0
        found.append(Listed(known, asked(known, frame), measurements, epoch_yr))
    return found


def elsewhere(hint: Hint, known: Known, chance: random.Random) -> Hint:
    """Move the hint's center by 5 to 170° in any direction; the scale stays right."""
    at = known.center or hint.center or Icrs(83.8, -5.4)
    away_rad, toward_rad = math.radians(chance.uniform(5, 170)), chance.uniform(0, 2 * math.pi)
    dec, ra = math.radians(at.dec_deg), math.radians(at.ra_deg)
    sine = math.sin(dec) * math.cos(away_rad) + math.cos(dec) * math.sin(away_rad) * math.cos(toward_rad)
    east = math.atan2(
        math.sin(toward_rad) * math.sin(away_rad) * math.cos(dec), math.cos(away_rad) - math.sin(dec) * sine
    )
    moved = Icrs(math.degrees(ra + east) % 360.0, math.degrees(math.asin(sine)))
    return replace(hint, center=moved, alternatives=())


def judged(name: str, known: Known | None, got: Identified, spent_s: float) -> Outcome:
    """Right, wrong, or refused."""
    if got.reference is None:
        return Outcome(name, str(got.reason), got.detail, got.false_probability, spent_s)
    plate = got.reference.plate
    result = "wrong"
    if known is not None and known.center is not None and known.grade != "N":
        allowed_arcsec = 3.0 * plate.scale_arcsec_px() + known.uncertainty_arcsec
        if separation_arcsec(plate.center(), known.center) <= allowed_arcsec:
            result = "right"
    return Outcome(name, result, f"{plate.center()} {got.detail}", got.false_probability, spent_s)


def timed(
    name: str, known: Known | None, m: Measurements, hint: Hint, epoch_yr: float, budget_s: float
) -> Outcome:
    """Identify and judge."""
    began = time.monotonic()
    got = identify(m, embedded_catalog(), hint, epoch_yr=epoch_yr, budget_s=budget_s)
    return judged(name, known, got, time.monotonic() - began)


def displaced_hints(lists: list[Listed], runs: int, budget_s: float, seed: int) -> Iterator[Outcome]:
    """(a) Measured lists of real and rendered frames, asked for at a place where they were not taken."""
    chance = random.Random(seed)
    for number in range(runs):
        one = lists[number % len(lists)]
        budget = budget_s * (PATIENCE if number % PATIENT_EVERY == PATIENT_EVERY - 1 else 1.0)
        hint = elsewhere(one.hint, one.known, chance)
        name = f"elsewhere {one.known.path.name} asked at {hint.center}"
        yield timed(name, one.known, one.measurements, hint, one.epoch_yr, budget)


def star_list(x: np.ndarray, y: np.ndarray, flux: np.ndarray, width_px: int, height_px: int) -> Measurements:
    """Measurements of no frame."""
    order = np.argsort(-flux)
    one = np.ones(x.size)
    return Measurements(
        x_px=x[order],
        y_px=y[order],
        x_sigma_px=0.1 * one,
        y_sigma_px=0.1 * one,
        flux=flux[order],
        flux_sigma=0.05 * flux[order],
        fwhm_px=3.0 * one,
        ellipticity=0.0 * one,
        flags=np.zeros(x.size, dtype=np.int64),
        width_px=width_px,
        height_px=height_px,
        background_adu=100.0,
        noise_adu=10.0,
    )


def random_list(rng: np.random.Generator) -> Measurements:
    """Sources strewn at random: even, in clusters, on a raster of pixels, or along lines."""
    width, height = (int(side) for side in rng.integers(300, 4000, 2))
    count = int(10 ** rng.uniform(0.7, 3.1))
    x, y = rng.uniform(0, width - 1, count), rng.uniform(0, height - 1, count)
    kind = rng.integers(0, 4)
    if kind == 1:
        many = count // 2
        x[:many] = np.clip(rng.normal(rng.uniform(0, width), 0.05 * width, many), 0, width - 1)
        y[:many] = np.clip(rng.normal(rng.uniform(0, height), 0.05 * width, many), 0, height - 1)
    elif kind == 2:
        x, y = np.round(x / 16) * 16, np.round(y / 16) * 16
    elif kind == 3:
        x[::3] = np.round(x[::3] / (width / 5)) * (width / 5)
    return star_list(
        np.clip(x, 0, width - 1), np.clip(y, 0, height - 1), rng.pareto(1.2, count) + 1.0, width, height
    )


def random_lists(runs: int, budget_s: float, seed: int) -> Iterator[Outcome]:
    """(b) Lists that are no sky."""
    rng = np.random.default_rng(seed)
    for _ in range(runs):
        m = random_list(rng)
        place = Icrs(float(rng.uniform(0, 360)), float(np.degrees(np.arcsin(rng.uniform(-1, 1)))))
        scale = float(10 ** rng.uniform(-0.2, 1.9))
        hint = Hint(place, float(rng.uniform(0.2, 3.0)), scale * 0.95, scale * 1.05)
        yield timed(f"random list of {len(m)} at {place}, {scale:.2f} ″/px", None, m, hint, 2026.0, budget_s)


def noise_frames(runs: int, budget_s: float, seed: int) -> Iterator[Outcome]:
    """(c) Frames of noise: read noise, shot noise, hot pixels, a gradient, clouds of large-scale light."""
    rng = np.random.default_rng(seed)
    for number in range(runs):
        height, width = (int(side) for side in rng.integers(300, 900, 2))
        level = np.full((height, width), 10 ** rng.uniform(1, 4))
        if number % 3 == 1:
            level *= 1 + 0.5 * np.linspace(0, 1, width)[None, :]
        pixels = rng.poisson(level) + rng.normal(0, 8, level.shape)
        if number % 2:
            hot = rng.integers(0, height * width, 150)
            pixels.ravel()[hot] += rng.exponential(2000, hot.size)
        try:
            m = measure(Frame(np.asarray(pixels, dtype=np.float32), source="noise"))
        except BadFrame as fault:
            yield Outcome("noise", "no usable image", str(fault), 1.0, 0.0)
            continue
        place = Icrs(float(rng.uniform(0, 360)), float(np.degrees(np.arcsin(rng.uniform(-1, 1)))))
        scale = float(10 ** rng.uniform(0, 1.9))
        hint = Hint(place, 1.0, scale * 0.95, scale * 1.05)
        yield timed(f"noise, {len(m)} sources", None, m, hint, 2026.0, budget_s)


def doubtful(lists: list[Listed], budget_s: float) -> Iterator[Outcome]:
    """(d) Frames of grade C and N: with the hint that is there, and with the scale unknown."""
    for one in lists:
        if one.known.grade not in "CN":
            continue
        wide = replace(one.hint, scale_low_arcsec_px=None, scale_high_arcsec_px=None)
        for hint in (one.hint, wide):
            name = f"{one.known.grade} {one.known.path.name}"
            yield timed(name, one.known, one.measurements, hint, one.epoch_yr, budget_s)


def report(title: str, outcomes: Iterator[Outcome]) -> int:
    """Print what came of the runs; how many answers were wrong."""
    counts: Counter[str] = Counter()
    least, spent, began = 1.0, [], time.monotonic()
    for one in outcomes:
        counts[one.result] += 1
        spent.append(one.spent_s)
        if one.result == "wrong":
            print(f"WRONG: {one.name}: {one.detail}, odds {one.false_probability:.1e}", flush=True)
        elif one.result != "right":
            least = min(least, one.false_probability)
    runs, wrong = sum(counts.values()), counts.pop("wrong", 0)
    print(f"\n{title}: {runs} runs, {time.monotonic() - began:.0f} s, median {np.median(spent):.2f} s")
    print(f"  wrong {wrong}, right in spite of all {counts.pop('right', 0)}, refused:")
    for reason, count in counts.most_common():
        print(f"    {count:5d}  {reason}")
    print(f"  least odds claimed for a refused match: {least:.1e}", flush=True)
    return wrong


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--runs", type=int, default=3000, help="runs of part a; b has a tenth, c a hundredth")
    words.add_argument("--budget", type=float, default=0.4, help="seconds per run")
    words.add_argument("--only", default="abcd", help="which parts")
    words.add_argument("--seed", type=int, default=7, help="another seed, other places and lists")
    said = words.parse_args()
    lists = listed(shared_folder()) if set(said.only) & set("ad") else []
    if "a" in said.only:
        report("a) hints that point elsewhere", displaced_hints(lists, said.runs, said.budget, said.seed))
    if "b" in said.only:
        report("b) random lists", random_lists(max(1, said.runs // 10), said.budget, said.seed))
    if "c" in said.only:
        report("c) noise", noise_frames(max(1, said.runs // 100), said.budget, said.seed))
    if "d" in said.only:
        report("d) frames of grade C and N", doubtful(lists, 10.0))


if __name__ == "__main__":
    main()
