"""What a night needs of a telescope; `mountnav.navigation.navigator.Navigator` has it."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Literal, Protocol

from mountnav.devices import MountReading
from mountnav.errors import SyncDoubt
from mountnav.frames import Frame
from mountnav.navigation.readings_kept import Meanwhile
from mountnav.navigation.reports import Look
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Verdict

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
        """How far the tube was sent; 0 when the mount was only told where it points."""
        ...


class Segmented(Protocol):
    """A mount that tells when its zero points change."""

    @property
    def segment_id(self) -> str:
        """Between two changes of them."""
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

    async def glance(self) -> MountReading:
        """Read the mount once, whatever runs; kept for frames that come later. Raises `DeviceError`."""
        ...

    def believed(self, utc: datetime) -> Icrs | None:
        """Where the mount believed to be then; None where no readings tell."""
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
        """Correct the mount by a look, guarded; `heard` is told what it is judged by, before it is done.

        Raises `SyncRefused`, `Busy`, `OutsideLimits`, `DeviceError`.
        """
        ...

    async def park(self) -> object:
        """Park it, within its limits."""
        ...
