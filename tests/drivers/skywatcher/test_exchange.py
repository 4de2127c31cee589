"""Motors on boards whose ramps take a while: "running" they say until they rest."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.skywatcher.axes import Gearing
from drivers.skywatcher.codec import Axis, MotorStatus
from drivers.skywatcher.exchange import Motors
from drivers.wire.command import Command

RATE_DEG_S = 1.0 / 3600.0


class SlowBoard:
    """One motor, which rests at the third question after its stop. A rate set meanwhile changes nothing."""

    device = "slow board"

    def __init__(self) -> None:
        self.running, self.left = False, 0

    async def ask(self, command: Command[Any]) -> Any:
        word = command.sent[1:2]
        if word == b"f":
            self.left -= 1
            if self.left == 0:
                self.running = False
            return MotorStatus(
                goto=False,
                backward=False,
                fast=False,
                running=self.running,
                blocked=False,
                initialized=True,
                level=False,
            )
        if word == b"K" and self.running:
            self.left = 3
        if word == b"J":
            assert not self.running, "started on its ramp"
            self.running, self.left = True, 0
        return None

    async def send_now(self, command: Command[Any]) -> None:
        await self.ask(command)


@pytest.fixture
def board() -> SlowBoard:
    return SlowBoard()


@pytest.fixture
def motors(board: SlowBoard) -> Motors:
    made = Motors(board, 5.0)  # type: ignore[arg-type]
    made.gears = dict.fromkeys(Axis, Gearing(9_024_000, 64_935, 16))
    return made


async def rested(motors: Motors) -> bool:
    return not [await motors.status(Axis.DECLINATION) for _ in range(5)][-1].running


async def test_a_rate_after_a_pulse_is_not_lost_on_the_ramp(board: SlowBoard, motors: Motors) -> None:
    async def begin() -> bool:
        return await motors.run(Axis.DECLINATION, 7.0 * RATE_DEG_S, lambda: True)

    assert await motors.for_a_time(Axis.DECLINATION, begin, 0.01)
    assert await motors.run(Axis.DECLINATION, RATE_DEG_S, lambda: True)
    assert not await rested(motors)


async def test_what_is_ordered_after_a_stop_is_not_lost_on_the_ramp(board: SlowBoard, motors: Motors) -> None:
    assert await motors.run(Axis.DECLINATION, RATE_DEG_S, lambda: True)
    await motors.send_stop()
    assert await motors.run(Axis.DECLINATION, RATE_DEG_S, lambda: True)
    assert not await rested(motors)


async def test_one_that_runs_on_only_changes_its_rate(board: SlowBoard, motors: Motors) -> None:
    assert await motors.run(Axis.DECLINATION, RATE_DEG_S, lambda: True)
    starts = motors.starts
    assert await motors.run(Axis.DECLINATION, 2.0 * RATE_DEG_S, lambda: True)
    assert motors.starts == starts
    await motors.send_stop()
    assert await rested(motors)
