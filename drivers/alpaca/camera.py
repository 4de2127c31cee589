"""An Alpaca camera, as a language: exposes, waits, fetches the image with a deadline that fits its size."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import replace
from datetime import datetime

import numpy as np

from drivers.alpaca import codec
from drivers.alpaca.camera_setup import CameraHabits, Chip, Field, read_chip, scale_arcsec_px, set_up
from drivers.alpaca.codec import Malformed
from drivers.alpaca.device import AlpacaDevice
from drivers.alpaca.exposure import Exposure, Told
from drivers.alpaca.image_bytes import Pixels
from drivers.alpaca.refusals import AlpacaRefused
from drivers.generic.camera import Shot
from drivers.generic.exposure import with_scale
from drivers.wire.wire_log import WireLog
from mountnav.errors import (
    BadFrame,
    BadRequest,
    Busy,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
)
from mountnav.frames import Frame
from mountnav.reading import frame_from_array
from mountnav.reading.fits_cards import Value
from mountnav.sky.coordinates import utc_now
from mountnav.tasks import begun

_BUSY = (1, 2, 3, 4)
_EXPOSING = (1, 2)
_IN_ERROR = 5
_IDLE_WITHIN_S = 5.0
_START_S = 30.0
_SLOWEST_PX_S = 0.25e6
"""A server that speaks JSON over a slow network sends some bytes for each pixel."""


_LONGEST_TOLD_S = 1e6
"""Longer than any exposure; sums with longer ones leave the calendar."""


class AlpacaCameraLanguage:
    """A `drivers.generic.camera.CameraLanguage` over one camera of an Alpaca server.

    Parameters
    ----------
    device : AlpacaDevice
    name : str, optional
        For messages; the device's address by default.
    habits : CameraHabits
    """

    def __init__(
        self, device: AlpacaDevice, *, name: str | None = None, habits: CameraHabits | None = None
    ) -> None:
        self._device = device
        self._name = name or device.address
        self._habits = habits or CameraHabits()
        self._chip: Chip | None = None
        self._field: Field | None = None
        self._clocks_agree = False
        self._aborting: set[asyncio.Task[None]] = set()
        self.done: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name and address."""
        return self._name

    @property
    def log(self) -> WireLog:
        """All that was asked and answered lately; images are abbreviated."""
        return self._device.asking.log

    @property
    def usable(self) -> bool:
        """Whether its server could be reached, and its driver was connected, whenever it was asked."""
        return self._device.asking.usable and self._chip is not None

    async def open(self) -> None:
        """Connect, and have the whole chip read out.

        Raises
        ------
        DeviceMissing, DeviceSilent, DeviceGarbled
            If there is no server, no such camera, or it can't be connected.
        DeviceRefused
            If it is not connected and may not be told to, or won't be set as the configuration says.
        """
        self._chip = None
        try:
            await self._device.bring_up(may_connect=self._habits.may_connect)
            chip = await read_chip(self._device)
            await self._set_up(chip)
            self._chip = chip
        except BaseException:
            await self._device.asking.close()
            raise

    async def close(self) -> None:
        """Release the connection; the camera stays connected, for others."""
        for one in [*self._aborting]:
            await one
        await self._device.asking.close()

    async def set_up(self) -> None:
        """Have the whole chip read out, with the binning, gain and offset that are wanted."""
        await self._set_up(self._known_chip())

    async def _set_up(self, chip: Chip) -> None:
        self._field, done = await set_up(self._device, chip, self._habits)
        self.done = tuple(done)

    def _known_chip(self) -> Chip:
        if self._chip is None:
            raise DeviceMissing("not connected", device=self._name, advice="open the camera first")
        return self._chip

    # -- exposures -------------------------------------------------------------------------------

    def send_abort(self) -> None:
        """Order the exposure thrown away, or ended where it can't be."""
        chip = self._chip
        member = None if chip is None else "abortexposure" if chip.can_abort else "stopexposure"
        if chip is None or member is None or not (chip.can_abort or chip.can_stop):
            return
        aborting = begun(self._send(member), "alpaca-abortexposure", died=self._device.asking.died)
        self._aborting.add(aborting)
        aborting.add_done_callback(self._aborting.discard)

    async def _send(self, member: str) -> None:
        try:
            await self._device.asking.put_past_all(member)
        except DeviceError as failure:
            self.log.note("event", meaning=f"the exposure could not be aborted: {failure.what}")

    async def _state(self) -> int:
        return await self._device.maybe("camerastate", codec.integer) or 0

    async def wait_until_idle(self, shot: Shot) -> None:
        """Wait a moment for an exposure that was just aborted to be over.

        Raises
        ------
        BadRequest
            If the camera takes no such exposure.
        Busy
            If another program's runs.
        """
        chip, loop = self._known_chip(), asyncio.get_running_loop()
        if not chip.shortest_s <= shot.exposure_s <= chip.longest_s:
            raise BadRequest(
                f"an exposure of {shot.exposure_s:g} s",
                device=self._name,
                advice=f"it takes {chip.shortest_s:g} to {chip.longest_s:g} s",
            )
        until_s = loop.time() + _IDLE_WITHIN_S
        while await self._state() in _BUSY:
            if loop.time() > until_s:
                raise Busy(
                    "another program's exposure is running",
                    device=self._name,
                    advice="wait until it is over",
                )
            await shot.pause(min(0.2, self._habits.poll_s))

    async def take(self, shot: Shot) -> Frame:
        """Order the exposure, wait for its image, and fetch it."""
        chip, field, loop = self._known_chip(), self._field, asyncio.get_running_loop()
        exposure_s = shot.exposure_s
        assert field is not None
        before, ordered, ordered_s = await self._told(), utc_now(), loop.time()
        shot.require_wanted()
        # some old drivers answer when the exposure is over
        deadline_s = exposure_s + max(_START_S, self._device.asking.deadline_s)
        await self._device.asking.put(
            "startexposure", {"Duration": exposure_s, "Light": True}, deadline_s=deadline_s
        )
        exposure = Exposure(exposure_s, ordered, utc_now(), before)
        if shot.aborted:
            # the abort may have overtaken the order
            self.send_abort()
        if loop.time() < ordered_s + exposure_s:
            await shot.pause(exposure_s)
        told, came = await self._image_ready(exposure, shot)
        pixels = await self._fetched(field, shot)
        middle, whose = exposure.middle(told, came, self._habits.clock_tolerance_s)
        self._clocks_agree = middle == exposure.told_middle(told)
        frame = await asyncio.to_thread(self._frame, pixels, told.duration_s or exposure_s, chip, field)
        return replace(frame, mid_exposure_utc=middle, source=f"{self._name}, timed by {whose}")

    async def _image_ready(self, exposure: Exposure, shot: Shot) -> tuple[Told, datetime]:
        loop = asyncio.get_running_loop()
        until_s = loop.time() + self._habits.download_s
        while True:
            missing: DeviceError = DeviceSilent(
                f"no image was ready {self._habits.download_s:.0f} s after the exposure",
                device=self._name,
                advice="does another program use the camera?",
            )
            try:
                ready = await self._ready_image(exposure, shot)
                if ready is not None:
                    return ready
            except AlpacaRefused as refused:
                shot.require_wanted()
                raise DeviceRefused(f"the exposure failed: {refused.words}", device=self._name) from refused
            except (DeviceSilent, DeviceGarbled) as failure:
                # many a server answers nothing while it reads out its chip
                missing = failure
            shot.require_wanted()
            if loop.time() > until_s:
                # or its clock was set meanwhile: the next one is not measured by it
                self._clocks_agree = False
                raise missing
            await shot.pause(self._habits.poll_s)

    async def _ready_image(self, exposure: Exposure, shot: Shot) -> tuple[Told, datetime] | None:
        """Ask once whether the image is ready; tell what the camera tells of it."""
        ready = await self._device.value("imageready", codec.truth)
        came = utc_now()
        failed = not ready and await self._state() == _IN_ERROR
        shot.require_wanted()
        if failed:
            raise DeviceRefused("the exposure failed: it is in error", device=self._name)
        if not ready:
            return None
        told = await self._told()
        if not exposure.is_new(told) and await self._state() in _EXPOSING:
            # it still speaks of the last image
            return None
        tolerance_s = self._habits.clock_tolerance_s
        another = exposure.is_of_another(told, came, tolerance_s, clocks_agree=self._clocks_agree)
        return None if another else (told, came)

    async def _told(self) -> Told:
        start = duration_s = None
        with suppress(AlpacaRefused, Malformed):
            start = codec.instant(await self._device.asking.get("lastexposurestarttime"))
        with suppress(AlpacaRefused, Malformed):
            duration_s = codec.number(
                await self._device.asking.get("lastexposureduration"), 0.0, _LONGEST_TOLD_S
            )
        return Told(start, duration_s)

    async def _fetched(self, field: Field, shot: Shot) -> Pixels:
        loop = asyncio.get_running_loop()
        deadline_s = self._habits.download_s + field.width_px * field.height_px / _SLOWEST_PX_S
        until_s = loop.time() + deadline_s
        while True:
            try:
                image = self._device.asking.image(deadline_s=until_s - loop.time())
                pixels = (await shot.outlast(image)).pixels
                break
            except DeviceSilent:
                # the image stays there until the next exposure: a server that failed may be asked again
                if loop.time() + self._habits.poll_s >= until_s:
                    raise
                await shot.pause(self._habits.poll_s)
        if pixels is None or pixels.shape[-2:] != (field.height_px, field.width_px):
            raise BadFrame(
                f"the image has the shape {None if pixels is None else pixels.shape}, "
                f"{field.width_px} × {field.height_px} pixels were to come",
                device=self._name,
                advice="does another program use the camera?",
            )
        return pixels

    # -- frames ----------------------------------------------------------------------------------

    def _frame(self, pixels: Pixels, exposure_s: float, chip: Chip, field: Field) -> Frame:
        header: dict[str, Value] = {"EXPTIME": exposure_s}
        if chip.pattern and field.binning == 1:
            header["BAYERPAT"] = chip.pattern
        if chip.max_adu is not None and float(np.max(pixels)) <= chip.max_adu:
            # some say it of the chip's bits where the image is stretched to 16: then it is none
            header["SATURATE"] = chip.max_adu
        frame = frame_from_array(pixels, header, name=self._name, raw=True)
        scale = scale_arcsec_px(chip, field, self._habits.focal_length_mm)
        return with_scale(frame, scale, "the camera's pixel size and the focal length in its URL")
