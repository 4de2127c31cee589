"""Make pointing models of ordinary nights, and judge them by what was planted and by fresh targets.

Run: python -m benchmarks.ordinary_nights [--nights 200] [--first 0] [--json] [--verbose]

A night is forty centerings on the simulator's mount, without pixels: slew, look, sync on what was seen (or
aim beside), slew again, look, and a few looks more while the target is tracked. That leaves some 130 looks in
some forty segments of one to eight. Mountings take turns: German, fork, alt-azimuth. Each has the errors of
usual mounts, 20″ of backlash in both axes, 8″ of periodic error, solved places with noise, and a few false
ones. Twelve more targets are only looked at: they tell what a model is worth.

terms      (error) / (stated sigma) of the planted terms, with the true terms given and with terms chosen
fresh      nights on which fresh targets are nearer with the model than without; and with which it was
accepted
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Literal, Protocol

import numpy as np

from mountnav.devices import PierSide
from mountnav.errors import ModelRefused
from mountnav.pointing.model.acceptance import Made, make
from mountnav.pointing.model.in_force import ModelInForce
from mountnav.pointing.model.mechanical import Conversion, mechanical
from mountnav.pointing.model.model import model_of
from mountnav.pointing.model.rigorous import angles, geometry, seen_from, wrapped
from mountnav.pointing.model.terms import ZERO_POINTS
from mountnav.pointing.observation import PointingObservation
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.chain import (
    apparent_to_icrs,
    hour_angle_to_icrs,
    icrs_to_apparent,
    icrs_to_observed,
    observed_to_hour_angle,
)
from mountnav.sky.coordinates import Air, Apparent, Icrs, Observed, Site
from mountnav.sky.sphere import displaced, half_turn_deg, offset_arcsec, separation_arcsec
from mountnav.units import RAD_PER_ARCSEC

Mounting = Literal["german", "fork", "altaz"]
MOUNTINGS: tuple[Mounting, ...] = ("german", "fork", "altaz")
AIR = Air(930.0, 5.0, 0.7)
START = datetime(2026, 11, 21, 18, 0, tzinfo=UTC)
LATITUDES_DEG = (48.93, 35.0, 20.0, -31.0)
BACKLASH_ARCSEC, PERIODIC_ARCSEC, WORM_S = 20.0, 8.0, 480.0
TARGETS, FRESH = 40, 12
LOWEST_DEG = 25.0
TOLERANCE_ARCSEC = 45.0
STILL_ARCSEC = 30.0
"""A slew that moves an axis by less tells nothing of its sense: as the journal has it."""
USUAL_ARCSEC = {
    "ME": 500.0, "MA": 500.0, "AN": 400.0, "AW": 400.0, "CH": 400.0, "CA": 400.0, "NP": 80.0, "NPAE": 60.0,
    "TF": 30.0,
}  # fmt: skip
"""Sizes of planted errors: those of small mounts that were aligned with some care."""


class Mount(Protocol):
    """What a night needs of a simulated mount."""

    def slew(self, place: Apparent) -> object:
        """Set out for a place, and track it."""

    def sync(self, place: Apparent) -> object:
        """Believe to be there."""

    def truth(self) -> Icrs:
        """Where the tube looks."""

    def reported(self) -> Apparent:
        """What it believes."""

    def pier_side(self) -> PierSide:
        """Where the tube hangs."""


class AltAzimuth:
    """An alt-azimuth mount that points wrong; the mechanics of the simulator are equatorial.

    Its gears have play as the simulator's: nothing after an approach towards larger angles, the whole of it
    after one towards smaller ones; tracking takes it up, or lets it come, as the axis goes.
    """

    def __init__(self, site: Site, terms: dict[str, float], clock: FastClock) -> None:
        self._conversion = Conversion(site, "altaz", mounting="altaz")
        self._geometry = geometry("altaz", math.radians(site.latitude_deg), terms)
        self._clock = clock
        self._zero = np.zeros(2)
        self._ordered = hour_angle_to_icrs(
            observed_to_hour_angle(Observed(180.0, 50.0, clock()), site), site, AIR
        )
        self._driven = self._axes()
        self._axes_before = self._driven.copy()

    def _at(self) -> PointingObservation:
        return PointingObservation(self._clock(), self._ordered, 0.0, self._ordered, air=AIR)

    def _axes(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        """Angles of the motors, rad: what it reads, less what it was synced by."""
        at = self._at()
        lon, lat = angles(
            self._conversion.vector(*self._conversion.read_place(self._ordered, at), at)[None, :]
        )
        return np.array([float(lon[0]), float(lat[0])]) - self._zero

    def _move(self) -> None:
        axes = self._axes()
        axes[0] = self._axes_before[0] + float(wrapped(np.array([axes[0] - self._axes_before[0]]))[0])
        play = BACKLASH_ARCSEC * RAD_PER_ARCSEC
        self._driven = np.minimum(np.maximum(self._driven, axes), axes + play)
        self._axes_before = axes

    def slew(self, place: Apparent) -> None:
        """Be there, and track it."""
        self._move()
        self._ordered = apparent_to_icrs(place)
        self._move()

    def sync(self, place: Apparent) -> None:
        """Believe to be there."""
        self._move()
        before = self._axes()
        self._ordered = apparent_to_icrs(place)
        moved = self._axes() - before
        moved[0] = float(wrapped(moved[:1])[0])
        self._zero = self._zero + moved

    def truth(self) -> Icrs:
        """Where the tube looks."""
        self._move()
        worm = 2.0 * math.pi * self._axes_before[0] / math.radians(WORM_S * 360.0 / 86164.0905)
        lon = self._driven[0] + PERIODIC_ARCSEC * RAD_PER_ARCSEC * math.sin(worm)
        seen = seen_from(self._geometry, np.array([lon]), self._driven[1:2])[0]
        return self._conversion.icrs_of(seen, self._at())

    def reported(self) -> Apparent:
        """What it believes."""
        return icrs_to_apparent(self._ordered, self._clock())

    def pier_side(self) -> PierSide:
        """It has none."""
        return PierSide.UNKNOWN


@dataclass(slots=True)
class Night:
    """What a night left, and the truth about it.

    Attributes
    ----------
    planted : dict
        Terms, zero points included, arcsec.
    looks : list of PointingObservation
        Of the forty targets.
    false : list of bool
        Which of them were solved wrongly.
    fresh : list of (synced, look, truth)
        Of each fresh target: what was synced on before, the first look, and where the tube truly was.
    """

    seed: int
    mounting: Mounting
    site: Site
    planted: dict[str, float]
    looks: list[PointingObservation] = field(default_factory=list)
    false: list[bool] = field(default_factory=list)
    fresh: list[tuple[PointingObservation, PointingObservation, Icrs]] = field(default_factory=list)

    @property
    def conversion(self) -> Conversion:
        """Between the sky and its axes."""
        return Conversion(
            self.site, "altaz" if self.mounting == "altaz" else "equatorial", mounting=self.mounting
        )

    @property
    def geometry_terms(self) -> dict[str, float]:
        """Planted, without zero points."""
        zero = ZERO_POINTS[self.conversion.kind]
        return {name: value for name, value in self.planted.items() if name not in zero}


class _Observing:
    """One night at work."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([15, seed])
        self.rng = rng
        mounting = MOUNTINGS[seed % 3]
        site = Site(float(rng.choice(LATITUDES_DEG)), 22.27, 700.0)
        names = ("CA", "NPAE", "AN", "AW", "TF") if mounting == "altaz" else ("CH", "NP", "ME", "MA", "TF")
        # one mount in eight is so good already that there is little to gain
        size = 0.03 if rng.random() < 0.125 else 1.0
        planted = {name: float(rng.normal(0.0, size * USUAL_ARCSEC[name])) for name in names}
        planted["TF"] = abs(planted["TF"])
        zero = rng.uniform(-1200.0, 1200.0, 2)
        planted |= dict(
            zip(ZERO_POINTS["altaz" if mounting == "altaz" else "equatorial"], zero.tolist(), strict=True)
        )
        self.night = Night(seed, mounting, site, planted)
        self.clock = FastClock(0.0, START)
        self.mount: Mount = (
            AltAzimuth(site, planted, self.clock)
            if mounting == "altaz"
            else self._equatorial(mounting, planted)
        )
        self.sigma_arcsec = float(rng.uniform(0.3, 1.5))
        self.jitter_arcsec = float(rng.uniform(0.0, 2.0))
        self.false_share = float(rng.uniform(0.0, 0.04))
        self.sync_share = float(rng.choice([1.0, 1.0, 1.0, 0.5]))
        self.more_looks = float(rng.uniform(0.6, 1.8))
        self.segment = 0
        self.sense = (0, 0)
        self.synced: PointingObservation | None = None

    def _equatorial(self, mounting: Mounting, planted: dict[str, float]) -> Mechanics:
        errors = {f"{name.lower()}_arcsec": value for name, value in planted.items()}
        return Mechanics(
            self.night_site(), AIR,
            PointingErrors(
                **errors, backlash_arcsec=BACKLASH_ARCSEC, periodic_amplitude_arcsec=PERIODIC_ARCSEC,
                periodic_period_s=WORM_S,
            ),
            machine=Machine(
                mounting="german" if mounting == "german" else "fork", slew_rate_deg_s=3.0, encoder_arcsec=0.5
            ),
            clock=self.clock,
        )  # fmt: skip

    def night_site(self) -> Site:
        return self.night.site

    def place(self) -> Icrs:
        """A place of the sky that nights look at: any azimuth, 25° to 80° high, not at the pole."""
        while True:
            alt = math.degrees(
                math.asin(self.rng.uniform(math.sin(math.radians(LOWEST_DEG)), math.sin(math.radians(80.0))))
            )
            now = self.clock()
            at = Observed(float(self.rng.uniform(0.0, 360.0)), alt, now)
            place = hour_angle_to_icrs(observed_to_hour_angle(at, self.night.site), self.night.site, AIR)
            later = icrs_to_observed(place, now + timedelta(minutes=15), self.night.site, AIR)
            if abs(place.dec_deg) < 82.0 and later.alt_deg > LOWEST_DEG - 5.0 and later.alt_deg < 84.0:
                return place

    def slew(self, place: Icrs) -> None:
        now = self.clock()
        before, side = self.mount.reported(), self.mount.pier_side()
        order = icrs_to_apparent(place, now)
        if isinstance(self.mount, AltAzimuth):
            # that mount is there at once: the slew's time goes before it, settling and half an exposure after
            self.clock.on(60.0)
            self.mount.slew(icrs_to_apparent(place, self.clock()))
            self.clock.on(float(self.rng.uniform(8.0, 20.0)))
        else:
            self.mount.slew(order)
            self.clock.on(float(self.rng.uniform(70.0, 90.0)))
        if {side, self.mount.pier_side()} == {PierSide.EAST, PierSide.WEST}:
            self.sense = (0, 0)
        else:
            ra, dec = half_turn_deg(order.ra_deg - before.ra_deg), order.dec_deg - before.dec_deg
            self.sense = (_sense(-ra), _sense(dec))

    def look(self) -> tuple[PointingObservation, Icrs, bool]:
        now, truth = self.clock(), self.mount.truth()
        off = self.rng.normal(0.0, math.hypot(self.sigma_arcsec, self.jitter_arcsec), 2)
        false = bool(self.rng.random() < self.false_share)
        if false:
            size, way = self.rng.uniform(180.0, 3600.0), self.rng.uniform(0.0, 2.0 * math.pi)
            off = off + size * np.array([math.cos(way), math.sin(way)])
        one = PointingObservation(
            now, displaced(truth, *off.tolist()), self.sigma_arcsec, self.mount.reported(),
            side=self.mount.pier_side(), segment_id=f"s{self.segment}", air=AIR, from_side=self.sense,
        )  # fmt: skip
        return one, truth, false

    def sync(self, look: PointingObservation) -> None:
        self.mount.sync(icrs_to_apparent(look.seen, self.clock()))
        self.segment += 1
        self.synced = PointingObservation(
            self.clock(), look.seen, look.sigma_arcsec, self.mount.reported(), side=look.side,
            segment_id=f"s{self.segment}", air=AIR,
        )  # fmt: skip

    def center(self, *, fresh: bool = False) -> None:
        night, target = self.night, self.place()
        aim = target
        self.slew(aim)
        begun = self.synced
        for attempt in range(5):
            one, truth, false = self.look()
            if not fresh:
                night.looks.append(one)
                night.false.append(false)
            elif attempt == 0 and begun is not None and not false:
                night.fresh.append((begun, one, truth))
            off = separation_arcsec(one.seen, target)
            if false:
                continue  # the service doubts it, and looks again
            if off < TOLERANCE_ARCSEC and (attempt or not fresh):
                break
            if fresh or self.rng.random() < self.sync_share:
                self.sync(one)
                aim = target
            else:
                away = offset_arcsec(one.seen, target)
                aim = displaced(aim, -away.east_arcsec, -away.north_arcsec)
            self.slew(aim)
        if fresh:
            return
        for _ in range(min(int(self.rng.geometric(1.0 / (1.0 + self.more_looks))) - 1, 6)):
            self.clock.on(float(self.rng.uniform(20.0, 150.0)))
            one, _, false = self.look()
            night.looks.append(one)
            night.false.append(false)


