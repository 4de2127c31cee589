"""An Alpaca camera, as a language: exposes, waits, fetches the image with a deadline that fits its size."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from drivers.alpaca.codec import base
from drivers.alpaca.codec.base import INVALID_VALUE, AlpacaRefused, Malformed
from drivers.alpaca.codec.exposure import Exposure, Pixels, Told
from drivers.alpaca.device import AlpacaDevice
from drivers.generic.camera import Shot
from drivers.generic.exposure import GenericCameraHabits, optics_scale_arcsec_px, with_scale
from drivers.generic.served_device import ServedDevice
from mountnav.clock import utc_now
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
from mountnav.reading.fits_headers import Value
from mountnav.tasks import begun

_LARGEST_SIDE_PX = 1 << 17
"""Larger sensor sides are refused as nonsense. Chosen by hand, far above any sensor."""
_LARGEST_PIXEL_UM = 1000.0
"""Larger pixels are refused as nonsense. Chosen by hand, far above any sensor."""
_LARGEST_ADU = 2.0**53
"""The largest whole number that a double holds exactly: larger saturation values can't be compared with
pixels."""
_LONGEST_S = 1e6
"""The longest exposure of a camera that reports none, or an infinite one: eleven days. Chosen by hand."""
_STEP_PX, _NEAR_PX = 8, 16
"""Some chips are read out in steps: their drivers refuse other sizes, or round them down."""
_SENSORS = {0: "", 1: "", 2: "RGGB"}
"""SensorType: monochrome, color planes, Bayer mosaic; the others (CMYG, LRGB) have no card."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraHabits(GenericCameraHabits):
    """What the configuration says of an Alpaca camera.

    Attributes
    ----------
    gain, offset : str or None
        A number, or one of the names that the camera has for them; None leaves it.
    poll_s : float
        Between two questions whether an image is ready.
    """

    gain: str | None = None
    offset: str | None = None
    poll_s: float = 0.25


@dataclass(frozen=True, slots=True)
class Chip:
    """What a camera is, as it says when it is connected.

    Attributes
    ----------
    width_px, height_px : int
        Of the whole chip, not binned.
    pixel_um : float or None
        Not binned.
    shortest_s, longest_s : float
        Exposures that it takes.
    pattern : str
        Of a Bayer mosaic; empty if it has none.
    can_abort, can_stop : bool
        Whether an exposure can be thrown away, or ended and read out.
    """

    width_px: int
    height_px: int
    pixel_um: float | None
    max_adu: float | None
    shortest_s: float
    longest_s: float
    pattern: str
    can_abort: bool
    can_stop: bool


@dataclass(frozen=True, slots=True)
class Field:
    """What of the chip is read out: binning, and the size in binned pixels."""

    binning: int
    width_px: int
    height_px: int


async def read_chip(device: AlpacaDevice) -> Chip:
    """Ask a connected camera what it is.

    Raises
    ------
    DeviceRefused
        If it doesn't say its size: it is no camera.
    DeviceSilent, DeviceGarbled, DeviceMissing
        If its answers don't come or make no sense.
    """

    async def known(member: str, low: float, high: float) -> float | None:
        # what is nice to have may be missing, or be nonsense
        try:
            told = await device.client.get(member)
            return base.number(told, low, high)
        except (AlpacaRefused, Malformed):
            return None

    async def side(member: str) -> int:
        return await device.value(member, lambda value: base.integer(value, 1, _LARGEST_SIDE_PX))

    pixel_um = await known("pixelsizex", 0.0, _LARGEST_PIXEL_UM)
    return Chip(
        width_px=await side("cameraxsize"),
        height_px=await side("cameraysize"),
        pixel_um=pixel_um or None,
        max_adu=await known("maxadu", 1.0, _LARGEST_ADU),
        shortest_s=await known("exposuremin", 0.0, _LONGEST_S) or 0.0,
        longest_s=await known("exposuremax", 0.0, float("inf")) or _LONGEST_S,
        pattern=_SENSORS.get(round(await known("sensortype", 0, 9) or 0), ""),
        can_abort=bool(await device.maybe("canabortexposure", base.truth)),
        can_stop=bool(await device.maybe("canstopexposure", base.truth)),
    )


