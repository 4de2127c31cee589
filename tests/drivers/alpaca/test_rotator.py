"""An Alpaca rotator against a small server of the tests' own, written from the published interface."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from drivers.generic.rotator import GenericRotator
from drivers.registry import open_rotator
from mountnav.errors import (
    BadSettings,
    Cancelled,
    DeviceError,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
    NotReached,
    RefusedButDone,
    TargetNotReached,
)
from tests.drivers.alpaca.alpaca_server import (
    NOT_IMPLEMENTED,
    AlpacaError,
    AlpacaServer,
    FakeDevice,
    Fault,
)

INVALID_VALUE = 0x401


class FakeRotator(FakeDevice):
    """An IRotatorV2 to V4: Position is the mechanism's angle and what a sync has added to it."""

    kind = "rotator"

    def __init__(self, version: int = 4, *, rate_deg_s: float = 60.0, step_deg: float | None = 0.01) -> None:
        super().__init__(version)
        self.rate_deg_s, self.step_deg = rate_deg_s, step_deg
        self.synced_deg = 40.0
        self.reverse = False
        self.stuck = False
        self._lock = threading.Lock()
        self._at_deg, self._wanted_deg, self._at_s = 10.0, 10.0, time.monotonic()

    def _mechanical(self) -> float:
        with self._lock:
            now_s = time.monotonic()
            way = self._wanted_deg - self._at_deg
            step = math.copysign(min(abs(way), self.rate_deg_s * (now_s - self._at_s)), way)
            if not self.stuck:
                self._at_deg += step
            self._at_s = now_s
            return self._at_deg % 360.0

    def _go(self, deg: float) -> None:
        if not 0.0 <= deg < 360.0:
            raise AlpacaError(INVALID_VALUE, f"{deg} is not in 0 to 360")
        self._mechanical()
        self._wanted_deg = deg

    def get_mechanicalposition(self, _: dict[str, str]) -> float:
        if self.version < 3:
            raise NOT_IMPLEMENTED
        return self._mechanical()

    def get_position(self, _: dict[str, str]) -> float:
        return (self._mechanical() + self.synced_deg) % 360.0

    def get_ismoving(self, _: dict[str, str]) -> bool:
        self._mechanical()
        return self._at_deg != self._wanted_deg and not self.stuck

    def get_stepsize(self, _: dict[str, str]) -> float:
        if self.step_deg is None:
            raise NOT_IMPLEMENTED
        return self.step_deg

    def get_reverse(self, _: dict[str, str]) -> bool:
        return self.reverse

    def put_movemechanical(self, form: dict[str, str]) -> None:
        if self.version < 3:
            raise NOT_IMPLEMENTED
        self._go(self.need(form, "Position", float))

    def put_moveabsolute(self, form: dict[str, str]) -> None:
        self._go((self.need(form, "Position", float) - self.synced_deg) % 360.0)

    def put_halt(self, _: dict[str, str]) -> None:
        self._mechanical()
        self._wanted_deg = self._at_deg


class Bench:
    def __init__(self, rotator: GenericRotator, server: AlpacaServer, fake: FakeRotator) -> None:
        self.rotator, self.server, self.fake = rotator, server, fake

    def fault(self, member: str, what: str, **details: Any) -> None:
        self.server.faults.append(Fault(member, what, **details))

    def asked(self, verb: str = "put") -> list[str]:
        return [member for one, member, _ in self.server.asked if one == verb]


@asynccontextmanager
async def bench(fake: FakeRotator | None = None, options: str = "") -> AsyncIterator[Bench]:
    fake = fake or FakeRotator()
    server = AlpacaServer({"rotator/0": fake}).start()
    rotator = open_rotator(f"alpaca+http://127.0.0.1:{server.port}/rotator/0{options}")
    assert isinstance(rotator, GenericRotator)
    try:
        await rotator.open()
        yield Bench(rotator, server, fake)
    finally:
        await rotator.close()
        server.stop()


@pytest.mark.parametrize("version", [3, 4])
async def test_it_is_turned_by_its_mechanism_s_angle_whatever_was_synced(version: int) -> None:
    async with bench(FakeRotator(version)) as one:
        assert (await one.rotator.reading()).mechanical_deg == pytest.approx(10.0)
        came = await one.rotator.turn(75.0)
        assert came.mechanical_deg == pytest.approx(75.0, abs=0.05)
        assert one.fake.get_mechanicalposition({}) == pytest.approx(75.0, abs=0.05)
        moved = {member for member in one.asked() if member not in ("connect", "connected")}
        assert moved == {"movemechanical"}


