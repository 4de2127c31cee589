"""The terms of pointing models: each a pair of functions (ξ, η) of the axis angles [POINTING §5], [TPOINT].

The convention is that of PMFIT and TPOINT: *observed = axis reading + Σ c f*. ξ is along growing longitude
times the cosine of latitude, η along growing latitude, both as arcs on the sky. Longitude is the hour angle
(west positive) or the azimuth (north through east), latitude the declination or the elevation, both of the
axes: beyond ±90° where the tube looks through the pole. Seen from there, ξ and η both point the other way
round, and with that the signs of CH, NP and ID turn over on the other side of the pier by themselves.

The terms are linear in their coefficients, so the table is the Jacobian too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest

Array = NDArray[np.float64]
Kind = Literal["equatorial", "altaz"]

LOWEST_SIN_ELEVATION = 0.05
"""Below 2.9° of elevation tan z is held: nothing is known there that a model could use."""


@dataclass(frozen=True, slots=True)
class AxisPlace:
    """Sines and cosines that terms are made of; see `axis_place`.

    Attributes
    ----------
    lon_rad, lat_rad : ndarray, shape (n,)
        Angles of the axes.
    sin_lon, cos_lon, sin_lat, cos_lat : ndarray, shape (n,)
        Of the two axes' angles.
    sin_site, cos_site : float
        Of the site's latitude.
    sin_elevation : ndarray, shape (n,)
        Of the altitude.
    """

    lon_rad: Array
    lat_rad: Array
    sin_lon: Array
    cos_lon: Array
    sin_lat: Array
    cos_lat: Array
    sin_site: float
    cos_site: float
    sin_elevation: Array


def axis_place(kind: Kind, lon_rad: Array, lat_rad: Array, site_latitude_rad: float) -> AxisPlace:
    """Make the sines and cosines of axis angles once for all terms."""
    sin_lon, cos_lon = np.sin(lon_rad), np.cos(lon_rad)
    sin_lat, cos_lat = np.sin(lat_rad), np.cos(lat_rad)
    sin_site, cos_site = float(np.sin(site_latitude_rad)), float(np.cos(site_latitude_rad))
    up = sin_lat if kind == "altaz" else sin_site * sin_lat + cos_site * cos_lat * cos_lon
    return AxisPlace(lon_rad, lat_rad, sin_lon, cos_lon, sin_lat, cos_lat, sin_site, cos_site, up)


Function = Callable[[AxisPlace], tuple[Array, Array]]


@dataclass(frozen=True, slots=True)
class Term:
    """A term by its TPOINT name.

    Attributes
    ----------
    function : callable
        Of an `AxisPlace`; gives ξ and η for a coefficient of 1.
    """

    name: str
    meaning: str
    function: Function


def _zero(p: AxisPlace) -> Array:
    return np.zeros_like(p.lon_rad)


def _one(p: AxisPlace) -> Array:
    return np.ones_like(p.lon_rad)


def _held(p: AxisPlace) -> Array:
    """Sine of the elevation, held near the horizon."""
    return np.maximum(p.sin_elevation, LOWEST_SIN_ELEVATION)


def _sag(p: AxisPlace) -> tuple[Array, Array]:
    """Away from the zenith by sin z, in equatorial axes."""
    return p.cos_site * p.sin_lon, p.cos_site * p.cos_lon * p.sin_lat - p.sin_site * p.cos_lat


def _sag_by_tangent(p: AxisPlace) -> tuple[Array, Array]:
    xi, eta = _sag(p)
    return xi / _held(p), eta / _held(p)


EQUATORIAL = {
    term.name: term
    for term in (
        Term("IH", "zero point of the hour angle axis", lambda p: (p.cos_lat, _zero(p))),
        Term("ID", "zero point of the declination axis", lambda p: (_zero(p), _one(p))),
        Term("CH", "tube not square to the declination axis", lambda p: (_one(p), _zero(p))),
        Term("NP", "axes not square to each other", lambda p: (p.sin_lat, _zero(p))),
        Term("ME", "polar axis wrong in elevation", lambda p: (p.sin_lon * p.sin_lat, p.cos_lon)),
        Term("MA", "polar axis wrong in azimuth", lambda p: (-p.cos_lon * p.sin_lat, p.sin_lon)),
        Term("TF", "tube sags with sin z", _sag),
        Term("TX", "tube sags with tan z", _sag_by_tangent),
        Term("FO", "fork sags", lambda p: (_zero(p), p.cos_lon)),
        Term("DAF", "declination axis sags", lambda p: (-p.sin_elevation, _zero(p))),
        Term("HCES", "hour angle circle off center, sine", lambda p: (p.sin_lon * p.cos_lat, _zero(p))),
        Term("HCEC", "hour angle circle off center, cosine", lambda p: (p.cos_lon * p.cos_lat, _zero(p))),
        Term("DCES", "declination circle off center, sine", lambda p: (_zero(p), p.sin_lat)),
        Term("DCEC", "declination circle off center, cosine", lambda p: (_zero(p), p.cos_lat)),
    )
}
"""Terms of equatorial mounts, harmonics apart. An entry here is all that a new term needs."""

ALTAZ = {
    term.name: term
    for term in (
        Term("IA", "zero point of the azimuth axis", lambda p: (-p.cos_lat, _zero(p))),
        Term("IE", "zero point of the elevation axis", lambda p: (_zero(p), _one(p))),
        Term("CA", "tube not square to the elevation axis", lambda p: (-_one(p), _zero(p))),
        Term("NPAE", "axes not square to each other", lambda p: (-p.sin_lat, _zero(p))),
        Term("AN", "azimuth axis tilted north", lambda p: (-p.sin_lon * p.sin_lat, -p.cos_lon)),
        Term("AW", "azimuth axis tilted west", lambda p: (-p.cos_lon * p.sin_lat, p.sin_lon)),
        Term("TF", "tube sags with cos E", lambda p: (_zero(p), -p.cos_lat)),
        Term("TX", "tube sags with cot E", lambda p: (_zero(p), -p.cos_lat / _held(p))),
        Term("ACES", "azimuth circle off center, sine", lambda p: (-p.sin_lon * p.cos_lat, _zero(p))),
        Term("ACEC", "azimuth circle off center, cosine", lambda p: (p.cos_lon * p.cos_lat, _zero(p))),
    )
}
"""Terms of alt-azimuth mounts, harmonics apart."""

ZERO_POINTS: dict[Kind, tuple[str, str]] = {"equatorial": ("IH", "ID"), "altaz": ("IA", "IE")}
"""What each sync sets again."""

CORE: dict[Kind, tuple[str, ...]] = {
    "equatorial": ("ME", "MA", "CH", "TF"),
    "altaz": ("AN", "AW", "CA", "TF"),
}
"""With the zero points the six terms that suit nearly every telescope [PMFIT]."""

NON_PERPENDICULARITY: dict[Kind, str] = {"equatorial": "NP", "altaz": "NPAE"}
"""Correlated with zero point and collimation up to 0.99 [POINTING §6]: tried after all others."""

_RESULTS: dict[Kind, dict[str, Callable[[AxisPlace, Array], tuple[Array, Array]]]] = {
    "equatorial": {
        "H": lambda p, f: (f * p.cos_lat, _zero(p)),
        "X": lambda p, f: (f, _zero(p)),
        "D": lambda p, f: (_zero(p), f),
    },
    "altaz": {
        "A": lambda p, f: (f * p.cos_lat, _zero(p)),
        "V": lambda p, f: (f, _zero(p)),
        "Z": lambda p, f: (_zero(p), f),
    },
}
_HARMONIC = re.compile(r"H([HXDAVZ])((?:[SC][HDAE]\d?){1,2})")
_FACTOR = re.compile(r"([SC])([HDAE])(\d?)")
_COORDINATES: dict[Kind, str] = {"equatorial": "HD", "altaz": "AE"}


def _harmonic(kind: Kind, name: str) -> Term | None:
    """Read a name such as HHSH2 (hour angle, sine of 2 h), HDCD3 or HXSH2CD1; None if it is none."""
    read = _HARMONIC.fullmatch(name)
    if read is None or read[1] not in _RESULTS[kind]:
        return None
    factors = [(s, c, int(n or 1)) for s, c, n in _FACTOR.findall(read[2])]
    if any(c not in _COORDINATES[kind] or n < 1 for _, c, n in factors):
        return None
    result = _RESULTS[kind][read[1]]

    def function(p: AxisPlace) -> tuple[Array, Array]:
        value = np.ones_like(p.lon_rad)
        for wave, coordinate, n in factors:
            angle = n * (p.lon_rad if coordinate in "HA" else p.lat_rad)
            value = value * (np.sin(angle) if wave == "S" else np.cos(angle))
        return result(p, value)

    said = " ".join(f"{'sin' if s == 'S' else 'cos'} {n if n > 1 else ''}{c}" for s, c, n in factors)
    where = {"H": "hour angle", "X": "east-west", "D": "declination", "A": "azimuth", "V": "left-right"}
    return Term(name, f"harmonic: {where.get(read[1], 'elevation')}, {said}", function)


def term(kind: Kind, name: str) -> Term:
    """Find a term by its TPOINT name.

    Raises
    ------
    BadRequest
        Mounts of this kind have no such term.
    """
    found = (EQUATORIAL if kind == "equatorial" else ALTAZ).get(name) or _harmonic(kind, name)
    if found is None:
        known = ", ".join(EQUATORIAL if kind == "equatorial" else ALTAZ)
        waves = (
            "HHSH2, HHCH2, HDSH2, HDSD2, HXSH2CD" if kind == "equatorial" else "HASA2, HVCA2, HZSA3, HZSE2"
        )
        raise BadRequest(
            f"{name!r} is not a term of an {kind} pointing model",
            advice=f"known: {known}, and harmonics such as {waves}",
        )
    return found


def basis(
    kind: Kind, names: Sequence[str], lon_rad: Array, lat_rad: Array, site_latitude_rad: float
) -> Array:
    """Evaluate terms at axis angles.

    Parameters
    ----------
    names : sequence of str, length k
        Names of terms: `IH`, `NP`, ...
    lon_rad, lat_rad : ndarray, shape (n,)
        Angles of the axes, the latitude beyond ±90° when beyond the pole.

    Returns
    -------
    ndarray, shape (n, 2, k)
        ξ and η for a coefficient of 1, in the tangent plane of the axes.

    Raises
    ------
    BadRequest
        An unknown name.
    """
    place = axis_place(kind, lon_rad, lat_rad, site_latitude_rad)
    columns = np.empty((len(lon_rad), 2, len(names)))
    for k, name in enumerate(names):
        columns[:, 0, k], columns[:, 1, k] = term(kind, name).function(place)
    return columns


HIGHEST_HARMONIC = 3
"""Of an automatic selection. On both sets of PMFIT the fourth and higher lower the leave-one-out RMS, but not
that of points which had no part in the selection."""


def candidates(kind: Kind, highest: int = HIGHEST_HARMONIC) -> tuple[str, ...]:
    """Terms that an automatic selection chooses among, besides zero points, core and non-perpendicularity.

    Parameters
    ----------
    highest : int
        Highest harmonic.
    """
    waves = range(1, highest + 1)
    table = EQUATORIAL if kind == "equatorial" else ALTAZ
    tried_anyway = (*ZERO_POINTS[kind], *CORE[kind], NON_PERPENDICULARITY[kind])
    named = [name for name in table if name not in tried_anyway]
    if kind == "equatorial":
        # HHSH1, HHCH1 and HDCH1 are HCES, HCEC and FO
        named += ["HDSH1"]
        named += [f"H{r}{f}H{n}" for n in waves[1:] for r in "HD" for f in "SC"]
    else:
        # HASA1 and HACA1 are ACES and ACEC
        named += ["HVSA1", "HVCA1", "HZSA1", "HZCA1", "HZSE1"]
        named += [f"H{r}{f}A{n}" for n in waves[1:] for r in "AVZ" for f in "SC"]
        named += [f"H{r}{f}E{n}" for n in waves[1:] for r in "VZ" for f in "SC"]
    return tuple(named)
