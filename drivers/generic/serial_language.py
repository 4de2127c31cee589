"""What all languages over one link share: the greeting, and questions that a mount may lack.

A greeting has a few questions without which there is no mount (who it is, where it looks). All others refine
what is known of it: its clock, its park, its guide rate. A firmware that lacks one of these is driven without
what hangs on it. Silence alone proves nothing - the mount may be deaf, the answer lost - so a question counts
as missing only when it stayed unanswered twice while the mount answered another one in between and after.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any, Protocol, TypeVar, cast

from drivers.generic.language import Identity, Unskilled
from drivers.wire.command import Command
from drivers.wire.line import ByteLine
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceError, DeviceGarbled, DeviceSilent

_BETWEEN_GREETINGS_S = 0.2
"""s between two greetings of a board that doesn't answer yet. A boot loader starts the firmware when it hears
nothing for a while; the times between the tries of a question are pause enough for that. Doubled, connecting
takes 0.2 s longer."""


class SerialLanguage(Unskilled):
    """The half of a `drivers.generic.language.Language` that concerns the link; a family adds the rest."""

    def __init__(self, link: Link) -> None:
        self._link = link

    @property
    def device(self) -> str:
        """Address, for messages."""
        return self._link.device

    @property
    def log(self) -> WireLog:
        """The latest messages on its wire."""
        return self._link.log

    @property
    def usable(self) -> bool:
        """Whether its link is open and not lost."""
        return self._link.usable

    async def _greeted(self, greet: Callable[[], Awaitable[Identity]]) -> Identity:
        """Open the link and greet until that succeeds or its time is over; a failure closes the link.

        A board may be deaf after its port was opened, because opening resets it. Then it has forgotten its
        alignment, and most boards don't report that: so a late first answer makes its position doubtful.

        Raises
        ------
        DeviceMissing
            If there is no such port.
        DeviceSilent, DeviceGarbled
            If no greeting was answered to its end; the advice depends on whether anything was answered.
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
        doubt = f"it answered only {woke_s:.1f} s after its port was opened, which may have restarted it"
        advice = "dtr=no keeps some boards from that; settle_s waits for a link that is only slow"
        return replace(identity, problems=(*identity.problems, f"{doubt} ({advice})"), doubt=doubt)

    def _with_advice(self, failure: DeviceError) -> DeviceError:
        """The same failure with other advice if the mount answers other questions: its cable is good then."""
        if not self._link.answers:
            return failure
        return type(failure)(
            failure.what,
            device=failure.device,
            advice="it answers other questions: its firmware may lack this one, or it speaks another "
            "dialect; update it, or name its protocol and dialect in the URL",
        )

    def unanswered_s(self) -> float:
        """How long a question has been waiting for its first good answer; 0 when none is waiting."""
        return self._link.unanswered_s()

    def take_line(self, line: ByteLine) -> None:
        """Use another line from now on, for example a recorded one; call it before `open`."""
        self._link.take_line(line)

    async def close(self) -> None:
        """Release the link; closing twice is fine."""
        await self._link.close()

    async def lost(self) -> str:
        """Wait until the open link is lost, and return why."""
        return await self._link.lost()


T = TypeVar("T")
_TRIES = (1, 2)
"""How many tries each of the two rounds has: on a line that loses one answer in twenty, one question in eight
thousand (20 cubed) is taken for missing. Doubled, a mount that lacks three questions takes half a minute to
connect."""


class AskOnce(Protocol):
    """A function that asks one question within a deadline; raises `DeviceError`."""

    async def __call__(self, command: Command[Any], *, deadline_s: float | None = None) -> Any:
        """Return the answer."""
        ...


class OptionalQuestions:
    """Asks the questions that a mount may lack, and remembers which it lacks.

    Parameters
    ----------
    alive : callable
        Asks a question that every mount of the family answers; raises `DeviceError` when this one doesn't.
    greetings : tuple of Command
        Questions that only decide which dialect is spoken: that they are missing is not reported.
    """

    def __init__(
        self, link: Link, alive: Callable[[], Awaitable[object]], greetings: tuple[Command[Any], ...] = ()
    ) -> None:
        self._link = link
        self._alive = alive
        self._greetings = {command.sent for command in greetings}
        self._answered: set[bytes] = set()
        self._missing: dict[bytes, str] = {}
        self._lacked: set[bytes] = set()

    def begin(self) -> None:
        """Forget what was found out, on a new link: the mount may be another one, or have other firmware.

        Questions that were missing before are tried in one round only: a moving mount may be waiting for its
        stop.
        """
        self._lacked |= self._missing.keys()
        self._answered.clear()
        self._missing.clear()

    def lacks(self, *commands: Command[Any]) -> bool:
        """Whether the mount is known to lack one of these questions."""
        return any(command.sent in self._missing for command in commands)

    @property
    def notes(self) -> tuple[str, ...]:
        """The missing questions, in words for an operator."""
        return tuple(
            f"it doesn't answer {sent!r} ({meaning}): what depends on it is left out"
            for sent, meaning in self._missing.items()
            if sent not in self._greetings
        )

    async def known(self, command: Command[T], ask: AskOnce | None = None) -> T | None:
        """Ask; None where the mount lacks the question. Once answered, a question is not optional any more.

        Parameters
        ----------
        ask : callable, optional
            Instead of the link's own way to ask.

        Raises
        ------
        DeviceSilent, DeviceGarbled, DeviceMissing
            If the mount answers nothing else either, or did answer this question before.
        """
        if command.sent in self._missing:
            return None
        put: AskOnce = ask or self._link.ask
        if command.sent in self._answered:
            return cast("T", await put(command))
        for tries in _TRIES[:1] if command.sent in self._lacked else _TRIES:
            try:
                value = await put(command, deadline_s=tries * self._link.patience.try_s)
            except (DeviceSilent, DeviceGarbled):
                await self._alive()
            else:
                self._answered.add(command.sent)
                self._lacked.discard(command.sent)
                return cast("T", value)
        self._missing[command.sent] = command.meaning
        return None
