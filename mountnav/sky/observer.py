"""Where the observer and the Earth are: what every place of a near body is seen from.

Kilometers and seconds, along the axes of the ICRS.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

from mountnav.sky.chain import slow_parts
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.iers import EarthOrientation, earth_orientation, tt_minus_utc_s, utc_mjd
from mountnav.sky.kernel import NAIF_IDS, barycentric_state_km
from mountnav.sky.sphere import turn_deg
from mountnav.units import AU_KM, J2000_JD, LIGHT_KM_S, MJD_ZERO_JD, RAD_PER_ARCSEC, SECONDS_PER_DAY

Vector = NDArray[np.float64]

_WGS84 = 1
"""ERFA's number of the reference ellipsoid."""
_LIGHT_STEPS = 3
"""How often the light time is asked for again; each step is v/c of the one before, 1e-4: after three nothing
changes by a microsecond. Doubled, twice the time for nothing."""
_EARTH_TURN_RAD_S = 7.292115146706979e-5
"""How fast the Earth turns [IERS 2010]. Doubled, the observer's own motion is: 0.3″ of aberration."""


@dataclass(frozen=True, slots=True)
class Instant:
    """An instant in the time scales that ephemerides want.

    Attributes
    ----------
    jd1, jd2 : float
        Terrestrial time as a two-part Julian date.
    tdb2 : float
        As `jd2`, barycentric dynamical time.
    """

    jd1: float
    jd2: float
    tdb2: float


@lru_cache(maxsize=256)
def instant(utc: datetime) -> Instant:
    """The time scales of an instant. Raises `BadRequest` for a naive one or one outside 1972 to 2099."""
    day, fraction = utc_mjd(utc)
    jd2 = fraction + tt_minus_utc_s(utc) / SECONDS_PER_DAY
    # the largest two terms [Explanatory Supplement 2.222-1]: within 30 µs, a meter of the Earth's way
    g = math.radians(357.53 + 0.9856003 * (MJD_ZERO_JD + day - J2000_JD + jd2))
    return Instant(
        MJD_ZERO_JD + day,
        jd2,
        jd2 + (0.001657 * math.sin(g) + 0.000014 * math.sin(2.0 * g)) / SECONDS_PER_DAY,
    )


@lru_cache(maxsize=256)
def _matrices(utc: datetime, earth: EarthOrientation) -> tuple[Any, Any]:
    """From the ITRS to the GCRS; and to the terrestrial intermediate one, by polar motion alone."""
    now = instant(utc)
    slow = slow_parts(now.jd1, now.jd2)
    x, y = erfa.bpn2xy(slow.matrix)
    day, fraction = utc_mjd(utc)
    era = erfa.era00(MJD_ZERO_JD + day, fraction + earth.dut1_s / SECONDS_PER_DAY)
    polar = erfa.pom00(
        earth.polar_x_arcsec * RAD_PER_ARCSEC,
        earth.polar_y_arcsec * RAD_PER_ARCSEC,
        erfa.sp00(now.jd1, now.jd2),
    )
    celestial = erfa.c2ixys(x, y, slow.s_rad)
    # celestial to terrestrial is polar · R3(era) · celestial
    return erfa.c2tcio(celestial, era, polar).T, polar.T


def itrs_to_gcrs(utc: datetime) -> Any:
    """Matrix from the Earth-fixed axes to those of the ICRS, shape (3, 3), with polar motion."""
    return _matrices(utc, earth_orientation(utc))[0]


@lru_cache(maxsize=64)
def _site_km(site: Site) -> Any:
    place_m = erfa.gd2gc(
        _WGS84, math.radians(site.longitude_deg), math.radians(site.latitude_deg), site.height_m
    )
    return np.asarray(place_m) / 1000.0


def site_geocentric_km(utc: datetime, site: Site) -> tuple[Vector, Vector]:
    """Place, km, and velocity, km/s, of a site from the Earth's center, along the axes of the ICRS."""
    matrix = itrs_to_gcrs(utc)
    fixed = _site_km(site)
    turning = np.array([-fixed[1], fixed[0], 0.0]) * _EARTH_TURN_RAD_S
    return matrix @ fixed, matrix @ turning


def earth_barycentric_km(utc: datetime) -> tuple[Vector, Vector]:
    """Place, km, and velocity, km/s, of the Earth's center from the barycenter of the solar system.

    By the ephemeris in use; outside its span by ERFA's ``epv00``, which is within 13 km.
    """
    now = instant(utc)
    state = barycentric_state_km(NAIF_IDS["earth"], now.jd1, now.tdb2)
    if state is not None:
        return state[0], state[1] / SECONDS_PER_DAY
    _, earth = erfa.epv00(now.jd1, now.tdb2)
    return np.asarray(earth["p"]) * AU_KM, np.asarray(earth["v"]) * AU_KM / SECONDS_PER_DAY


def seen_from(
    barycentric_km: Callable[[float, float], Vector],
    utc: datetime,
    site: Site,
    earth_km: Vector | None = None,
) -> tuple[Vector, float]:
    """Where a body stands for an observer at a site: the astrometric vector, light time taken off.

    Parameters
    ----------
    barycentric_km : callable (jd1, jd2) -> ndarray, shape (3,)
        The body's place from the barycenter of the solar system, km; TDB as a two-part Julian date.
    utc : datetime
        Aware.
    earth_km : ndarray, shape (3,), optional
        The Earth's center by the same source as the body; by the ephemeris in use if not given. The
        barycenters of DE440 and of ERFA's formulas lie 100 km apart, which is 1′ at the Moon.

    Returns
    -------
    vector_km : ndarray, shape (3,)
        From the observer now to where the body was when the light left.
    """
    now = instant(utc)
    earth = earth_barycentric_km(utc)[0] if earth_km is None else earth_km
    observer = earth + site_geocentric_km(utc, site)[0]
    light_s = 0.0
    vector = observer
    for _ in range(_LIGHT_STEPS):
        vector = barycentric_km(now.jd1, now.tdb2 - light_s / SECONDS_PER_DAY) - observer
        light_s = float(np.linalg.norm(vector)) / LIGHT_KM_S
    return vector, light_s


def direction(vector: Vector) -> Icrs:
    """Where a vector points."""
    x, y, z = (float(part) for part in vector)
    return Icrs(turn_deg(math.degrees(math.atan2(y, x))), math.degrees(math.atan2(z, math.hypot(x, y))))
