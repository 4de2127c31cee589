"""Targets that move, made for the demo: a comet that passes the Earth closely, and a satellite's pass.

Both are made up for a site and a moment: they stand high in the sky.
They are given to the service as anybody would give them, as elements. Nothing here is known to the service.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from datetime import datetime, timedelta

import erfa
import numpy as np
from numpy.typing import NDArray

from mountnav.ephemeris.elements import GM_SUN_AU3_DAY2, OBLIQUITY_RAD
from mountnav.sky.chain import observed_to_icrs
from mountnav.sky.coordinates import Air, Icrs, Observed, Site
from mountnav.sky.iers import utc_mjd
from mountnav.sky.kernel import barycentric_state_km
from mountnav.sky.observer import earth_barycentric_km, instant, itrs_to_gcrs, site_geocentric_km
from mountnav.units import AU_KM, MJD_ZERO_JD, SECONDS_PER_DAY

__all__ = ["COMET", "SATELLITE", "Orbit", "comet_elements", "orbit_of", "satellite_lines"]

Vector = NDArray[np.float64]

COMET, SATELLITE = "C/2026 Demo", "DEMOSAT"
_COMET_KM = 1.5e6
"""How far the comet of the demo is, km: four times the Moon. Doubled, it moves half as fast."""
_COMET_KM_S = 10.0
"""How fast it crosses the line of sight, km/s: 1.4″/s, an arcminute in 45 s. Doubled, twice as fast."""
_SATELLITE_KM = 1400.0
"""Height of the satellite of the demo, km: 0.2°/s to 0.3°/s where it is highest. Halved, some mounts are too
slow for it."""
_EARTH_KM3_S2 = 398600.8
"""Mass parameter of the Earth that SGP4 counts with (WGS72), km³/s²."""
_SUN = 10
"""NAIF's number of the Sun."""


@dataclass(frozen=True, slots=True)
class Orbit:
    """Elements of an orbit, radians; `anomaly` is the true one."""

    semi_latus: float
    eccentricity: float
    inclination: float
    node: float
    peri: float
    anomaly: float


def orbit_of(place: Vector, velocity: Vector, mu: float) -> Orbit:
    """The orbit that goes through a place with a velocity [Bate, Mueller & White 1971, 2.4].

    Parameters
    ----------
    place, velocity : ndarray, shape (3,)
        Along axes whose third one is the pole that nodes and inclinations are counted from.
    mu : float
        Mass parameter, in their units.
    """
    distance = float(np.linalg.norm(place))
    momentum = np.cross(place, velocity)
    node = np.array([-momentum[1], momentum[0], 0.0])
    shape = np.cross(velocity, momentum) / mu - place / distance
    eccentricity = float(np.linalg.norm(shape))
    inclination = math.acos(momentum[2] / float(np.linalg.norm(momentum)))
    ascending = math.atan2(node[1], node[0])
    # in the plane of the orbit, from the node on
    aside = np.cross(momentum, node)
    along, across = node / np.linalg.norm(node), aside / np.linalg.norm(aside)
    argument = math.atan2(float(place @ across), float(place @ along))
    peri = math.atan2(float(shape @ across), float(shape @ along)) if eccentricity > 1e-9 else 0.0
    return Orbit(
        float(momentum @ momentum) / mu,
        eccentricity,
        inclination,
        ascending % math.tau,
        peri % math.tau,
        (argument - peri) % math.tau,
    )


def comet_elements(
    utc: datetime,
    site: Site,
    air: Air,
    *,
    alt_deg: float = 55.0,
    az_deg: float = 150.0,
    distance_km: float = _COMET_KM,
    speed_km_s: float = _COMET_KM_S,
) -> str:
    """Elements of a comet that stands there now and moves by about 1.4″/s, as JPL's SBDB writes them."""
    where = _direction(observed_to_icrs(Observed(az_deg, alt_deg, utc), site, air))
    earth_km, earth_km_s = earth_barycentric_km(utc)
    here_km, _ = site_geocentric_km(utc, site)
    now = instant(utc)
    sun = barycentric_state_km(_SUN, now.jd1, now.tdb2)
    assert sun is not None, "the shipped ephemeris covers the demo's time"
    sun_km, sun_km_s = sun[0], sun[1] / SECONDS_PER_DAY
    place_km = earth_km + here_km + distance_km * where - sun_km
    # across the line of sight, against the Earth's own way: so the orbit stays one around the Sun
    ahead = earth_km_s - (earth_km_s @ where) * where
    velocity_km_s = earth_km_s - sun_km_s - speed_km_s * ahead / np.linalg.norm(ahead)
    c, s = math.cos(OBLIQUITY_RAD), math.sin(OBLIQUITY_RAD)
    ecliptic = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    orbit = orbit_of(
        ecliptic @ place_km / AU_KM, ecliptic @ velocity_km_s * SECONDS_PER_DAY / AU_KM, GM_SUN_AU3_DAY2
    )
    q_au = orbit.semi_latus / (1.0 + orbit.eccentricity)
    jd = now.jd1 + now.tdb2
    told = {
        "e": orbit.eccentricity,
        "q": q_au,
        "tp": jd - _since_perihelion_days(orbit, q_au),
        "om": math.degrees(orbit.node),
        "w": math.degrees(orbit.peri),
        "i": math.degrees(orbit.inclination),
    }
    return json.dumps(
        {
            "object": {"fullname": COMET, "des": "2026 Demo", "kind": "cu"},
            "orbit": {
                "equinox": "J2000",
                "epoch": f"{jd:.9f}",
                "condition_code": "0",
                "elements": [{"name": name, "value": repr(value)} for name, value in told.items()],
            },
        }
    )


