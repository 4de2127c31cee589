"""A camera of frames without pixels that carry the true position, for whole nights in virtual time.

Only tests and benchmarks use it. It is here because both do, and neither may depend on the other's helpers;
`mountnav.testing` may not import drivers.
"""

from __future__ import annotations

from datetime import timedelta
from typing import Literal

import numpy as np

from drivers.generic.camera import ExposureLock
from mountnav.clock import Clock
from mountnav.frames import Frame
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.sky_seen import SeenThrough
from mountnav.simulation.truth_frame import FrameTruth
from mountnav.sky.sphere import position_angle_deg, separation_arcsec


class TruthCamera:
    """A `mountnav.devices.Camera` on a simulated mount, in its clock's time; `SkySeen` solves its frames.

    Parameters
    ----------
    clock : Clock
        The mechanics' own.
    script : SkyScript, optional
        Says which of its frames are stale.
    through : SeenThrough, optional
        Size of its frames.
    turned_deg : float
        How the camera is turned in the tube: position angle of +y minus the tube's own north.
    read_out_s : float
        Between the end of an exposure and its frame.
    clock_off_s : float
        The camera's clock minus UTC.
    habit : {"sound", "frozen", "one-behind"}
        "frozen": from frame `ails_from` on each frame has the pixels of that one; "one-behind": each has
        those of the exposure before it; both with the time of the present exposure.
    ails_from : int
        Number of the first frame with such a habit.

    Attributes
    ----------
    frames : int
        How many were exposed.
    """

    def __init__(
        self,
        mechanics: Mechanics,
        clock: Clock,
        script: SkyScript | None = None,
        through: SeenThrough | None = None,
        *,
        turned_deg: float = 0.0,
        read_out_s: float = 0.3,
        clock_off_s: float = 0.0,
        habit: Literal["sound", "frozen", "one-behind"] = "sound",
        ails_from: int = 0,
        name: str = "truth camera",
    ) -> None:
        self._mechanics = mechanics
        self._clock = clock
        self._script = script or SkyScript()
        self._through = through or SeenThrough()
        self._turned_deg = turned_deg
        self._read_out_s = read_out_s
        self._clock_off_s = clock_off_s
        self._habit = habit
        self._ails_from = ails_from
        self._held: FrameTruth | None = None
        self._name = name
        self._exposing = ExposureLock(name)
        self._last: Frame | None = None
        self.frames = 0

    @property
    def name(self) -> str:
        """Name, for messages."""
        return self._name

    async def open(self) -> None:
        """Do nothing."""

    async def close(self) -> None:
        """End a running exposure, if there is one."""
        await self.abort()

    async def expose(self, exposure_s: float) -> Frame:
        """Wait for the length of the exposure; the frame says where the tube pointed in its middle.

        Raises
        ------
        BadRequest
            If the exposure time is not positive.
        Busy
            If an exposure runs already.
        Cancelled
            If `abort` ended it.
        """
        with self._exposing.hold(exposure_s) as shot:
            began = self._clock.utc()
            await shot.outlast(self._clock.sleep(exposure_s + self._read_out_s))
        number, self.frames = self.frames, self.frames + 1
        stale = np.random.default_rng([self._script.seed % 2**32, number, 1]).random()
        if self._last is not None and stale < self._script.stale_share:
            return self._last
        middle = began + timedelta(seconds=exposure_s / 2.0)
        end = began + timedelta(seconds=exposure_s)
        first, center, last = (self._mechanics.truth(utc) for utc in (began, middle, end))
        truth = FrameTruth(
            center,
            (self._mechanics.tube_angle_deg(middle) + self._turned_deg) % 360.0,
            max(separation_arcsec(first, center), separation_arcsec(center, last)) * 2.0,
            number,
            position_angle_deg(first, last),
        )
        shown, self._held = self._shown(truth)
        self._last = shown.frame(
            self._through.width_px,
            self._through.height_px,
            exposure_s,
            middle + timedelta(seconds=self._clock_off_s),
            f"{self._name} {number}",
        )
        return self._last

    def mend(self) -> None:
        """Repair its frames and its clock."""
        self._habit, self._clock_off_s = "sound", 0.0

    def _shown(self, truth: FrameTruth) -> tuple[FrameTruth, FrameTruth]:
        """The truth that the frame carries, and the one that is held back for the next."""
        held = self._held
        if held is None or self._habit == "sound" or truth.number <= self._ails_from:
            return truth, truth
        return held, (held if self._habit == "frozen" else truth)

    async def abort(self) -> None:
        """End a running exposure; its `expose` raises `Cancelled`. Without one, nothing happens."""
        self._exposing.abort()
