"""The way of a followed target against the limits: sides that aren't told, and what is known from before."""

from __future__ import annotations

import asyncio
from datetime import datetime, timedelta

import pytest

from mountnav.devices import MountReading, OffsetRates, PierSide
from mountnav.errors import BadRequest, LimitKind
from mountnav.mount.path_ahead import PathAhead
from mountnav.pointing.limits import Limits, Reached
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import HourAngle, Icrs
from tests.mount.mount_rig import AIR, NIGHT, SITE

NONE = OffsetRates(0.0, 0.0)
HOUR = timedelta(hours=1)
SIDEREAL_S_DEG = 239.345
"""Seconds in which the sky turns by a degree."""


class Star:
    """A path that stays on one star; counts how often it is asked for."""

    def __init__(self, ha_deg: float, dec_deg: float) -> None:
        self.icrs = hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, NIGHT), SITE, AIR)
        self.asked = 0

    def path(self, _utc: datetime) -> Icrs:
        self.asked += 1
        return self.icrs

    def read(self, after_s: float = 0.0, side: PierSide | None = None) -> MountReading:
        """As a mount reads that has followed it so long."""
        utc = NIGHT + timedelta(seconds=after_s)
        return MountReading(icrs_to_apparent(self.icrs, utc), utc, pier_side=side)


def ahead_of(
    star: Star, ends_utc: datetime, before: PathAhead | None = None, *, german: bool = False
) -> PathAhead:
    return PathAhead(SITE, AIR, "german" if german else "fork", NONE, ends_utc, star.path, before)


def looked(
    ahead: PathAhead, limits: Limits, reading: MountReading, side: PierSide | None = None
) -> tuple[Reached, datetime] | None:
    return asyncio.run(ahead.look_ahead(limits, reading, (side,), reading.utc))


def test_a_side_that_is_not_told_stays_the_one_that_it_began_on() -> None:
    star, limits = Star(-1.0, 20.0), Limits(15.0, past_meridian_deg=(5.0, 5.0))
    first = ahead_of(star, NIGHT + HOUR, german=True)
    found = looked(first, limits, star.read())
    assert found is not None
    assert found[0].limit is LimitKind.MERIDIAN
    comes_s = (found[1] - NIGHT).total_seconds()
    assert comes_s == pytest.approx(6.0 * SIDEREAL_S_DEG, abs=30.0)
    # the meridian is behind it now, and the tube hangs as it did
    past = star.read(2.0 * SIDEREAL_S_DEG)
    on = ahead_of(star, past.utc + HOUR, first, german=True)
    assert looked(on, limits, past) == (found[0], found[1])
    fresh = ahead_of(star, past.utc + HOUR, german=True)
    assert looked(fresh, limits, past) is None


def test_a_side_that_is_told_counts_whatever_was_taken_for_it() -> None:
    star, limits = Star(1.0, 20.0), Limits(15.0, past_meridian_deg=(5.0, 5.0))
    ahead = ahead_of(star, NIGHT + HOUR, german=True)
    assert looked(ahead, limits, star.read()) is None
    sides = [side for side in (PierSide.EAST, PierSide.WEST) if looked(ahead, limits, star.read(), side)]
    assert len(sides) == 1


def test_what_a_path_comes_to_is_known_when_it_is_ordered_shorter_and_longer_again() -> None:
    star, limits = Star(65.0, 10.0), Limits(20.0)
    long = ahead_of(star, NIGHT + 2 * HOUR)
    found = looked(long, limits, star.read())
    assert found is not None
    assert found[0].limit is LimitKind.ALTITUDE
    comes_s = (found[1] - NIGHT).total_seconds()
    assert comes_s > 660.0  # else the straight way ahead would show it
    cost = star.asked
    shorter = ahead_of(star, found[1] - timedelta(seconds=60.0), long)
    assert looked(shorter, limits, star.read()) is None
    longer = ahead_of(star, NIGHT + 2 * HOUR, shorter)
    assert looked(longer, limits, star.read()) == found
    assert star.asked - cost < 10
    # the watch hears of it while the mount follows, so much later by so much less
    later = longer.reached(limits, star.read(30.0), None, 2.0 * comes_s)
    assert later is not None
    assert later.after_s == pytest.approx(comes_s - 30.0, abs=1.0)
    assert longer.reached(limits, star.read(30.0), None, comes_s - 60.0) is None


def test_a_path_of_something_else_is_refused() -> None:
    star = Star(-20.0, 20.0)
    with pytest.raises(BadRequest, match=r"the target's path is 2\d\.\d° from where the mount stands"):
        looked(ahead_of(star, NIGHT + HOUR), Limits(15.0), Star(4.0, 20.0).read())
