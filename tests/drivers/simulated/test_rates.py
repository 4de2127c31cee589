"""Offset rates and moved axes of the mount without a wire, with the faults of its mechanics."""

from __future__ import annotations

import asyncio
import math

import pytest

from drivers.simulated.behavior import MountBehavior
from drivers.simulated.mount import SimulatedMount
from mountnav.devices import (
    STARS_RATES,
    Direction,
    MountAxis,
    MovesAxes,
    OffsetRates,
    Skill,
    SlewOutcome,
    SyncOutcome,
    TakesOffsetRates,
)
from mountnav.errors import BadRequest, Busy, DeviceMissing, DeviceRefused, Refusal, RefusedButDone
from mountnav.simulation.rate_faults import RateFault
from mountnav.simulation.virtual_time import VirtualClock
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import half_turn_deg
from tests.drivers.simulated.test_mount import lived, up

COMET = OffsetRates(0.05, -0.02)
PASS = OffsetRates(900.0, -1500.0)


async def _measured(mount: SimulatedMount, clock: VirtualClock, seconds: float) -> tuple[float, float]:
    before = await mount.reading()
    await clock.sleep(seconds)
    after = await mount.reading()
    took_s = (after.utc - before.utc).total_seconds()
    turned_deg = half_turn_deg(after.place.ra_deg - before.place.ra_deg)
    return 3600.0 * turned_deg / took_s, 3600.0 * (after.place.dec_deg - before.place.dec_deg) / took_s


@pytest.mark.parametrize(("rates", "seconds"), [(COMET, 1000.0), (PASS, 4.0)])
@pytest.mark.parametrize("ha_deg", [-40.0, 30.0])
def test_it_follows_on_either_side_of_the_pier(rates: OffsetRates, seconds: float, ha_deg: float) -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        assert isinstance(mount, TakesOffsetRates)
        assert await mount.slew(up(clock, ha_deg, 40.0)) is SlewOutcome.ARRIVED
        await mount.set_offset_rates(rates)
        await clock.sleep(2.0)
        assert await _measured(mount, clock, seconds) == pytest.approx(
            (rates.ra_arcsec_s, rates.dec_arcsec_s), rel=1e-3
        )
        assert mount.rates_known == rates
        await mount.set_offset_rates(STARS_RATES)
        await clock.sleep(2.0)
        assert await _measured(mount, clock, seconds) == pytest.approx((0.0, 0.0), abs=1e-3)

    assert lived(life).received.count("rates") == 2


@pytest.mark.parametrize(
    "fault", [RateFault(ra_factor=-1.0), RateFault(dec_factor=15.04), RateFault(swapped=True)]
)
def test_a_fault_moves_it_otherwise_and_shows_in_no_answer(fault: RateFault) -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        await mount.slew(up(clock, -30.0, 30.0))
        mount.mechanics.fail_rates(fault)
        await mount.set_offset_rates(OffsetRates(1.0, 0.5))
        await clock.sleep(2.0)
        kept = fault.kept((1.0, 0.5))
        assert await _measured(mount, clock, 100.0) == pytest.approx(kept, abs=0.01)
        told = await mount.offset_rates()
        assert told is not None
        assert (told.ra_arcsec_s, told.dec_arcsec_s) == pytest.approx((1.0, 0.5))

    lived(life)


def test_rates_that_read_as_none_are_refused() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        mount.mechanics.fail_rates(RateFault(ra_factor=0.0, dec_factor=0.0, reads_zero=True))
        with pytest.raises(DeviceRefused, match="says that it has"):
            await mount.set_offset_rates(COMET)
        assert mount.rates_known == STARS_RATES

    lived(life)


@pytest.mark.parametrize("order", ["slew", "stop", "park", "home", "track", "rest", "lost", "close"])
def test_they_end_with(order: str) -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        await mount.slew(up(clock, -30.0, 30.0))
        await mount.set_offset_rates(OffsetRates(5.0, 5.0))
        if order == "slew":
            await mount.slew(up(clock, -20.0, 30.0))
        elif order == "stop":
            await mount.stop()
        elif order == "park":
            await mount.park()
        elif order == "home":
            await mount.home()
        elif order == "lost":
            mount.cut(10.0)
            await clock.sleep(1.0)
            assert mount.rates_known is None
            await clock.sleep(20.0)
        elif order == "close":
            await mount.close()
        else:
            await mount.set_tracking(order == "track")
        assert mount.rates_known == STARS_RATES
        assert mount.mechanics.beside_arcsec_s == (0.0, 0.0)

    lived(life)


def test_a_restart_forgets_them() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        await mount.set_offset_rates(OffsetRates(5.0, 5.0))
        mount.reboot()
        assert mount.rates_known is None
        await clock.sleep(20.0)
        assert mount.mechanics.beside_arcsec_s == (0.0, 0.0)

    lived(life)


