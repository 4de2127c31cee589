"""From the sky to the axes of a German mount and back, both sides and hemispheres, against ERFA."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta

import erfa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.skywatcher.axes import (
    HOME,
    AxisCounts,
    Gearing,
    Offsets,
    Turns,
    altitude_deg,
    goto_s,
    hour_angle_of,
    other_side,
    place_of,
    rise_deg,
    side_for,
    side_of,
    sight,
    true_timer_hz,
    turns_at,
)
from drivers.skywatcher.codec import Axis, Board
from mountnav.devices import PierSide
from mountnav.errors import DeviceRefused, Refusal
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, Icrs, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

HOURS = st.floats(-179.9, 180.0)
DECS = st.floats(-89.9, 89.9)
LATITUDES = st.floats(-89.0, 89.0).filter(lambda latitude: abs(latitude) > 1.0)
SIDES = st.sampled_from([PierSide.EAST, PierSide.WEST])
INSTANTS = st.datetimes(datetime(2000, 1, 1), datetime(2020, 1, 1)).map(lambda at: at.replace(tzinfo=UTC))
GEARS = {Axis.HOUR_ANGLE: Gearing(9_024_000, 64_935, 16), Axis.DECLINATION: Gearing(2_903_040, 64_935, 16)}


def tube(turns: Turns, latitude_deg: float) -> tuple[float, float, float]:
    """Where a tube looks (meridian, west, pole), by turning a mount that stands at home, axis after axis.

    At home the tube looks at the visible pole. ERFA's rotations turn the frame, hence the signs.
    """
    up = 1.0 if latitude_deg >= 0.0 else -1.0
    matrix = erfa.ir()
    # with the counterweight down the second axis leans the tube about the line from the meridian
    matrix = erfa.rx(math.radians(turns.second_deg - 90.0), matrix)
    matrix = erfa.rz(-up * math.radians(turns.first_deg), matrix)
    x, y, z = (float(part) for part in erfa.rxp(matrix, (0.0, 0.0, up)))
    return x, y, z


def direction(ha_deg: float, dec_deg: float) -> tuple[float, float, float]:
    x, y, z = (float(part) for part in erfa.s2c(math.radians(ha_deg), math.radians(dec_deg)))
    return x, y, z


@given(st.floats(-170.0, 170.0), st.floats(-80.0, 260.0), LATITUDES)
def test_the_geometry_is_that_of_two_turning_axes(first: float, second: float, latitude: float) -> None:
    turns = Turns(first, second)
    seen = sight(turns, latitude)
    assert direction(seen.ha_deg, seen.dec_deg) == pytest.approx(tube(turns, latitude), abs=1e-9)


@given(HOURS, DECS, LATITUDES, SIDES)
def test_places_there_and_back(ha: float, dec: float, latitude: float, side: PierSide) -> None:
    turns = turns_at(ha, dec, side, latitude)
    seen = sight(turns, latitude)
    assert seen.side is side is side_of(turns, latitude)
    assert abs(half_turn_deg(seen.ha_deg - ha)) < 1e-9
    assert seen.dec_deg == pytest.approx(dec, abs=1e-9)
    assert -180.0 < turns.first_deg <= 180.0
    assert -90.0 <= turns.second_deg <= 270.0


@given(HOURS, DECS, LATITUDES, SIDES)
def test_a_slew_never_raises_the_counterweight(
    ha: float, dec: float, latitude: float, side: PierSide
) -> None:
    wanted = side_for(ha, dec, side, latitude, past_deg=1.0)
    assert rise_deg(turns_at(ha, dec, wanted, latitude)) <= 1.0 + 1e-9
    if rise_deg(turns_at(ha, dec, side, latitude)) <= 0.0:
        assert wanted is side


@given(st.floats(0.1, 179.9), DECS, LATITUDES)
def test_west_of_the_meridian_the_tube_hangs_in_the_east(ha: float, dec: float, latitude: float) -> None:
    for sign, side in ((1.0, PierSide.EAST), (-1.0, PierSide.WEST)):
        assert side_for(sign * ha, dec, other_side(side), latitude, past_deg=0.0) is side


def test_home_looks_at_the_visible_pole() -> None:
    assert sight(HOME, 50.0).dec_deg == 90.0
    assert sight(HOME, -30.0).dec_deg == -90.0


@given(INSTANTS, st.floats(0.0, 359.99), DECS, LATITUDES, st.floats(-180.0, 180.0))
def test_the_sky_there_and_back(at: datetime, ra: float, dec: float, latitude: float, east: float) -> None:
    site = Site(latitude, east, 100.0)
    place = Apparent(ra, dec, at)
    angles = hour_angle_of(place, at, site)
    back = place_of(angles.ha_deg, angles.dec_deg, at, site)
    assert separation_arcsec(Icrs(back.ra_deg, back.dec_deg), Icrs(ra, dec)) < 1e-3


@given(INSTANTS, st.floats(0.0, 359.99), st.floats(-85.0, 85.0), st.floats(-180.0, 180.0))
def test_hour_angles_are_erfas(at: datetime, ra: float, dec: float, east: float) -> None:
    # Greenwich apparent sidereal time, UT1 taken as UTC: within 0.9 s, 13.6 arcsec
    jd1, jd2 = erfa.dtf2d(
        b"UTC", at.year, at.month, at.day, at.hour, at.minute, at.second + at.microsecond / 1e6
    )
    gst_deg = math.degrees(float(erfa.gst06a(jd1, jd2, jd1, jd2 + 69.0 / 86400.0)))
    angles = hour_angle_of(Apparent(ra, dec, at), at, Site(45.0, east))
    assert abs(half_turn_deg(angles.ha_deg - (gst_deg + east - ra))) * 3600.0 < 20.0
    _, altitude = erfa.hd2ae(math.radians(angles.ha_deg), math.radians(angles.dec_deg), math.radians(45.0))
    assert altitude_deg(angles, Site(45.0, east)) == pytest.approx(math.degrees(float(altitude)), abs=1e-9)


SMALL = st.floats(-0.9, 0.9)


@given(
    HOURS,
    st.floats(-80.0, 80.0),
    LATITUDES,
    SIDES,
    SMALL,
    SMALL,
    st.lists(st.tuples(HOURS, st.floats(-80, 80))),
)
def test_after_a_sync_the_axes_look_where_it_said(
    ha: float,
    dec: float,
    latitude: float,
    side: PierSide,
    off_ha: float,
    off_dec: float,
    earlier: list[tuple[float, float]],
) -> None:
    offsets = Offsets(latitude)
    for other_ha, other_dec in earlier:
        offsets.learn(turns_at(other_ha, other_dec, side, latitude), other_ha + off_dec, other_dec + off_ha)
    counted = turns_at(ha, dec, side, latitude)
    offsets.learn(counted, half_turn_deg(ha + off_ha), dec + off_dec)
    seen = offsets.sight(counted)
    assert separation_arcsec(Icrs(seen.ha_deg, seen.dec_deg), Icrs(ha + off_ha, dec + off_dec)) < 1e-3
    back = offsets.counted_turns(offsets.true_turns(counted))
    assert back.first_deg == pytest.approx(counted.first_deg, abs=1e-9)
    assert back.second_deg == pytest.approx(counted.second_deg, abs=1e-9)


def test_each_side_keeps_its_own_sync_and_lends_it_to_one_that_has_none() -> None:
    offsets = Offsets(50.0)
    west, east = turns_at(-30.0, 20.0, PierSide.WEST, 50.0), turns_at(30.0, 20.0, PierSide.EAST, 50.0)
    offsets.learn(west, -30.0 + 0.2, 20.1)
    assert offsets.at(PierSide.EAST) == offsets.at(PierSide.WEST)
    offsets.learn(east, 30.0 + 0.3, 20.0)
    assert offsets.at(PierSide.EAST).first_deg == pytest.approx(0.3)
    assert offsets.at(PierSide.WEST).first_deg == pytest.approx(0.2)
    # turned by hand: what the other side knew is void
    offsets.learn(east, 30.0 + 9.0, 20.0)
    assert offsets.at(PierSide.WEST) == offsets.at(PierSide.EAST)


@given(HOURS, st.floats(-60.0, 89.0), SIDES, st.booleans())
def test_counts_there_and_back(ha: float, dec: float, side: PierSide, fresh: bool) -> None:
    standing = AxisCounts(50.0)
    standing.geared(GEARS)
    (standing.begin_at_home if fresh else standing.begin_as_eqmod)()
    turns = turns_at(ha, dec, side, 50.0)
    back = standing.turns(*standing.counts(turns))
    assert back.first_deg == pytest.approx(turns.first_deg, abs=180.0 / 9_024_000)
    assert back.second_deg == pytest.approx(turns.second_deg, abs=180.0 / 2_903_040)


def test_setting_the_second_count_leaves_the_axes_where_they_stand() -> None:
    standing = AxisCounts(50.0)
    standing.geared(GEARS)
    standing.begin_at_home()
    assert standing.turns(0x800000, 0x800000) == HOME
    standing.second_moved(0x800000, 0x800000 + standing.quarter)
    assert standing.turns(0x800000, 0x800000 + standing.quarter) == HOME
    standing.begin_as_eqmod()
    assert standing.turns(0x800000, 0x800000 + standing.quarter) == HOME


def test_a_board_that_cannot_count_so_far_says_so() -> None:
    standing = AxisCounts(50.0)
    standing.geared(dict.fromkeys(Axis, Gearing(12_492_146, 16_000_000, 1)))
    standing.begin_as_eqmod()
    with pytest.raises(DeviceRefused) as refused:
        standing.counts(Turns(0.0, 265.0))
    assert refused.value.reason is Refusal.LIMIT


def test_the_sidereal_period_is_what_real_boards_take() -> None:
    # measured on an HEQ5: 620 ticks gave 0.999 of the sidereal rate; told by another board: 110359
    assert Gearing(9_024_000, 64_935, 16).period(SIDEREAL_DEG_S) == 620
    assert Gearing(12_492_146, 16_000_000, 1).period(SIDEREAL_DEG_S) == pytest.approx(110_359, abs=3)
    gear = Gearing(9_024_000, 64_935, 16)
    assert gear.rate_deg_s(620) / SIDEREAL_DEG_S == pytest.approx(1.0, abs=1e-4)
    assert gear.rate_deg_s(620, fast=True) == pytest.approx(16.0 * gear.rate_deg_s(620))


def test_one_firmware_is_known_to_tell_a_wrong_frequency() -> None:
    assert true_timer_hz(Board(1, 6, 1), 64_935) == 0xFC80
    assert true_timer_hz(Board(2, 4, 1), 64_935) == 64_935


def test_a_goto_takes_as_long_as_an_owner_measured() -> None:
    # 10 degrees, 2.2 deg/s2 up to 3.49 deg/s: 5.6 s by its log, the last of it creeping
    assert goto_s(10.0, 3.49, 2.2) == pytest.approx(4.5, abs=0.5)
    assert goto_s(-1.0, 3.4, 2.2) == pytest.approx(2.0 * math.sqrt(1.0 / 2.2))


def test_instants_of_a_place_are_taken_as_now() -> None:
    now = datetime(2026, 11, 22, tzinfo=UTC)
    site = Site(50.0, 10.0)
    old = Apparent(100.0, 20.0, now - timedelta(days=1))
    new = Apparent(100.0, 20.0, now)
    assert hour_angle_of(old, now, site) == hour_angle_of(new, now, site)
