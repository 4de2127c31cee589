"""What every serial language has in common: all that it says goes over one link."""

from __future__ import annotations

from drivers.language import Unskilled
from drivers.line import ByteLine
from drivers.link import Link
from drivers.wire_log import WireLog


class OverLink(Unskilled):
    """The half of a `drivers.language.Language` that is its link's; a family's language is made on top of it.

    Parameters
    ----------
    link : Link
    """

    def __init__(self, link: Link) -> None:
        self._link = link

    @property
    def device(self) -> str:
        """Address, for messages."""
        return self._link.device

    @property
    def log(self) -> WireLog:
        """All that went over its wire lately."""
        return self._link.log

    @property
    def usable(self) -> bool:
        """Whether its link is open and not lost."""
        return self._link.usable

    def unanswered_s(self) -> float:
        """Since when a question has been waiting for its first good answer; 0 when none is."""
        return self._link.unanswered_s()

    def take_line(self, line: ByteLine) -> None:
        """Talk over another line from now on; before `open`, as when a recorded wire is played."""
        self._link.take_line(line)

    async def close(self) -> None:
        """Release the link; closing twice is fine."""
        await self._link.close()

    async def lost(self) -> str:
        """Wait until the open link is lost, and tell why."""
        return await self._link.lost()