def test_what_makes_no_sense_or_is_too_fast() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        with pytest.raises(BadRequest):
            await mount.set_offset_rates(OffsetRates(math.nan, 0.0))
        with pytest.raises(DeviceRefused, match=r"at most 100\.0000″/s") as refusal:
            await mount.set_offset_rates(OffsetRates(0.0, 101.0))
        assert refusal.value.reason is Refusal.LIMIT
        await mount.park()
        for order in (mount.set_offset_rates(COMET), mount.move_axis("primary", 1.0)):
            with pytest.raises(DeviceRefused) as refusal:
                await order
            assert refusal.value.reason is Refusal.PARKED

    assert "rates" not in lived(life, MountBehavior(most_rate_arcsec_s=100.0)).received


def test_one_that_lacks_both() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        assert not {Skill.OFFSET_RATES, Skill.MOVE_AXIS} & mount.skills
        assert mount.axis_rates_deg_s == {}
        assert await mount.offset_rates() is None
        for order in (mount.set_offset_rates(COMET), mount.move_axis("primary", 1.0)):
            with pytest.raises(DeviceRefused) as refusal:
                await order
            assert refusal.value.reason is Refusal.UNSUPPORTED

    lived(life, MountBehavior(takes_rates=False, moves_axes=False))


def test_refused_and_done_is_ended() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        mount.denies |= {"rates", "axis"}
        with pytest.raises(RefusedButDone):
            await mount.set_offset_rates(COMET)
        assert mount.mechanics.beside_arcsec_s == (0.0, 0.0)
        with pytest.raises(RefusedButDone):
            await mount.move_axis("primary", 1.0)
        assert not mount.mechanics.slewing()
        assert not mount.axes_moved

    lived(life)


def test_a_sync_at_rates_is_seen() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        await mount.slew(up(clock, -30.0, 30.0))
        await mount.set_offset_rates(OffsetRates(0.0, 200.0))
        place = (await mount.reading()).place
        assert isinstance(place, Apparent)
        result = await mount.sync(Apparent(place.ra_deg, place.dec_deg + 0.05, place.utc))
        assert result.outcome is SyncOutcome.SEEN

    lived(life)


@pytest.mark.parametrize(("axis", "rate_deg_s"), [("primary", 1.0), ("primary", -2.0), ("secondary", 1.5)])
@pytest.mark.parametrize("ha_deg", [-40.0, 30.0])
def test_an_axis_moves_until_it_is_told_to_end(axis: MountAxis, rate_deg_s: float, ha_deg: float) -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        assert isinstance(mount, MovesAxes)
        await mount.slew(up(clock, ha_deg, 30.0))
        await mount.move_axis(axis, rate_deg_s)
        assert mount.axes_moved == {axis: rate_deg_s}
        for order in (
            mount.slew(up(clock, 0.0, 30.0)),
            mount.sync(up(clock, 0.0, 30.0)),
            mount.guide(Direction.NORTH, 1.0),
            mount.set_offset_rates(COMET),
            mount.set_tracking(False),
        ):
            with pytest.raises(Busy):
                await order
        await clock.sleep(2.0)
        along = (await _measured(mount, clock, 2.0))[0 if axis == "primary" else 1]
        assert along == pytest.approx(3600.0 * rate_deg_s, rel=0.02)
        await mount.move_axis(axis, 0.0)
        assert not mount.axes_moved
        assert await _measured(mount, clock, 2.0) == pytest.approx((0.0, 0.0), abs=1e-3)
        with pytest.raises(BadRequest):
            await mount.move_axis(axis, 99.0)
        with pytest.raises(BadRequest):
            await mount.move_axis(axis, math.nan)
        with pytest.raises(BadRequest):
            await mount.move_axis("third", 1.0)  # type: ignore[arg-type]

    lived(life)


@pytest.mark.parametrize("how", ["stop", "close", "lost"])
def test_a_moved_axis_ends_with(how: str) -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        await mount.slew(up(clock, -30.0, 30.0))
        await mount.move_axis("primary", 1.0)
        if how == "stop":
            await mount.stop()
        elif how == "close":
            await mount.close()
            await clock.sleep(5.0)
        else:
            mount.cut(1.0)
            await clock.sleep(10.0)
            with pytest.raises(DeviceMissing):
                mount.cable.require(0)
        assert not mount.axes_moved
        assert not mount.mechanics.slewing()

    lived(life)


def test_not_while_it_slews() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        slew = asyncio.ensure_future(mount.slew(up(clock, -60.0, 10.0)))
        await clock.sleep(1.0)
        for order in (mount.move_axis("primary", 1.0), mount.set_offset_rates(COMET)):
            with pytest.raises(Busy):
                await order
        assert await slew is SlewOutcome.ARRIVED

    lived(life)
