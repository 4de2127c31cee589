"""Keeps a mount's link: heartbeat, detection of silence and loss, reconnecting with back-off.

Two tasks per mount, one for the heartbeat and one that watches. Neither moves anything: after a loss the
state is read again, and the position is not trusted until the sky has been looked at.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from enum import StrEnum

from drivers.generic.language import Language
from drivers.generic.options import Timing
from mountnav.clock import real_s
from mountnav.errors import DeviceError, DeviceMissing
from mountnav.tasks import fault_words, waited_for

_log = logging.getLogger(__name__)

_CHECK_S = 0.1
"""Between two checks of a link for silence, s. Chosen: a tenth of the default `silence_s`, so that a silence
is noticed in time; a lost line wakes the watch at once. Doubled, a silence is noticed 0.1 s later; halved, an
idle service works twice as much."""
_SHORTEST_BEAT_S = 0.02
"""s. A heartbeat that is due at once waits this long nevertheless, so that it can't spin. Chosen by hand: an
exchange at 9600 baud. Doubled or halved, nothing shows at the default heartbeat of 0.5 s."""


class LinkState(StrEnum):
    """What is known of the link."""

    CLOSED = "closed"
    UP = "up"
    SILENT = "silent"
    LOST = "lost"


class LinkSupervisor:
    """Watches one language's link.

    Parameters
    ----------
    beat : callable
        Reads the mount once.
    reopen : callable
        Opens the link again, greeting and state included; raises `DeviceError`.
    silent, lost, back : callable
        Called with the length of a silence so far (s), with the reason of a loss, and, when the mount answers
        again on the same link, with the length of the silence (s). `reopen` itself reports a new link.
    """

    def __init__(
        self,
        language: Language,
        timing: Timing,
        *,
        beat: Callable[[], Awaitable[object]],
        reopen: Callable[[], Awaitable[object]],
        silent: Callable[[float], None],
        lost: Callable[[str], Awaitable[None]],
        back: Callable[[float], Awaitable[None]],
    ) -> None:
        self._language = language
        self._timing = timing
        self._beat = beat
        self._reopen = reopen
        self._silent, self._lost, self._back = silent, lost, back
        self._tasks: list[asyncio.Task[None]] = []
        self._heard_s = 0.0
        self._silent_since_s: float | None = None
        self._fault: str | None = None
        """An error in one of the two tasks: then the link counts as lost."""
        self.state = LinkState.CLOSED

    def start(self) -> None:
        """Begin to watch a link that was just opened."""
        self.heard()
        self.state = LinkState.UP
        self._silent_since_s = None
        self._fault = None
        if not self._tasks:
            self._tasks = [waited_for(self._restarted(self._watch), "link-watch")]
            if self._timing.heartbeat_s > 0.0:
                self._tasks.append(waited_for(self._restarted(self._beat_on), "link-beat"))

    async def end(self) -> None:
        """Stop watching."""
        tasks, self._tasks = self._tasks, []
        self.state = LinkState.CLOSED
        for task in tasks:
            task.cancel()
        for task in tasks:
            with contextlib.suppress(asyncio.CancelledError):
                await task

    def heard(self) -> None:
        """A good reading has come."""
        self._heard_s = asyncio.get_running_loop().time()

    async def _restarted(self, work: Callable[[], Awaitable[None]]) -> None:
        """Run one of the two tasks for ever; an error of ours in it counts as a lost link."""
        while True:
            try:
                await work()
            except Exception as fault:
                _log.exception("%s: keeping its link failed unexpectedly", self._language.device)
                self._fault = fault_words(fault)
                await asyncio.sleep(self._timing.backoff_s)

    async def _beat_on(self) -> None:
        loop, each_s = asyncio.get_running_loop(), real_s(self._timing.heartbeat_s)
        while True:
            await asyncio.sleep(max(self._heard_s + each_s - loop.time(), _SHORTEST_BEAT_S))
            if loop.time() < self._heard_s + each_s:
                continue
            if not self._language.usable or self.state is LinkState.LOST:
                await asyncio.sleep(each_s)
                continue
            try:
                await self._beat()
            except DeviceMissing:
                continue
            except DeviceError:
                # silence or nonsense: the watch measures how long
                await asyncio.sleep(self._timing.poll_s)

    async def _watch(self) -> None:
        while True:
            why = await self._check()
            if why is None:
                continue
            self.state = LinkState.LOST
            self._silent_since_s = None
            await self._lost(why)
            await self._connect_again()
            self.heard()
            self.state = LinkState.UP

    async def _check(self) -> str | None:
        """Wait a moment; return why the link counts as lost, or None."""
        loop = asyncio.get_running_loop()
        fault, self._fault = self._fault, None
        if fault is not None:
            return fault
        try:
            async with asyncio.timeout(_CHECK_S):
                return await self._language.lost()
        except TimeoutError:
            if not self._language.usable:
                # lost at this very moment: the language knows why
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_CHECK_S):
                        return await self._language.lost()
                return "the link is gone"
        if self._timing.heartbeat_s <= 0.0:
            return None
        now_s = loop.time()
        if self._silent_since_s is not None and self._heard_s > self._silent_since_s:
            for_s = self._heard_s - self._silent_since_s + self._timing.silence_s
            self._silent_since_s = None
            self.state = LinkState.UP
            await self._back(for_s)
        waiting_s = min(self._language.unanswered_s(), now_s - self._heard_s)
        if self._silent_since_s is None and waiting_s > self._timing.silence_s:
            self._silent_since_s = now_s
            self.state = LinkState.SILENT
            self._silent(waiting_s)
        quiet_s = now_s - self._heard_s
        if self._silent_since_s is not None and quiet_s > self._timing.lost_after_s:
            return f"silent for {quiet_s:.0f} s"
        return None

    async def _connect_again(self) -> None:
        delay_s = self._timing.backoff_s
        while True:
            try:
                await self._reopen()
            except DeviceError:
                await asyncio.sleep(delay_s)
                delay_s = min(2.0 * delay_s, self._timing.longest_backoff_s)
            else:
                return
