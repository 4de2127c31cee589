"""What a service reads in its journal before it takes orders; without a journal it starts, and reads later.

A mount that slews from before must be stopped though the disk is full or PostgreSQL away. So the service
starts degraded: states are told, stops and parks taken, all else is refused with the reason. As soon as the
journal can be written, what was left out is made up for, and orders are taken. A fault of ours in that is
told and tried again: what was remembered is never left out.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from mountnav.errors import JournalFailed, MountnavError
from mountnav.journal.sql_journal import SqlJournal
from mountnav.tasks import begun, fault_words

_log = logging.getLogger(__name__)

_AGAIN_S = 1.0
"""Between tries to reach the journal, s. Doubled, orders are refused a second longer than it was away."""

Step = Callable[[], Awaitable[object]]


@dataclass(frozen=True, slots=True)
class _Owed:
    """A step that is still to be done, and whether the orders of all telescopes wait for it."""

    step: Step
    by_all: bool


class RestoredState:
    """Does what needs the journal once, in its order: now, or when there is one.

    Parameters
    ----------
    tell : callable (kind, data)
        Publishes an event.
    """

    def __init__(self, journal: SqlJournal, tell: Callable[[str, dict[str, object]], None]) -> None:
        self._journal = journal
        self._tell = tell
        self._owed: list[_Owed] = []
        self._lost = False
        """Whether it was told that no orders are taken."""
        self._fault: str | None = None
        self._mending: asyncio.Task[None] | None = None

    @property
    def problem(self) -> str | None:
        """Why no order can be taken just now but stops and parks; None when all is well."""
        if self._journal.problem is not None:
            return self._journal.problem
        if not self._waits:
            return None
        if self._fault is not None:
            return f"what was ordered before isn't known yet: the journal can't be read for {self._fault}"
        return "the journal is being read: what was ordered before isn't known yet"

    @property
    def _waits(self) -> bool:
        return any(step.by_all for step in self._owed)

    async def first(self, step: Step) -> None:
        """Do a step now that all orders wait for; if it can't be done yet it is owed, and all that follow.

        Raises
        ------
        MountnavError
            What the operator has to mend: the service doesn't start.
        """
        await self._do(_Owed(step, by_all=True))

    async def besides(self, step: Step) -> None:
        """The same of a step that only one telescope's orders wait for, which that one sees to itself."""
        await self._do(_Owed(step, by_all=False))

    async def _do(self, one: _Owed) -> None:
        if self._waits or self._journal.problem is not None:
            self._owed.append(one)
            return
        try:
            await one.step()
        except JournalFailed as failure:
            if one.by_all:
                _log.error("the service starts without its journal: %s", failure)
            self._owed.append(one)
        except MountnavError:
            raise
        except Exception as fault:
            # what moves from before must be stopped all the same
            self._faulted(fault)
            self._owed.append(one)

    def start(self) -> None:
        """From now on try to make up for what is owed."""
        self._lost = self._waits
        if self._lost:
            self._tell("journal-lost", {"why": self.problem})
        if self._owed:
            self._begin()

    def _begin(self) -> None:
        self._mending = begun(self._mend(), "journal mends", died=lambda fault: self._begin())

    async def close(self) -> None:
        """Try no more."""
        if self._mending is not None:
            self._mending.cancel()
            await asyncio.gather(self._mending, return_exceptions=True)

    async def _mend(self) -> None:
        while self._owed:
            await asyncio.sleep(_AGAIN_S)
            for step in tuple(self._owed):
                if self._journal.problem is not None or not await self._made_up_for(step):
                    # what comes after it may build on it
                    if step.by_all:
                        break
                    continue
                self._owed.remove(step)
            if self._lost and not self._waits:
                self._lost = False
                _log.warning("the journal is back: orders are taken")
                self._tell("journal-back", {})

    async def _made_up_for(self, one: _Owed) -> bool:
        try:
            await one.step()
        except JournalFailed as failure:
            if one.by_all:
                _log.warning("the journal can't be read yet: %s", failure)
            return False
        except Exception as fault:
            # never left out: without what was remembered an order might be carried out twice, or by a place
            # that doesn't count
            self._faulted(fault)
            return False
        if one.by_all:
            self._fault = None
        return True

    def _faulted(self, fault: Exception) -> None:
        words = fault_words(fault)
        if words != self._fault:
            _log.error("reading from the journal failed unexpectedly", exc_info=fault)
        self._fault = words


__all__ = ["RestoredState"]
