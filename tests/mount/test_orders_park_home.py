"""Park and home: who is told that the mount is there may close a roof over it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from mountnav.devices import SlewOutcome, from_mount
from mountnav.errors import Cancelled, NotReached, TargetNotReached
from mountnav.journal.records import Outcome
from mountnav.simulation.machine import Machine
from mountnav.sky.sphere import separation_arcsec
from tests.navigation.virtual_rig import VirtualRig, in_virtual_time

Send = Callable[[VirtualRig], Awaitable[SlewOutcome]]
STATIONS = pytest.mark.parametrize(
    "send",
    [lambda rig: rig.navigator.park(), lambda rig: rig.navigator.home()],
    ids=["park", "home"],
)
SLOW = Machine(slew_rate_deg_s=1.0)


async def away(rig: VirtualRig) -> None:
    await rig.navigator.slew(rig.up(30.0, 10.0))


@STATIONS
def test_it_is_told_when_it_is_there(send: Send) -> None:
    async def work(rig: VirtualRig) -> None:
        await away(rig)
        assert await send(rig) is SlewOutcome.ARRIVED

    in_virtual_time(work)


@STATIONS
def test_what_comes_to_rest_on_the_way_has_failed(send: Send) -> None:
    async def work(rig: VirtualRig) -> None:
        await away(rig)
        sending = asyncio.ensure_future(send(rig))
        await rig.clock.sleep(3.0)
        rig.mechanics.stick("ha")
        with pytest.raises(TargetNotReached, match="stopped on its way to its") as failed:
            await sending
        assert failed.value.reason is NotReached.REST
        assert failed.value.device == rig.navigator.mount.name
        assert not rig.mechanics.parked
        assert rig.navigator.activity == "idle"
        last = rig.journal.commands[-1]
        assert rig.journal.ends[last.command_id].outcome is Outcome.STALLED

    in_virtual_time(work, machine=SLOW)


@STATIONS
def test_what_is_stopped_on_the_way_is_not_there(send: Send) -> None:
    async def work(rig: VirtualRig) -> None:
        await away(rig)
        sending = asyncio.ensure_future(send(rig))
        await rig.clock.sleep(3.0)
        before = from_mount((await rig.mount.reading()).place)
        await rig.navigator.stop()
        with pytest.raises(Cancelled, match="was stopped on its way to its"):
            await sending
        after = from_mount((await rig.mount.reading()).place)
        assert separation_arcsec(before, after) < 10.0 * 3600.0
        assert not rig.mechanics.parked

    in_virtual_time(work, machine=SLOW)
