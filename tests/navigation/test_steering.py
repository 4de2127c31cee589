"""Where to send a mount next: on the sphere, and near the pole by its geometry, judged by exact rotations."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mountnav.devices import PierSide
from mountnav.navigation.steering import (
    Followed,
    PolarSteering,
    Sighting,
    Steering,
    sent_as_believed,
    steering_for,
)
from mountnav.simulation.geometry import true_direction
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.chain import (
    apparent_to_hour_angle,
    apparent_to_icrs,
    hour_angle_to_apparent,
    icrs_to_apparent,
)
from mountnav.sky.coordinates import GeometricHourAngle, Icrs, Site
from mountnav.sky.sphere import displaced, separation_arcsec

SITE = Site(48.9, 22.3, 0.0)
UTC_NOW = datetime(2026, 11, 21, 22, 0, tzinfo=UTC)


def errors(draw_arcsec: float) -> st.SearchStrategy[float]:
    return st.floats(-draw_arcsec, draw_arcsec)


def looked(aim: Icrs, wrong: PointingErrors, utc: datetime, through_pole: bool = False) -> Icrs:
    """Where a mount with these errors looks when it believes to look at `aim`: exact rotations."""
    here = apparent_to_hour_angle(icrs_to_apparent(aim, utc), SITE)
    axes = (here.ha_deg + 180.0, 180.0 - here.dec_deg) if through_pole else (here.ha_deg, here.dec_deg)
    ha_deg, dec_deg = true_direction(*axes, wrong, SITE.latitude_deg)
    return apparent_to_icrs(hour_angle_to_apparent(GeometricHourAngle(ha_deg, dec_deg, utc), SITE))


def at(ha_deg: float, dec_deg: float) -> Icrs:
    return apparent_to_icrs(hour_angle_to_apparent(GeometricHourAngle(ha_deg, dec_deg, UTC_NOW), SITE))


@given(
    ha_deg=st.floats(-80.0, 80.0),
    dec_deg=st.floats(-20.0, 86.5),
    ih=errors(1500.0),
    id_=errors(1500.0),
    ch=errors(400.0),
    me=errors(600.0),
    ma=errors(600.0),
)
@settings(max_examples=60, deadline=None)
def test_offsets_converge_in_three_steps_away_from_the_pole(
    ha_deg: float, dec_deg: float, ih: float, id_: float, ch: float, me: float, ma: float
) -> None:
    wrong = PointingErrors(ih_arcsec=ih, id_arcsec=id_, ch_arcsec=ch, me_arcsec=me, ma_arcsec=ma)
    target = at(ha_deg, dec_deg)
    steering = steering_for(target, 1.0, SITE)
    aim, utc = target, UTC_NOW
    assert isinstance(steering, Steering)
    for number in range(4):
        seen = looked(aim, wrong, utc)
        followed = steering.sighted(Sighting(aim, seen), utc)
        assert followed in (Followed.FIRST, Followed.YES, Followed.UNTOLD), number
        aim = steering.next_aim(utc)
    assert separation_arcsec(seen, target) < 12.0


@given(
    ha_deg=st.floats(-180.0, 180.0),
    polar_distance_arcsec=st.floats(0.0, 7000.0),
    ih=errors(1500.0),
    id_=errors(500.0),
    ch=errors(400.0),
    me=errors(500.0),
    ma=errors(500.0),
    through_pole=st.booleans(),
    south=st.booleans(),
)
@settings(max_examples=80, deadline=None)
def test_near_the_pole_it_converges_wherever_the_mount_can_point(
    ha_deg: float,
    polar_distance_arcsec: float,
    ih: float,
    id_: float,
    ch: float,
    me: float,
    ma: float,
    through_pole: bool,
    south: bool,
) -> None:
    wrong = PointingErrors(ih_arcsec=ih, id_arcsec=id_, ch_arcsec=ch, me_arcsec=me, ma_arcsec=ma)
    # what it can't reach lies within this of its own pole, which lies within this of the sky's
    assume(polar_distance_arcsec > 1.05 * (math.hypot(me, ma) + math.hypot(id_, ch)) + 30.0)
    sign = -1.0 if south else 1.0
    target = at(ha_deg, sign * (90.0 - polar_distance_arcsec / 3600.0))
    steering = PolarSteering(target, 3.0, SITE)
    side = PierSide.WEST if through_pole else PierSide.EAST
    aim, utc = target, UTC_NOW
    for _ in range(5):
        seen = looked(aim, wrong, utc, through_pole and not south)
        if separation_arcsec(seen, target) < 5.0:
            return
        steering.sighted(Sighting(aim, seen, side if not south else PierSide.EAST), utc)
        utc += timedelta(seconds=40)
        aim = steering.next_aim(utc, side if not south else PierSide.EAST)
        assert steering.hole(utc, side if not south else PierSide.EAST) is None
    raise AssertionError(f"{separation_arcsec(seen, target):.1f}″ off after five steps")


def test_both_postures_are_one_geometry() -> None:
    wrong = PointingErrors(
        ih_arcsec=300.0, id_arcsec=-150.0, ch_arcsec=200.0, me_arcsec=250.0, ma_arcsec=-90.0
    )
    target = at(35.0, 89.5)
    steering = PolarSteering(target, 3.0, SITE)
    aim = target
    for number in range(4):
        through = number % 2 == 1
        side = PierSide.WEST if through else PierSide.EAST
        seen = looked(aim, wrong, UTC_NOW, through)
        steering.sighted(Sighting(aim, seen, side), UTC_NOW)
        aim = steering.next_aim(UTC_NOW, PierSide.EAST if through else PierSide.WEST)
    assert separation_arcsec(looked(aim, wrong, UTC_NOW, False), target) < 5.0


def test_a_target_in_the_hole_of_the_pole_is_told() -> None:
    wrong = PointingErrors(id_arcsec=-20.0, ch_arcsec=400.0)
    target = at(20.0, 90.0 - 100.0 / 3600.0)
    steering = PolarSteering(target, 3.0, SITE)
    aim = target
    for _ in range(3):
        assert steering.hole(UTC_NOW) is None
        steering.sighted(Sighting(aim, looked(aim, wrong, UTC_NOW)), UTC_NOW)
        aim = steering.next_aim(UTC_NOW)
    hole = steering.hole(UTC_NOW)
    assert hole is not None
    assert abs(hole.short_arcsec - 300.0) < 15.0
    # and the mount is sent as near as it can get
    assert abs(separation_arcsec(looked(aim, wrong, UTC_NOW), target) - 300.0) < 25.0


def test_an_hour_angle_that_is_far_off_leaves_no_rest() -> None:
    # the turn that explains it is taken back as it was put on: 20″ were left for ever, 2.4° from the pole
    wrong = PointingErrors(ih_arcsec=14_000.0, id_arcsec=1800.0, ch_arcsec=450.0, ma_arcsec=-400.0)
    target = at(-178.0, 87.6)
    steering = steering_for(target, 1.0, SITE)
    aim, utc = target, UTC_NOW
    for _ in range(7):
        seen = looked(aim, wrong, utc)
        steering.sighted(Sighting(aim, seen), utc)
        aim = steering.next_aim(utc)
    assert separation_arcsec(looked(aim, wrong, utc), target) < 2.0


def test_a_zero_point_that_keeps_it_from_the_target_is_told_as_that() -> None:
    wrong = PointingErrors(id_arcsec=-2500.0, ch_arcsec=-90.0)
    target = at(154.0, 89.36)
    steering = steering_for(target, 1.0, SITE)
    assert isinstance(steering, PolarSteering)
    aim = target
    for _ in range(4):
        steering.sighted(Sighting(aim, looked(aim, wrong, UTC_NOW)), UTC_NOW)
        aim = steering.next_aim(UTC_NOW)
    hole = steering.hole(UTC_NOW)
    assert hole is not None
    assert "beyond the pole" in hole.words
    assert "first light" in hole.advice


def test_what_the_tube_did_is_named() -> None:
    target = at(0.0, 30.0)

    def after(seen: Icrs) -> Followed:
        steering = Steering(target, 5.0)
        steering.sighted(Sighting(target, displaced(target, 300.0, 0.0)), UTC_NOW)
        aim = steering.next_aim(UTC_NOW)
        assert separation_arcsec(aim, displaced(target, -300.0, 0.0)) < 0.1
        return steering.sighted(Sighting(aim, seen), UTC_NOW)

    assert after(displaced(target, 3.0, 2.0)) is Followed.YES
    assert after(displaced(target, 290.0, 0.0)) is Followed.STUCK
    assert after(displaced(target, -300.0, 0.0)) is Followed.ELSEWHERE
    assert after(displaced(target, 300.0, 400.0)) is Followed.ELSEWHERE
    steering = Steering(target, 5.0)
    steering.sighted(Sighting(target, displaced(target, 4.0, 0.0)), UTC_NOW)
    assert steering.sighted(Sighting(steering.next_aim(UTC_NOW), target), UTC_NOW) is Followed.UNTOLD


def test_a_belief_that_jumped_is_what_steps_are_counted_from() -> None:
    aim = at(0.0, 30.0)
    assert sent_as_believed(aim, displaced(aim, 20.0, 0.0), 60.0) is aim
    jumped = displaced(aim, 800.0, 0.0)
    assert sent_as_believed(aim, jumped, 60.0) is jumped
