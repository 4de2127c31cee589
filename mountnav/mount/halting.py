"""Ending a motion or the tracking at a limit, by stop, rest or park; written down, told, and watched."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable
from typing import Protocol

from mountnav.clock import Clock
from mountnav.devices import MountReading, Skill, SlewOutcome, TrackingRate
from mountnav.errors import DeviceError, DeviceRefused, LimitKind, MountnavError
from mountnav.journal.records import EntryKind, because
from mountnav.mount.guarding import Guard
from mountnav.mount.standing import Listener
from mountnav.mount.written_orders import OrderBook
from mountnav.navigation.kinds import from_mount
from mountnav.sky.sphere import separation_arcsec
from mountnav.tasks import waited_for

SLEWING_S = 1.0
"""How often a motion is looked at."""
_WATCHED_S = 4.0
_TELL_AGAIN_S = 60.0


class Watched(Protocol):
    """What the watch asks of the mount, and orders."""

    @property
    def skills(self) -> frozenset[Skill]:
        """What it can do."""
        ...

    @property
    def trusted(self) -> bool:
        """Whether its position counts."""
        ...

    async def reading(self) -> MountReading:
        """Where it is."""
        ...

    async def stop(self) -> None:
        """Stop it."""
        ...

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Track or rest."""
        ...

    async def park(self) -> SlewOutcome:
        """Park it."""
        ...


class Halting:
    """Ends what one mount does, by orders that are checked and written like any other.

    Parameters
    ----------
    mount : Watched
    guard : Guard
    book : OrderBook
    clock : Clock
    tell : callable
        Told ``limit-stop``, ``limit-stop-failed``.
    under_way : callable
        Whether an order to move runs.
    look : callable
        Looks at that order once.
    """

    def __init__(
        self,
        mount: Watched,
        guard: Guard,
        book: OrderBook,
        clock: Clock,
        tell: Listener,
        *,
        under_way: Callable[[], bool],
        look: Callable[[], Awaitable[None]],
    ) -> None:
        self._mount = mount
        self._guard = guard
        self._book = book
        self._clock = clock
        self._tell = tell
        self._under_way = under_way
        self._look = look
        self._failed_s = -math.inf
        self._over = asyncio.Event()
        self._over.set()

    async def over(self) -> None:
        """Wait until what is being ended has ended: an order before that would be stopped as well."""
        await self._over.wait()

    async def halt(self, reading: MountReading, limit: LimitKind, what: str, *, motion: bool) -> bool:
        """End the motion or the tracking, write it down and tell; whether it was done.

        Parameters
        ----------
        reading : MountReading
            That showed it.
        limit : LimitKind
        what : str
            Why, in words.
        motion : bool
            Whether it moves, rather than tracks.
        """
        self._over.clear()
        try:
            return await self._halted(reading, limit, what, motion)
        finally:
            self._over.set()

    async def _halted(self, reading: MountReading, limit: LimitKind, what: str, motion: bool) -> bool:
        seen = self._guard.seen(reading)
        facts: dict[str, object] = {
            "limit": str(limit),
            "why": what,
            "ra_deg": reading.place.ra_deg,
            "dec_deg": reading.place.dec_deg,
            "altitude_deg": seen.alt_deg,
            "azimuth_deg": seen.az_deg,
            "side": None if reading.pier_side is None else str(reading.pier_side),
        }
        again = self._clock.monotonic_s() < self._failed_s + _TELL_AGAIN_S
        if not again:
            self._book.note_now(EntryKind.FAULT, "to be stopped at a limit", facts)
        try:
            with because(why=f"limits: {what}"):
                if limit is LimitKind.SUN and not motion and self._guard.sun_would_come(reading):
                    await self._flee()
                else:
                    await self._end(motion)
        except MountnavError as error:
            facts["error"] = str(error)
            if again:
                return False
            self._failed_s = self._clock.monotonic_s()
            self._book.note_now(EntryKind.FAULT, "could not be stopped at a limit", facts)
            self._tell("limit-stop-failed", facts)
            return False
        self._tell("limit-stop", facts)
        return True

    async def _flee(self) -> None:
        """Get out of the Sun's way: a tube west of it that stands still is where the Sun will be."""
        if Skill.PARK not in self._mount.skills or not self._mount.trusted:
            raise DeviceRefused(
                "it tracks on: standing still it would have the Sun come over it, and can't park"
            )
        await self._park()

    async def _end(self, motion: bool) -> None:
        if motion:
            await self._mount.stop()
            if self._under_way():
                return  # the slew that was stopped tells of it; tracking is judged for itself
        if Skill.TRACK in self._mount.skills:
            try:
                await self._mount.set_tracking(False)
            except DeviceError:
                await self._mount.stop()
                raise
            return
        if not motion:
            await self._mount.stop()
        # many old mounts track on after a stop, and have no words for ending that: parked they rest
        if await self._tracks():
            if Skill.PARK not in self._mount.skills:
                raise DeviceRefused("it tracks on after a stop, and can neither rest nor park")
            await self._park()

    async def _park(self) -> None:
        """Park it. Whoever watches is here and waits for that, so its way is looked at from here."""
        parking = waited_for(self._mount.park())
        try:
            while not parking.done():
                pause = waited_for(self._clock.sleep(SLEWING_S))
                try:
                    await asyncio.wait({parking, pause}, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    pause.cancel()
                if not parking.done():
                    with contextlib.suppress(MountnavError):  # the next look may be answered; it parks on
                        await self._look()
        finally:
            if not parking.done():
                parking.cancel()
            # what became of it is told below; it must have ended either way
            await asyncio.gather(parking, return_exceptions=True)
        if parking.result() is SlewOutcome.STALLED:
            raise DeviceError(
                "it came to rest on its way to its park position",
                advice="look at the mount: is an axis blocked or a clutch open?",
            )

    async def _tracks(self) -> bool:
        """Whether it follows the sky, by two readings."""
        before = await self._mount.reading()
        if before.tracking is not None:
            return before.tracking
        await self._clock.sleep(_WATCHED_S)
        after = await self._mount.reading()
        seconds = (after.utc - before.utc).total_seconds()
        moved = separation_arcsec(from_mount(before.place), from_mount(after.place))
        turned = 15.0 * seconds * math.cos(math.radians(after.place.dec_deg))
        return moved < 0.5 * turned
