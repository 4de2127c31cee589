"""A line to far away: a question is asked again when its answer is lost, and not when it is only late."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest

from drivers.wire.command import Command, Read
from drivers.wire.exchange import Exchange, Patience
from mountnav.errors import DeviceSilent

PATIENCE = Patience(deadline_s=3.0, try_s=0.8, quiet_s=0.05)


class FarLine:
    """Each question is answered so many seconds later, by a clock of its own; None: never."""

    address, usable = "a far line", True

    def __init__(self, answered_after_s: Sequence[float | None]) -> None:
        self.now_s = 0.0
        self.asked = 0
        self._after_s = list(answered_after_s)
        self._due_s: list[float] = []

    def time(self) -> float:
        return self.now_s

    async def write(self, data: bytes) -> None:
        after_s = self._after_s[self.asked]
        self.asked += 1
        if after_s is not None:
            self._due_s.append(self.now_s + after_s)

    async def read(self, timeout_s: float) -> bytes:
        until_s = self.now_s + timeout_s
        if self._due_s and self._due_s[0] <= until_s:
            self.now_s = max(self.now_s, self._due_s.pop(0))
            return b"1#"
        self.now_s = until_s
        return b""

    def drain(self) -> bytes:
        return b""


def _until_hash(heard: bytes, over: bool) -> Read[bytes] | None:
    end = heard.find(b"#")
    return None if end < 0 else Read(heard[:end], end + 1)


PLACE = Command(b":GR#", "the place", _until_hash)
SLEW = Command(b":MS#", "a slew", _until_hash, repeatable=False)


def exchange_on(line: FarLine, monkeypatch: pytest.MonkeyPatch) -> Exchange:
    monkeypatch.setattr(asyncio.get_running_loop(), "time", line.time)
    return Exchange(line, PATIENCE)  # type: ignore[arg-type]


async def test_an_answer_that_is_only_late_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    line = FarLine([0.5, 0.5, 1.2, 0.5])
    exchange = exchange_on(line, monkeypatch)
    for _ in range(4):
        assert await exchange.ask(PLACE) == b"1"
    assert (line.asked, exchange.troubles) == (4, 0)


async def test_a_lost_answer_on_a_far_line_is_asked_for_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line = FarLine([0.7, 0.7, None, 0.7, *[None] * 9])
    exchange = exchange_on(line, monkeypatch)
    for _ in range(3):
        assert await exchange.ask(PLACE) == b"1"
    assert line.asked == 4
    with pytest.raises(DeviceSilent):
        await exchange.ask(PLACE)
    assert line.asked >= 6


async def test_a_near_line_asks_again_as_soon_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    # how long a mount takes for an order tells nothing of the line
    line = FarLine([0.01, 0.7, None, 0.01])
    exchange = exchange_on(line, monkeypatch)
    await exchange.ask(PLACE)
    await exchange.ask(SLEW)
    before_s = line.now_s
    await exchange.ask(PLACE)
    assert line.now_s - before_s < 1.0
