"""What a camera's driver is told before exposures, so that looks get whole frames; its optics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.generic.exposure import GenericCameraHabits, optics_scale_arcsec_px
from drivers.indi import orders
from drivers.indi.device import IndiDevice
from drivers.indi.state import Property
from mountnav.errors import DeviceRefused

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
    habits : CameraHabits

    Raises
    ------
    DeviceRefused
        If its driver doesn't want to.
    DeviceSilent, DeviceMissing
        If it doesn't answer or is gone.
    """
    # a new connection gets no files unless it asks for them; servers may forget that with their driver
    device.client.send(orders.enable_blob(device.name, "Also"))
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
        # of the mount nothing else is told to us
        device.client.send(orders.get_properties(habits.mount, "TELESCOPE_INFO"))
    if habits.binning is not None:
        done += await _binned(device, habits.of_chip("BINNING"), habits.binning)
    # after the binning: some drivers change the frame with it
    return done + await _whole(device, habits)


async def _listening(device: IndiDevice, mount: str) -> list[str]:
    active = device.get("ACTIVE_DEVICES")
    if active is None or active.text("ACTIVE_TELESCOPE") in (None, mount):
        return []
    texts = {key: value for key, value in active.values.items() if isinstance(value, str)}
    order = orders.new_texts(device.name, "ACTIVE_DEVICES", texts | {"ACTIVE_TELESCOPE": mount})
    await device.ordered(order, asking="ACTIVE_DEVICES", echo="ACTIVE_DEVICES")
    return [f"it listens to {mount}"]


async def _binned(device: IndiDevice, name: str, binning: int) -> list[str]:
    one = device.get(name)
    if one is None:
        return []
    wanted = dict.fromkeys(one.values, float(binning))
    if wanted == one.values:
        return []
    await device.ordered(orders.new_numbers(device.name, name, wanted), asking=name, echo=name)
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
    await device.ordered(orders.new_numbers(device.name, name, wanted), asking=name, echo=name)
    now = device.get(name)
    if now is None or not _is_whole(now, width_px, height_px):
        part = [] if now is None else [now.number(one) for one in ("X", "Y", "WIDTH", "HEIGHT")]
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