def _since_perihelion_days(orbit: Orbit, q_au: float) -> float:
    """How long ago an ellipse's perihelion was; negative before it."""
    e = orbit.eccentricity
    half = math.remainder(orbit.anomaly, math.tau) / 2.0
    eccentric = 2.0 * math.atan2(math.sqrt(1.0 - e) * math.sin(half), math.sqrt(1.0 + e) * math.cos(half))
    axis_au = q_au / (1.0 - e)
    return (eccentric - e * math.sin(eccentric)) * math.sqrt(axis_au**3 / GM_SUN_AU3_DAY2)


def satellite_lines(
    utc: datetime, site: Site, *, in_s: float = 150.0, alt_deg: float = 60.0, az_deg: float = 140.0
) -> str:
    """Two lines, and a name before them, of a satellite that is highest there after so many seconds."""
    top_utc = utc + timedelta(seconds=in_s)
    up = _up_at(site)
    north = np.array([0.0, 0.0, 1.0]) - up[2] * up
    north /= np.linalg.norm(north)
    east = np.cross(north, up)
    alt, az = math.radians(alt_deg), math.radians(az_deg)
    line = math.cos(alt) * (math.cos(az) * north + math.sin(az) * east) + math.sin(alt) * up
    here = np.linalg.inv(itrs_to_gcrs(top_utc)) @ site_geocentric_km(top_utc, site)[0]
    # from the site along the line of sight up to the orbit
    radius_km = float(np.linalg.norm(here)) + _SATELLITE_KM
    along = float(here @ line)
    range_km = -along + math.sqrt(along**2 + radius_km**2 - float(here @ here))
    fixed = here + range_km * line
    day, fraction = utc_mjd(top_utc)
    turn = erfa.gmst82(MJD_ZERO_JD + day, fraction)
    c, s = math.cos(turn), math.sin(turn)
    to_sky = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    place = to_sky @ fixed
    outward = place / np.linalg.norm(place)
    # square to the line of sight, toward the east: highest where it is nearest
    heading = np.cross(outward, to_sky @ line)
    if heading @ (to_sky @ east) < 0.0:
        heading = -heading
    speed_km_s = math.sqrt(_EARTH_KM3_S2 / radius_km)
    orbit = orbit_of(place, speed_km_s * heading / np.linalg.norm(heading), _EARTH_KM3_S2)
    argument_deg = math.degrees((orbit.anomaly + orbit.peri) % math.tau)
    turns_a_day = SECONDS_PER_DAY / (math.tau * math.sqrt(radius_km**3 / _EARTH_KM3_S2))
    year_day = top_utc.timetuple().tm_yday + fraction
    first = f"1 99999U 26001A   {top_utc:%y}{year_day:012.8f}  .00000000  00000-0  00000-0 0  999"
    second = (
        f"2 99999 {math.degrees(orbit.inclination):8.4f} {math.degrees(orbit.node):8.4f} 0000001 "
        f"{0.0:8.4f} {argument_deg:8.4f} {turns_a_day:11.8f}00001"
    )
    return "\n".join((SATELLITE, *(f"{one}{_checksum(one)}" for one in (first, second))))


def _checksum(line: str) -> int:
    """The last digit of a line of two-line elements: digits, and 1 for each minus."""
    return sum(int(one) if one.isdigit() else one == "-" for one in line) % 10


def _up_at(site: Site) -> Vector:
    latitude, longitude = math.radians(site.latitude_deg), math.radians(site.longitude_deg)
    return np.array(
        [
            math.cos(latitude) * math.cos(longitude),
            math.cos(latitude) * math.sin(longitude),
            math.sin(latitude),
        ]
    )


def _direction(place: Icrs) -> Vector:
    ra, dec = math.radians(place.ra_deg), math.radians(place.dec_deg)
    return np.array([math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)])
