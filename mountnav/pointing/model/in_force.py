"""A pointing model at work: where to send the mount, what to expect there, and the segment's zero points.

The geometry is the model's and doesn't change. The two zero points belong to the segment: each look measures
them, with an error that grows where the axis' angle means little (near the pole) and where the model is
uncertain, and a Kalman filter that lets them wander slowly averages the looks [POINTING §7].

What a sync does: after a sync at P the mount's belief is right at P, so the zero points become those for
which the model's correction at P is zero; elsewhere the difference between the model there and at P remains.
A sync is treated as any other look: the position seen, and what the mount says of it afterwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol

import numpy as np

from mountnav.devices import PierSide
from mountnav.errors import ModelRefused
from mountnav.pointing.model.mechanical import Conversion, folded, looks_through_pole
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.rigorous import POLE_AVOIDED_RAD, Geometry, axes_for, seen_from, wrapped
from mountnav.pointing.model.terms import Array, basis
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.sphere import Offset, offset_arcsec
from mountnav.units import RAD_PER_ARCSEC


@dataclass(frozen=True, slots=True)
class Expected:
    """What a pointing model expects at a target, before anything has moved.

    Attributes
    ----------
    offset : Offset
        Seen minus believed that is expected there; east and north positive.
    sigma_arcsec : float
        How far from it (on the sky, one sigma per coordinate) the tube may look.
    """

    offset: Offset
    sigma_arcsec: float


class Pointing(Protocol):
    """A pointing model in force, with the zero points of the present segment."""

    @property
    def model_id(self) -> str | None:
        """Which model; None when there is none and only the last sync is known."""
        ...

    def expected(self, target: Icrs, utc: datetime, side: PierSide) -> Expected:
        """Offset (seen minus believed) expected at `target`.

        Raises
        ------
        ModelRefused
            The target can't be reached with this geometry, or is too near a pole of the model.
        """
        ...

    def aim(self, target: Icrs, utc: datetime, side: PierSide) -> Icrs:
        """Where to send the mount so that the tube looks at `target`. Raises `ModelRefused`."""
        ...

    def observed(self, observation: PointingObservation) -> None:
        """Learn the zero points of the observation's segment from it."""
        ...

    def new_segment(self, segment_id: str, synced: PointingObservation | None) -> None:
        """The mount's zero points have changed; by a sync on `synced`, if one is given."""
        ...


def one_point_sigma_arcsec(away_deg: float) -> float:
    """How far off a mount without a model may be so far from the one place where it was right.

    5 m: 6.5″ at 10°, 50″ at 50°; 8 m: 82″ at 50° [POINTING §4]; small mounts are some times worse.
    """
    return math.hypot(5.0, 10.0 * away_deg)


class NoModel:
    """Without a model: no offset is expected; how far off the tube may be grows with the way since a sync.

    The growth is what one-point syncs are worth on real telescopes [POINTING §4]; as long as nothing was seen
    in this segment, all is possible that the configuration allows.
    """

    def __init__(self, unseen_sigma_arcsec: float = 3600.0) -> None:
        self._unseen_sigma_arcsec = unseen_sigma_arcsec
        self._last: Icrs | None = None
        self._side = PierSide.UNKNOWN
        self._segment: str | None = None

    @property
    def model_id(self) -> str | None:
        """None."""
        return None

    def expected(self, target: Icrs, utc: datetime, side: PierSide) -> Expected:
        """No offset, with a sigma that grows with the distance from what was seen last."""
        from mountnav.sky.sphere import separation_arcsec

        sigma = self._unseen_sigma_arcsec
        # a sync on the other side of the pier is worth nothing: twice the cone lies between [POINTING §5]
        flipped = {self._side, side} == {PierSide.EAST, PierSide.WEST}
        if self._last is not None and not flipped:
            away_deg = separation_arcsec(self._last, target) / 3600.0
            sigma = one_point_sigma_arcsec(away_deg)
        return Expected(Offset(0.0, 0.0), min(sigma, self._unseen_sigma_arcsec))

    def aim(self, target: Icrs, utc: datetime, side: PierSide) -> Icrs:
        """The target itself."""
        return target

    def observed(self, observation: PointingObservation) -> None:
        """Nothing is learned without a sync: the mount's belief stays as wrong as it is."""

    def new_segment(self, segment_id: str, synced: PointingObservation | None) -> None:
        """From a sync on, what lies near it is right."""
        self._segment = segment_id
        self._last = None if synced is None else synced.seen
        self._side = PierSide.UNKNOWN if synced is None else synced.side


