"""What every serial language has in common: all that it says goes over one link."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace

from drivers.generic.language import Identity, Unskilled
from drivers.wire.line import ByteLine
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceError, DeviceGarbled, DeviceSilent

_BETWEEN_GREETINGS_S = 0.2
"""A boot loader goes on when it hears nothing for a while; the tries of a question are pauses enough."""


class OverLink(Unskilled):
    """The half of a `drivers.generic.language.Language` that is its link's; a family adds the rest.

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

    async def _greeted(self, greet: Callable[[], Awaitable[Identity]]) -> Identity:
        """Open the link and greet until that goes well, or its time is over; a failure closes the link.

        A board may be deaf after its port was opened, because that starts it anew. Then it has forgotten what
        it knew, and most can't tell: its position doesn't count until somebody has looked at the sky.

        Raises
        ------
        DeviceMissing
            If there is no such port.
        DeviceSilent, DeviceGarbled
            If it didn't answer well to the end; the advice depends on whether it answered anything.
        """
        link, loop = self._link, asyncio.get_running_loop()
        await link.open()
        until = loop.time() + link.patience.greeting_s
        try:
            while True:
                try:
                    identity = await greet()
                    break
                except (DeviceSilent, DeviceGarbled) as failure:
                    if loop.time() >= until:
                        raise self._with_advice(failure) from failure
                await asyncio.sleep(_BETWEEN_GREETINGS_S)
        except BaseException:
            await link.close()
            raise
        woke_s = link.woke_after_s
        if woke_s is None:
            return identity
        doubt = f"it answered only {woke_s:.1f} s after its port was opened, which may have started it anew"
        advice = "dtr=no keeps some boards from that; settle_s waits for a link that is only slow"
        return replace(identity, problems=(*identity.problems, f"{doubt} ({advice})"), doubt=doubt)

    def _with_advice(self, failure: DeviceError) -> DeviceError:
        """The same failure; a mount that answers other questions has no bad cable."""
        if not self._link.answers:
            return failure
        return type(failure)(
            failure.what,
            device=failure.device,
            advice="it answers other questions: its firmware may lack this one, or it speaks another "
            "dialect; update it, or name its protocol and dialect in the URL",
        )

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
