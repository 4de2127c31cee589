"""Looks at the sky as angles of the axes: one model then holds both sides of the pier.

A German mount that looks through the pole has its hour angle axis half a turn on and its declination axis
past ±90°. In these angles collimation, non-perpendicularity and declination zero keep their signs on both
sides [POINTING §5]: a model without side signs leaves 849″ where this one leaves the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mountnav.devices import PierSide
from mountnav.errors import BadRequest
from mountnav.pointing.model.rigorous import angles, direction, wrapped
from mountnav.pointing.model.terms import Array, Kind
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.chain import (
    apparent_to_hour_angle,
    apparent_to_icrs,
    hour_angle_to_apparent,
    hour_angle_to_icrs,
    hour_angle_to_observed,
    icrs_to_apparent,
    icrs_to_hour_angle,
    observed_to_hour_angle,
)
from mountnav.sky.coordinates import (
    SIDEREAL_ARCSEC_S,
    Air,
    Apparent,
    GeometricHourAngle,
    HourAngle,
    Icrs,
    Observed,
    Site,
)

Bools = NDArray[np.bool_]
Numbers = NDArray[np.int64]

SAME_TARGET_RAD = np.radians(0.5)
"""Looks one after another that saw places so near each other are of one target."""
_DRIVEN_ARCSEC_S = 1.6
"""An alt-azimuth axis that tracks faster has taken up its play, 20″ or so, in the dozen seconds from the end
of a slew to the middle of an exposure; a slower one a part of it."""
_TURNED_RAD = np.radians(30.0 / 3600.0)
"""Axes that read so much more were turned there, and the play is taken up: gears have less."""
_LONG_WAY_RAD = np.radians(1.0)
"""The same over a sync, which changes what the axes read by less."""


@dataclass(frozen=True, slots=True, eq=False)
class Mechanical:
    """Observations as angles of the axes; structure of arrays.

    Attributes
    ----------
    seen : ndarray, shape (n, 3)
        Unit vectors of the observed (refracted) places the tube looked at.
    beyond : ndarray of bool, shape (n,)
        Whether it looked through the pole.
    read_lon_rad, read_lat_rad : ndarray, shape (n,)
        What the axes read; the latitude mechanical.
    sigma_arcsec : ndarray, shape (n,)
        One-sigma error of the solved place and the reading, per coordinate.
    segment : ndarray of int, shape (n,)
        Index into `segment_ids`.
    segment_ids : tuple of str
        Zero points are common within a segment; in order of time.
    target : ndarray of int, shape (n,), optional
        Looks of one number are of one target, also where a sync lies between them: what one of them is off
        by, the others are too. None: each is of its own.
    sense : ndarray, shape (n, 2), optional
        Sense (+1 to -1, 0 unknown) in which the gears of both axes were driven last: play. None: unknown.
    """

    kind: Kind
    site_latitude_rad: float
    seen: Array
    beyond: Bools
    read_lon_rad: Array
    read_lat_rad: Array
    sigma_arcsec: Array
    segment: Numbers
    segment_ids: tuple[str, ...]
    target: Numbers | None = None
    sense: Array | None = None

    @property
    def targets(self) -> Numbers:
        """`target`, also where each look is of its own."""
        return np.arange(len(self), dtype=np.int64) if self.target is None else self.target

    @property
    def senses(self) -> Array:
        """`sense`, 0 where it is unknown."""
        return np.zeros((len(self), 2)) if self.sense is None else self.sense

    def __len__(self) -> int:
        return len(self.read_lon_rad)

    @property
    def seen_angles(self) -> tuple[Array, Array]:
        """Mechanical longitude and latitude of a perfect mount that looks at the seen places, rad."""
        return folded(self.seen, self.beyond, self.site_latitude_rad)

    def chosen(self, which: Bools | Numbers) -> Mechanical:
        """Some of the observations; all segments keep their names."""
        return replace(
            self,
            seen=self.seen[which],
            beyond=self.beyond[which],
            read_lon_rad=self.read_lon_rad[which],
            read_lat_rad=self.read_lat_rad[which],
            sigma_arcsec=self.sigma_arcsec[which],
            segment=self.segment[which],
            target=None if self.target is None else self.target[which],
            sense=None if self.sense is None else self.sense[which],
        )


def folded(vectors: Array, beyond: Bools, site_latitude_rad: float) -> tuple[Array, Array]:
    """Axis angles of perfect geometry that look at places, through the pole where `beyond`; rad."""
    lon, lat = angles(vectors)
    over = np.copysign(np.pi, site_latitude_rad) - lat
    return wrapped(np.where(beyond, lon + np.pi, lon)), np.where(beyond, over, lat)


def looks_through_pole(side: PierSide, ha_deg: float, mounting: str | None) -> bool:
    """Whether the tube looks through the pole.

    Parameters
    ----------
    side : PierSide
        As the mount says; counts before everything else.
    ha_deg : float
        Hour angle looked at: a German mount that doesn't tell its side is taken to look away from its own
        side of the pier, from the east at positive hour angles.
    mounting : str or None
        Only a German mount has another side.
    """
    if side is not PierSide.UNKNOWN:
        return side is PierSide.WEST
    return mounting == "german" and ha_deg < 0.0


@dataclass(frozen=True, slots=True)
class Conversion:
    """Between places on the sky and the angles of a mount's axes.

    Attributes
    ----------
    does_refraction : bool
        Whether the mount itself allows for refraction: its readings are then of the unrefracted sky, and its
        axes stand at the refracted place. Else its readings are taken for what the axes read, and refraction
        is applied here, once [POINTING §3.5].
    mounting : str or None
        "german" where a mount that doesn't tell its side has two.
    """

    site: Site
    kind: Kind = "equatorial"
    does_refraction: bool = False
    mounting: str | None = None

    def seen_place(self, place: Icrs, observation_air: Air, at: PointingObservation) -> HourAngle:
        """Where in the observed sky a solved place stood."""
        return icrs_to_hour_angle(place, at.utc, self.site, observation_air)

    def read_place(self, reading: Apparent | Icrs, at: PointingObservation) -> tuple[float, float]:
        """Hour angle and declination of what the axes of a perfect mount would read for this reading, deg."""
        if self.does_refraction:
            icrs = reading if isinstance(reading, Icrs) else apparent_to_icrs(reading)
            refracted = icrs_to_hour_angle(icrs, at.utc, self.site, at.air)
            return refracted.ha_deg, refracted.dec_deg
        apparent = icrs_to_apparent(reading, at.utc) if isinstance(reading, Icrs) else reading
        plain = apparent_to_hour_angle(Apparent(apparent.ra_deg, apparent.dec_deg, at.utc), self.site)
        return plain.ha_deg, plain.dec_deg

    def vector(self, ha_deg: float, dec_deg: float, at: PointingObservation) -> Array:
        """Unit vector in the frame of the mount's kind."""
        if self.kind == "altaz":
            place = hour_angle_to_observed(HourAngle(ha_deg, dec_deg, at.utc), self.site)
            lon, lat = place.az_deg, place.alt_deg
        else:
            lon, lat = ha_deg, dec_deg
        return np.asarray(direction(np.array([np.radians(lon)]), np.array([np.radians(lat)]))[0])

    def reading_of(self, vector: Array, at: PointingObservation) -> Icrs:
        """ICRS place that a mount would report (or must be sent to) for a direction of its axes."""
        ha_deg, dec_deg = self._hour_angle(vector, at)
        if self.does_refraction:
            return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, at.utc), self.site, at.air)
        apparent = hour_angle_to_apparent(GeometricHourAngle(ha_deg, dec_deg, at.utc), self.site)
        return apparent_to_icrs(apparent)

    def icrs_of(self, vector: Array, at: PointingObservation) -> Icrs:
        """ICRS place of a direction of the observed sky."""
        ha_deg, dec_deg = self._hour_angle(vector, at)
        return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, at.utc), self.site, at.air)

    def _hour_angle(self, vector: Array, at: PointingObservation) -> tuple[float, float]:
        lon, lat = (float(np.degrees(one[0])) for one in angles(vector[None, :]))
        if self.kind == "altaz":
            place = observed_to_hour_angle(Observed(lon % 360.0, lat, at.utc), self.site)
            return place.ha_deg, place.dec_deg
        return lon, lat


