"""A target on a point beside the frame's middle: where the middle must look, before and after each look.

Before a look it follows from what solves have taught of the camera, if that is known; after one from its
plate, whatever is believed of the camera. Limits hold for where the tube looks, not for where the point does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime

from mountnav.devices import PierSide
from mountnav.ephemeris import Ephemeris
from mountnav.errors import BadRequest, NotReached, TargetNotReached
from mountnav.navigation.aim_points import (
    AimPoint,
    Arm,
    FrameSize,
    MountFrame,
    OffsetPoint,
    PixelPoint,
    Unreachable,
    arm_by_camera,
    arm_seen,
    axis_for,
    frame_size_of,
    pixel_in,
)
from mountnav.navigation.camera import Mounting
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.reports import Look, PointSeen
from mountnav.sky.chain import icrs_to_hour_angle
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Icrs, Site
from mountnav.sky.sphere import turn_deg

__all__ = ["Aiming", "AxisEphemeris", "point_seen"]


def point_seen(point: AimPoint, found: Look) -> PointSeen:
    """Where a point looked in a solved frame. Raises `BadRequest` if it isn't within the frame."""
    size = _size_of(found)
    arm = arm_seen(point, found.solution, size)
    pixel = pixel_in(point, size) if isinstance(point, PixelPoint) else (None, None)
    return PointSeen(
        name=point.name,
        place=_place(point, found),
        x_px=pixel[0],
        y_px=pixel[1],
        from_middle_arcsec=arm.length_arcsec,
        position_angle_deg=turn_deg(found.solution.rotation_deg + point.turned_deg),
    )


def _place(point: AimPoint, found: Look) -> Icrs:
    size = _size_of(found)
    if isinstance(point, PixelPoint):
        return found.solution.icrs_at(*pixel_in(point, size))
    return arm_seen(point, found.solution, size).end(found.seen, found.solution.rotation_deg)


def _size_of(found: Look) -> FrameSize:
    told = None if found.camera is None else frame_size_of(str(found.camera))
    return FrameSize(found.width_px, found.height_px, 0 if told is None else told.binning)


@dataclass(frozen=True, slots=True)
class AxisEphemeris:
    """Where the frame's middle must look for a point to follow a target that moves.

    Attributes
    ----------
    arm : Arm
        To the point, as it was learned.
    camera_deg : float
        Angle of the image's +y from the mount's north, on the side of the pier that it is followed on.
    """

    target: Ephemeris
    arm: Arm
    camera_deg: float
    mounting: Mounting | None

    @property
    def name(self) -> str:
        """The target's."""
        return self.target.name

    @property
    def begins_utc(self) -> datetime | None:
        """From when on it can be asked."""
        return self.target.begins_utc

    @property
    def ends_utc(self) -> datetime | None:
        """Until when."""
        return self.target.ends_utc

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """Where the middle must look. Raises `BadRequest` outside of its span, and by the mount's pole."""
        frame = MountFrame(self.mounting, utc, site)
        axis = axis_for(self.target.icrs(utc, site), self.arm, self.camera_deg, frame)
        if isinstance(axis, Unreachable):
            raise BadRequest(f"{self.name}: the point can't be brought so near to the mount's pole")
        return axis

    def sigma_arcsec(self, utc: datetime) -> float:
        """Of the target's place."""
        return self.target.sigma_arcsec(utc)


