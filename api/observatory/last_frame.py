"""The last solved frame of each telescope, kept in memory, and its preview picture.

A preview is binned down and stretched so that faint stars show; it is not turned to have north up.
"""

from __future__ import annotations

import asyncio
import io
from collections import deque
from dataclasses import dataclass
from datetime import datetime
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from mountnav.clock import utc_now
from mountnav.frames import Frame, Hint
from mountnav.navigation.equipment import Solve
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings

__all__ = ["LARGEST_PX", "MEDIA_TYPE", "Kept", "LastFrame", "Preview", "SkySeen", "preview_of"]


LARGEST_PX = 1400
"""Neither side of a preview is longer."""
MEDIA_TYPE = "image/webp"
_QUALITY = 72
"""WebP quality, 0 to 100; chosen by hand. Lower, fewer bytes, and faint stars are lost in the blocks."""
_SAMPLE = 400_000
"""Pixels that the sky level and its noise are estimated from, at the most about; chosen by hand. Halved,
the estimate's own error grows by 1.4; doubled, a preview takes longer."""
_SEEN_AT_MOST = 2000
"""So many frames' figures of the sky are remembered, some 200 kB: a night of a look every twenty seconds.
Halved, the strip of a long night of short exposures begins in its middle."""
# the sky lies a little above black, and a star of some hundred sigmas is white
_BLACK_SIGMAS, _WHITE_SIGMAS, _SOFT = 1.5, 300.0, 0.02


@dataclass(frozen=True, slots=True)
class Preview:
    """A picture of a frame.

    Attributes
    ----------
    content : bytes
        Of `MEDIA_TYPE`; its rows run from the top down, so the file's first row is at the bottom.
    width_px, height_px : int
        Of the picture.
    binned : int
        So many pixels of the frame are one of the picture, each way.
    """

    content: bytes
    width_px: int
    height_px: int
    binned: int


def preview_of(pixels: NDArray[Any]) -> Preview:
    """Draw a preview; takes some tens of milliseconds, in a thread.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        In file order; NaN marks missing pixels.
    """
    from PIL import Image  # not needed by a service that nobody looks at

    small, binned = _binned(pixels)
    gray = _stretched(small)[::-1]
    content = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(gray)).save(content, "WEBP", quality=_QUALITY, method=2)
    return Preview(content.getvalue(), gray.shape[1], gray.shape[0], binned)


def _binned(pixels: NDArray[Any]) -> tuple[NDArray[np.float32], int]:
    height, width = pixels.shape
    by = max(1, -(-max(height, width) // LARGEST_PX))
    if by == 1 or min(height, width) < by:
        return pixels.astype(np.float32), 1
    rows, columns = height // by, width // by
    cells = pixels[: rows * by, : columns * by].reshape(rows, by, columns, by)
    return cells.mean(axis=(1, 3), dtype=np.float32), by


def _stretched(gray: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Bytes on a scale that is linear near the sky's noise and logarithmic far above it."""
    sample = gray.reshape(-1)[:: max(1, gray.size // _SAMPLE)]
    sample = sample[np.isfinite(sample)]
    if sample.size == 0:
        return np.zeros(gray.shape, dtype=np.uint8)
    sky = float(np.median(sample))
    # noise from the lower half: stars widen the upper one only
    sigma = 1.4826 * float(np.median(np.abs(sample[sample <= sky] - sky))) if sample.size else 0.0
    sigma = sigma or float(np.std(sample)) or 1.0
    level = (gray - (sky - _BLACK_SIGMAS * sigma)) / ((_BLACK_SIGMAS + _WHITE_SIGMAS) * sigma)
    level = np.clip(np.nan_to_num(level, nan=0.0), 0.0, 1.0)
    shown = np.arcsinh(level / _SOFT) / np.arcsinh(1.0 / _SOFT)
    return np.asarray(np.round(255.0 * shown), dtype=np.uint8)


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


@dataclass(frozen=True, slots=True)
class SkySeen:
    """What a solved frame showed of the sky.

    Attributes
    ----------
    utc : datetime
        Mid-exposure; when it was solved, where the frame tells none.
    fwhm_arcsec, zero_point_mag, limiting_mag : float or None
        As `mountnav.measuring.measurements.SkyQuality` has them.
    exposure_s : float or None
        None: not known.
    """

    utc: datetime
    fwhm_arcsec: float | None
    zero_point_mag: float | None
    limiting_mag: float | None
    exposure_s: float | None


class LastFrame:
    """A solver that also remembers the last frame it solved. It listens; it never steers.

    Only the newest frame is held: one frame's memory for each telescope, and once somebody looked at it only
    a small picture. Of those before, `seen` keeps what they showed of the sky.

    Parameters
    ----------
    solve : Solve
        Who truly solves.
    """

    def __init__(self, solve: Solve) -> None:
        self._solve = solve
        self._making = asyncio.Lock()
        self.kept: Kept | None = None
        self.seen: deque[SkySeen] = deque(maxlen=_SEEN_AT_MOST)

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
        quality = verdict.quality
        if verdict.solution is not None and quality is not None:
            self.seen.append(
                SkySeen(
                    utc=frame.mid_exposure_utc or self.kept.solved_utc,
                    fwhm_arcsec=quality.fwhm_arcsec,
                    zero_point_mag=quality.zero_point_mag,
                    limiting_mag=quality.limiting_mag,
                    exposure_s=frame.exposure_s,
                )
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
