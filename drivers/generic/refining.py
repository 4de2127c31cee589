"""Questions that a mount may lack: asked until they are answered or proven to be missing, and told.

A greeting has a few questions without which there is no mount (who it is, where it looks). All others refine
what is known of it: its clock, its park, its guide rate. A firmware that lacks one of these is driven without
what hangs on it. Silence alone proves nothing - the mount may be deaf, the answer lost - so a question counts
as missing only when it stayed unanswered twice while the mount answered another one in between and after.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, Protocol, TypeVar, cast

from drivers.wire.command import Command
from drivers.wire.link import Link
from mountnav.errors import DeviceGarbled, DeviceSilent

T = TypeVar("T")
_TRIES = (1, 2)
"""How many tries each of the two rounds has: a line that loses one answer in twenty takes one question in
eight thousand for missing. Doubled, a mount that lacks three questions takes half a minute to connect."""


class AskOnce(Protocol):
    """Puts one question within a deadline; raises `DeviceError`."""

    async def __call__(self, command: Command[Any], *, deadline_s: float | None = None) -> Any:
        """Return the answer."""
        ...


class Refining:
    """Asks over a link what a mount may lack.

    Parameters
    ----------
    link : Link
    alive : callable
        Asks what every mount of the family answers; raises `DeviceError` when this one doesn't now.
    greetings : tuple of Command
        Nobody is told that these are missing: nothing hangs on them but which words are spoken.
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
        """Begin anew, as when a link was opened: the mount may be another, or have other firmware.

        What was missing before is asked once only: something may be moving that waits for its stop.
        """
        self._lacked |= self._missing.keys()
        self._answered.clear()
        self._missing.clear()

    def lacks(self, *commands: Command[Any]) -> bool:
        """Whether one of these questions is known to be missing."""
        return any(command.sent in self._missing for command in commands)

    @property
    def notes(self) -> tuple[str, ...]:
        """What is missing, in words for an operator."""
        return tuple(
            f"it doesn't answer {sent!r} ({meaning}): what hangs on that is left out"
            for sent, meaning in self._missing.items()
            if sent not in self._greetings
        )

    async def known(self, command: Command[T], ask: AskOnce | None = None) -> T | None:
        """Ask; None where the mount lacks the question. What was answered once is not optional any more.

        Parameters
        ----------
        command : Command
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
