"""How the iOptron language asks and orders: answers that can be believed, refusals with a reason.

A bare `1` says nothing of its question, and each stop is answered by one. So every order is preceded by a
question whose answer is a text: when that has come, no older `1` is on its way.
"""

from __future__ import annotations

from typing import TypeVar

from drivers.generic.serial_language import OptionalQuestions
from drivers.ioptron.greeting import GREETING
from drivers.ioptron.models import Model
from drivers.ioptron.values import MountState, Status
from drivers.ioptron.words import Words
from drivers.wire.command import Command
from drivers.wire.link import Link
from mountnav.errors import DeviceError, DeviceGarbled, DeviceRefused, DeviceSilent, Refusal
from mountnav.sky.coordinates import Site

T = TypeVar("T")


class Talk:
    """A link, and the words that are spoken on it.

    Parameters
    ----------
    link : Link
    words : Words
    model : Model
        Who answers; `words` and `model` are put right by the greeting.
    """

    def __init__(self, link: Link, words: Words, model: Model) -> None:
        self.link = link
        self.words = words
        self.model = model
        self.refining = OptionalQuestions(link, self._alive)

    async def ask(self, command: Command[T]) -> T:
        """Ask, or order once; raises as `Link.ask` does."""
        return await self.link.ask(command)

    async def known(self, command: Command[T]) -> T | None:
        """Ask what it may lack; None where it does. See `OptionalQuestions.known`."""
        return await self.refining.known(command)

    async def _alive(self) -> None:
        await self.link.ask(GREETING)

    async def settled(self, what: str, *, moves: bool = True) -> Status:
        """Ask for a text, so that no older `1` is on its way; refuse what a parked mount can't do.

        Raises
        ------
        DeviceRefused
            If it is parked, and the order is none for a parked mount.
        """
        status = await self.link.ask(self.words.status)
        if moves and status.state is MountState.PARKED:
            raise self.no(f"{what} refused: it is parked", Refusal.PARKED, "unpark it first")
        return status

    async def told(self, command: Command[bool]) -> tuple[bool | None, DeviceError | None]:
        """Send an order once; its answer, or why there is none."""
        try:
            return await self.link.ask(command), None
        except (DeviceSilent, DeviceGarbled) as failure:
            return None, failure

    async def obeyed(self, command: Command[bool], what: str | None = None) -> None:
        """Order what must be done. Raises `DeviceRefused` when the answer is 0."""
        if not await self.link.ask(command):
            raise self.no(f"refused {what or command.meaning}: 0", Refusal.OTHER)

    def no(self, what: str, reason: Refusal, advice: str | None = None) -> DeviceRefused:
        """Make a refusal."""
        return DeviceRefused(what, device=self.link.device, advice=advice, reason=reason)


def site_of(status: Status) -> Site:
    """Where it believes to stand."""
    return Site(status.latitude_deg, status.longitude_deg)
