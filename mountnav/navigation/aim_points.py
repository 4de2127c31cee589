"""Points beside the middle of the frame that a target is brought to: a slit, a fiber, another camera.

All of it is geometry. Pixels count from 0, and whole numbers are centers of pixels: (0, 0) is the center of
the file's first pixel, FITS's (1, 1). The middle of a frame is ((W - 1) / 2, (H - 1) / 2).

A point is fixed in the tube. Seen from the frame's middle it lies at the end of an arm: so many seconds of
arc long, at an angle to the image's +y that no slew changes. A German mount turns the image by 180° on the
other side of the pier, and the arm with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime

from mountnav.errors import BadRequest, BadSettings
from mountnav.navigation.camera import Mounting, Normal, axis_angle_deg
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_hour_angle, icrs_to_observed, observed_to_icrs
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Observed, Site
from mountnav.sky.sphere import (
    displaced,
    half_turn_deg,
    position_angle_deg,
    separation_arcsec,
    turn_deg,
)
from mountnav.solution import Solution
from mountnav.units import ARCSEC_PER_RAD

__all__ = [
    "AimPoint",
    "Arm",
    "FrameSize",
    "MountFrame",
    "OffsetPoint",
    "PixelPoint",
    "Unreachable",
    "arm_by_camera",
    "arm_seen",
    "axis_for",
    "by_name",
    "frame_size_of",
    "middle_for",
    "pixel_in",
]

_VACUUM = Air(pressure_hpa=0.0)
"""No refraction. A place with it instead puts an arm of 1.5° at altitude 20° wrong by 11″ before a look."""

LONGEST_ARM_DEG = 20.0
"""A point is no further than this from the frame's middle, °: beyond it no camera sees it, and no other tube
on the same mount looks. Chosen by hand. Doubled, a mistyped offset of 40° would be slewed to."""


@dataclass(frozen=True, slots=True)
class FrameSize:
    """Of the frames of a camera that looks; `binning` is 0 where it isn't known."""

    width_px: int
    height_px: int
    binning: int = 0


@dataclass(frozen=True, slots=True)
class PixelPoint:
    """A pixel of the look camera.

    Attributes
    ----------
    name : str
        Empty for one that an order names by its pixel alone.
    x_px, y_px : float
        From 0; whole numbers are centers of pixels.
    width_px, height_px : int or None
        Of the frame in which it was measured: another size that differs by its binning alone is converted.
    binning : int or None
        Of that frame.
    turned_deg : float
        Position angle of the point's own direction (a slit's length, +y of another camera) minus that of the
        image's +y, on the sky from north through east.
    """

    name: str
    x_px: float
    y_px: float
    width_px: int | None = None
    height_px: int | None = None
    binning: int | None = None
    turned_deg: float = 0.0

    def __post_init__(self) -> None:
        _require_numbers(self.name, self.x_px, self.y_px, self.turned_deg)

    def __str__(self) -> str:
        """For messages."""
        pixel = f"pixel ({self.x_px:.6g}, {self.y_px:.6g})"
        return f"{self.name}, {pixel}" if self.name else pixel


@dataclass(frozen=True, slots=True)
class OffsetPoint:
    """Another tube on the same mount: where it looks, seen from the middle of the look camera's frame.

    Attributes
    ----------
    east_arcsec, north_arcsec : float
        On the sky, when the look camera's image stood at `at_rotation_deg`.
    at_rotation_deg : float
        Solved rotation of the look camera's frame (position angle of +y) when these were measured.
    turned_deg : float
        As of `PixelPoint`.
    """

    name: str
    east_arcsec: float
    north_arcsec: float
    at_rotation_deg: float
    turned_deg: float = 0.0

    def __post_init__(self) -> None:
        _require_numbers(
            self.name, self.east_arcsec, self.north_arcsec, self.at_rotation_deg, self.turned_deg
        )
        length_deg = math.hypot(self.east_arcsec, self.north_arcsec) / 3600.0
        if length_deg > LONGEST_ARM_DEG:
            raise BadSettings(
                f"point {self.name}: {length_deg:.1f}° beside the frame's middle is further than "
                f"{LONGEST_ARM_DEG:g}°",
                advice="offsets are in seconds of arc",
            )

    def __str__(self) -> str:
        """For messages."""
        return f"{self.name}, {math.hypot(self.east_arcsec, self.north_arcsec):.0f}″ beside the middle"


AimPoint = PixelPoint | OffsetPoint


def _require_numbers(name: str, *values: float) -> None:
    if not all(math.isfinite(value) for value in values):
        raise BadSettings(f"point {name or 'of the order'}: {values} are not numbers")


def by_name(points: tuple[AimPoint, ...], name: str, *, device: str | None = None) -> AimPoint:
    """The point of that name. Raises `BadRequest`."""
    for point in points:
        if point.name == name:
            return point
    known = ", ".join(point.name for point in points)
    raise BadRequest(
        f"there is no point {name!r}",
        device=device,
        advice=f"there is: {known}" if known else "name one in [[telescope.point]], or give x_px and y_px",
    )


