"""Earth satellites by SGP4, as a telescope at a site sees them.

SGP4's places are of the true equator and mean equinox of date (TEME) [Vallado et al. 2006, AIAA 2006-6753].
They go to the Earth-fixed frame by the Greenwich mean sidereal time of 1982, as that paper has it, and to the
ICRS by the IAU's 2006/2000A chain, polar motion and UT1 allowed for.

The satellite goes around the Sun with the Earth while its light is under way: leaving that out would be 20″
wrong, for the chain to the apparent place adds the whole aberration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from functools import lru_cache
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray
from sgp4.api import SGP4_ERRORS, WGS72, Satrec

from mountnav.ephemeris.ephemeris import require_within
from mountnav.errors import BadRequest
from mountnav.sky.chain import slow_parts
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.iers import EarthOrientation, earth_orientation, utc_mjd
from mountnav.sky.observer import direction, earth_barycentric_km, instant, site_geocentric_km
from mountnav.units import LIGHT_KM_S, MJD_ZERO_JD, SECONDS_PER_DAY

Vector = NDArray[np.float64]

_SGP4_EPOCH_MJD = 33281
"""SGP4 counts its days from 1949-12-31 0 h."""
_EARTH_RADIUS_KM = 6378.135
"""Of WGS72, as SGP4 has it."""
_LIGHT_STEPS = 2
"""How often the light time is asked for again: the second step changes it by v/c, 3e-5 of a millisecond."""

SIGMA_AT_EPOCH_KM = 1.0
"""What elements are worth at their epoch, along the way: 1 km is the usual figure of public elements of low
satellites [Vallado & Cefola 2012]. Doubled, searches for fresh elements are twice as wide."""
SIGMA_KM_A_DAY = 1.5
"""How it grows: 1 to 3 km a day are told by the same. Doubled, elements are refused after half the days."""
DRAG_DOUBT = 0.2
"""So much of what drag does is unknown: the upper air's density is forecast no better. Doubled, elements of
low satellites are refused a third earlier."""
MOST_SIGMA_DEG = 3.0
"""Elements are refused when the satellite may be further off than this, overhead: no search finds it then.
Doubled, elements of the space station count 6 days instead of 4."""
MOST_AGE_DAYS = 60.0
"""Older elements are refused whatever their sigma: the forces of Sun and Moon on high satellites aren't
SGP4's best, and satellites maneuver. Doubled, a geostationary one that was moved is looked for where it
was."""


@dataclass(frozen=True, slots=True)
class SatelliteElements:
    """Mean elements for SGP4, as a TLE or an OMM has them.

    Attributes
    ----------
    norad_id : int
        Catalog number; 0 if there is none.
    epoch_mjd_day, epoch_day_fraction
        The same to a microsecond, as SGP4 takes it.
    bstar : float
        Drag, per Earth radius.
    motion_dot_rev_day2, motion_ddot_rev_day3 : float
        Half the first and a sixth of the second derivative, as the formats write them.
    international_id : str
        "1998-067A"; empty if there is none.

    Raises
    ------
    BadRequest
        Numbers that belong to no orbit around the Earth.
    """

    name: str
    norad_id: int
    epoch_utc: datetime
    mean_motion_rev_day: float
    eccentricity: float
    inclination_deg: float
    node_deg: float
    perigee_deg: float
    mean_anomaly_deg: float
    bstar: float = 0.0
    motion_dot_rev_day2: float = 0.0
    motion_ddot_rev_day3: float = 0.0
    international_id: str = ""

    def __post_init__(self) -> None:
        """Refuse what is no orbit."""
        if self.epoch_utc.utcoffset() is None:
            raise BadRequest(f"the epoch of {self.name} doesn't say its time zone")
        bounds = (
            ("mean motion", self.mean_motion_rev_day, 0.01, 18.0, "revolutions a day"),
            ("eccentricity", self.eccentricity, 0.0, 0.999999, ""),
            ("inclination", self.inclination_deg, 0.0, 180.0, "°"),
            ("right ascension of the node", self.node_deg, 0.0, 360.0, "°"),
            ("argument of perigee", self.perigee_deg, 0.0, 360.0, "°"),
            ("mean anomaly", self.mean_anomaly_deg, 0.0, 360.0, "°"),
            ("drag term B*", self.bstar, -10.0, 10.0, ""),
            ("change of the mean motion", self.motion_dot_rev_day2, -10.0, 10.0, "rev/day²"),
            ("second change of the mean motion", self.motion_ddot_rev_day3, -100.0, 100.0, "rev/day³"),
        )
        for what, value, low, high, unit in bounds:
            if not low <= value <= high:
                told = f"{value:.9g} {unit}".rstrip()
                raise BadRequest(f"{self.name}: {what} {told} is impossible for an Earth satellite")
        if not 0 <= self.norad_id < 1_000_000_000:
            raise BadRequest(f"{self.name}: {self.norad_id} is not a catalog number")

    @property
    def semi_major_km(self) -> float:
        """Half the orbit's length."""
        # Kepler's third law with WGS72's GM of 398600.8 km³/s²
        n = self.mean_motion_rev_day * 2.0 * math.pi / SECONDS_PER_DAY
        return float((398600.8 / n**2) ** (1.0 / 3.0))

    def sigma_km(self, utc: datetime) -> float:
        """How far off along its way it may be, one sigma; grows with the elements' age."""
        age_days = abs((utc - self.epoch_utc).total_seconds()) / SECONDS_PER_DAY
        # the along-way effect of drag is a turn of motion_dot * age², in revolutions
        drag_km = 2.0 * math.pi * self.semi_major_km * abs(self.motion_dot_rev_day2) * age_days**2
        return SIGMA_AT_EPOCH_KM + SIGMA_KM_A_DAY * age_days + DRAG_DOUBT * drag_km

    def satrec(self) -> Satrec:
        """The orbit as SGP4 takes it. Raises `BadRequest` if SGP4 refuses."""
        day, fraction = utc_mjd(self.epoch_utc)
        made = Satrec()
        per_minute = 2.0 * math.pi / 1440.0
        made.sgp4init(
            WGS72,
            "i",
            self.norad_id % 100_000,
            (day - _SGP4_EPOCH_MJD) + fraction,
            self.bstar,
            self.motion_dot_rev_day2 * per_minute / 1440.0,
            self.motion_ddot_rev_day3 * per_minute / 1440.0**2,
            self.eccentricity,
            math.radians(self.perigee_deg),
            math.radians(self.inclination_deg),
            math.radians(self.mean_anomaly_deg),
            self.mean_motion_rev_day * per_minute,
            math.radians(self.node_deg),
        )
        # sgp4init rounds the day to doubles of days since 1950; the fraction is better kept on its own
        made.jdsatepoch, made.jdsatepochF = MJD_ZERO_JD + day, fraction
        if made.error:
            raise BadRequest(
                f"{self.name}: SGP4 refuses its elements: {SGP4_ERRORS.get(made.error, made.error)}"
            )
        return made


