"""A recorded wire under the real driver: each question gets what was answered at that time of the night."""

from __future__ import annotations

import asyncio
from bisect import bisect_right
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from drivers.generic.mount import DrivenMount
from drivers.generic.places import apart_arcsec
from drivers.registry import open_mount
from drivers.wire.over_link import OverLink
from mountnav.devices import MountReading
from mountnav.errors import DeviceError
from mountnav.night.recorded import Line, Recording, reading_of
from mountnav.simulation.virtual_time import VirtualClock, for_all_modules, run_virtually

SWAPPED = timedelta(milliseconds=20)
"""An answer that is written down before its question is so much older at most: two threads write."""
GREETING = timedelta(minutes=2)
"""A driver's greeting and its first looks take no longer than this of virtual time."""
NEAR_ARCSEC = 15.0
"""An answer of a reading may be of the second before or after it: so much the sky turns in one."""
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
    """A `drivers.wire.line.ByteLine` that has no other end but a recording.

    Parameters
    ----------
    turns : dict of bytes to Turns
    clock : VirtualClock

    """

    def __init__(self, turns: dict[bytes, Turns], clock: VirtualClock) -> None:
        self._turns = turns
        self._clock = clock
        self._came = bytearray()
        self._news = asyncio.Event()
        self._open = False

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
            # it was never asked in the recording: nothing answers it
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


@dataclass(frozen=True, slots=True)
class WireCheck:
    """What the real driver makes of a recorded wire, beside the recorded readings.

    Attributes
    ----------
    problem : str
        Why it could not be played; empty if it was.
    readings : int
        Recorded readings.
    alike : int
        So many that the driver reads as it did then, within a step of the mount and what it moves meanwhile.
    unanswered : int
        So many that the recorded wire had no answer for.
    """

    problem: str = ""
    readings: int = 0
    alike: int = 0
    unanswered: int = 0

    @property
    def told(self) -> str:
        """In words."""
        if self.problem:
            return self.problem
        told = f"through its driver {self.alike} of {self.readings} readings are as they were"
        return told + (f"; {self.unanswered} had no answer" if self.unanswered else "")


def check_wire(url: str, recording: Recording) -> WireCheck:
    """Let the real driver read the recorded wire at the times of the recorded readings. Opens no port.

    Parameters
    ----------
    url : str
        The mount's, for its driver and options.
    recording : Recording
    """
    readings = [reading_of(line.facts["reading"]) for line in recording.of("reading")]
    if not readings:
        return WireCheck("no reading was recorded")
    clock = VirtualClock(min(one.utc for one in readings) - GREETING)
    with for_all_modules(clock):
        return run_virtually(_checked(url, recording, readings, clock), clock)


async def _checked(
    url: str, recording: Recording, readings: list[MountReading], clock: VirtualClock
) -> WireCheck:
    family = url.partition("://")[0].partition("+")[0]
    mount = open_mount(url) if family in SETTLED else None
    if not isinstance(mount, DrivenMount) or not isinstance(mount.language, OverLink):
        return WireCheck(f"the wire of {family} is not read again: its answers alone don't tell a place")
    mount.language.take_line(TapeLine(turns_of(recording), clock))
    alike = unanswered = 0
    try:
        await mount.open()
        for then in readings:
            await clock.sleep(max(0.0, (then.utc - clock.utc()).total_seconds()))
            try:
                now = await mount.reading()
            except DeviceError:
                unanswered += 1
                continue
            alike += apart_arcsec(then.place, now.place) <= NEAR_ARCSEC + mount.resolution_arcsec
    except DeviceError as error:
        return WireCheck(f"the recorded wire doesn't greet: {error}")
    finally:
        await mount.close()
    return WireCheck("", len(readings), alike, unanswered)
