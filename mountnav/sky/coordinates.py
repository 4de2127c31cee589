"""The kinds of coordinates, which never mix: a value carries its kind in its type [POINTING §0]."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from mountnav.units import ARCSEC_PER_DEG, SECONDS_PER_DAY

__all__ = [
    "SIDEREAL_ARCSEC_S",
    "SIDEREAL_DEG_S",
    "SOLAR_TO_SIDEREAL",
    "Air",
    "Apparent",
    "GeometricHourAngle",
    "HourAngle",
    "Icrs",
    "MountAxes",
    "Observed",
    "Site",
]


@dataclass(frozen=True, slots=True)
class Icrs:
    """An astrometric place: what catalogs hold (moved to date) and what a solution returns."""

    ra_deg: float
    dec_deg: float


@dataclass(frozen=True, slots=True)
class Apparent:
    """An apparent place of date ("JNow"): true equator and equinox of `utc`, geocentric, no refraction."""

    ra_deg: float
    dec_deg: float
    utc: datetime


@dataclass(frozen=True, slots=True)
class Observed:
    """A topocentric refracted place: what the tube points at. Azimuth runs north through east."""

    az_deg: float
    alt_deg: float
    utc: datetime


@dataclass(frozen=True, slots=True)
class HourAngle:
    """Observed (refracted) hour angle and declination; hour angle west positive, in (-180, 180]."""

    ha_deg: float
    dec_deg: float
    utc: datetime


@dataclass(frozen=True, slots=True)
class GeometricHourAngle:
    """Hour angle (west positive, in (-180, 180]) and declination of an apparent place: no refraction.

    What a mount that knows no refraction works with. Up to 200″ from `HourAngle` above 15° of altitude.
    """

    ha_deg: float
    dec_deg: float
    utc: datetime


@dataclass(frozen=True, slots=True)
class MountAxes:
    """What the axes' encoders would read: polar angle (west positive) and declination angle.

    ``dec_axis_deg`` is mechanical: beyond ±90 when the tube is beyond the pole.
    """

    ha_axis_deg: float
    dec_axis_deg: float


@dataclass(frozen=True, slots=True)
class Site:
    """Where the telescope stands; longitude EAST positive (WGS84)."""

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Air:
    """The air at the telescope; `pressure_hpa` is the station's (QFE), 0 switches refraction off."""

    pressure_hpa: float = 0.0
    temperature_c: float = 10.0
    relative_humidity: float = 0.5
    wavelength_um: float = 0.6


SIDEREAL_DEG_S = 360.98564736629 / SECONDS_PER_DAY
"""Of the mean sidereal time, degrees per second of UT1 [IAU 1982]. Doubled, nothing would be followed."""
SIDEREAL_ARCSEC_S = ARCSEC_PER_DEG * SIDEREAL_DEG_S
"""The same in arcseconds: 15.041."""
SOLAR_TO_SIDEREAL = SIDEREAL_DEG_S * SECONDS_PER_DAY / 360.0
"""Sidereal hours in an hour of UT1: 1.0027379."""