def _sense(moved_deg: float) -> int:
    return 0 if abs(moved_deg) < STILL_ARCSEC / 3600.0 else 1 if moved_deg > 0.0 else -1


def night(seed: int, targets: int = TARGETS) -> Night:
    """Live through a night; the same seed gives the same one."""
    observing = _Observing(seed)
    for _ in range(targets):
        observing.center()
        observing.clock.on(float(observing.rng.uniform(60.0, 600.0)))
    for _ in range(FRESH + 1):
        observing.center(fresh=True)
    return observing.night


@dataclass(frozen=True, slots=True)
class Judged:
    """What became of a night.

    Attributes
    ----------
    z : dict
        (Found - planted) / stated sigma; a planted term that isn't in the model counts as found to be 0, with
        the sigma that it has in the fit of the true terms.
    sigma_arcsec : dict
    spurious : tuple of str
        Terms that nobody planted.
    with_arcsec, without_arcsec : float
        RMS distance of fresh targets.
    nearer : float
        Share of the fresh targets that are nearer with the model.
    """

    seed: int
    mounting: str
    looks: int
    segments: int
    refused: str = ""
    accepted: bool = False
    z: dict[str, float] = field(default_factory=dict)
    sigma_arcsec: dict[str, float] = field(default_factory=dict)
    spurious: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    true_left_out: int = 0
    false_kept: int = 0
    loo_arcsec: float = math.nan
    with_arcsec: float = math.nan
    without_arcsec: float = math.nan
    nearer: float = math.nan
    expected_z2: float = math.nan
    notes: tuple[str, ...] = ()


