"""A camera behind an `indiserver`, as a language; its large files never hold up the mount's connection."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime

from drivers.generic.camera import Shot
from drivers.generic.exposure import GenericCameraHabits, optics_scale_arcsec_px, with_scale
from drivers.generic.served_device import ServedDevice
from drivers.indi.codec import messages
from drivers.indi.codec.answers import refusal, slew_was_refused
from drivers.indi.codec.exposure import BrokenBlob, Exposure, content
from drivers.indi.codec.messages import Blob, Changed, Defined, Event, Ordered, State
from drivers.indi.codec.state import Property
from drivers.indi.device import IndiDevice
from mountnav.clock import utc_now
from mountnav.errors import (
    BadFrame,
    Busy,
    DeviceError,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
)
from mountnav.frames import Frame
from mountnav.reading import read_frame

_GUIDE_CHIP = "CCD2"
_NEAR, _NEAR_PX = 0.05, 32.0
"""Drivers round a frame to what their chip can read out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraHabits(GenericCameraHabits):
    """What the configuration says of a camera behind INDI.

    Attributes
    ----------
    mount : str or None
        Device that the camera's driver shall listen to for its headers; None leaves that as it is.
    chip : str
        Property of the file.
    """

    mount: str | None = None
    chip: str = "CCD1"

    def of_chip(self, what: str) -> str:
        """Name of a chip's property: ``CCD_EXPOSURE``, or ``GUIDER_EXPOSURE`` of the guide chip."""
        return f"{'GUIDER' if self.chip == _GUIDE_CHIP else 'CCD'}_{what}"


async def set_up(device: IndiDevice, habits: CameraHabits) -> list[str]:
    """Have light frames of the whole chip sent to this connection, as FITS; tell what was not so already.

    Parameters
    ----------
    device : IndiDevice
        Of the camera, up.

    Raises
    ------
    DeviceRefused
        If its driver doesn't want to.
    DeviceSilent, DeviceMissing
        If it doesn't answer or is gone.
    """
    # a new connection gets no files unless it asks for them; servers may forget that with their driver
    device.client.send(messages.enable_blob(device.name, "Also"))
    done: list[str] = []
    upload = device.get("UPLOAD_MODE")
    if upload is not None and not (upload.on("UPLOAD_CLIENT") or upload.on("UPLOAD_BOTH")):
        await device.set_switches("UPLOAD_MODE", _only("UPLOAD_CLIENT", upload))
        done.append("files are sent to clients")
    for name, element, what in (
        ("CCD_TRANSFER_FORMAT", "FORMAT_FITS", "files are sent as FITS"),
        (habits.of_chip("FRAME_TYPE"), "FRAME_LIGHT", "frames are light frames"),
        ("CCD_FAST_TOGGLE", "INDI_DISABLED", "one exposure does not start the next"),
    ):
        one = device.get(name)
        if one is not None and one.on(element) is False:
            await device.set_switches(name, _only(element, one))
            done.append(what)
    if habits.mount is not None:
        done += await _listening(device, habits.mount)
        # of the mount we get nothing else
        device.client.send(messages.get_properties(habits.mount, "TELESCOPE_INFO"))
    if habits.binning is not None:
        done += await _binned(device, habits.of_chip("BINNING"), habits.binning)
    # after the binning: some drivers change the frame with it
    return done + await _whole(device, habits)


async def _listening(device: IndiDevice, mount: str) -> list[str]:
    active = device.get("ACTIVE_DEVICES")
    if active is None or active.text("ACTIVE_TELESCOPE") in (None, mount):
        return []
    texts = {key: value for key, value in active.values.items() if isinstance(value, str)}
    order = messages.new_texts(device.name, "ACTIVE_DEVICES", texts | {"ACTIVE_TELESCOPE": mount})
    await device.ordered(order, asking="ACTIVE_DEVICES", echo="ACTIVE_DEVICES")
    return [f"it listens to {mount}"]