async def test_an_old_one_is_turned_by_its_position() -> None:
    async with bench(FakeRotator(2)) as one:
        assert (await one.rotator.reading()).mechanical_deg == pytest.approx(50.0)
        assert (await one.rotator.turn(75.0)).mechanical_deg == pytest.approx(75.0, abs=0.05)
        assert one.fake.get_position({}) == pytest.approx(75.0, abs=0.05)
        assert "moveabsolute" in one.asked()


async def test_one_that_tells_no_step_and_no_reverse_is_turned_too() -> None:
    fake = FakeRotator(step_deg=None)
    fake.missing.add("reverse")
    async with bench(fake) as one:
        await one.rotator.turn(30.0)
        assert one.rotator.reversed is None
        assert one.rotator.step_deg == 0.01


async def test_a_reversed_one_is_told() -> None:
    async with bench() as one:
        await one.rotator.reading()
        assert one.rotator.reversed is False
        one.fake.reverse = True
        await one.rotator.reading()
        assert one.rotator.reversed is True


async def test_halt_ends_a_turn() -> None:
    async with bench(FakeRotator(rate_deg_s=5.0)) as one:
        turning = asyncio.ensure_future(one.rotator.turn(200.0))
        async with asyncio.timeout(30.0):
            while "movemechanical" not in one.asked():
                await asyncio.sleep(0.01)
        await one.rotator.stop()
        with pytest.raises(Cancelled):
            await turning
        assert "halt" in one.asked()
        assert not one.fake.get_ismoving({})


async def test_one_that_can_t_be_halted_says_so() -> None:
    fake = FakeRotator()
    fake.missing.add("halt")
    async with bench(fake) as one:
        with pytest.raises(DeviceRefused, match="no way to stop it"):
            await one.rotator.stop()


async def test_one_that_takes_the_order_and_stays_is_named() -> None:
    async with bench() as one:
        one.fake.stuck = True
        with pytest.raises(TargetNotReached) as told:
            await one.rotator.turn(100.0)
        assert told.value.reason is NotReached.STUCK


async def test_its_refusal_is_told_in_its_words() -> None:
    async with bench() as one:
        one.fault("movemechanical", "error", number=0x40B, body="The cable guard is on")
        with pytest.raises(DeviceRefused, match="cable guard"):
            await one.rotator.turn(100.0)
        assert one.fake.get_mechanicalposition({}) == pytest.approx(10.0)


async def test_an_order_without_an_answer_leaves_it_stopped() -> None:
    async with bench(FakeRotator(rate_deg_s=3.0), "?timeout_s=1") as one:
        one.fault("movemechanical", "deaf", seconds=3.0)
        with pytest.raises(DeviceSilent):
            await one.rotator.turn(100.0)
        assert "halt" in one.asked()


async def test_what_is_no_rotator_is_refused() -> None:
    fake = FakeRotator()
    fake.missing |= {"mechanicalposition", "position"}
    with pytest.raises(DeviceRefused, match="doesn't give its angle"):
        async with bench(fake):
            pass
    with pytest.raises(BadSettings, match="no rotator"):
        open_rotator("alpaca+http://host/camera/0")
    server = AlpacaServer({}).start()
    try:
        with pytest.raises(DeviceMissing):
            await open_rotator(f"alpaca+http://127.0.0.1:{server.port}/rotator/0").open()
    finally:
        server.stop()


async def test_one_that_refuses_and_turns_is_stopped() -> None:
    async with bench(FakeRotator(rate_deg_s=10.0)) as one:
        one.fault("movemechanical", "denied", number=0x40B, body="The cable guard is on")
        with pytest.raises(RefusedButDone, match=r"said refused .* cable guard is on.*, but it turned"):
            await one.rotator.turn(170.0)
        assert not one.fake.get_ismoving({})
        assert one.fake.get_mechanicalposition({}) < 60.0


@pytest.mark.parametrize("what", ["refuse-connection", "html", "half"])
async def test_answers_that_are_lost_in_a_turn_leave_it_stopped(what: str) -> None:
    async with bench(FakeRotator(rate_deg_s=5.0), "?timeout_s=1") as one:
        turning = asyncio.ensure_future(one.rotator.turn(170.0))
        async with asyncio.timeout(30.0):
            while one.asked().count("movemechanical") == 0:
                await asyncio.sleep(0.01)
        one.fault("mechanicalposition", what, times=3)
        with pytest.raises(DeviceError, match="it was stopped at"):
            await turning
        assert not one.fake.get_ismoving({})
        assert one.fake.get_mechanicalposition({}) < 160.0
