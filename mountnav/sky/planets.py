"""Sun, Moon and planets as a telescope at a site sees them: no network, no ephemeris file.

The Earth and the Sun are ERFA's ``epv00``, the Moon is ``moon98`` (Meeus 1998), the planets are ``plan94``
(Simon et al. 1994). The worst of 1500 instants from 1980 to 2049 against JPL's DE421, as seen from a site:
Sun 0.02″, Moon 18″, Mercury 2″, Venus 11″, Mars 51″ (when it is near), Jupiter 54″, Saturn 89″, Uranus 71″,
Neptune 10″.
"""

from __future__ import annotations

import math
from datetime import datetime
from typing import Any, Final

import erfa
import numpy as np

from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.iers import tt_minus_utc_s, utc_mjd
from mountnav.sky.sphere import turn_deg

_MJD_ZERO_JD = 2400000.5
"""Julian date of the zero of the modified Julian date."""
_AU_M = 149597870700.0
"""The astronomical unit in meters, by definition [IAU 2012]."""
_LIGHT_DAYS_PER_AU = 499.004784 / 86400.0
"""Days that light takes for an astronomical unit, 499.004784 s."""
_WGS84 = 1
"""ERFA's number of the reference ellipsoid."""
_PLAN94: Final = {"mercury": 1, "venus": 2, "mars": 4, "jupiter": 5, "saturn": 6, "uranus": 7, "neptune": 8}
"""ERFA's numbers of the planets in `plan94`."""

BODIES: Final = ("sun", "moon", *_PLAN94)
"""Names that `place_of_body` takes."""


def position_of_body(name: str, utc: datetime, site: Site) -> Icrs:
    """Where a body stands for an observer at a site: topocentric, astrometric, light time taken off.

    That is, where a star would have to stand in the ICRS to be seen in the same direction: the chain to the
    apparent or observed place adds aberration as it does for stars.

    Parameters
    ----------
    name : str
        One of `BODIES`.
    utc : datetime
        Aware.
    site : Site

    Returns
    -------
    Icrs

    Raises
    ------
    BadRequest
        The instant is naive or outside 1972 to 2099.
    KeyError
        Not one of `BODIES`.
    """
    if name not in BODIES:
        raise KeyError(name)
    day, fraction = utc_mjd(utc)
    tt1, tt2 = _MJD_ZERO_JD + day, fraction + tt_minus_utc_s(utc) / 86400.0
    _, earth = erfa.epv00(tt1, tt2)
    observer = np.asarray(earth["p"]) + _observer_au(utc, site, tt1, tt2)
    light_days = 0.0
    seen = observer
    for _ in range(3):  # after two steps nothing changes by a millisecond of light
        seen = _barycentric_au(name, tt1, tt2 - light_days) - observer
        light_days = float(np.linalg.norm(seen)) * _LIGHT_DAYS_PER_AU
    x, y, z = (float(part) for part in seen)
    return Icrs(turn_deg(math.degrees(math.atan2(y, x))), math.degrees(math.atan2(z, math.hypot(x, y))))


def _barycentric_au(name: str, tt1: float, tt2: float) -> Any:
    """Place of a body from the barycenter of the solar system, shape (3,)."""
    heliocentric, barycentric = erfa.epv00(tt1, tt2)
    if name == "moon":
        return np.asarray(barycentric["p"]) + np.asarray(erfa.moon98(tt1, tt2)["p"])
    sun = np.asarray(barycentric["p"]) - np.asarray(heliocentric["p"])
    if name == "sun":
        return sun
    return sun + np.asarray(erfa.plan94(tt1, tt2, _PLAN94[name])["p"])


def _observer_au(utc: datetime, site: Site, tt1: float, tt2: float) -> Any:
    """Place of the site from the Earth's center along the axes of the ICRS; no polar motion."""
    x, _, z = erfa.gd2gc(_WGS84, 0.0, math.radians(site.latitude_deg), site.height_m) / _AU_M
    turn = math.radians(sidereal_time_deg(utc, site))
    of_date = np.array([x * math.cos(turn), x * math.sin(turn), z])
    return erfa.pnm06a(tt1, tt2).T @ of_date


__all__ = ["BODIES", "position_of_body"]
