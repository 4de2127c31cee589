"""Sun, Moon, planets and their satellites as a telescope at a site sees them: no network.

They are JPL's DE440 from 2015 to 2054, from the excerpt that is shipped (`mountnav.sky.kernel`), and of any
other span or body from SPK files that an operator imported. Outside of all files ERFA's formulas stand in:
the Earth and the Sun ``epv00``, the Moon ``moon98`` (Meeus 1998), the planets ``plan94`` (Simon et al. 1994).
The worst of 1500 instants from 1980 to 2049 against JPL's DE421, as seen from a site: Sun 0.02″, Moon 18″,
Mercury 2″, Venus 11″, Mars 51″ (when it is near), Jupiter 54″, Saturn 89″, Uranus 71″, Neptune 10″.
`sigma_of_body_arcsec` says which it is.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, Final

import erfa
import numpy as np

from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.jupiter_moons import MOONS, SIGMA_ARCSEC, from_barycenter_km
from mountnav.sky.kernel import NAIF_IDS, barycentric_state_km, has_body, source_of
from mountnav.sky.observer import direction, instant, seen_from
from mountnav.units import AU_KM

_PLAN94: Final = {"mercury": 1, "venus": 2, "mars": 4, "jupiter": 5, "saturn": 6, "uranus": 7, "neptune": 8}
"""ERFA's numbers of the planets in `plan94`."""
_FORMULA_SIGMA_ARCSEC: Final = {
    "sun": 0.02,
    "moon": 9.0,
    "mercury": 1.0,
    "venus": 5.0,
    "mars": 20.0,
    "jupiter": 27.0,
    "saturn": 45.0,
    "uranus": 35.0,
    "neptune": 5.0,
}
"""Of ERFA's formulas: half of the worst of 1500 instants against DE421. Doubled, searches are twice as
wide."""
_KERNEL_SIGMA_ARCSEC: Final = 0.02
"""Of a body that a file has itself: DE440's own errors are milliarcseconds, and the chain's 0.01″ count
more."""
_SYSTEM_SIGMA_ARCSEC: Final = {"jupiter": 0.06, "saturn": 0.06, "pluto": 0.1}
"""How far, seen from the Earth, a planet goes around the barycenter of its system at most, where a file has
that alone: Jupiter 220 km, Saturn 310 km, Pluto 2130 km; Uranus' and Neptune's (40 and 75 km) are
milliarcseconds."""

BODIES: Final = ("sun", "moon", *_PLAN94, "pluto")
"""Names that `position_of_body` takes without an import."""
SATELLITES: Final = tuple(name for name in NAIF_IDS if name not in BODIES and name != "earth")
"""Names of planets' satellites; but for `MOONS` a file has to be there that has them."""


def position_of_body(name: str, utc: datetime, site: Site) -> Icrs:
    """Where a body stands for an observer at a site: topocentric, astrometric, light time taken off.

    That is, where a star would have to stand in the ICRS to be seen in the same direction: the chain to the
    apparent or observed place adds aberration as it does for stars.

    Parameters
    ----------
    name : str
        One of `BODIES` or `SATELLITES`.
    utc : datetime
        Aware.

    Raises
    ------
    BadRequest
        The instant is naive or outside 1972 to 2099; or no file has that body then, and there is no formula.
    KeyError
        Neither one of `BODIES` nor of `SATELLITES`.
    """
    return direction(vector_to_body_km(name, utc, site))


def vector_to_body_km(name: str, utc: datetime, site: Site) -> Any:
    """From the observer to the body, astrometric, shape (3,), km. As `position_of_body`."""
    number = NAIF_IDS[name]
    now = instant(utc)
    if has_body(number, now.jd1 + now.tdb2) and has_body(number, now.jd1 + now.tdb2 - _MOST_LIGHT_DAYS):
        return seen_from(lambda jd1, jd2: _of_kernel(number, jd1, jd2), utc, site)[0]
    if name in MOONS and _has_jupiter(now.jd1 + now.tdb2):
        return seen_from(lambda jd1, jd2: _of_moon(name, jd1, jd2), utc, site)[0]
    if name not in _FORMULA_SIGMA_ARCSEC:
        raise BadRequest(
            f"no ephemeris on this machine has {name.capitalize()} at {utc:%Y-%m-%d}",
            advice="import one that has: mountnav ephemeris import FILE.bsp",
        )
    _, earth = erfa.epv00(now.jd1, now.tdb2)
    earth_km = np.asarray(earth["p"]) * AU_KM
    return seen_from(lambda jd1, jd2: _of_formula(name, jd1, jd2), utc, site, earth_km)[0]


def sigma_of_body_arcsec(name: str, utc: datetime) -> float:
    """One-sigma uncertainty of `position_of_body`, ″; raises as it does."""
    number = NAIF_IDS[name]
    now = instant(utc)
    if has_body(number, now.jd1 + now.tdb2):
        alone = source_of(number, now.jd1 + now.tdb2, whole_system=False) is None
        return _SYSTEM_SIGMA_ARCSEC.get(name, _KERNEL_SIGMA_ARCSEC) if alone else _KERNEL_SIGMA_ARCSEC
    if name in MOONS and _has_jupiter(now.jd1 + now.tdb2):
        return SIGMA_ARCSEC[name]
    if name not in _FORMULA_SIGMA_ARCSEC:
        raise BadRequest(f"no ephemeris on this machine has {name.capitalize()} at {utc:%Y-%m-%d}")
    return _FORMULA_SIGMA_ARCSEC[name]


_MOST_LIGHT_DAYS = 0.35
"""Light from Pluto takes 7 hours: so long before an instant a file has to begin. Doubled, nothing but the
first night of a file is given to the formulas."""


_JUPITER_SYSTEM: Final = 5
"""NAIF's number of the barycenter of Jupiter's system."""


def _has_jupiter(jd: float) -> bool:
    return has_body(_JUPITER_SYSTEM, jd) and has_body(_JUPITER_SYSTEM, jd - _MOST_LIGHT_DAYS)


def _of_moon(name: str, jd1: float, jd2: float) -> Any:
    """Place of a moon of Jupiter from the barycenter of the solar system, shape (3,), km."""
    return _of_kernel(_JUPITER_SYSTEM, jd1, jd2) + from_barycenter_km(name, jd1 + jd2)


def _of_kernel(number: int, jd1: float, jd2: float) -> Any:
    state = barycentric_state_km(number, jd1, jd2)
    if state is None:  # asked before: a file was taken away meanwhile
        raise BadRequest("the ephemeris has just been taken away", advice="ask again")
    return state[0]


def _of_formula(name: str, jd1: float, jd2: float) -> Any:
    """Place of a body from the barycenter of the solar system, shape (3,), km."""
    heliocentric, barycentric = erfa.epv00(jd1, jd2)
    if name == "moon":
        return (np.asarray(barycentric["p"]) + np.asarray(erfa.moon98(jd1, jd2)["p"])) * AU_KM
    sun = np.asarray(barycentric["p"]) - np.asarray(heliocentric["p"])
    if name == "sun":
        return sun * AU_KM
    return (sun + np.asarray(erfa.plan94(jd1, jd2, _PLAN94[name])["p"])) * AU_KM


__all__ = ["BODIES", "SATELLITES", "position_of_body", "sigma_of_body_arcsec", "vector_to_body_km"]
