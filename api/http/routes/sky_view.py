"""A telescope's limits, and where all stands in its sky now: what a map of the sky is drawn from."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from api.http.sky_views import LimitsView, SkyView, limits_view, sky_view
from api.problems import responses
from api.service import TheService, TheTelescope
from mountnav.sky.coordinates import Icrs

router = APIRouter(prefix="/telescopes", tags=["telescopes"])

Ra = Annotated[
    float | None,
    Query(
        ge=0,
        lt=360,
        allow_inf_nan=False,
        description="Right ascension, ICRS, degrees; with `dec_deg`, the answer tells of this place too",
    ),
]
Dec = Annotated[float | None, Query(ge=-90, le=90, allow_inf_nan=False)]


@router.get("/{telescope_id}/limits", responses=responses(404))
async def get_limits(telescope: TheTelescope) -> LimitsView:
    """Where the telescope may point: altitudes, horizon, hour angles, cones round Sun and Moon."""
    return limits_view(telescope.id, telescope.navigator)


@router.get("/{telescope_id}/sky", responses=responses(404))
async def get_sky(
    service: TheService, telescope: TheTelescope, ra_deg: Ra = None, dec_deg: Dec = None
) -> SkyView:
    """Sidereal time, Sun and Moon, the telescope's way over the sky, and the limit that it will reach first.

    With `ra_deg` and `dec_deg` also where that place stands, and whether it lies within the limits: an
    answer of this moment, which every slew asks again.
    """
    asked = None if ra_deg is None or dec_deg is None else Icrs(ra_deg, dec_deg)
    snapshot = service.dispatcher.watch(telescope.id).latest
    jobs = [job for job in service.jobs.all() if job.telescope == telescope.id]
    return sky_view(telescope.navigator, snapshot.state, snapshot.job, jobs, asked, telescope.last_frame)
