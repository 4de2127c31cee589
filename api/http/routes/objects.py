"""GET /v1/objects: bright stars, Messier's objects, planets and the Moon by name, and where they are now."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from api.orders.results import Finite, Place, place
from api.problems import responses
from api.service import TheService
from mountnav.clock import utc_now
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.named import search

router = APIRouter(tags=["sky"])


class ObjectView(BaseModel):
    """Something bright that has a name; its name is a target of kind `name`."""

    name: str
    kind: Literal["star", "messier", "planet", "moon", "sun"]
    aliases: list[str]
    mag: Finite = Field(description="Visual; null where it changes")
    icrs: Place = Field(description="Now, seen from the site; proper motion taken into account")
    altitude_deg: Finite = Field(description="Now, refracted")
    azimuth_deg: Finite


@router.get("/objects", responses=responses())
async def search_objects(
    service: TheService,
    q: Annotated[
        str, Query(max_length=80, description="Part of a name or designation; empty: the brightest")
    ] = "",
    count: Annotated[int, Query(ge=1, le=100, description="At most so many")] = 20,
) -> list[ObjectView]:
    """Objects by name: that name itself, then those that begin so, then the brighter. Needs no network."""
    site, air, utc = service.settings.site.site, service.settings.air.air, utc_now()
    views = []
    for found in search(q, count):
        icrs = found.icrs(utc, site)
        observed = icrs_to_observed(icrs, utc, site, air)
        views.append(
            ObjectView(
                name=found.name,
                kind=found.kind,
                aliases=list(found.aliases),
                mag=found.mag,
                icrs=place(icrs),
                altitude_deg=observed.alt_deg,
                azimuth_deg=observed.az_deg,
            )
        )
    return views
