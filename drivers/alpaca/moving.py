"""Orders to move as Alpaca gives them, and the stop that passes them all.

An order goes out once. Old drivers answer some of them only when the motion is over: then the answer is
awaited in the background, and an error in it is kept for whoever follows the motion.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TypeVar

from drivers.alpaca.asking import Asking
from drivers.alpaca.codec import Parameters
from drivers.alpaca.looking import Looking
from drivers.alpaca.refusals import PARKED, AlpacaRefused
from drivers.generic.language import Sent
from mountnav.errors import DeviceError, DeviceGarbled, DeviceMissing, DeviceRefused, DeviceSilent
from mountnav.tasks import begun

T = TypeVar("T")
_SOON_S = 1.0
"""A refusal comes at once; so long it is waited for where the answer may take minutes, and for a stop's."""
_MOST_STOPS = 4
"""So many stops may be unanswered: more of them would only wait behind each other."""


class Moving:
    """Sends one telescope's orders to move.

    Parameters
    ----------
    asking : Asking
    looking : Looking
        Keeps what failed.
    longest_s : float
        For an answer that comes at the end of the motion.
    """

    def __init__(self, asking: Asking, looking: Looking, longest_s: float) -> None:
        self._asking = asking
        self._looking = looking
        self._longest_s = longest_s
        self._orders: set[asyncio.Task[DeviceError | None]] = set()
        self._stops: set[asyncio.Task[None]] = set()

    async def order(self, member: str, parameters: Parameters, *, at_once: bool) -> Sent:
        """Give an order to move, once.

        Parameters
        ----------
        member : str
        parameters : mapping
        at_once : bool
            Whether it answers when the motion begins; else it may answer at its end.

        Raises
        ------
        DeviceRefused
            If it says no.
        DeviceMissing
            If it can't have reached it.
        """
        number = self._looking.ordered()
        if at_once:
            try:
                await self._asking.put(member, parameters)
            except (DeviceSilent, DeviceGarbled) as failure:
                return Sent(lost=failure)
            return Sent()
        sending = begun(
            self._to_its_end(member, parameters, number), f"alpaca-{member}", died=self._asking.died
        )
        self._orders.add(sending)
        sending.add_done_callback(self._orders.discard)
        try:
            done, _ = await asyncio.wait({sending}, timeout=_SOON_S)
        except asyncio.CancelledError:
            sending.cancel()
            raise
        ended = self._outcome(sending) if done else None
        if isinstance(ended, (DeviceRefused, DeviceMissing)):
            raise ended
        return Sent(lost=ended)

    async def _to_its_end(self, member: str, parameters: Parameters, number: int) -> DeviceError | None:
        try:
            await self._asking.put(member, parameters, deadline_s=self._longest_s)
        except DeviceError as failure:
            if isinstance(failure, AlpacaRefused):
                self._looking.fail(number, failure.words or failure.what)
            # of any other the readings tell what came of it
            self._asking.log.note("event", meaning=f"{member}: {failure.what}")
            return failure
        return None

    async def stop(self) -> None:
        """Abort all motion, beside every other exchange; a slow answer is not waited for.

        Raises
        ------
        DeviceRefused
            If it can't be stopped at all.
        DeviceMissing, DeviceSilent, DeviceGarbled
            If the stop can't be sent, or the answer says nothing.
        """
        if len(self._stops) >= _MOST_STOPS:
            return
        stopping = begun(self._abort(), "alpaca-abortslew", died=self._stop_failed)
        self._stops.add(stopping)
        stopping.add_done_callback(self._stops.discard)
        done, _ = await asyncio.wait({stopping}, timeout=_SOON_S)
        if done:
            self._outcome(stopping)

    def _outcome(self, ended: asyncio.Task[T]) -> T:
        """What an ended order came to; one that ended with its connections is no cancellation of ours."""
        if ended.cancelled():
            raise DeviceMissing(
                "the connection was closed meanwhile", device=self._asking.address, advice="connect again"
            )
        return ended.result()

    async def _abort(self) -> None:
        try:
            await self._asking.put_past_all("abortslew")
        except AlpacaRefused as refused:
            if refused.unsupported:
                raise
            # a parked one has nothing to stop; of any other the readings tell, and it is told again
            if refused.number != PARKED:
                self._asking.log.note("event", meaning=f"the stop was refused: {refused.words}")

    def _stop_failed(self, fault: Exception) -> None:
        self._asking.log.note("event", meaning=f"a stop failed: {fault}")
        if not isinstance(fault, DeviceError):
            self._asking.died(fault)

    async def end(self) -> None:
        """Wait for no answer any more."""
        running = [*self._orders, *self._stops]
        for one in running:
            one.cancel()
        for one in running:
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await one