# Sigma of the zero points before the first look of a segment, arcsec: a degree. Chosen by hand; doubled,
# the first look counts almost alone all the same.
UNSEEN_SIGMA_ARCSEC = 3600.0
# Random walk of the zero points, arcsec in an hour. Chosen by hand; doubled, older looks count less and
# single ones more.
WANDER_ARCSEC_PER_ROOT_HOUR = 5.0
_GATE = 25.0
"""χ² of two coordinates beyond which a look isn't of the same zero points: one honest look in 270,000."""
# Bound on a look's sigma, arcsec, which is infinite at the pole: it tells nothing then, without breaking
# the arithmetic.
_WORST_SIGMA_ARCSEC = 1e6
_LEAST_SCATTER_ARCSEC = 1.0
"""No telescope repeats itself better from night to night, however well one run went."""


@dataclass(frozen=True, slots=True)
class SegmentZeroPoints:
    """What is known of the zero points of the present segment.

    Attributes
    ----------
    lon_arcsec, lat_arcsec : float
        Added to the axes' readings.
    looks : int
        That told them.
    """

    segment_id: str
    lon_arcsec: float
    lat_arcsec: float
    sigma_lon_arcsec: float
    sigma_lat_arcsec: float
    looks: int


class ModelInForce:
    """A pointing model applied to one mount; a `Pointing`.

    Parameters
    ----------
    air : Air
        For places to come; looks bring their own.
    does_refraction : bool
        Whether the mount allows for refraction itself; must be as it was when the model was made.
    mounting : str, optional
        "german" where a mount that doesn't tell its side has two.
    resolution_arcsec : float
        Of the mount's places.
    unseen_sigma_arcsec : float
        How far off the zero points may be in a segment that nothing was seen in.
    wander_arcsec : float
        How far they wander in an hour.

    Raises
    ------
    ModelRefused
        The model was made for another site, or for readings with another refraction.
    """

    def __init__(
        self,
        model: PointingModel,
        *,
        site: Site,
        air: Air,
        does_refraction: bool = False,
        mounting: str | None = None,
        resolution_arcsec: float = 0.0,
        unseen_sigma_arcsec: float = UNSEEN_SIGMA_ARCSEC,
        wander_arcsec: float = WANDER_ARCSEC_PER_ROOT_HOUR,
    ) -> None:
        if abs(model.site_latitude_deg - site.latitude_deg) > 0.05:
            raise ModelRefused(
                f"the pointing model {model.id} was made at latitude {model.site_latitude_deg:.3f}°, "
                f"the site is at {site.latitude_deg:.3f}°",
                advice="make a model here; if the telescope never moved, correct the site",
            )
        if model.does_refraction != does_refraction:
            was, now = ("itself", "doesn't") if model.does_refraction else ("not at all", "does")
            raise ModelRefused(
                f"the pointing model {model.id} was made for a mount that allows for refraction {was}, "
                f"this one {now}",
                advice="set does_refraction as it was when the looks were taken, or make a new model",
            )
        self._model = model
        self._air = air
        self._conversion = Conversion(site, model.kind, does_refraction, mounting)
        self._geometry: Geometry = model.rotations(with_zero_points=False)
        self._resolution = resolution_arcsec / math.sqrt(12.0)
        self._scatter = max(model.scatter_arcsec, _LEAST_SCATTER_ARCSEC)
        self._unseen = unseen_sigma_arcsec
        self._wander = wander_arcsec
        sign = -1.0 if model.kind == "altaz" else 1.0
        self._zero = np.array([sign * model.coefficients_arcsec[0], model.coefficients_arcsec[1]])
        self._covariance = np.eye(2) * unseen_sigma_arcsec**2
        self._segment_id = ""
        self._looks = 0
        self._last_utc: datetime | None = None
        self._suspect: tuple[Array, Array] | None = None

    @property
    def model_id(self) -> str | None:
        """Which model."""
        return self._model.id

    @property
    def model(self) -> PointingModel:
        """The model itself."""
        return self._model

    @property
    def zero_points(self) -> SegmentZeroPoints:
        """What is known of the present segment's."""
        sigma = np.sqrt(np.diag(self._covariance))
        lon, lat = self._zero.tolist()
        return SegmentZeroPoints(self._segment_id, lon, lat, float(sigma[0]), float(sigma[1]), self._looks)

    # -- what it is asked ------------------------------------------------------------------------

    def expected(self, target: Icrs, utc: datetime, side: PierSide) -> Expected:
        """Offset (seen minus believed) when the mount believes to be at `target`.

        Raises
        ------
        ModelRefused
            The place is within 1.2′ of the mount's own pole.
        """
        at = self._moment(target, utc, side)
        lon, lat = self._axes_reading(at)
        self._refuse_pole(lat, target)
        zero = self._zero * RAD_PER_ARCSEC
        seen = seen_from(self._geometry, np.array([lon + zero[0]]), np.array([lat + zero[1]]))[0]
        offset = offset_arcsec(self._conversion.icrs_of(seen, at), target)
        return Expected(offset, self._sigma_arcsec(lon + zero[0], lat + zero[1], utc))

    def aim(self, target: Icrs, utc: datetime, side: PierSide) -> Icrs:
        """Where to send the mount so that the tube looks at `target`.

        Raises
        ------
        ModelRefused
            No position of the axes looks there, or it is within 1.2′ of the mount's own pole.
        """
        at = self._moment(target, utc, side)
        lon, lat = self._axes_seeing(target, at)
        zero = self._zero * RAD_PER_ARCSEC
        turned, over = lon - zero[0], lat - zero[1]
        vector = np.array(
            [math.cos(over) * math.cos(turned), math.cos(over) * math.sin(turned), math.sin(over)]
        )
        return self._conversion.reading_of(vector, at)

    # -- what it learns --------------------------------------------------------------------------

    def observed(self, observation: PointingObservation) -> None:
        """Learn the zero points from a look.

        A look that can't be of these zero points changes nothing, until a second one agrees with it: one
        wrong solution doesn't move the model, a slipped clutch does.
        """
        if observation.segment_id != self._segment_id:
            self.new_segment(observation.segment_id, None)
        try:
            told, error = self._told(observation)
        except ModelRefused:
            return  # at the pole a look says nothing of the hour angle's zero point
        self._pass_to(observation.utc)
        if self._looks and self._off(told, error, self._zero, self._covariance) > _GATE:
            if self._suspect is not None and self._off(told, error, *self._suspect) <= _GATE:
                self._zero, self._covariance = self._joined(told, error, *self._suspect)
                self._suspect, self._looks = None, 2
            else:
                self._suspect = told, error
            return
        self._suspect = None
        self._zero, self._covariance = self._joined(told, error, self._zero, self._covariance)
        self._looks += 1

    def new_segment(self, segment_id: str, synced: PointingObservation | None) -> None:
        """Zero points have changed; how, is told by `synced`: the look synced on, with the reading after it.

        Without it they are as they were, as likely as not (after a flip they mostly are), and anything else
        is possible. Told twice of one segment, with the look the second time, nothing is lost.
        """
        if segment_id != self._segment_id or synced is not None:
            self._segment_id = segment_id
            self._covariance = np.eye(2) * self._unseen**2
            self._looks = 0
            self._last_utc = None
            self._suspect = None
        if synced is not None:
            try:
                told, error = self._told(synced)
            except ModelRefused:
                return
            self._zero, self._covariance = told, error
            self._looks, self._last_utc = 1, synced.utc

    # -- how -------------------------------------------------------------------------------------

    def _moment(self, place: Icrs, utc: datetime, side: PierSide) -> PointingObservation:
        return PointingObservation(utc, place, 0.0, place, side=side, air=self._air)

    def _axes_reading(self, at: PointingObservation) -> tuple[float, float]:
        """What a perfect mount's axes read for a reading: longitude and mechanical latitude."""
        ha_deg, dec_deg = self._conversion.read_place(at.reading, at)
        beyond = looks_through_pole(at.side, ha_deg, self._conversion.mounting)
        return self._folded(ha_deg, dec_deg, at, beyond)

    def _folded(
        self, ha_deg: float, dec_deg: float, at: PointingObservation, beyond: bool
    ) -> tuple[float, float]:
        vector = self._conversion.vector(ha_deg, dec_deg, at)
        lon, lat = folded(vector[None, :], np.array([beyond]), self._geometry.site_latitude_rad)
        return float(lon[0]), float(lat[0])

    def _axes_seeing(self, target: Icrs, at: PointingObservation) -> tuple[float, float]:
        """Axis angles, zero points apart, that make the tube look at a place. Raises `ModelRefused`."""
        looked = self._conversion.seen_place(target, at.air, at)
        beyond = looks_through_pole(at.side, looked.ha_deg, self._conversion.mounting)
        vector = self._conversion.vector(looked.ha_deg, looked.dec_deg, at)
        axes = axes_for(self._geometry, vector[None, :], np.array([beyond]))
        if not axes.reached[0]:
            raise ModelRefused(
                f"no position of the axes looks at {target.ra_deg:.4f}°, {target.dec_deg:+.4f}°: "
                "its collimation error keeps it from the mount's own pole",
                advice="choose a position farther from the pole, or switch the model off for it",
            )
        self._refuse_pole(float(axes.lat_rad[0]), target, near=bool(axes.near_pole[0]))
        return float(axes.lon_rad[0]), float(axes.lat_rad[0])

    def _refuse_pole(self, lat_rad: float, place: Icrs, *, near: bool | None = None) -> None:
        if near if near is not None else abs(math.cos(lat_rad)) < math.sin(POLE_AVOIDED_RAD):
            raise ModelRefused(
                f"{place.ra_deg:.4f}°, {place.dec_deg:+.4f}° is within 1.2′ of the mount's own pole, "
                "where the angle of its axis is undefined",
                advice="choose a position farther from the pole, or switch the model off for it",
            )

    def _told(self, look: PointingObservation) -> tuple[Array, Array]:
        """Zero points that explain a look, and their covariance, arcsec. Raises `ModelRefused`."""
        lon, lat = self._axes_seeing(look.seen, look)
        # the side on which the look was: as it was taken to be in finding the axes
        looked = self._conversion.seen_place(look.seen, look.air, look)
        beyond = looks_through_pole(look.side, looked.ha_deg, self._conversion.mounting)
        read_lon, read_lat = self._folded(*self._conversion.read_place(look.reading, look), look, beyond)
        off = np.array([lon - read_lon, lat - read_lat])
        told = wrapped(off) / RAD_PER_ARCSEC
        own = look.sigma_arcsec**2 + self._resolution**2 + self._scatter**2
        sky = np.eye(2) * max(own, 1e-6) + self._model_covariance(lon, lat)
        scale = np.array([1.0 / math.cos(lat), 1.0])
        error = sky * np.outer(scale, scale)
        return told, np.asarray(np.minimum(error, _WORST_SIGMA_ARCSEC**2))

    def _model_covariance(self, lon: float, lat: float) -> Array:
        """Of the model's geometry on the sky at axis angles, zero points apart; shape (2, 2), arcsec².

        The zero points were fitted with it and are told again by each segment's looks: what remains is the
        error of the geometry for fixed zero points.
        """
        names = self._model.geometry_terms
        if not names:
            return np.zeros((2, 2))
        f = basis(
            self._model.kind, names, np.array([lon]), np.array([lat]), self._geometry.site_latitude_rad
        )[0]
        whole = self._model.covariance
        among, mixed, zero = whole[2:, 2:], whole[2:, :2], whole[:2, :2]
        if np.all(np.diag(zero) > 0.0):
            among = among - mixed @ np.linalg.solve(zero, mixed.T)
        return np.asarray(f @ among @ f.T)

    def _pass_to(self, utc: datetime) -> None:
        if self._last_utc is not None and utc > self._last_utc:
            hours = (utc - self._last_utc).total_seconds() / 3600.0
            self._covariance = self._covariance + np.eye(2) * self._wander**2 * hours
        self._last_utc = utc if self._last_utc is None else max(utc, self._last_utc)

    @staticmethod
    def _joined(told: Array, error: Array, known: Array, covariance: Array) -> tuple[Array, Array]:
        gain = covariance @ np.linalg.inv(covariance + error)
        off = wrapped((told - known) * RAD_PER_ARCSEC) / RAD_PER_ARCSEC
        kept = np.eye(2) - gain
        # Joseph's form stays symmetric and positive
        return known + gain @ off, kept @ covariance @ kept.T + gain @ error @ gain.T

    @staticmethod
    def _off(told: Array, error: Array, known: Array, covariance: Array) -> float:
        off = wrapped((told - known) * RAD_PER_ARCSEC) / RAD_PER_ARCSEC
        return float(off @ np.linalg.solve(covariance + error, off))

    def _sigma_arcsec(self, lon: float, lat: float, utc: datetime) -> float:
        """One sigma per coordinate on the sky: model, zero points, and what single looks scatter by."""
        zero = self._covariance
        if self._last_utc is not None and utc > self._last_utc:
            hours = (utc - self._last_utc).total_seconds() / 3600.0
            zero = zero + np.eye(2) * self._wander**2 * hours
        along = np.array([math.cos(lat), 1.0])
        sky = zero * np.outer(along, along) + self._model_covariance(lon, lat)
        scatter = self._scatter**2 + self._resolution**2
        return math.sqrt(0.5 * float(np.trace(sky)) + scatter)
