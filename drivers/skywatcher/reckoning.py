"""The sky for a controller that knows none: places, hour angles and altitudes at our site by our clock."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

from mountnav.sky.chain import (
    apparent_to_icrs,
    hour_angle_to_icrs,
    hour_angle_to_observed,
    icrs_to_apparent,
    icrs_to_hour_angle,
)
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Site

# refraction is left to who solves frames: a mount's own belief has none
_NO_AIR = Air(pressure_hpa=0.0)


def hour_angle_of(place: Apparent, utc: datetime, site: Site) -> HourAngle:
    """Hour angle and declination, at an instant, of a place whose numbers are taken as of date then."""
    return icrs_to_hour_angle(apparent_to_icrs(replace(place, utc=utc)), utc, site, _NO_AIR)


def place_of(ha_deg: float, dec_deg: float, utc: datetime, site: Site) -> Apparent:
    """Apparent place at an hour angle and declination."""
    return icrs_to_apparent(hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc), site, _NO_AIR), utc)


def altitude_deg(angles: HourAngle, site: Site) -> float:
    """Altitude above the horizon."""
    return hour_angle_to_observed(angles, site).alt_deg