async def _binned(device: IndiDevice, name: str, binning: int) -> list[str]:
    one = device.get(name)
    if one is None:
        return []
    wanted = dict.fromkeys(one.values, float(binning))
    if wanted == one.values:
        return []
    await device.ordered(messages.new_numbers(device.name, name, wanted), asking=name, echo=name)
    now = device.get(name)
    if now is None or now.values != wanted:
        raise DeviceRefused(f"can't bin by {binning}", device=device.address)
    return [f"binning is {binning}"]


async def _whole(device: IndiDevice, habits: CameraHabits) -> list[str]:
    """Have the whole chip read out: the middle of a part that somebody chose is not where it points."""
    name = habits.of_chip("FRAME")
    frame, chip = device.get(name), device.get(habits.of_chip("INFO"))
    width_px, height_px = (None if chip is None else chip.number(f"CCD_MAX_{axis}") for axis in "XY")
    if frame is None or not width_px or not height_px or frame.number("WIDTH") is None:
        # nothing is known of its size, as of a lens camera before its first frame
        return []
    if _is_whole(frame, width_px, height_px) or frame.perm == "ro":
        return []
    wanted = {"X": 0.0, "Y": 0.0, "WIDTH": width_px, "HEIGHT": height_px}
    await device.ordered(messages.new_numbers(device.name, name, wanted), asking=name, echo=name)
    now = device.get(name)
    if now is None or not _is_whole(now, width_px, height_px):
        part = [] if now is None else [now.number(element) for element in ("X", "Y", "WIDTH", "HEIGHT")]
        raise DeviceRefused(
            f"reads out {part} of its chip, and not all {width_px:.0f} × {height_px:.0f} pixels",
            device=device.address,
            advice="reset the frame in its driver, or in the program that chose the part",
        )
    return ["the whole chip is read out"]


def _is_whole(frame: Property, width_px: float, height_px: float) -> bool:
    wanted = {"X": (0.0, width_px), "Y": (0.0, height_px)}
    wanted |= {"WIDTH": (width_px, width_px), "HEIGHT": (height_px, height_px)}
    return all(
        (told := frame.number(name)) is not None and abs(told - there) <= min(_NEAR_PX, _NEAR * side)
        for name, (there, side) in wanted.items()
    )


def scale_arcsec_px(device: IndiDevice, habits: CameraHabits) -> float | None:
    """Scale by pixel size, binning and focal length, or None where one of them isn't known."""
    chip, binning = device.get(habits.of_chip("INFO")), device.get(habits.of_chip("BINNING"))
    pixel_um = None if chip is None else chip.number("CCD_PIXEL_SIZE")
    bins = (None if binning is None else binning.number("HOR_BIN")) or 1.0
    return optics_scale_arcsec_px(pixel_um, bins, _focal_length_mm(device, habits))


def _focal_length_mm(device: IndiDevice, habits: CameraHabits) -> float | None:
    optics = device.get("SCOPE_INFO")
    own_mm = None if optics is None else optics.number("FOCAL_LENGTH")
    if own_mm or habits.focal_length_mm is not None:
        return own_mm or habits.focal_length_mm
    if habits.mount is None:
        return None
    told = device.client.properties.get(habits.mount, "TELESCOPE_INFO")
    return None if told is None else told.number("TELESCOPE_FOCAL_LENGTH")


def _only(on: str, one: Property) -> Mapping[str, bool]:
    return {key: key == on for key in one.values}


_NO_FILE_S = 5.0
"""How long a file may still come after the driver said that the exposure ended badly. Chosen by hand;
halved, a file that is only slow to be packed is missed, doubled, a failure is reported later."""
_IDLE_WITHIN_S = 5.0
"""How long an exposure that still runs may take to end before a new one is refused as another program's.
Chosen by hand."""
_GLANCE_S = 0.2
"""How often we check what comes true without a message (see `Exposure.settle`). Chosen by hand: little
work, and no frame waits noticeably longer."""
_START_S = 30.0
"""How long, beyond the exposure, a driver may take to say that it has begun: some answer only when the
exposure is over. Chosen by hand; too short reports a slow driver as silent."""


