"""Print how well and how fast a simulated series is followed: shift against truth, drift, milliseconds.

Run: python -m benchmarks.series [frames]        (20 by default; one satellite, drift, star trailing)
     python -m benchmarks.series profiles        (preliminary identification: the paper's and our profile)
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.identification.preliminary import find_shift, preliminary
from mountnav.identification.settings import PreliminarySettings
from mountnav.identification.shift import sources_of
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Measurements
from mountnav.series.follow import SeriesFollower
from mountnav.series.results import SeriesReport
from mountnav.simulation.optics import SimulatedOptics, optics_preset
from mountnav.simulation.render import draw_frame, project
from mountnav.simulation.trails import SatelliteTrail
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import half_turn_deg

Array = NDArray[np.float64]
START = datetime(2026, 11, 21, 20, tzinfo=UTC)
CENTER = Icrs(83.2, 21.4)
CADENCE_S = 60.0
EXPOSURE_S = 10.0
RA_ARCSEC_MIN, DEC_ARCSEC_MIN = 21.0, -9.0
SATELLITE_FRAME = 7


@dataclass(frozen=True, slots=True)
class Drawn:
    """A simulated frame and the center it was drawn for."""

    frame: Frame
    center: Icrs


def drawn_series(
    frames: int,
    optics: SimulatedOptics,
    *,
    start: Icrs = CENTER,
    center_of: Callable[[float], Icrs] | None = None,
) -> Iterator[Drawn]:
    """Frames of a drifting telescope, one of them with a satellite."""
    # the rate in right ascension holds at the middle of the track, as `mountnav.series.drift` states it
    middle_dec_deg = start.dec_deg + DEC_ARCSEC_MIN * 0.5 * (frames - 1) * CADENCE_S / 60.0 / 3600.0
    cosine = math.cos(math.radians(middle_dec_deg))
    for number in range(frames):
        minutes = number * CADENCE_S / 60.0
        center = (
            center_of(minutes)
            if center_of
            else Icrs(
                (start.ra_deg + RA_ARCSEC_MIN * minutes / 3600.0 / cosine) % 360.0,
                start.dec_deg + DEC_ARCSEC_MIN * minutes / 3600.0,
            )
        )
        trail = SatelliteTrail(-50.0, 200.0, 0.9 * optics.width_px, optics.height_px + 30.0, 4000.0)
        frame = draw_frame(
            center,
            optics,
            embedded_catalog(),
            exposure_s=EXPOSURE_S,
            mid_exposure_utc=START + timedelta(minutes=minutes),
            seed=(7, number),
            trails=(trail,) if number == SATELLITE_FRAME else (),
            drift_arcsec_s=(RA_ARCSEC_MIN / 60.0, DEC_ARCSEC_MIN / 60.0),
        )
        yield Drawn(replace(frame, source=f"frame {number}"), center)


def true_shift(anchor: Icrs, center: Icrs, optics: SimulatedOptics) -> tuple[float, float]:
    """Where a center lies in the anchor's frame, from its center, pixels."""
    x, y = project(anchor, optics, np.array([center.ra_deg]), np.array([center.dec_deg]))
    return float(x[0]) - (optics.width_px - 1) / 2.0, float(y[0]) - (optics.height_px - 1) / 2.0


def shift_errors(report: SeriesReport, centers: list[Icrs], optics: SimulatedOptics) -> Array:
    """Errors of the frames' shifts: through the plate, and of the mean over pairs; shape (n, 4), pixels."""
    rows = []
    for one in report.frames:
        if one.shift is None:
            continue
        dx, dy = true_shift(centers[one.shift.anchor], centers[one.number], optics)
        rows.append(
            (one.shift.dx_px - dx, one.shift.dy_px - dy, one.shift.mean_dx_px - dx, one.shift.mean_dy_px - dy)
        )
    return np.array(rows)


def cpu_milliseconds(lists: list[Measurements], rounds: int = 5) -> float:
    """CPU time of preparing a list and finding its shift to the first one."""
    settings = PreliminarySettings.measured()
    first = sources_of(lists[0], settings)
    began = time.process_time()
    for _ in range(rounds):
        for one in lists[1:]:
            find_shift(first, sources_of(one, settings), settings)
    return 1e3 * (time.process_time() - began) / rounds / (len(lists) - 1)


