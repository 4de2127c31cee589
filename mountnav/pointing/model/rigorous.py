"""From axis angles to the sky and back, as rotations: exact for large errors, near the pole, on both sides.

After Wallace's virtual telescope [Wallace 2002, SPIE 4848, 125]: the tube leans by the collimation error
against the latitude axis, that axis against the longitude axis, that one against the Earth, and the tube
sinks. What is empirical (harmonics, off-center circles, ...) acts where it is measured, at the tube: its ξ as
collimation, its η as an angle of the latitude axis.

Vectors are (x: meridian on the equator, y: west, z: pole) for equatorial mounts and (north, east, zenith) for
alt-azimuth ones, so that (cos lat cos lon, cos lat sin lon, sin lat) is a place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mountnav.pointing.model.terms import LOWEST_SIN_ELEVATION, Array, Kind, axis_place, term
from mountnav.units import RAD_PER_ARCSEC

POLE_AVOIDED_RAD = np.radians(0.02)
"""So near the axis' own pole its angle means nothing."""

# Most rounds of the fixed-point iterations. Chosen by hand.
_ROUNDS = 30
# An iteration has converged when nothing changes by more, rad (2e-8″): near the rounding of doubles.
# Smaller, it may never end early.
_DONE_RAD = 1e-13

# coefficient -> (internal angle, sign): the signs make both tables of [POINTING §5] the same rotations
_ANGLES: dict[Kind, dict[str, tuple[str, float]]] = {
    "equatorial": {
        "IH": ("lon_zero", 1.0),
        "ID": ("lat_zero", 1.0),
        "CH": ("lean", 1.0),
        "NP": ("skew", 1.0),
        "ME": ("tilt_x", 1.0),
        "MA": ("tilt_y", 1.0),
        "TF": ("sag_sine", 1.0),
        "TX": ("sag_tangent", 1.0),
    },
    "altaz": {
        "IA": ("lon_zero", -1.0),
        "IE": ("lat_zero", 1.0),
        "CA": ("lean", -1.0),
        "NPAE": ("skew", -1.0),
        "AN": ("tilt_x", -1.0),
        "AW": ("tilt_y", 1.0),
        "TF": ("sag_sine", 1.0),
        "TX": ("sag_tangent", 1.0),
    },
}


@dataclass(frozen=True, slots=True)
class Geometry:
    """A model's coefficients as angles of rotations; made by `geometry`.

    Attributes
    ----------
    lon_zero, lat_zero : float
        Zero points of the axes; all angles in radians.
    lean, skew : float
        Tube against latitude axis, latitude axis against longitude axis.
    tilt_x, tilt_y : float
        Longitude axis against the Earth.
    sag_sine, sag_tangent : float
        Sinking of the tube by sin z and by tan z.
    empirical : tuple of (name, radians)
        Terms that are no rotations.
    """

    kind: Kind
    site_latitude_rad: float
    lon_zero: float = 0.0
    lat_zero: float = 0.0
    lean: float = 0.0
    skew: float = 0.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    sag_sine: float = 0.0
    sag_tangent: float = 0.0
    empirical: tuple[tuple[str, float], ...] = field(default=())


def geometry(kind: Kind, site_latitude_rad: float, coefficients_arcsec: Mapping[str, float]) -> Geometry:
    """Turn coefficients into rotations.

    Raises
    ------
    BadRequest
        An unknown term.
    """
    angles: dict[str, float] = {}
    empirical: list[tuple[str, float]] = []
    for name, value in coefficients_arcsec.items():
        if name in _ANGLES[kind]:
            angle, sign = _ANGLES[kind][name]
            angles[angle] = sign * value * RAD_PER_ARCSEC
        else:
            term(kind, name)
            empirical.append((name, value * RAD_PER_ARCSEC))
    return Geometry(kind, site_latitude_rad, **angles, empirical=tuple(empirical))


def direction(lon_rad: Array, lat_rad: Array) -> Array:
    """Unit vectors of places; shape (n, 3)."""
    cos_lat = np.cos(lat_rad)
    return np.stack([cos_lat * np.cos(lon_rad), cos_lat * np.sin(lon_rad), np.sin(lat_rad)], axis=-1)


