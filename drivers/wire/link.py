"""A link: a line, its exchange of questions and answers, and the log of both; it can be reopened."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TypeVar
from urllib.parse import urlsplit

from drivers.wire.command import Command
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import ByteLine, ControlLines, SerialLine, UdpLine
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceMissing
from mountnav.tasks import waited_for

T = TypeVar("T")


class Link:
    """A line that can be opened again, with a new exchange each time: no answer outlives its line.

    Parameters
    ----------
    log : WireLog
        The log in which the line notes its bytes.
    """

    def __init__(self, line: ByteLine, patience: Patience, log: WireLog) -> None:
        self._line = line
        self._patience = patience
        self._exchange = Exchange(line, patience)
        self._fault: str | None = None
        self._faulted = asyncio.Event()
        self.log = log

    @property
    def device(self) -> str:
        """Address, for messages."""
        return self._line.address

    @property
    def patience(self) -> Patience:
        """How long its exchanges wait."""
        return self._patience

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        return self._line.usable and self._fault is None

    @property
    def troubles(self) -> int:
        """How many answers were lost or garbled since it was opened."""
        return self._exchange.troubles

    @property
    def answers(self) -> int:
        """How many good answers came since it was opened."""
        return self._exchange.answers

    @property
    def woke_after_s(self) -> float | None:
        """See `Exchange.woke_after_s`."""
        return self._exchange.woke_after_s

    def unanswered_s(self) -> float:
        """How long the present question has been waiting for its first good answer; 0 when there is none."""
        return self._exchange.unanswered_s()

    def take_line(self, line: ByteLine) -> None:
        """Use another line from now on, for example a recorded one; only while the link is not open."""
        self._exchange.end()
        self._line = line
        self._exchange = Exchange(line, self._patience)

    async def open(self) -> None:
        """Open the line, again if it is open, and let it settle. Raises `DeviceMissing`."""
        self._exchange.end()
        await self._line.open()
        await asyncio.sleep(self._patience.settle_s)
        self._fault = None
        self._faulted.clear()
        self._exchange = Exchange(self._line, self._patience)

    async def close(self) -> None:
        """Release the line; closing twice is fine."""
        self._exchange.end()
        await self._line.close()

    async def lost(self) -> str:
        """Wait until the open line is lost, or a task that used it has died, and return why."""
        line, faulted = waited_for(self._line.lost()), waited_for(self._faulted.wait())
        try:
            await asyncio.wait({line, faulted}, return_when=asyncio.FIRST_COMPLETED)
            return self._fault or await line
        finally:
            for task in (line, faulted):
                task.cancel()

    def lose(self, why: str) -> None:
        """Count the link as lost though its line is not: nothing is asked until it is opened again."""
        if self._fault is None:
            self._fault = why
            self.log.note("event", meaning=f"lost {self.device}: {why}")
            self._faulted.set()

    async def ask(self, command: Command[T], *, deadline_s: float | None = None) -> T:
        """Send a command and return what its reader makes of the answer; see `Exchange.ask`."""
        if self._fault is not None:
            raise DeviceMissing(
                f"the line is lost: {self._fault}", device=self.device, advice="connect again"
            )
        if not self._line.usable:
            raise DeviceMissing("the line is not open", device=self.device, advice="connect first")
        return await self._exchange.ask(command, deadline_s=deadline_s)

    async def send_now(self, *commands: Command[None]) -> None:
        """Send commands in one write, past any question under way: the path of a stop."""
        await self._exchange.send_now(*commands)


def link_to(
    line: str | Callable[[WireLog], ByteLine],
    *,
    baud: int = 9600,
    control: ControlLines | None = None,
    patience: Patience | None = None,
) -> Link:
    """Make a link over a line of its own; nothing is opened yet.

    Parameters
    ----------
    line : str or callable
        Device path, ``socket://host:port`` or ``udp://host:port``, or a function that makes a `ByteLine` with
        the log given.
    baud : int
        Speed of a serial port.
    control : ControlLines, optional
        Of a serial port.
    patience : Patience, optional
        For one question.
    """
    log = WireLog()
    made: ByteLine
    if not isinstance(line, str):
        made = line(log)
    elif (parts := urlsplit(line)).scheme == "udp" and parts.hostname and parts.port:
        made = UdpLine(parts.hostname, parts.port, log=log)
    else:
        made = SerialLine(line, baud=baud, log=log, control=control)
    return Link(made, patience or Patience(), log)
