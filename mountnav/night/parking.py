"""What a night needs of a telescope, and the park that it orders.

The park goes past what holds the telescope, and is sent again while what hinders may pass.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Literal, Protocol

from mountnav.clock import Clock
from mountnav.devices import MountReading
from mountnav.errors import Busy, DeviceMissing, DeviceSilent, JournalFailed, MountnavError, SyncDoubt
from mountnav.frames import Frame
from mountnav.journal.records import EntryKind, because
from mountnav.navigation.reading_history import Meanwhile
from mountnav.navigation.reports import Look
from mountnav.night.events import Decision, Why
from mountnav.night.memory import PARK_OVER, Listen, NightNotes, OwedPark
from mountnav.sky.coordinates import Icrs, Site
from mountnav.solution import Verdict

__all__ = ["NightParking", "Preempt"]


By = Literal["sync", "offset", "model"]


class FrameLooked(Protocol):
    """A frame that somebody else exposed, compared with what the mount believed then."""

    @property
    def look(self) -> Look | None:
        """None where it was not identified, or there are no readings round it."""
        ...

    @property
    def doubts(self) -> tuple[SyncDoubt, ...]:
        """Why it must not be used for a correction."""
        ...

    @property
    def why(self) -> str:
        """In words."""
        ...

    @property
    def meanwhile(self) -> Meanwhile | None:
        """What it was compared by, for recordings."""
        ...


class Corrected(Protocol):
    """What came of a correction."""

    @property
    def outcome(self) -> str:
        """In words."""
        ...

    @property
    def moved_arcsec(self) -> float:
        """How far the tube was sent; 0 when the mount was only synced."""
        ...


class Segmented(Protocol):
    """A mount that announces when its zero points change, and knows where it stands."""

    @property
    def segment_id(self) -> str:
        """Between two changes of them."""
        ...

    @property
    def site(self) -> Site:
        """Where on Earth it stands."""
        ...


class NightTelescope(Protocol):
    """A telescope that a night may ask and correct."""

    @property
    def activity(self) -> str:
        """What holds it: "idle", or what runs."""
        ...

    @property
    def mount(self) -> Segmented:
        """Its mount, as far as a night looks at it."""
        ...

    async def read_mount(self) -> MountReading:
        """Read the mount once, whatever runs; kept for frames that come later. Raises `DeviceError`."""
        ...

    def believed(self, utc: datetime) -> Icrs | None:
        """Where the mount believed to be then; None where no readings show it."""
        ...

    async def frame(self, frame: Frame, verdict: Verdict, *, used: str = "night") -> FrameLooked:
        """Compare a frame with the readings round its exposure, and write the look down.

        Raises `BadFrame`, `DeviceError`, `JournalFailed`.
        """
        ...

    async def correct(
        self,
        look: Look,
        *,
        by: By,
        target: Icrs | None,
        key: str,
        heard: Callable[[object], None] | None = None,
    ) -> Corrected:
        """Correct the mount by a look, guarded; `heard` gets what it is judged by, before it is done.

        Raises `SyncRefused`, `Busy`, `OutsideLimits`, `DeviceError`.
        """
        ...

    async def park(self) -> object:
        """Park it, within its limits."""
        ...


_log = logging.getLogger(__name__)

AGAIN_S = 15.0
"""A park that failed is ordered again after so long, s. Chosen by hand: a lost link comes back in some
seconds. Doubled, a telescope stands in the rain for as long more."""
PATIENCE_S = 3600.0
"""So long the morning's park waits for work with the telescope, s; a park for rain doesn't wait. Chosen by
hand. Doubled, a telescope may be open two hours after dawn."""
_PASSING = (Busy, DeviceMissing, DeviceSilent, JournalFailed)

Preempt = Callable[[], Awaitable[None]]
"""Ends what others do with a telescope, and stops it. Raises `DeviceError`."""


@dataclass(slots=True)
class _Owed:
    park: OwedPark
    since_s: float
    next_s: float
    told: bool = False

    @property
    def why(self) -> Why:
        return self.park.decision.why


class NightParking:
    """Parks one telescope.

    Parameters
    ----------
    name : str
        Of the telescope.
    listen : callable
        Told ``night-park-waits``, ``night-park-failed``, and ``night-parked`` where it had waited.
    make_way : callable, optional
        Used where it is unsafe: all work with the telescope is stopped then.
    """

    def __init__(
        self,
        telescope: NightTelescope,
        name: str,
        notes: NightNotes,
        listen: Listen,
        clock: Clock,
        make_way: Preempt | None = None,
    ) -> None:
        self._telescope = telescope
        self._name = name
        self._notes = notes
        self._listen = listen
        self._clock = clock
        self._make_way = make_way
        self._owed: _Owed | None = None

    async def park(self, decision: Decision, night_id: str) -> None:
        """Park now; if somebody holds the telescope, or it can't be reached, as soon as that is over."""
        before = None if self._owed is None else self._owed.park.after(decision, night_id)
        self.owe(before or OwedPark(decision, night_id))
        await self.again()

    def owe(self, park: OwedPark) -> None:
        """Park at the next `again`: so it was decided, maybe before the service was restarted."""
        now_s = self._clock.monotonic_s()
        self._owed = _Owed(park, now_s, now_s)

    async def again(self) -> None:
        """Try again what is owed, when it is time. To be called every few seconds."""
        owed, now_s = self._owed, self._clock.monotonic_s()
        if owed is not None and now_s >= owed.next_s:
            await self._try(owed)

    def decided(self, decision: Decision) -> None:
        """Owe nothing any more if a decision takes the reason away, or says that somebody has taken over."""
        if self._owed is not None and self._owed.park.after(decision, "") is None:
            self._owed = None

    async def _try(self, owed: _Owed) -> None:
        # not before this try has ended
        owed.next_s = math.inf
        try:
            await self._tried(owed)
        finally:
            # what is still owed is tried again, also after a fault of ours
            owed.next_s = self._clock.monotonic_s() + AGAIN_S

    async def _tried(self, owed: _Owed) -> None:
        why = f"night: {owed.why}"
        try:
            with because(night_id=owed.park.night_id, why=why):
                if owed.why is Why.UNSAFE and self._make_way is not None:
                    await self._make_way()
                await self._telescope.park()
        except _PASSING as error:
            await self._not_yet(owed, error)
            return
        except MountnavError as error:
            await self._failed(owed, error)
        else:
            if owed.told:
                self._listen("night-parked", {"why": str(owed.why)})
            await self._over(owed, "parked at last" if owed.told else "parked")
        self._done(owed)

    async def _not_yet(self, owed: _Owed, error: MountnavError) -> None:
        waited_s = self._clock.monotonic_s() - owed.since_s
        if owed.why is not Why.UNSAFE and waited_s > PATIENCE_S:
            self._done(owed)
            await self._failed(owed, error)
            return
        if not owed.told:
            owed.told = True
            _log.error("%s could not be parked yet: %s", self._name, error)
            self._listen("night-park-waits", {"problem": str(error)})
            await self._notes.note(EntryKind.FAULT, f"not parked yet: {error}")

    def _done(self, owed: _Owed) -> None:
        # what came meanwhile stays owed
        if self._owed is owed:
            self._owed = None

    async def _failed(self, owed: _Owed, error: MountnavError) -> None:
        _log.error("%s could not be parked: %s", self._name, error)
        self._listen("night-park-failed", {"problem": str(error)})
        await self._notes.note(EntryKind.FAULT, f"not parked: {error}")
        await self._over(owed, f"not parked ({error})")

    async def _over(self, owed: _Owed, how: str) -> None:
        """Written down, so that a service that starts again doesn't park once more."""
        why = str(owed.why)
        await self._notes.note(EntryKind.NIGHT, f"{how}: {why}", {"act": PARK_OVER, "why": why})
