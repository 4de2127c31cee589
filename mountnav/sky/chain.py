"""The way between kinds of coordinates: every conversion is a function here, and there is no other way.

::

    Icrs ── Apparent ── GeometricHourAngle          equinox of date, geocentric, no refraction
      └──── HourAngle ── Observed                   topocentric; refracted if the air has a pressure

Only ERFA is used: IAU 2006/2000A precession-nutation, aberration, light deflection by the Sun, polar motion,
diurnal aberration and refraction [POINTING §1]. Instants are aware datetimes; naive ones raise `BadRequest`.
Conversions cost 0.06 ms for a new instant, 0.5 ms for the first of an hour, and some ten microseconds for the
same one again.

The slow parts, computed hour by hour: the Earth's way around the Sun, precession and nutation.

To sum up the series of IAU 2000A and of the Earth's ephemeris takes four fifths of the time of a conversion
at a new instant, and their fastest term takes five days. They are summed up at full hours of terrestrial time
and drawn straight between two of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from math import floor
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

from mountnav.sky.coordinates import Air, Apparent, GeometricHourAngle, HourAngle, Icrs, Observed, Site
from mountnav.sky.iers import EarthOrientation, earth_orientation, tt_minus_utc_s, utc_mjd
from mountnav.sky.sphere import half_turn_deg, turn_deg
from mountnav.units import MJD_ZERO_JD, RAD_PER_ARCSEC, SECONDS_PER_DAY

Array = NDArray[np.float64]

_NODES_PER_DAY = 24
"""Full hours. Straight lines between them miss the nutation by 1.3e-5″ at most (its term of 13.7 days: 0.23″
times its rate squared times an hour squared by eight); twice as many, a quarter of that."""


@dataclass(frozen=True, slots=True)
class SlowParts:
    """The Earth's position and orientation at an instant, as ERFA takes them.

    Attributes
    ----------
    barycentric : ndarray of erfa's dtype pv
        Place and velocity, au and au a day.
    heliocentric : ndarray, shape (3,)
        Place, au.
    matrix : ndarray, shape (3, 3)
        Bias, precession and nutation: from the ICRS to the true equator and equinox.
    s_rad : float
        The CIO locator.
    """

    barycentric: Any
    heliocentric: Array
    matrix: Array
    s_rad: float


@lru_cache(maxsize=64)
def _at_node(node: int) -> Array:
    """All of it at a full hour, in one row."""
    tt1, tt2 = MJD_ZERO_JD + node // _NODES_PER_DAY, (node % _NODES_PER_DAY) / _NODES_PER_DAY
    heliocentric, barycentric = erfa.epv00(tt1, tt2)
    matrix = erfa.pnm06a(tt1, tt2)
    x, y = erfa.bpn2xy(matrix)
    s_rad = erfa.s06(tt1, tt2, x, y)
    return np.concatenate(
        (barycentric["p"], barycentric["v"], heliocentric["p"], matrix.ravel(), [float(s_rad)])
    )


def slow_parts(tt1: float, tt2: float) -> SlowParts:
    """The slow parts at an instant.

    Parameters
    ----------
    tt1, tt2 : float
        Terrestrial time as a two-part Julian date.

    Returns
    -------
    SlowParts
        Within 2e-5″ of what the series give.
    """
    at = ((tt1 - MJD_ZERO_JD) + tt2) * _NODES_PER_DAY
    node = floor(at)
    before = _at_node(node)
    row = before + (at - node) * (_at_node(node + 1) - before)
    barycentric = np.empty((), dtype=erfa.dt_pv)
    barycentric["p"], barycentric["v"] = row[0:3], row[3:6]
    return SlowParts(barycentric, row[6:9], row[9:18].reshape(3, 3), float(row[18]))


_REFRACTION_STEPS = 8
"""Iterations of the inverse refraction at most; it ends before, once it has converged to
`_REFRACTION_DONE_RAD`."""
_REFRACTION_DONE_RAD = 1e-4 * RAD_PER_ARCSEC
"""The iteration ends when it is within 0.1 mas; doubled, positions near the horizon may be off by 0.2 mas."""


def _terrestrial(utc: datetime) -> tuple[float, float]:
    """Terrestrial time as a two-part Julian date.

    Made here and not by ``erfa.utctai``, which warns of a "dubious year" five years after its release.
    """
    day, fraction = utc_mjd(utc)
    return MJD_ZERO_JD + day, fraction + tt_minus_utc_s(utc) / SECONDS_PER_DAY


@lru_cache(maxsize=64)
def _geocentric(utc: datetime) -> tuple[Any, float]:
    """ERFA's star-independent parameters for the geocenter, and the equation of the origins."""
    tt1, tt2 = _terrestrial(utc)
    earth = slow_parts(tt1, tt2)
    x, y = erfa.bpn2xy(earth.matrix)
    astrom = erfa.apci(tt1, tt2, earth.barycentric, earth.heliocentric, x, y, earth.s_rad)
    return astrom, float(erfa.eors(earth.matrix, earth.s_rad))


