"""A whole camera made of a language: opened again when it was lost, one exposure at a time, aborts."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from drivers.generic.camera_language import CameraLanguage
from drivers.generic.shot import Shot, Turn
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceError, DeviceGarbled, DeviceMissing, DeviceSilent
from mountnav.frames import Frame


class ExposingCamera:
    """A `mountnav.devices.Camera`.

    Parameters
    ----------
    language : CameraLanguage
    """

    def __init__(self, language: CameraLanguage) -> None:
        self._language = language
        self._wanted_open = False
        self._opening = asyncio.Lock()
        self._turn = Turn(language.name)
        self._ordered = False

    @property
    def name(self) -> str:
        """Name, for messages."""
        return self._language.name

    @property
    def wire_log(self) -> WireLog:
        """All that was said lately; images are abbreviated."""
        return self._language.log

    @property
    def done(self) -> tuple[str, ...]:
        """What was set at the last opening, or before the last exposure, in words."""
        return self._language.done

    async def open(self) -> None:
        """Connect, and have the camera set as the configuration says.

        Raises
        ------
        DeviceMissing, DeviceSilent, DeviceGarbled
            If there is no server, no such camera, or it can't be connected.
        DeviceRefused
            If it is not connected and may not be told to, is no camera, or won't be set.
        """
        async with self._opening:
            await self._language.open()
        self._wanted_open = True

    async def close(self) -> None:
        """Release the connection; a running `expose` ends as after `abort`. The camera stays connected."""
        self._wanted_open = False
        with suppress(DeviceError):
            await self.abort()
        await self._language.close()

    async def expose(self, exposure_s: float) -> Frame:
        """Take one frame.

        Parameters
        ----------
        exposure_s : float

        Returns
        -------
        Frame
            With `mid_exposure_utc` by the camera's own time where that agrees with our clock, else by ours;
            `source` says by which.

        Raises
        ------
        BadRequest
            If the exposure is not positive, or none that the camera takes.
        Busy
            If an exposure runs, ours or another program's.
        Cancelled
            After `abort`.
        DeviceRefused
            If the driver says no, fails, or another program ended the exposure.
        DeviceSilent
            If no image came in time.
        DeviceGarbled, BadFrame
            If what came can't be read, or is not what was set.
        DeviceMissing
            If server, driver or camera is gone.
        """
        with self._turn.taken(exposure_s) as shot:
            return await self._expose(shot)

    async def _expose(self, shot: Shot) -> Frame:
        try:
            opened = await self._ready()
            await self._language.wait_until_idle(shot)
            if not opened:
                await self._language.set_up()
            shot.require_wanted()
            self._ordered = True
            return await self._language.take(shot)
        except (asyncio.CancelledError, DeviceSilent, DeviceGarbled):
            # one that nobody waits for must not hold the camera
            self._end_ours()
            raise
        finally:
            self._ordered = False

    async def abort(self) -> None:
        """End a running exposure; its `expose` raises `Cancelled`. Without one, nothing happens."""
        if self._turn.abort():
            self._end_ours()

    def _end_ours(self) -> None:
        # until ours is ordered, the one that runs is another program's
        if self._ordered and self._language.usable:
            self._language.send_abort()

    async def _ready(self) -> bool:
        """Open a connection again that was lost since `open`; tell whether it was."""
        if self._language.usable:
            return False
        if not self._wanted_open:
            raise DeviceMissing("not connected", device=self.name, advice="open the camera first")
        async with self._opening:
            await self._language.open()
        return True
