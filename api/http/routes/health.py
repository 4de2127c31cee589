"""Whether the service lives and is ready, and which version it is. Open: it tells nothing of the sky."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from api.http.service_views import (
    DoorView,
    EarthRotationView,
    HealthView,
    LiveView,
    ReadyView,
    VersionView,
    readiness,
)
from api.observatory.virtual import virtual_view
from api.problems import PROBLEM_TYPE, Refused, problem
from api.service import Service, TheService
from mountnav import __version__
from mountnav.sky.iers import iers_status

router = APIRouter(tags=["service"])

_NOT_READY: dict[int | str, dict[str, Any]] = {
    503: {
        "description": "It is not ready; `detail` says why",
        "content": {PROBLEM_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
}


@router.get("/health")
async def get_health(service: TheService) -> HealthView:
    """Whether the service is ready, and what is connected. Always 200. Asks no device."""
    found, rotation = readiness(service), iers_status()
    return HealthView(
        status="ok" if found.well else "degraded",
        ready=found.ready,
        why_not=list(found.why_not),
        concerns=list(found.concerns),
        version=__version__,
        telescopes={telescope.id: telescope.is_open for telescope in service.observatory.telescopes},
        solver=service.solver.state,
        solver_engine=service.solver.engine,
        journal=service.journal.problem or "ok",
        blind_index=service.solver.blind_index.state,
        earth_rotation=EarthRotationView(
            dut1_s=rotation.dut1_s,
            dut1_overridden=rotation.dut1_overridden,
            table_ends_utc=rotation.last_row_utc,
            table_days_left=rotation.days_left,
            warning=rotation.warning,
        ),
        doors=listener_views(service),
        virtual=virtual_view(),
    )


@router.get("/health/live")
async def get_live() -> LiveView:
    """Whether the process lives: for a supervisor that restarts it if it doesn't answer."""
    return LiveView(version=__version__)


@router.get("/health/ready", responses=_NOT_READY)
async def get_ready(service: TheService) -> ReadyView:
    """200 if orders are taken and can be carried out; else 503 `not-ready`, and why not."""
    found = readiness(service)
    if not found.ready:
        detail = "; ".join(found.why_not)
        raise Refused(problem("not-ready", 503, detail, advice="see /v1/health", retryable=True))
    return ReadyView(concerns=list(found.concerns))


@router.get("/version")
async def get_version() -> VersionView:
    """The version of mountnav that runs here, and of the interface. Asks no device."""
    return VersionView(name="mountnav", version=__version__)


def listener_views(service: Service) -> dict[str, DoorView]:
    """The states of the listeners for other programs."""
    settings = service.settings
    enabled = {
        "alpaca-discovery": settings.alpaca.enabled and settings.alpaca.discovery,
        "indi": settings.indi_server.enabled,
        "lx200": settings.lx200_server.enabled,
        "stellarium": settings.stellarium.enabled,
        "solver-commands": settings.solver_commands.enabled,
        "nova": settings.nova.enabled,
    }
    states = service.listeners.states
    views = {}
    for name, on in enabled.items():
        state = states.get(name)
        if state is None:
            views[name] = DoorView(enabled=on)
        else:
            views[name] = DoorView(enabled=on, host=state.host, port=state.port, problem=state.problem)
    return views
