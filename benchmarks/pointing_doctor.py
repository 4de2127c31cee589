"""Print what the doctor finds on simulated mounts: each illness from four solves, and healthy nights.

Run: python -m benchmarks.pointing_doctor [trials] [nights]        (200 a cell and 1,000 by default)
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from mountnav.devices import PierSide
from mountnav.pointing.doctor import ORDINARY, Diagnosis, Geometry, Illness, diagnose, known
from mountnav.pointing.observation import PointingObservation
from mountnav.simulation.geometry import true_direction
from mountnav.simulation.machine import Machine
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.simulation.posture import axes_at
from mountnav.sky.chain import (
    apparent_to_hour_angle,
    apparent_to_icrs,
    hour_angle_to_apparent,
    hour_angle_to_icrs,
    hour_angle_to_observed,
    icrs_to_apparent,
)
from mountnav.sky.coordinates import Air, Apparent, GeometricHourAngle, HourAngle, Icrs, Site
from mountnav.sky.sphere import half_turn_deg, position_angle_deg, turn_deg

START = datetime(2026, 11, 21, 18, tzinfo=UTC)
NOISE_ARCSEC = 60.0
"""On the sky, both coordinates together."""
LOWEST_DEG = 25.0
GERMAN = Machine(mounting="german")
SIDEREAL = 1.00273790935


@dataclass(slots=True)
class Patient:
    """A German mount with ordinary errors, and perhaps an illness.

    Attributes
    ----------
    site, air, errors
        The truth.
    believes_icrs : bool
        What we take its readings for.
    speaks_icrs : bool
        What it speaks.
    ahead_s : float
        Its clock, or its longitude as seconds of time.
    sense : {1, -1}
        -1: it believes to stand in the other hemisphere.
    parity : int
    camera_deg, camera_noise_deg : float
    shift_deg : (float, float)
        Believed minus motor axes.
    """

    rng: np.random.Generator
    site: Site
    air: Air
    errors: PointingErrors
    noise_arcsec: float = NOISE_ARCSEC
    believes_icrs: bool = False
    speaks_icrs: bool = False
    ahead_s: float = 0.0
    sense: float = 1.0
    parity: int = 1
    camera_deg: float = 0.0
    camera_noise_deg: float = 0.008
    shift_deg: tuple[float, float] = (0.0, 0.0)
    segment: int = 0
    looks: list[PointingObservation] = field(default_factory=list)
    syncs: list[PointingObservation] = field(default_factory=list)
    logged: bool = True

    def _mind(self, place: Apparent) -> tuple[float, float]:
        """Hour angle and declination that it makes of an apparent place."""
        angle = apparent_to_hour_angle(place, self.site)
        return angle.ha_deg + self.ahead_s / 240.0 * SIDEREAL, angle.dec_deg

    def _numbers(self, place: Apparent, icrs: bool) -> Apparent | Icrs:
        return apparent_to_icrs(place) if icrs else place

    def look(
        self, utc: datetime, ha_deg: float, dec_deg: float, side: PierSide, told: PierSide | None = None
    ) -> PointingObservation | None:
        """Look with the true axes near a place (from a side); None if the tube is too low to see anything."""
        latitude = self.site.latitude_deg
        motor = axes_at(ha_deg, dec_deg, GERMAN, side, latitude)
        jitter = self.rng.normal(0.0, self.noise_arcsec / math.sqrt(2.0) / 3600.0, 2)
        # noise on the sky: that of the hour angle axis grows with the secant
        true_axes = motor[0] + jitter[0] / max(math.cos(math.radians(dec_deg)), 0.05), motor[1] + jitter[1]
        at = HourAngle(*true_direction(*true_axes, self.errors, latitude), utc)
        if hour_angle_to_observed(at, self.site).alt_deg < LOWEST_DEG:
            return None
        seen = hour_angle_to_icrs(at, self.site, self.air)
        above = HourAngle(*true_direction(true_axes[0], true_axes[1] + 0.01, self.errors, latitude), utc)
        angle = position_angle_deg(seen, hour_angle_to_icrs(above, self.site, self.air))
        reading = self._reads(utc, motor)
        numbers = self._numbers(reading, self.speaks_icrs)
        believed: Apparent | Icrs = (
            Icrs(numbers.ra_deg, numbers.dec_deg)
            if self.believes_icrs
            else Apparent(numbers.ra_deg, numbers.dec_deg, utc)
        )
        one = PointingObservation(
            utc=utc,
            seen=seen,
            sigma_arcsec=0.5,
            reading=believed,
            side=told or side,
            segment_id=f"s{self.segment}",
            air=self.air,
            rotation_deg=turn_deg(angle + self.camera_deg + self.rng.normal(0.0, self.camera_noise_deg)),
            parity=self.parity,
            look_id=f"l{len(self.looks) + 1}",
        )
        self.looks.append(one)
        return one

    def _reads(self, utc: datetime, motor: tuple[float, float]) -> Apparent:
        ha, dec = motor[0] + self.shift_deg[0], motor[1] + self.shift_deg[1]
        if abs(half_turn_deg(dec)) > 90.0:
            ha, dec = ha + 180.0, math.copysign(180.0, dec) - dec
        ha, dec = self.sense * ha - self.ahead_s / 240.0 * SIDEREAL, self.sense * dec
        return hour_angle_to_apparent(GeometricHourAngle(half_turn_deg(ha), dec, utc), self.site)

    def sync(self, by_deg: tuple[float, float] = (0.0, 0.0)) -> None:
        """Sync on what was seen last (or that far beside it): a new segment."""
        last = self.looks[-1]
        numbers = last.seen if self.believes_icrs else icrs_to_apparent(last.seen, last.utc)
        place = (
            icrs_to_apparent(Icrs(numbers.ra_deg, numbers.dec_deg), last.utc)
            if self.speaks_icrs
            else Apparent(numbers.ra_deg, numbers.dec_deg, last.utc)
        )
        reading = last.reading
        now = (
            icrs_to_apparent(Icrs(reading.ra_deg, reading.dec_deg), last.utc)
            if self.speaks_icrs
            else Apparent(reading.ra_deg, reading.dec_deg, last.utc)
        )
        a, b = apparent_to_hour_angle(place, self.site), apparent_to_hour_angle(now, self.site)
        beyond = -1.0 if last.side is PierSide.WEST else 1.0
        self.shift_deg = (
            self.shift_deg[0] + self.sense * half_turn_deg(a.ha_deg - b.ha_deg) + by_deg[0],
            self.shift_deg[1] + self.sense * beyond * (a.dec_deg - b.dec_deg) + by_deg[1],
        )
        self.segment += 1
        after = Apparent(numbers.ra_deg, numbers.dec_deg, last.utc)
        if by_deg == (0.0, 0.0):
            self.syncs.append(
                replace(
                    last,
                    reading=Icrs(after.ra_deg, after.dec_deg) if self.believes_icrs else after,
                    segment_id=f"s{self.segment}",
                    utc=last.utc + timedelta(seconds=1),
                )
            )


def errors_of(rng: np.random.Generator, kind: str) -> PointingErrors:
    """Draw a mount: aligned (all within about 60″), scope (8′), eye (polar axis to 1°, cone to 30′)."""
    kind = {"any": ("aligned", "scope", "eye")[int(rng.integers(3))]}.get(kind, kind)
    polar, cone, square, flexure = {
        "aligned": (60.0, 60.0, 30.0, 30.0),
        "scope": (720.0, 600.0, 180.0, 120.0),
        "eye": (3600.0, 1800.0, 300.0, 240.0),
    }[kind]
    size, angle = rng.uniform(0.0, polar), rng.uniform(0.0, 2.0 * math.pi)
    return PointingErrors(
        ih_arcsec=float(rng.normal(0.0, 1800.0)),
        id_arcsec=float(rng.normal(0.0, 1800.0)),
        ch_arcsec=float(rng.uniform(-cone, cone)),
        np_arcsec=float(rng.uniform(-square, square)),
        me_arcsec=float(size * math.cos(angle)),
        ma_arcsec=float(size * math.sin(angle)),
        tf_arcsec=float(rng.uniform(0.0, flexure)),
    )


def patient(rng: np.random.Generator, kind: str) -> Patient:
    """Draw a healthy mount somewhere on Earth."""
    latitude = float(rng.choice([-1.0, 1.0]) * rng.uniform(20.0, 60.0))
    site = Site(latitude, float(rng.choice([-1, 1]) * rng.uniform(5.0, 170.0)), 200.0)
    icrs = bool(rng.integers(2))
    return Patient(
        rng,
        site,
        Air(float(rng.choice([0.0, 950.0]))),
        errors_of(rng, kind),
        believes_icrs=icrs,
        speaks_icrs=icrs,
        parity=int(rng.choice([-1, 1])),
        camera_deg=float(rng.uniform(0.0, 360.0)),
    )


def target(rng: np.random.Generator, site: Site) -> tuple[float, float]:
    """Draw a place above 25°, evenly over the sky: hour angle and declination."""
    while True:
        ha, dec = float(rng.uniform(-180.0, 180.0)), math.degrees(math.asin(float(rng.uniform(-1.0, 1.0))))
        if (
            hour_angle_to_observed(HourAngle(ha, dec, START), site).alt_deg > LOWEST_DEG + 5.0
            and abs(dec) < 88.0
        ):
            return ha, dec


def side_of(ha_deg: float) -> PierSide:
    return PierSide.EAST if ha_deg >= 0.0 else PierSide.WEST


Event = Callable[[Patient], None]


def night(
    one: Patient,
    *,
    looks: int = 4,
    synced: bool = False,
    minutes: tuple[float, float] = (5.0, 40.0),
    event: Event | None = None,
    at: int | None = None,
    random_syncs: float = 0.0,
    sides: str = "",
) -> tuple[PointingObservation, ...]:
    """Look at random targets; sync after the first if asked; let something happen before look `at`."""
    rng = one.rng
    utc = START + timedelta(days=float(rng.uniform(0.0, 365.0)))
    turn = int(rng.integers(1, looks))
    first = None
    for number in range(looks):
        if event is not None and number == at:
            event(one)
        for _ in range(2000):
            ha, dec = target(rng, one.site)
            side = side_of(ha)
            if sides == "flip" and number == turn and first is side:
                continue  # by the look `turn` it must have changed sides
            if sides == "stay" and first is not None and first is not side:
                continue
            told = side
            if sides == "flip" and first is not None:
                told = first
            if sides == "stay" and number >= turn:
                told = PierSide.WEST if side is PierSide.EAST else PierSide.EAST
            if one.look(utc, ha, dec, side, told) is not None:
                first = first or side
                break
        utc += timedelta(minutes=float(rng.uniform(*minutes)))
        if synced and number == 0:
            one.sync()
        elif random_syncs and rng.uniform() < random_syncs:
            one.sync((float(rng.normal(0.0, 0.1)), float(rng.normal(0.0, 0.1))))
    return tuple(one.looks)


def _slip(one: Patient, low_deg: float, high_deg: float) -> None:
    size = float(one.rng.choice([-1.0, 1.0])) * math.exp(
        one.rng.uniform(math.log(low_deg), math.log(high_deg))
    )
    axis = int(one.rng.integers(2))
    shift = list(one.shift_deg)
    shift[axis] += size
    one.shift_deg = (shift[0], shift[1])


def make(illness: str, rng: np.random.Generator, synced: bool, kind: str = "any", count: int = 4) -> Trial:
    """Draw a night with an illness."""
    one = patient(rng, kind)
    first = 2 if synced else 1
    expected: int | None = one.parity
    wanted: tuple[Illness, ...] = ()
    looks: tuple[PointingObservation, ...] = ()
    match illness.split(" ")[0]:
        case "healthy":
            looks = night(one, synced=synced, random_syncs=0.2)
            one.logged = False
        case "epoch":
            one.speaks_icrs = not one.believes_icrs
            wanted, looks = (Illness.EPOCH,), night(one, synced=synced, looks=count)
        case "DST":
            one.ahead_s = float(rng.choice([-3600.0, 3600.0]))
            wanted, looks = (Illness.CLOCK,), night(one, synced=synced)
        case "zone":
            one.ahead_s = 3600.0 * float(rng.choice([-1, 1])) * int(rng.integers(2, 13))
            wanted, looks = (Illness.CLOCK,), night(one, synced=synced)
        case "clock":
            one.ahead_s = float(rng.choice([-1, 1])) * float(rng.uniform(2400.0, 43200.0))
            wanted, looks = (Illness.CLOCK,), night(one, synced=synced)
        case "longitude":
            one.ahead_s = -2.0 * one.site.longitude_deg * 240.0 / SIDEREAL
            wanted, looks = (Illness.LONGITUDE_SIGN,), night(one, synced=synced)
        case "service":
            # ours, not the mount's: the readings agree with what is seen
            wanted, looks = (Illness.LONGITUDE_SIGN,), night(one, synced=synced)
            one.site = replace(one.site, longitude_deg=-one.site.longitude_deg)
        case "hemisphere":
            one.sense = -1.0
            wanted, looks = (Illness.HEMISPHERE,), night(one, synced=synced)
        case "mirrored":
            one.parity = -one.parity
            wanted, looks = (Illness.MIRRORED,), night(one, synced=synced)
        case "side:unreported":
            wanted, looks = (Illness.PIER_SIDE,), night(one, synced=synced, sides="flip")
        case "side:invented":
            wanted, looks = (Illness.PIER_SIDE,), night(one, synced=synced, sides="stay")
        case "slip" | "slip>3°":
            at, least_deg = int(rng.integers(first, 4)), 1.0 if illness == "slip" else 3.0
            looks = night(one, synced=synced, event=lambda who: _slip(who, least_deg, 30.0), at=at)
            wanted = (Illness.SLIPPED,)
        case "reclocked":

            def put(who: Patient) -> None:
                who.ahead_s += float(rng.choice([-3600.0, 3600.0]))

            looks = night(one, synced=synced, event=put, at=int(rng.integers(first, 4)))
            wanted = (Illness.CLOCK,)
    return Trial(one, looks, expected, wanted)


@dataclass(frozen=True, slots=True)
class Trial:
    """A night to be judged."""

    patient: Patient
    looks: tuple[PointingObservation, ...]
    parity: int | None
    wanted: tuple[Illness, ...]

    def judged(
        self, geometry: tuple[Geometry, ...] = ORDINARY, noise_arcsec: float | None = None
    ) -> Diagnosis:
        """Ask the doctor."""
        return diagnose(
            self.looks,
            site=self.patient.site,
            believed_epoch="icrs" if self.patient.believes_icrs else "apparent",
            expected_parity=self.parity,
            mounting="german",
            geometry=geometry,
            noise_arcsec=noise_arcsec,
            synced_on=self.patient.syncs if self.patient.logged else None,
        )

    def with_model(self) -> Diagnosis:
        """Judge with the mount's terms known to 15″, as a model in force knows them."""
        e, rng = self.patient.errors, self.patient.rng
        ch, np_, me, ma, tf = (
            float(value + rng.normal(0.0, 15.0))
            for value in (e.ch_arcsec, e.np_arcsec, e.me_arcsec, e.ma_arcsec, e.tf_arcsec)
        )
        return self.judged(
            known(ch_arcsec=ch, np_arcsec=np_, me_arcsec=me, ma_arcsec=ma, tf_arcsec=tf, sigma_arcsec=15.0),
            NOISE_ARCSEC,
        )