@lru_cache(maxsize=64)
def _refraction(air: Air) -> tuple[float, float]:
    """ERFA's constants A and B of the air."""
    a, b = erfa.refco(air.pressure_hpa, air.temperature_c, air.relative_humidity, air.wavelength_um)
    return float(a), float(b)


@lru_cache(maxsize=64)
def _topocentric(utc: datetime, site: Site, air: Air, earth: EarthOrientation) -> Any:
    """ERFA's star-independent parameters for a site and its air: ``apco13`` with our own time scales."""
    tt1, tt2 = _terrestrial(utc)
    day, fraction = utc_mjd(utc)
    slow = slow_parts(tt1, tt2)
    x, y = erfa.bpn2xy(slow.matrix)
    refraction_a, refraction_b = _refraction(air)
    return erfa.apco(
        tt1,
        tt2,
        slow.barycentric,
        slow.heliocentric,
        x,
        y,
        slow.s_rad,
        erfa.era00(MJD_ZERO_JD + day, fraction + earth.dut1_s / SECONDS_PER_DAY),
        math.radians(site.longitude_deg),
        math.radians(site.latitude_deg),
        site.height_m,
        earth.polar_x_arcsec * RAD_PER_ARCSEC,
        earth.polar_y_arcsec * RAD_PER_ARCSEC,
        erfa.sp00(tt1, tt2),
        refraction_a,
        refraction_b,
    )


def _at(utc: datetime, site: Site, air: Air) -> Any:
    return _topocentric(utc, site, air, earth_orientation(utc))


def icrs_to_apparent(place: Icrs, utc: datetime) -> Apparent:
    """Convert to the apparent ("JNow") place of `utc`: aberrated, true equator and equinox, geocentric.

    Raises
    ------
    BadRequest
        The instant is naive or outside 1972 to 2099.
    """
    astrom, eo = _geocentric(utc)
    ra_cio, dec = erfa.atciqz(math.radians(place.ra_deg), math.radians(place.dec_deg), astrom)
    return Apparent(turn_deg(math.degrees(float(ra_cio) - eo)), math.degrees(float(dec)), utc)


def apparent_to_icrs(place: Apparent) -> Icrs:
    """Inverse of `icrs_to_apparent`.

    Raises
    ------
    BadRequest
        The place's instant is naive or outside 1972 to 2099.
    """
    astrom, eo = _geocentric(place.utc)
    ra, dec = erfa.aticq(math.radians(place.ra_deg) + eo, math.radians(place.dec_deg), astrom)
    return Icrs(turn_deg(math.degrees(float(ra))), math.degrees(float(dec)))


def icrs_to_hour_angle(place: Icrs, utc: datetime, site: Site, air: Air) -> HourAngle:
    """Observed hour angle and declination: refracted if the air has a pressure, else topocentric.

    Refraction is good to 0.06″ down to 15° of altitude, to 1″ at 10°, and means nothing below 5°.

    Raises
    ------
    BadRequest
        The instant is naive or outside 1972 to 2099.
    """
    astrom = _at(utc, site, air)
    ra_cio, dec_cio = erfa.atciqz(math.radians(place.ra_deg), math.radians(place.dec_deg), astrom)
    _, _, ha, dec, _ = erfa.atioq(ra_cio, dec_cio, astrom)
    return HourAngle(half_turn_deg(math.degrees(float(ha))), math.degrees(float(dec)), utc)