def judged(
    lived: Night, terms: tuple[str, ...] | Literal["auto"], given_sigma_arcsec: dict[str, float] | None = None
) -> tuple[Judged, Made | None]:
    """Make a model of a night and hold it against the truth."""
    told = len(lived.looks), len({one.segment_id for one in lived.looks})
    try:
        made = make(mechanical(lived.looks, lived.conversion), terms=terms)
    except ModelRefused as cause:
        return Judged(lived.seed, lived.mounting, *told, refused=cause.what), None
    found = made.fit
    value = dict(zip(found.terms, found.coefficients_arcsec.tolist(), strict=True))
    sigma = dict(zip(found.terms, found.sigma_arcsec.tolist(), strict=True))
    planted = lived.geometry_terms
    sigma = (given_sigma_arcsec or {}) | sigma
    z = {name: (value.get(name, 0.0) - planted[name]) / sigma[name] for name in planted if name in sigma}
    false = np.array(lived.false)
    model = model_of(found, made_utc=START)
    near, far, chi = [], [], []
    for synced, look, truth in lived.fresh:
        force = ModelInForce(model, site=lived.site, air=AIR, mounting=lived.mounting)
        force.new_segment(synced.segment_id, synced)
        assert isinstance(look.reading, Apparent)
        believed = apparent_to_icrs(look.reading)
        try:
            expected = force.expected(believed, look.utc, look.side)
        except ModelRefused:
            continue
        off = offset_arcsec(truth, believed)
        missed = (
            off.east_arcsec - expected.offset.east_arcsec,
            off.north_arcsec - expected.offset.north_arcsec,
        )
        near.append(math.hypot(*missed))
        far.append(off.total_arcsec)
        chi.append(0.5 * (near[-1] / expected.sigma_arcsec) ** 2)
    with_, without = np.array(near), np.array(far)
    return Judged(
        lived.seed,
        lived.mounting,
        *told,
        accepted=made.judged.accepted,
        z=z,
        sigma_arcsec=sigma,
        spurious=tuple(name for name in found.geometry_terms if name not in planted),
        missing=tuple(name for name in planted if name not in value),
        true_left_out=int(np.sum(~found.used & ~false)),
        false_kept=int(np.sum(found.used & false)),
        loo_arcsec=found.loo_arcsec,
        with_arcsec=float(np.sqrt(np.mean(with_**2))),
        without_arcsec=float(np.sqrt(np.mean(without**2))),
        nearer=float(np.mean(with_ < without)),
        expected_z2=float(np.mean(chi)),
        notes=found.notes,
    ), made