def angles(vectors: Array) -> tuple[Array, Array]:
    """Longitude in (-π, π] and latitude in [-π/2, π/2] of vectors, rad."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def _turned(a: Array, b: Array, angle: Array | float) -> tuple[Array, Array]:
    """Components (a, b) turned from a towards b."""
    c, s = np.cos(angle), np.sin(angle)
    return a * c - b * s, a * s + b * c


def _empirical(g: Geometry, lon_rad: Array, lat_rad: Array) -> tuple[Array, Array]:
    """Sum of the terms that are no rotations."""
    xi, eta = np.zeros_like(lon_rad), np.zeros_like(lon_rad)
    if g.empirical:
        place = axis_place(g.kind, lon_rad, lat_rad, g.site_latitude_rad)
        for name, value in g.empirical:
            one_xi, one_eta = term(g.kind, name).function(place)
            xi, eta = xi + value * one_xi, eta + value * one_eta
    return xi, eta


def _zenith(g: Geometry) -> Array:
    if g.kind == "altaz":
        return np.array([0.0, 0.0, 1.0])
    return np.array([np.cos(g.site_latitude_rad), 0.0, np.sin(g.site_latitude_rad)])


def _sunk(g: Geometry, v: Array) -> Array:
    """Directions, sunk away from the zenith."""
    if g.sag_sine == 0.0 and g.sag_tangent == 0.0:
        return v
    zenith = _zenith(g)
    cos_z = v @ zenith
    away = v * cos_z[..., None] - zenith
    sin_z = np.sqrt(np.sum(away * away, axis=-1))
    angle = sin_z * (g.sag_sine + g.sag_tangent / np.maximum(cos_z, LOWEST_SIN_ELEVATION))
    # sin(angle)/sin z without dividing by nothing at the zenith
    share = np.divide(np.sin(angle), sin_z, out=np.zeros_like(angle), where=sin_z > 0.0)
    return np.asarray(v * np.cos(angle)[..., None] + away * share[..., None])


def _raised(g: Geometry, seen: Array) -> Array:
    """Inverse of `_sunk`."""
    if g.sag_sine == 0.0 and g.sag_tangent == 0.0:
        return seen
    v = seen
    for _ in range(_ROUNDS):
        missed = seen - _sunk(g, v)
        v = v + missed
        v = v / np.linalg.norm(v, axis=-1, keepdims=True)
        if np.max(np.abs(missed), initial=0.0) < _DONE_RAD:
            break
    return v


def seen_from(g: Geometry, lon_rad: Array, lat_rad: Array) -> Array:
    """Where the tube looks when the axes read this.

    Parameters
    ----------
    lon_rad, lat_rad : ndarray, shape (n,)
        Axis readings; the latitude is mechanical, beyond ±90° when beyond the pole.

    Returns
    -------
    ndarray, shape (n, 3)
        Unit vectors of the observed (refracted) sky.
    """
    lon, lat = lon_rad + g.lon_zero, lat_rad + g.lat_zero
    xi, eta = _empirical(g, lon, lat)
    lean = g.lean + xi
    x, y, z = np.cos(lean), np.sin(lean), np.zeros_like(lon)
    x, z = _turned(x, z, lat + eta)
    z, y = _turned(z, y, g.skew)
    x, y = _turned(x, y, lon)
    x, z = _turned(x, z, g.tilt_x)
    y, z = _turned(y, z, g.tilt_y)
    return _sunk(g, np.stack([x, y, z], axis=-1))


@dataclass(frozen=True, slots=True)
class Axes:
    """Axis readings that look at places.

    Attributes
    ----------
    lon_rad, lat_rad : ndarray, shape (n,)
        The latitude mechanical; NaN where out of reach.
    reached : ndarray of bool, shape (n,)
        False where no position of the axes looks there: the tube's lean keeps it from the pole.
    near_pole : ndarray of bool, shape (n,)
        So near the mount's own pole that the angle of the longitude axis means nothing.
    """

    lon_rad: Array
    lat_rad: Array
    reached: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    near_pole: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


def axes_for(
    g: Geometry, seen: Array, beyond: Array | np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
) -> Axes:
    """Find the axis readings that make the tube look at places: inverse of `seen_from`.

    Parameters
    ----------
    seen : ndarray, shape (n, 3)
        Unit vectors of the observed sky.
    beyond : ndarray of bool, shape (n,)
        Whether the tube is to look through the pole.
    """
    v = _raised(g, seen)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    y, z = _turned(y, z, -g.tilt_y)
    x, z = _turned(x, z, -g.tilt_x)
    level = np.hypot(x, y)
    sense = np.where(beyond, -1.0, 1.0)
    sin_skew, cos_skew = np.sin(g.skew), np.cos(g.skew)
    lon, lat = np.arctan2(y, x) + np.where(beyond, np.pi, 0.0), np.arctan2(z, sense * level)
    reached = np.ones(lon.shape, dtype=np.bool_)
    for _ in range(_ROUNDS if g.empirical else 1):
        xi, eta = _empirical(g, lon, lat)
        sin_lean, cos_lean = np.sin(g.lean + xi), np.cos(g.lean + xi)
        sin_lat = (z + sin_lean * sin_skew) / (cos_lean * cos_skew)
        side = cos_lean * sin_lat * sin_skew + sin_lean * cos_skew
        square = level * level - side * side
        reached = (square >= 0.0) & (np.abs(sin_lat) <= 1.0 + 1e-12)
        cos_lat = sense * np.sqrt(np.maximum(square, 0.0)) / cos_lean
        new_lon = np.arctan2(y, x) - np.arctan2(side, cos_lean * cos_lat)
        new_lat = np.arctan2(sin_lat, cos_lat) - eta
        change = np.maximum(
            np.abs(_wrapped(new_lon - lon)) * np.abs(cos_lat), np.abs(_wrapped(new_lat - lat))
        )
        lon, lat = new_lon, new_lat
        if np.max(np.where(reached, change, 0.0), initial=0.0) < _DONE_RAD:
            break
    near = np.abs(np.cos(lat)) < np.sin(POLE_AVOIDED_RAD)
    nothing = np.where(reached, 0.0, np.nan)
    return Axes(_wrapped(lon - g.lon_zero) + nothing, _wrapped(lat - g.lat_zero) + nothing, reached, near)


def _wrapped(angle: Array) -> Array:
    """Into (-π, π]."""
    return np.asarray(np.pi - np.mod(np.pi - angle, 2.0 * np.pi))


wrapped = _wrapped


def tangent(lon_rad: Array, lat_rad: Array) -> tuple[Array, Array]:
    """Unit vectors along ξ and η at axis angles; shape (n, 3) each. Defined at the pole too."""
    sin_lon, cos_lon = np.sin(lon_rad), np.cos(lon_rad)
    sin_lat, cos_lat = np.sin(lat_rad), np.cos(lat_rad)
    zero = np.zeros_like(lon_rad)
    return (
        np.stack([-sin_lon, cos_lon, zero], axis=-1),
        np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1),
    )
