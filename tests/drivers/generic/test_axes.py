"""Axes moved by hand: ended by 0, by a stop, by closing, by a broken link, and by whatever is not certain."""

from __future__ import annotations

import asyncio
import math

import pytest

from mountnav.devices import Direction, MountAxis, MovesAxes, OffsetRates, Skill, SlewOutcome
from mountnav.errors import (
    BadRequest,
    Busy,
    DeviceRefused,
    DeviceSilent,
    MountnavError,
    Refusal,
    RefusedButDone,
)
from tests.drivers.generic.plain_rig import Rig, plain, rigged


def _sent(rig: Rig) -> list[str]:
    return [order for order in rig.language.orders if order.startswith("axis")]


async def _moved_deg(rig: Rig, seconds: float) -> tuple[float, float]:
    before = (await rig.mount.reading()).place
    await asyncio.sleep(seconds)
    after = (await rig.mount.reading()).place
    return (after.ra_deg - before.ra_deg + 180.0) % 360.0 - 180.0, after.dec_deg - before.dec_deg


async def _rests(rig: Rig) -> bool:
    east, north = await _moved_deg(rig, 0.3)
    return abs(east) < 0.003 and abs(north) < 0.003


@pytest.mark.parametrize("tells_motion", [True, False])
@pytest.mark.parametrize(("axis", "rate_deg_s"), [("primary", 1.5), ("primary", -3.0), ("secondary", -2.0)])
async def test_it_moves_until_it_is_told_to_end(
    axis: MountAxis, rate_deg_s: float, tells_motion: bool
) -> None:
    async with rigged() as rig:
        assert isinstance(rig.mount, MovesAxes)
        rig.language.tells_motion = tells_motion
        await rig.mount.move_axis(axis, rate_deg_s)
        assert rig.mount.axes_moved == {axis: rate_deg_s}
        await asyncio.sleep(0.2)
        east, north = await _moved_deg(rig, 0.5)
        along, across = (east, north) if axis == "primary" else (north, east)
        assert math.copysign(1.0, along) == math.copysign(1.0, rate_deg_s)
        assert 0.4 * abs(rate_deg_s) < abs(along)
        assert abs(across) < 0.01
        await rig.mount.move_axis(axis, 0.0)
        assert not rig.mount.axes_moved
        assert await _rests(rig)
        assert rig.mount.trusted
        assert (await rig.mount.reading()).tracking


async def test_both_axes_at_once_and_each_ends_alone() -> None:
    async with rigged() as rig:
        await rig.mount.move_axis("primary", 1.0)
        await rig.mount.move_axis("secondary", 1.0)
        assert set(rig.mount.axes_moved) == {"primary", "secondary"}
        await rig.mount.move_axis("primary", 0.0)
        assert set(rig.mount.axes_moved) == {"secondary"}
        await asyncio.sleep(0.1)
        east, north = await _moved_deg(rig, 0.3)
        assert abs(east) < 0.01
        assert north > 0.1
        await rig.mount.move_axis("secondary", 0.0)
        assert await _rests(rig)


async def test_a_new_speed_takes_the_place_of_the_old_one() -> None:
    async with rigged() as rig:
        await rig.mount.move_axis("secondary", 1.0)
        await rig.mount.move_axis("secondary", -1.0)
        assert rig.mount.axes_moved == {"secondary": -1.0}
        await asyncio.sleep(0.2)
        assert (await _moved_deg(rig, 0.3))[1] < -0.1


@pytest.mark.parametrize(
    ("axis", "rate_deg_s"),
    [
        ("primary", 2.5),
        ("primary", 0.0009),
        ("secondary", -2.1),
        ("secondary", math.nan),
        ("primary", math.inf),
        ("tertiary", 1.0),
    ],
)
async def test_what_makes_no_sense_is_refused_and_never_goes_out(axis: MountAxis, rate_deg_s: float) -> None:
    async with rigged() as rig:
        with pytest.raises(BadRequest):
            await rig.mount.move_axis(axis, rate_deg_s)
        assert not _sent(rig)


