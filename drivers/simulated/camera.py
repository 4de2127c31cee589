"""A camera that draws the sky where the telescope truly points, not where the mount believes to point."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime, timedelta

from drivers.generic.camera import ExposureLock
from mountnav.catalog.stars import Catalog
from mountnav.clock import real_s, utc_now
from mountnav.frames import Frame
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.simulation.trails import MovingBody
from mountnav.sky.coordinates import Icrs


class SimulatedCamera:
    """A `mountnav.devices.Camera` that draws its frames.

    Parameters
    ----------
    truth : callable
        Gives where the optical axis truly points at a time, e.g. `Mechanics.truth`.
    optics : SimulatedOptics
        Telescope and camera.
    catalog : Catalog
        Stars to draw.
    seed : int
        Of the noise: frame n of a camera with the same seed has the same noise.
    name : str
        For messages.
    clock : callable
        Gives the present time; the same as the mechanics'.
    tube_angle_deg : callable, optional
        Gives the position angle of the tube's own north at a time, e.g. `Mechanics.tube_angle_deg`: on the
        other side of the pier the image is upside down. Left out: north is always up.
    bodies : sequence of MovingBody
        What moves among the stars, and is drawn as it moves in the frame.
    """

    def __init__(
        self,
        truth: Callable[[datetime], Icrs],
        optics: SimulatedOptics,
        catalog: Catalog,
        *,
        seed: int = 0,
        name: str = "simulated camera",
        clock: Callable[[], datetime] = utc_now,
        tube_angle_deg: Callable[[datetime], float] | None = None,
        bodies: Sequence[MovingBody] = (),
    ) -> None:
        self._truth = truth
        self._optics = optics
        self._catalog = catalog
        self._seed = seed
        self._name = name
        self._clock = clock
        self._tube_angle_deg = tube_angle_deg
        self._bodies = tuple(bodies)
        self._frames = 0
        self._exposing = ExposureLock(name)

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
        """Wait for the length of the exposure, then draw the sky where the tube truly looked meanwhile.

        Stars are trailed as far as it moved among them.

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
            number, self._frames = self._frames, self._frames + 1
            mid_utc = self._clock() + timedelta(seconds=exposure_s / 2.0)
            await shot.pause(real_s(exposure_s))
            frame = await asyncio.to_thread(self._draw, exposure_s, mid_utc, number)
            shot.require_wanted()
            return frame

    async def abort(self) -> None:
        """End a running exposure; its `expose` raises `Cancelled`. Without one, nothing happens."""
        self._exposing.abort()

    def _draw(self, exposure_s: float, mid_utc: datetime, number: int) -> Frame:
        optics = self._optics
        if self._tube_angle_deg is not None:
            optics = replace(optics, rotation_deg=optics.rotation_deg + self._tube_angle_deg(mid_utc))
        return draw_frame(
            self._truth(mid_utc),
            optics,
            self._catalog,
            exposure_s=exposure_s,
            mid_exposure_utc=mid_utc,
            seed=(self._seed, number),
            tube=self._truth,
            bodies=self._bodies,
        )
