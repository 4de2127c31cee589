"""A mount that says no and does it all the same is stopped, told, and no longer trusted; a real no stays."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace

import pytest

from drivers.generic.mount import GenericMount
from mountnav.clock import utc_now
from mountnav.devices import Direction, SlewOutcome, SlewState
from mountnav.errors import DeviceError, DeviceRefused, RefusedButDone
from mountnav.sky.coordinates import Apparent
from tests.drivers.generic.plain_language import PlainLanguage
from tests.drivers.generic.plain_rig import QUICK, plain, rigged

QUICK_TO_GIVE_UP = replace(QUICK, stop_timeout_s=0.5)


class MuteAfterNo(PlainLanguage):
    """Its no is the last that is heard of it."""

    def _denied(self, order: str) -> None:
        self.silent = order in self.denies
        super()._denied(order)


ORDERS: dict[str, Callable[[GenericMount, Apparent], Awaitable[object]]] = {
    "slew": lambda mount, place: mount.slew(place),
    "park": lambda mount, place: mount.park(),
    "home": lambda mount, place: mount.home(),
    "guide": lambda mount, place: mount.guide(Direction.NORTH, 0.1),
}


@pytest.mark.parametrize("order", ORDERS)
async def test_a_refused_order_that_moves_it_is_stopped_and_told(order: str) -> None:
    language = plain(slew_rate_deg_s=4.0)
    async with rigged(language) as rig:
        target = await rig.beside(20.0, -30.0)
        language.denies = {order}
        with pytest.raises(
            RefusedButDone, match=r"said refused \(below horizon\), but moved.*; stopped"
        ) as error:
            await ORDERS[order](rig.mount, target)
        assert not isinstance(error.value, DeviceRefused)
        assert not language.mechanics.slewing()
        assert "stop 0" in language.orders
        assert not rig.mount.trusted
        assert rig.mount.slew_state is SlewState.STOPPED
        (told,) = rig.heard("refused-but-done")
        assert told["why"] == error.value.what
        assert "said no to" in str(rig.heard("untrusted")[0]["why"])
        # and it isn't slewed by that position
        language.denies = set()
        with pytest.raises(DeviceRefused, match="can't be trusted"):
            await rig.mount.slew(target)


async def test_one_that_sets_out_late_is_seen_within_the_grace_of_a_start() -> None:
    language = plain(slew_rate_deg_s=4.0)
    async with rigged(language) as rig:
        target = await rig.beside(20.0, -30.0)
        language.denies, language.slew_ignored = {"slew"}, True
        asyncio.get_running_loop().call_later(0.6 * QUICK.start_grace_s, language.mechanics.slew, target)
        with pytest.raises(RefusedButDone):
            await rig.mount.slew(target)
        assert not language.mechanics.slewing()


async def test_a_refusal_that_is_one_stays_one() -> None:
    async with rigged() as rig:
        below = Apparent(0.0, -80.0, utc_now())
        with pytest.raises(DeviceRefused, match="below horizon"):
            await rig.mount.slew(below)
        assert rig.mount.slew_state is SlewState.REFUSED
        assert rig.mount.trusted
        assert not [one for one in rig.language.orders if one.startswith("stop")]
        assert await rig.mount.slew(await rig.beside(1.0, -1.0)) is SlewOutcome.ARRIVED


async def test_somebody_elses_motion_is_not_stopped_by_a_refusal() -> None:
    async with rigged() as rig:
        rig.language.mechanics.move("n", 0.5)
        await rig.until(lambda: rig.mount._session.in_motion)
        with pytest.raises(DeviceRefused, match="below horizon"):
            await rig.mount.slew(Apparent(0.0, -80.0, utc_now()))
        assert rig.language.mechanics.slewing()
        assert rig.mount.trusted
        rig.language.mechanics.stop()


async def test_a_refused_sync_that_was_taken_is_told_and_nothing_is_stopped() -> None:
    async with rigged() as rig:
        rig.language.denies = {"sync"}
        with pytest.raises(RefusedButDone, match=r"the sync: said refused .*, but moved by 0\.\d\d°"):
            await rig.mount.sync(await rig.beside(0.3, -0.3))
        assert not rig.mount.trusted
        assert "stop 0" not in rig.language.orders


@pytest.mark.parametrize("on", [True, False])
async def test_tracking_that_was_refused_and_switched_is_told(on: bool) -> None:
    async with rigged() as rig:
        await rig.mount.set_tracking(not on)
        rig.language.denies = {"tracking"}
        with pytest.raises(DeviceError, match="said refused") as error:
            await rig.mount.set_tracking(on)
        assert isinstance(error.value, RefusedButDone)
        # begun against its word it would go on unattended
        assert rig.language.mechanics.tracking is False
        assert not rig.mount.trusted


async def test_an_unparking_that_was_refused_and_done_is_told() -> None:
    async with rigged() as rig:
        await rig.mount.park()
        rig.language.denies = {"unpark"}
        with pytest.raises(RefusedButDone, match="but did it"):
            await rig.mount.unpark()


async def test_one_that_can_not_be_stopped_is_told_so() -> None:
    language = plain(slew_rate_deg_s=2.0)
    language.stops_needed = 10**6
    async with rigged(language, QUICK_TO_GIVE_UP) as rig:
        language.denies = {"slew"}
        with pytest.raises(RefusedButDone, match="could not be stopped"):
            await rig.mount.slew(await rig.beside(30.0, -40.0))
        assert rig.mount.slew_state is SlewState.LOST
        # and it is told again at each look
        told = language.orders.count("stop 1")
        await rig.until(lambda: language.orders.count("stop 1") > told)
        language.stops_needed = 0


async def test_one_that_says_no_and_nothing_more_is_owed_a_stop() -> None:
    language = MuteAfterNo(plain(slew_rate_deg_s=2.0).mechanics)
    async with rigged(language) as rig:
        language.denies = {"slew"}
        with pytest.raises(DeviceError, match="said no") as error:
            await rig.mount.slew(await rig.beside(30.0, -40.0))
        assert not isinstance(error.value, DeviceRefused)
        assert rig.mount.slew_state is SlewState.LOST
        language.silent = False
        await rig.until(lambda: not language.mechanics.slewing())
