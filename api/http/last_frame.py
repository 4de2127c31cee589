"""The last frame of a telescope that was solved for it, kept in memory for whoever wants to see it."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from datetime import datetime
from uuid import uuid4

from api.http.preview import Preview, preview_of
from mountnav.frames import Frame, Hint
from mountnav.navigation.equipment import Solve
from mountnav.sky.coordinates import Icrs, utc_now
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings


@dataclass(slots=True)
class Kept:
    """A frame and what became of it.

    Attributes
    ----------
    id : str
        Of its own, for caches.
    solved_utc : datetime
        When the verdict was there.
    frame : Frame or None
        Let go once its preview was made.
    width_px, height_px : int
        Of the frame.
    believed : Icrs or None
        Where the mount believed the frame's center to be.
    verdict : Verdict
    preview : Preview or None
        Made when somebody asks for it.
    """

    id: str
    solved_utc: datetime
    frame: Frame | None
    source: str
    mid_exposure_utc: datetime | None
    exposure_s: float | None
    width_px: int
    height_px: int
    believed: Icrs | None
    verdict: Verdict
    preview: Preview | None = None


class LastFrame:
    """A solver that also remembers the last frame it solved. It listens; it never steers.

    Only the newest frame is held: one frame's memory for each telescope, and once somebody looked at it only
    a small picture.

    Parameters
    ----------
    solve : Solve
        Who truly solves.
    """

    def __init__(self, solve: Solve) -> None:
        self._solve = solve
        self._making = asyncio.Lock()
        self.kept: Kept | None = None

    async def __call__(self, frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        """Solve, and remember; as `mountnav.navigation.equipment.Solve`."""
        verdict = await self._solve(frame, hint, settings)
        self.kept = Kept(
            id=uuid4().hex[:16],
            solved_utc=utc_now(),
            frame=frame,
            source=frame.source,
            mid_exposure_utc=frame.mid_exposure_utc,
            exposure_s=frame.exposure_s,
            width_px=frame.width_px,
            height_px=frame.height_px,
            believed=hint.center,
            verdict=verdict,
        )
        return verdict

    async def preview(self) -> tuple[Kept, Preview] | None:
        """Make the picture of the frame that is the last one now, if there is one."""
        async with self._making:
            kept = self.kept
            if kept is None:
                return None
            if kept.preview is None:
                assert kept.frame is not None
                kept.preview = await asyncio.to_thread(preview_of, kept.frame.pixels)
                kept.frame = None
            return kept, kept.preview


__all__ = ["Kept", "LastFrame"]
