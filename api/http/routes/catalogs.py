"""GET /v1/catalogs: the star catalogs that frames are solved with."""

from __future__ import annotations

import asyncio
from typing import Literal

from fastapi import APIRouter
from pydantic import BaseModel, Field

from api.orders.job_views import Finite
from api.problems import responses
from api.service import Service, TheService
from mountnav.catalog.catalog_set import CatalogSet
from mountnav.catalog.doctor.diagnosis import named_catalogs
from mountnav.catalog.packed import PackedStore

router = APIRouter(prefix="/catalogs", tags=["service"])


class CatalogRecord(BaseModel):
    """A star catalog."""

    slug: str = Field(description="Its name in commands and settings")
    name: str
    kind: Literal["embedded", "imported", "online"]
    stars: int | None = Field(description="null for an online one")
    band: str | None
    commonest_mag: Finite = Field(default=None, description="Beyond this magnitude it thins out")
    faintest_mag: Finite = None
    epoch_yr: Finite = None
    sky_percent: Finite = Field(default=None, description="Share of the sky that it covers")


@router.get("", responses=responses())
async def list_catalogs(service: TheService) -> list[CatalogRecord]:
    """The star catalogs that frames are solved with: on this machine, then online. Asks no server."""
    return await asyncio.to_thread(_records, service)


def _records(service: Service) -> list[CatalogRecord]:
    records = []
    for named in named_catalogs(service.catalog):
        if isinstance(named.catalog, PackedStore):
            embedded = isinstance(service.catalog, CatalogSet) and named.catalog is service.catalog.indexed
            _, faintest, commonest = named.catalog.magnitudes
            records.append(
                CatalogRecord(
                    slug=named.slug,
                    name=named.catalog.name,
                    kind="embedded" if embedded else "imported",
                    stars=len(named.catalog),
                    band=named.catalog.header.band,
                    commonest_mag=commonest,
                    faintest_mag=faintest,
                    epoch_yr=named.catalog.header.epoch_yr,
                    sky_percent=100.0 * named.catalog.sky_share(),
                )
            )
    use = service.settings.catalogs.use
    for online in service.settings.catalogs.online:
        if use is None or online.name in use:
            records.append(
                CatalogRecord(
                    slug=online.name,
                    name=online.table or online.url,
                    kind="online",
                    stars=None,
                    band=online.band,
                    faintest_mag=online.mag_limit,
                    epoch_yr=online.epoch_yr,
                )
            )
    return records
