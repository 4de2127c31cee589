"""One question, one answer, one deadline - and never an old answer to a new question.

Before each question what still lies on the line is thrown away. After anything went wrong (no answer, an
answer that matches nothing, a caller that gave up) the line is owing: the next question waits until the
line has been quiet, and listens a moment longer after its answer for another one, because the first may
have been the late one. Questions that change nothing are asked again within the deadline; commands that
move or sync are sent once.
"""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass
from typing import TypeVar

from drivers.command import Command, Unreadable
from drivers.line import ByteLine
from mountnav.errors import DeviceGarbled, DeviceSilent

T = TypeVar("T")
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Patience:
    """How long to wait for what.

    Attributes
    ----------
    deadline_s : float
        For a question with all its repetitions.
    try_s : float
        For one answer; no longer than the deadline.
    quiet_s : float
        How long the line must be silent to count as quiet.
    """

    deadline_s: float = 5.0
    try_s: float = 1.6
    quiet_s: float = 0.1


class Exchange:
    """Questions and answers over one line, one at a time.

    Parameters
    ----------
    line : ByteLine
        An opened line.
    patience : Patience
        How long to wait for what.
    """

    def __init__(self, line: ByteLine, patience: Patience) -> None:
        self._line = line
        self._patience = patience
        self._turn = asyncio.Lock()
        self._owing = False
        self.troubles = 0

    async def ask(self, command: Command[T], *, deadline_s: float | None = None) -> T:
        """Send a command and return what its reader makes of the answer.

        Parameters
        ----------
        command : Command
        deadline_s : float, optional
            Instead of the deadline of `Patience`.

        Raises
        ------
        DeviceSilent
            If no whole answer came within the deadline.
        DeviceGarbled
            If what came matched nothing, to the last try.
        DeviceMissing
            If the line is lost.
        """
        async with self._turn:
            loop = asyncio.get_running_loop()
            until = loop.time() + (self._patience.deadline_s if deadline_s is None else deadline_s)
            while True:
                owed = self._owing
                if owed:
                    await self._quiet(until)
                self._line.drain()
                # owing until answered: a caller cancelled in between leaves the mark behind
                self._owing = True
                await self._line.write(command.sent)
                if not command.answered:
                    self._owing = owed
                    return command.read(b"", True).value  # type: ignore[union-attr]
                try:
                    value = await self._answer(command, until, owed)
                except (DeviceSilent, DeviceGarbled) as failure:
                    self.troubles += 1
                    _LOG.warning("%s", failure)
                    if not command.repeatable or loop.time() >= until:
                        raise
                else:
                    self._owing = False
                    return value

    async def send_now(self, command: Command[None]) -> None:
        """Send a command that has no answer, past whatever is being asked: the path of a stop."""
        await self._line.write_now(command.sent)

    async def _answer(self, command: Command[T], until: float, owed: bool) -> T:
        loop = asyncio.get_running_loop()
        try_until = min(until, loop.time() + self._patience.try_s)
        heard = b""
        try:
            while (read := command.read(heard, False)) is None:
                left_s = try_until - loop.time()
                came = await self._line.read(left_s) if left_s > 0 else b""
                heard += came
                if not came:
                    read = command.read(heard, True)
                    break
            if read is None:
                raise DeviceSilent(
                    f"no whole answer to {command.meaning} ({command.sent!r}); heard {heard!r}",
                    device=self._line.address,
                    advice="check cable, speed (baud) and that the mount is on",
                )
            if owed:
                # an answer that was owed from before may have been this one: the last one counts
                while came := await self._line.read(self._patience.quiet_s):
                    heard += came
            while heard[read.length :]:
                heard = heard[read.length :]
                later = command.read(heard, False)
                if later is None or not owed:
                    raise Unreadable(f"{heard!r} came after the answer")
                read = later
        except Unreadable as cause:
            raise DeviceGarbled(
                f"answer to {command.meaning} ({command.sent!r}) makes no sense: {cause}",
                device=self._line.address,
                advice="check cable, speed (baud) and that nothing else talks to the mount",
            ) from cause
        return read.value

    async def _quiet(self, until: float) -> None:
        """Wait until nothing has come for a while, or the deadline has passed."""
        loop = asyncio.get_running_loop()
        while await self._line.read(self._patience.quiet_s):
            if loop.time() >= until:
                return
