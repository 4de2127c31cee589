"""Links that are lost or silent, on a language without a wire."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivers.generic.link_supervisor import LinkState
from mountnav.devices import (
    SlewState,
)
from mountnav.errors import DeviceMissing, DeviceRefused
from tests.drivers.generic.plain_rig import QUICK, plain, rigged


async def test_a_lost_link_is_told_found_again_and_takes_the_trust() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0)) as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        rig.language.absent = True
        rig.language.lose()
        with pytest.raises(DeviceMissing):
            await slew
        assert rig.mount.slew_state is SlewState.LOST
        await rig.until(lambda: rig.heard("link-lost"))
        assert rig.mount.link is LinkState.LOST
        with pytest.raises(DeviceMissing):
            await rig.mount.reading()
        tries = rig.language.orders.count("open")
        await rig.until(lambda: rig.language.orders.count("open") > tries + 2)
        rig.language.absent = False
        await rig.until(lambda: rig.heard("link-back"))
        # it went on moving all the while: the first thing said is stop
        back = len(rig.language.orders) - 1 - rig.language.orders[::-1].index("open")
        assert rig.language.orders[back + 1] == "stop 0"
        await rig.until(lambda: rig.mount.slew_state is SlewState.STOPPED)
        assert not rig.mount.trusted
        assert rig.mount.link is LinkState.UP
        with pytest.raises(DeviceRefused):
            await rig.mount.slew(await rig.beside(1.0, -1.0))


async def test_a_silent_mount_is_told_and_then_counts_as_lost() -> None:
    async with rigged() as rig:
        trusted: list[bool] = []
        rig.mount.listen(lambda what, _: trusted.append(rig.mount.trusted) if what == "link-silent" else None)
        rig.language.silent = True
        await rig.until(lambda: rig.heard("link-silent"))
        assert trusted == [True]
        await rig.until(lambda: rig.heard("link-lost"))
        assert not rig.mount.trusted
        rig.language.silent = False
        await rig.until(lambda: rig.heard("link-back"))
        assert (await rig.mount.reading()).slewing is False


async def test_a_short_silence_is_told_and_forgiven() -> None:
    async with rigged(timing=replace(QUICK, lost_after_s=60.0)) as rig:
        rig.language.silent = True
        await rig.until(lambda: rig.heard("link-silent"))
        rig.language.silent = False
        await rig.until(lambda: rig.heard("link-back"))
        assert rig.mount.trusted
        assert not rig.heard("link-lost")