ILLNESSES = (
    "epoch",
    "DST",
    "zone",
    "clock",
    "longitude",
    "hemisphere",
    "mirrored",
    "side:unreported",
    "side:invented",
    "slip",
    "slip>3°",
    "reclocked",
    "service",
)


def main() -> None:
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    nights = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    only = sys.argv[3].split(",") if len(sys.argv) > 3 else ILLNESSES
    print(f"{trials} nights a row, 4 solves, {NOISE_ARCSEC:.0f}″ on the sky: named as it is")
    for illness in only:
        for synced in (False, True):
            for kind in ("model", "aligned", "any"):
                rng = np.random.default_rng([20261121, *illness.encode(), synced, len(kind)])
                found = Counter[str]()
                for _ in range(trials):
                    one = make(illness, rng, synced, "any" if kind == "model" else kind)
                    got = one.with_model() if kind == "model" else one.judged()
                    names = [str(each.what) for each in got.findings]
                    both = [str(other) for each in got.findings for other in each.alternatives]
                    if any(str(wanted) in names for wanted in one.wanted):
                        found["found"] += 1
                    elif any(str(wanted) in both for wanted in one.wanted):
                        found["as alternative to " + ", ".join(names)] += 1
                    elif names:
                        found["else: " + ", ".join(names)] += 1
                    elif got.suspicions:
                        found["suspected: " + ", ".join(str(each.what) for each in got.suspicions)] += 1
                    else:
                        found["missed"] += 1
                rest = ", ".join(f"{name} {count}" for name, count in found.most_common() if name != "found")
                print(
                    f"{illness:16s} {'synced' if synced else 'raw':7s} {kind:8s} "
                    f"{100.0 * found['found'] / trials:6.1f} %   {rest}",
                    flush=True,
                )
    for looks in (4, 6, 8, 12, 20) if "epoch" in only else ():
        rng = np.random.default_rng([20261121, looks])
        named = sum(
            any(
                one.what is Illness.EPOCH for one in make("epoch", rng, False, "any", looks).judged().findings
            )
            for _ in range(trials)
        )
        print(
            f"epoch, nothing known of the mount, {looks:2d} solves: {100.0 * named / trials:.1f} %",
            flush=True,
        )
    for kind in ("aligned", "scope", "eye") if nights else ():
        rng = np.random.default_rng([7, len(kind)])
        alarms, suspected, began = Counter[str](), Counter[str](), time.perf_counter()
        for number in range(nights):
            got = make("healthy", rng, bool(number % 2), kind).judged()
            alarms.update(str(one.what) for one in got.findings)
            suspected.update(str(one.what) for one in got.suspicions)
        spent = time.perf_counter() - began
        print(
            f"healthy {kind:8s} {nights} nights: alarms {dict(alarms)}, suspicions {dict(suspected)}, "
            f"{1000.0 * spent / max(nights, 1):.0f} ms a night"
        )


if __name__ == "__main__":
    main()