async def test_a_mount_or_an_axis_that_lacks_it() -> None:
    async with rigged() as rig:
        rig.language.axis_rates_deg_s = {"primary": rig.language.axis_rates_deg_s["primary"], "secondary": ()}
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.move_axis("secondary", 1.0)
        assert refusal.value.reason is Refusal.UNSUPPORTED
        rig.language.skills = rig.language.skills - {Skill.MOVE_AXIS}
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.move_axis("primary", 1.0)
        assert refusal.value.reason is Refusal.UNSUPPORTED
        assert not _sent(rig)


async def test_not_while_parked() -> None:
    async with rigged() as rig:
        rig.language.parked = True
        await rig.mount.reading()
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.move_axis("primary", 1.0)
        assert refusal.value.reason is Refusal.PARKED
        assert not _sent(rig)


async def test_nothing_else_begins_while_an_axis_is_moved() -> None:
    async with rigged() as rig:
        place = await rig.beside(1.0, 1.0)
        await rig.mount.move_axis("primary", 0.01)
        for order in (
            rig.mount.slew(place),
            rig.mount.sync(place),
            rig.mount.park(),
            rig.mount.home(),
            rig.mount.guide(Direction.NORTH, 0.1),
            rig.mount.set_tracking(False),
            rig.mount.set_offset_rates(OffsetRates(0.1, 0.1)),
        ):
            with pytest.raises(Busy, match="primary axis is moved by hand"):
                await order
        await rig.mount.move_axis("primary", 0.0)
        assert await rig.mount.slew(place) is SlewOutcome.ARRIVED


async def test_not_while_it_slews_or_is_guided() -> None:
    async with rigged(plain(slew_rate_deg_s=4.0)) as rig:
        slew = asyncio.ensure_future(rig.mount.slew(await rig.beside(6.0, -5.0)))
        await rig.until(lambda: "slew" in rig.language.orders)
        for rate_deg_s in (1.0, 0.0):
            with pytest.raises(Busy):
                await rig.mount.move_axis("primary", rate_deg_s)
        await slew
        pulse = asyncio.ensure_future(rig.mount.guide(Direction.NORTH, 0.4))
        await rig.until(lambda: any(one.startswith("guide") for one in rig.language.orders))
        with pytest.raises(Busy):
            await rig.mount.move_axis("primary", 1.0)
        await pulse
        assert not _sent(rig)


async def test_a_stop_ends_it_at_once() -> None:
    async with rigged() as rig:
        await rig.mount.move_axis("primary", 2.0)
        await rig.mount.move_axis("secondary", 2.0)
        await rig.mount.stop()
        assert not rig.mount.axes_moved
        assert await _rests(rig)
        assert await rig.mount.slew(await rig.beside(1.0, 1.0)) is SlewOutcome.ARRIVED


async def test_a_stop_that_is_not_heeded_leaves_it_moving() -> None:
    async with rigged() as rig:
        await rig.mount.move_axis("primary", 2.0)
        rig.language.stops_needed = 4
        await rig.mount.stop()
        assert not rig.mount.axes_moved
        assert rig.language.orders.count("stop 0") == 1
        assert "stop 4" in rig.language.orders


async def test_closing_ends_it() -> None:
    async with rigged() as rig:
        await rig.mount.move_axis("primary", 2.0)
        await rig.mount.close()
        assert "stop 0" in rig.language.orders
        assert not rig.language.mechanics.slewing()


async def test_a_broken_link_ends_it() -> None:
    async with rigged() as rig:
        await rig.mount.move_axis("primary", 2.0)
        rig.language.lose()
        await rig.until(lambda: rig.heard("link-back"))
        await rig.until(lambda: not rig.language.mechanics.slewing())
        assert not rig.mount.axes_moved
        assert any(one.startswith("stop") for one in rig.language.orders)
        assert not rig.mount.trusted


