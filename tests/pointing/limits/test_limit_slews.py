"""Slews checked: postures, what the mount says of itself, the Sun on the way, and tracking afterwards."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.devices import PierSide
from mountnav.errors import BadSettings, LimitKind, OutsideLimits
from mountnav.pointing.limits import Horizon, Limits
from mountnav.pointing.limits.bodies import bodies
from mountnav.pointing.limits.detours import legs_to
from mountnav.sky.chain import (
    hour_angle_to_icrs,
    hour_angle_to_observed,
    icrs_to_hour_angle,
    icrs_to_observed,
    observed_to_icrs,
)
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Observed, Site
from mountnav.sky.sphere import half_turn_deg

SITE = Site(48.93, 22.27, 700.0)
AIR = Air(930.0, 5.0, 0.7)
NIGHT = datetime(2026, 11, 21, 22, tzinfo=UTC)
MORNING = datetime(2026, 6, 21, 7, tzinfo=UTC)
EAST, WEST = PierSide.EAST, PierSide.WEST
GERMAN = Limits(15.0, past_meridian_deg=(5.0, 5.0))


def at(ha_deg: float, dec_deg: float, utc: datetime = NIGHT, site: Site = SITE) -> Icrs:
    return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc), site, AIR)


def refused(
    limits: Limits, start: Icrs, target: Icrs, utc: datetime = NIGHT, **known: object
) -> OutsideLimits:
    with pytest.raises(OutsideLimits) as refusal:
        limits.check_slew(start, target, utc, SITE, AIR, **known)  # type: ignore[arg-type]
    return refusal.value


def test_both_postures_are_tried_and_told() -> None:
    start, target = at(-40.0, 20.0), at(3.0, 20.0)
    stays = GERMAN.check_slew(start, target, NIGHT, SITE, AIR, mounting="german", side=WEST, destination=WEST)
    assert stays.sides == (WEST,)
    check = GERMAN.check_slew(start, at(10.0, 40.0), NIGHT, SITE, AIR, mounting="german", side=WEST)
    assert check.sides == (EAST,)
    assert check.ways == ("changing to the east side of the pier",)
    assert check.refused == ("staying on the west side of the pier, which it may do unasked: watched for",)
    assert not check.sure


def test_a_side_that_the_axes_do_not_reach_is_refused_and_the_other_one_named() -> None:
    told = refused(GERMAN, at(-40.0, 40.0), at(12.0, 40.0), mounting="german", side=WEST, destination=WEST)
    assert told.limit is LimitKind.MERIDIAN
    assert "7.0° too far past the meridian" in str(told)
    assert "changing to the east side of the pier would be allowed" in str(told)


def test_near_the_meridian_a_mount_that_may_stay_has_to_be_allowed_both() -> None:
    start, target = at(-40.0, 40.0), at(3.0, 40.0)
    check = GERMAN.check_slew(start, target, NIGHT, SITE, AIR, mounting="german", side=WEST)
    assert set(check.sides) == {EAST, WEST}
    # none flips to the side that looks the other way
    check = GERMAN.check_slew(at(40.0, 40.0), target, NIGHT, SITE, AIR, mounting="german", side=EAST)
    assert check.sides[0] is EAST
    assert check.ways == ("staying on the east side of the pier",)


def test_nothing_known_of_the_mount_is_checked_as_a_fork_and_a_side_makes_it_german() -> None:
    start, target = at(-40.0, 40.0), at(40.0, 40.0)
    assert Limits(15.0).check_slew(start, target, NIGHT, SITE, AIR).mounting == "fork"
    assert Limits(15.0).check_slew(start, target, NIGHT, SITE, AIR, side=WEST).mounting == "german"
    assert Limits(15.0).check_slew(start, target, NIGHT, SITE, AIR, mounting="altaz").mounting == "altaz"


def test_over_the_pole_or_along_the_north_the_way_counts_not_only_its_ends() -> None:
    # both stand well, and a fork turns by way of the north between them
    start, target = at(-110.0, 45.0), at(110.0, 45.0)
    for place in (start, target):
        Limits(15.0).check(place, NIGHT, SITE, AIR)
    told = refused(Limits(15.0), start, target, mounting="fork")
    assert told.limit is LimitKind.ALTITUDE
    assert "of the way the tube might be at altitude" in str(told)
    legs = legs_to(Limits(15.0), start, target, NIGHT, SITE, AIR, "fork", None)
    assert len(legs) >= 2
    for begin, end in zip((start, *legs), legs, strict=False):
        Limits(15.0).check_slew(begin, end, NIGHT, SITE, AIR, mounting="fork")


def test_the_suns_cone_is_kept_from_on_the_way_and_at_its_end() -> None:
    sun = bodies(MORNING, SITE).sun
    limits = Limits(5.0, sun_cone_deg=20.0)
    before, behind = (at(sun.ha_deg + step, sun.dec_deg, MORNING) for step in (-40.0, 40.0))
    told = refused(limits, before, behind, MORNING, mounting="fork")
    assert told.limit is LimitKind.SUN
    assert "from the Sun" in str(told)
    near = refused(limits, before, at(sun.ha_deg, sun.dec_deg + 12.0, MORNING), MORNING, mounting="fork")
    assert "12." in str(near)
    assert near.limit is LimitKind.SUN
    assert legs_to(limits, before, behind, MORNING, SITE, AIR, "fork", None)
    # the same at midnight is nobody's business
    midnight = MORNING - timedelta(hours=8.5)
    limits.check(at(sun.ha_deg, sun.dec_deg + 12.0, midnight), midnight, SITE, AIR)


def test_the_moons_cone_if_asked_for() -> None:
    moon = bodies(NIGHT, SITE).moon
    place = at(moon.ha_deg, moon.dec_deg + 3.0)
    Limits(5.0).check(place, NIGHT, SITE, AIR)
    with pytest.raises(OutsideLimits, match="from the Moon") as refusal:
        Limits(5.0, moon_cone_deg=10.0).check(place, NIGHT, SITE, AIR)
    assert refusal.value.limit is LimitKind.MOON


def test_by_day_if_that_is_refused() -> None:
    limits = Limits(5.0, daylight="refuse")
    place = at(-60.0, 70.0, MORNING)
    Limits(5.0).check(place, MORNING, SITE, AIR)
    with pytest.raises(OutsideLimits, match="nothing is slewed or tracked") as refusal:
        limits.check(place, MORNING, SITE, AIR)
    assert refusal.value.limit is LimitKind.DAYLIGHT
    when = limits.next_allowed(place, MORNING, SITE, AIR)
    assert when is not None
    sun = bodies(when, SITE).sun
    seen = hour_angle_to_observed(HourAngle(sun.ha_deg, sun.dec_deg, when), SITE)
    assert seen.alt_deg == pytest.approx(-6.0, abs=0.01)


def test_a_target_that_sets_during_the_slew_is_refused() -> None:
    target = observed_to_icrs(Observed(275.0, 15.1, NIGHT), SITE, AIR)
    told = refused(Limits(15.0), at(0.0, 40.0), target, mounting="fork")
    assert "it would be below the limit" in str(told)
    assert "soon leaves" in str(told)
    Limits(15.0, slew_takes_s=5.0, track_for_s=5.0).check_slew(
        at(0.0, 40.0), target, NIGHT, SITE, AIR, mounting="fork"
    )


def test_a_german_mount_near_the_equator_is_told_what_to_set() -> None:
    site = Site(10.0, 22.27)
    start, target = at(-30.0, 0.0, site=site), at(40.0, 0.0, site=site)
    with pytest.raises(OutsideLimits, match=r"limits\.way_min_altitude_deg"):
        Limits(15.0).check_slew(start, target, NIGHT, site, AIR, mounting="german", side=WEST)
    lower = Limits(15.0, way_min_altitude_deg=0.0, rate_ratio=(0.8, 1.25))
    if not legs_to(lower, start, target, NIGHT, site, AIR, "german", WEST):
        lower.check_slew(start, target, NIGHT, site, AIR, mounting="german", side=WEST)


# the pole stands 30 degrees high, and a tube that changes sides may sink beneath it by more than these 5
LOW_POLE = Site(-30.08, 95.08, 1900.0)
ABOVE_25 = Limits(25.0, rate_ratio=(0.8, 1.25), margin_deg=0.5)


def test_what_a_mount_foretells_leads_it_where_either_side_may_be_the_present_one() -> None:
    # at the zenith: nothing tells on which side the tube hangs, and no way is allowed from both of them
    start, target = at(0.3, -30.0, site=LOW_POLE), at(-50.0, -40.0, site=LOW_POLE)
    with pytest.raises(OutsideLimits, match="would be allowed"):
        ABOVE_25.check_slew(start, target, NIGHT, LOW_POLE, AIR, mounting="german", side=None)
    assert not legs_to(ABOVE_25, start, target, NIGHT, LOW_POLE, AIR, "german", None)
    legs = legs_to(ABOVE_25, start, target, NIGHT, LOW_POLE, AIR, "german", None, foretold=WEST)
    assert len(legs) >= 2
    # the first one is allowed from either side, and where the mount comes to shows which it is
    first = ABOVE_25.check_slew(
        start,
        legs[0],
        NIGHT,
        LOW_POLE,
        AIR,
        mounting="german",
        side=None,
        destination=WEST if icrs_to_hour_angle(legs[0], NIGHT, LOW_POLE, AIR).ha_deg < 0.0 else EAST,
        track_for_s=0.0,
    )
    assert {way.start.side for way in first.expected} == {EAST, WEST}
    assert len(first.sides) == 1


def test_limits_of_hour_angle_declination_and_axes() -> None:
    limits = Limits(5.0, hour_angle_deg=(-60.0, 60.0), declination_deg=(-20.0, 75.0))
    for place, limit in (((70.0, 40.0), LimitKind.HOUR_ANGLE), ((0.0, 80.0), LimitKind.DECLINATION)):
        with pytest.raises(OutsideLimits) as refusal:
            limits.check(at(*place), NIGHT, SITE, AIR)
        assert refusal.value.limit is limit
    axis = Limits(5.0, second_axis_deg=(-30.0, 60.0))
    told = refused(axis, at(0.0, 40.0), at(0.0, 70.0), mounting="fork")
    assert told.limit is LimitKind.UNREACHABLE


@pytest.mark.parametrize(
    "wrong",
    [
        {"sun_cone_deg": -1.0},
        {"sun_cone_deg": 95.0},
        {"hour_angle_deg": (10.0, -10.0)},
        {"rate_ratio": (0.0, 2.0)},
        {"past_meridian_deg": (-5.0, 5.0)},
        {"margin_deg": float("nan")},
        {"track_for_s": -1.0},
    ],
)
def test_limits_that_make_no_sense(wrong: dict[str, object]) -> None:
    with pytest.raises(BadSettings):
        Limits(15.0, **wrong)  # type: ignore[arg-type]


WALL = Horizon(((0.0, 10.0), (100.0, 10.0), (100.0, 40.0), (140.0, 40.0), (140.0, 10.0)))


@pytest.mark.long
@settings(max_examples=25, deadline=None)
@given(st.floats(0.0, 360.0, exclude_max=True), st.floats(-60.0, 90.0), st.floats(0.0, 24.0))
def test_the_next_time_is_right_with_walls_and_sun(ra_deg: float, dec_deg: float, hour: float) -> None:
    limits = Limits(12.0, horizon=WALL, sun_cone_deg=20.0, hour_angle_deg=(-100.0, 100.0))
    target, utc = Icrs(ra_deg, dec_deg), MORNING + timedelta(hours=hour)

    def allowed(when: datetime) -> bool:
        try:
            limits.check(target, when, SITE, AIR)
        except OutsideLimits:
            return False
        return True

    when = limits.next_allowed(target, utc, SITE, AIR)
    looks = [utc + timedelta(minutes=20.0 * step) for step in range(72)]
    if when is None:
        assert not any(map(allowed, looks))
        return
    assert allowed(when)
    if when > utc:
        assert not any(
            allowed(look)
            for look in [*looks, when - timedelta(seconds=3)]
            if look <= when - timedelta(seconds=2)
        )


@settings(max_examples=40, deadline=None)
@given(st.floats(-100.0, 100.0), st.floats(-20.0, 85.0), st.sampled_from([EAST, WEST]))
def test_the_time_to_a_limit_is_right(ha_deg: float, dec_deg: float, side: PierSide) -> None:
    limits = Limits(15.0, horizon=WALL, past_meridian_deg=(8.0, 8.0))
    place = at(ha_deg, dec_deg)
    soon = limits.reached(place, NIGHT, SITE, AIR, mounting="german", side=side)
    if soon is None or soon.after_s == 0.0:
        return
    later = NIGHT + timedelta(seconds=soon.after_s)
    if soon.limit is LimitKind.MERIDIAN:
        # whichever comes first: the axis as the sky is seen, or as a mount reckons that knows no refraction
        bare = icrs_to_hour_angle(place, NIGHT, SITE, Air(0.0))
        turned_deg = soon.after_s * 15.041 / 3600.0 + (180.0 if side is WEST else 0.0)
        past_deg = [half_turn_deg(one + turned_deg - 188.0) for one in (ha_deg, bare.ha_deg)]
        assert max(past_deg) == pytest.approx(0.0, abs=0.02)
        return
    seen = icrs_to_observed(place, later, SITE, AIR)
    edge = max(15.0, WALL.altitude_at(seen.az_deg + 0.3))
    assert seen.alt_deg < edge + 0.1