def hour_angle_to_icrs(place: HourAngle, site: Site, air: Air) -> Icrs:
    """Inverse of `icrs_to_hour_angle`.

    Raises
    ------
    BadRequest
        The place's instant is naive or outside 1972 to 2099.
    """
    return observed_to_icrs(hour_angle_to_observed(place, site), site, air)


def icrs_to_observed(place: Icrs, utc: datetime, site: Site, air: Air) -> Observed:
    """Observed azimuth and altitude; see `icrs_to_hour_angle`.

    Raises
    ------
    BadRequest
        The instant is naive or outside 1972 to 2099.
    """
    return hour_angle_to_observed(icrs_to_hour_angle(place, utc, site, air), site)


def observed_to_icrs(place: Observed, site: Site, air: Air) -> Icrs:
    """Inverse of `icrs_to_observed`.

    Raises
    ------
    BadRequest
        The place's instant is naive or outside 1972 to 2099.
    """
    astrom = _at(place.utc, site, air)
    az, zenith_distance = math.radians(place.az_deg), math.radians(90.0 - place.alt_deg)
    aimed = zenith_distance
    for _ in range(_REFRACTION_STEPS):
        ra_cio, dec_cio = erfa.atoiq("A", az, aimed, astrom)
        # atoiq undoes refraction to first order only: 0.02″ off at 10°, 8″ at 3°; so it is asked again
        missed = zenith_distance - float(erfa.atioq(ra_cio, dec_cio, astrom)[1])
        aimed += missed
        if abs(missed) < _REFRACTION_DONE_RAD:
            break
    ra, dec = erfa.aticq(ra_cio, dec_cio, astrom)
    return Icrs(turn_deg(math.degrees(float(ra))), math.degrees(float(dec)))


def hour_angle_to_observed(place: HourAngle, site: Site) -> Observed:
    """Turn into azimuth and altitude: a rotation by the latitude and nothing else."""
    az, alt = erfa.hd2ae(
        math.radians(place.ha_deg), math.radians(place.dec_deg), math.radians(site.latitude_deg)
    )
    return Observed(turn_deg(math.degrees(float(az))), math.degrees(float(alt)), place.utc)


def observed_to_hour_angle(place: Observed, site: Site) -> HourAngle:
    """Inverse of `hour_angle_to_observed`."""
    ha, dec = erfa.ae2hd(
        math.radians(place.az_deg), math.radians(place.alt_deg), math.radians(site.latitude_deg)
    )
    return HourAngle(half_turn_deg(math.degrees(float(ha))), math.degrees(float(dec)), place.utc)


def sidereal_time_deg(utc: datetime, site: Site) -> float:
    """Local apparent sidereal time, in [0, 360).

    Raises
    ------
    BadRequest
        The instant is naive or outside 1972 to 2099.
    """
    day, fraction = utc_mjd(utc)
    era = erfa.era00(MJD_ZERO_JD + day, fraction + earth_orientation(utc).dut1_s / SECONDS_PER_DAY)
    _, eo = _geocentric(utc)
    return turn_deg(math.degrees(float(era) - eo) + site.longitude_deg)


def apparent_to_hour_angle(place: Apparent, site: Site) -> GeometricHourAngle:
    """Hour angle as a mount reckons it that knows no refraction: local apparent sidereal time minus RA.

    Polar motion and diurnal aberration (together below 0.7″) are left out, as such mounts do.

    Raises
    ------
    BadRequest
        The place's instant is naive or outside 1972 to 2099.
    """
    ha_deg = half_turn_deg(sidereal_time_deg(place.utc, site) - place.ra_deg)
    return GeometricHourAngle(ha_deg, place.dec_deg, place.utc)


def hour_angle_to_apparent(place: GeometricHourAngle, site: Site) -> Apparent:
    """Inverse of `apparent_to_hour_angle`.

    Raises
    ------
    TypeError
        The place is an observed `HourAngle`: that way leads through `hour_angle_to_icrs`.
    BadRequest
        The place's instant is naive or outside 1972 to 2099.
    """
    if not isinstance(place, GeometricHourAngle):
        raise TypeError(f"{type(place).__name__} is not a GeometricHourAngle: use hour_angle_to_icrs")
    ra_deg = turn_deg(sidereal_time_deg(place.utc, site) - place.ha_deg)
    return Apparent(ra_deg, place.dec_deg, place.utc)
