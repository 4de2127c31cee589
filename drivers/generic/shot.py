"""One exposure that somebody waits for, until it is aborted; and the turn that only one can have."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Iterator
from contextlib import contextmanager, suppress
from typing import TypeVar

from mountnav.errors import BadRequest, Busy, Cancelled, MountnavError
from mountnav.tasks import waited_for

T = TypeVar("T")


class Shot:
    """An exposure that was asked for.

    Parameters
    ----------
    exposure_s : float
    device : str
        For messages.
    """

    def __init__(self, exposure_s: float, device: str) -> None:
        self.exposure_s = exposure_s
        self.device = device
        self._aborted = asyncio.Event()

    @property
    def aborted(self) -> bool:
        """Whether nobody wants it any more."""
        return self._aborted.is_set()

    def abort(self) -> None:
        """Have whoever waits for it raise `Cancelled`."""
        self._aborted.set()

    def require_wanted(self) -> None:
        """Raise `Cancelled` if it was aborted."""
        if self.aborted:
            raise Cancelled("the exposure was aborted", device=self.device)

    async def pause(self, for_s: float) -> None:
        """Wait; raises `Cancelled` as soon as it is aborted."""
        with suppress(TimeoutError):
            async with asyncio.timeout(for_s):
                await self._aborted.wait()
        self.require_wanted()

    async def outlast(self, work: Awaitable[T]) -> T:
        """Wait for a piece of work; drops it and raises `Cancelled` as soon as it is aborted."""
        working = waited_for(work)
        waiting = waited_for(self._aborted.wait())
        try:
            await asyncio.wait({working, waiting}, return_when=asyncio.FIRST_COMPLETED)
            self.require_wanted()
            return await working
        finally:
            for one in (working, waiting):
                one.cancel()
            with suppress(asyncio.CancelledError, MountnavError):
                await working


class Turn:
    """One exposure at a time.

    Parameters
    ----------
    device : str
        For messages.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._shot: Shot | None = None

    @contextmanager
    def taken(self, exposure_s: float) -> Iterator[Shot]:
        """Begin a shot, and end it with the block.

        Raises
        ------
        BadRequest
            If the exposure is not positive.
        Busy
            If one runs.
        """
        if not 0.0 < exposure_s < math.inf:
            raise BadRequest(f"an exposure of {exposure_s} s", device=self._device, advice="longer than 0 s")
        if self._shot is not None:
            raise Busy("an exposure is running", device=self._device, advice="wait for it, or abort it")
        self._shot = Shot(exposure_s, self._device)
        try:
            yield self._shot
        finally:
            self._shot = None

    def abort(self) -> bool:
        """Abort the shot that runs; tell whether there is one."""
        if self._shot is None:
            return False
        self._shot.abort()
        return True