@lru_cache(maxsize=256)
def _teme_to_gcrs(utc: datetime, earth: EarthOrientation) -> Any:
    """Matrix from TEME of date to the axes of the ICRS, shape (3, 3)."""
    now = instant(utc)
    day, fraction = utc_mjd(utc)
    ut1 = fraction + earth.dut1_s / SECONDS_PER_DAY
    slow = slow_parts(now.jd1, now.jd2)
    x, y = erfa.bpn2xy(slow.matrix)
    celestial = erfa.c2ixys(x, y, slow.s_rad)
    # over the Earth-fixed frame without polar motion: R3(GMST) takes TEME to it, R3(-ERA) leads back
    turn = float(erfa.gmst82(MJD_ZERO_JD + day, ut1)) - float(erfa.era00(MJD_ZERO_JD + day, ut1))
    cos, sin = math.cos(turn), math.sin(turn)
    about = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return celestial.T @ about


@dataclass(frozen=True, slots=True)
class EarthSatellite:
    """A satellite of the Earth, as an `Ephemeris`; it ends when its elements are too old.

    Attributes
    ----------
    begins_utc, ends_utc : datetime
        Within them the elements are young enough: see `MOST_SIGMA_DEG` and `MOST_AGE_DAYS`.

    Raises
    ------
    BadRequest
        SGP4 refuses the elements.
    """

    elements: SatelliteElements
    begins_utc: datetime = field(init=False)
    ends_utc: datetime = field(init=False)
    _satrec: Satrec = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Set SGP4 up; find how long the elements are good for."""
        object.__setattr__(self, "_satrec", self.elements.satrec())
        good = timedelta(days=self._good_for_days())
        object.__setattr__(self, "begins_utc", self.elements.epoch_utc - good)
        object.__setattr__(self, "ends_utc", self.elements.epoch_utc + good)

    @property
    def name(self) -> str:
        """As its elements call it."""
        return self.elements.name

    def _good_for_days(self) -> float:
        overhead_km = max(self.elements.semi_major_km - _EARTH_RADIUS_KM, 100.0)
        most_km = overhead_km * math.radians(MOST_SIGMA_DEG)
        low, high = 0.0, MOST_AGE_DAYS
        if self.elements.sigma_km(self.elements.epoch_utc + timedelta(days=high)) <= most_km:
            return high
        for _ in range(30):
            middle = (low + high) / 2.0
            fits = self.elements.sigma_km(self.elements.epoch_utc + timedelta(days=middle)) <= most_km
            low, high = (middle, high) if fits else (low, middle)
        return low

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """Where it stands.

        Raises
        ------
        BadRequest
            Its elements are too old (or too young) for the instant, or it has come down by them.
        """
        return direction(self.vector_km(utc, site))

    def vector_km(self, utc: datetime, site: Site) -> Vector:
        """From the observer to the satellite, astrometric, shape (3,), km. Raises as `icrs`."""
        self._require_young(utc)
        matrix = _teme_to_gcrs(utc, earth_orientation(utc))
        here = site_geocentric_km(utc, site)[0]
        earth_km_s = earth_barycentric_km(utc)[1]
        light_s = 0.0
        vector = np.zeros(3)
        for _ in range(_LIGHT_STEPS + 1):
            vector = matrix @ self.teme_km(utc, -light_s) - here - earth_km_s * light_s
            light_s = float(np.linalg.norm(vector)) / LIGHT_KM_S
        return vector

    def teme_km(self, utc: datetime, later_s: float = 0.0) -> Vector:
        """SGP4's own place, TEME of date, shape (3,), km. Raises `BadRequest` if there is none."""
        day, fraction = utc_mjd(utc)
        error, place, _ = self._satrec.sgp4(MJD_ZERO_JD + day, fraction + later_s / SECONDS_PER_DAY)
        if error or not all(map(math.isfinite, place)):
            raise BadRequest(
                f"{self.name} has no place at {utc:%Y-%m-%d %H:%M} UTC: "
                f"{SGP4_ERRORS.get(error, 'SGP4 gives no number')}",
                advice="get elements of today",
            )
        return np.asarray(place)

    def sigma_arcsec(self, utc: datetime) -> float:
        """How far off it may be if it stood overhead: there it would count most."""
        self._require_young(utc)
        height_km = float(np.linalg.norm(self.teme_km(utc))) - _EARTH_RADIUS_KM
        return math.degrees(math.atan2(self.elements.sigma_km(utc), max(height_km, 100.0))) * 3600.0

    def _require_young(self, utc: datetime) -> None:
        days = (self.ends_utc - self.elements.epoch_utc).total_seconds() / SECONDS_PER_DAY
        why = (
            f" (its elements are of {self.elements.epoch_utc:%Y-%m-%d %H:%M} UTC and good for "
            f"{days:.1f} days: later it may be {self.elements.sigma_km(self.ends_utc):.0f} km off)"
        )
        require_within(self.name, utc, self.begins_utc, self.ends_utc, why)
