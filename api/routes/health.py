"""Whether the service lives, and which version it is. Open to all: it tells nothing of the sky."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter

from api.models import HealthView, VersionView
from api.service import TheService
from mountnav import __version__

router = APIRouter(tags=["service"])


@router.get("/health")
async def get_health(service: TheService) -> HealthView:
    """Tell that the service lives, and which telescopes are connected. Asks no device."""
    connected = {telescope.id: telescope.is_open for telescope in service.observatory.telescopes}
    status: Literal["ok", "degraded"] = "ok" if all(connected.values()) else "degraded"
    return HealthView(status=status, version=__version__, telescopes=connected)


@router.get("/version")
async def get_version() -> VersionView:
    """Tell what runs here."""
    return VersionView(name="mountnav", version=__version__)