def summary(all_: list[Judged]) -> dict[str, object]:
    """Figures of many nights."""
    made = [one for one in all_ if not one.refused]
    values = np.array([z for one in made for z in one.z.values()])
    taken = [one for one in made if one.accepted]
    worse = [one.seed for one in taken if one.with_arcsec > one.without_arcsec]
    by_term: dict[str, list[float]] = {}
    for one in made:
        for name, z in one.z.items():
            by_term.setdefault(name, []).append(z)
    return {
        "nights": len(all_),
        "refused": len(all_) - len(made),
        "accepted": len(taken),
        "planted_terms": len(values),
        "within_1_sigma": round(float(np.mean(np.abs(values) < 1.0)), 3),
        "within_2_sigma": round(float(np.mean(np.abs(values) < 2.0)), 3),
        "within_3_sigma": round(float(np.mean(np.abs(values) < 3.0)), 4),
        "largest": round(float(np.max(np.abs(values))), 2),
        "rms_error_over_sigma": round(float(np.sqrt(np.mean(values**2))), 2),
        "by_term": {name: round(float(np.sqrt(np.mean(np.square(z)))), 2) for name, z in by_term.items()},
        "missing": dict(Counter(name for one in made for name in one.missing)),
        "spurious_a_night": round(float(np.mean([len(one.spurious) for one in made])), 2),
        "spurious": dict(Counter(name for one in made for name in one.spurious)),
        "true_looks_left_out": round(
            sum(one.true_left_out for one in made) / sum(one.looks for one in made), 4
        ),
        "most_left_out_in_a_night": max(one.true_left_out / one.looks for one in made),
        "false_looks_kept": sum(one.false_kept for one in made),
        "fresh_arcsec": {
            "with": round(float(np.median([one.with_arcsec for one in made])), 1),
            "without": round(float(np.median([one.without_arcsec for one in made])), 1),
        },
        "loo_over_fresh": round(float(np.median([one.loo_arcsec / one.with_arcsec for one in made])), 2),
        "expected_chi2": round(float(np.median([one.expected_z2 for one in made])), 2),
        "nights_nearer": round(float(np.mean([one.with_arcsec < one.without_arcsec for one in made])), 3),
        "targets_nearer": round(float(np.mean([one.nearer for one in made])), 3),
        "accepted_nights_nearer": round(1.0 - len(worse) / max(len(taken), 1), 3),
        "accepted_and_worse": worse,
    }