class IndiCameraLanguage(ServedDevice[IndiDevice]):
    """A `drivers.generic.camera.CameraLanguage` over one device of an `indiserver`."""

    def __init__(
        self, device: IndiDevice, *, name: str | None = None, habits: CameraHabits | None = None
    ) -> None:
        super().__init__(device, name=name)
        self._habits = habits or CameraHabits()
        self._exposure = self._habits.of_chip("EXPOSURE")
        self._now: Exposure | None = None
        self._last_header_time: datetime | None = None
        self._clocks_agree = False
        self._ours_until = 0
        """After so many messages our own exposure had brought its file."""
        self.done: tuple[str, ...] = ()
        device.client.listen(self._on_event)

    @property
    def usable(self) -> bool:
        """Whether the connection is up, and the device connected ever since."""
        return self._device.usable

    async def open(self) -> None:
        """Connect, and have files sent to us: as FITS, of light frames.

        Raises
        ------
        DeviceMissing, DeviceSilent
            If there is no server, no such device, or its driver can't connect.
        DeviceRefused
            If it is not connected and may not be ordered to, is no camera, or keeps its files to itself.
        """
        async with self._or_closed() as device:
            await device.bring_up(may_connect=self._habits.may_connect, needed=(self._exposure,))
            self._ours_until = 0
            await self.set_up()

    async def set_up(self) -> None:
        """Have light frames of the whole chip sent to us; see `camera_setup`."""
        self.done = tuple(await set_up(self._device, self._habits))

    # -- exposures -------------------------------------------------------------------------------

    def send_abort(self) -> None:
        """Order the exposure aborted."""
        abort = messages.new_switches(
            self._device.name, self._habits.of_chip("ABORT_EXPOSURE"), {"ABORT": True}
        )
        with suppress(DeviceError):
            self._device.client.send(abort)

    async def wait_until_idle(self, shot: Shot) -> None:
        """Wait a moment for an exposure that was just aborted, or whose file has come, to be over.

        Raises
        ------
        Busy
            If another program's runs.
        """
        device = self._device

        def idle() -> bool:
            one = device.get(self._exposure)
            return shot.aborted or one is None or one.state is not State.BUSY

        if await device.client.until(idle, _IDLE_WITHIN_S):
            return
        shot.require_wanted()
        one = device.get(self._exposure)
        if one is None or one.count > self._ours_until:
            raise Busy(
                "another program's exposure is running", device=self._name, advice="wait until it is over"
            )
        # said that it began when it was already done, and nothing ever since
        self.log.note("event", meaning="its driver never said that our last exposure was over")

    async def take(self, shot: Shot) -> Frame:
        """Order the exposure, and wait for the file that is its own."""
        now = Exposure(shot.exposure_s, utc_now(), asyncio.get_running_loop().time(), 0)
        now.count = self._device.client.properties.count
        self._now = now
        try:
            return await self._take(now, shot)
        finally:
            self._now = None

    async def _take(self, now: Exposure, shot: Shot) -> Frame:
        device = self._device
        order = messages.new_numbers(device.name, self._exposure, {f"{self._exposure}_VALUE": now.exposure_s})
        # some drivers take up the question only when the exposure is over
        deadline_s = now.exposure_s + max(_START_S, device.deadline_s)
        heard = await shot.outlast(device.ordered(order, asking=self._exposure, deadline_s=deadline_s))
        now.answered = True
        if now.begun is None and slew_was_refused(self._exposure, heard):
            raise refusal("the exposure", heard, self._name)
        while True:
            blob, came = await self._next_file(now, shot)
            frame = await self._frame(blob, now, came)
            if frame is not None:
                self._ours_until = device.client.properties.count
                return frame

    async def _next_file(self, now: Exposure, shot: Shot) -> tuple[Blob, datetime]:
        loop, client = asyncio.get_running_loop(), self._device.client

        def left_s() -> float:
            began_s = max(now.ordered_s, now.begun_s)
            return began_s + now.exposure_s + self._habits.download_s - loop.time()

        def settled() -> bool:
            now.settle(loop.time())
            over = now.ended_s is not None and loop.time() > now.ended_s + _NO_FILE_S
            ended = shot.aborted or now.failed or now.overtaken or over or not self._device.usable
            return bool(now.files) or ended

        while not settled() and left_s() > 0.0:
            # some of it comes true by waiting, without any news
            await client.until(settled, min(_GLANCE_S, max(0.01, left_s())))
        shot.require_wanted()
        if now.files:
            return now.files.pop(0)
        if not self._device.usable:
            raise DeviceMissing("its driver is gone", device=self._name, advice="connect again")
        raise self._no_file(now)

    def _no_file(self, now: Exposure) -> DeviceError:
        words = "; ".join([*self._device.words_since(now.count)[-3:], *now.dropped[-1:]])
        if now.failed or now.overtaken or now.ended_s is not None:
            how = "failed" if now.failed else "was ended by another program, or brought no file"
            return DeviceRefused(f"the exposure {how}{': ' if words else ''}{words}", device=self._name)
        return DeviceSilent(
            f"no file came within {now.exposure_s + self._habits.download_s:.0f} s{words and '; ' + words}",
            device=self._name,
            advice="does another client of the server take its files?",
        )

    def _on_event(self, event: Event, now: Property | None) -> None:
        exposure = self._now
        if exposure is None or getattr(event, "device", "") != self._device.name:
            return
        utc, at_s = utc_now(), asyncio.get_running_loop().time()
        match event:
            case Changed(name=self._exposure, state=State() as state):
                exposure.take_state(state, utc, at_s)
            case Defined(name=self._exposure, state=State.BUSY):
                # some don't say it unasked
                exposure.take_state(State.BUSY, utc, at_s)
            case Ordered(name=self._exposure):
                exposure.overtaken = True
                self.log.note("event", meaning="another program ordered an exposure")
            case Changed(name=self._habits.chip, kind="BLOB"):
                self._note_dropped(exposure, exposure.take_files(event, utc, at_s))

    def _note_dropped(self, exposure: Exposure, why: str | None) -> None:
        if why is not None:
            exposure.dropped.append(f"dropped a file: {why}")
            self.log.note("event", meaning=exposure.dropped[-1])

    # -- frames ----------------------------------------------------------------------------------

    async def _frame(self, blob: Blob, now: Exposure, came: datetime) -> Frame | None:
        """Read a file; None if it is of another exposure."""
        try:
            frame = await asyncio.to_thread(_read, blob, self._name)
        except BrokenBlob as fault:
            raise BadFrame(f"its file {blob.format} can't be unpacked: {fault}", device=self._name) from fault
        why = self._why_not(frame, now, came)
        now.doubtful = False
        if why is not None:
            self._note_dropped(now, why)
            return None
        by_header = self._last_header_time = frame.mid_exposure_utc
        middle, whose = now.middle(by_header, came, self._habits.clock_tolerance_s)
        self._clocks_agree = middle == by_header
        timed = replace(
            frame,
            mid_exposure_utc=middle,
            exposure_s=frame.exposure_s or now.exposure_s,
            source=f"{self._device.name}, timed by {whose}",
        )
        scale = scale_arcsec_px(self._device, self._habits)
        return with_scale(timed, scale, "the INDI drivers' pixel size and focal length")

    def _why_not(self, frame: Frame, now: Exposure, came: datetime) -> str | None:
        """Tell why a file is not this exposure's, if it isn't."""
        if now.is_of_another(frame.exposure_s):
            return f"exposed for {frame.exposure_s} s, not {now.exposure_s} s"
        by_header, tolerance_s = frame.mid_exposure_utc, self._habits.clock_tolerance_s
        # whole seconds are no fingerprint
        if by_header is not None and by_header.microsecond and by_header == self._last_header_time:
            return "it is the one that came before"
        why = now.why_not(by_header, came, tolerance_s, clocks_agree=self._clocks_agree)
        if why is not None:
            # or its clock was set meanwhile: the next one is not measured by it
            self._clocks_agree = False
        return why


def _read(blob: Blob, name: str) -> Frame:
    return read_frame(bytes(content(blob)), name=name, raw=True)
