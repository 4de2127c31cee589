"""How far off the solved looks were, one by one: what drift and residuals are plotted from."""

from __future__ import annotations

import asyncio
from datetime import datetime, timedelta
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from api.orders.job_views import Finite
from api.pointing.looks import looks_of_journal
from api.problems import responses
from api.service import TheService, TheTelescope
from mountnav.clock import utc_now
from mountnav.pointing.drift.stretches import MOVED_ARCSEC, cut, looks_of
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Site

router = APIRouter(prefix="/telescopes", tags=["pointing"])

Hours = Annotated[float, Query(gt=0, le=24 * 7, description="How far back the looks are taken, hours")]
Most = Annotated[int, Query(ge=1, le=5000, description="At most so many looks, the newest")]

_LINE_FROM_LOOKS = 3
"""Looks that a straight line is fitted through at the least: two would leave no residual."""


class LookOffsetView(BaseModel):
    """A look: seen minus believed, east and north positive."""

    utc: datetime
    look_id: str
    stretch: int = Field(description="Looks between two moves or syncs have the same number")
    east_arcsec: Finite = Field(description="What refraction alone does within the stretch is taken off")
    north_arcsec: Finite
    sigma_arcsec: Finite
    residual_east_arcsec: Finite = Field(description="From the stretch's straight line; null below 3 looks")
    residual_north_arcsec: Finite


class LookOffsetsView(BaseModel):
    """The newest solved looks of a telescope, in the order of time."""

    telescope: str
    looks: list[LookOffsetView]
    slew_ends: list[datetime]


@router.get("/{telescope_id}/offsets", responses=responses(404))
async def get_offsets(
    service: TheService, telescope: TheTelescope, hours: Hours = 14.0, most: Most = 1000
) -> LookOffsetsView:
    """Seen minus believed of each solved look, and what a straight drift between two moves leaves of it."""
    since = utc_now() - timedelta(hours=hours)
    where, site = service.settings.journal.where, service.settings.site.site

    def reckon() -> LookOffsetsView:
        found, slew_ends, _ = looks_of_journal(where, telescope.id, since, None)
        newest = sorted(found, key=lambda one: one.utc)[-most:]
        return LookOffsetsView(
            telescope=telescope.id, looks=_offsets(newest, site), slew_ends=sorted(slew_ends)[-most:]
        )

    return await asyncio.to_thread(reckon)


def _offsets(observations: list[PointingObservation], site: Site) -> list[LookOffsetView]:
    views: list[LookOffsetView] = []
    for number, part in enumerate(cut(observations, MOVED_ARCSEC)):
        looks = looks_of(part, site, refracts=False)
        left = [_left(looks.seconds, side) for side in (looks.east, looks.north)]
        views += [
            LookOffsetView(
                utc=one.utc,
                look_id=one.look_id,
                stretch=number,
                east_arcsec=float(looks.east[place]),
                north_arcsec=float(looks.north[place]),
                sigma_arcsec=float(looks.sigma[place]),
                residual_east_arcsec=None if left[0] is None else float(left[0][place]),
                residual_north_arcsec=None if left[1] is None else float(left[1][place]),
            )
            for place, one in enumerate(part)
        ]
    return views


def _left(seconds: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """What a straight line leaves; None where two looks would always lie on one."""
    if seconds.size < _LINE_FROM_LOOKS or np.ptp(seconds) <= 0.0:
        return None
    design = np.column_stack([np.ones_like(seconds), seconds])
    return np.asarray(values - design @ np.linalg.lstsq(design, values, rcond=None)[0])


__all__ = ["router"]
