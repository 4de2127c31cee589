"""Model runs: points in the allowed sky, on both sides, in a short way; the file goes on where it was."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.clock import utc_now
from mountnav.devices import PierSide
from mountnav.errors import BadRequest
from mountnav.pointing.limits import Limits
from mountnav.pointing.model.planning import (
    Outcome,
    add,
    allowed_by,
    begin,
    mend,
    plan,
    read_run,
    shortest,
    spiral,
    way_deg,
)
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Icrs, Site
from tests.present import present

SITE = Site(48.93, 22.27)


def above(lowest_deg):
    return lambda az, alt, side: alt >= lowest_deg


@pytest.mark.long
@pytest.mark.parametrize("kind", ["spiral", "random"])
@pytest.mark.parametrize("mounting", ["german", "fork", "altaz", None])
def test_points_lie_in_the_allowed_sky(kind, mounting):
    found = plan(30, SITE, above(20.0), mounting=mounting, kind=kind)
    assert len(found.points) == 30
    assert [one.number for one in found.points] == list(range(1, 31))
    assert all(one.alt_deg >= 20.0 for one in found.points)
    assert sum(one.held_out for one in found.points) == 6
    sides = {one.side for one in found.points}
    assert sides == ({PierSide.EAST, PierSide.WEST} if mounting == "german" else {PierSide.UNKNOWN})
    assert found == plan(30, SITE, above(20.0), mounting=mounting, kind=kind)


def test_points_are_spread_evenly():
    points = plan(60, SITE, above(15.0)).points
    heights = np.sin(np.radians([one.alt_deg for one in points]))
    low = math.sin(math.radians(15.0))
    counts, _ = np.histogram(heights, np.linspace(low, 1.0, 4))
    assert counts.min() >= 15
    by_azimuth, _ = np.histogram([one.az_deg for one in points], np.linspace(0, 360, 5))
    assert by_azimuth.min() >= 10


def test_each_side_has_its_own_limits():
    def only_west_of_the_meridian_from_the_east(az, alt, side):
        if side is PierSide.EAST:
            return alt > 20.0 and 180.0 < az < 360.0
        return alt > 20.0 and az < 180.0

    found = plan(30, SITE, only_west_of_the_meridian_from_the_east, mounting="german")
    assert all((one.side is PierSide.EAST) == (one.az_deg > 180.0) for one in found.points)
    both = plan(30, SITE, above(20.0), mounting="german", both_sides_each=True)
    places = [(round(one.az_deg, 6), round(one.alt_deg, 6)) for one in both.points]
    assert len(set(places)) < 30


def test_the_telescopes_limits():
    limits = Limits(
        25.0, 80.0, hour_angle_deg=(-75.0, 75.0), declination_deg=(-20.0, 70.0), past_meridian_deg=(10.0, 0.0)
    )
    allowed = allowed_by(limits, SITE)
    found = plan(40, SITE, allowed, mounting="german")
    for one in found.points:
        assert 26.0 <= one.alt_deg <= 79.0
        assert -74.0 <= one.ha_deg <= 74.0
        assert -19.0 <= one.dec_deg <= 69.0
        assert one.ha_deg >= -9.0 if one.side is PierSide.EAST else one.ha_deg <= 0.0


def test_no_room():
    with pytest.raises(BadRequest, match="no room"):
        plan(10, SITE, lambda az, alt, side: False)
    with pytest.raises(BadRequest, match="2 points"):
        plan(2, SITE, above(20.0))
    small = plan(12, SITE, lambda az, alt, side: alt > 70.0)
    assert len(small.points) == 12


@pytest.mark.long
@settings(max_examples=20, deadline=None)
@given(st.integers(4, 40), st.booleans(), st.integers(0, 1000))
def test_the_way_is_short(n, wraps, seed):
    rng = np.random.default_rng(seed)
    axes = np.stack([rng.uniform(-90, 270, n), rng.uniform(-30, 210, n)], axis=1)
    order = shortest(axes, None, wraps=wraps)
    assert sorted(order) == list(range(n))
    length = way_deg(axes[order], wraps=wraps)
    for _ in range(30):
        assert length <= way_deg(axes[rng.permutation(n)], wraps=wraps) + 1e-6
    # no stretch turned round makes it shorter
    for i in range(n - 1):
        for j in range(i + 1, n):
            turned = [*order[:i], *order[i : j + 1][::-1], *order[j + 1 :]]
            assert length <= way_deg(axes[turned], wraps=wraps) + 1e-6


def test_a_short_way_beats_the_order_of_the_spiral_by_far():
    points = plan(60, SITE, above(20.0), mounting="fork")
    by_altitude = sorted(points.points, key=lambda one: one.alt_deg)
    axes = np.array([(one.ha_deg, one.dec_deg) for one in by_altitude])
    assert points.way_deg < 0.4 * way_deg(axes, wraps=True)


def test_spiral_has_equal_areas():
    heights = np.sort([math.sin(math.radians(alt)) for _, alt in spiral(100)])
    assert np.diff(heights) == pytest.approx(np.full(99, 0.01))


def test_a_run_goes_on_where_it_was(tmp_path):
    path = tmp_path / "run.jsonl"
    points = plan(10, SITE, above(20.0), mounting="german").points
    begin(path, "east", points, [5])
    with pytest.raises(BadRequest, match="there already"):
        begin(path, "east", points, [5])
    assert present(read_run(path)).left == points
    held_out = next(one.number for one in points if one.held_out and one.number != 5)
    for number in (held_out, 5):
        seen = PointingObservation(utc_now(), Icrs(1.0, 2.0), 0.5, Icrs(1.1, 2.0), look_id=f"look {number}")
        add(path, Outcome(number, seen.look_id), seen)
    failed = next(one.number for one in points if one.number not in (held_out, 5))
    add(path, Outcome(failed, None, "cloud"), None)
    going = present(read_run(path))
    assert {one.number for one in going.left} == {one.number for one in points} - {
        held_out,
        5,
        failed,
    }
    assert [len(going.of_part(part)) for part in ("fit", "held-out", "fresh")] == [0, 1, 1]
    # killed in the middle of a point: in whichever line
    before = path.read_bytes()
    seen = PointingObservation(utc_now(), Icrs(1.0, 2.0), 0.5, Icrs(1.1, 2.0), look_id="last")
    add(path, Outcome(going.left[0].number, "last"), seen)
    whole = path.read_bytes()
    for cut in range(len(before), len(whole), 5):
        path.write_bytes(whole[:cut])
        mend(path)
        assert present(read_run(path)).left == going.left, cut
        assert len(present(read_run(path)).of_part("fit")) == 0
    path.write_bytes(whole)
    assert len(present(read_run(path)).left) == len(going.left) - 1
    path.write_bytes(whole + b'# point {"number": 3, "loo\n')
    with pytest.raises(BadRequest, match="damaged line"):
        read_run(path)
