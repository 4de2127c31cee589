"""SimulatedCamera: exposes in real time and sees what is truly there, never what the mount believes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import datetime, timedelta

from mountnav.catalog.stars import Catalog
from mountnav.errors import BadRequest, Busy, Cancelled
from mountnav.frames import Frame
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs, utc_now


class SimulatedCamera:
    """A `mountnav.navigation.devices.Camera` that draws its frames.

    Parameters
    ----------
    truth : callable
        Gives where the optical axis truly looks at an instant, e.g. `Mechanics.truth`.
    optics : SimulatedOptics
        Telescope and camera.
    catalog : Catalog
        Stars to draw.
    seed : int
        Of the noise. Frame n of a camera with the same seed has the same noise.
    name : str
        For messages.
    clock : callable
        Gives the present instant; the same as the mechanics'.
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
    ) -> None:
        self._truth = truth
        self._optics = optics
        self._catalog = catalog
        self._seed = seed
        self._name = name
        self._clock = clock
        self._frames = 0
        self._aborted: asyncio.Event | None = None

    @property
    def name(self) -> str:
        """Name, for messages."""
        return self._name

    async def open(self) -> None:
        """Nothing to get ready."""

    async def close(self) -> None:
        """End a running exposure, if there is one."""
        await self.abort()

    async def expose(self, exposure_s: float) -> Frame:
        """Wait out the exposure, then draw the sky at the truth of mid-exposure.

        Raises
        ------
        BadRequest
            When the exposure time is not positive.
        Busy
            When an exposure runs already.
        Cancelled
            When `abort` ended it.
        """
        if not 0.0 < exposure_s < float("inf"):
            raise BadRequest(f"an exposure of {exposure_s} s", device=self._name, advice="longer than 0 s")
        if self._aborted is not None:
            raise Busy("an exposure is running", device=self._name, advice="wait for it, or abort it")
        aborted = self._aborted = asyncio.Event()
        try:
            number, self._frames = self._frames, self._frames + 1
            mid_utc = self._clock() + timedelta(seconds=exposure_s / 2.0)
            try:
                await asyncio.wait_for(aborted.wait(), exposure_s)
            except TimeoutError:  # not aborted: the exposure is over
                frame = await asyncio.to_thread(self._draw, exposure_s, mid_utc, number)
            if aborted.is_set():
                raise Cancelled("the exposure was aborted", device=self._name)
            return frame
        finally:
            self._aborted = None

    async def abort(self) -> None:
        """End a running exposure; its `expose` raises `Cancelled`. Without one, nothing happens."""
        if self._aborted is not None:
            self._aborted.set()

    def _draw(self, exposure_s: float, mid_utc: datetime, number: int) -> Frame:
        return draw_frame(
            self._truth(mid_utc),
            self._optics,
            self._catalog,
            exposure_s=exposure_s,
            mid_exposure_utc=mid_utc,
            seed=(self._seed, number),
        )
