"""Whether the service lives, and which version it is. Open to all: it tells nothing of the sky."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter

from api.models import EarthRotationView, HealthView, VersionView
from api.service import TheService
from mountnav import __version__
from mountnav.sky.iers import iers_status

router = APIRouter(tags=["service"])


@router.get("/health")
async def get_health(service: TheService) -> HealthView:
    """Tell that the service lives, what is connected, and until when UT1 is known. Asks no device."""
    connected = {telescope.id: telescope.is_open for telescope in service.observatory.telescopes}
    rotation = iers_status()
    solver = service.solver
    well = all(connected.values()) and rotation.warning is None and not solver.state.startswith("failed")
    status: Literal["ok", "degraded"] = "ok" if well else "degraded"
    return HealthView(
        status=status,
        version=__version__,
        telescopes=connected,
        solver=solver.state,
        blind_index=solver.blind_index.state,
        earth_rotation=EarthRotationView(
            dut1_s=rotation.dut1_s,
            dut1_overridden=rotation.dut1_overridden,
            table_ends_utc=rotation.last_row_utc,
            table_days_left=rotation.days_left,
            warning=rotation.warning,
        ),
    )


@router.get("/version")
async def get_version() -> VersionView:
    """Tell what runs here."""
    return VersionView(name="mountnav", version=__version__)
