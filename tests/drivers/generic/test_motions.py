"""Slews to their end and stops past everything, on a language without a wire."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivers.generic.language import Readout
from mountnav.clock import utc_now
from mountnav.devices import (
    Direction,
    SlewOutcome,
    SlewState,
)
from mountnav.errors import Busy, DeviceMissing, DeviceRefused, DeviceSilent, Refusal
from mountnav.sky.coordinates import Apparent
from tests.drivers.generic.plain_rig import QUICK, plain, rigged


async def test_a_slew_tells_what_it_has_come_to() -> None:
    async with rigged(plain(slew_rate_deg_s=5.0)) as rig:
        assert rig.mount.slew_state is SlewState.NONE
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(4.0, -4.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        with pytest.raises(Busy):
            await rig.mount.slew(await rig.beside(1.0, -1.0))
        with pytest.raises(Busy):
            await rig.mount.sync(await rig.beside(0.0, 0.0))
        assert await slew is SlewOutcome.ARRIVED
        assert rig.mount.slew_state is SlewState.ARRIVED
        assert rig.language.orders.count("slew") == 1


async def test_a_refused_slew_keeps_its_reason() -> None:
    async with rigged() as rig:
        place = (await rig.mount.reading()).place
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.slew(Apparent(place.ra_deg, -80.0, utc_now()))
        assert refusal.value.reason is Refusal.BELOW_HORIZON
        assert rig.mount.slew_state is SlewState.REFUSED


@pytest.mark.parametrize("ignored", [False, True])
async def test_a_lost_answer_is_seen_in_the_sky(ignored: bool) -> None:
    async with rigged() as rig:
        rig.language.slew_answer_lost, rig.language.slew_ignored = True, ignored
        slew = rig.mount.slew(await rig.beside(3.0, -3.0))
        if ignored:
            with pytest.raises(DeviceSilent):
                await slew
        else:
            assert await slew is SlewOutcome.ARRIVED
        assert rig.language.orders.count("slew") == 1


@pytest.mark.parametrize("silently", [False, True])
async def test_a_slew_that_never_begins(silently: bool) -> None:
    async with rigged() as rig:
        rig.language.slew_ignored, rig.language.refuses_silently = True, silently
        slew = rig.mount.slew(await rig.beside(3.0, -3.0))
        if silently:
            with pytest.raises(DeviceRefused, match="didn't move"):
                await slew
        else:
            assert await slew is SlewOutcome.STALLED


async def test_a_slew_that_takes_too_long_is_stopped() -> None:
    async with rigged(plain(slew_rate_deg_s=0.5), replace(QUICK, slew_timeout_s=0.5)) as rig:
        assert await rig.mount.slew(await rig.beside(5.0, -5.0)) is SlewOutcome.STALLED
        assert not rig.language.mechanics.slewing()


async def test_a_cancelled_slew_is_stopped_and_its_state_is_found_out() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0)) as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(5.0, -5.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        slew.cancel()
        with pytest.raises(asyncio.CancelledError):
            await slew
        assert rig.mount.slew_state is SlewState.LOST
        await rig.until(lambda: rig.mount.slew_state is SlewState.STOPPED)
        assert not rig.language.mechanics.slewing()


async def test_stop_is_repeated_until_the_mount_rests() -> None:
    async with rigged(plain(slew_rate_deg_s=2.0)) as rig:
        rig.language.stops_needed = 3
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        await rig.mount.stop()
        assert not rig.language.mechanics.slewing()
        assert "stop 3" in rig.language.orders
        assert await slew is SlewOutcome.STOPPED


async def test_an_order_that_comes_during_a_stop_waits_for_its_end() -> None:
    """A stop is repeated: what went out in between was stopped with the rest, and told as "didn't move"."""
    async with rigged(plain(slew_rate_deg_s=20.0)) as rig:
        rig.language.stops_needed = 3
        first = asyncio.create_task(rig.mount.slew(await rig.beside(60.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        stopping = asyncio.create_task(rig.mount.stop())
        await rig.until(lambda: "stop 1" in rig.language.orders)
        assert await first is SlewOutcome.STOPPED
        second = asyncio.create_task(rig.mount.slew(await rig.beside(-10.0, 3.0)))
        await stopping
        assert await second is SlewOutcome.ARRIVED
        stops = [order for order in rig.language.orders if order.startswith("stop")]
        assert rig.language.orders.index(stops[-1]) < len(rig.language.orders) - 1


async def test_a_stop_ends_an_order_that_waits_for_another_one() -> None:
    async with rigged() as rig:
        # as while another stop is carried out
        rig.mount._session.no_stop.clear()
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(-10.0, 3.0)))
        await rig.until(lambda: rig.mount._session.job is not None)
        await rig.mount.stop()
        assert await slew is SlewOutcome.STOPPED
        assert not any(order.startswith("slew") for order in rig.language.orders)


async def test_stop_goes_on_through_a_silence() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0), replace(QUICK, lost_after_s=60.0)) as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        rig.language.silent, rig.language.stops_needed = True, 4
        stop = asyncio.create_task(rig.mount.stop())
        await rig.until(lambda: "stop 4" in rig.language.orders)
        rig.language.silent = False
        await stop
        assert not rig.language.mechanics.slewing()
        # its follower has seen it stop, or heard nothing for too long: never that it arrived
        (end,) = await asyncio.gather(slew, return_exceptions=True)
        assert end is SlewOutcome.STOPPED or isinstance(end, DeviceSilent)


async def test_one_reading_after_the_time_for_a_stop_claims_no_motion() -> None:
    async with rigged(timing=replace(QUICK, stop_timeout_s=0.0, heartbeat_s=0.0)) as rig:
        await rig.mount.stop()


async def test_a_stop_has_its_time_after_a_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was told into the silence nobody may have heard."""
    timing = replace(QUICK, stop_timeout_s=1.0, heartbeat_s=0.0)
    async with rigged(timing=timing) as rig:
        readout = rig.language.readout
        looks = iter(("silent", "late"))
        rig.language.stops_needed = 10_000
        rig.language.mechanics.move("n", 1.0)

        async def slow() -> Readout:
            match next(looks, None):
                case "silent":
                    raise DeviceSilent("no answer", device="plain")
                case "late":
                    # its answer comes when the stop's time is over, and only then it listens to stops
                    await asyncio.sleep(2.0 * timing.stop_timeout_s)
                    rig.language.stops_needed = 0
            return await readout()

        monkeypatch.setattr(rig.language, "readout", slow)
        await rig.mount.stop()
        assert next(looks, None) is None
        assert not rig.language.mechanics.slewing()


