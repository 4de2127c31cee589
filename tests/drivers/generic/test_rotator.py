"""A whole rotator over simulated mechanics, in virtual time: turns, stops, and each known way to go wrong."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, TypeVar

import pytest

from drivers.generic.rotator import GenericRotator, RotatorTiming, Told
from drivers.simulated.rotator import SimulatedRotatorLanguage
from mountnav.errors import (
    BadRequest,
    Busy,
    Cancelled,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
    NotReached,
    RefusedButDone,
    TargetNotReached,
)
from mountnav.simulation.rotator_mechanics import RotatorBehavior, RotatorMechanics
from mountnav.simulation.virtual_time import VirtualClock, run_virtually

Result = TypeVar("Result")


@dataclass
class Rig:
    rotator: GenericRotator
    language: SimulatedRotatorLanguage
    mechanics: RotatorMechanics
    clock: VirtualClock


def with_rotator(
    work: Callable[[Rig], Coroutine[Any, Any, Result]],
    behavior: RotatorBehavior | None = None,
    *,
    starts_deg: float = 10.0,
    language: Callable[[RotatorMechanics], SimulatedRotatorLanguage] = SimulatedRotatorLanguage,
) -> Result:
    clock = VirtualClock(datetime(2026, 11, 21, 20, 0, tzinfo=UTC))

    async def run() -> Result:
        mechanics = RotatorMechanics(clock, behavior, starts_deg=starts_deg)
        spoken = language(mechanics)
        rotator = GenericRotator(spoken, timing=RotatorTiming(), clock=clock)
        await rotator.open()
        try:
            return await work(Rig(rotator, spoken, mechanics, clock))
        finally:
            await rotator.close()

    return run_virtually(run(), clock)


@pytest.mark.parametrize("wanted_deg", [100.0, 350.0, 370.0, -10.0, 10.0, 10.5])
def test_it_turns_and_rests_there(wanted_deg: float) -> None:
    async def work(rig: Rig) -> None:
        assert rig.mechanics.orders == []
        came = await rig.rotator.turn(wanted_deg)
        assert came.mechanical_deg == pytest.approx(wanted_deg % 360.0, abs=0.05)
        assert came.moving is False
        assert rig.mechanics.count_deg == pytest.approx(wanted_deg % 360.0, abs=0.05)
        # only what is an angle to every driver is sent
        assert all(0.0 <= one < 360.0 for one in rig.mechanics.orders)

    with_rotator(work)


def test_where_it_stands_already_nothing_is_sent() -> None:
    async def work(rig: Rig) -> None:
        await rig.rotator.turn(10.01)
        assert rig.mechanics.orders == []

    with_rotator(work)


def test_a_coarse_one_rests_within_its_steps() -> None:
    async def work(rig: Rig) -> None:
        assert (await rig.rotator.turn(101.3)).mechanical_deg == 102.0

    with_rotator(work, RotatorBehavior(step_deg=2.0))


def test_one_that_says_yes_and_does_not_move_is_named() -> None:
    async def work(rig: Rig) -> None:
        with pytest.raises(TargetNotReached, match="says that it is done, and did not move") as told:
            await rig.rotator.turn(50.0)
        assert told.value.reason is NotReached.STUCK

    with_rotator(work, RotatorBehavior(ignores=True))


class Idle(SimulatedRotatorLanguage):
    """Says that it rests, whatever it does."""

    async def read(self) -> Told:
        return Told(self.mechanics.count_deg, False)


class Mute(SimulatedRotatorLanguage):
    """Doesn't say whether it moves."""

    async def read(self) -> Told:
        return Told(self.mechanics.count_deg, None)


@pytest.mark.parametrize("language", [Idle, Mute])
def test_whether_it_moves_is_seen_not_believed(language: Any) -> None:
    async def work(rig: Rig) -> None:
        assert (await rig.rotator.turn(60.0)).mechanical_deg == pytest.approx(60.0, abs=0.05)
        assert not rig.mechanics.moving

    with_rotator(work, language=language)


