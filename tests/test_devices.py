"""The law of a sync and the sides of a reading: what drivers, mount and navigation judge by alike."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest

from mountnav.devices import (
    STARS_RATES,
    MountReading,
    OffsetRates,
    PierSide,
    SyncLaw,
    SyncOutcome,
    for_mount,
    from_mount,
    miss_arcsec,
    moved_arcsec,
    moved_on,
    offset_speed_arcsec_s,
    rates_of,
)
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec

NOW = datetime(2026, 11, 21, 22, tzinfo=UTC)
BEFORE = MountReading(Icrs(80.0, 20.0), NOW)


def later(east_arcsec: float, north_arcsec: float, after_s: float = 1.0) -> MountReading:
    """A reading so far from the one before the sync."""
    place = displaced(Icrs(80.0, 20.0), east_arcsec, north_arcsec)
    return replace(BEFORE, place=place, utc=NOW + timedelta(seconds=after_s))


@pytest.mark.parametrize(
    ("way_arcsec", "resolution_arcsec", "most_arcsec", "near_arcsec"),
    [
        (40.0, 1.0, 30.0, 10.0),  # a quarter of the way
        (4000.0, 1.0, 30.0, 30.0),  # no more than the cap
        (4.0, 1.0, 30.0, 6.0),  # a step and what a reading wanders besides
        (4.0, 60.0, 30.0, 65.0),  # a step that is coarser than the cap
    ],
)
def test_a_quarter_of_the_way_is_left_to_the_mount(
    way_arcsec: float, resolution_arcsec: float, most_arcsec: float, near_arcsec: float
) -> None:
    law = SyncLaw.of(way_arcsec, resolution_arcsec, most_arcsec)
    assert law.near_arcsec == pytest.approx(near_arcsec)
    assert law.seen(near_arcsec - 0.1)
    assert not law.seen(near_arcsec + 0.1)


@pytest.mark.parametrize(
    ("took", "outcome"),
    [
        ((600.0, 600.0), SyncOutcome.SEEN),
        ((0.0, 0.0), SyncOutcome.IGNORED),
        ((600.0, 0.0), SyncOutcome.ELSEWHERE),
        ((-36000.0, 0.0), SyncOutcome.ELSEWHERE),
        ((5.0, 0.0), SyncOutcome.IGNORED),
    ],
    ids=["all", "nothing", "one coordinate of two", "a damaged number", "a wandering reading"],
)
def test_a_sync_is_judged_by_the_reading_after_it(took: tuple[float, float], outcome: SyncOutcome) -> None:
    place, after = displaced(Icrs(80.0, 20.0), 600.0, 600.0), later(*took)
    law = SyncLaw.of(separation_arcsec(Icrs(80.0, 20.0), place), 1.0, 30.0)
    assert law.outcome(miss_arcsec(place, NOW, after), BEFORE, after) is outcome


def test_the_turn_of_the_sky_is_no_motion_of_a_mount_that_rests() -> None:
    for_s = 60.0
    resting = replace(
        BEFORE, place=Icrs(80.0 + for_s * 15.041 / 3600.0, 20.0), utc=NOW + timedelta(seconds=for_s)
    )
    assert separation_arcsec(resting.place, Icrs(80.0, 20.0)) > 800.0  # type: ignore[type-var]
    assert moved_arcsec(BEFORE, resting) < 0.1
    assert moved_arcsec(BEFORE, replace(BEFORE, utc=resting.utc)) == 0.0


COMET = OffsetRates(12.0, -20.0)


def test_the_way_of_offset_rates_is_no_motion_and_no_miss() -> None:
    after = replace(BEFORE, place=moved_on(BEFORE.place, COMET, 5.0), utc=NOW + timedelta(seconds=5.0))
    assert moved_arcsec(BEFORE, after) > 90.0
    assert moved_arcsec(BEFORE, after, [COMET]) < 0.01
    assert miss_arcsec(BEFORE.place, NOW, after, [COMET]) < 0.01
    law = SyncLaw.of(600.0, 1.0, 30.0)
    assert law.unseen(BEFORE, after) is SyncOutcome.ELSEWHERE
    assert law.unseen(BEFORE, after, [COMET]) is SyncOutcome.IGNORED
    # and what is off that way counts as it always does
    off = replace(after, place=replace(after.place, dec_deg=after.place.dec_deg + 0.1))
    assert moved_arcsec(BEFORE, off, [COMET]) == pytest.approx(260.0, abs=5.0)
    assert law.outcome(400.0, BEFORE, off, [COMET]) is SyncOutcome.ELSEWHERE


def test_one_at_rates_moves_as_they_say() -> None:
    moved = moved_on(Icrs(359.9999, 10.0), OffsetRates(3.6, 7.2), 1000.0)
    assert (moved.ra_deg, moved.dec_deg) == (pytest.approx(0.9999), pytest.approx(12.0))
    assert moved_on(Icrs(10.0, 89.9), OffsetRates(0.0, 3600.0), 1.0).dec_deg == 90.0
    assert offset_speed_arcsec_s(OffsetRates(10.0, 0.0), 60.0) == pytest.approx(5.0)
    assert offset_speed_arcsec_s(OffsetRates(0.0, -4.0), 60.0) == pytest.approx(4.0)


def test_what_is_known_of_its_rates() -> None:
    class Driver:
        rates_known: OffsetRates | None = COMET

    class Checked:
        offset_rates_in_force = SimpleNamespace(rates=COMET)

    assert rates_of(Driver()) == rates_of(Checked()) == (COMET,)
    Driver.rates_known = STARS_RATES
    assert rates_of(Driver()) == rates_of(object()) == ()


def test_a_reading_without_a_side_is_of_an_unknown_one() -> None:
    assert BEFORE.side is PierSide.UNKNOWN
    assert replace(BEFORE, pier_side=PierSide.WEST).side is PierSide.WEST


def test_coordinates_come_back_from_a_mount_as_they_were_sent() -> None:
    place = Icrs(80.0, 20.0)
    assert for_mount(place, "icrs", NOW) is place
    sent = for_mount(place, "apparent", NOW)
    assert separation_arcsec(from_mount(sent), place) < 0.001