def frame_size_of(camera: str) -> FrameSize | None:
    """The frame's size by a camera's identity in words, as `CameraIdentity` writes it; None without one."""
    head, _, binned = camera.partition(" binned ")
    width, cross, height = head.rpartition(" ")[2].partition("×")
    if not (cross and width.isdecimal() and height.isdecimal()):
        return None
    across, _, down = binned.partition("x")
    binning = int(across) if across.isdecimal() and across == down else 0
    return FrameSize(int(width), int(height), binning)


# -- pixels ----------------------------------------------------------------------------------------


def pixel_in(point: PixelPoint, frame: FrameSize) -> tuple[float, float]:
    """The point's pixel in frames of this size, which may be binned otherwise.

    Returns
    -------
    x_px, y_px : float
        From 0.

    Raises
    ------
    BadRequest
        It isn't within the frame, or the frame's size isn't that in which it was measured, binned.
    """
    factor = _binned_by(point, frame)
    x_px, y_px = ((value + 0.5) / factor - 0.5 for value in (point.x_px, point.y_px))
    if not (-0.5 <= x_px <= frame.width_px - 0.5 and -0.5 <= y_px <= frame.height_px - 0.5):
        raise BadRequest(
            f"{point} isn't within the camera's frame of {frame.width_px}×{frame.height_px} pixels",
            advice="pixels count from 0: the last one is (width - 1, height - 1); give the binning of the "
            "frame in which it was measured",
        )
    return x_px, y_px


def _binned_by(point: PixelPoint, frame: FrameSize) -> float:
    """How many of the point's pixels are one of the frame's."""
    if point.width_px is None or point.height_px is None:
        return frame.binning / point.binning if point.binning and frame.binning else 1.0
    if point.binning and frame.binning:
        factor = frame.binning / point.binning
    else:
        # by the sizes alone: a binned frame loses what is left over of a pixel at its edges
        across = point.width_px / frame.width_px
        factor = float(round(across)) if across >= 1.0 else 1.0 / round(1.0 / across)
    for measured, now in ((point.width_px, frame.width_px), (point.height_px, frame.height_px)):
        if abs(measured / factor - now) > 1.0:
            raise BadRequest(
                f"{point} was measured in a frame of {point.width_px}×{point.height_px} pixels, and the "
                f"camera's is {frame.width_px}×{frame.height_px}: another part of the chip, or another one",
                advice="read out the whole chip, or measure the point again",
            )
    return factor


# -- arms ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Arm:
    """From the frame's middle to a point.

    Attributes
    ----------
    angle_deg : float
        Position angle at the middle, minus that of the image's +y.
    """

    length_arcsec: float
    angle_deg: float

    def end(self, middle: Icrs, rotation_deg: float) -> Icrs:
        """Where the point looks when the frame's middle looks at `middle`, with that rotation."""
        angle = math.radians(rotation_deg + self.angle_deg)
        return displaced(middle, self.length_arcsec * math.sin(angle), self.length_arcsec * math.cos(angle))


def arm_seen(point: AimPoint, solution: Solution, frame: FrameSize) -> Arm:
    """The arm by a solved frame, its distortion included.

    Raises
    ------
    BadRequest
        As `pixel_in`.
    """
    if isinstance(point, OffsetPoint):
        return _arm_of_offset(point)
    x_px, y_px = pixel_in(point, frame)
    middle = solution.icrs_at((frame.width_px - 1) / 2, (frame.height_px - 1) / 2)
    there = solution.icrs_at(x_px, y_px)
    return Arm(
        separation_arcsec(middle, there),
        turn_deg(position_angle_deg(middle, there) - solution.rotation_deg),
    )


def arm_by_camera(point: AimPoint, normal: Normal | None, frame: FrameSize | None) -> Arm | None:
    """The arm by what solves have taught of the camera; None where that isn't enough.

    Parameters
    ----------
    normal : Normal or None
        As `Learned.normal`.
    frame : FrameSize or None
        Of the camera that looks.

    Raises
    ------
    BadRequest
        As `pixel_in`.
    """
    if isinstance(point, OffsetPoint):
        return _arm_of_offset(point)
    if frame is None:
        return None
    x_px, y_px = pixel_in(point, frame)
    if normal is None:
        return None
    right_px, up_px = x_px - (frame.width_px - 1) / 2, y_px - (frame.height_px - 1) / 2
    radius_px = math.hypot(right_px, up_px)
    length_rad = math.atan(normal.scale_arcsec_px * _undistorted(radius_px, normal) / ARCSEC_PER_RAD)
    # seen as the sky is, +x lies a right angle to the west of +y
    angle_deg = math.degrees(math.atan2(-normal.parity * right_px, up_px))
    return Arm(length_rad * ARCSEC_PER_RAD, turn_deg(angle_deg))


