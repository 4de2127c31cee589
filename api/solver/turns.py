"""Who may solve next: looks before uploads, and each owner as much as the others."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

LONGEST_S = 3600.0
"""Of a turn, as it is charged: a budget is at most as long, and a clock that jumps charges no more."""


@dataclass(slots=True, eq=False)
class _Waiting:
    owner: str
    first: bool
    number: int
    begins: asyncio.Future[None]


@dataclass(slots=True)
class _Account:
    """What an owner had, in seconds; after a pause he begins with what the least of the others had.

    Attributes
    ----------
    waiting, held : int
        Requests that wait, and places that are held now.
    """

    used_s: float = 0.0
    waiting: int = 0
    held: int = 0


@dataclass(slots=True)
class Turns:
    """Gives a number of places to those who ask for one.

    Looks go before uploads. Of those who wait, the owner goes next who holds the fewest places, and of these
    the one who had the least time. One place is never given to uploads, nor to an owner who holds all others:
    another telescope's look finds it free however many frames are under way.

    Parameters
    ----------
    places : int
        How many there are; 2 at least.
    """

    places: int
    now_s: Callable[[], float] = time.monotonic
    _waiting: list[_Waiting] = field(default_factory=list)
    _accounts: dict[tuple[bool, str], _Account] = field(default_factory=dict)
    _numbers: itertools.count[int] = field(default_factory=itertools.count)

    @property
    def held(self) -> int:
        """Places that are in use."""
        return sum(one.held for one in self._accounts.values())

    @property
    def waiting(self) -> int:
        """Requests without a place."""
        return len(self._waiting)

    @asynccontextmanager
    async def turn(self, owner: str, *, first: bool) -> AsyncIterator[None]:
        """Wait for a place, and hold it within this.

        Parameters
        ----------
        owner : str
            A telescope, or who sent an upload.
        first : bool
            Whether it is a look.
        """
        await self.take(owner, first=first)
        began_s = self.now_s()
        try:
            yield
        finally:
            self.give_back(owner, first=first, used_s=self.now_s() - began_s)

    async def take(self, owner: str, *, first: bool) -> None:
        """Wait for a place. Who is cancelled while he waits holds none."""
        account = self._account(owner, first=first)
        one = _Waiting(owner, first, next(self._numbers), asyncio.get_running_loop().create_future())
        account.waiting += 1
        self._waiting.append(one)
        self._give()
        try:
            await one.begins
        except asyncio.CancelledError:
            if one.begins.done() and not one.begins.cancelled():
                self.give_back(owner, first=first, used_s=0.0)
            else:
                self._waiting.remove(one)
                account.waiting -= 1
                self._forget(owner, first=first)
            raise

    def give_back(self, owner: str, *, first: bool, used_s: float) -> None:
        """Let a place go that was taken."""
        account = self._accounts[first, owner]
        account.held -= 1
        account.used_s += min(max(0.0, used_s), LONGEST_S)
        self._forget(owner, first=first)
        self._give()

    def _account(self, owner: str, *, first: bool) -> _Account:
        found = self._accounts.setdefault((first, owner), _Account())
        if not found.waiting and not found.held:
            # who paused has saved nothing up
            busy = [one.used_s for one in self._accounts.values() if one.waiting or one.held]
            found.used_s = max(found.used_s, min(busy, default=0.0))
        return found

    def _forget(self, owner: str, *, first: bool) -> None:
        """Keep no account of who neither waits nor holds and owes nothing; strangers are without number."""
        account = self._accounts[first, owner]
        if account.waiting or account.held:
            return
        busy = [one.used_s for one in self._accounts.values() if one.waiting or one.held]
        if not busy:
            self._accounts.clear()
        elif account.used_s <= min(busy):
            del self._accounts[first, owner]

    def _give(self) -> None:
        while (one := self._next()) is not None:
            self._waiting.remove(one)
            account = self._accounts[one.first, one.owner]
            account.waiting -= 1
            account.held += 1
            one.begins.set_result(None)

    def _next(self) -> _Waiting | None:
        """Who goes next, if there is a place for anyone."""
        free = self.places - self.held
        if free <= 0:
            return None
        uploads = sum(one.held for (first, _), one in self._accounts.items() if not first)
        most = self.places - 1

        def may(one: _Waiting) -> bool:
            if not one.first and uploads >= most:
                return False
            return self._accounts[one.first, one.owner].held < most

        def worth(one: _Waiting) -> tuple[bool, int, float, int]:
            account = self._accounts[one.first, one.owner]
            return not one.first, account.held, account.used_s, one.number

        return min(
            (one for one in self._waiting if not one.begins.done() and may(one)), key=worth, default=None
        )