def follow_simulated(frames: int) -> None:
    optics = replace(optics_preset("demo"), distortion_px2=4e-9)
    follower = SeriesFollower(embedded_catalog(), hint=Hint(center=CENTER, radius_deg=1.0))
    centers, lists = [], []
    for one in drawn_series(frames, optics):
        follower.add(one.frame)
        lists.append(measure(one.frame))
        centers.append(one.center)
    report = follower.report()
    errors = shift_errors(report, centers, optics)
    places = [
        math.hypot(
            half_turn_deg(one.center.ra_deg - true.ra_deg) * math.cos(math.radians(true.dec_deg)),
            one.center.dec_deg - true.dec_deg,
        )
        * 3600.0
        for one, true in zip(report.frames, centers, strict=True)
        if one.center is not None
    ]
    stated = [one.shift.dx_sigma_px for one in report.frames if one.shift]
    print(f"{frames} frames of {optics.width_px} × {optics.height_px} px, {optics.scale_arcsec_px} ″/px")
    print("modes:", dict(Counter(str(one.mode) for one in report.frames)))
    rms = np.sqrt((errors**2).mean(axis=0))
    print(f"shift against truth, rms per coordinate: {rms[0]:.4f} {rms[1]:.4f} px")
    print(
        f"shift against truth, rms of the distance: {np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()):.4f} px"
    )
    print(f"  stated standard error, median: {np.median(stated):.4f} px")
    print(f"  mean over pairs alone (3, 4), rms of the distance: {np.hypot(rms[2], rms[3]):.4f} px")
    print(f"center against truth, rms: {math.sqrt(np.mean(np.square(places))):.4f}″")
    if report.drift:
        drift = report.drift
        print(
            f"drift: RA {drift.ra_arcsec_min:+.4f} ± {drift.ra_sigma_arcsec_min:.4f} "
            f"(true {RA_ARCSEC_MIN:+.4f}), Dec {drift.dec_arcsec_min:+.4f} "
            f"± {drift.dec_sigma_arcsec_min:.4f} ″/min (true {DEC_ARCSEC_MIN:+.4f})"
        )
    milliseconds = np.array([1e3 * one.times.preliminary_s for one in report.frames if one.shift])
    print(
        f"preliminary identification with its plate: median {np.median(milliseconds):.2f} ms, "
        f"90 % {np.percentile(milliseconds, 90):.2f} ms, most {milliseconds.max():.2f} ms"
    )
    print(f"  the same lists again, CPU time: {cpu_milliseconds(lists):.2f} ms a frame")
    print(f"measuring: median {1e3 * np.median([one.times.measure_s for one in report.frames]):.0f} ms")
    satellite = report.frames[SATELLITE_FRAME] if frames > SATELLITE_FRAME else report.frames[-1]
    print(f"persistent sources: {[one.persistent for one in report.frames]}")
    print(f"satellite's frame: {satellite.measured} measured, {satellite.persistent} persistent")


# -- the two profiles of preliminary identification ---------------------------------------------------------


def star_list(x: Array, y: Array, flux: Array, width_px: int, height_px: int) -> Measurements:
    """Measurements of a made-up list."""
    order = np.argsort(-flux)
    same = np.full(x.size, 1.0)
    return Measurements(
        x[order],
        y[order],
        0.03 * same,
        0.03 * same,
        flux[order],
        0.01 * flux[order],
        3.0 * same,
        0.05 * same,
        np.zeros(x.size, dtype=np.int64),
        width_px,
        height_px,
        100.0,
        5.0,
    )


def two_lists(
    rng: np.random.Generator, stars: int, size: tuple[int, int], shift: tuple[float, float], missing: float
) -> tuple[Measurements, Measurements]:
    """The same sky twice, the second time shifted and with a share of the stars missing."""
    width, height = size
    count = 9 * stars
    x, y = rng.uniform(-width, 2 * width, count), rng.uniform(-height, 2 * height, count)
    flux = rng.pareto(1.2, count) + 1.0
    lists = []
    for number, (dx, dy) in enumerate(((0.0, 0.0), shift)):
        seen_x, seen_y = x - dx + rng.normal(0, 0.03, count), y - dy + rng.normal(0, 0.03, count)
        inside = (seen_x > 0) & (seen_x < width) & (seen_y > 0) & (seen_y < height)
        if number:
            inside &= rng.random(count) >= missing
        lists.append(star_list(seen_x[inside], seen_y[inside], flux[inside], width, height))
    return lists[0], lists[1]


def compare_profiles(trials: int = 40) -> None:
    profiles = {"paper": PreliminarySettings(), "measured": PreliminarySettings.measured()}
    print("| stars | frame px | shift up to | missing | " + " | ".join(profiles) + " |")
    print("|---" * 6 + "|")
    cases = [
        (stars, size, reach, missing)
        for stars, size in ((30, (1500, 1000)), (300, (1500, 1000)), (1500, (1500, 1000)), (60, (256, 256)))
        for reach, missing in ((0.02, 0.0), (0.3, 0.0), (0.6, 0.0), (0.05, 0.5))
    ]
    for stars, size, reach, missing in cases:
        cells = []
        for settings in profiles.values():
            rng = np.random.default_rng(20230511)
            errors, spent = [], []
            for _ in range(trials):
                shift = (rng.uniform(-reach, reach) * size[0], rng.uniform(-reach, reach) * size[1])
                first, second = two_lists(rng, stars, size, shift, missing)
                began = time.process_time()
                got = preliminary(first, second, settings)
                spent.append(1e3 * (time.process_time() - began))
                if got.pairing:
                    errors.append(math.hypot(got.pairing.dx_px - shift[0], got.pairing.dy_px - shift[1]))
            rms = f"{math.sqrt(np.mean(np.square(errors))):.3f} px" if errors else "-"
            cells.append(f"{len(errors)}/{trials}, {rms}, {np.median(spent):.1f} ms")
        case = f"| {stars} | {size[0]} × {size[1]} | {100 * reach:.0f} % | {100 * missing:.0f} % | "
        print(case + " | ".join(cells) + " |")
    for name, settings in profiles.items():
        rng = np.random.default_rng(1)
        outcomes: Counter[str] = Counter()
        for stars, size in ((6, (1000, 1000)), (30, (1500, 1000)), (300, (1500, 1000)), (60, (256, 256))):
            for _ in range(250):
                first, _ = two_lists(rng, stars, size, (0.0, 0.0), 0.0)
                _, second = two_lists(rng, stars, size, (0.0, 0.0), 0.0)
                outcomes[preliminary(first, second, settings).outcome.name] += 1
        print(f"unrelated lists, {name}: {dict(outcomes)}")


def main() -> None:
    if sys.argv[1:] == ["profiles"]:
        compare_profiles()
    else:
        follow_simulated(int(sys.argv[1]) if len(sys.argv) > 1 else 20)


if __name__ == "__main__":
    main()
