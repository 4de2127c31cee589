"""GET /v1/objects: bright stars, Messier's objects, the solar system, and what was imported, by name."""

from __future__ import annotations

import asyncio
from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from api.orders.results import Finite, Place, place
from api.problems import responses
from api.service import TheService
from mountnav.clock import utc_now
from mountnav.ephemeris.bodies import SolarSystemBody
from mountnav.ephemeris.ephemeris import sky_rates
from mountnav.ephemeris.imported import Entry, imports
from mountnav.ephemeris.named import satellites_here
from mountnav.errors import BadRequest
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Site
from mountnav.sky.named import NamedObject, name_key, search

router = APIRouter(tags=["sky"])


class ObjectView(BaseModel):
    """Something that has a name; its name is a target of kind `name`."""

    name: str
    kind: Literal[
        "star", "messier", "planet", "moon", "sun", "minor-planet", "comet", "satellite", "planet-satellite"
    ]
    aliases: list[str]
    mag: Finite = Field(description="Visual; null where it changes")
    icrs: Place = Field(description="Now, seen from the site; nulls if it can't be told (`problem` says why)")
    altitude_deg: Finite = Field(description="Now, refracted")
    azimuth_deg: Finite
    moves: bool = Field(default=False, description="Among the stars")
    rate_arcsec_s: Finite = Field(default=None, description="How fast; null if it stands still")
    sigma_arcsec: Finite = Field(default=None, description="How uncertain its place is, one sigma")
    problem: str | None = Field(
        default=None, description="Why it has no place now: elements that are too old"
    )


@router.get("/objects", responses=responses())
async def search_objects(
    service: TheService,
    q: Annotated[
        str, Query(max_length=80, description="Part of a name or designation; empty: the brightest")
    ] = "",
    count: Annotated[int, Query(ge=1, le=100, description="At most so many objects")] = 20,
) -> list[ObjectView]:
    """Objects by name: that name itself, then those that begin so, then the brighter; imported ones last.

    Needs no network. Of imported objects at most ten are told with their places: each orbit is integrated.
    """
    site, air, utc = service.settings.site.site, service.settings.air.air, utc_now()
    views = [_bundled(found, utc, site, air) for found in search(q, count)]
    key = name_key(q)
    for name in satellites_here():
        if key and name.startswith(key):
            views.append(
                _moving(SolarSystemBody(name), name.capitalize(), "planet-satellite", [], utc, site, air)
            )
    if len(views) < count:
        found = await asyncio.to_thread(imports().search, q, min(count - len(views), _MOST_IMPORTED))
        views += await asyncio.to_thread(lambda: [_imported(entry, utc, site, air) for entry in found])
    return views[:count]


_MOST_IMPORTED = 10
"""Imported objects of an answer at most: to integrate an orbit from its epoch takes 50 to 300 ms. Doubled, an
answer takes twice as long."""


def _bundled(found: NamedObject, utc: datetime, site: Site, air: Air) -> ObjectView:
    if found.place is None:
        body = SolarSystemBody(found.name.lower())
        return _moving(body, found.name, found.kind, list(found.aliases), utc, site, air)
    icrs = found.icrs(utc, site)
    observed = icrs_to_observed(icrs, utc, site, air)
    return ObjectView(
        name=found.name,
        kind=found.kind,
        aliases=list(found.aliases),
        mag=found.mag,
        icrs=place(icrs),
        altitude_deg=observed.alt_deg,
        azimuth_deg=observed.az_deg,
    )


def _imported(entry: Entry, utc: datetime, site: Site, air: Air) -> ObjectView:
    aliases = list(getattr(entry.elements, "aliases", ()))
    return _moving(entry, entry.name, entry.kind, aliases, utc, site, air)


def _moving(
    found: SolarSystemBody | Entry,
    name: str,
    kind: Literal[
        "star", "messier", "planet", "moon", "sun", "minor-planet", "comet", "satellite", "planet-satellite"
    ],
    aliases: list[str],
    utc: datetime,
    site: Site,
    air: Air,
) -> ObjectView:
    try:
        target = found.ephemeris() if isinstance(found, Entry) else found
        icrs = target.icrs(utc, site)
        rate = sky_rates(target, utc, site).total_arcsec_s
        sigma = target.sigma_arcsec(utc)
    except BadRequest as refused:
        return ObjectView(
            name=name,
            kind=kind,
            aliases=aliases,
            mag=None,
            icrs=Place(ra_deg=None, dec_deg=None, frame="icrs"),
            altitude_deg=None,
            azimuth_deg=None,
            moves=True,
            problem=refused.what,
        )
    observed = icrs_to_observed(icrs, utc, site, air)
    return ObjectView(
        name=name,
        kind=kind,
        aliases=aliases,
        mag=None,
        icrs=place(icrs),
        altitude_deg=observed.alt_deg,
        azimuth_deg=observed.az_deg,
        moves=True,
        rate_arcsec_s=rate,
        sigma_arcsec=sigma,
    )
