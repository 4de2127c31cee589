"""What a run of the service leaves going is known by its journal, and ended first thing by the next one."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from mountnav.devices import OffsetRates
from mountnav.errors import DeviceRefused
from mountnav.journal.records import CommandEnd, CommandRecord, EntryKind, Order, Outcome
from mountnav.mount import LeftGoing, left_going
from mountnav.mount.dead_man import Armed
from mountnav.mount.trust import LastSeen, why_not_to_trust
from mountnav.sky.coordinates import Icrs
from tests.mount.following_rig import FollowingRig, Guarded, run_following
from tests.mount.mount_rig import AIR, NIGHT, SITE

AT = datetime(2026, 11, 21, 22, tzinfo=UTC)
Row = tuple[CommandRecord, CommandEnd | None]


def row(order: Order, outcome: Outcome | None, **facts: object) -> Row:
    end = None if outcome is None else CommandEnd(AT, outcome)
    return CommandRecord("id", "t", AT, order, "segment", facts=facts), end


def rates(ra: float, dec: float, outcome: Outcome | None = Outcome.DONE) -> Row:
    return row("offset-rates", outcome, ra_arcsec_s=ra, dec_arcsec_s=dec)


def axis(name: str, rate: float, outcome: Outcome | None = Outcome.DONE) -> Row:
    return row("move-axis", outcome, axis=name, rate_deg_s=rate)


@pytest.mark.parametrize(
    ("latest_first", "going"),
    [
        ([], False),
        ([rates(3.0, 4.0)], True),
        ([rates(3.0, 4.0, None)], True),
        ([rates(3.0, 4.0, Outcome.UNKNOWN)], True),
        ([rates(3.0, 4.0, Outcome.REFUSED_BUT_DONE)], True),
        ([rates(3.0, 4.0, Outcome.REFUSED)], False),
        ([rates(3.0, 4.0, Outcome.NOT_SENT), rates(1.0, 0.0)], True),
        ([rates(3.0, 4.0, Outcome.REFUSED), rates(0.0, 0.0)], False),
        ([rates(0.0, 0.0), rates(3.0, 4.0)], False),
        # told to end, and not known whether they did
        ([rates(0.0, 0.0, Outcome.UNKNOWN), rates(3.0, 4.0)], True),
        ([rates(0.0, 0.0, None), rates(3.0, 4.0)], True),
    ],
)
def test_what_is_in_force_is_told_by_the_latest_order_that_changed_anything(
    latest_first: list[Row], going: bool
) -> None:
    left = left_going(latest_first, [])
    assert ("offset-rates" in left) == going
    if latest_first == [rates(3.0, 4.0)]:
        assert left["offset-rates"].speed_deg_s == pytest.approx(5.0 / 3600.0)


def test_each_axis_is_known_by_its_own_orders() -> None:
    assert left_going([], [axis("primary", 0.0), axis("secondary", 0.0), axis("primary", 1.0)]) == {}
    left = left_going([], [axis("primary", 0.0), axis("secondary", -2.0), axis("primary", 1.0)])
    assert left["move-axis"].speed_deg_s == 2.0
    assert "secondary" in left["move-axis"].words


def test_a_guard_stays_armed_as_long_as_anything_goes_on() -> None:
    guard = Guarded()
    armed = Armed(guard)
    armed.need("offset-rates", AT + timedelta(seconds=60.0))
    armed.need("move-axis", AT + timedelta(seconds=5.0))
    assert guard.until_utc == AT + timedelta(seconds=60.0)
    armed.free("offset-rates")
    assert guard.until_utc == AT + timedelta(seconds=5.0)
    armed.free("move-axis")
    armed.free("move-axis")
    assert guard.told == ["arm", "arm", "arm", "disarm"]
    armed.let_go()
    assert guard.told[-1] == "disarm"
    guard.missing = True
    with pytest.raises(DeviceRefused):
        armed.need("move-axis", AT)
    armed.let_go()
    assert guard.told[-1] == "disarm"


def test_what_was_left_going_is_ended_first_thing_and_told() -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        # as an earlier run left it
        rig.mechanics.track_beside(30.0, 0.0)
        rig.mechanics.move("n", 1.0)
        left = {
            "offset-rates": LeftGoing("rates of 30 and 0 ″/s", 30.0 / 3600.0),
            "move-axis": LeftGoing("its secondary axis", 1.0),
        }
        await rig.mount.take_up(None, [], left)  # type: ignore[arg-type]
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert abs(rig.mechanics.axis_velocity("dec")) < 1e-6
        assert not rig.mount.axis_moving
        assert rig.guard.until_utc is None

    rig = run_following(work)
    assert [what for what, _ in rig.told if what == "left-going"] == ["left-going"] * 2
    told = [one.what for one in rig.journal.entries if one.kind is EntryKind.FAULT]
    assert len([what for what in told if "without having ended it" in what]) == 2


def test_what_was_left_going_and_cannot_be_ended_is_tried_on() -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        rig.mechanics.track_beside(30.0, 0.0)
        rig.following.fails.add("end-rates")
        await rig.mount.take_up(None, [], {"offset-rates": LeftGoing("rates", 0.01)})
        assert rig.mount.following_problem is not None
        assert rig.guard.until_utc is not None
        await rig.clock.sleep(1.5)
        rig.following.fails.clear()
        await rig.clock.sleep(3.0)
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert rig.mount.following_problem is None
        assert rig.guard.until_utc is None

    run_following(work)


@pytest.mark.parametrize(("drift_deg", "trusted"), [(1.0, True), (3.0, False)])
def test_a_mount_that_has_followed_since_it_was_seen_stands_elsewhere_with_reason(
    drift_deg: float, trusted: bool
) -> None:
    """6 ″/s for 20 minutes are 2°: as far as that, and half a degree, nobody moved it by hand."""

    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        now = await rig.mount.reading()
        place = rig.mechanics.truth()
        last = LastSeen(
            Icrs(place.ra_deg, place.dec_deg - drift_deg), now.utc - timedelta(minutes=20.0), True
        )
        assert (why_not_to_trust(last, [], now, SITE, AIR, 6.0 / 3600.0) is None) == trusted
        assert why_not_to_trust(last, [], now, SITE, AIR) is not None
        await rig.mount.take_up(last, [], {"offset-rates": LeftGoing("rates", 6.0 / 3600.0)})
        assert rig.mount.trusted == trusted

    run_following(work, utc=NIGHT)


def test_a_mount_that_contradicts_the_settings_neither_follows_nor_is_moved() -> None:
    from mountnav.devices import ConnectReport

    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        rig.driver.report = ConnectReport("x", "apparent", clock_off_s=3600.0)  # type: ignore[attr-defined]
        ends = rig.clock.utc() + timedelta(seconds=60.0)
        with pytest.raises(DeviceRefused, match="contradict"):
            await rig.mount.set_offset_rates(OffsetRates(1.0, 1.0), ends_utc=ends)
        with pytest.raises(DeviceRefused, match="contradict"):
            await rig.mount.move_axis("primary", 1.0, for_s=1.0)
        assert rig.following.ordered == []

    run_following(work)
