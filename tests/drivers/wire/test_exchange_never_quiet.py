"""A line that is never quiet: what is asked ends with the reason, and nothing grows."""

from __future__ import annotations

import asyncio

import pytest

from drivers.wire.command import Command, Read
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import Incoming
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceGarbled


class Endless:
    """A line on which there is always more, once something was asked."""

    address, usable = "a line", True

    def __init__(self, answer: bytes) -> None:
        self._answer, self._next = answer, b""

    async def write(self, data: bytes) -> None:
        self._next = self._answer

    write_now = write

    async def read(self, timeout_s: float) -> bytes:
        await asyncio.sleep(0)
        came = self._next
        if came:
            self._next = b"x" * 1000
        return came

    def drain(self) -> bytes:
        return b""


def _until_hash(heard: bytes, over: bool) -> Read[bytes] | None:
    end = heard.find(b"#")
    return None if end < 0 else Read(heard[:end], end + 1)


@pytest.mark.parametrize(("answer", "owed"), [(b"x", False), (b"1#", True)], ids=["no end", "owed"])
async def test_an_answer_without_end_is_garbled(answer: bytes, owed: bool) -> None:
    line = Endless(answer)
    exchange = Exchange(line, Patience(try_s=60.0, quiet_s=0.01))  # type: ignore[arg-type]
    exchange._owing = owed
    command = Command(b":GR#", "the place", _until_hash, repeatable=False)
    async with asyncio.timeout(30):
        with pytest.raises(DeviceGarbled, match="and no end") as told:
            await exchange.ask(command, deadline_s=20.0)
    assert len(str(told.value)) < 500


def test_of_what_nobody_reads_the_latest_is_kept() -> None:
    incoming = Incoming("a line", lambda: "look", WireLog(kept=1))
    incoming.opened()
    for number in range(1000):
        incoming.arrived(b"%04d" % number * 100)
    came = incoming.drain()
    assert len(came) == 1 << 16
    assert came.endswith(b"0999")
