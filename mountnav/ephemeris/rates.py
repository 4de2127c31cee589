"""Targets that somebody gives by a place, rates and an end: among the stars, or over the horizon."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from mountnav.ephemeris.ephemeris import require_within, told
from mountnav.errors import BadRequest
from mountnav.sky.chain import observed_to_icrs
from mountnav.sky.coordinates import Air, Icrs, Observed, Site
from mountnav.sky.sphere import turn_deg

LONGEST_RATES = timedelta(days=2)
"""So long rates may hold: who gives them knows the target for a night. Doubled, a curved way is further
off its tangent by four times as much."""
MOST_RATE_ARCSEC_S = 36_000.0
"""Fastest rate that is taken, 10°/s: twice what a rocket launch from nearby does. What a mount can do is
judged by it."""


def _require_span(begins: datetime, ends: datetime) -> None:
    if begins.utcoffset() is None or ends.utcoffset() is None:
        raise BadRequest("begin and end of rates have to say their time zone", advice="give UTC, ending in Z")
    if not begins < ends:
        raise BadRequest(f"rates that begin at {told(begins)} can't end at {told(ends)}")
    if ends - begins > LONGEST_RATES:
        raise BadRequest(
            f"rates over {(ends - begins).total_seconds() / 3600:.1f} h are too long; "
            f"{LONGEST_RATES.total_seconds() / 3600:g} h are the most",
            advice="give orbital elements or an ephemeris table for longer",
        )


def _require_rate(rate_arcsec_s: float) -> None:
    if not abs(rate_arcsec_s) <= MOST_RATE_ARCSEC_S:
        raise BadRequest(
            f"no telescope can follow a rate of {rate_arcsec_s:g}″/s; {MOST_RATE_ARCSEC_S:g} is the most"
        )


def _require_off_poles(begin_deg: float, end_deg: float, what: str) -> None:
    if not (-90.0 <= begin_deg <= 90.0 and -90.0 <= end_deg <= 90.0):
        raise BadRequest(
            f"these rates lead to {what} {end_deg:+.2f}°, over the pole, where such rates have no meaning",
            advice="end them before, or give the path by waypoints",
        )


@dataclass(frozen=True, slots=True)
class SkyRatesTarget:
    """A place in the ICRS at an instant that moves evenly in right ascension and declination.

    Attributes
    ----------
    place : Icrs
        Topocentric, astrometric, at `begins_utc`.
    ra_arcsec_s, dec_arcsec_s : float
        Change of the right ascension (not times cos δ, east positive) and of the declination, ″ per SI
        second.
    begins_utc, ends_utc : datetime
        It has no place before and after.
    sigma_arcsec_told : float
        What the giver thinks it is worth.

    Raises
    ------
    BadRequest
        It ends before it begins, lasts too long, is too fast, or leads over a pole.
    """

    place: Icrs
    ra_arcsec_s: float
    dec_arcsec_s: float
    begins_utc: datetime
    ends_utc: datetime
    name: str = "a target by rates"
    sigma_arcsec_told: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what leads nowhere."""
        _require_span(self.begins_utc, self.ends_utc)
        _require_rate(self.ra_arcsec_s)
        _require_rate(self.dec_arcsec_s)
        lasts_s = (self.ends_utc - self.begins_utc).total_seconds()
        end_deg = self.place.dec_deg + self.dec_arcsec_s * lasts_s / 3600.0
        _require_off_poles(self.place.dec_deg, end_deg, "declination")

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """Where it stands; the same from every site. Raises `BadRequest` outside its span."""
        require_within(self.name, utc, self.begins_utc, self.ends_utc)
        since_s = (utc - self.begins_utc).total_seconds()
        return Icrs(
            turn_deg(self.place.ra_deg + self.ra_arcsec_s * since_s / 3600.0),
            self.place.dec_deg + self.dec_arcsec_s * since_s / 3600.0,
        )

    def sigma_arcsec(self, utc: datetime) -> float:
        """As told."""
        return self.sigma_arcsec_told


@dataclass(frozen=True, slots=True)
class HorizonRatesTarget:
    """A direction over the horizon at an instant that moves evenly in azimuth and altitude; or stands still.

    Attributes
    ----------
    az_deg, alt_deg : float
        Observed (with refraction, if the air has a pressure) at `begins_utc`; azimuth north through east.
    az_arcsec_s, alt_arcsec_s : float
        Change of the azimuth (not times cos of the altitude) and of the altitude, ″ per SI second. Both 0: it
        stands still over the horizon, while the stars pass.

    Raises
    ------
    BadRequest
        As of `SkyRatesTarget`.
    """

    az_deg: float
    alt_deg: float
    az_arcsec_s: float
    alt_arcsec_s: float
    begins_utc: datetime
    ends_utc: datetime
    air: Air
    name: str = "a target by rates over the horizon"
    sigma_arcsec_told: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what leads nowhere."""
        _require_span(self.begins_utc, self.ends_utc)
        _require_rate(self.az_arcsec_s)
        _require_rate(self.alt_arcsec_s)
        lasts_s = (self.ends_utc - self.begins_utc).total_seconds()
        _require_off_poles(self.alt_deg, self.alt_deg + self.alt_arcsec_s * lasts_s / 3600.0, "altitude")

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """Where that direction lies among the stars. Raises `BadRequest` outside its span."""
        require_within(self.name, utc, self.begins_utc, self.ends_utc)
        since_s = (utc - self.begins_utc).total_seconds()
        here = Observed(
            az_deg=turn_deg(self.az_deg + self.az_arcsec_s * since_s / 3600.0),
            alt_deg=self.alt_deg + self.alt_arcsec_s * since_s / 3600.0,
            utc=utc,
        )
        return observed_to_icrs(here, site, self.air)

    def sigma_arcsec(self, utc: datetime) -> float:
        """As told."""
        return self.sigma_arcsec_told
