"""What a series remembers of its sources: which were seen in how many frames, size by size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.plate import Plate
from mountnav.identification.selection import all_finite
from mountnav.series.followed import Look, Size
from mountnav.series.persistence import Persistence
from mountnav.series.results import FrameResult, Shift
from mountnav.series.shift import pixels, places

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class SeriesMemory:
    """The sources of a series.

    Parameters
    ----------
    frames : int
        In so many of them a source is persistent.
    """

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._of_size: dict[Size, Persistence] = {}
        self._ids: dict[int, Index] = {}

    def carry(self, size: Size, old: Plate | None, new: Plate | None) -> None:
        """Go on in the pixels of another anchor; begin anew where either has no plate."""
        memory = self._of_size.get(size)
        if memory is None or old is None or new is None:
            self._of_size[size] = Persistence(self._frames)
            return

        def to_new(x: Array, y: Array) -> tuple[Array, Array]:
            new_x, new_y = pixels(new, *places(old, x, y))
            far = (np.abs(new_x - new.center_x_px) > 1.5 * size[0]) | (
                np.abs(new_y - new.center_y_px) > 1.5 * size[1]
            )
            return np.where(far, np.nan, new_x), np.where(far, np.nan, new_y)

        memory.change_pixels(to_new)

    def added(self, look: Look, shift: Shift | None, result: FrameResult) -> FrameResult:
        """Add the frame's sources to what is known of the series."""
        m = look.measurements
        chosen = all_finite(m)
        dx, dy = (shift.dx_px, shift.dy_px) if shift else (0.0, 0.0)
        fwhm = m.fwhm_px[chosen]
        fwhm = fwhm[np.isfinite(fwhm)]
        reach = max(1.5, 0.6 * float(np.median(fwhm))) if fwhm.size else 1.5
        memory = self._of_size[look.size]
        ids = memory.add(m.x_px[chosen] + dx, m.y_px[chosen] + dy, m.flux[chosen], reach)
        self._ids[result.number] = ids
        return replace(result, persistent=int(memory.persistent(ids).sum()))

    def recounted(self, result: FrameResult) -> FrameResult:
        """A frame with its persistent sources as they are known now."""
        ids = self._ids.get(result.number)
        if ids is None:
            return result
        memory = self._of_size[(result.width_px, result.height_px)]
        return replace(result, persistent=int(memory.persistent(ids).sum()))

    def knows(self, result: FrameResult) -> bool:
        """Whether the frame's sources are known."""
        return result.number in self._ids

    def of_size(self, size: Size) -> Persistence:
        """What is known of the frames of one size."""
        return self._of_size[size]