def test_one_that_is_blocked_is_stopped() -> None:
    async def work(rig: Rig) -> None:
        began_s = rig.clock.monotonic_s()
        with pytest.raises(TargetNotReached, match=r"has stood at 30.00° for too long") as told:
            await rig.rotator.turn(60.0)
        assert told.value.reason is NotReached.TIME
        assert rig.clock.monotonic_s() - began_s < 40.0
        # it doesn't try on
        assert not rig.mechanics.moving

    with_rotator(work, RotatorBehavior(stalls_at_deg=30.0))


def test_one_that_rests_elsewhere_is_told_with_both_angles() -> None:
    async def work(rig: Rig) -> None:
        async def hand() -> None:
            await rig.clock.sleep(5.0)
            rig.mechanics.stop()

        touching = asyncio.ensure_future(hand())
        with pytest.raises(TargetNotReached, match=r"stopped at .* from 10.00° to 100.00°") as told:
            await rig.rotator.turn(100.0)
        assert told.value.reason is NotReached.REST
        await touching

    with_rotator(work)


def test_a_stop_ends_a_turn_and_is_seen() -> None:
    async def work(rig: Rig) -> None:
        turning = asyncio.ensure_future(rig.rotator.turn(170.0))
        await rig.clock.sleep(10.0)
        with pytest.raises(Busy):
            await rig.rotator.turn(20.0)
        await rig.rotator.stop()
        stood = rig.mechanics.count_deg
        assert 25.0 < stood < 60.0
        with pytest.raises(Cancelled):
            await turning
        await rig.clock.sleep(5.0)
        assert rig.mechanics.count_deg == stood
        # and after it another turn may begin
        await rig.rotator.turn(20.0)

    with_rotator(work)


def test_who_is_cancelled_leaves_it_stopped() -> None:
    async def work(rig: Rig) -> None:
        turning = asyncio.ensure_future(rig.rotator.turn(170.0))
        await rig.clock.sleep(10.0)
        turning.cancel()
        with pytest.raises(asyncio.CancelledError):
            await turning
        assert not rig.mechanics.moving

    with_rotator(work)


def test_one_that_turns_on_after_its_stop_is_told() -> None:
    async def work(rig: Rig) -> None:
        turning = asyncio.ensure_future(rig.rotator.turn(170.0))
        await rig.clock.sleep(5.0)
        with pytest.raises(DeviceSilent, match="still turns"):
            await rig.rotator.stop()
        with pytest.raises(Cancelled):
            await turning

    with_rotator(work, RotatorBehavior(deaf_to_stop=True))


@pytest.mark.parametrize("wrong", [float("nan"), float("inf")])
def test_what_is_no_angle_is_not_sent(wrong: float) -> None:
    async def work(rig: Rig) -> None:
        with pytest.raises(BadRequest):
            await rig.rotator.turn(wrong)
        assert rig.mechanics.orders == []

    with_rotator(work)


def test_a_reading_that_is_no_angle_is_refused() -> None:
    class Nonsense(SimulatedRotatorLanguage):
        async def read(self) -> Told:
            return Told(1e9, False)

    async def work(rig: Rig) -> None:
        with pytest.raises(DeviceSilent, match="reports an angle of"):
            await rig.rotator.reading()

    with_rotator(work, language=Nonsense)


def test_a_lost_connection_is_opened_again_and_a_closed_one_is_not() -> None:
    async def work(rig: Rig) -> None:
        rig.language.usable = False
        assert (await rig.rotator.reading()).mechanical_deg == 10.0
        await rig.rotator.close()
        with pytest.raises(DeviceMissing):
            await rig.rotator.reading()

    with_rotator(work)


class Denies(SimulatedRotatorLanguage):
    """Says no to each turn; and turns, unless its mechanics ignore that."""

    async def order(self, mechanical_deg: float) -> None:
        await super().order(mechanical_deg)
        raise DeviceRefused("the turn: busy", device=self.name)


