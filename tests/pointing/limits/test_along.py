"""Limits along a path: each kind is found where the path truly enters it; a star's is as `reached`."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mountnav.devices import PierSide
from mountnav.errors import BadRequest, LimitKind
from mountnav.pointing.limits import Horizon, Limits, Mounting
from mountnav.pointing.limits.along import (
    Path,
    SkyEvent,
    SkyEventKind,
    forecast,
    reached_along,
    reached_by_axes,
)
from mountnav.pointing.limits.scene import Scene
from mountnav.sky.chain import (
    apparent_to_icrs,
    hour_angle_to_icrs,
    icrs_to_hour_angle,
    icrs_to_observed,
    observed_to_icrs,
)
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, HourAngle, Icrs, Observed, Site
from mountnav.sky.planets import position_of_body
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

SITE = Site(48.93, 22.27, 700.0)
AIR = Air(930.0, 5.0, 0.7)
VACUUM = Air(0.0)
NIGHT = datetime(2026, 11, 21, 22, tzinfo=UTC)
DAY = datetime(2026, 6, 21, 10, tzinfo=UTC)


def star(ha_deg: float, dec_deg: float, utc: datetime = NIGHT, air: Air = AIR) -> Path:
    place = hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc), SITE, air)
    return lambda _: place


def drifting(ha_deg: float, dec_deg: float, ra_deg_s: float, dec_deg_s: float, utc: datetime = NIGHT) -> Path:
    """From a place at steady rates in right ascension and declination."""
    begins = star(ha_deg, dec_deg, utc)(utc)

    def place(at: datetime) -> Icrs:
        seconds = (at - utc).total_seconds()
        return Icrs(
            (begins.ra_deg + ra_deg_s * seconds) % 360.0,
            max(-90.0, min(90.0, begins.dec_deg + dec_deg_s * seconds)),
        )

    return place


def over_ground(points: Callable[[float], tuple[float, float]], utc: datetime = NIGHT) -> Path:
    """By azimuth and altitude (of seconds)."""

    def place(at: datetime) -> Icrs:
        az_deg, alt_deg = points((at - utc).total_seconds())
        return observed_to_icrs(Observed(az_deg % 360.0, alt_deg, at), SITE, AIR)

    return place


def satellite(
    highest_deg: float, utc: datetime = NIGHT, to_az_deg: float = 90.0, half_s: float = 300.0
) -> Path:
    """A pass on a great circle through a highest point in the south: 1.2°/s there, slow near the horizon."""

    def points(seconds: float) -> tuple[float, float]:
        # as from a straight way 500 km high: the angle along the circle
        along = math.atan((seconds - half_s) * 7.5 / 500.0)
        tilt = math.radians(90.0 - highest_deg)
        x, y, z = math.sin(along), math.cos(along) * math.sin(tilt), math.cos(along) * math.cos(tilt)
        # x to the east, y to the south
        return math.degrees(math.atan2(x, -y)), math.degrees(math.asin(z))

    return over_ground(points, utc)


# -- a fixed star ----------------------------------------------------------------------------------

MOUNTINGS: tuple[Mounting, ...] = ("german", "fork", "altaz")


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(
    ha_deg=st.floats(-180.0, 180.0),
    dec_deg=st.floats(-35.0, 89.0),
    mounting=st.sampled_from(MOUNTINGS),
    side=st.sampled_from([None, PierSide.EAST, PierSide.WEST]),
    margin_deg=st.sampled_from([0.0, 0.25, 2.0]),
    within_s=st.sampled_from([0.0, 600.0, 20_000.0]),
)
def test_a_stars_path_reaches_what_tracking_reaches(
    ha_deg: float,
    dec_deg: float,
    mounting: Mounting,
    side: PierSide | None,
    margin_deg: float,
    within_s: float,
) -> None:
    limits = Limits(
        20.0,
        80.0,
        horizon=Horizon(((0.0, 5.0), (100.0, 30.0), (200.0, 12.0), (290.0, 45.0))),
        hour_angle_deg=(-75.0, 80.0),
        declination_deg=(-30.0, 85.0),
        past_meridian_deg=(10.0, 5.0),
        first_axis_deg=(-200.0, 260.0),
        second_axis_deg=(-40.0, 200.0),
        sun_cone_deg=25.0,
        daylight="refuse",
        margin_deg=margin_deg,
    )
    path = star(ha_deg, dec_deg, air=VACUUM)
    one = limits.reached(path(NIGHT), NIGHT, SITE, VACUUM, mounting=mounting, side=side, within_s=within_s)
    other = reached_along(limits, path, NIGHT, SITE, VACUUM, mounting=mounting, side=side, within_s=within_s)
    if one is None or other is None:
        # one at the very end of the time, or just at a limit
        found = one or other
        assert found is None or found.after_s > within_s - 30.0 or found.after_s < 1.0
        return
    assert other.after_s == pytest.approx(one.after_s, abs=20.0)
    if one.limit is not other.limit:
        # two at once
        assert abs(one.after_s - other.after_s) < 20.0
    else:
        assert other.alt_deg == pytest.approx(one.alt_deg, abs=0.6)


# -- each kind of limit ----------------------------------------------------------------------------


def entered(
    limits: Limits,
    path: Path,
    utc: datetime,
    within_s: float,
    mounting: Mounting | None = "fork",
    side: PierSide | None = None,
) -> tuple[LimitKind, float]:
    found = reached_along(limits, path, utc, SITE, AIR, mounting=mounting, side=side, within_s=within_s)
    assert found is not None
    return found.limit, found.after_s


def at(utc: datetime, seconds: float) -> datetime:
    return utc + timedelta(seconds=seconds)


@pytest.mark.parametrize(("rate", "alt_deg"), [(-0.01, 20.0), (-1.0, 20.0), (0.2, 75.0)])
def test_altitude(rate: float, alt_deg: float) -> None:
    path = drifting(0.0, 20.0, 0.0, rate)
    kind, after_s = entered(Limits(20.0, 75.0), path, NIGHT, 60.0 / abs(rate))
    assert kind is LimitKind.ALTITUDE
    place = icrs_to_observed(path(at(NIGHT, after_s)), at(NIGHT, after_s), SITE, AIR)
    assert place.alt_deg == pytest.approx(alt_deg, abs=0.1)


@pytest.mark.parametrize("seconds", [2000.0, 60.0, 10.0])
def test_a_flagpole_on_the_horizon(seconds: float) -> None:
    """Half a degree wide, however fast the target comes by."""
    pole = Horizon(((0.0, 5.0), (179.75, 5.0), (179.75, 60.0), (180.25, 60.0), (180.25, 5.0), (359.0, 5.0)))
    path = over_ground(lambda s: (120.0 + 100.0 * s / seconds, 40.0))
    kind, after_s = entered(Limits(0.0, horizon=pole), path, NIGHT, seconds)
    assert kind is LimitKind.HORIZON
    assert 120.0 + 100.0 * after_s / seconds == pytest.approx(179.75, abs=0.4)


@pytest.mark.parametrize("rate", [0.002, 0.2])
def test_sun_cone(rate: float) -> None:
    sun = position_of_body("sun", DAY, SITE)
    begins = Icrs(sun.ra_deg, sun.dec_deg + 40.0)

    def path(utc: datetime) -> Icrs:
        return Icrs(begins.ra_deg, begins.dec_deg - rate * (utc - DAY).total_seconds())

    kind, after_s = entered(Limits(5.0, sun_cone_deg=20.0), path, DAY, 35.0 / rate)
    assert kind is LimitKind.SUN
    then = at(DAY, after_s)
    apart = separation_arcsec(path(then), position_of_body("sun", then, SITE)) / 3600.0
    assert apart == pytest.approx(20.0, abs=0.15)


def test_moon_cone_in_which_the_moon_moves_itself() -> None:
    begins = datetime(2026, 11, 24, 18, tzinfo=UTC)
    moon = position_of_body("moon", begins, SITE)
    # it stays, and the Moon comes: half a degree an hour
    place = Icrs((moon.ra_deg + 23.5) % 360.0, moon.dec_deg)
    limits = Limits(-5.0, moon_cone_deg=20.0)
    found = reached_along(limits, lambda _: place, begins, SITE, AIR, mounting="fork", within_s=36_000.0)
    assert found is not None
    assert found.limit is LimitKind.MOON
    then = at(begins, found.after_s)
    topocentric_deg = 1.0
    apart = separation_arcsec(place, position_of_body("moon", then, SITE)) / 3600.0
    assert apart == pytest.approx(20.0, abs=topocentric_deg + 0.2)


def test_daylight() -> None:
    limits = Limits(5.0, daylight="refuse", daylight_from_altitude_deg=-6.0)
    kind, after_s = entered(limits, star(-60.0, 80.0), NIGHT, 43_200.0)
    assert kind is LimitKind.DAYLIGHT
    then = at(NIGHT, after_s)
    sun = icrs_to_observed(position_of_body("sun", then, SITE), then, SITE, VACUUM)
    assert sun.alt_deg == pytest.approx(-6.0, abs=0.1)


@pytest.mark.parametrize(("side", "ha_deg", "ra_rate"), [("east", 3.0, 0.05), ("west", -3.0, -0.05)])
def test_meridian_on_either_side_of_the_pier(side: str, ha_deg: float, ra_rate: float) -> None:
    """To the east the tube that hangs east, to the west the other: 8° are allowed."""
    limits = Limits(5.0, past_meridian_deg=(8.0, 8.0))
    path = drifting(ha_deg, 20.0, ra_rate, 0.0)
    kind, after_s = entered(limits, path, NIGHT, 600.0, "german", PierSide(side))
    assert kind is LimitKind.MERIDIAN
    here = icrs_to_hour_angle(path(at(NIGHT, after_s)), at(NIGHT, after_s), SITE, AIR)
    assert abs(here.ha_deg) == pytest.approx(8.0, abs=0.1)
    # on the other side it goes on
    other = PierSide(side).other
    assert (
        reached_along(limits, path, NIGHT, SITE, AIR, mounting="german", side=other, within_s=600.0) is None
    )


def test_hour_angle() -> None:
    path = drifting(0.0, 20.0, -0.02, 0.0)
    kind, after_s = entered(Limits(-5.0, hour_angle_deg=(-30.0, 30.0)), path, NIGHT, 3600.0)
    assert kind is LimitKind.HOUR_ANGLE
    assert after_s * (0.02 + SIDEREAL_DEG_S) == pytest.approx(30.0, abs=0.1)


def test_declination() -> None:
    path = drifting(0.0, 20.0, 0.0, 0.01)
    kind, after_s = entered(Limits(5.0, declination_deg=(-10.0, 40.0)), path, NIGHT, 3600.0)
    assert kind is LimitKind.DECLINATION
    assert 20.0 + 0.01 * after_s == pytest.approx(40.0, abs=0.1)


@pytest.mark.long
@pytest.mark.parametrize(
    ("mounting", "axes", "path"),
    [
        ("fork", {"first_axis_deg": (-40.0, 40.0)}, drifting(0.0, 20.0, -0.05, 0.0)),
        ("fork", {"second_axis_deg": (-20.0, 45.0)}, drifting(0.0, 20.0, 0.0, 0.05)),
        ("altaz", {"first_axis_deg": (-90.0, 200.0)}, over_ground(lambda s: (150.0 + 0.1 * s, 40.0))),
        ("altaz", {"second_axis_deg": (0.0, 60.0)}, over_ground(lambda s: (150.0, 40.0 + 0.1 * s))),
        ("german", {"first_axis_deg": (-20.0, 200.0)}, drifting(10.0, 20.0, 0.1, 0.0)),
        # west of the pier the declination axis stands at 180° - δ
        ("german-west", {"second_axis_deg": (120.0, 200.0)}, drifting(-40.0, 20.0, 0.0, 0.1)),
    ],
)
def test_axes(mounting: str, axes: dict[str, tuple[float, float]], path: Path) -> None:
    limits = Limits(-80.0, **axes)  # type: ignore[arg-type]
    side = PierSide.WEST if mounting == "german-west" else PierSide.EAST if mounting == "german" else None
    kind_of: Mounting = "german" if mounting.startswith("german") else mounting  # type: ignore[assignment]
    kind, after_s = entered(limits, path, NIGHT, 1500.0, kind_of, side)
    assert kind is LimitKind.UNREACHABLE
    expected_s = {
        (-40.0, 40.0): 40.0 / (0.05 + SIDEREAL_DEG_S),
        (-20.0, 45.0): 25.0 / 0.05,
        (-90.0, 200.0): 500.0,
        (0.0, 60.0): 200.0,
        (-20.0, 200.0): 30.0 / (0.1 - SIDEREAL_DEG_S),
        (120.0, 200.0): 400.0,
    }[next(iter(axes.values()))]
    assert after_s == pytest.approx(expected_s, rel=0.01)


def test_azimuths_count_on_through_the_north() -> None:
    """A satellite in the north: from 330° to 30° an alt-az mount turns by 60°, not by 300°."""
    path = over_ground(lambda s: (330.0 + s, 40.0))
    limits = Limits(5.0, first_axis_deg=(-170.0, 20.0))
    kind, after_s = entered(limits, path, NIGHT, 60.0, "altaz")
    assert kind is LimitKind.UNREACHABLE
    assert after_s == pytest.approx(50.0, abs=0.4)


# -- speed -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("highest_deg", [25.0, 60.0, 88.0])
def test_a_pass_is_seen_to_the_tenth_of_a_degree(highest_deg: float) -> None:
    path = satellite(highest_deg)
    limits = Limits(15.0, 85.0)
    events = forecast(limits, path, NIGHT, at(NIGHT, 600.0), SITE, AIR, mounting="altaz")
    outside = [event for event in events if event.kind is SkyEventKind.LIMIT]
    inside = [event for event in events if event.kind is SkyEventKind.WITHIN_LIMIT]
    rises = [event for event in inside if event.alt_deg < 20.0]
    sets = [event for event in outside if event.alt_deg < 20.0 and event.utc > at(NIGHT, 300.0)]
    assert len(rises) == len(sets) == 1
    assert rises[0].alt_deg == pytest.approx(15.0, abs=0.15)
    assert sets[0].alt_deg == pytest.approx(15.0, abs=0.15)
    too_high = [event for event in outside if event.alt_deg > 80.0]
    assert len(too_high) == (1 if highest_deg > 85.0 else 0)
    meridian = [event for event in events if event.kind is SkyEventKind.MERIDIAN]
    assert len(meridian) == 1
    assert abs((meridian[0].utc - at(NIGHT, 300.0)).total_seconds()) < 1.0


def test_looks_are_few_where_nothing_is_near() -> None:
    asked: list[datetime] = []

    def counted(path: Path) -> Path:
        def place(utc: datetime) -> Icrs:
            asked.append(utc)
            return path(utc)

        return place

    reached_along(Limits(5.0), counted(star(0.0, 60.0)), NIGHT, SITE, AIR, mounting="fork", within_s=36_000.0)
    assert len(asked) < 620
    asked.clear()
    reached_along(Limits(5.0), counted(satellite(60.0)), NIGHT, SITE, AIR, mounting="fork", within_s=600.0)
    assert len(asked) < 700


def test_what_would_take_too_long_is_refused_and_not_guessed() -> None:
    # round the horizon each ten seconds
    path = over_ground(lambda s: (36.0 * s, 20.1 + math.sin(s)))
    with pytest.raises(BadRequest, match="too long"):
        reached_along(Limits(20.0), path, NIGHT, SITE, AIR, mounting="altaz", within_s=7200.0)


def test_a_path_that_does_not_answer_is_told_and_a_naive_instant_refused() -> None:
    def ends(utc: datetime) -> Icrs:
        if utc > at(NIGHT, 100.0):
            raise BadRequest("the ephemeris ends")
        return Icrs(10.0, 20.0)

    with pytest.raises(BadRequest, match="ends"):
        reached_along(Limits(-80.0), ends, NIGHT, SITE, AIR, within_s=200.0)
    with pytest.raises(BadRequest):
        reached_along(Limits(-80.0), star(0.0, 20.0), NIGHT.replace(tzinfo=None), SITE, AIR, within_s=200.0)


# -- the forecast ----------------------------------------------------------------------------------


def of(events: tuple[SkyEvent, ...], kind: SkyEventKind) -> list[SkyEvent]:
    return [event for event in events if event.kind is kind]


@pytest.mark.long
def test_a_day_of_a_planet_is_foretold() -> None:
    def jupiter(utc: datetime) -> Icrs:
        return position_of_body("jupiter", utc, SITE)

    limits = Limits(20.0, past_meridian_deg=(5.0, 5.0))
    events = forecast(limits, jupiter, NIGHT, at(NIGHT, 86_400.0), SITE, AIR, mounting="fork")
    (rises,), (sets,) = of(events, SkyEventKind.RISES), of(events, SkyEventKind.SETS)
    (meridian,), (lower,) = of(events, SkyEventKind.MERIDIAN), of(events, SkyEventKind.LOWER_MERIDIAN)
    assert [event.utc for event in events] == sorted(event.utc for event in events)
    for event in (rises, sets):
        assert event.alt_deg == pytest.approx(0.0, abs=0.01)
        seen = icrs_to_observed(jupiter(event.utc), event.utc, SITE, AIR)
        assert seen.alt_deg == pytest.approx(0.0, abs=0.01)
    for event, ha_deg in ((meridian, 0.0), (lower, 180.0)):
        here = icrs_to_hour_angle(jupiter(event.utc), event.utc, SITE, AIR)
        assert half_turn_deg(here.ha_deg - ha_deg) == pytest.approx(0.0, abs=0.01)
    limit = of(events, SkyEventKind.WITHIN_LIMIT) + of(events, SkyEventKind.LIMIT)
    assert {event.limit for event in limit} == {LimitKind.ALTITUDE}
    assert "UTC, altitude" in rises.words
    assert forecast(limits, jupiter, NIGHT, NIGHT, SITE, AIR) == ()


def test_what_begins_within_the_suns_cone_and_leaves_it_is_told() -> None:
    sun = position_of_body("sun", DAY, SITE)

    def leaves(utc: datetime) -> Icrs:
        return Icrs(sun.ra_deg, sun.dec_deg + 10.0 + 0.01 * (utc - DAY).total_seconds())

    limits = Limits(5.0, sun_cone_deg=20.0)
    events = forecast(limits, leaves, DAY, at(DAY, 3000.0), SITE, AIR, mounting="fork")
    (near,), (far,) = of(events, SkyEventKind.SUN_NEAR), of(events, SkyEventKind.SUN_FAR)
    assert near.utc == DAY
    assert (far.utc - DAY).total_seconds() == pytest.approx(1000.0, abs=15.0)
    assert far.limit is LimitKind.SUN


@pytest.mark.long
@settings(max_examples=25, deadline=None)
@given(
    ha_deg=st.floats(-100.0, 100.0),
    dec_deg=st.floats(-20.0, 80.0),
    ra_rate=st.sampled_from([-0.3, -0.01, 0.0, 0.004, 0.1]),
    dec_rate=st.sampled_from([-0.2, 0.0, 0.01]),
)
def test_what_is_reached_first_is_the_first_limit_of_the_forecast(
    ha_deg: float, dec_deg: float, ra_rate: float, dec_rate: float
) -> None:
    limits = Limits(
        15.0, 85.0, horizon=Horizon(((0.0, 10.0), (90.0, 40.0), (180.0, 5.0), (270.0, 50.0))), margin_deg=0.1
    )
    path = drifting(ha_deg, dec_deg, ra_rate, dec_rate)
    within_s = 1800.0 if max(abs(ra_rate), abs(dec_rate)) < 0.05 else 150.0
    found = reached_along(limits, path, NIGHT, SITE, AIR, mounting="fork", within_s=within_s)
    events = forecast(limits, path, NIGHT, at(NIGHT, within_s), SITE, AIR, mounting="fork")
    outside = of(events, SkyEventKind.LIMIT)
    assume(not any(event.utc == NIGHT for event in outside))
    if not outside:
        assert found is None
        return
    assert found is not None
    first_s = (outside[0].utc - NIGHT).total_seconds()
    assert found.after_s == pytest.approx(first_s, abs=max(2.0, 0.02 * within_s))


@pytest.mark.long
@settings(max_examples=30, deadline=None)
@given(st.floats(-80.0, 80.0), st.floats(-10.0, 80.0), st.sampled_from([-0.2, -0.02, 0.05, 0.15]))
def test_no_place_before_what_is_reached_is_outside(ha_deg: float, dec_deg: float, rate: float) -> None:
    """Looked at 500 times by another way: place by place."""
    horizon = Horizon(((0.0, 10.0), (90.0, 40.0), (91.0, 5.0), (180.0, 5.0), (270.0, 50.0)))
    limits = Limits(15.0, 85.0, horizon=horizon)
    path = drifting(ha_deg, dec_deg, rate, 0.5 * rate)
    within_s = 20.0 / abs(rate)
    found = reached_along(limits, path, NIGHT, SITE, AIR, mounting="fork", within_s=within_s)

    def outside_deg(seconds: float) -> float:
        then = at(NIGHT, seconds)
        seen = icrs_to_observed(path(then), then, SITE, AIR)
        edge = horizon.altitude_at(seen.az_deg)
        return max(15.0 - seen.alt_deg, seen.alt_deg - 85.0, edge - seen.alt_deg)

    assume(outside_deg(0.0) < -0.01)
    until_s = within_s if found is None else found.after_s
    assert max(outside_deg(float(s)) for s in np.linspace(0.0, until_s, 500)) < 0.4
    if found is not None and found.after_s < within_s - 5.0:
        assert outside_deg(found.after_s) > -0.4


# -- axes moved by hand ----------------------------------------------------------------------------


def by_hand(
    ha_deg: float,
    dec_deg: float,
    rates: tuple[float, float],
    limits: Limits,
    mounting: Mounting = "german",
    side: PierSide | None = PierSide.EAST,
    within_s: float = 60.0,
) -> tuple[LimitKind, float] | None:
    here = HourAngle(ha_deg, dec_deg, NIGHT)
    found = reached_by_axes(
        Scene(limits, NIGHT, SITE),
        here,
        here,
        rates,
        mounting=mounting,
        side=side,
        tracks=True,
        within_s=within_s,
    )
    return None if found is None else (found.limit, found.after_s)


def test_moved_axes_reach_the_limits_of_both_sides() -> None:
    limits = Limits(5.0, past_meridian_deg=(10.0, 10.0))
    # to the east on the east side: the counterweight rises
    assert by_hand(20.0, 20.0, (1.0, 0.0), limits) == (
        LimitKind.MERIDIAN,
        pytest.approx(30.0, abs=0.3),
    )
    assert by_hand(20.0, 20.0, (1.0, 0.0), limits, side=PierSide.WEST) is None
    assert by_hand(-20.0, 20.0, (-1.0, 0.0), limits, side=PierSide.WEST) == (
        LimitKind.MERIDIAN,
        pytest.approx(30.0, abs=0.3),
    )


@pytest.mark.parametrize("side", [PierSide.EAST, PierSide.WEST])
def test_down_is_down_on_both_sides(side: PierSide) -> None:
    found = by_hand(0.0, 0.0, (0.0, -1.0), Limits(20.0), side=side)
    assert found is not None
    assert found[0] is LimitKind.ALTITUDE
    assert found[1] == pytest.approx(90.0 - SITE.latitude_deg - 20.0, abs=0.3)


def test_nothing_is_moved_through_the_pole_or_the_zenith() -> None:
    for side in (PierSide.EAST, PierSide.WEST):
        by_the_hand = by_hand(30.0, 70.0, (0.0, 1.0), Limits(5.0), side=side)
        assert by_the_hand == (LimitKind.UNREACHABLE, pytest.approx(20.0, abs=0.3))
    assert by_hand(30.0, 70.0, (0.0, -1.0), Limits(5.0), within_s=30.0) is None
    here = HourAngle(0.0, 20.0, NIGHT)
    high = 90.0 - SITE.latitude_deg + 20.0
    found = reached_by_axes(
        Scene(Limits(5.0), NIGHT, SITE),
        here,
        here,
        (0.0, 1.0),
        mounting="altaz",
        side=None,
        tracks=True,
        within_s=60.0,
    )
    assert found is not None
    assert found.after_s == pytest.approx(90.0 - high, abs=0.3)


def test_apparent_places_are_paths_too() -> None:
    # the same instant by two kinds of coordinates: the chain is the only way between them
    from mountnav.sky.coordinates import Apparent

    place = apparent_to_icrs(Apparent(100.0, 20.0, NIGHT))
    one = reached_along(Limits(10.0), lambda _: place, NIGHT, SITE, AIR, within_s=43_200.0)
    other = Limits(10.0).reached(place, NIGHT, SITE, AIR)
    assert one is not None
    assert other is not None
    assert one.after_s == pytest.approx(other.after_s, abs=60.0)
