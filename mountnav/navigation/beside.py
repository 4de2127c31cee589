"""How far beside a mount's belief its tube looks: measured by a look, and carried on over the sky.

An offset of the axes: what a look shows in one place holds elsewhere as turns of both axes, apart from what
the geometry (a polar axis beside the pole, a cone error) makes of the way between. That grows with the way,
and is told as error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from mountnav.navigation.offset_trend import OffsetTrend
from mountnav.pointing.limits import Mounting
from mountnav.pointing.model.in_force import one_point_sigma_arcsec
from mountnav.sky.chain import (
    apparent_to_icrs,
    icrs_to_apparent,
    icrs_to_observed,
    observed_to_icrs,
)
from mountnav.sky.coordinates import Air, Apparent, Icrs, Observed, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec, turn_deg

__all__ = ["Beside"]

POLE_DEG = 89.9
"""Nearer to the pole of the axes an offset leads no further, °: beyond it the axes' angles turn round.
Doubled distance (89.8°), less of the sky is reached."""
ROUNDS = 3
"""So often the aim of a model is undone by what is left; each time a hundredth of it is. Doubled, nothing
more is gained."""

AXES_SHARE = 1.0
"""A mount whose zero points are off has axes off by this share of that, one sigma: who sets up by eye does
both so well. Halved, a pass of such a mount is 2.3 sigma off."""
NEAR_ARCSEC_DEG = 20.0
"""What mounts are off besides, ″ for each degree of the way, near a look. Doubled, looks on a pass count for
more than those before them."""
MODEL_LEAVES = 0.1
"""A pointing model leaves this share of that. Doubled, its passes are told to be twice as far off."""

Aim = Callable[[Icrs, datetime], Icrs]
"""Where a pointing model sends the mount for a place."""


def _as_it_is(place: Icrs, utc: datetime) -> Icrs:
    return place


@dataclass(frozen=True, slots=True)
class Beside:
    """Believed minus seen, as turns of the two axes; besides what a pointing model says.

    Attributes
    ----------
    altaz : bool
        Whether the axes are those of an alt-azimuth mount; else they are equatorial.
    aim_by : callable
        What the pointing model in force makes of a place; the place itself, without one.
    lon_arcsec, lat_arcsec : float
        Of the axes: right ascension and declination, or azimuth and altitude.
    lon_sigma_arcsec, lat_sigma_arcsec : float
        One sigma each, on the sky, where it was seen.
    at : Icrs or None
        Where that was; None: nothing was seen, and the sigmas hold everywhere.
    trend : OffsetTrend or None
        How it changes on a pass, by the looks there; None elsewhere.
    """

    site: Site
    air: Air
    altaz: bool
    aim_by: Aim = _as_it_is
    lon_arcsec: float = 0.0
    lat_arcsec: float = 0.0
    lon_sigma_arcsec: float = 0.0
    lat_sigma_arcsec: float = 0.0
    at: Icrs | None = None
    trend: OffsetTrend | None = None

    @classmethod
    def nothing_seen(
        cls, site: Site, air: Air, mounting: Mounting | None, aim_by: Aim | None, sigma_arcsec: float
    ) -> Beside:
        """What is known without a look: the model's aim, or nothing."""
        altaz = mounting == "altaz"
        made = cls(site, air, altaz, aim_by or _as_it_is)
        return made._with(0.0, 0.0, sigma_arcsec, sigma_arcsec, None)

    def seen(self, seen: Icrs, believed: Icrs, utc: datetime, sigma_arcsec: float) -> Beside:
        """After a look: weighed against what was known before, which is worth less the further it was.

        Parameters
        ----------
        sigma_arcsec : float
            Of the look, one sigma per coordinate; with what its instant is uncertain by.
        """
        lon, lat = self._turns(self.aim_by(seen, utc), believed, utc)
        before = [
            math.hypot(one, self._grown(seen)) for one in (self.lon_sigma_arcsec, self.lat_sigma_arcsec)
        ]
        told = max(sigma_arcsec, 1e-3)
        shares = [one**2 / (one**2 + told**2) for one in before]
        lon = self.lon_arcsec + shares[0] * (lon - self.lon_arcsec)
        lat = self.lat_arcsec + shares[1] * (lat - self.lat_arcsec)
        left = [told * math.sqrt(share) for share in shares]
        return self._with(lon, lat, left[0], left[1], seen)

    def anew(self, seen: Icrs, believed: Icrs, utc: datetime, sigma_arcsec: float) -> Beside:
        """After a look that counts alone: nothing of what was known before does."""
        lon, lat = self._turns(self.aim_by(seen, utc), believed, utc)
        return self._with(lon, lat, sigma_arcsec, sigma_arcsec, seen)

    def seen_on_the_way(
        self,
        seen: Icrs,
        believed: Icrs,
        utc: datetime,
        sigma_arcsec: float,
        along_arcsec: float,
        toward: Icrs,
    ) -> Beside:
        """After a look at a tube that follows a fast target: how the offset changes is learned as well.

        Parameters
        ----------
        sigma_arcsec : float
            Of the look across the way, one sigma.
        along_arcsec : float
            ... and along it.
        toward : Icrs
            A place ahead on the way.
        """
        trend, at = self.trend, self.at
        if trend is None or at is None:
            alone = self.seen(seen, believed, utc, math.hypot(sigma_arcsec, along_arcsec))
            cosine = self._cosine(seen, utc)
            variances = (alone.lon_sigma_arcsec / cosine) ** 2, alone.lat_sigma_arcsec**2
            return replace(
                alone, trend=OffsetTrend.begun(utc, (alone.lon_arcsec, alone.lat_arcsec), variances)
            )
        seconds = (utc - trend.utc).total_seconds()
        if seconds <= 0.0:
            return self
        cosine, change = self._cosine(seen, utc), self._grown(seen) / seconds
        after = trend.seen(
            utc,
            self._turns(self.aim_by(seen, utc), believed, utc),
            self._look_covariance(seen, toward, utc, sigma_arcsec, along_arcsec),
            change_arcsec_s=(change / cosine, change),
            way_deg=separation_arcsec(at, seen) / 3600.0,
        )
        lon, lat = after.at(utc)
        left = [math.sqrt(one) for one in after.variances(utc)]
        return replace(self._with(lon, lat, left[0] * cosine, left[1], seen), trend=after)

    def aim(self, place: Icrs, utc: datetime) -> Icrs:
        """Where to send the mount so that its tube looks at `place`."""
        return self._turned(self.aim_by(place, utc), 1.0, utc)

    def looks(self, believed: Icrs, utc: datetime) -> Icrs:
        """Where the tube looks when the mount believes to point at `believed`."""
        sent = self._turned(believed, -1.0, utc)
        place = sent
        for _ in range(ROUNDS if self.aim_by is not _as_it_is else 0):
            lon, lat = self._turns(self.aim_by(place, utc), sent, utc)
            place = self._with(lon, lat, 0.0, 0.0, None)._turned(place, 1.0, utc)
        return place

    def sigma_arcsec(self, place: Icrs, utc: datetime) -> float:
        """How far off the tube may look there and then, one sigma per coordinate."""
        if self.trend is not None and self.trend.turns:
            lon, lat = self.trend.variances(utc)
            return math.sqrt(0.5 * (lon * self._cosine(place, utc) ** 2 + lat))
        own = math.sqrt(0.5 * (self.lon_sigma_arcsec**2 + self.lat_sigma_arcsec**2))
        return math.hypot(own, self._grown(place))

    # -- the axes -----------------------------------------------------------------------------------

    def _grown(self, place: Icrs) -> float:
        """What the way since the look makes of it, ″; a model has the geometry already."""
        if self.at is None:
            return 0.0
        away_deg = separation_arcsec(self.at, place) / 3600.0
        if self.aim_by is not _as_it_is:
            away_deg *= MODEL_LEAVES
        # an offset as large as that of a mount that was set up by eye comes with axes as far off
        size = AXES_SHARE * math.hypot(self.lon_arcsec, self.lat_arcsec) * math.radians(away_deg)
        return math.hypot(min(one_point_sigma_arcsec(away_deg), NEAR_ARCSEC_DEG * away_deg), size)

    def _with(self, lon: float, lat: float, lon_sigma: float, lat_sigma: float, at: Icrs | None) -> Beside:
        return Beside(self.site, self.air, self.altaz, self.aim_by, lon, lat, lon_sigma, lat_sigma, at)

    def _angles(self, place: Icrs, utc: datetime) -> tuple[float, float]:
        if self.altaz:
            here = icrs_to_observed(place, utc, self.site, self.air)
            return here.az_deg, here.alt_deg
        of_date = icrs_to_apparent(place, utc)
        return of_date.ra_deg, of_date.dec_deg

    def _turns(self, place: Icrs, believed: Icrs, utc: datetime) -> tuple[float, float]:
        lon, lat = self._angles(place, utc)
        to_lon, to_lat = self._angles(believed, utc)
        return half_turn_deg(to_lon - lon) * 3600.0, (to_lat - lat) * 3600.0

    def _cosine(self, place: Icrs, utc: datetime) -> float:
        return max(1e-3, math.cos(math.radians(self._angles(place, utc)[1])))

    def _look_covariance(
        self, seen: Icrs, toward: Icrs, utc: datetime, across: float, along: float
    ) -> NDArray[np.float64]:
        """Of a look's offsets in the axes' angles: along the way it is less certain."""
        cosine = self._cosine(seen, utc)
        lon, lat = self._turns(seen, toward, utc)
        way = np.array([lon * cosine, lat])
        way /= max(float(np.linalg.norm(way)), 1e-9)
        on_the_sky = across**2 * np.eye(2) + along**2 * np.outer(way, way)
        as_angles = np.diag([1.0 / cosine, 1.0])
        return np.asarray(as_angles @ on_the_sky @ as_angles)

    def _turned(self, place: Icrs, sign: float, utc: datetime) -> Icrs:
        lon, lat = self._angles(place, utc)
        by_lon, by_lat = (self.lon_arcsec, self.lat_arcsec) if self.trend is None else self.trend.at(utc)
        lon = turn_deg(lon + sign * by_lon / 3600.0)
        lat = max(-POLE_DEG, min(POLE_DEG, lat + sign * by_lat / 3600.0))
        if self.altaz:
            return observed_to_icrs(Observed(lon, lat, utc), self.site, self.air)
        return apparent_to_icrs(Apparent(lon, lat, utc))
