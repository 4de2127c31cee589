"""Questions to a hand control: no answer is taken for that of another question.

All answers that were owed have come when a letter comes back that was not used just before [NexStar K].
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import TypeVar

from drivers.generic.language import Sent, Wanted
from drivers.generic.serial_language import OptionalQuestions
from drivers.nexstar.codec import base
from drivers.nexstar.codec.replies import ECHOES
from drivers.wire.command import Command
from drivers.wire.link import Link
from mountnav.errors import DeviceGarbled, DeviceSilent

T = TypeVar("T")
_MOST_TRIES = 4
"""How many further answers are compared until two in a row are alike. Chosen by hand; halved, a bad line
fails where it still could be used."""


class HandsetExchange:
    """Questions and orders over a link."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._echoes = 0
        self._troubles = 0
        self.refining = OptionalQuestions(link, self.step)

    def opened(self) -> None:
        """Take note that the link is new."""
        self._troubles = 0
        self.refining.begin()

    async def step(self) -> None:
        """Come into step."""
        self._echoes = (self._echoes + 1) % len(ECHOES)
        await self._link.ask(base.echo(ECHOES[self._echoes : self._echoes + 1]))
        self._troubles = self._link.troubles

    async def back_in_step(self) -> None:
        """Come into step if anything went wrong since the last time."""
        if self._link.troubles != self._troubles:
            await self.step()

    async def asked(self, command: Command[T], deadline_s: float | None = None) -> T:
        """Ask, in step again if anything went wrong since."""
        await self.back_in_step()
        return await self._link.ask(command, deadline_s=deadline_s)

    async def agreed(
        self,
        command: Command[T],
        deadline_s: float | None = None,
        alike: Callable[[T, T], bool] = operator.eq,
    ) -> T:
        """Ask for what may be any byte, in step, until two answers in a row are alike: no flipped bit shows.

        Raises
        ------
        DeviceGarbled
            If they go on differing; otherwise as `asked`.
        """
        await self.step()
        answer = await self.asked(command, deadline_s)
        for _ in range(_MOST_TRIES):
            again = await self.asked(command, deadline_s)
            if alike(answer, again):
                return again
            answer = again
        raise DeviceGarbled(
            f"answers to {command.meaning} ({command.sent!r}) contradict each other, the last is {answer}",
            device=self._link.device,
            advice="check cable, speed (baud) and that nothing else talks to the mount",
        )

    async def agreed_if_known(
        self, command: Command[T], *, alike: Callable[[T, T], bool] = operator.eq
    ) -> T | None:
        """As `agreed`, what it may lack: None then."""
        return await self.refining.known(command, functools.partial(self.agreed, alike=alike))

    async def asked_if_known(self, command: Command[T]) -> T | None:
        """As `asked`, what it may lack: None then."""
        return await self.refining.known(command, self.asked)

    async def once(self, order: Command[None], wanted: Wanted) -> Sent:
        """Send an order a single time; its answer may be lost, but is never another's."""
        await self.step()
        if not wanted():
            return Sent(wire=False)
        try:
            await self._link.ask(order)
        except (DeviceSilent, DeviceGarbled) as failure:
            return Sent(lost=failure)
        return Sent()
