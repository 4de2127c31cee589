"""Azimuth and altitude of a fake mount: what it believes, and going there to stay."""

from __future__ import annotations

from dataclasses import replace

from mountnav.simulation.machine import AxisAngles
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.posture import axes_at, turned_near
from mountnav.sky.chain import (
    apparent_to_icrs,
    hour_angle_to_icrs,
    hour_angle_to_observed,
    icrs_to_apparent,
    icrs_to_hour_angle,
    observed_to_hour_angle,
)
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Observed
from mountnav.sky.sphere import half_turn_deg

_NO_AIR = Air(pressure_hpa=0.0)


def believed_horizon(mechanics: Mechanics) -> tuple[float, float]:
    """Return azimuth and altitude (deg) of where it believes to look."""
    angles = _hour_angle(mechanics, mechanics.reported())
    seen = hour_angle_to_observed(angles, mechanics.believed_site)
    return seen.az_deg, seen.alt_deg


def point_at_horizon(mechanics: Mechanics, az_deg: float, alt_deg: float) -> None:
    """Turn both axes until it believes to look there; it tracks afterwards if it did before."""
    site, now, tracking = mechanics.believed_site, mechanics.reported(), mechanics.tracking
    shown = mechanics.believed_utc(now.utc)
    angles = observed_to_hour_angle(Observed(az_deg, alt_deg, shown), site)
    target = icrs_to_apparent(hour_angle_to_icrs(angles, site, _NO_AIR), shown)
    side = mechanics.destination_side(replace(target, utc=now.utc))
    wanted = axes_at(angles.ha_deg, angles.dec_deg, mechanics.machine, side, site.latitude_deg)
    encoders = mechanics.axis_angle("ha", now.utc), mechanics.axis_angle("dec", now.utc)
    off = _belief_beyond_encoders(mechanics, now, encoders)
    aim = turned_near((wanted[0] - off[0], wanted[1] - off[1]), encoders, mechanics.machine, off[0])
    mechanics.drive_to("ha", aim[0])
    mechanics.drive_to("dec", aim[1])
    mechanics.tracking = tracking


def _hour_angle(mechanics: Mechanics, place: Apparent) -> HourAngle:
    """Hour angle that it makes of a place, by its own clock and site."""
    shown = mechanics.believed_utc(place.utc)
    icrs = apparent_to_icrs(replace(place, utc=shown))
    return icrs_to_hour_angle(icrs, shown, mechanics.believed_site, _NO_AIR)


def _belief_beyond_encoders(mechanics: Mechanics, now: Apparent, encoders: AxisAngles) -> AxisAngles:
    """What syncs have added to the encoders' angles."""
    angles, side = _hour_angle(mechanics, now), mechanics.pier_side(now.utc)
    latitude_deg = mechanics.believed_site.latitude_deg
    believed = axes_at(angles.ha_deg, angles.dec_deg, mechanics.machine, side, latitude_deg)
    return half_turn_deg(believed[0] - encoders[0]), half_turn_deg(believed[1] - encoders[1])