def mechanical(observations: Sequence[PointingObservation], conversion: Conversion) -> Mechanical:
    """Turn observations into angles of the axes.

    Parameters
    ----------
    observations : sequence of PointingObservation
        In any order; segments are numbered in order of their first instant.

    Returns
    -------
    Mechanical
        In the order given.

    Raises
    ------
    BadRequest
        There are none, or one has no positive error.
    """
    if not observations:
        raise BadRequest("there are no observations", advice="look at some stars first")
    begun: dict[str, float] = {}
    for one in observations:
        begun[one.segment_id] = min(begun.get(one.segment_id, np.inf), one.utc.timestamp())
    ids = tuple(sorted(begun, key=lambda key: begun[key]))
    number = {key: index for index, key in enumerate(ids)}
    seen, read, beyond = [], [], []
    for one in observations:
        if not (np.isfinite(one.sigma_arcsec) and one.sigma_arcsec >= 0.0):
            name = one.look_id or one.utc.isoformat()
            raise BadRequest(f"the look {name} has a sigma of {one.sigma_arcsec}″")
        looked = conversion.seen_place(one.seen, one.air, one)
        seen.append(conversion.vector(looked.ha_deg, looked.dec_deg, one))
        read.append(conversion.vector(*conversion.read_place(one.reading, one), one))
        beyond.append(looks_through_pole(one.side, looked.ha_deg, conversion.mounting))
    latitude = float(np.radians(conversion.site.latitude_deg))
    through = np.array(beyond, dtype=np.bool_)
    lon, lat = folded(np.array(read), through, latitude)
    return Mechanical(
        conversion.kind,
        latitude,
        np.array(seen),
        through,
        lon,
        lat,
        np.array([one.sigma_arcsec for one in observations]),
        np.array([number[one.segment_id] for one in observations], dtype=np.int64),
        ids,
        _targets(observations, through),
        _senses(observations, conversion, through, lon, lat),
    )


