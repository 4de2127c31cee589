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

from drivers.wire.command import Command, Unreadable
from drivers.wire.line import ByteLine
from mountnav.errors import DeviceGarbled, DeviceMissing, DeviceSilent

T = TypeVar("T")
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Patience:
    """How long an exchange waits.

    Attributes
    ----------
    deadline_s : float
        For a question with all its repetitions.
    try_s : float
        For one answer; no longer than the deadline.
    quiet_s : float
        How long the line must be silent to count as quiet.
    settle_s : float
        Between opening the line and the first question: for a board that is known to reset when it is opened.
    greeting_s : float
        How long a greeting that failed is repeated. A board that resets when its port is opened is deaf
        for 2 to 8 s, with its boot loader and its network; doubled, a mount that is off is reported half a
        minute after it was opened.
    """

    deadline_s: float = 5.0
    try_s: float = 1.6
    quiet_s: float = 0.1
    settle_s: float = 0.0
    greeting_s: float = 15.0


_ROUNDS = 3.0
"""A question is repeated no sooner than after so many times the time that answers took lately: on a far line
of a busy machine a late answer would be taken for a lost one, and its successor for a late one. Doubled, a
lost answer on a far line costs twice the time; never more than half the deadline."""
_FORGOTTEN = 0.9
"""The slowest answer's time is multiplied by this with each later answer: after seven it counts half. Nearer
to 1, one slow answer counts for longer; at 0.8 it counts half after three."""
_MOST_HEARD_BYTES = 16_384
"""The longest answer with all that came beside it: mounts answer with some hundred bytes at most. Without it
a line that is never quiet would be read without end; doubled, reading it piece by piece takes four times as
long."""


class Exchange:
    """Questions and answers over one line, one at a time.

    Parameters
    ----------
    line : ByteLine
        An opened line.

    Attributes
    ----------
    troubles : int
        How many answers were lost or garbled.
    answers : int
        How many good answers came.
    woke_after_s : float or None
        Seconds from the first question until a question was answered that had stayed unanswered, as all
        before it; None where the device answered from the beginning.
    """

    def __init__(self, line: ByteLine, patience: Patience) -> None:
        self._line = line
        self._patience = patience
        self._turn = asyncio.Lock()
        self._owing = False
        self._ended = False
        self._asked_s: float | None = None
        self._first_s = 0.0
        self._round_s = 0.0
        self._unanswered: set[str] = set()
        self.troubles = 0
        self.answers = 0
        self.woke_after_s: float | None = None

    def unanswered_s(self) -> float:
        """How long the present question has been waiting for its first good answer; 0 when there is none."""
        asked_s = self._asked_s
        return 0.0 if asked_s is None else asyncio.get_running_loop().time() - asked_s

    def end(self) -> None:
        """Give up the present question, and send nothing more: the line is closed."""
        self._ended = True

    def _require_line(self) -> None:
        if self._ended:
            raise DeviceMissing("the line was closed", device=self._line.address, advice="connect again")

    async def ask(self, command: Command[T], *, deadline_s: float | None = None) -> T:
        """Send a command and return what its reader makes of the answer.

        Parameters
        ----------
        deadline_s : float, optional
            Used instead of the deadline of `Patience`.

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
            if command.answered:
                self._asked_s = loop.time()
                self._first_s = self._first_s or self._asked_s
            try:
                return await self._asked(command, until)
            finally:
                self._asked_s = None

    async def _asked(self, command: Command[T], until: float) -> T:
        loop = asyncio.get_running_loop()
        while True:
            self._require_line()
            owed = self._owing
            if owed:
                await self._quiet(until)
                self._require_line()
            self._line.drain()
            # owing until answered: a caller that is cancelled in between leaves the line marked as owing
            self._owing = True
            await self._line.write(command.sent)
            if not command.answered:
                self._owing = owed
                nothing = command.read(b"", True)
                assert nothing is not None  # what isn't answered is read from nothing
                return nothing.value
            try:
                value = await self._answer(command, until, owed)
            except (DeviceSilent, DeviceGarbled) as failure:
                self.troubles += 1
                if not self.answers and isinstance(failure, DeviceSilent):
                    self._unanswered.add(command.meaning)
                # at level info: the wire log has it, and what repeating can't mend is raised
                _LOG.info("%s", failure)
                if not command.repeatable or loop.time() >= until:
                    raise
            else:
                self._owing = False
                self.answers += 1
                if command.meaning in self._unanswered and self.woke_after_s is None:
                    self.woke_after_s = loop.time() - self._first_s
                return value

    async def send_now(self, *commands: Command[None]) -> None:
        """Send commands in one write, past any question under way: the path of a stop.

        Their answers, if they have any, are not read here: they end up in the buffer of the question under
        way, whose reader passes over them, and the line counts as owing.
        """
        if any(command.answered for command in commands):
            self._owing = True
        self._require_line()
        await self._line.write_now(b"".join(command.sent for command in commands))

    async def _answer(self, command: Command[T], until: float, owed: bool) -> T:
        loop = asyncio.get_running_loop()
        asked_s = loop.time()
        # on a far line, repeat no sooner than an answer can have come
        longest_s = max(self._patience.try_s, 0.5 * self._patience.deadline_s)
        try_s = min(max(self._patience.try_s, _ROUNDS * self._round_s), longest_s)
        try_until = min(until, asked_s + try_s)
        heard = b""
        try:
            while (read := command.read(heard, False)) is None:
                left_s = try_until - loop.time()
                came = await self._line.read(left_s) if left_s > 0 else b""
                self._require_line()
                heard = _longer(heard, came)
                if not came:
                    read = command.read(heard, True)
                    break
            if read is None:
                raise DeviceSilent(
                    f"no complete answer to {command.meaning} ({command.sent!r}); heard {heard!r}",
                    device=self._line.address,
                    advice="check cable, speed (baud) and that the mount is on",
                )
            if owed:
                # this may have been the late answer to an earlier question: the last answer counts
                while came := await self._line.read(self._patience.quiet_s):
                    heard = _longer(heard, came)
                # a reader that passes over the answers to a stop has more of them now
                read = command.read(heard, False) or read
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
        if not owed and command.repeatable:
            # only of answers that surely belong to this question: of a repeated one the first try is unknown
            self._round_s = max(loop.time() - asked_s, _FORGOTTEN * self._round_s)
        return read.value

    async def _quiet(self, until: float) -> None:
        """Wait until nothing has come for `quiet_s`, or the deadline has passed."""
        loop = asyncio.get_running_loop()
        while await self._line.read(self._patience.quiet_s):
            if loop.time() >= until:
                return


def _longer(heard: bytes, came: bytes) -> bytes:
    if len(heard) + len(came) > _MOST_HEARD_BYTES:
        raise Unreadable(f"{heard[:40]!r} and so on: more than {_MOST_HEARD_BYTES} bytes came, and no end")
    return heard + came
