"""Whatever has a name: bundled bright objects, bodies of the solar system, and what was imported."""

from __future__ import annotations

from datetime import datetime
from typing import Final

from mountnav.ephemeris.bodies import SolarSystemBody
from mountnav.ephemeris.ephemeris import Ephemeris, StarLike
from mountnav.ephemeris.imported import Entry, imports
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Site
from mountnav.sky.jupiter_moons import MOONS
from mountnav.sky.kernel import NAIF_IDS, kernels_in_use
from mountnav.sky.named import NamedObject, name_key, object_of_name
from mountnav.sky.planets import SATELLITES

__all__ = ["Found", "ephemeris_of_name", "found_of_name", "satellites_here"]

Found = NamedObject | SolarSystemBody | Entry


def found_of_name(name: str) -> Found:
    """What a name means: a bundled object first, then a satellite of a planet, then what was imported.

    Raises
    ------
    BadRequest
        Nothing is called so, or several are.
    """
    try:
        return object_of_name(name)
    except BadRequest as unknown:
        found: list[Found] = [
            SolarSystemBody(one)
            for one in satellites_here()
            if name_key(name) in (name_key(one), name_key(_NUMBERED[one]))
        ]
        found += imports().find(name)
        if len(found) == 1:
            return found[0]
        if not found:
            raise BadRequest(
                unknown.what,
                advice=f"{unknown.advice}; or import its elements: mountnav ephemeris import FILE",
            ) from unknown
        told = ", ".join(_told(one) for one in found[:5])
        raise BadRequest(
            f"{len(found)} objects are called {name!r}: {told}", advice="give the number or the whole name"
        ) from unknown


def satellites_here() -> tuple[str, ...]:
    """Names of the planets' satellites that are known without an import, or that a file in use has."""
    here = {segment.target for kernel in kernels_in_use() for segment in kernel.segments}
    return tuple(name for name in SATELLITES if name in MOONS or NAIF_IDS[name] in here)


def _told(found: Found) -> str:
    if isinstance(found, SolarSystemBody) and found.body in _NUMBERED:
        return f"{found.name} (which is also {_NUMBERED[found.body]})"
    return found.name


_NUMERALS: Final = ("I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X", "XI", "XII", "XIII", "XIV")
_PLANETS: Final = {4: "Mars", 5: "Jupiter", 6: "Saturn", 7: "Uranus", 8: "Neptune", 9: "Pluto"}
"""NAIF's hundreds of the planets' systems."""
_NUMBERED: Final = {
    name: f"{_PLANETS[NAIF_IDS[name] // 100]} {_NUMERALS[NAIF_IDS[name] % 100 - 1]}" for name in SATELLITES
}
"""The IAU's numbers of the planets' satellites: Europa is Jupiter II, and the minor planet is another."""


def ephemeris_of_name(name: str, utc: datetime, site: Site) -> Ephemeris:
    """Where what is called so stands when; a star as it is at `utc`. Raises BadRequest."""
    match found_of_name(name):
        case Entry() as entry:
            return entry.ephemeris()
        case SolarSystemBody() as body:
            return body
        case NamedObject(place=None) as wanderer:
            return SolarSystemBody(wanderer.name.lower())
        case NamedObject() as fixed:
            return StarLike(fixed.icrs(utc, site), fixed.name)