async def test_a_mount_that_can_not_be_stopped_is_told() -> None:
    async with rigged(plain(slew_rate_deg_s=0.5), replace(QUICK, stop_timeout_s=0.3)) as rig:
        rig.language.stops_needed = 10_000
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        with pytest.raises(DeviceRefused, match="cut its power"):
            await rig.mount.stop()
        rig.language.stops_needed = 0
        await rig.mount.stop()
        assert await slew is SlewOutcome.STOPPED


async def test_a_slew_does_not_go_on_over_a_new_link() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0), replace(QUICK, poll_s=0.6, backoff_s=0.01)) as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        # lost and made again between two looks of whoever follows
        rig.language.lose()
        await rig.until(lambda: rig.heard("link-back"))
        with pytest.raises(DeviceMissing, match="lost on the way: unplugged"):
            await slew
        await rig.until(lambda: rig.mount.slew_state is SlewState.STOPPED)
        assert not rig.mount.trusted


async def test_a_mount_that_runs_on_is_not_called_refused() -> None:
    timing = replace(QUICK, slew_timeout_s=0.5, stop_timeout_s=0.3)
    async with rigged(plain(slew_rate_deg_s=1.0), timing) as rig:
        rig.language.stops_needed = 10_000
        with pytest.raises(DeviceRefused, match="still moves"):
            await rig.mount.slew(await rig.beside(20.0, -20.0))
        assert rig.mount.slew_state is SlewState.LOST
        rig.language.stops_needed = 0
        await rig.until(lambda: rig.mount.slew_state is SlewState.STOPPED)


async def test_no_other_order_runs_into_a_slew_nor_a_slew_into_a_pulse() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0)) as rig:
        place = await rig.beside(10.0, -10.0)
        pulse = asyncio.create_task(rig.mount.guide(Direction.NORTH, 0.3))
        other = asyncio.create_task(rig.mount.guide(Direction.WEST, 0.2))
        await asyncio.sleep(0.05)
        with pytest.raises(Busy, match="guide pulse"):
            await rig.mount.slew(place)
        await asyncio.gather(pulse, other)
        slew = asyncio.create_task(rig.mount.slew(place))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        for order in (
            rig.mount.guide(Direction.NORTH, 0.1),
            rig.mount.set_tracking(False),
            rig.mount.unpark(),
            rig.mount.park(),
        ):
            with pytest.raises(Busy):
                await order
        await rig.mount.stop()
        assert await slew is SlewOutcome.STOPPED
