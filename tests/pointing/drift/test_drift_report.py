"""Drift reports of simulated mounts: rates, periodic error, jumps, settling, polar axis against the truth."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from mountnav.pointing.drift import drift_report
from mountnav.pointing.observation import PointingObservation
from mountnav.simulation.geometry import true_direction
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.chain import hour_angle_to_apparent, hour_angle_to_observed
from mountnav.sky.coordinates import Air, GeometricHourAngle, HourAngle, Site
from mountnav.sky.sphere import displaced
from tests.present import present

START = datetime(2026, 11, 21, 20, tzinfo=UTC)
NORTH, SOUTH = Site(48.93, 22.27, 700.0), Site(-30.2, -70.7, 2700.0)
AIR = Air(930.0)


class Hand:
    """A clock that is put on by hand."""

    def __init__(self) -> None:
        self.utc = START

    def __call__(self) -> datetime:
        return self.utc


def watched(
    site: Site,
    errors: PointingErrors,
    places: list[tuple[float, float]],
    *,
    minutes: float = 40.0,
    every_s: float = 60.0,
    sigma_arcsec: float = 0.2,
    air: Air = AIR,
    seed: int = 1,
) -> tuple[list[PointingObservation], list[datetime]]:
    """Follow places (hour angle, declination) one after another, looking ever so often."""
    rng = np.random.default_rng(seed)
    clock = Hand()
    mount = Mechanics(site, air, errors, machine=Machine(), clock=clock)
    looks: list[PointingObservation] = []
    ends: list[datetime] = []
    for ha_deg, dec_deg in places:
        mount.slew(hour_angle_to_apparent(GeometricHourAngle(ha_deg, dec_deg, clock.utc), site))
        while mount.slewing():
            clock.utc += timedelta(seconds=1)
        ends.append(clock.utc)
        for _ in range(int(minutes * 60.0 / every_s)):
            clock.utc += timedelta(seconds=every_s)
            east, north = rng.normal(0.0, sigma_arcsec, 2)
            looks.append(
                PointingObservation(
                    utc=clock.utc,
                    seen=displaced(mount.truth(), float(east), float(north)),
                    sigma_arcsec=sigma_arcsec,
                    reading=mount.reported(),
                    segment_id="s",
                    air=air,
                )
            )
    return looks, ends


PLACES = {
    NORTH: [(0.0, 10.0), (-75.0, 35.0), (60.0, 20.0)],
    SOUTH: [(0.0, -10.0), (-75.0, -35.0), (60.0, -20.0)],
}


@pytest.mark.parametrize("site", [NORTH, SOUTH], ids=["north", "south"])
@pytest.mark.parametrize(("me", "ma"), [(200.0, -320.0), (-150.0, 90.0)])
def test_polar_error_from_drift_and_its_advice_reduces_the_error(site: Site, me: float, ma: float) -> None:
    errors = PointingErrors(me_arcsec=me, ma_arcsec=ma, ch_arcsec=200.0, ih_arcsec=500.0)
    report = drift_report(watched(site, errors, PLACES[site])[0], site=site)
    assert report.polar is not None, report.polar_reason
    found = report.polar.from_drift
    assert found is not None
    assert abs(found.me_arcsec - me) < 4.0 * found.me_sigma_arcsec + 3.0
    assert abs(found.ma_arcsec - ma) < 4.0 * found.ma_sigma_arcsec + 3.0
    assert max(found.me_sigma_arcsec, found.ma_sigma_arcsec) < 20.0
    # where the axis' upper end truly stands, by the simulator; then the knobs are turned as advised
    axis = HourAngle(
        *true_direction(
            0.0,
            math.copysign(90.0, site.latitude_deg),
            PointingErrors(me_arcsec=me, ma_arcsec=ma),
            site.latitude_deg,
        ),
        START,
    )
    stands = hour_angle_to_observed(axis, site)
    assert report.polar.raise_arcmin is not None
    assert report.polar.east_arcmin is not None
    alt = stands.alt_deg + report.polar.raise_arcmin / 60.0
    # facing south, what goes east goes back in azimuth
    pole_az, eastward = (0.0, 1.0) if site.latitude_deg > 0.0 else (180.0, -1.0)
    az = stands.az_deg + eastward * report.polar.east_arcmin / 60.0
    left_az = (az - pole_az + 180.0) % 360.0 - 180.0
    before = math.hypot(me, ma)
    after = 3600.0 * math.hypot(
        alt - abs(site.latitude_deg), left_az * math.cos(math.radians(site.latitude_deg))
    )
    assert after < 0.1 * before + 3.0


def test_advice_followed_leaves_less_drift() -> None:
    errors = PointingErrors(me_arcsec=300.0, ma_arcsec=240.0)
    first = drift_report(watched(NORTH, errors, PLACES[NORTH])[0], site=NORTH)
    assert first.polar is not None
    assert first.polar.used is not None
    assert first.polar.advice.startswith("raise the polar axis 5.")
    assert (
        "turn the azimuth knob 6." in first.polar.advice
    )  # 240″ are 6.1′ about the vertical at this latitude
    assert first.polar.advice.endswith("west")
    better = replace(
        errors,
        me_arcsec=errors.me_arcsec - present(first.polar.raise_arcmin) * 60.0,
        ma_arcsec=errors.ma_arcsec
        + present(first.polar.east_arcmin) * 60.0 * math.cos(math.radians(NORTH.latitude_deg)),
    )
    second = drift_report(watched(NORTH, better, PLACES[NORTH])[0], site=NORTH)
    for old, new in zip(first.stretches, second.stretches, strict=True):
        assert (
            math.hypot(present(new.rates).east_arcsec_h, present(new.rates).north_arcsec_h)
            < 0.1 * math.hypot(present(old.rates).east_arcsec_h, present(old.rates).north_arcsec_h) + 2.0
        )


def test_a_perfect_mount_drifts_only_by_refraction() -> None:
    report = drift_report(watched(NORTH, PointingErrors(), [(-60.0, 10.0)])[0], site=NORTH)
    (stretch,) = report.stretches
    assert abs(present(stretch.rates).east_arcsec_h) < 4.0 * present(stretch.rates).east_sigma_arcsec_h + 0.05
    assert (
        abs(present(stretch.rates).north_arcsec_h) < 4.0 * present(stretch.rates).north_sigma_arcsec_h + 0.05
    )
    # at this altitude refraction alone is plainly seen, and told apart
    assert (
        math.hypot(present(stretch.refraction).east_arcsec_h, present(stretch.refraction).north_arcsec_h)
        > 5.0
    )
    left = drift_report(watched(NORTH, PointingErrors(), [(-60.0, 10.0)])[0], site=NORTH, mount_refracts=True)
    assert (
        math.hypot(
            present(left.stretches[0].rates).east_arcsec_h, present(left.stretches[0].rates).north_arcsec_h
        )
        > 5.0
    )


def test_one_hour_angle_tells_only_half_of_the_axis() -> None:
    report = drift_report(
        watched(NORTH, PointingErrors(me_arcsec=300.0, ma_arcsec=100.0), [(0.0, 0.0)], minutes=20)[0],
        site=NORTH,
    )
    assert report.polar is None
    assert "only the azimuth error" in report.polar_reason


def test_model_and_drift_agree_or_nothing_is_turned() -> None:
    looks = watched(NORTH, PointingErrors(me_arcsec=200.0, ma_arcsec=-100.0), PLACES[NORTH])[0]
    same = present(
        drift_report(looks, site=NORTH, model_terms={"ME": (203.0, 3.0), "MA": (-98.0, 3.0)}).polar
    )
    assert same.agree is True
    assert present(same.used).me_sigma_arcsec < 3.0
    other = present(
        drift_report(looks, site=NORTH, model_terms={"ME": (-200.0, 3.0), "MA": (-98.0, 3.0)}).polar
    )
    assert other.agree is False
    assert other.used is None
    assert "contradict" in other.advice
    alone = present(drift_report([], site=NORTH, model_terms={"ME": (60.0, 3.0), "MA": (0.0, 3.0)}).polar)
    assert alone.advice == "raise the polar axis 1.0′ ± 0.1′"


def test_periodic_error_is_found_with_its_amplitude() -> None:
    errors = PointingErrors(periodic_amplitude_arcsec=8.0, periodic_period_s=480.0)
    looks, _ = watched(NORTH, errors, [(-20.0, 40.0)], minutes=60, every_s=30.0, sigma_arcsec=0.5)
    found = present(drift_report(looks, site=NORTH, worm_period_s=480.0).periodic)
    assert abs(found.period_s - 480.0) < 5.0 * found.period_sigma_s + 1.0
    assert found.period_sigma_s < 5.0
    assert abs(found.amplitude_arcsec - 8.0) < 5.0 * found.amplitude_sigma_arcsec
    assert found.amplitude_sigma_arcsec < 0.2
    assert found.false_alarm < 1e-6
    assert found.is_worm is True
    assert present(drift_report(looks, site=NORTH, worm_period_s=638.0).periodic).is_worm is False


def test_no_periodic_error_is_told_without_one_or_too_early() -> None:
    calm, _ = watched(NORTH, PointingErrors(), [(-20.0, 40.0)], minutes=60, every_s=30.0, sigma_arcsec=0.5)
    none = drift_report(calm, site=NORTH)
    assert none.periodic is None
    assert "no period stands out" in none.periodic_reason
    swinging = PointingErrors(periodic_amplitude_arcsec=8.0)
    few, _ = watched(NORTH, swinging, [(-20.0, 40.0)], minutes=60, every_s=400.0)
    early = drift_report(few, site=NORTH)
    assert early.periodic is None
    assert "needed" in early.periodic_reason


def test_even_sampling_names_its_aliases() -> None:
    swinging = PointingErrors(periodic_amplitude_arcsec=8.0)
    looks, _ = watched(NORTH, swinging, [(-20.0, 40.0)], minutes=90, every_s=100.0)
    found = present(drift_report(looks, site=NORTH).periodic)
    # 1/100 s ± 1/480 s
    assert [round(one) for one in found.aliases_s[:2]] == [126, 83]


def test_a_jump_is_no_drift() -> None:
    looks, _ = watched(NORTH, PointingErrors(), [(-20.0, 40.0)])
    jumped = looks[:20] + [replace(one, seen=displaced(one.seen, 25.0, -10.0)) for one in looks[20:]]
    (stretch,) = drift_report(jumped, site=NORTH).stretches
    (jump,) = stretch.jumps
    assert jump.utc == looks[20].utc
    assert jump.east_arcsec == pytest.approx(25.0, abs=2.0)
    assert jump.north_arcsec == pytest.approx(-10.0, abs=2.0)
    assert abs(present(stretch.rates).east_arcsec_h) < 2.0


def test_settling_is_limited_by_the_looks_round_it() -> None:
    looks, ends = watched(
        NORTH, PointingErrors(), [(-40.0, 30.0), (0.0, 20.0), (30.0, 50.0)], minutes=3, every_s=5.0
    )
    # 20″ off at the end of the slew, gone with a time constant of 5 s: below the noise (0.2″) after some 20 s
    settled = []
    for one in looks:
        since = (one.utc - max(end for end in ends if end < one.utc)).total_seconds()
        settled.append(replace(one, seen=displaced(one.seen, 20.0 * math.exp(-since / 5.0), 0.0)))
    found = present(drift_report(settled, site=NORTH, slew_ends=ends).settling)
    assert found.slews == 3
    least_s, most_s = present(found.least_s), present(found.most_s)
    assert 10.0 <= least_s < most_s <= 30.0
    assert least_s <= present(found.typical_s) <= most_s
    still = present(drift_report(looks, site=NORTH, slew_ends=ends).settling)
    assert still.least_s is None
    assert still.most_s == pytest.approx(5.0)
    assert drift_report(looks, site=NORTH).settling is None


def test_nothing_is_told_of_nothing() -> None:
    report = drift_report([], site=NORTH)
    assert report.stretches == ()
    assert (report.periodic, report.settling, report.polar) == (None, None, None)
    assert report.as_dict()["words"] == "No drift is known: no three looks lie between two moves."