async def set_up(device: AlpacaDevice, chip: Chip, habits: CameraHabits) -> tuple[Field, list[str]]:
    """Have the whole chip read out, with the binning, gain and offset that are wanted.

    Only what is otherwise is set: another program may have used the camera since.

    Returns
    -------
    list of str
        What was set, in words.

    Raises
    ------
    DeviceRefused
        If it doesn't want to, or says yes and does otherwise.
    DeviceSilent, DeviceGarbled, DeviceMissing
        If its answers don't come or make no sense.
    """
    done: list[str] = []
    binning = await _whole(device, "binx")
    wanted = habits.binning or binning
    # before the size: that counts in binned pixels [Alpaca §7]
    for member, said in (("binx", "BinX"), ("biny", "BinY")):
        if await _set(device, member, said, wanted):
            done.append(f"{said} is {wanted}")
    for member, said in (("startx", "StartX"), ("starty", "StartY")):
        if await _set(device, member, said, 0):
            done.append(f"{said} is 0")
    width_px = await _set_side(device, "numx", "NumX", chip.width_px // wanted, done)
    height_px = await _set_side(device, "numy", "NumY", chip.height_px // wanted, done)
    for member, said, level in (("gain", "Gain", habits.gain), ("offset", "Offset", habits.offset)):
        if level is not None and await _set(device, member, said, await _level(device, member, level)):
            done.append(f"{said} is {level}")
    return Field(wanted, width_px, height_px), done


async def _whole(device: AlpacaDevice, member: str) -> int:
    return await device.value(member, base.integer)


async def _set(device: AlpacaDevice, member: str, said: str, value: int) -> bool:
    """Set a whole number unless it is so; see it set."""
    if await _whole(device, member) == value:
        return False
    await device.client.put(member, {said: value})
    now = await _whole(device, member)
    if now != value:
        raise DeviceRefused(f"took {said} = {value}, and has {now}", device=device.address)
    return True


async def _set_side(device: AlpacaDevice, member: str, said: str, value: int, done: list[str]) -> int:
    """Set a side of what is read out, or the next smaller one that the chip can; return it."""
    before = await _whole(device, member)
    if before == value:
        return value
    try:
        await device.client.put(member, {said: value})
    except AlpacaRefused as refused:
        rounded = value - value % _STEP_PX
        if refused.number != INVALID_VALUE or rounded in (0, value):
            raise
        await device.client.put(member, {said: rounded})
    now = await _whole(device, member)
    if not max(1, value - _NEAR_PX) <= now <= value:
        raise DeviceRefused(f"took {said} = {value}, and has {now}", device=device.address)
    if now != before:
        done.append(f"{said} is {now}")
    return now


async def _level(device: AlpacaDevice, member: str, level: str) -> int:
    """Read a gain or an offset: a number, or one of the camera's names, which it numbers from 0."""
    names = await device.maybe(f"{member}s", lambda value: value if isinstance(value, list) else [])
    if names and level in names:
        return names.index(level)
    try:
        return int(level)
    except ValueError:
        there = ", ".join(map(str, names or ())) or "numbers alone"
        raise DeviceRefused(
            f"has no {member} {level!r}", device=device.address, advice=f"it has: {there}"
        ) from None


def scale_arcsec_px(chip: Chip, field: Field, focal_length_mm: float | None) -> float | None:
    """Scale by pixel size, binning and focal length, or None where one of them isn't known."""
    return optics_scale_arcsec_px(chip.pixel_um, field.binning, focal_length_mm)


_BUSY = (1, 2, 3, 4)
"""Camera states in which an exposure can't begin: waiting, exposing, reading, downloading [Alpaca
CameraState]."""
_EXPOSING = (1, 2)
"""Camera states in which the image can't be there: waiting, exposing [Alpaca CameraState]."""
_IN_ERROR = 5
"""The camera state of an exposure that failed [Alpaca CameraState]."""
_IDLE_WITHIN_S = 5.0
"""How long an exposure that still runs may take to end before a new one is refused as another program's.
Chosen by hand, the same as for INDI."""
_START_S = 30.0
"""How long, beyond the exposure, a server may take to answer the order to expose: old drivers answer when
it is over. Chosen by hand, the same as for INDI."""
_SLOWEST_PX_S = 0.25e6
"""A server that speaks JSON over a slow network sends some bytes for each pixel."""


_LONGEST_TOLD_S = 1e6
"""Longer than any exposure; sums with longer ones leave the calendar."""


class AlpacaCameraLanguage(ServedDevice[AlpacaDevice]):
    """A `drivers.generic.camera.CameraLanguage` over one camera of an Alpaca server."""

    def __init__(
        self, device: AlpacaDevice, *, name: str | None = None, habits: CameraHabits | None = None
    ) -> None:
        super().__init__(device, name=name)
        self._habits = habits or CameraHabits()
        self._chip: Chip | None = None
        self._field: Field | None = None
        self._clocks_agree = False
        self._aborting: set[asyncio.Task[None]] = set()
        self.done: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether its server could be reached, and its driver was connected, whenever it was asked."""
        return self._device.client.usable and self._chip is not None

    async def open(self) -> None:
        """Connect, and have the whole chip read out.

        Raises
        ------
        DeviceMissing, DeviceSilent, DeviceGarbled
            If there is no server, no such camera, or it can't be connected.
        DeviceRefused
            If it is not connected and may not be ordered to, or won't be set as the configuration says.
        """
        self._chip = None
        async with self._or_closed() as device:
            await device.bring_up(may_connect=self._habits.may_connect)
            chip = await read_chip(device)
            await self._set_up(chip)
            self._chip = chip

    async def close(self) -> None:
        """Release the connection; the camera stays connected, for others."""
        for abort in [*self._aborting]:
            await abort
        await super().close()

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
        aborting = begun(self._send(member), "alpaca-abortexposure", died=self._device.client.died)
        self._aborting.add(aborting)
        aborting.add_done_callback(self._aborting.discard)

    async def _send(self, member: str) -> None:
        try:
            await self._device.client.put_past_all(member)
        except DeviceError as failure:
            self.log.note("event", meaning=f"the exposure could not be aborted: {failure.what}")

    async def _state(self) -> int:
        return await self._device.maybe("camerastate", base.integer) or 0

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
        deadline_s = exposure_s + max(_START_S, self._device.client.deadline_s)
        await self._device.client.put(
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
        """Ask once whether the image is ready; return what the camera reports of it."""
        ready = await self._device.value("imageready", base.truth)
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
            start = base.instant(await self._device.client.get("lastexposurestarttime"))
        with suppress(AlpacaRefused, Malformed):
            duration_s = base.number(
                await self._device.client.get("lastexposureduration"), 0.0, _LONGEST_TOLD_S
            )
        return Told(start, duration_s)

    async def _fetched(self, field: Field, shot: Shot) -> Pixels:
        loop = asyncio.get_running_loop()
        deadline_s = self._habits.download_s + field.width_px * field.height_px / _SLOWEST_PX_S
        until_s = loop.time() + deadline_s
        while True:
            try:
                image = self._device.client.image(deadline_s=until_s - loop.time())
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
