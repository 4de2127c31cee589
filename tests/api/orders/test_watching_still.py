"""Since when a mount is still: by its readings alone, and null where they don't say so."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

from api.orders.watching import still_since
from mountnav.devices import MountReading
from mountnav.navigation.reports import TelescopeState
from mountnav.sky.coordinates import Icrs

BEGIN = datetime(2026, 11, 26, 21, 0, tzinfo=UTC)


def state(after_s: float, ra_deg: float = 10.0, *, slewing: bool | None = False) -> TelescopeState:
    utc, icrs = BEGIN + timedelta(seconds=after_s), Icrs(ra_deg, 0.0)
    reading = MountReading(place=icrs, utc=utc, slewing=slewing)
    return TelescopeState("east", True, "idle", reading, icrs, 45.0, 180.0, None)


def since(*states: TelescopeState) -> datetime | None:
    found: datetime | None = None
    before = TelescopeState("east", False, "idle", None, None, None, None, None)
    for one in states:
        found, before = still_since(found, before, one), one
    return found


def test_from_the_first_reading_that_is_still() -> None:
    assert since(state(0)) == BEGIN
    assert since(state(0), state(1), state(2)) == BEGIN


def test_a_slew_ends_it_and_its_end_begins_it() -> None:
    assert since(state(0), state(1, slewing=True)) is None
    assert since(state(0), state(1, slewing=True), state(2), state(3)) == BEGIN + timedelta(seconds=2)


def test_a_mount_that_says_nothing_of_slewing_is_judged_by_where_it_reads() -> None:
    moved = state(2, 10.5, slewing=None)
    assert since(state(1, slewing=None), moved, state(3, 10.5, slewing=None)) == BEGIN + timedelta(seconds=2)


def test_standing_while_the_sky_turns_is_still_and_a_motion_by_hand_is_not() -> None:
    sky_deg, by_hand_deg = 60 * 15.04 / 3600, 60 * 60 / 3600
    assert since(state(0), state(60, 10 + sky_deg)) == BEGIN
    assert since(state(0), state(60, 10 + by_hand_deg)) == BEGIN + timedelta(seconds=60)


def test_a_line_that_was_lost_says_nothing() -> None:
    lost = replace(state(1), connected=False)
    assert since(state(0), lost) is None
    assert since(state(0), lost, state(2)) == BEGIN + timedelta(seconds=2)
