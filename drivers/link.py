"""What a serial language talks over: a line, its exchange of questions and answers, and the log of both."""

from __future__ import annotations

from typing import TypeVar

from drivers.command import Command
from drivers.exchange import Exchange, Patience
from drivers.line import ByteLine
from drivers.wire_log import WireLog
from mountnav.errors import DeviceMissing

T = TypeVar("T")


class Link:
    """A line that can be opened again, with a new exchange each time.

    Parameters
    ----------
    line : ByteLine
    patience : Patience
        How long to wait for what.
    log : WireLog
        The one that the line notes its bytes in.
    """

    def __init__(self, line: ByteLine, patience: Patience, log: WireLog) -> None:
        self._line = line
        self._patience = patience
        self._exchange = Exchange(line, patience)
        self.log = log

    @property
    def device(self) -> str:
        """Address, for messages."""
        return self._line.address

    @property
    def patience(self) -> Patience:
        """How long to wait for what."""
        return self._patience

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        return self._line.usable

    @property
    def troubles(self) -> int:
        """How many answers went wrong since it was opened."""
        return self._exchange.troubles

    def unanswered_s(self) -> float:
        """Since when the present question waits for its first good answer; 0 when there is none."""
        return self._exchange.unanswered_s()

    def take_line(self, line: ByteLine) -> None:
        """Talk over another line from now on; for a link that is not open, as when a recording is played."""
        self._exchange.end()
        self._line = line
        self._exchange = Exchange(line, self._patience)

    async def open(self) -> None:
        """Open the line, anew if it is open. Raises `DeviceMissing`."""
        self._exchange.end()
        await self._line.open()
        self._exchange = Exchange(self._line, self._patience)

    async def close(self) -> None:
        """Release the line; closing twice is fine."""
        self._exchange.end()
        await self._line.close()

    async def lost(self) -> str:
        """Wait until the open line is lost, and tell why."""
        return await self._line.lost()

    async def ask(self, command: Command[T], *, deadline_s: float | None = None) -> T:
        """Send a command and return what its reader makes of the answer; see `Exchange.ask`."""
        if not self._line.usable:
            raise DeviceMissing("the line is not open", device=self.device, advice="connect first")
        return await self._exchange.ask(command, deadline_s=deadline_s)

    async def send_now(self, *commands: Command[None]) -> None:
        """Send commands in one write, past whatever is being asked: the path of a stop."""
        await self._exchange.send_now(*commands)
