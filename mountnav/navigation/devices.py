"""What a Mount and a Camera can do, as navigation sees them. Small and async; drivers fulfil these."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Literal, Protocol

from mountnav.frames import Frame
from mountnav.sky.coordinates import Apparent, Icrs

Epoch = Literal["apparent", "icrs"]


@dataclass(frozen=True, slots=True)
class MountReading:
    """What the mount says of itself at `utc` (instant between question and answer).

    `place` is in the mount's own kind of coordinates: `Apparent` for JNow mounts, `Icrs` for J2000 mounts.
    `slewing` is None where the mount was not asked.
    """

    place: Apparent | Icrs
    utc: datetime
    slewing: bool | None = None


class SlewOutcome(StrEnum):
    """How a slew ended."""

    ARRIVED = "arrived"
    STALLED = "stalled"
    STOPPED = "stopped"


class Mount(Protocol):
    """A mount: reading, slew, sync, stop. All raise `DeviceError`s; none swallows an outcome."""

    @property
    def name(self) -> str:
        """Name and address, for messages."""
        ...

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates this mount speaks."""
        ...

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step of a commanded or reported place."""
        ...

    async def open(self) -> None:
        """Connect and identify. Never moves, never syncs, never sets time or site."""
        ...

    async def close(self) -> None:
        """Release the line."""
        ...

    async def reading(self) -> MountReading:
        """Where the mount believes it points, now."""
        ...

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        """Go there; return when at rest (arrived, stalled or stopped). `DeviceRefused` when it says no."""
        ...

    async def sync(self, place: Apparent | Icrs) -> None:
        """Tell the mount that it points there. Raises `DeviceRefused` when it says no. No read-back here."""
        ...

    async def stop(self) -> None:
        """Stop all motion now. Own path: never queued behind another exchange."""
        ...


class Camera(Protocol):
    """A camera: expose, abort."""

    @property
    def name(self) -> str:
        """Name, for messages."""
        ...

    async def open(self) -> None:
        """Get ready."""
        ...

    async def close(self) -> None:
        """Release."""
        ...

    async def expose(self, exposure_s: float) -> Frame:
        """Take one frame; `mid_exposure_utc` must be set."""
        ...

    async def abort(self) -> None:
        """End a running exposure; the pending `expose` raises `Cancelled`."""
        ...