def line(one: Judged, name: str) -> str:
    """A night in one line."""
    z = " ".join(f"{key}{value:+.1f}" for key, value in one.z.items())
    return (
        f"{one.seed:4d} {one.mounting:6} {name:6} {one.looks:3d}/{one.segments:2d} "
        f"{'acc' if one.accepted else 'NOT'} {z} loo {one.loo_arcsec:.1f} "
        f"fresh {one.with_arcsec:.1f} of {one.without_arcsec:.1f} out {one.true_left_out} "
        f"kept {one.false_kept} +{','.join(one.spurious)} -{','.join(one.missing)} {one.refused}"
    )


def main() -> None:
    told = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    told.add_argument("--nights", type=int, default=200)
    told.add_argument("--first", type=int, default=0)
    told.add_argument("--json", action="store_true")
    told.add_argument("--verbose", action="store_true")
    options = told.parse_args()
    results: dict[str, list[Judged]] = {"given": [], "chosen": []}
    for seed in range(options.first, options.first + options.nights):
        lived = night(seed)
        given = judged(lived, tuple(lived.geometry_terms))[0]
        chosen = judged(lived, "auto", given.sigma_arcsec)[0]
        for name, one in (("given", given), ("chosen", chosen)):
            results[name].append(one)
            if options.verbose:
                print(line(one, name), file=sys.stderr)
    told_of = {name: summary(all_) for name, all_ in results.items()}
    if options.json:
        print(json.dumps(told_of, ensure_ascii=False))
        return
    for name, values in told_of.items():
        print(name)
        for key, value in values.items():
            print(f"  {key:28} {value}")


if __name__ == "__main__":
    main()
