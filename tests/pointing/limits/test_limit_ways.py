"""Ways against brute force: no path of an allowed area has a place outside, whatever the rates make of it."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mountnav.devices import PierSide
from mountnav.errors import LimitKind
from mountnav.pointing.limits import Horizon, Limits, Mounting
from mountnav.pointing.limits.bodies import bodies
from mountnav.pointing.limits.postures import Standing, Way, ways_between
from mountnav.pointing.limits.scene import Scene
from mountnav.pointing.limits.ways import trouble_on
from mountnav.sky.coordinates import Site

SITE = Site(48.93, 22.27, 700.0)
DAY = datetime(2026, 6, 21, 9, tzinfo=UTC)
POLES = Horizon(
    ((0.0, 5.0), (90.0, 5.0), (90.2, 45.0), (90.4, 5.0), (200.0, 25.0), (240.0, 25.0), (270.0, 5.0))
)
LIMITS = Limits(12.0, 87.0, horizon=POLES, sun_cone_deg=15.0, declination_deg=(-40.0, 90.0))

angles = st.floats(-175.0, 175.0)


def inside(first_deg: float, second_deg: float, mounting: Mounting, slack_deg: float) -> bool:
    """Whether axes look within the limits, in plain trigonometry of one point."""
    lat = math.radians(SITE.latitude_deg)
    if mounting == "altaz":
        alt, az = math.radians(second_deg), math.radians(first_deg)
    else:
        h, d = math.radians(first_deg), math.radians(second_deg)
        up = math.sin(lat) * math.sin(d) + math.cos(lat) * math.cos(d) * math.cos(h)
        alt = math.asin(max(-1.0, min(1.0, up)))
        az = math.atan2(
            -math.cos(d) * math.sin(h),
            math.cos(lat) * math.sin(d) - math.sin(lat) * math.cos(d) * math.cos(h),
        )
    alt_deg = math.degrees(alt)
    dec = math.asin(
        max(-1.0, min(1.0, math.sin(lat) * math.sin(alt) + math.cos(lat) * math.cos(alt) * math.cos(az)))
    )
    sun = bodies(DAY, SITE).sun
    h, d = math.radians(sun.ha_deg), math.radians(sun.dec_deg)
    sun_alt = math.asin(math.sin(lat) * math.sin(d) + math.cos(lat) * math.cos(d) * math.cos(h))
    sun_az = math.atan2(
        -math.cos(d) * math.sin(h), math.cos(lat) * math.sin(d) - math.sin(lat) * math.cos(d) * math.cos(h)
    )
    cosine = math.sin(alt) * math.sin(sun_alt) + math.cos(alt) * math.cos(sun_alt) * math.cos(az - sun_az)
    return (
        12.0 - slack_deg <= alt_deg <= 87.0 + slack_deg
        and math.degrees(dec) >= -40.0 - slack_deg
        and alt_deg >= POLES.altitude_at(math.degrees(az)) - slack_deg
        and math.degrees(math.acos(max(-1.0, min(1.0, cosine)))) >= 15.0 - slack_deg
    )


def standing(mounting: Mounting, first_deg: float, second_deg: float) -> Standing:
    side = PierSide.EAST if mounting == "german" else PierSide.UNKNOWN
    return Standing(mounting, side, first_deg, second_deg)


@pytest.mark.long
@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(["fork", "german", "altaz"]),
    st.tuples(angles, st.floats(-30.0, 210.0)),
    st.tuples(angles, st.floats(-30.0, 210.0)),
    st.floats(0.0, 1.0),
    st.floats(0.0, 2.5),
    st.booleans(),
    st.booleans(),
)
def test_no_path_of_an_allowed_way_leaves_the_limits(
    mounting: Mounting,
    start: tuple[float, float],
    end: tuple[float, float],
    share: float,
    late_deg: float,
    any_rates: bool,
    first_late: bool,
) -> None:
    if mounting == "altaz":
        start, end = ((first, second / 3.0 + 15.0) for first, second in (start, end))
    assume(inside(*start, mounting, 0.0) and inside(*end, mounting, 0.0))
    limits = LIMITS if not any_rates else Limits(
        12.0, 87.0, horizon=POLES, sun_cone_deg=15.0, declination_deg=(-40.0, 90.0), rate_ratio=None
    )  # fmt: skip
    way = Way(standing(mounting, *start), standing(mounting, *end))
    if trouble_on(way, Scene(limits, DAY, SITE)) is not None:
        return
    # from 1/2 to 2, or from one axis first to the other first
    ratio = 2.0 ** (2.0 * share - 1.0) if not any_rates else math.tan(math.radians(0.5 + 89.0 * share))
    wide, high = end[0] - start[0], end[1] - start[1]
    total_s = max(abs(wide), abs(high) / ratio) + late_deg
    steps = int(total_s * (1.0 + ratio) / 0.25) + 2 if ratio < 50.0 else 4000
    for step in range(steps + 1):
        t = total_s * step / steps
        u = min(max(t - (late_deg if first_late else 0.0), 0.0), abs(wide))
        v = min(max(t - (0.0 if first_late else late_deg), 0.0) * ratio, abs(high))
        place = start[0] + math.copysign(u, wide), start[1] + math.copysign(v, high)
        assert inside(*place, mounting, 0.02), (place, t)


@pytest.mark.long
@settings(max_examples=200, deadline=None)
@given(st.tuples(angles, st.floats(-30.0, 210.0)), st.tuples(angles, st.floats(-30.0, 210.0)))
def test_what_is_refused_has_a_place_outside(start: tuple[float, float], end: tuple[float, float]) -> None:
    way = Way(standing("german", *start), standing("german", *end))
    trouble = trouble_on(way, Scene(LIMITS, DAY, SITE))
    if trouble is None:
        return
    alt_az = math.radians(trouble.alt_deg), math.radians(trouble.az_deg)
    if not trouble.started_outside:
        # a quarter of a degree of azimuth is kept from what is thin
        near = [math.degrees(alt_az[1]) + step for step in (-2.0, -0.5, 0.0, 0.5, 2.0)]
        assert trouble.depth_deg > 0.0
        assert trouble.limit is LimitKind.HORIZON or not any(
            inside(az, trouble.alt_deg, "altaz", -1e-6) for az in near[2:3]
        )


def from_low(end: tuple[float, float]) -> Way:
    return Way(Standing("altaz", PierSide.UNKNOWN, 300.0, 3.0), Standing("altaz", PierSide.UNKNOWN, *end))


def test_from_outside_only_inwards() -> None:
    scene = Scene(Limits(12.0), DAY, SITE)
    assert trouble_on(from_low((310.0, 40.0)), scene) is None
    assert (
        trouble_on(from_low((310.0, 3.0)), scene) is None
    )  # no deeper: where it ends is looked at elsewhere
    deeper = trouble_on(from_low((310.0, 1.0)), scene)
    assert deeper is not None
    assert deeper.started_outside
    assert deeper.limit is LimitKind.ALTITUDE


def test_from_outside_one_limit_the_others_still_hold() -> None:
    wall = Horizon(((0.0, 0.0), (304.0, 0.0), (304.0, 70.0), (306.0, 70.0), (306.0, 0.0)))
    trouble = trouble_on(from_low((310.0, 40.0)), Scene(Limits(12.0, horizon=wall), DAY, SITE))
    assert trouble is not None
    assert trouble.limit is LimitKind.HORIZON


def test_a_fork_nearly_half_a_turn_away_may_go_either_way() -> None:
    start, end = standing("fork", -88.0, 30.0), standing("fork", 89.0, 30.0)
    assert [way.end.first_deg for way in ways_between(start, end, None)] == [-271.0, 89.0]
    assert len(ways_between(start, standing("fork", 80.0, 30.0), None)) == 1


def test_an_axis_with_a_range_stays_in_it_or_is_checked_both_ways() -> None:
    start, end = standing("fork", 150.0, 80.0), standing("fork", -150.0, 80.0)
    ends = [way.end.first_deg for way in ways_between(start, end, (-170.0, 170.0))]
    assert ends == [-150.0, 210.0]
