"""What the doctor starts from: observations in the frame of the axes, and what a pointing model says.

The frame has its pole where the first axis points (celestial pole; zenith for an alt-az mount), x towards the
meridian (in the south for alt-az), y west. Longitude in it is hour angle (azimuth from south through west).
Positions are geometric: refraction is a column of the fit, as most mounts don't model it [POINTING §3.5].

A pointing model, if there is one, says beforehand what the mount's geometry is and how well it repeats.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mountnav.devices import PierSide
from mountnav.pointing.doctor.priors import Geometry
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.chain import apparent_to_hour_angle, icrs_to_apparent
from mountnav.sky.coordinates import Apparent, Icrs, Site
from mountnav.sky.sphere import displaced, half_turn_deg, position_angle_deg

Array = NDArray[np.float64]
# How far north of the look a second point is taken to find how the frame of date is turned, arcsec. Only
# its direction is used, so any short arc does.
_PROBE_ARCSEC = 60.0


@dataclass(frozen=True, slots=True)
class Fact:
    """One observation: hour angle and declination (rad) seen, read, and read as the other epoch's numbers.

    `turned_rad` is the position angle of the image's +y axis from the pole of date; NaN if unknown.
    """

    seen: tuple[float, float]
    read: tuple[float, float]
    other: tuple[float, float]
    turned_rad: float


@lru_cache(maxsize=4096)
def fact_of(observation: PointingObservation, site: Site) -> Fact:
    """Compute once per observation; a night asks again and again with one more."""
    utc, reading = observation.utc, observation.reading
    seen = icrs_to_apparent(observation.seen, utc)
    as_date = Apparent(reading.ra_deg, reading.dec_deg, utc)
    as_icrs = icrs_to_apparent(Icrs(reading.ra_deg, reading.dec_deg), utc)
    read, other = (as_date, as_icrs) if isinstance(reading, Apparent) else (as_icrs, as_date)
    turned = math.nan
    if observation.rotation_deg is not None:
        north = icrs_to_apparent(displaced(observation.seen, 0.0, _PROBE_ARCSEC), utc)
        turned = math.radians(observation.rotation_deg + position_angle_deg(seen, north))
    return Fact(_angles(seen, site), _angles(read, site), _angles(other, site), turned)


def _angles(place: Apparent, site: Site) -> tuple[float, float]:
    angle = apparent_to_hour_angle(place, site)
    return math.radians(angle.ha_deg), math.radians(angle.dec_deg)


@dataclass(frozen=True, slots=True)
class Facts:
    """All observations, in order of time; each array has shape (n,), angles in radians in the axes' frame.

    Attributes
    ----------
    utc_s : ndarray
        Seconds since the first.
    lon, lat : ndarray
        Where the tube looked.
    read_lon, read_lat, other_lon, other_lat : ndarray
        Reading, and reading if its numbers are of the other epoch.
    turned : ndarray
        Position angle of the image's +y axis from the frame's pole, north through east; NaN if unknown.
    sigma : ndarray
        Of the solved place, per coordinate.
    west : ndarray of bool
        Tube beyond the pole, as the mount says.
    axis_latitude : float
        Altitude of the frame's pole; 90° for alt-az.
    """

    utc_s: Array
    lon: Array
    lat: Array
    read_lon: Array
    read_lat: Array
    other_lon: Array
    other_lat: Array
    turned: Array
    sigma: Array
    west: NDArray[np.bool_]
    sides: tuple[PierSide, ...]
    segments: tuple[str, ...]
    look_ids: tuple[str, ...]
    axis_latitude: float

    def __len__(self) -> int:
        return int(self.lon.size)

    def part(self, mask: NDArray[np.bool_]) -> Facts:
        """Some of the observations."""
        kept = {one.name: getattr(self, one.name) for one in fields(self)}
        for name, value in kept.items():
            if isinstance(value, np.ndarray):
                kept[name] = value[mask]
            elif isinstance(value, tuple):
                kept[name] = tuple(one for one, keep in zip(value, mask, strict=True) if keep)
        return Facts(**kept)


def facts_of(observations: tuple[PointingObservation, ...], site: Site, *, altaz: bool = False) -> Facts:
    """Make arrays of observations that are in order of time."""
    ones = [fact_of(one, site) for one in observations]
    start = observations[0].utc
    latitude = math.radians(site.latitude_deg)
    seen, read, other = (
        np.array([getattr(one, name) for one in ones]).reshape(-1, 2) for name in ("seen", "read", "other")
    )
    turned = np.array([one.turned_rad for one in ones])
    if altaz:
        turned = turned - _parallactic(seen, latitude)
        seen, read, other = (to_altaz(one, latitude) for one in (seen, read, other))
    return Facts(
        utc_s=np.array([(one.utc - start).total_seconds() for one in observations]),
        lon=seen[:, 0],
        lat=seen[:, 1],
        read_lon=read[:, 0],
        read_lat=read[:, 1],
        other_lon=other[:, 0],
        other_lat=other[:, 1],
        turned=turned,
        sigma=np.radians(np.array([max(one.sigma_arcsec, 0.01) for one in observations]) / 3600.0),
        west=np.array([one.side is PierSide.WEST for one in observations]),
        sides=tuple(one.side for one in observations),
        segments=tuple(one.segment_id for one in observations),
        look_ids=tuple(one.look_id for one in observations),
        axis_latitude=math.pi / 2.0 if altaz else latitude,
    )


def to_altaz(angles: Array, latitude: float) -> Array:
    """Hour angles and declinations as azimuths from south through west and altitudes; shape (n, 2), rad."""
    lon, lat = angles[:, 0], angles[:, 1]
    x, y, z = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
    south = x * math.sin(latitude) - z * math.cos(latitude)
    up = x * math.cos(latitude) + z * math.sin(latitude)
    return np.column_stack((np.arctan2(y, south), np.arctan2(up, np.hypot(south, y))))


def from_altaz(angles: Array, latitude: float) -> Array:
    """Inverse of `to_altaz`."""
    lon, lat = angles[:, 0], angles[:, 1]
    south, y, up = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
    x = south * math.sin(latitude) + up * math.cos(latitude)
    z = up * math.sin(latitude) - south * math.cos(latitude)
    return np.column_stack((np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))))


def _parallactic(angles: Array, latitude: float) -> Array:
    """Position angle of the zenith at each place, north through east."""
    lon, lat = angles[:, 0], angles[:, 1]
    return np.arctan2(
        np.sin(lon) * math.cos(latitude),
        np.cos(lat) * math.sin(latitude) - np.sin(lat) * math.cos(latitude) * np.cos(lon),
    )


def wrapped(angle: Array) -> Array:
    """Into (-π, π]."""
    return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


def wrapped_deg(angle_deg: float) -> float:
    """Into (-180, 180]."""
    return half_turn_deg(angle_deg)


# Column of each term among the doctor's six (`evidence.GLOBAL`).
_TERMS = {
    "equatorial": {"CH": 0, "NP": 1, "ME": 2, "MA": 3, "TF": 4, "TX": 5},
    "altaz": {"CA": 0, "NPAE": 1, "AN": 2, "AW": 3, "TF": 4, "TX": 5},
}
# the doctor has one set of rotations for both kinds of mounts: the equatorial ones
_SENSES = {"CA": -1.0, "NPAE": -1.0, "AW": -1.0}
# Prior sigma, arcsec, of the six columns for terms that the model doesn't have; near that of the most
# precise class of `priors`; chosen by hand.
_UNSAID = (30.0, 20.0, 60.0, 60.0, 30.0, 35.0)
# No term of a model is trusted more closely than this, arcsec. Chosen by hand. Doubled, slighter changes of
# a modeled mount pass as ordinary.
_LEAST_ARCSEC = 10.0
# Sigma of the difference between both sides of the pier, in units of the model's noise. Chosen by hand.
_SIDES = 4.0


def geometry_of(model: PointingModel) -> tuple[tuple[Geometry, ...], float]:
    """Make priors of a model in force.

    Parameters
    ----------
    model : PointingModel
        What it holds beyond the six terms of geometry only widens them.

    Returns
    -------
    noise_arcsec : float
        Scatter of single looks on the sky.
    """
    noise = max(math.sqrt(2.0) * model.scatter_arcsec, model.sky_rms_arcsec or 0.0, 5.0)
    # terms that no rotation stands for act like errors of the geometry
    others = [
        value
        for name, value in zip(model.terms, model.coefficients_arcsec, strict=True)
        if name not in _TERMS[model.kind] and name not in ("IH", "ID", "IA", "IE")
    ]
    spare = math.sqrt(sum(one**2 for one in others))
    values, sigmas = [0.0, 0.0, 0.0, 0.0, 0.0, 12.5], list(_UNSAID)
    for name, value, sigma in zip(model.terms, model.coefficients_arcsec, model.sigma_arcsec, strict=True):
        at = _TERMS[model.kind].get(name)
        if at is not None:
            values[at] = _SENSES.get(name, 1.0) * value
            sigmas[at] = math.hypot(max(sigma, _LEAST_ARCSEC), spare)
    v, s = values, sigmas
    return (
        Geometry(
            (v[0], v[1], v[2], v[3], v[4], v[5]),
            (s[0], s[1], s[2], s[3], s[4], s[5]),
            _SIDES * max(noise, 15.0),
        ),
    ), noise
