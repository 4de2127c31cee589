"""The truth of a virtual observatory: its time, and where its tubes really look. No real one has it."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Annotated, Literal

from fastapi import APIRouter, Depends
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from api.access.callers import Role
from api.access.security import RoleRequired
from api.problems import responses
from api.service import Service, TheService
from mountnav.clock import utc_now, virtual_time
from mountnav.errors import BadRequest, Busy
from mountnav.night.daylight import next_dark_from
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.chain import icrs_to_observed

router = APIRouter(tags=["virtual observatory"])


class TruthView(BaseModel):
    """Where the tube of one telescope truly looks; neither its mount nor the service knows."""

    model_config = ConfigDict(extra="forbid")

    telescope: str
    ra_deg: float = Field(description="ICRS, of the optical axis.")
    dec_deg: float
    alt_deg: float = Field(description="Refraction included.")
    az_deg: float = Field(description="North through east.")


class VirtualObservatoryView(BaseModel):
    """The virtual present, and the truth at that instant."""

    model_config = ConfigDict(extra="forbid")

    utc: datetime
    speed: float = Field(description="Virtual seconds in a second.")
    truth: list[TruthView]


_FARTHEST = timedelta(days=400)
"""Longest stretch that one order passes over: a year and a month. Doubled, a slip of the pen ends later."""


class SkipRequest(BaseModel):
    """Until when the virtual time passes at once."""

    model_config = ConfigDict(extra="forbid")

    until: Annotated[
        AwareDatetime | Literal["night"],
        Field(
            description="An instant with its time zone, later than now; or night: when it gets dark next, "
            "after the present night if it is dark."
        ),
    ]


@router.get("/virtual", responses=responses(), dependencies=[Depends(RoleRequired(Role.VIEW))])
async def get_truth(service: TheService) -> VirtualObservatoryView:
    """Tell where the tubes truly look now: to judge by, not to steer by."""
    return _truth(service)


@router.post(
    "/virtual/skip",
    responses=responses(409),
    dependencies=[Depends(RoleRequired(Role.OPERATE))],
)
async def skip_time(service: TheService, asked: SkipRequest) -> VirtualObservatoryView:
    """Let the virtual time pass at once, such as a day between two nights, while nothing moves.

    Refused while a telescope has a job, slews or tracks: nobody would watch it meanwhile.
    """
    virtual, now = virtual_time(), utc_now()
    if not isinstance(virtual, FastClock):
        raise BadRequest("there is no virtual time to pass", advice="start the service with --demo")
    until = next_dark_from(now, service.settings.site.site) if asked.until == "night" else asked.until
    if not now < until <= now + _FARTHEST:
        raise BadRequest(
            f"{until.isoformat()} is not within {_FARTHEST.days} days after now, {now.isoformat()}",
            advice="give a later instant, or night",
        )
    _require_at_rest(service)
    virtual.on((until - now).total_seconds())
    for telescope in service.dispatcher.telescopes:
        service.dispatcher.watch(telescope.id).wake()
    return _truth(service)


def _require_at_rest(service: Service) -> None:
    for telescope in service.dispatcher.telescopes:
        latest = service.dispatcher.watch(telescope.id).latest
        reading, why = latest.state.reading, None
        if latest.job is not None and not latest.job.is_over:
            why = f"it has the job {latest.job.kind}"
        elif latest.slewing:
            why = "it slews"
        elif latest.state.connected and reading is not None and reading.tracking:
            why = "it tracks"
        if why is not None:
            raise Busy(
                f"the time can't pass while nobody watches {telescope.id}: {why}",
                device=telescope.id,
                advice="park it, or stop its tracking, and ask again",
            )


def _truth(service: Service) -> VirtualObservatoryView:
    utc, virtual = utc_now(), virtual_time()
    site, air = service.settings.site.site, service.settings.air.air
    views = []
    for telescope in service.observatory.telescopes:
        if telescope.mechanics is None:
            continue
        place = telescope.mechanics.truth(utc)
        seen = icrs_to_observed(place, utc, site, air)
        views.append(
            TruthView(
                telescope=telescope.id,
                ra_deg=place.ra_deg,
                dec_deg=place.dec_deg,
                alt_deg=seen.alt_deg,
                az_deg=seen.az_deg,
            )
        )
    return VirtualObservatoryView(utc=utc, speed=1.0 if virtual is None else virtual.speed, truth=views)
