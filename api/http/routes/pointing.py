"""A telescope's pointing, from the looks in the journal: its doctor's findings, and its drift report."""

from __future__ import annotations

import asyncio
from datetime import datetime, timedelta
from typing import Annotated, Any

from fastapi import APIRouter, Query

from api.observatory.observatory import Telescope
from api.pointing.judgements import diagnosis_view, drift_view
from api.pointing.looks import looks_of_journal
from api.problems import responses
from api.service import Service, TheService, TheTelescope
from mountnav.clock import utc_now
from mountnav.devices import ConnectReport
from mountnav.pointing.model.in_force import ModelInForce
from mountnav.pointing.model.model import PointingModel

router = APIRouter(prefix="/telescopes", tags=["pointing"])

Hours = Annotated[float, Query(gt=0, le=24 * 366, description="How far back the looks are taken, hours")]


@router.get("/{telescope_id}/pointing-doctor", responses=responses(404))
async def get_diagnosis(service: TheService, telescope: TheTelescope, hours: Hours = 14.0) -> dict[str, Any]:
    """What the solved looks say about clock, site, epoch, image, pier side and clutches. Moves nothing."""
    looks, _, synced_on = await _looks(service, telescope.id, hours)
    navigator = telescope.navigator
    return await asyncio.to_thread(
        diagnosis_view,
        looks,
        site=service.settings.site.site,
        epoch=navigator.mount.epoch,
        mounting=navigator.mount.mounting,
        synced_on=synced_on,
        parity=None if navigator.learned.normal is None else navigator.learned.normal.parity,
        model=_model(telescope),
        sign_confirmed=_says_the_same(telescope),
    )


@router.get("/{telescope_id}/drift", responses=responses(404))
async def get_drift(service: TheService, telescope: TheTelescope, hours: Hours = 14.0) -> dict[str, Any]:
    """Rates, periodic error, settle time, polar alignment with advice, from the solved looks."""
    looks, slew_ends, _ = await _looks(service, telescope.id, hours)
    return await asyncio.to_thread(
        drift_view,
        looks,
        site=service.settings.site.site,
        slew_ends=slew_ends,
        model=_model(telescope),
        altaz=telescope.navigator.mount.mounting == "altaz",
    )


def _says_the_same(telescope: Telescope) -> bool:
    """Whether the mount has told the longitude that we have, to half a degree."""
    report = telescope.navigator.mount.report
    off_deg = report.longitude_off_deg if isinstance(report, ConnectReport) else None
    return off_deg is not None and abs(off_deg) < 0.5


def _model(telescope: Telescope) -> PointingModel | None:
    """The model in force, if there is one: it tells apart what looks alike without it."""
    pointing = telescope.navigator.pointing
    return pointing.model if isinstance(pointing, ModelInForce) else None


async def _looks(service: Service, telescope_id: str, hours: float) -> Any:
    since: datetime = utc_now() - timedelta(hours=hours)
    return await asyncio.to_thread(
        looks_of_journal, service.settings.journal.where, telescope_id, since, None
    )
