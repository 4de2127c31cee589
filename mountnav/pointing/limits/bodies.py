"""Sun and Moon as seen from a site: no network, no ephemeris file, a few arcseconds (Moon) or less (Sun).

The Sun is where the Earth saw it 499 s ago [erfa.epv00]: that is light time and aberration at once. The Moon
is ``erfa.moon98`` (Meeus 1998, some ten arcseconds), seen from the site: its parallax is up to a degree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache

import erfa
import numpy as np

from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import GeometricHourAngle, Site
from mountnav.sky.iers import tt_minus_utc_s, utc_mjd
from mountnav.sky.sphere import half_turn_deg
from mountnav.units import AU_KM, MJD_ZERO_JD, SECONDS_PER_DAY

# Days that light takes for an astronomical unit (499.004784 s).
_LIGHT_DAYS_PER_AU = 499.004784 / SECONDS_PER_DAY
# Days that light takes from the Moon at its mean distance (1.28 s).
_MOON_LIGHT_DAYS = 1.28 / SECONDS_PER_DAY
# ERFA's number of the ellipsoid WGS 84.
_WGS84 = 1

SUN_DEG_PER_S = 15.0 / 3600.0
"""How fast the Sun's hour angle grows."""
MOON_DEG_PER_S = 14.4921 / 3600.0
"""How fast the Moon's does, on the average."""


@dataclass(frozen=True, slots=True)
class Bodies:
    """Sun and Moon at an instant: topocentric, no refraction."""

    sun: GeometricHourAngle
    moon: GeometricHourAngle


@lru_cache(maxsize=64)
def bodies(utc: datetime, site: Site) -> Bodies:
    """Find Sun and Moon.

    Parameters
    ----------
    utc : datetime
        Aware.

    Raises
    ------
    BadRequest
        The instant is naive or outside 1972 to 2099.
    """
    day, fraction = utc_mjd(utc)
    tt1, tt2 = MJD_ZERO_JD + day, fraction + tt_minus_utc_s(utc) / SECONDS_PER_DAY
    to_date = erfa.pnm06a(tt1, tt2)
    sidereal_deg = sidereal_time_deg(utc, site)
    observer_au = _observer_au(site, sidereal_deg)
    earth, _ = erfa.epv00(tt1, tt2 - _LIGHT_DAYS_PER_AU)
    moon = erfa.moon98(tt1, tt2 - _MOON_LIGHT_DAYS)
    return Bodies(
        _place(to_date @ -np.asarray(earth["p"]) - observer_au, sidereal_deg, utc),
        _place(to_date @ np.asarray(moon["p"]) - observer_au, sidereal_deg, utc),
    )


def _observer_au(site: Site, sidereal_deg: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Place of the site from the Earth's center, along equator and equinox of date; no polar motion."""
    x, _, z = erfa.gd2gc(_WGS84, 0.0, math.radians(site.latitude_deg), site.height_m) / (1000.0 * AU_KM)
    turn = math.radians(sidereal_deg)
    return np.array([x * math.cos(turn), x * math.sin(turn), z])


def _place(
    vector: np.ndarray[tuple[int], np.dtype[np.float64]], sidereal_deg: float, utc: datetime
) -> GeometricHourAngle:
    x, y, z = (float(part) for part in vector)
    ra_deg, dec_deg = math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))
    return GeometricHourAngle(half_turn_deg(sidereal_deg - ra_deg), dec_deg, utc)
