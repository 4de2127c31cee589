"""The settings read again: telescopes added, changed and taken out while the others go on."""

from __future__ import annotations

from fastapi import APIRouter, Request
from pydantic import BaseModel, Field

from api.access.security import TheCaller
from api.http.reloading import reloaded
from api.problems import responses

router = APIRouter(tags=["service"])


class ReloadView(BaseModel):
    """What reading the settings again has changed."""

    added: list[str] = Field(description="Telescopes that are new")
    changed: list[str] = Field(description="Telescopes that were let go and put together anew")
    removed: list[str] = Field(description="Telescopes that were stopped and let go")
    untouched: list[str] = Field(description="Telescopes that went on meanwhile")
    needs_restart: list[str] = Field(
        description="Other tables of the file that differ from what the service runs with: they count from "
        "its next start on"
    )


@router.post("/reload", responses=responses(409))
async def reload_settings(request: Request, caller: TheCaller) -> ReloadView:
    """Read the settings file again. Telescopes whose table changed are exchanged; all others go on.

    A telescope that is taken out or changed must be idle: no job, no lease, no night under way. Whatever is
    wrong with the file, or not idle, is told, and nothing is changed then.
    """
    told = await reloaded(request.app, caller)
    return ReloadView(
        added=list(told.added),
        changed=list(told.changed),
        removed=list(told.removed),
        untouched=list(told.untouched),
        needs_restart=list(told.needs_restart),
    )
