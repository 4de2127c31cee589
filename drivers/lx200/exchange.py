"""How an LX200 is asked and ordered: what it may lack, what it refuses, what is sent once."""

from __future__ import annotations

from typing import TypeVar

from drivers.generic.language import Sent, Wanted
from drivers.generic.serial_language import OptionalQuestions
from drivers.lx200.codec import base
from drivers.lx200.codec.base import Answer
from drivers.lx200.codec.dialect import Order
from drivers.wire.command import Command
from drivers.wire.link import Link
from mountnav.errors import DeviceGarbled, DeviceRefused, DeviceSilent, Refusal

T = TypeVar("T")


class Lx200Exchange:
    """Questions and orders over a link; as a function it is a `drivers.lx200.codec.dialect.Ask`."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self.has_letter = False
        """Whether it answered ACK: a Gemini that starts up answers nothing else."""
        self.refining = OptionalQuestions(
            link, self._alive, greetings=(base.ALIGNMENT, base.PRODUCT, base.FIRMWARE)
        )

    async def __call__(self, command: Command[T], deadline_s: float | None = None) -> T:
        """Ask; raises as `Link.ask` does."""
        return await self._link.ask(command, deadline_s=deadline_s)

    async def known(self, command: Command[T]) -> T | None:
        """Ask what it may lack; None where it does. See `OptionalQuestions.known`."""
        return await self.refining.known(command)

    async def _alive(self) -> None:
        await self._link.ask(base.ALIGNMENT if self.has_letter else base.GET_RA)

    @property
    def device(self) -> str:
        """Address, for messages."""
        return self._link.device

    async def order(self, order: Order, what: str) -> None:
        """Send an order. Raises `DeviceRefused` when the answer is no."""
        answer = await self(order)
        if isinstance(answer, Answer) and answer.refusal is not None:
            raise self.refused(what, answer.refusal, answer.reason)
        if answer is False:
            raise self.refused(what, "0", Refusal.OTHER)

    def refused(self, what: str, words: str, reason: Refusal) -> DeviceRefused:
        """Make a refusal."""
        return DeviceRefused(f"refused {what}: {words}", device=self.device, reason=reason)

    async def once(self, orders: tuple[Order, ...], what: str, wanted: Wanted) -> Sent:
        """Send orders once, unless a stop has come; a lost answer is reported, not asked for again."""
        for number, order in enumerate(orders):
            if not wanted():
                return Sent(wire=number > 0)
            try:
                await self.order(order, what)
            except (DeviceSilent, DeviceGarbled) as failure:
                return Sent(lost=failure)
        return Sent()
