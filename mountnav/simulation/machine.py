"""How a simulated mount is built: mounting, rates, limits, stations, and what it forgets without power."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from datetime import datetime
from typing import Literal

from mountnav.errors import BadSettings

Mounting = Literal["fork", "german"]
AxisAngles = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Machine:
    """The build of a mount. Axis angles are (hour angle axis, declination axis), deg.

    In the normal posture they are hour angle and declination. A German mount that looks through the pole has
    its hour angle axis 12 h on and its declination axis past the pole (90 to 270, in the south -90 to -270);
    with the counterweight down, its hour angle axis stands at 90 in both postures.

    Attributes
    ----------
    mounting : {"fork", "german"}
        A fork has one posture and each axis goes the shortest way; a German mount changes sides and never
        turns an axis all round.
    slew_rate_deg_s, acceleration_deg_s2 : float
        Of the hour angle axis, > 0.
    dec_slew_rate_deg_s, dec_acceleration_deg_s2 : float or None
        Of the declination axis; None: the same.
    encoder_arcsec : float
        Step of the encoders, to which reported angles are rounded; 0: none.
    ha_limits_deg, dec_limits_deg : (low, high) or None
        How far each axis turns.
    meridian_limits_deg : (east, west) or None
        German: how far the tube, on the east of the pier, may look east of the meridian, and how far, on
        the west of it, it may be tracked west of the meridian.
    lowest_altitude_deg : float or None
        Where the horizon is taken to be: `Mechanics.refusal` says no below, and tracking ends there.
    at_limit : {"stop", "flip", "ignore"}
        What happens there: motion ends; a German mount changes sides and tracks on; nothing.
    side_rule : {"meridian", "stay"}
        German: which side a slew takes: the one that looks its way; or the present one as long as it can.
    sync_reach_deg : float or None
        Syncs farther off are refused.
    home_axes_deg, park_axes_deg : (float, float) or None
        None: the pole, the German counterweight down; park None: home.
    home_sensor : bool
        Whether homing finds the true home and puts the belief right.
    starts_at : {"zenith", "home", "park"}
        Where it stands when made (in the normal posture); at "park" it is parked.
    boots_believing : {"home", "kept"}
        After a reboot it takes itself to be at home; or it still knows, as with absolute encoders.
    remembers_park, remembers_sync, remembers_clock, remembers_site : bool
        Whether these outlive a reboot.
    boot_utc : datetime or None
        Where a forgotten clock starts, aware UTC; None: 2000-01-01.
    boot_site : (latitude_deg, longitude_deg) or None
        Where a forgetful mount believes to stand; None: 0, 0.
    clock_offset_s, clock_drift_ppm : float
        Its clock minus UTC when made, and what it gains.

    Raises
    ------
    BadSettings
        When a value makes no mount.
    """

    mounting: Mounting = "fork"
    slew_rate_deg_s: float = 4.0
    acceleration_deg_s2: float = 2.0
    dec_slew_rate_deg_s: float | None = None
    dec_acceleration_deg_s2: float | None = None
    encoder_arcsec: float = 0.0
    ha_limits_deg: tuple[float, float] | None = None
    dec_limits_deg: tuple[float, float] | None = None
    meridian_limits_deg: tuple[float, float] | None = None
    lowest_altitude_deg: float | None = None
    at_limit: Literal["stop", "flip", "ignore"] = "stop"
    side_rule: Literal["meridian", "stay"] = "meridian"
    sync_reach_deg: float | None = None
    home_axes_deg: AxisAngles | None = None
    park_axes_deg: AxisAngles | None = None
    home_sensor: bool = False
    starts_at: Literal["zenith", "home", "park"] = "zenith"
    tracks_at_start: bool = True
    tracks_at_boot: bool = False
    tracks_after_unpark: bool = False
    boots_believing: Literal["home", "kept"] = "home"
    remembers_park: bool = True
    remembers_sync: bool = False
    remembers_clock: bool = True
    remembers_site: bool = True
    boot_utc: datetime | None = None
    boot_site: tuple[float, float] | None = None
    clock_offset_s: float = 0.0
    clock_drift_ppm: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            _check(field.name, getattr(self, field.name))
        if self.boot_utc is not None and self.boot_utc.utcoffset() is None:
            raise BadSettings(f"boot_utc = {self.boot_utc} doesn't say its time zone", advice="give UTC")

    @property
    def ha_range_deg(self) -> tuple[float, float]:
        """How far the hour angle axis turns, meridian limits included; infinite where there is no limit."""
        low, high = self.ha_limits_deg or (-math.inf, math.inf)
        if self.mounting == "german" and self.meridian_limits_deg is not None:
            east, west = self.meridian_limits_deg
            low, high = max(low, -east), min(high, 180.0 + west)
        return low, high

    @property
    def dec_range_deg(self) -> tuple[float, float]:
        """How far the declination axis turns; infinite where there is no limit."""
        return self.dec_limits_deg or (-math.inf, math.inf)

    def home_at(self, latitude_deg: float) -> AxisAngles:
        """Home position, axis angles."""
        if self.home_axes_deg is not None:
            return self.home_axes_deg
        return (90.0 if self.mounting == "german" else 0.0), math.copysign(90.0, latitude_deg)

    def park_at(self, latitude_deg: float) -> AxisAngles:
        """Park position as built, axis angles."""
        return self.home_at(latitude_deg) if self.park_axes_deg is None else self.park_axes_deg


_CHOICES = {
    "mounting": ("fork", "german"),
    "at_limit": ("stop", "flip", "ignore"),
    "side_rule": ("meridian", "stay"),
    "starts_at": ("zenith", "home", "park"),
    "boots_believing": ("home", "kept"),
}
_POSITIVE = {
    "slew_rate_deg_s",
    "acceleration_deg_s2",
    "dec_slew_rate_deg_s",
    "dec_acceleration_deg_s2",
    "sync_reach_deg",
}
_OPTIONAL = {"dec_slew_rate_deg_s", "dec_acceleration_deg_s2", "lowest_altitude_deg", "sync_reach_deg"}
_NUMBERS = {"slew_rate_deg_s", "acceleration_deg_s2", "encoder_arcsec", "clock_offset_s", "clock_drift_ppm"}
_PAIRS = {
    "ha_limits_deg",
    "dec_limits_deg",
    "meridian_limits_deg",
    "home_axes_deg",
    "park_axes_deg",
    "boot_site",
}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _check(name: str, value: object) -> None:
    """Refuse a value of a field that makes no mount."""
    if name in _CHOICES:
        if value not in _CHOICES[name]:
            raise BadSettings(f"{name} = {value!r}", advice=f"one of {', '.join(_CHOICES[name])}")
    elif name in _PAIRS:
        if value is not None:
            _check_pair(name, value)
    elif name == "boot_utc":
        if value is not None and not isinstance(value, datetime):
            raise BadSettings(
                f"{name} = {value!r} is not an instant", advice="for example 2000-01-01T00:00:00Z"
            )
    elif name in _NUMBERS or name in _OPTIONAL:
        if value is None and name in _OPTIONAL:
            return
        if not isinstance(value, int | float) or not _is_number(value):
            raise BadSettings(f"{name} = {value!r} is not a number")
        if name in _POSITIVE and value <= 0:
            raise BadSettings(f"{name} = {value} can't move a mount", advice="> 0")
        if name == "encoder_arcsec" and value < 0:
            raise BadSettings(f"{name} = {value} is not a step", advice=">= 0")
    elif not isinstance(value, bool):
        raise BadSettings(f"{name} = {value!r}", advice="true or false")


def _check_pair(name: str, value: object) -> None:
    if not isinstance(value, tuple) or len(value) != 2 or not all(_is_number(one) for one in value):
        raise BadSettings(f"{name} = {value!r} is not a pair of angles", advice="two numbers, deg")
    if name in ("ha_limits_deg", "dec_limits_deg") and value[0] >= value[1]:
        raise BadSettings(f"{name} = {value} leaves no room", advice="low, high")
