"""What will happen to a target in the next hours, as this telescope and its site see it."""

from __future__ import annotations

from datetime import datetime, timedelta

from pydantic import BaseModel, Field

from api.orders.results import Finite, Place, SkyEventView, place
from api.orders.targets import AnyTarget, Body, Target, ephemeris_of, moves
from mountnav.clock import utc_now
from mountnav.ephemeris.ephemeris import Ephemeris, sky_rates
from mountnav.errors import BadRequest
from mountnav.mount import CheckedMount
from mountnav.pointing.limits.along import SkyEvent, forecast
from mountnav.sky.chain import icrs_to_observed

__all__ = ["LONGEST_H", "ForecastBody", "ForecastView", "forecast_of", "sky_event_view"]

LONGEST_H = 48.0
"""Furthest that is looked ahead, hours: two nights. Doubled, one request of a satellite takes seconds of a
processor more."""
USUAL_H = 12.0
"""The same where nothing is said: whatever is up sets within it. Doubled, each forecast tells of tomorrow."""


class ForecastBody(Body):
    """Of which target, and how far ahead."""

    target: Target
    hours: float = Field(default=USUAL_H, gt=0, le=LONGEST_H)


class ForecastView(BaseModel):
    """Where a target is now, how it moves, and what will happen to it; nothing is ordered by it."""

    telescope: str
    name: str = Field(description="What it is called")
    moves: bool = Field(description="Whether it moves among the stars")
    utc: datetime = Field(description="Of this moment")
    until_utc: datetime = Field(description="Up to which it is told; before `hours` where its ephemeris ends")
    ends_utc: datetime | None = Field(description="When its ephemeris ends; null: not in sight")
    place: Place = Field(description="Where it is now, topocentric and astrometric")
    altitude_deg: Finite = Field(description="Observed, now")
    azimuth_deg: Finite
    sigma_arcsec: Finite = Field(description="How uncertain that place is, one sigma")
    ra_arcsec_s: Finite = Field(description="How it moves now, not times cos(dec); positive to the east")
    dec_arcsec_s: Finite
    total_arcsec_s: Finite = Field(description="Along its way on the sphere")
    events: list[SkyEventView] = Field(description="In the sequence of time")


def sky_event_view(event: SkyEvent) -> SkyEventView:
    """View of one event."""
    return SkyEventView(
        kind=str(event.kind),
        utc=event.utc,
        altitude_deg=event.alt_deg,
        azimuth_deg=event.az_deg,
        limit=None if event.limit is None else str(event.limit),
        words=event.words,
    )


def forecast_of(telescope_id: str, mount: CheckedMount, target: AnyTarget, hours: float) -> ForecastView:
    """What will happen to a target. Takes up to seconds for one that is fast: to be called in a thread.

    Raises
    ------
    BadRequest
        No such target, or none at this moment.
    """
    utc, site, air = utc_now(), mount.site, mount.air
    ephemeris: Ephemeris = ephemeris_of(target, utc, site, air)
    if ephemeris.begins_utc is not None and ephemeris.begins_utc > utc:
        raise BadRequest(
            f"{ephemeris.name} begins at {ephemeris.begins_utc:%Y-%m-%d %H:%M:%S} UTC only",
            advice="ask for a later time, or give an ephemeris that has begun",
        )
    until_utc = utc + timedelta(hours=hours)
    if ephemeris.ends_utc is not None:
        until_utc = min(until_utc, ephemeris.ends_utc)
    here = ephemeris.icrs(utc, site)
    seen = icrs_to_observed(here, utc, site, air)
    rates = sky_rates(ephemeris, utc, site)
    events = forecast(
        mount.limits,
        lambda at: ephemeris.icrs(at, site),
        utc,
        until_utc,
        site,
        air,
        mounting=mount.mounting,
    )
    return ForecastView(
        telescope=telescope_id,
        name=_name_of(target, ephemeris),
        moves=moves(target),
        utc=utc,
        until_utc=until_utc,
        ends_utc=ephemeris.ends_utc,
        place=place(here),
        altitude_deg=seen.alt_deg,
        azimuth_deg=seen.az_deg,
        sigma_arcsec=ephemeris.sigma_arcsec(utc),
        ra_arcsec_s=rates.ra_arcsec_s,
        dec_arcsec_s=rates.dec_arcsec_s,
        total_arcsec_s=rates.total_arcsec_s,
        events=[sky_event_view(event) for event in events],
    )


def _name_of(target: AnyTarget, ephemeris: Ephemeris) -> str:
    return str(getattr(target, "name", None) or ephemeris.name)
