"""The audit: who ordered what, by which face, from where, and what became of it; newest first."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from pydantic import BaseModel, Field

from api.access.security import TheCaller, require_telescope
from api.http.journal_views import Instant
from api.problems import responses
from mountnav.journal.audit_and_leases import AuditRow
from mountnav.journal.reading import JournalReader, Wanted

router = APIRouter(tags=["journal"])


class AuditView(BaseModel):
    """One order, or attempt at one."""

    row: int = Field(description="Counts up")
    utc: datetime
    telescope: str = Field(description="Empty for what concerns the whole service")
    caller: str = Field(description="The name of the key; `(unknown)` for somebody who showed none")
    role: str
    face: str = Field(description="rest, alpaca, indi, lx200, stellarium; service for its own acts")
    address: str
    what: str = Field(description="The order's kind, or the route")
    request: dict[str, Any] = Field(description="What was asked for, without secrets")
    outcome: str = Field(
        description="taken; answered, of what is not an order; or the slug of the problem it was refused for"
    )
    detail: str
    status: int | None = None
    job_id: str | None = None


class AuditPageView(BaseModel):
    """A page of the audit."""

    rows: list[AuditView]
    next_cursor: str | None = Field(
        description="Hand it back as `cursor` for the next, older page; null when this was the last one"
    )


# no coroutine on purpose: a database is waited for in a thread, never in the event loop


@router.get("/audit", responses=responses())
def list_audit(
    request: Request,
    caller_asks: TheCaller,
    telescope: Annotated[str | None, Query(max_length=100)] = None,
    caller: Annotated[
        str | None, Query(max_length=100, description="Only orders given by the key of this name")
    ] = None,
    since: Annotated[
        Instant | None, Query(description="Only from this time on; UTC unless it tells a zone")
    ] = None,
    until: Annotated[
        Instant | None, Query(description="Only before this time; UTC unless it tells a zone")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=1000, description="Rows on a page")] = 100,
    cursor: Annotated[
        str | None, Query(pattern=r"^[0-9]{1,18}$", description="`next_cursor` of the page before")
    ] = None,
) -> AuditPageView:
    """Who ordered what, newest first; a key for some telescopes is shown those."""
    if telescope is not None:
        require_telescope(caller_asks, telescope)
    reader: JournalReader = request.app.state.service.journal.reader
    wanted = Wanted(telescope=telescope, since=since, until=until)
    rows = reader.audits(
        telescope=wanted.telescope,
        telescopes=caller_asks.telescopes,
        caller=caller,
        since=wanted.since,
        until=wanted.until,
        before_row=None if cursor is None else int(cursor),
        limit=limit + 1,
    )
    shown = rows[:limit]
    return AuditPageView(
        rows=[audit_view(row) for row in shown],
        next_cursor=str(shown[-1].row_id) if len(rows) > limit else None,
    )


def audit_view(row: AuditRow) -> AuditView:
    """View of a row."""
    return AuditView(
        row=row.row_id,
        utc=row.utc,
        telescope=row.telescope,
        caller=row.caller,
        role=row.role,
        face=row.face,
        address=row.address,
        what=row.what,
        request=dict(row.request),
        outcome=row.outcome,
        detail=row.detail,
        status=row.status,
        job_id=row.job_id,
    )


__all__ = ["AuditPageView", "AuditView", "audit_view", "router"]