def test_one_that_says_no_and_turns_is_stopped_and_told() -> None:
    async def work(rig: Rig) -> None:
        with pytest.raises(
            RefusedButDone, match=r"said refused \(the turn: busy\), but it turned from 10.0°"
        ):
            await rig.rotator.turn(170.0)
        assert not rig.mechanics.moving
        assert rig.mechanics.count_deg < 20.0

    with_rotator(work, language=Denies)


def test_one_that_says_no_and_stays_has_refused() -> None:
    async def work(rig: Rig) -> None:
        with pytest.raises(DeviceRefused, match="the turn: busy"):
            await rig.rotator.turn(170.0)

    with_rotator(work, RotatorBehavior(ignores=True), language=Denies)


class Cut(SimulatedRotatorLanguage):
    """Its connection is lost 3 s after each turn's order, and comes again when it may."""

    lost_for_s = 5.0
    lost_at_s: float | None = None
    clock: VirtualClock | None = None

    async def order(self, mechanical_deg: float) -> None:
        await super().order(mechanical_deg)
        assert self.clock is not None
        self.lost_at_s = self.clock.monotonic_s() + 3.0

    def there(self) -> bool:
        if self.lost_at_s is None or self.clock is None:
            return True
        away_s = self.clock.monotonic_s() - self.lost_at_s
        self.usable = self.usable and away_s < 0.0
        return not 0.0 <= away_s < self.lost_for_s

    async def open(self) -> None:
        if not self.there():
            raise DeviceMissing("no such server", device=self.name)
        self.lost_at_s = None
        await super().open()

    async def read(self) -> Told:
        if not self.there() or not self.usable:
            raise DeviceMissing("the connection was lost", device=self.name)
        return await super().read()

    async def send_stop(self) -> None:
        if not self.there() or not self.usable:
            raise DeviceMissing("not connected", device=self.name)
        await super().send_stop()


def test_one_whose_link_is_lost_in_a_turn_is_stopped_as_soon_as_it_is_back() -> None:
    async def work(rig: Rig) -> None:
        assert isinstance(rig.language, Cut)
        rig.language.clock = rig.clock
        with pytest.raises(DeviceMissing, match="it was stopped at"):
            await rig.rotator.turn(170.0)
        assert not rig.mechanics.moving
        assert rig.mechanics.count_deg < 50.0
        assert rig.rotator.links == 2

    with_rotator(work, language=Cut)


def test_one_whose_link_stays_away_is_said_to_turn_on() -> None:
    async def work(rig: Rig) -> None:
        assert isinstance(rig.language, Cut)
        rig.language.clock, rig.language.lost_for_s = rig.clock, 1e6
        with pytest.raises(DeviceMissing, match="it may be turning on"):
            await rig.rotator.turn(170.0)
        assert rig.mechanics.moving

    with_rotator(work, language=Cut)


@pytest.mark.parametrize("kind", [DeviceGarbled, DeviceSilent])
def test_one_that_is_not_understood_in_a_turn_is_stopped(kind: type[DeviceError]) -> None:
    class Strange(SimulatedRotatorLanguage):
        async def read(self) -> Told:
            if self.mechanics.orders and self.mechanics.moving:
                raise kind("an answer that is none", device=self.name)
            return await super().read()

    async def work(rig: Rig) -> None:
        with pytest.raises(kind, match="it was stopped at"):
            await rig.rotator.turn(170.0)
        assert not rig.mechanics.moving

    with_rotator(work, language=Strange)


def test_one_that_sets_out_when_it_was_given_up_is_stopped() -> None:
    class Late(SimulatedRotatorLanguage):
        ordered: list[float] = []  # noqa: RUF012 - of one test

        async def order(self, mechanical_deg: float) -> None:
            self.ordered.append(mechanical_deg)

        async def send_stop(self) -> None:
            self.ordered.clear()
            await super().send_stop()

    async def work(rig: Rig) -> None:
        with pytest.raises(TargetNotReached, match="did not move"):
            await rig.rotator.turn(170.0)
        assert Late.ordered == []

    with_rotator(work, language=Late)
