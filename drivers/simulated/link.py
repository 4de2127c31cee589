"""The link to a simulated mount: up, silent or gone, with a real one's events but no heartbeat."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Literal

from drivers.generic.link_supervisor import LinkState
from drivers.generic.session import Listener
from drivers.simulated.behavior import MountBehavior
from mountnav.clock import Clock
from mountnav.errors import DeviceMissing, DeviceSilent

Trouble = Literal["silent", "missing"]
"""How a link fails: nothing answers, or the port is gone."""

_LOSS_SHOWS_S = 0.1
"""s until the loss of a port is noticed, as by a real line's reading thread. Doubled or halved, nothing
shows."""
_NO_PORT_S = 0.01
"""s that opening a port takes that isn't there, so that repeated attempts can't stop the virtual clock."""


class Cable:
    """The cable to one simulated mount.

    Parameters
    ----------
    name : str
        Of the mount, for messages.
    back : callable
        Called when a lost link was opened again: nothing that was known before counts any more.
    lost : callable
        Called with the reason when the link is lost.

    Attributes
    ----------
    links : int
        How often it was made or lost: what began under another count is given up.
    listeners : list of callable
        Called with each event.
    """

    def __init__(
        self,
        name: str,
        clock: Clock,
        behavior: MountBehavior,
        *,
        back: Callable[[], None],
        lost: Callable[[str], None],
    ) -> None:
        self._name, self._clock, self._behavior = name, clock, behavior
        self._back, self._lost = back, lost
        self._until_s = -1.0
        self._trouble: Trouble = "missing"
        self._alarms: list[asyncio.TimerHandle] = []
        self.links = 0
        self.state = LinkState.CLOSED
        self.listeners: list[Listener] = []

    async def open(self) -> None:
        """Plug it in.

        Raises
        ------
        DeviceMissing, DeviceSilent
            While the port is gone or nothing answers.
        """
        await self._answered()
        self.links += 1
        self.state = LinkState.UP

    def close(self) -> None:
        """Unplug it for good."""
        self.state = LinkState.CLOSED
        self._quiet()

    def cut(self, for_s: float, trouble: Trouble = "missing") -> None:
        """Let the link fail now: the port is gone, or nothing answers any more."""
        self._until_s, self._trouble = self._clock.monotonic_s() + for_s, trouble
        if self.state is not LinkState.UP:
            return
        self._quiet()
        if trouble == "missing":
            self._after(_LOSS_SHOWS_S, self._on_lost, "the port is gone")
        else:
            self._after(min(self._behavior.silence_s, for_s), self._on_silent, for_s)

    async def ask(self) -> None:
        """Let one question and its answer pass.

        Raises
        ------
        DeviceMissing
            When the link is closed, or lost and can't be opened again yet.
        DeviceSilent
            When nothing answers.
        """
        if self.state is LinkState.CLOSED:
            raise DeviceMissing("not connected", device=self._name, advice="open the mount first")
        links = self.links
        await self._answered()
        if self.state is LinkState.LOST:
            self._open_again()
        elif links != self.links:
            raise DeviceMissing("its link was lost on the way", device=self._name)

    def require(self, links: int) -> None:
        """Raise `DeviceMissing` if the link is not the one under which something began."""
        if self.links != links:
            raise DeviceMissing(
                "its link was lost on the way",
                device=self._name,
                advice="look at the sky before anything moves",
            )

    def emit(self, what: str, facts: Mapping[str, object]) -> None:
        """Send an event to all listeners."""
        for listener in self.listeners:
            listener(what, facts)

    # -- inside ----------------------------------------------------------------------------------

    async def _answered(self) -> None:
        if self._clock.monotonic_s() < self._until_s:
            if self._trouble == "missing":
                await self._clock.sleep(_NO_PORT_S)
                raise DeviceMissing("there is no such port", device=self._name)
            await self._clock.sleep(self._behavior.silence_s)
            raise DeviceSilent(
                f"no answer within {self._behavior.silence_s:g} s",
                device=self._name,
                advice="is it switched on?",
            )
        await self._clock.sleep(self._behavior.latency_s)

    def _on_silent(self, for_s: float) -> None:
        self.state = LinkState.SILENT
        self.emit("link-silent", {"for_s": self._behavior.silence_s})
        if for_s > self._behavior.lost_after_s:
            self._after(
                self._behavior.lost_after_s - self._behavior.silence_s,
                self._on_lost,
                f"silent for {self._behavior.lost_after_s:.0f} s",
            )
        else:
            self._after(for_s - self._behavior.silence_s, self._on_answer, for_s)

    def _on_answer(self, after_s: float) -> None:
        self.state = LinkState.UP
        self.emit("link-back", {"after_s": after_s})

    def _on_lost(self, why: str) -> None:
        self.links += 1
        self.state = LinkState.LOST
        self.emit("link-lost", {"why": why})
        self._lost(why)
        self._after(self._behavior.again_s, self._try_again)

    def _try_again(self) -> None:
        if self.state is not LinkState.LOST:
            return
        if self._clock.monotonic_s() < self._until_s:
            self._after(self._behavior.again_s, self._try_again)
        else:
            self._open_again()

    def _open_again(self) -> None:
        self.links += 1
        self.state = LinkState.UP
        self._quiet()
        self.emit("link-back", {"identity": "simulated mount", "trusted": False, "problems": []})
        self._back()

    def _after(self, seconds: float, call: Callable[..., None], *given: object) -> None:
        loop = asyncio.get_running_loop()
        self._alarms = [
            alarm for alarm in self._alarms if not alarm.cancelled() and alarm.when() > loop.time()
        ]
        self._alarms.append(loop.call_later(max(0.0, seconds), call, *given))

    def _quiet(self) -> None:
        for alarm in self._alarms:
            alarm.cancel()
        self._alarms.clear()