@dataclass(frozen=True, slots=True)
class Aiming:
    """Brings targets to one point of one telescope; without a point, to the frame's middle.

    Attributes
    ----------
    point : AimPoint or None
        None: the frame's middle.
    """

    equipment: Equipment
    point: AimPoint | None = None

    @property
    def words(self) -> str:
        """For messages."""
        return "the frame's middle" if self.point is None else str(self.point)

    def place(self, found: Look) -> Icrs:
        """Where the point looked. Raises `BadRequest` if it isn't within the frame."""
        return found.seen if self.point is None else _place(self.point, found)

    def seen(self, found: Look) -> PointSeen | None:
        """The same with all that is to be told of it; None without a point."""
        return None if self.point is None else point_seen(self.point, found)

    def camera_deg(self, found: Look) -> float:
        """Angle of the image's +y from the mount's own north, as a look shows it."""
        return self._frame(found.mid_exposure_utc).angle_deg(found.seen, found.solution.rotation_deg)

    def axis_before(self, target: Icrs, side: PierSide) -> Icrs | None:
        """Where the middle must look, by what solves have taught; None where that isn't enough.

        Parameters
        ----------
        side : PierSide
            On which the tube will hang there.

        Raises
        ------
        BadRequest
            The point isn't within the camera's frames.
        OutsideLimits
            Another tube would look into the Sun.
        """
        if self.point is None:
            return target
        self._require_no_sun(target)
        learned = self.equipment.guard.learned
        arm = arm_by_camera(self.point, learned.normal, self._frame_size())
        angle_deg = learned.angle_on(side)
        if arm is None or angle_deg is None:
            return None
        found = axis_for(target, arm, angle_deg, self._frame(self.equipment.clock.utc()))
        # what was learned may be a little off: near the pole looks will tell
        return None if isinstance(found, Unreachable) else found

    def axis_after(self, target: Icrs, found: Look, *, flipped: bool = False) -> Icrs:
        """Where the middle must look, by what a look showed of the point.

        Parameters
        ----------
        flipped : bool
            With the tube on the other side of the pier than in that look.

        Raises
        ------
        BadRequest
            The point isn't within the frame.
        TargetNotReached
            In this posture it can't look there: the mount's pole is too near.
        """
        if self.point is None:
            return target
        arm = arm_seen(self.point, found.solution, _size_of(found))
        angle_deg = self.camera_deg(found) + (180.0 if flipped else 0.0)
        axis = axis_for(target, arm, angle_deg, self._frame(found.mid_exposure_utc))
        if not isinstance(axis, Unreachable):
            return axis
        raise TargetNotReached(
            f"{self.words} lies {arm.length_arcsec:.0f}″ beside the middle, and in this posture it can't be "
            f"brought nearer than {axis.short_arcsec:.0f}″ to a target so near to the pole",
            device=self.equipment.name,
            advice="flip the mount, turn the camera, or choose a point nearer to the middle",
            reason=NotReached.POLE,
        )

    def between_sides(self, target: Icrs, found: Look, *, sure: bool = False) -> TargetNotReached | None:
        """Why a mount changes sides of the pier with each correction, and will again; None if it needn't.

        On each side the frame's middle would have to look at the half of the sky for which the mount takes
        the other one.

        Parameters
        ----------
        sure : bool
            It is said also if it needn't: by the pole mounts take sides by counts of their own.
        """
        equipment, later = self.equipment, ""
        for flipped in (False, True):
            east = (found.after.side is PierSide.EAST) is not flipped
            try:
                axis = self.axis_after(target, found, flipped=flipped)
            except TargetNotReached:
                continue
            here = icrs_to_hour_angle(axis, equipment.clock.utc(), equipment.site, equipment.air)
            if (here.ha_deg >= 0.0) is east:
                if not sure:
                    return None
            elif east:
                minutes = -here.ha_deg / SIDEREAL_DEG_S / 60.0
                later = (
                    f"in about {minutes:.0f} min the meridian is passed for this point, too: order it then"
                )
        return TargetNotReached(
            f"the target stands at the meridian: to bring it to {self.words} the mount would have to point "
            "to the other half of the sky from either side of the pier, so it would change sides each time",
            device=equipment.name,
            advice=later or "order it again later, or choose a point nearer to the middle",
            reason=NotReached.SIDE,
        )

    def _frame_size(self) -> FrameSize | None:
        known = frame_size_of(self.equipment.guard.camera)
        if known is None and isinstance(self.point, PixelPoint) and self.point.width_px is not None:
            # the frames in which it was measured; the first look tells if they are others now
            assert self.point.height_px is not None
            return FrameSize(self.point.width_px, self.point.height_px, self.point.binning or 0)
        return known

    def _frame(self, utc: datetime) -> MountFrame:
        equipment = self.equipment
        return MountFrame(equipment.guard.learned.rules.mounting, utc, equipment.site)

    def _require_no_sun(self, target: Icrs) -> None:
        if not isinstance(self.point, OffsetPoint):
            return
        equipment = self.equipment
        sun_alone = replace(
            equipment.mount.limits,
            min_altitude_deg=-90.0,
            max_altitude_deg=90.0,
            horizon=None,
            hour_angle_deg=None,
            declination_deg=None,
            moon_cone_deg=0.0,
            daylight="allow",
        )
        sun_alone.check(target, equipment.clock.utc(), equipment.site, equipment.air)

    def path(self, target: Ephemeris, side: PierSide) -> Ephemeris:
        """Where the middle must look along a target's path, by what solves have taught.

        Raises
        ------
        BadRequest
            It isn't known yet where the point looks.
        OutsideLimits
        """
        if self.point is None:
            return target
        now = self.equipment.clock.utc()
        self.require_known(target.icrs(now, self.equipment.site), side)
        learned = self.equipment.guard.learned
        arm, camera_deg = (
            arm_by_camera(self.point, learned.normal, self._frame_size()),
            learned.angle_on(side),
        )
        assert arm is not None
        assert camera_deg is not None
        return AxisEphemeris(target, arm, camera_deg, learned.rules.mounting)

    def require_known(self, target: Icrs, side: PierSide) -> Icrs:
        """As `axis_before`, for an order that doesn't look.

        Raises
        ------
        BadRequest
            It isn't known yet where the point looks.
        OutsideLimits
        """
        axis = self.axis_before(target, side)
        if axis is not None:
            return axis
        raise BadRequest(
            f"it is not known yet where {self.words} looks: how the camera is mounted on the tube must be "
            f"measured first ({self.equipment.guard.learned.words})",
            device=self.equipment.name,
            advice="order center, which looks; or look at three fields, then slew",
        )
