"""The one way to a mount: what is refused, what is written when, and what becomes of outcomes."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from mountnav.devices import (
    STARS_RATES,
    Direction,
    MountAxis,
    OffsetRates,
    PierSide,
    Skill,
    SlewOutcome,
    SyncOutcome,
)
from mountnav.errors import (
    Busy,
    Cancelled,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
    JournalFailed,
    LimitKind,
    OutsideLimits,
    Refusal,
)
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import CommandEnd, CommandRecord, EntryKind, Outcome, because
from mountnav.mount import CheckedMount
from mountnav.mount.kill_points import watching_kill_points
from mountnav.pointing.limits import Limits
from mountnav.simulation.mechanics import Machine
from mountnav.simulation.virtual_time import for_all_modules
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import displaced
from mountnav.testing.check_mount import check_mount
from tests.mount.mount_rig import AIR, LIMITS, SITE, Rig, run

# -- what is refused -----------------------------------------------------------------------------


class LikeADriver:
    """The room of the mount as drivers are asked: it wants an end for rates, and moves axes for a moment."""

    def __init__(self, rig: Rig) -> None:
        self._mount, self._clock = rig.mount, rig.clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._mount, name)

    @property
    def skills(self) -> frozenset[Skill]:
        return self._mount.skills - {Skill.MOVE_AXIS}

    async def move_axis(self, axis: MountAxis, rate_deg_s: float) -> None:
        raise DeviceRefused("for a moment only", device=self._mount.name, reason=Refusal.UNSUPPORTED)

    async def set_offset_rates(self, rates: OffsetRates) -> None:
        ends_utc = self._clock.utc() + timedelta(minutes=5)
        await self._mount.set_offset_rates(rates, ends_utc=ends_utc)

    async def offset_rates(self) -> OffsetRates:
        force = self._mount.offset_rates_in_force
        return STARS_RATES if force is None else force.rates


def test_it_is_a_mount_like_any_other() -> None:
    async def work(rig: Rig) -> None:
        with for_all_modules(rig.clock):
            await rig.mount.slew(rig.place(-20.0, 40.0))
            await check_mount(LikeADriver(rig))

    rig = run(work, limits=Limits(-90.0), machine=Machine(lowest_altitude_deg=5.0))
    assert None not in [outcome for _, outcome in rig.outcomes()]


def test_a_place_outside_is_refused_and_nothing_is_sent() -> None:
    async def work(rig: Rig) -> None:
        with pytest.raises(OutsideLimits, match="below the limit") as refusal:
            await rig.mount.slew(rig.place(100.0, -20.0))
        assert refusal.value.limit is LimitKind.ALTITUDE

    rig = run(work)
    assert rig.driver.received == []
    assert rig.outcomes() == []
    (facts,) = rig.refusals()
    assert facts["order"] == "slew"
    assert facts["limit"] == "altitude"
    assert "below the limit" in str(facts["why"])


def test_a_parked_mount_is_not_slewed_and_unparking_is_an_order_of_its_own() -> None:
    async def work(rig: Rig) -> None:
        await rig.mount.park()
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.slew(rig.place(-20.0, 40.0))
        assert refusal.value.reason is Refusal.PARKED
        with pytest.raises(DeviceRefused):
            await rig.mount.set_tracking(True)
        await rig.mount.unpark()
        assert await rig.mount.slew(rig.place(-20.0, 40.0)) is SlewOutcome.ARRIVED

    rig = run(work)
    assert rig.driver.received == ["park", "unpark", "slew"]
    assert [one["reason"] for one in rig.refusals()] == ["parked", "parked"]


@pytest.mark.parametrize("order", ["slew", "park", "home", "guide"])
def test_an_untrusted_position_does_not_move(order: str) -> None:
    async def work(rig: Rig) -> None:
        orders = {
            "slew": lambda: rig.mount.slew(rig.place(-20.0, 40.0)),
            "park": rig.mount.park,
            "home": rig.mount.home,
            "guide": lambda: rig.mount.guide(Direction.NORTH, 1.0),
        }
        with pytest.raises(DeviceRefused) as refusal:
            await orders[order]()
        assert refusal.value.reason is Refusal.UNTRUSTED

    rig = run(work, trusted=False)
    assert rig.driver.received == []
    assert [one["reason"] for one in rig.refusals()] == ["untrusted"]


def test_homing_by_sensors_needs_no_trust_gives_it_and_begins_a_segment() -> None:
    async def work(rig: Rig) -> None:
        before = rig.mount.segment_id
        assert await rig.mount.home() is SlewOutcome.ARRIVED
        assert rig.mount.trusted
        assert rig.mount.segment_id != before

    rig = run(work, machine=Machine(home_sensor=True), trusted=False)
    assert rig.outcomes() == [("home", Outcome.DONE)]
    assert "its home was found" in rig.segments()


def test_whom_we_distrust_is_not_moved_until_a_sync_is_seen() -> None:
    async def work(rig: Rig) -> None:
        rig.mount.distrust("an undo failed")
        with pytest.raises(DeviceRefused, match="can't be trusted"):
            await rig.mount.slew(rig.place(-20.0, 40.0))
        await rig.mount.sync((await rig.mount.reading()).place)
        assert rig.mount.trusted
        await rig.mount.slew(rig.place(-20.0, 40.0))

    assert run(work).driver.received == ["sync", "slew"]


def test_by_day_nothing_but_parking() -> None:
    async def work(rig: Rig) -> None:
        for order in (rig.mount.home(), rig.mount.slew(rig.place(-90.0, 60.0)), rig.mount.set_tracking(True)):
            with pytest.raises(OutsideLimits) as refusal:
                await order
            assert refusal.value.limit is LimitKind.DAYLIGHT
        assert await rig.mount.park() is SlewOutcome.ARRIVED

    afternoon = datetime(2026, 6, 21, 13, tzinfo=UTC)
    rig = run(
        work, limits=Limits(15.0, daylight="refuse"), utc=afternoon, machine=Machine(tracks_at_start=False)
    )
    assert rig.driver.received == ["park"]


def test_no_sync_on_a_place_below_the_ground() -> None:
    async def work(rig: Rig) -> None:
        with pytest.raises(OutsideLimits, match="no telescope can point there"):
            await rig.mount.sync(rig.place(170.0, -10.0))

    assert run(work).driver.received == []


def test_a_second_order_to_move_is_refused_not_queued() -> None:
    async def work(rig: Rig) -> None:
        first = asyncio.create_task(rig.mount.slew(rig.place(-60.0, 20.0)))
        await rig.clock.sleep(2.0)
        for order in (
            rig.mount.slew(rig.place(0.0, 20.0)),
            rig.mount.park(),
            rig.mount.sync(rig.place(0.0, 20.0)),
            rig.mount.set_tracking(False),
        ):
            with pytest.raises(Busy, match="a slew is running"):
                await order
        assert await first is SlewOutcome.ARRIVED

    rig = run(work)
    assert rig.driver.received == ["slew"]
    assert [one["slug"] for one in rig.refusals()] == ["busy"] * 4


def test_what_is_not_allowed_directly_is_reached_by_way_of_other_places() -> None:
    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-75.0, 30.0))
        # along the north, where the direct way dips below
        assert await rig.mount.slew(rig.place(100.0, 45.0)) is SlewOutcome.ARRIVED

    rig = run(work, limits=Limits(25.0, rate_ratio=None), mounting="fork")
    legs = [one.facts for one in rig.journal.commands if "leg" in one.facts]
    assert [one["leg"] for one in legs] == list(range(1, len(legs) + 1))
    assert len(legs) >= 2
    assert any(entry.kind is EntryKind.DECISION and "via" in entry.facts for entry in rig.journal.entries)
    assert {outcome for _, outcome in rig.outcomes()} == {Outcome.DONE}


# -- what is written when ------------------------------------------------------------------------


class Ordered(MemoryJournal):
    """Notes in which order the journal and the wire were served."""

    def __init__(self) -> None:
        super().__init__()
        self.story: list[str] = []
        self.full = False

    async def begin(self, command: CommandRecord) -> None:
        if self.full:
            raise JournalFailed("no room on the disk")
        await super().begin(command)
        self.story.append(f"{command.order} written")

    async def end(self, command_id: str, end: CommandEnd) -> None:
        if self.full:
            raise JournalFailed("no room on the disk")
        await asyncio.sleep(0.1)
        await super().end(command_id, end)
        self.story.append(f"closed {end.outcome}")


def test_an_order_is_written_sent_and_closed_in_this_order() -> None:
    journal = Ordered()

    async def work(rig: Rig) -> None:
        steps: list[str] = []
        send = rig.driver.slew

        async def slew(place: Apparent) -> SlewOutcome:
            journal.story.append("sent")
            return await send(place)

        rig.driver.slew = slew  # type: ignore[method-assign,assignment]
        with watching_kill_points(steps.append), because(job_id="job 7", why="centering"):
            await rig.mount.slew(rig.place(-20.0, 40.0))
        assert steps == ["slew begin", "slew begun", "slew sent", "slew end", "slew ended"]

    rig = run(work, journal=journal)
    assert journal.story == ["slew written", "sent", "closed done"]
    (command,) = rig.journal.commands
    assert command.cause.job_id == "job 7"
    assert command.segment_id == rig.mount.segment_id
    assert command.before is not None
    end = rig.journal.ends[command.command_id]
    assert end.after is not None
    assert end.miss_arcsec is not None
    assert end.miss_arcsec < 30.0


def test_what_can_not_be_written_is_not_sent_but_a_stop_is() -> None:
    journal = Ordered()
    journal.full = True

    async def work(rig: Rig) -> None:
        with pytest.raises(JournalFailed):
            await rig.mount.slew(rig.place(-20.0, 40.0))
        await rig.mount.stop()
        assert ("journal-failed") in [what for what, _ in rig.told]

    assert run(work, journal=journal).driver.received == ["stop"]


def test_an_outcome_that_could_not_be_written_is_written_later() -> None:
    journal = Ordered()

    async def work(rig: Rig) -> None:
        slewing = asyncio.create_task(rig.mount.slew(rig.place(-20.0, 40.0)))
        await rig.clock.sleep(2.0)
        journal.full = True
        assert await slewing is SlewOutcome.ARRIVED
        assert rig.outcomes() == [("slew", None)]
        journal.full = False
        await rig.mount.guide(Direction.NORTH, 0.5)
        assert rig.outcomes() == [("slew", Outcome.DONE), ("guide", Outcome.DONE)]

    run(work, journal=journal)


def test_a_stop_that_overtakes_an_order_keeps_it_from_being_sent() -> None:
    async def work(rig: Rig) -> None:
        def at(name: str) -> None:
            if name == "slew begun":
                # as another task would, while the disk was busy
                rig.mount._sender.stops += 1

        with watching_kill_points(at):
            assert await rig.mount.slew(rig.place(-20.0, 40.0)) is SlewOutcome.STOPPED

    rig = run(work)
    assert rig.driver.received == []
    assert rig.outcomes() == [("slew", Outcome.NOT_SENT)]


def test_a_stop_ends_a_slew_and_both_are_closed() -> None:
    async def work(rig: Rig) -> None:
        slewing = asyncio.create_task(rig.mount.slew(rig.place(-70.0, 20.0)))
        await rig.clock.sleep(3.0)
        await rig.mount.stop()
        assert await slewing is SlewOutcome.STOPPED
        assert rig.mount.last_motion_utc is not None

    rig = run(work)
    assert sorted(rig.outcomes()) == [("slew", Outcome.STOPPED), ("stop", Outcome.DONE)]


def test_a_cancelled_slew_is_closed_as_not_known() -> None:
    journal = Ordered()

    async def work(rig: Rig) -> None:
        slewing = asyncio.create_task(rig.mount.slew(rig.place(-70.0, 20.0)))
        await rig.clock.sleep(3.0)
        slewing.cancel()
        # and once more while the row is being closed
        await asyncio.sleep(0.05)
        slewing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await slewing
        assert rig.outcomes() == [("slew", Outcome.UNKNOWN)]

    run(work, journal=journal)


@pytest.mark.parametrize("name", ["slew begin", "slew begun", "slew sent", "slew end", "slew ended"])
def test_cancelled_at_any_step_an_order_is_closed(name: str) -> None:
    async def work(rig: Rig) -> None:
        def at(step: str) -> None:
            if step == name:
                slewing.cancel()

        slewing = asyncio.create_task(rig.mount.slew(rig.place(-20.0, 40.0)))
        with watching_kill_points(at), pytest.raises(asyncio.CancelledError):
            await slewing
        await rig.mount._book.settle()

    rig = run(work, journal=Ordered())
    sent = rig.driver.received.count("slew")
    assert sent <= 1
    assert None not in [outcome for _, outcome in rig.outcomes()]
    if rig.outcomes():
        ((_, outcome),) = rig.outcomes()
        # a driver that was cancelled before it had said anything can't be told from one that had
        allowed = {Outcome.NOT_SENT, Outcome.UNKNOWN} if sent == 0 else {Outcome.DONE, Outcome.UNKNOWN}
        assert outcome in allowed


def test_a_silent_mount_leaves_the_outcome_unknown_and_the_journal_says_so() -> None:
    async def work(rig: Rig) -> None:
        slewing = asyncio.create_task(rig.mount.slew(rig.place(-70.0, 20.0)))
        await rig.clock.sleep(3.0)
        rig.driver.cut(20.0, "silent")
        with pytest.raises((DeviceSilent, DeviceMissing)):
            await slewing
        await rig.clock.sleep(60.0)
        assert not rig.mount.trusted

    rig = run(work)
    assert rig.outcomes()[0] == ("slew", Outcome.UNKNOWN)
    assert any(why.startswith("untrusted") for why in rig.segments())
    kinds = [(one.kind, one.what) for one in rig.journal.entries]
    assert (EntryKind.LINK, "link-lost") in kinds


def test_a_refusal_of_the_mount_is_written() -> None:
    machine = Machine(lowest_altitude_deg=40.0)

    async def work(rig: Rig) -> None:
        with pytest.raises(DeviceRefused):
            await rig.mount.slew(rig.place(-60.0, 10.0))

    assert run(work, machine=machine).outcomes() == [("slew", Outcome.REFUSED)]


# -- segments ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("behaves", "outcome", "kept"),
    [
        ("normal", Outcome.DONE, False),
        ("late", Outcome.LATE, False),
        ("ignore", Outcome.IGNORED, True),
    ],
)
def test_a_sync_that_was_seen_begins_a_segment(behaves: str, outcome: Outcome, kept: bool) -> None:
    async def work(rig: Rig) -> None:
        rig.mechanics.sync_behavior = behaves  # type: ignore[assignment]
        rig.mechanics.sync_late_s = 2.0
        before, heard = rig.mount.segment_id, []
        rig.mount.on_segment(lambda segment, why: heard.append((segment, why)))
        place = (await rig.mount.reading()).place
        assert isinstance(place, Apparent)
        result = await rig.mount.sync(displaced(place, 300.0, 200.0))
        assert (result.outcome is SyncOutcome.IGNORED) == kept
        assert (rig.mount.segment_id == before) == kept
        assert [segment for segment, _ in heard] == ([] if kept else [rig.mount.segment_id])

    rig = run(work)
    assert rig.outcomes() == [("sync", outcome)]
    # the order itself stands in the segment in which it was given
    assert (rig.journal.commands[0].segment_id == rig.mount.segment_id) == kept


def test_a_sync_that_shows_much_later_begins_a_segment_then() -> None:
    async def work(rig: Rig) -> None:
        rig.mechanics.sync_behavior = "late"
        rig.mechanics.sync_late_s = 8.0
        before = rig.mount.segment_id
        place = (await rig.mount.reading()).place
        assert isinstance(place, Apparent)
        assert (await rig.mount.sync(displaced(place, 300.0, 200.0))).outcome is SyncOutcome.IGNORED
        assert rig.mount.segment_id == before
        await rig.clock.sleep(60.0)
        assert rig.mount.segment_id != before

    assert "a sync was seen, late" in run(work).segments()


def test_a_sync_cut_off_on_its_way_begins_a_segment_since_nobody_knows() -> None:
    async def work(rig: Rig) -> None:
        before = rig.mount.segment_id
        send = rig.driver.sync

        async def sync(place: Apparent) -> object:
            rig.driver.cut(3.0, "silent")
            return await send(place)

        rig.driver.sync = sync  # type: ignore[method-assign,assignment]
        with pytest.raises(DeviceSilent):
            await rig.mount.sync(rig.place(0.0, 45.0))
        assert rig.mount.segment_id != before

    assert run(work).outcomes() == [("sync", Outcome.UNKNOWN)]


def test_a_flip_keeps_the_segment_and_the_side_of_the_last_sync_is_known() -> None:
    async def work(rig: Rig) -> None:
        await rig.mount.slew(rig.place(-30.0, 40.0))
        reading = await rig.mount.reading()
        assert reading.pier_side is PierSide.WEST
        await rig.mount.sync(reading.place)
        segment = rig.mount.segment_id
        assert rig.mount.side_of_last_sync is PierSide.WEST
        await rig.mount.slew(rig.place(30.0, 40.0))
        assert (await rig.mount.reading()).pier_side is PierSide.EAST
        assert rig.mount.segment_id == segment
        assert rig.mount.side_of_last_sync is PierSide.WEST

    rig = run(work, machine=Machine(mounting="german"), mounting="german")
    flips = [
        one.facts
        for one in rig.journal.entries
        if one.kind is EntryKind.SEGMENT and "sync_counts_here" in one.facts
    ]
    assert [(one["side"], one["sync_counts_here"]) for one in flips][-1] == ("east", False)


def test_a_stop_before_a_sync_was_sent_is_told() -> None:
    async def work(rig: Rig) -> None:
        def at(name: str) -> None:
            if name == "sync begun":
                rig.mount._sender.stops += 1

        with watching_kill_points(at), pytest.raises(Cancelled):
            await rig.mount.sync(rig.place(0.0, 45.0))

    rig = run(work)
    assert rig.driver.received == []
    assert rig.outcomes() == [("sync", Outcome.NOT_SENT)]


def test_what_only_some_mounts_report_is_none_of_one_that_does_not() -> None:
    class Bare:
        """No more than a mount must have."""

        name, epoch, resolution_arcsec = "bare", "icrs", 1.0

    async def work(rig: Rig) -> None:
        bare = CheckedMount(Bare(), telescope="t", limits=LIMITS, site=SITE, air=AIR)  # type: ignore[arg-type]
        assert bare.link is bare.slew_state is bare.report is bare.wire_log is None
        assert bare.tracking_rates is bare.guide_rates_deg_s is None
        assert not bare.tells_trust
        assert bare.skills == frozenset()
        assert rig.mount.tells_trust
        assert rig.mount.slew_state == "none"
        assert rig.mount.link == "up"

    run(work)
