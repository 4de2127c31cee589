"""Geometry on the sphere: distances, directions and offsets are taken along great circles, never as bare ΔRA.

Summing plain ΔRA and ΔDec makes a 10″ error at δ = 89.5° read 1146″ [POINTING §3.6]; so nothing here does it.
Two places are compared only if they are of one kind (`TypeError` otherwise) [POINTING §0].
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mountnav.sky.coordinates import Apparent, GeometricHourAngle, HourAngle, Icrs, Observed
from mountnav.units import ARCSEC_PER_RAD

Place = TypeVar("Place", Icrs, Apparent, Observed, HourAngle, GeometricHourAngle)


@dataclass(frozen=True, slots=True)
class Offset:
    """Seen minus believed, as an arc on the sphere; its components are true angles on the sky.

    Attributes
    ----------
    east_arcsec, north_arcsec : float
        Length of the arc times sine and cosine of its position angle at the believed place.
    """

    east_arcsec: float
    north_arcsec: float

    @property
    def total_arcsec(self) -> float:
        """Length of the arc."""
        return math.hypot(self.east_arcsec, self.north_arcsec)


def _east_north_rad(
    place: Icrs | Apparent | Observed | HourAngle | GeometricHourAngle,
) -> tuple[float, float]:
    """Longitude that grows eastward and latitude of any kind of position, in radians."""
    match place:
        case Icrs() | Apparent():
            return math.radians(place.ra_deg), math.radians(place.dec_deg)
        case Observed():
            return math.radians(place.az_deg), math.radians(place.alt_deg)
        case HourAngle() | GeometricHourAngle():
            return -math.radians(place.ha_deg), math.radians(place.dec_deg)
    raise TypeError(f"{type(place).__name__} is no place on the sky")


def _arc(a: Place, b: Place) -> tuple[float, float]:
    """Length and position angle (at `a`, north through east) of the arc from `a` to `b`, in radians."""
    if type(a) is not type(b):
        raise TypeError(
            f"{type(a).__name__} and {type(b).__name__} are different kinds of places: convert one first"
        )
    lon_a, lat_a = _east_north_rad(a)
    lon_b, lat_b = _east_north_rad(b)
    lon = lon_b - lon_a
    east = math.cos(lat_b) * math.sin(lon)
    # sin δb cos δa - cos δb sin δa cos Δα, without the cancellation between neighbors
    north = math.sin(lat_b - lat_a) + 2.0 * math.cos(lat_b) * math.sin(lat_a) * math.sin(lon / 2.0) ** 2
    along = math.sin(lat_a) * math.sin(lat_b) + math.cos(lat_a) * math.cos(lat_b) * math.cos(lon)
    return math.atan2(math.hypot(east, north), along), math.atan2(east, north)


def separation_arcsec(a: Place, b: Place) -> float:
    """Great-circle distance between two positions of one kind.

    Raises
    ------
    TypeError
        The places are of different kinds.
    """
    return _arc(a, b)[0] * ARCSEC_PER_RAD


def position_angle_deg(a: Place, b: Place) -> float:
    """Direction from `a` to `b`, at `a`, from north through east, in [0, 360).

    For `Observed` places north is up and east is growing azimuth.

    Raises
    ------
    TypeError
        The places are of different kinds.
    """
    angle_deg = math.degrees(_arc(a, b)[1]) % 360.0
    return 0.0 if angle_deg >= 360.0 else angle_deg  # a tiny negative angle rounds up to 360


def offset_arcsec(seen: Place, believed: Place) -> Offset:
    """How far, and in which direction, the telescope is from where it believes to be.

    Parameters
    ----------
    seen : place
        Where the frame shows it points.
    believed : place of the same kind
        Where the mount says it points.

    Returns
    -------
    Offset
        East and north positive; ``displaced(believed, offset.east_arcsec, offset.north_arcsec)`` is `seen`.

    Raises
    ------
    TypeError
        The places are of different kinds.
    """
    length, angle = _arc(believed, seen)
    return Offset(length * math.sin(angle) * ARCSEC_PER_RAD, length * math.cos(angle) * ARCSEC_PER_RAD)


def displaced(place: Place, east_arcsec: float, north_arcsec: float) -> Place:
    """Find the position that is reached along the great circle that leaves `place` by this offset.

    Returns
    -------
    place of the same kind
        Right ascension and azimuth in [0, 360), hour angle in (-180, 180]; the instant is kept.
    """
    lon, lat = _east_north_rad(place)
    length = math.hypot(east_arcsec, north_arcsec) / ARCSEC_PER_RAD
    angle = math.atan2(east_arcsec, north_arcsec)
    # components along the meridian plane, east, and the pole: exact at the poles, where cos δ is none
    outward = math.cos(lat) * math.cos(length) - math.sin(lat) * math.sin(length) * math.cos(angle)
    eastward = math.sin(length) * math.sin(angle)
    poleward = math.sin(lat) * math.cos(length) + math.cos(lat) * math.sin(length) * math.cos(angle)
    lon_deg = math.degrees(lon + math.atan2(eastward, outward))
    lat_deg = math.degrees(math.atan2(poleward, math.hypot(outward, eastward)))
    match place:
        case Icrs() | Apparent():
            return replace(place, ra_deg=turn_deg(lon_deg), dec_deg=lat_deg)
        case Observed():
            return replace(place, az_deg=turn_deg(lon_deg), alt_deg=lat_deg)
        case HourAngle() | GeometricHourAngle():
            return replace(place, ha_deg=half_turn_deg(-lon_deg), dec_deg=lat_deg)


def turn_deg(angle_deg: float) -> float:
    """Bring an angle into [0, 360)."""
    turned_deg = angle_deg % 360.0
    return 0.0 if turned_deg >= 360.0 else turned_deg  # -1e-20 % 360 is 360


def half_turn_deg(angle_deg: float) -> float:
    """Bring an angle into (-180, 180]."""
    return 180.0 - turn_deg(180.0 - angle_deg)


def gnomonic(
    ra_deg: ArrayLike, dec_deg: ArrayLike, ra0_deg: float, dec0_deg: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Project positions on the plane that touches the sphere at (ra0, dec0) [POINTING §10].

    Parameters
    ----------
    ra_deg, dec_deg : array_like, shape (n,)
        Places, of the same kind as the tangent point.
    ra0_deg, dec0_deg : float
        Tangent point.

    Returns
    -------
    xi_rad, eta_rad : ndarray, shape (n,)
        Standard coordinates, east and north positive; NaN where the place lies 90° away or more.
    """
    lon = np.radians(np.asarray(ra_deg, dtype=np.float64) - ra0_deg)
    lat = np.radians(np.asarray(dec_deg, dtype=np.float64))
    sin0, cos0 = math.sin(math.radians(dec0_deg)), math.cos(math.radians(dec0_deg))
    sin_lat, cos_lat, cos_lon = np.sin(lat), np.cos(lat), np.cos(lon)
    depth = sin0 * sin_lat + cos0 * cos_lat * cos_lon
    depth = np.where(depth > 1e-12, depth, np.nan)
    return cos_lat * np.sin(lon) / depth, (cos0 * sin_lat - sin0 * cos_lat * cos_lon) / depth


def gnomonic_inverse(
    xi: ArrayLike, eta: ArrayLike, ra0_deg: float, dec0_deg: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find the positions whose standard coordinates are (xi, eta); inverse of `gnomonic`.

    Parameters
    ----------
    xi, eta : array_like, shape (n,)
        Standard coordinates in radians, east and north positive.
    ra0_deg, dec0_deg : float
        Tangent point.

    Returns
    -------
    ra_deg, dec_deg : ndarray, shape (n,)
        Right ascension in [0, 360).
    """
    east = np.asarray(xi, dtype=np.float64)
    north = np.asarray(eta, dtype=np.float64)
    sin0, cos0 = math.sin(math.radians(dec0_deg)), math.cos(math.radians(dec0_deg))
    outward = cos0 - north * sin0
    ra_deg = (ra0_deg + np.degrees(np.arctan2(east, outward))) % 360.0
    dec_deg = np.degrees(np.arctan2(north * cos0 + sin0, np.hypot(east, outward)))
    return np.where(ra_deg >= 360.0, 0.0, ra_deg), dec_deg
