"""What an Alpaca camera is, and what it is told before each exposure, so that looks see the whole chip."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.alpaca import codec
from drivers.alpaca.codec import Malformed
from drivers.alpaca.device import AlpacaDevice
from drivers.alpaca.refusals import INVALID_VALUE, AlpacaRefused
from drivers.generic.exposure import GenericCameraHabits, optics_scale_arcsec_px
from mountnav.errors import DeviceRefused

_LARGEST_SIDE_PX = 1 << 17
_LARGEST_PIXEL_UM = 1000.0
_LARGEST_ADU = 2.0**53
_LONGEST_S = 1e6
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
    max_adu : float or None
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
        If it doesn't tell its size: it is no camera.
    DeviceSilent, DeviceGarbled, DeviceMissing
        If its answers don't come or make no sense.
    """

    async def known(member: str, low: float, high: float) -> float | None:
        # what is nice to have may be missing, or be nonsense
        try:
            told = await device.asking.get(member)
            return codec.number(told, low, high)
        except (AlpacaRefused, Malformed):
            return None

    async def side(member: str) -> int:
        return await device.value(member, lambda value: codec.integer(value, 1, _LARGEST_SIDE_PX))

    pixel_um = await known("pixelsizex", 0.0, _LARGEST_PIXEL_UM)
    return Chip(
        width_px=await side("cameraxsize"),
        height_px=await side("cameraysize"),
        pixel_um=pixel_um or None,
        max_adu=await known("maxadu", 1.0, _LARGEST_ADU),
        shortest_s=await known("exposuremin", 0.0, _LONGEST_S) or 0.0,
        longest_s=await known("exposuremax", 0.0, float("inf")) or _LONGEST_S,
        pattern=_SENSORS.get(round(await known("sensortype", 0, 9) or 0), ""),
        can_abort=bool(await device.maybe("canabortexposure", codec.truth)),
        can_stop=bool(await device.maybe("canstopexposure", codec.truth)),
    )


async def set_up(device: AlpacaDevice, chip: Chip, habits: CameraHabits) -> tuple[Field, list[str]]:
    """Have the whole chip read out, with the binning, gain and offset that are wanted.

    Only what is otherwise is set: another program may have used the camera since.

    Returns
    -------
    Field
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
    return await device.value(member, codec.integer)


async def _set(device: AlpacaDevice, member: str, said: str, value: int) -> bool:
    """Set a whole number unless it is so; see it set."""
    if await _whole(device, member) == value:
        return False
    await device.asking.put(member, {said: value})
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
        await device.asking.put(member, {said: value})
    except AlpacaRefused as refused:
        rounded = value - value % _STEP_PX
        if refused.number != INVALID_VALUE or rounded in (0, value):
            raise
        await device.asking.put(member, {said: rounded})
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
