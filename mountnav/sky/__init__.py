"""The sky: kinds of coordinates as types, the chain between them, the sphere, and the Earth offline."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mountnav.sky.chain import (
        apparent_to_hour_angle,
        apparent_to_icrs,
        hour_angle_to_apparent,
        hour_angle_to_icrs,
        hour_angle_to_observed,
        icrs_to_apparent,
        icrs_to_hour_angle,
        icrs_to_observed,
        observed_to_hour_angle,
        observed_to_icrs,
        sidereal_time_deg,
    )
    from mountnav.sky.coordinates import (
        Air,
        Apparent,
        GeometricHourAngle,
        HourAngle,
        Icrs,
        MountAxes,
        Observed,
        Site,
    )
    from mountnav.sky.iers import (
        EarthOrientation,
        IersStatus,
        earth_orientation,
        iers_status,
        override_dut1,
        prepare,
        read_tables,
    )
    from mountnav.sky.sphere import (
        Offset,
        displaced,
        gnomonic,
        gnomonic_inverse,
        offset_arcsec,
        position_angle_deg,
        separation_arcsec,
    )

__all__ = [
    "Air",
    "Apparent",
    "EarthOrientation",
    "GeometricHourAngle",
    "HourAngle",
    "Icrs",
    "IersStatus",
    "MountAxes",
    "Observed",
    "Offset",
    "Site",
    "apparent_to_hour_angle",
    "apparent_to_icrs",
    "displaced",
    "earth_orientation",
    "gnomonic",
    "gnomonic_inverse",
    "hour_angle_to_apparent",
    "hour_angle_to_icrs",
    "hour_angle_to_observed",
    "icrs_to_apparent",
    "icrs_to_hour_angle",
    "icrs_to_observed",
    "iers_status",
    "observed_to_hour_angle",
    "observed_to_icrs",
    "offset_arcsec",
    "override_dut1",
    "position_angle_deg",
    "prepare",
    "read_tables",
    "separation_arcsec",
    "sidereal_time_deg",
]

_ROOMS = ("coordinates", "sphere", "iers", "chain")


def __getattr__(name: str) -> object:
    # a room is opened when something in it is asked for: the kinds of coordinates alone need no ephemeris
    if name in __all__:
        for room in _ROOMS:
            inside = vars(import_module(f"{__name__}.{room}"))
            if name in inside:
                return inside[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
