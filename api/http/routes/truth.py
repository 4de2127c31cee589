"""The truth of a virtual observatory: its time, and where its tubes really look. No real one has it."""

from __future__ import annotations

from datetime import datetime

from fastapi import APIRouter, Depends
from pydantic import BaseModel, ConfigDict, Field

from api.access.callers import Role
from api.access.security import RoleRequired
from api.problems import responses
from api.service import TheService
from mountnav.clock import utc_now, virtual_time
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


@router.get("/virtual", responses=responses(), dependencies=[Depends(RoleRequired(Role.VIEW))])
async def get_truth(service: TheService) -> VirtualObservatoryView:
    """Tell where the tubes truly look now: to judge by, not to steer by."""
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