def _undistorted(radius_px: float, normal: Normal) -> float:
    """How far from the middle a star belongs that appears at this distance, by the plates, pixels."""
    return radius_px * (1.0 - (normal.distortion_px2 or 0.0) * radius_px**2)


def _arm_of_offset(point: OffsetPoint) -> Arm:
    angle_deg = math.degrees(math.atan2(point.east_arcsec, point.north_arcsec))
    return Arm(math.hypot(point.east_arcsec, point.north_arcsec), turn_deg(angle_deg - point.at_rotation_deg))


# -- where the middle must look ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Unreachable:
    """The point can't look there in this posture: the mount's pole is too near.

    Attributes
    ----------
    short_arcsec : float
        By how much.
    """

    short_arcsec: float


@dataclass(frozen=True, slots=True)
class MountFrame:
    """A mount's own north at one instant: an alt-azimuth mount's is the zenith.

    Refraction is left out: it squeezes the sky, and the arm with it, as the plate of each look shows.

    Attributes
    ----------
    mounting : {"german", "fork", "altaz"} or None
        Anything but "altaz" turns about a polar axis.
    """

    mounting: Mounting | None
    utc: datetime
    site: Site

    def angle_deg(self, place: Icrs, rotation_deg: float) -> float:
        """A rotation at a place, counted from the mount's north instead of the ICRS's."""
        return axis_angle_deg(place, place, rotation_deg, self.utc, self.site, _VACUUM, self.mounting)[0]

    def rotation_deg(self, place: Icrs, angle_deg: float) -> float:
        """The inverse of `angle_deg`."""
        return turn_deg(angle_deg - self.angle_deg(place, 0.0))

    def longitude_latitude(self, place: Icrs) -> tuple[float, float]:
        """In the mount's frame, degrees; the longitude grows to the left as the sky is seen."""
        if self.mounting == "altaz":
            observed = icrs_to_observed(place, self.utc, self.site, _VACUUM)
            return -observed.az_deg, observed.alt_deg
        here = icrs_to_hour_angle(place, self.utc, self.site, _VACUUM)
        return -here.ha_deg, here.dec_deg

    def icrs(self, longitude_deg: float, latitude_deg: float) -> Icrs:
        """The inverse of `longitude_latitude`."""
        if self.mounting == "altaz":
            observed = Observed(turn_deg(-longitude_deg), latitude_deg, self.utc)
            return observed_to_icrs(observed, self.site, _VACUUM)
        here = HourAngle(half_turn_deg(-longitude_deg), latitude_deg, self.utc)
        return hour_angle_to_icrs(here, self.site, _VACUUM)


def axis_for(target: Icrs, arm: Arm, angle_deg: float, frame: MountFrame) -> Icrs | Unreachable:
    """Where the frame's middle must look for the point at the end of the arm to look at the target.

    A slew keeps the angle between the image and the mount's own north, at the middle and not at the target:
    near the pole that makes the difference.

    Parameters
    ----------
    angle_deg : float
        Of the image's +y from the mount's north, in the posture that it will have.
    """
    longitude_deg, latitude_deg = frame.longitude_latitude(target)
    found = middle_for(longitude_deg, latitude_deg, arm.length_arcsec, angle_deg + arm.angle_deg)
    return found if isinstance(found, Unreachable) else frame.icrs(*found)


def middle_for(
    longitude_deg: float, latitude_deg: float, length_arcsec: float, angle_deg: float
) -> tuple[float, float] | Unreachable:
    """From which place an arc of this length and position angle (at that place) leads to the given one."""
    length = length_arcsec / ARCSEC_PER_RAD
    angle, latitude = math.radians(angle_deg), math.radians(latitude_deg)
    # sin φ = cos ρ sin φ₀ + sin ρ cos θ cos φ₀ = reach · sin(φ₀ + lift)
    along, up = math.cos(length), math.sin(length) * math.cos(angle)
    reach, lift = math.hypot(along, up), math.atan2(up, along)
    highest = math.asin(min(1.0, reach))
    if abs(latitude) > highest:
        return Unreachable((abs(latitude) - highest) * ARCSEC_PER_RAD)
    inclined = math.asin(max(-1.0, min(1.0, math.sin(latitude) / reach)))
    for middle in (inclined - lift, math.copysign(math.pi, inclined) - inclined - lift):
        if abs(middle) <= math.pi / 2.0:
            break
    else:
        return Unreachable((abs(inclined - lift) - math.pi / 2.0) * ARCSEC_PER_RAD)
    eastward = math.atan2(
        math.sin(length) * math.sin(angle),
        math.cos(middle) * math.cos(length) - math.sin(middle) * math.sin(length) * math.cos(angle),
    )
    return longitude_deg - math.degrees(eastward), math.degrees(middle)
