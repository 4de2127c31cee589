"""A recorded wire under the real driver: each question gets what was answered at that time of the night."""

from __future__ import annotations

import asyncio
from bisect import bisect_right
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from drivers.driven.mount import DrivenMount
from drivers.over_link import OverLink
from drivers.registry import open_mount
from mountnav.errors import DeviceError
from mountnav.navigation.devices import MountReading
from mountnav.night.recorded import Line, Recording
from mountnav.simulation.virtual_time import VirtualClock

SWAPPED = timedelta(milliseconds=20)
_ASKED, _SAID = "driver->mount", "mount->driver"
SETTLED = ("lx200", "nexstar", "synscan", "ioptron")
"""Families whose answers tell a place by themselves; others reckon it with the present time."""


@dataclass(slots=True)
class Turns:
    """What was answered to one question, and when it was asked; in the order of time."""

    utc: list[datetime] = field(default_factory=list)
    answers: list[bytes] = field(default_factory=list)

    def answered(self) -> Turns:
        """Without those that got none, if others did: silence isn't played."""
        kept = [(utc, answer) for utc, answer in zip(self.utc, self.answers, strict=True) if answer]
        return Turns([utc for utc, _ in kept], [answer for _, answer in kept]) if kept else self

    def at(self, utc: datetime) -> bytes:
        """The last answer until then; before the first the first."""
        return self.answers[max(bisect_right(self.utc, utc) - 1, 0)]


def turns_of(recording: Recording) -> dict[bytes, Turns]:
    """The recorded dialogue by question: what went out in one go, and all that came until the next.

    Two threads write down what goes over a line: an answer may stand before its question. So what comes when
    the last question has its answer, right before a question that got none, is that one's.
    """
    turns: dict[bytes, Turns] = {}
    last: Turns | None = None
    lines = [line for line in recording.of("wire") if line.facts["hex"]]
    for at, line in enumerate(lines):
        data = bytes.fromhex(line.facts["hex"])
        if line.facts["dir"] == _ASKED:
            early = _before_its_question(lines, at)
            if early and last is not None:
                last.answers[-1] = last.answers[-1].removesuffix(early)
            assert line.utc is not None
            last = turns.setdefault(data, Turns())
            last.utc.append(line.utc)
            last.answers.append(early)
        elif last is not None:
            last.answers[-1] += data
    return {question: one.answered() for question, one in turns.items()}


def _before_its_question(lines: list[Line], at: int) -> bytes:
    """The answer to a question that was written down right before it; mostly there is none."""
    if at < 2 or [one.facts["dir"] for one in lines[at - 2 : at]] != [_SAID, _SAID]:
        return b""
    if at + 1 < len(lines) and lines[at + 1].facts["dir"] == _SAID:
        return b""
    asked, said = lines[at].utc, lines[at - 1].utc
    if asked is None or said is None or asked - said > SWAPPED:
        return b""
    return bytes.fromhex(lines[at - 1].facts["hex"])


class TapeLine:
    """A `drivers.line.ByteLine` that has no other end but a recording.

    Parameters
    ----------
    turns : dict of bytes to Turns
    clock : VirtualClock

    Attributes
    ----------
    unknown : set of bytes
        Questions that were never asked in the recording: nothing answers them.
    """

    def __init__(self, turns: dict[bytes, Turns], clock: VirtualClock) -> None:
        self._turns = turns
        self._clock = clock
        self._came = bytearray()
        self._news = asyncio.Event()
        self._open = False
        self.unknown: set[bytes] = set()

    @property
    def address(self) -> str:
        """For messages."""
        return "recording"

    @property
    def usable(self) -> bool:
        """Whether it is open."""
        return self._open

    async def open(self) -> None:
        """Open it."""
        self._came.clear()
        self._open = True

    async def close(self) -> None:
        """Close it."""
        self._open = False

    async def write(self, data: bytes) -> None:
        """Ask; the answer takes no time, so that the replay never runs late."""
        found = self._turns.get(data)
        if found is None:
            self.unknown.add(data)
            return
        answer = found.at(self._clock.utc())
        await asyncio.sleep(0)
        self._came += answer
        self._news.set()

    async def write_now(self, data: bytes) -> None:
        """As `write`: nothing moves that would have to be stopped."""
        await self.write(data)

    async def read(self, timeout_s: float) -> bytes:
        """What came, or comes within the time."""
        if not self._came:
            try:
                async with asyncio.timeout(max(timeout_s, 0.0)):
                    await self._news.wait()
            except TimeoutError:
                pass
        return self.drain()

    def drain(self) -> bytes:
        """What has come so far."""
        came = bytes(self._came)
        self._came.clear()
        self._news.clear()
        return came

    async def lost(self) -> str:
        """Never."""
        await asyncio.Event().wait()
        return ""


class WireReader:
    """The real driver over a recorded wire, asked for readings alone.

    Parameters
    ----------
    url : str
        The mount's, for its driver and options; its port is never opened.
    recording : Recording
    clock : VirtualClock
    """

    def __init__(self, url: str, recording: Recording, clock: VirtualClock) -> None:
        self._url = url
        self._turns = turns_of(recording)
        self._clock = clock
        self._mount: DrivenMount | None = None
        self._line: TapeLine | None = None
        self.problem = ""

    @property
    def unknown(self) -> list[bytes]:
        """Questions that the recording has no answer for."""
        return sorted(self._line.unknown) if self._line is not None else []

    async def open(self) -> Callable[[], Awaitable[MountReading]] | None:
        """Greet the recorded mount; None, with `problem`, if this driver can't be played."""
        family = self._url.partition("://")[0].partition("+")[0]
        mount = open_mount(self._url) if family in SETTLED else None
        if not isinstance(mount, DrivenMount) or not isinstance(mount.language, OverLink):
            self.problem = f"{family} is not played from its wire; the recorded readings are taken"
            return None
        self._line = TapeLine(self._turns, self._clock)
        mount.language.take_line(self._line)
        try:
            await mount.open()
        except DeviceError as error:
            self.problem = f"the recorded wire doesn't greet: {error}; the recorded readings are taken"
            await mount.close()
            return None
        self._mount = mount
        return mount.reading

    async def close(self) -> None:
        """Let the driver go."""
        if self._mount is not None:
            await self._mount.close()
