"""Whatever has a name: bundled bright objects, bodies of the solar system, and what was imported."""

from __future__ import annotations

from datetime import datetime

from mountnav.ephemeris.bodies import SolarSystemBody
from mountnav.ephemeris.ephemeris import Ephemeris, StarLike
from mountnav.ephemeris.imported import Entry, imports
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Site
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
            SolarSystemBody(one) for one in satellites_here() if name_key(one) == name_key(name)
        ]
        found += imports().find(name)
        if len(found) == 1:
            return found[0]
        if not found:
            raise BadRequest(
                unknown.what,
                advice=f"{unknown.advice}; or import its elements: mountnav ephemeris import FILE",
            ) from unknown
        told = ", ".join(one.name for one in found[:5])
        raise BadRequest(
            f"{len(found)} objects are called {name!r}: {told}", advice="give the number or the whole name"
        ) from unknown


def satellites_here() -> tuple[str, ...]:
    """Names of the planets' satellites that a file in use has."""
    here = {segment.target for kernel in kernels_in_use() for segment in kernel.segments}
    return tuple(name for name in SATELLITES if NAIF_IDS[name] in here)


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
