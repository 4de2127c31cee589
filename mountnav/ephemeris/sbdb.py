"""Orbital elements as JPL's Small-Body Database answers (``sbdb.api``), with their covariance if any."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from mountnav.ephemeris.elements import Covariance, OrbitElements, OwnForces
from mountnav.errors import BadRequest

_LABELS: Final = ("e", "q", "tp", "node", "peri", "i")
"""Rows of SBDB's covariance; forces of a comet may follow, and are left out."""
_MOST_LABELS: Final = 24
"""Rows of a covariance at most; six elements and some forces are usual."""
_MOST_NAME: Final = 80
"""Letters of a name that are kept."""


def looks_like_sbdb(record: object) -> bool:
    """Whether parsed JSON is an answer of SBDB."""
    return isinstance(record, Mapping) and "orbit" in record and "object" in record


def require_orbit(found: dict[str, Any]) -> None:
    """Refuse what JPL answers when it has nothing, or several objects, in its own words.

    Raises
    ------
    BadRequest
        It is such an answer.
    """
    signature = found.get("signature")
    source = signature.get("source") if isinstance(signature, dict) else None
    said = found.get("error") or found.get("message")
    if not isinstance(source, str) or not isinstance(said, str) or looks_like_sbdb(found):
        return
    several = found.get("list")
    listed = several if isinstance(several, list) else []
    names = [str(one.get("name")) for one in listed if isinstance(one, dict)]
    which = f" ({', '.join(names[:5])[:120]})" if names else ""
    raise BadRequest(
        f"it is no orbit: {source[:60]} says {said.strip()[:160]!r}{which}",
        advice="ask for one object, by its designation",
    )


def read_sbdb(record: Mapping[str, Any]) -> OrbitElements:
    """An answer of SBDB.

    Parameters
    ----------
    record : dict
        Parsed JSON.

    Raises
    ------
    BadRequest
        A field that is missing or none; or it isn't around the Sun.
    """
    orbit, what = record.get("orbit"), record.get("object")
    if not isinstance(orbit, Mapping) or not isinstance(what, Mapping):
        raise BadRequest("an answer of SBDB has an object and an orbit")
    name = _words(what.get("fullname")) or _words(what.get("des")) or "a small body"
    equinox = orbit.get("equinox", "J2000")
    if equinox != "J2000":
        raise BadRequest(f"{name}: the elements are of equinox {equinox!r}, not J2000")
    covariance = orbit.get("covariance")
    told = _values(orbit.get("elements"), name)
    number = _words(what.get("des"))
    short = _words(what.get("shortname"))
    kind = _words(what.get("kind"))
    code = orbit.get("condition_code")
    return OrbitElements(
        name=name,
        aliases=tuple(dict.fromkeys(one for one in (number, short) if one and one != name)),
        epoch_jd=_float(orbit.get("epoch"), "epoch", name),
        q_au=_of(told, "q", name),
        eccentricity=_of(told, "e", name),
        inclination_deg=_of(told, "i", name),
        node_deg=_of(told, "om", name),
        peri_deg=_of(told, "w", name),
        perihelion_jd=_of(told, "tp", name),
        uncertainty=int(str(code)) if str(code) in set("0123456789") else None,
        comet=kind.startswith("c"),
        covariance=_matrix(covariance, told, name) if isinstance(covariance, Mapping) else None,
        forces=_forces(orbit.get("model_pars"), name),
    )


def _words(value: object) -> str:
    return value.strip()[:_MOST_NAME] if isinstance(value, str) else ""


def _float(value: object, what: str, name: str) -> float:
    try:
        found = (
            float(value) if isinstance(value, str | int | float) and not isinstance(value, bool) else math.nan
        )
    except (ValueError, OverflowError):
        found = math.nan
    if not math.isfinite(found):
        raise BadRequest(f"{name}: {what} is {str(value)[:30]!r}, no number")
    return found


def _values(elements: object, name: str) -> dict[str, float]:
    if not isinstance(elements, list) or len(elements) > 40:
        raise BadRequest(f"{name}: the orbit has no list of elements")
    return {
        str(one.get("name")): _float(one.get("value"), str(one.get("name"))[:20], name)
        for one in elements
        if isinstance(one, Mapping) and one.get("value") is not None
    }


def _of(told: Mapping[str, float], key: str, name: str) -> float:
    if key not in told:
        raise BadRequest(f"{name}: the elements have no {key}", advice="ask SBDB for its default elements")
    return told[key]


def _matrix(covariance: Mapping[str, Any], told: Mapping[str, float], name: str) -> Covariance | None:
    labels, data = covariance.get("labels"), covariance.get("data")
    if not isinstance(labels, list) or not isinstance(data, list) or not 6 <= len(labels) <= _MOST_LABELS:
        return None
    if tuple(labels[:6]) != _LABELS or len(data) != len(labels):
        raise BadRequest(f"{name}: a covariance of {labels[:6]} is not supported; of {list(_LABELS)} is")
    rows = []
    for row in data[:6]:
        if not isinstance(row, list) or len(row) != len(labels):
            raise BadRequest(f"{name}: the covariance is not a square of numbers")
        rows.append(tuple(_float(value, "covariance", name) for value in row[:6]))
    # of another epoch than the main ones they stand beside it, else they are the main ones
    own = covariance.get("elements")
    values = _values(own, name) if isinstance(own, list) else told
    names = ("e", "q", "tp", "om", "w", "i")
    return Covariance(tuple(rows), tuple(_of(values, one, name) for one in names))


def _forces(pars: object, name: str) -> OwnForces | None:
    """Forces beside gravity, by the law that is told beside them."""
    if not isinstance(pars, list) or not pars:
        return None
    told = {
        str(one.get("name")): _float(one.get("value"), str(one.get("name"))[:20], name)
        for one in pars[:40]
        if isinstance(one, Mapping) and one.get("value") is not None and one.get("name") in _FORCES
    }
    if not {"A1", "A2", "A3"}.intersection(told):
        return None
    return OwnForces(
        told.get("A1", 0.0),
        told.get("A2", 0.0),
        told.get("A3", 0.0),
        scale=told.get("ALN", 0.1112620426),
        r0_au=told.get("R0", 2.808),
        m=told.get("NM", 2.15),
        n=told.get("NN", 5.093),
        k=told.get("NK", 4.6142),
        lag_days=told.get("DT", 0.0),
    )


_FORCES: Final = ("A1", "A2", "A3", "ALN", "R0", "NM", "NN", "NK", "DT")
"""SBDB's names of the forces beside gravity, and of their law."""