async def test_an_end_whose_answer_is_lost_becomes_a_stop() -> None:
    async with rigged() as rig:
        await rig.mount.move_axis("primary", 2.0)
        rig.language.axis_lost, rig.language.axis_keeps_on = DeviceSilent("nothing"), True
        await rig.mount.move_axis("primary", 0.0)
        assert "stop 0" in rig.language.orders
        assert not rig.mount.axes_moved
        assert await _rests(rig)


async def test_an_end_that_is_refused_becomes_a_stop() -> None:
    async with rigged() as rig:
        await rig.mount.move_axis("primary", 2.0)
        rig.language.denies.add("axis-end")
        rig.language.axis_keeps_on = True
        await rig.mount.move_axis("primary", 0.0)
        assert "stop 0" in rig.language.orders
        assert await _rests(rig)


async def test_a_beginning_whose_answer_is_lost_is_stopped() -> None:
    async with rigged() as rig:
        rig.language.axis_lost = DeviceSilent("nothing")
        with pytest.raises(DeviceSilent):
            await rig.mount.move_axis("primary", 2.0)
        assert not rig.mount.axes_moved
        await rig.until(lambda: not rig.language.mechanics.slewing())
        assert "stop 0" in rig.language.orders


async def test_refused_and_moving_is_stopped() -> None:
    async with rigged() as rig:
        rig.language.denies.add("axis")
        with pytest.raises(RefusedButDone):
            await rig.mount.move_axis("primary", 2.0)
        assert not rig.mount.axes_moved
        assert not rig.language.mechanics.slewing()


async def test_a_cancelled_beginning_is_stopped() -> None:
    async with rigged() as rig:
        gate = asyncio.Event()
        send = rig.language.send_move_axis

        async def slow(axis: MountAxis, rate_deg_s: float, wanted: object) -> object:
            sent = await send(axis, rate_deg_s, wanted)  # type: ignore[arg-type]
            await gate.wait()
            return sent

        rig.language.send_move_axis = slow  # type: ignore[method-assign, assignment]
        order = asyncio.ensure_future(rig.mount.move_axis("primary", 2.0))
        await rig.until(lambda: _sent(rig))
        order.cancel()
        with pytest.raises(asyncio.CancelledError):
            await order
        assert not rig.mount.axes_moved
        await rig.until(lambda: not rig.language.mechanics.slewing())


async def test_an_end_overtakes_a_beginning_that_waits() -> None:
    async with rigged() as rig:
        async with rig.mount._session.ordering:
            begin = asyncio.ensure_future(rig.mount.move_axis("primary", 2.0))
            await asyncio.sleep(0.05)
            end = asyncio.ensure_future(rig.mount.move_axis("primary", 0.0))
            await asyncio.sleep(0.05)
        with pytest.raises(DeviceRefused, match="newer order"):
            await begin
        await end
        assert _sent(rig) == ["axis primary 0"]
        assert not rig.mount.axes_moved


async def test_a_stop_overtakes_a_beginning_that_waits() -> None:
    async with rigged() as rig:
        async with rig.mount._session.ordering:
            begin = asyncio.ensure_future(rig.mount.move_axis("primary", 2.0))
            await asyncio.sleep(0.05)
            await rig.mount.stop()
        with pytest.raises(MountnavError):
            await begin
        assert not _sent(rig)
        assert not rig.mount.axes_moved


async def test_offset_rates_go_on_after_it() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(OffsetRates(0.0, 60.0))
        await rig.mount.move_axis("primary", 0.5)
        await asyncio.sleep(0.2)
        await rig.mount.move_axis("primary", 0.0)
        before = await rig.mount.reading()
        await asyncio.sleep(0.5)
        after = await rig.mount.reading()
        took_s = (after.utc - before.utc).total_seconds()
        assert 3600.0 * (after.place.dec_deg - before.place.dec_deg) / took_s == pytest.approx(60.0, abs=4.0)
        assert rig.mount.trusted