def _targets(observations: Sequence[PointingObservation], beyond: Bools) -> Numbers:
    """Number the targets: looks one after another that saw the same place through the same side."""
    ra = np.radians([one.seen.ra_deg for one in observations])
    dec = np.radians([one.seen.dec_deg for one in observations])
    places = direction(ra, dec)
    target = np.zeros(len(observations), dtype=np.int64)
    first, number = -1, -1
    for index in sorted(range(len(observations)), key=lambda one: observations[one].utc):
        near = first >= 0 and float(np.linalg.norm(places[index] - places[first])) < SAME_TARGET_RAD
        if not near or beyond[index] != beyond[first]:
            first, number = index, number + 1
        target[index] = number
    return target


def _senses(
    observations: Sequence[PointingObservation], conversion: Conversion, beyond: Bools, lon: Array, lat: Array
) -> Array:
    """In which sense the gears were driven last; shape (n, 2).

    The journal tells it of slews in hour angle and declination; beyond the pole the declination axis turns
    the other way round. Where it tells nothing (flips; alt-azimuth mounts) the way from the look before does,
    if it was long. An alt-azimuth mount's axes are driven by tracking too, which takes up the play within
    seconds.
    """
    senses = np.zeros((len(observations), 2))
    if conversion.kind == "equatorial":
        senses[:] = [one.from_side for one in observations]
        senses[:, 1] *= np.where(beyond, -1.0, 1.0)
    order = sorted(range(len(observations)), key=lambda one: observations[one].utc)
    way = np.zeros_like(senses)
    for before, now in pairwise(order):
        moved = np.array([wrapped(lon[now] - lon[before]), lat[now] - lat[before]])
        # what wasn't turned since keeps the sense that it had; a sync between looks turns nothing
        synced = observations[now].segment_id != observations[before].segment_id
        turned = np.abs(moved) > (_LONG_WAY_RAD if synced else _TURNED_RAD)
        way[now] = np.where(turned, np.sign(moved), way[before])
        if not np.any(senses[now]) and (conversion.kind == "altaz" or beyond[now] != beyond[before]):
            senses[now] = way[now]
    if conversion.kind == "altaz":
        site = np.radians(conversion.site.latitude_deg)
        upright = np.clip(lat, -1.5, 1.5)
        azimuth = SIDEREAL_ARCSEC_S * (np.sin(site) - np.cos(site) * np.cos(lon) * np.tan(upright))
        elevation = SIDEREAL_ARCSEC_S * np.cos(site) * np.sin(lon)
        rates = np.stack([azimuth, elevation], axis=1)
        driven = np.minimum(np.abs(rates) / _DRIVEN_ARCSEC_S, 1.0)
        senses = driven * np.sign(rates) + (1.0 - driven) * senses
    return senses
