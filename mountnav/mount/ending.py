"""Ending what must not go on: tried until it is done, reported while it isn't, the mount stopped at last."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable

from mountnav.clock import Clock
from mountnav.errors import MountnavError
from mountnav.journal.records import EntryKind
from mountnav.mount.mount_state import Listener
from mountnav.mount.order_book import OrderBook
from mountnav.tasks import begun, fault_words, first_of, waited_for

_AGAIN_S = 1.0
"""Between the first tries, s. Chosen by hand: a link that hiccups is back by then. Doubled, rates go on for
some seconds longer before the mount is stopped."""
_LATER_S = 5.0
"""Between the tries after the mount was stopped, or could not be, s. Chosen by hand: a lost link is tried as
often by its driver. Doubled, rates go on for so much longer after a link is back that nobody tells of."""
_TRIES = 3
"""After so many tries the mount is stopped. Doubled, rates that can't be ended go on for some seconds
more."""
_LAST_TRY_S = 8.0
"""A try that is under way when its time is up is waited for so much longer, s: cut off, whether the mount
took the end isn't known. A slow line answers in that time, or its driver says that it doesn't. Doubled, a
service with a silent mount takes longer to end."""
_TELL_AGAIN_S = 60.0
"""A failure is reported again after so long, s. Halved, an unplugged mount fills the journal twice as
fast."""


class Ending:
    """Ends one thing that one mount does by itself.

    Parameters
    ----------
    what : str
        "offset-rates" or "move-axis", for events: ``…-not-ended``, ``…-stopped``, ``…-ended-late``.
    words : str
        The same for people.
    once : callable
        ``once(why)``: ends it and sees that it has; raises a `MountnavError` if not. Nothing to end is fine.
    stop : callable
        Stops the mount.
    owed : callable
        Whether there is anything to end.
    """

    def __init__(
        self,
        what: str,
        words: str,
        *,
        once: Callable[[str], Awaitable[None]],
        stop: Callable[[str], Awaitable[None]],
        owed: Callable[[], bool],
        book: OrderBook,
        clock: Clock,
        tell: Listener,
    ) -> None:
        self._what, self._words = what, words
        self._once, self._stop, self._owed = once, stop, owed
        self._book, self._clock, self._tell = book, clock, tell
        self._task: asyncio.Task[None] | None = None
        self._wake = asyncio.Event()
        self._trying = self._last = False
        self._told_s = -math.inf
        self._why = ""
        self.problem: str | None = None
        """What an operator should know: it could not be ended yet."""

    def begin(self, why: str) -> None:
        """End it, in a task of its own, until it is done; begun already is fine."""
        if not self._owed():
            return
        if not self._trying:
            # a stop that fails within a try says so as well: that is no news, and no reason to try at once
            self._wake.set()
        if self._task is None or self._task.done():
            self._why, self._last = why, False
            self._task = begun(self._run(why), f"end-{self._what}", died=self._died)

    async def now(self, why: str) -> None:
        """End it, and return when it has; what can't be ended is tried on. Raises the first try's error."""
        try:
            await self._once(why)
        except MountnavError as error:
            self._failed(error, why, 1)
            self.begin(why)
            raise
        except asyncio.CancelledError:
            self.begin(why)
            raise
        self._done()

    async def over(self, within_s: float) -> bool:
        """Wait so long until it has ended, and for the try that is under way then; whether it has."""
        task = self._task
        for pause_s in (within_s, _LAST_TRY_S):
            if task is None or task.done():
                break
            pause = waited_for(self._clock.sleep(pause_s))
            try:
                await asyncio.wait({task, pause}, return_when=asyncio.FIRST_COMPLETED)
            finally:
                pause.cancel()
                await asyncio.gather(pause, return_exceptions=True)
            # none after the one that is under way
            self._last = True
            self._wake.set()
        return not self._owed()

    async def close(self) -> None:
        """Try no more."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await task

    def wake(self) -> None:
        """Try at once: the link is back."""
        self._wake.set()

    def _died(self, fault: Exception) -> None:
        self._tell(f"{self._what}-not-ended", {"why": fault_words(fault), "tries": 0})
        self._task = None
        asyncio.get_running_loop().call_later(_AGAIN_S, self.begin, self._why)

    async def _run(self, why: str) -> None:
        tries, stopped = 0, False
        while self._owed():
            self._wake.clear()
            self._trying = True
            try:
                await self._once(why)
            except MountnavError as error:
                tries += 1
                self._failed(error, why, tries)
                if tries >= _TRIES and not stopped and not self._last:
                    stopped = await self._stopped(why)
            else:
                break
            finally:
                self._trying = False
            if not self._last:
                await self._pause(_AGAIN_S if tries < _TRIES else _LATER_S)
            if self._last:
                return
        self._done()

    async def _stopped(self, why: str) -> bool:
        """Stop the mount, since they can't be ended otherwise; whether it was heard."""
        facts: dict[str, object] = {"why": why}
        try:
            await self._stop(f"{self._words} could not be ended")
        except MountnavError as error:
            facts["error"] = str(error)
            self._book.note_now(EntryKind.FAULT, f"{self._words} could not be ended, nor it stopped", facts)
            return False
        self._book.note_now(EntryKind.FAULT, f"{self._words} could not be ended: it was stopped", facts)
        self._tell(f"{self._what}-stopped", facts)
        return True

    def _failed(self, error: MountnavError, why: str, tries: int) -> None:
        self.problem = f"{self._words} could not be ended ({error.what}); mountnav tries again by itself"
        now_s = self._clock.monotonic_s()
        if now_s < self._told_s + _TELL_AGAIN_S:
            return
        self._told_s = now_s
        facts: dict[str, object] = {"why": why, "error": str(error), "tries": tries}
        self._book.note_now(EntryKind.FAULT, f"{self._words} could not be ended", facts)
        self._tell(f"{self._what}-not-ended", facts)

    def _done(self) -> None:
        self._told_s = -math.inf
        if self.problem is not None:
            self.problem = None
            self._book.note_now(EntryKind.NOTE, f"{self._words} have ended, late", {})
            self._tell(f"{self._what}-ended-late", {})

    async def _pause(self, seconds: float) -> None:
        await first_of(self._clock.sleep(seconds), self._wake.wait())
