"""Rates beside the stars': refused or in force, and always ended, judged by what the mechanics truly do."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from datetime import datetime, timedelta

import pytest

from mountnav.devices import STARS_RATES, Direction, OffsetRates, TrackingRate
from mountnav.errors import (
    BadRequest,
    Busy,
    Cancelled,
    DeviceError,
    DeviceRefused,
    DeviceSilent,
    JournalFailed,
    LimitKind,
    MountnavError,
    OutsideLimits,
)
from mountnav.journal.records import CommandRecord, EntryKind, Outcome
from mountnav.mount import FollowingPolicy
from mountnav.pointing.limits import Limits
from mountnav.simulation.mechanics import Machine
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Icrs
from tests.mount.following_rig import FollowingRig, run_following
from tests.mount.mount_rig import AIR, SITE

COMET = OffsetRates(0.05, -0.03)
FAST = OffsetRates(600.0, -300.0)


def ends(rig: FollowingRig, seconds: float) -> datetime:
    return rig.clock.utc() + timedelta(seconds=seconds)


async def follow(rig: FollowingRig, rates: OffsetRates = COMET, for_s: float = 3600.0) -> None:
    """Slew to the south, and follow."""
    await rig.mount.slew(rig.place(-20.0, 20.0))
    await rig.mount.set_offset_rates(rates, ends_utc=ends(rig, for_s))
    assert rig.beside == pytest.approx((rates.ra_arcsec_s, rates.dec_arcsec_s))


def sidereal(rig: FollowingRig) -> bool:
    return rig.mechanics.tracking and rig.beside == (0.0, 0.0)


def events(rig: FollowingRig, about: str = "offset-rates") -> list[str]:
    return [what for what, _ in rig.told if what.startswith(about)]


# -- in force --------------------------------------------------------------------------------------


def test_rates_are_written_before_they_are_sent_guarded_and_read_back() -> None:
    async def work(rig: FollowingRig) -> None:
        begun = rig.journal.begin

        async def begin(command: CommandRecord) -> None:
            if command.order == "offset-rates":
                assert not rig.following.ordered
                assert rig.guard.told == []
            await begun(command)

        rig.journal.begin = begin  # type: ignore[method-assign]
        await follow(rig)
        assert rig.guard.told == ["arm"]
        in_force = rig.mount.offset_rates_in_force
        assert in_force is not None
        assert in_force.rates == COMET
        assert rig.guard.until_utc is not None
        assert rig.guard.until_utc >= in_force.ends_utc

    rig = run_following(work)
    row = next(one for one in rig.journal.commands if one.order == "offset-rates")
    assert row.facts["ra_arcsec_s"] == COMET.ra_arcsec_s
    assert row.facts["on_loss"] == "sidereal"
    assert row.before is not None
    end = rig.journal.ends[row.command_id]
    assert end.outcome is Outcome.DONE
    assert end.facts["read_back"] == {
        "ra_arcsec_s": pytest.approx(0.05),
        "dec_arcsec_s": pytest.approx(-0.03),
    }
    # closing has ended them
    assert sidereal(rig)
    assert rig.guard.told[-1] == "disarm"


def test_rates_end_at_their_end_and_not_before() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig, for_s=100.0)
        await rig.clock.sleep(98.0)
        assert rig.beside != (0.0, 0.0)
        await rig.clock.sleep(4.0)
        assert sidereal(rig)
        assert rig.mount.offset_rates_in_force is None
        assert rig.guard.until_utc is None

    rig = run_following(work)
    assert events(rig) == ["offset-rates-over"]
    assert rig.told[-1][1]["left"] == "sidereal"
    last = [one for one in rig.journal.commands if one.order == "offset-rates"][-1]
    assert last.facts["ra_arcsec_s"] == 0.0
    assert rig.journal.ends[last.command_id].outcome is Outcome.DONE


def test_by_policy_the_mount_stands_still_at_their_end() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig, for_s=100.0)
        await rig.clock.sleep(105.0)
        assert not rig.mechanics.tracking
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)

    run_following(work, policy=FollowingPolicy(on_loss="stop"))


def test_rates_ordered_again_take_the_place_of_the_first_and_prolong_them() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig, for_s=100.0)
        moved = rig.mount.last_motion_utc
        for number in range(1, 6):
            await rig.clock.sleep(60.0)
            rates = OffsetRates(0.05 + 0.01 * number, -0.03)
            await rig.mount.set_offset_rates(rates, ends_utc=ends(rig, 100.0))
            assert rig.beside == pytest.approx((rates.ra_arcsec_s, rates.dec_arcsec_s))
        # frames of an exposure during which rates are renewed are still of this motion
        assert rig.mount.last_motion_utc == moved
        await rig.clock.sleep(101.0)
        assert sidereal(rig)

    assert events(run_following(work)) == ["offset-rates-over"]


def test_a_clock_that_is_set_back_does_not_prolong_them() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig, for_s=100.0)
        true = rig.clock.utc
        rig.clock.utc = lambda: true() - timedelta(hours=1)  # type: ignore[method-assign]
        await rig.clock.sleep(102.0)
        rig.clock.utc = true  # type: ignore[method-assign]
        assert sidereal(rig)
        assert rig.mount.offset_rates_in_force is None

    run_following(work)


# -- refused ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rates", "for_s", "error"),
    [
        (OffsetRates(math.nan, 0.0), 60.0, "are not rates"),
        (OffsetRates(0.0, math.inf), 60.0, "are not rates"),
        (COMET, 0.0, "would end"),
        (COMET, -5.0, "would end"),
        (COMET, 43_300.0, "at most 43200 s"),
        (OffsetRates(0.0, 8000.0), 60.0, "at most 7200"),
    ],
)
def test_rates_that_make_no_sense_are_refused_and_nothing_is_sent(
    rates: OffsetRates, for_s: float, error: str
) -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        with pytest.raises(BadRequest, match=error):
            await rig.mount.set_offset_rates(rates, ends_utc=ends(rig, for_s))
        with pytest.raises(BadRequest, match="time zone"):
            await rig.mount.set_offset_rates(COMET, ends_utc=ends(rig, 60.0).replace(tzinfo=None))
        assert rig.following.ordered == []
        assert rig.guard.told == []

    run_following(work)


Setting = Callable[[FollowingRig], Awaitable[None]]


async def _parked(rig: FollowingRig) -> None:
    await rig.mount.park()


async def _resting(rig: FollowingRig) -> None:
    await rig.mount.set_tracking(False)


async def _untrusted(rig: FollowingRig) -> None:
    rig.mount.distrust("somebody moved it")


async def _too_slow(rig: FollowingRig) -> None:
    rig.following.most = OffsetRates(0.01, 0.01)


async def _no_guard(rig: FollowingRig) -> None:
    rig.guard.missing = True


async def _said_no(rig: FollowingRig) -> None:
    rig.following.fails.add("refuse-rates")


@pytest.mark.parametrize("setting", [_parked, _resting, _untrusted, _too_slow, _no_guard, _said_no])
def test_rates_are_refused_to_a_mount_that_must_not_have_them(setting: Setting) -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        await setting(rig)
        with pytest.raises(DeviceRefused):
            await rig.mount.set_offset_rates(COMET, ends_utc=ends(rig, 60.0))
        assert rig.mount.offset_rates_in_force is None
        assert rig.guard.until_utc is None
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)

    run_following(work)


def test_rates_that_are_refused_leave_those_before_them_in_force() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig, for_s=300.0)
        rig.following.fails.add("refuse-rates")
        with pytest.raises(DeviceRefused):
            await rig.mount.set_offset_rates(OffsetRates(1.0, 1.0), ends_utc=ends(rig, 600.0))
        rig.following.fails.clear()
        assert rig.mount.offset_rates_in_force is not None
        assert rig.mount.offset_rates_in_force.rates == COMET
        assert rig.beside == pytest.approx((0.05, -0.03))
        await rig.clock.sleep(302.0)
        assert sidereal(rig)

    run_following(work)


def test_a_journal_that_cannot_be_written_lets_no_rates_out_but_ends_them() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig)
        begun = rig.journal.begin

        async def fails(command: CommandRecord) -> None:
            raise JournalFailed("full")

        rig.journal.begin = fails  # type: ignore[method-assign]
        with pytest.raises(JournalFailed):
            await rig.mount.set_offset_rates(OffsetRates(1.0, 1.0), ends_utc=ends(rig, 600.0))
        assert rig.beside == pytest.approx((0.05, -0.03))
        await rig.mount.end_offset_rates()
        assert sidereal(rig)
        rig.journal.begin = begun  # type: ignore[method-assign]

    run_following(work)


def test_a_slew_that_runs_lets_no_rates_in() -> None:
    async def work(rig: FollowingRig) -> None:
        slew = asyncio.ensure_future(rig.mount.slew(rig.place(30.0, 20.0)))
        await rig.clock.sleep(2.0)
        with pytest.raises(Busy):
            await rig.mount.set_offset_rates(COMET, ends_utc=ends(rig, 60.0))
        await slew

    run_following(work)


# -- what ends them --------------------------------------------------------------------------------


async def _stop(rig: FollowingRig) -> None:
    await rig.mount.stop()


async def _end(rig: FollowingRig) -> None:
    await rig.mount.end_offset_rates()


async def _none(rig: FollowingRig) -> None:
    await rig.mount.set_offset_rates(OffsetRates(0.0, 0.0), ends_utc=ends(rig, 60.0))


async def _slew(rig: FollowingRig) -> None:
    await rig.mount.slew(rig.place(10.0, 30.0))


async def _park(rig: FollowingRig) -> None:
    await rig.mount.park()


async def _home(rig: FollowingRig) -> None:
    await rig.mount.home()


async def _rest(rig: FollowingRig) -> None:
    await rig.mount.set_tracking(False)


async def _track(rig: FollowingRig) -> None:
    await rig.mount.set_tracking(True)


async def _lunar(rig: FollowingRig) -> None:
    await rig.mount.set_tracking(True, TrackingRate.LUNAR)


async def _close(rig: FollowingRig) -> None:
    await rig.mount.close()


async def _distrust(rig: FollowingRig) -> None:
    rig.mount.distrust("it slipped")
    await rig.clock.sleep(1.0)


async def _link(rig: FollowingRig) -> None:
    rig.driver.cut(20.0)
    with pytest.raises(DeviceError):
        await rig.mount.reading()
    await rig.clock.sleep(40.0)


def test_an_end_that_is_slow_as_the_mount_is_let_go_is_no_work_for_the_guard() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig, COMET, 600.0)
        rig.following.slow_s = 7.0  # longer than the mount is waited for
        await rig.mount.close()
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert "take over" not in rig.guard.told
        assert rig.guard.until_utc is None

    rig = run_following(work)
    assert rig.outcomes()[-1] == ("offset-rates", Outcome.DONE)


def test_rates_that_only_the_driver_could_end_as_it_was_closed_are_no_work_for_the_guard() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig, COMET, 600.0)
        rig.following.fails = {"end-rates"}

        async def close() -> None:
            rig.following.fails = set()
            await rig.following.set_offset_rates(STARS_RATES)

        rig.driver.close = close  # type: ignore[method-assign]
        await rig.mount.close()
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert "take over" not in rig.guard.told
        assert rig.guard.until_utc is None

    rig = run_following(work)
    assert rig.outcomes()[-1] == ("offset-rates", Outcome.DONE)


@pytest.mark.parametrize("hangs", [False, True])
def test_rates_that_nobody_could_end_as_the_mount_was_let_go_are_the_guard_s(hangs: bool) -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig, COMET, 600.0)
        rig.following.fails = {"end-rates"}

        async def close() -> None:
            if hangs:
                while "take over" not in rig.guard.told:
                    await rig.clock.sleep(0.5)

        rig.driver.close = close  # type: ignore[method-assign]
        await rig.mount.close()
        assert "take over" in rig.guard.told
        assert "disarm" not in rig.guard.told

    run_following(work)


def test_an_unplugged_mount_is_tried_again_after_pauses_and_let_go_twice() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig, COMET, 600.0)
        rig.following.fails = {"end-rates"}
        await rig.mount.close()
        # its cable is closed now: each try fails at once, and so does each stop
        began_s = rig.clock.monotonic_s()
        await rig.mount.close()
        assert rig.clock.monotonic_s() - began_s > 1.0
        assert len(rig.journal.commands) < 30
        assert rig.guard.told == ["arm", "take over", "take over"]

    run_following(work)


@pytest.mark.long
@pytest.mark.parametrize(
    "order",
    [_stop, _end, _none, _slew, _park, _home, _rest, _track, _lunar, _close, _distrust, _link],
)
@pytest.mark.parametrize("rates", [COMET, FAST])
@pytest.mark.parametrize("native", [False, True])
def test_each_order_and_mishap_ends_them(order: Setting, rates: OffsetRates, native: bool) -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig, rates, 20.0 if rates is FAST and order is not _link else 60.0)
        await order(rig)
        assert rig.mount.offset_rates_in_force is None
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert rig.guard.until_utc is None
        if order in (_rest, _park):
            assert not rig.mechanics.tracking
        if order is not _close:
            assert rig.mount.following_problem is None

    run_following(work, native=native)


async def _guide(rig: FollowingRig) -> None:
    await rig.mount.guide(Direction.NORTH, 1.0)


async def _sync(rig: FollowingRig) -> None:
    await rig.mount.sync(rig.mechanics.reported())


@pytest.mark.parametrize("order", [_guide, _sync])
def test_a_sync_and_guide_pulses_leave_them_in_force(order: Setting) -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig)
        await order(rig)
        assert rig.mount.offset_rates_in_force is not None
        assert rig.beside == pytest.approx((0.05, -0.03))

    run_following(work)


def test_rates_are_ended_before_the_slew_is_sent() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig)
        slew = rig.driver.slew

        async def looked(place: object) -> object:
            assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
            return await slew(place)  # type: ignore[arg-type]

        rig.driver.slew = looked  # type: ignore[method-assign, assignment]
        await rig.mount.slew(rig.place(10.0, 30.0))

    run_following(work)


def test_a_slew_that_is_refused_leaves_them_in_force() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig)
        with pytest.raises(OutsideLimits):
            await rig.mount.slew(rig.place(0.0, -60.0))
        assert rig.beside == pytest.approx((0.05, -0.03))

    run_following(work)


def test_a_slew_is_not_sent_while_they_cannot_be_ended() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig)
        rig.following.fails.add("end-rates")
        with pytest.raises(DeviceSilent):
            await rig.mount.slew(rig.place(10.0, 30.0))
        assert rig.driver.received.count("slew") == 1
        rig.following.fails.clear()
        await rig.clock.sleep(10.0)
        assert sidereal(rig)
        await rig.mount.slew(rig.place(10.0, 30.0))

    rig = run_following(work)
    assert events(rig) == ["offset-rates-not-ended", "offset-rates-ended-late"]


@pytest.mark.parametrize("fault", ["end-rates", "deaf-rates"])
def test_rates_that_cannot_be_ended_are_tried_on_told_and_the_mount_is_stopped(fault: str) -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig)
        rig.following.fails.add(fault)
        with pytest.raises(DeviceError):
            await rig.mount.end_offset_rates()
        assert rig.mount.following_problem is not None
        await rig.clock.sleep(15.0)
        assert not rig.mechanics.tracking
        if fault == "end-rates":
            # switched off, it has none: but nobody has seen that
            assert rig.guard.until_utc is not None
        await rig.clock.sleep(200.0)
        rig.following.fails.clear()
        await rig.clock.sleep(10.0)
        assert rig.mount.following_problem is None
        assert rig.mount.offset_rates_in_force is None
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert rig.guard.until_utc is None

    rig = run_following(work)
    told = events(rig)
    assert told[0] == "offset-rates-not-ended"
    assert "offset-rates-stopped" in told
    assert told[-1] == "offset-rates-ended-late"
    # some reports, not one each try
    assert len(told) < 8
    faults = [one.what for one in rig.journal.entries if one.kind is EntryKind.FAULT]
    assert any("it was stopped" in what for what in faults)


def test_rates_of_which_nobody_knows_whether_they_were_taken_are_ended() -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        rig.following.fails.add("rates")
        with pytest.raises(DeviceSilent):
            await rig.mount.set_offset_rates(COMET, ends_utc=ends(rig, 60.0))
        await rig.clock.sleep(1.0)
        assert rig.following.ordered[-1] == ("rates", 0.0, 0.0)
        assert rig.guard.until_utc is None

    run_following(work)


def test_a_caller_that_is_cancelled_leaves_no_rates() -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        for after_s in (0.01, 0.02, 0.03, 0.05):
            order = asyncio.ensure_future(rig.mount.set_offset_rates(COMET, ends_utc=ends(rig, 600.0)))
            await rig.clock.sleep(after_s)
            order.cancel()
            await asyncio.gather(order, return_exceptions=True)
            await rig.clock.sleep(3.0)
            if rig.mount.offset_rates_in_force is None:
                assert rig.beside == (0.0, 0.0)
            await rig.mount.end_offset_rates()
            assert sidereal(rig)

    run_following(work)


def test_a_stop_while_they_are_ordered_wins() -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        for after_s in (0.001, 0.01, 0.021, 0.03, 0.05, 0.07):
            order = asyncio.ensure_future(rig.mount.set_offset_rates(COMET, ends_utc=ends(rig, 600.0)))
            await rig.clock.sleep(after_s)
            await rig.mount.stop()
            (came,) = await asyncio.gather(order, return_exceptions=True)
            assert came is None or isinstance(came, Cancelled)
            await rig.clock.sleep(2.0)
            assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
            assert rig.mount.offset_rates_in_force is None
            if not rig.mechanics.tracking:
                await rig.mount.set_tracking(True)

    run_following(work)


def test_a_stop_leaves_a_mount_at_rest_that_rested_after_it() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig)
        stop, end = rig.driver.stop, rig.following.set_offset_rates

        async def stops_tracking() -> None:
            await stop()
            rig.mechanics.tracking = False

        async def begins_to_track(rates: OffsetRates) -> None:
            await end(rates)
            rig.mechanics.tracking = True

        rig.driver.stop = stops_tracking  # type: ignore[method-assign]
        rig.following.set_offset_rates = begins_to_track  # type: ignore[method-assign]
        await rig.mount.stop()
        assert not rig.mechanics.tracking
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)

    run_following(work)


def test_rates_that_end_late_do_not_have_a_mount_track_that_was_told_to_rest() -> None:
    async def work(rig: FollowingRig) -> None:
        await follow(rig)
        end = rig.following.set_offset_rates

        async def begins_to_track(rates: OffsetRates) -> None:
            await end(rates)
            rig.mechanics.tracking = True

        rig.following.set_offset_rates = begins_to_track  # type: ignore[method-assign]
        rig.following.fails.add("end-rates")
        await rig.mount.set_tracking(False)
        assert not rig.mechanics.tracking
        rig.following.fails.clear()
        await rig.clock.sleep(10.0)
        assert rig.following.ordered[-1] == ("rates", 0.0, 0.0)
        assert not rig.mechanics.tracking

    run_following(work)


def test_rates_that_were_checked_before_a_slew_are_not_sent_after_it() -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        now = rig.mechanics.truth()
        asked = asyncio.Event()

        def slowly(utc: datetime) -> Icrs:
            asked.set()
            return now

        order = asyncio.ensure_future(
            rig.mount.set_offset_rates(COMET, ends_utc=ends(rig, 40_000.0), path=slowly)
        )
        await asked.wait()
        # the path is looked at in a thread
        slew = asyncio.ensure_future(rig.mount.slew(rig.place(-10.0, 20.0)))
        came, _ = await asyncio.gather(order, slew, return_exceptions=True)
        if rig.mount.offset_rates_in_force is None:
            assert came is None or isinstance(came, Busy | OutsideLimits)
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)

    run_following(work)


# -- limits ----------------------------------------------------------------------------------------


def altitude_deg(rig: FollowingRig) -> float:
    return icrs_to_observed(rig.mechanics.truth(), rig.clock.utc(), SITE, AIR).alt_deg


def test_rates_that_lead_into_a_limit_before_their_end_are_refused_with_the_instant() -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(0.0, 20.0))
        down = OffsetRates(0.0, -360.0)  # 0.1°/s
        with pytest.raises(OutsideLimits, match=r"altitude 1[45].*below the limit") as refused:
            await rig.mount.set_offset_rates(down, ends_utc=ends(rig, 600.0))
        assert refused.value.limit is LimitKind.ALTITUDE
        assert rig.following.ordered == []
        await rig.mount.set_offset_rates(down, ends_utc=ends(rig, 60.0))

    rig = run_following(work)
    assert rig.refusals()[0]["limit"] == "altitude"


def test_a_path_that_enters_a_limit_is_refused_whatever_the_rates_say() -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(0.0, 20.0))
        reading = await rig.mount.reading()
        now = rig.mechanics.truth()

        def sinks(utc: datetime) -> Icrs:
            seconds = (utc - reading.utc).total_seconds()
            return Icrs(now.ra_deg, now.dec_deg - 1e-4 * seconds * seconds)

        with pytest.raises(OutsideLimits):
            await rig.mount.set_offset_rates(COMET, ends_utc=ends(rig, 900.0), path=sinks)
        await rig.mount.set_offset_rates(COMET, ends_utc=ends(rig, 400.0), path=sinks)
        with pytest.raises(BadRequest, match="from where the mount stands"):
            await rig.mount.set_offset_rates(
                COMET, ends_utc=ends(rig, 60.0), path=lambda _: Icrs(now.ra_deg, now.dec_deg + 30.0)
            )

    run_following(work)


def test_what_follows_is_stopped_before_a_limit_though_it_was_told_another_path() -> None:
    """The mount goes ten times as fast as its path says."""

    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(0.0, 0.0))
        now = rig.mechanics.truth()
        await rig.mount.set_offset_rates(
            OffsetRates(0.0, -360.0), ends_utc=ends(rig, 900.0), path=lambda _: now
        )
        seen = []
        for _ in range(400):
            await rig.clock.sleep(1.0)
            seen.append(altitude_deg(rig))
        assert min(seen) >= 20.0
        assert min(seen) < 23.0
        assert not rig.mechanics.tracking
        assert rig.mount.offset_rates_in_force is None

    rig = run_following(work, limits=Limits(20.0))
    assert [what for what, _ in rig.told if what.startswith("limit-stop")] == ["limit-stop"]


def test_a_mount_that_follows_much_faster_than_it_was_told_is_stopped_at_the_limit() -> None:
    """Its declination rate is wrong by 100: nobody has told the room."""

    async def work(rig: FollowingRig) -> None:
        from mountnav.simulation.rate_faults import RateFault

        await rig.mount.slew(rig.place(0.0, 0.0))
        rig.mechanics.fail_rates(RateFault(dec_factor=100.0))
        await rig.mount.set_offset_rates(OffsetRates(0.0, -20.0), ends_utc=ends(rig, 900.0))
        lowest = 90.0
        for _ in range(200):
            await rig.clock.sleep(1.0)
            lowest = min(lowest, altitude_deg(rig))
        # 0.56°/s, seen each 2 s; a quarter of a degree outside shows by readings
        assert lowest >= 20.0 - 0.25 - 0.56 * 4.0
        assert rig.mount.offset_rates_in_force is None

    rig = run_following(work, limits=Limits(20.0), policy=FollowingPolicy())
    assert "limit-stop" in [what for what, _ in rig.told]


def test_a_german_mount_that_follows_stops_past_the_meridian_by_the_true_path() -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-3.0, 20.0))
        # to the west besides: twice as fast over the ground as the stars
        rates = OffsetRates(-15.0, 0.0)
        with pytest.raises(OutsideLimits) as refused:
            await rig.mount.set_offset_rates(rates, ends_utc=ends(rig, 3600.0))
        assert refused.value.limit is LimitKind.MERIDIAN
        await rig.mount.set_offset_rates(rates, ends_utc=ends(rig, 900.0))
        near = rig.mount.reached(await rig.mount.reading())
        assert near is not None
        assert near.limit is LimitKind.MERIDIAN
        # 8° at 30″/s for 900 s are 7.5°, and the rest as for a star
        assert 900.0 < near.after_s < 1080.0

    run_following(
        work,
        limits=Limits(15.0, past_meridian_deg=(5.0, 5.0)),
        machine=Machine(mounting="german"),
        mounting="german",
    )


def test_one_path_is_looked_at_once_however_often_the_rates_are_renewed() -> None:
    asked: list[datetime] = []

    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(-20.0, 20.0))
        now = rig.mechanics.truth()

        class Target:
            def path(self, utc: datetime) -> Icrs:
                asked.append(utc)
                return now

        target, until = Target(), ends(rig, 3600.0)
        await rig.mount.set_offset_rates(COMET, ends_utc=until, path=target.path)
        first = len(asked)
        for number in range(5):
            later = until + timedelta(seconds=60.0 * number)
            await rig.mount.set_offset_rates(COMET, ends_utc=later, path=target.path)
        # a later end is looked at from the end before it on
        assert first > 60
        assert len(asked) < first + 60

    run_following(work)


@pytest.mark.long
def test_orders_to_set_and_end_them_at_random_leave_none() -> None:
    """Whatever order comes at whatever moment: nothing is in force that isn't known."""
    from random import Random

    async def work(rig: FollowingRig) -> None:
        chance = Random(18)
        await rig.mount.slew(rig.place(-20.0, 20.0))
        orders: list[Setting] = [
            _stop,
            _end,
            _slew,
            _track,
            _rest,
            _guide,
            _distrust_and_trust,
            _set,
            _set,
            _set,
        ]
        running: set[asyncio.Future[None]] = set()
        for _ in range(120):
            order = chance.choice(orders)
            rig.following.fails = set(
                chance.sample(
                    ["end-rates", "rates", "refuse-rates", "deaf-rates"], chance.choice([0, 0, 0, 1])
                )
            )
            running.add(asyncio.ensure_future(order(rig)))
            await rig.clock.sleep(chance.choice([0.0, 0.01, 0.03, 0.5, 3.0]))
        rig.following.fails.clear()
        for came in await asyncio.gather(*running, return_exceptions=True):
            assert came is None or isinstance(came, MountnavError), came
        await rig.clock.sleep(30.0)
        in_force = rig.mount.offset_rates_in_force
        assert (in_force is None) == (rig.mechanics.beside_arcsec_s == (0.0, 0.0))
        await rig.clock.sleep(700.0)
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert rig.mount.offset_rates_in_force is None
        assert rig.guard.until_utc is None

    rig = run_following(work)
    assert all(outcome is not None for _, outcome in rig.outcomes())


async def _set(rig: FollowingRig) -> None:
    await rig.mount.set_offset_rates(COMET, ends_utc=ends(rig, 600.0))


async def _distrust_and_trust(rig: FollowingRig) -> None:
    rig.mount.distrust("a test")
    rig.mount.trust()
