"""The journal as the API shows it, and instants in queries: ISO 8601, never a bare number."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, Field

from mountnav.journal.reading import Line, Run
from mountnav.journal.wording import as_json


def _as_text(value: object) -> object:
    if isinstance(value, str):
        try:
            float(value)
        except ValueError:
            return value
    elif value is None or isinstance(value, datetime):
        return value
    raise ValueError("no instant: write 2026-12-01T22:00:00Z")


Instant = Annotated[datetime, BeforeValidator(_as_text)]
"""Of a query parameter."""


class JournalLineView(BaseModel):
    """One thing that was written down."""

    utc: datetime
    telescope: str = Field(description="Empty for the service itself")
    kind: str = Field(description="look, command, or an entry's kind: sync, refusal, fault, model, ...")
    words: str = Field(description="What happened, in one sentence")
    facts: dict[str, Any] = Field(
        description="All else that is known, units in the names; what isn't known is left out"
    )


class JournalPageView(BaseModel):
    """A page of the journal."""

    lines: list[JournalLineView]
    next_cursor: str | None = Field(
        description="Hand it back as `cursor` for the next page; null when this was the last one"
    )


class RunView(BaseModel):
    """One start of the service."""

    run_id: str
    started_utc: datetime
    ended_utc: datetime | None = Field(description="null while it lasts, and if it was killed")
    version: str
    host: str
    pid: int
    settings_sha256: str


def line_view(line: Line) -> JournalLineView:
    """View of a line."""
    told = as_json(line)
    utc, telescope, kind, words = (told.pop(name) for name in ("utc", "telescope", "kind", "words"))
    return JournalLineView(utc=utc, telescope=telescope, kind=kind, words=words, facts=told)


def page_view(lines: list[Line], limit: int) -> JournalPageView:
    """View of a page that was asked for with room for one line more than `limit`."""
    shown = lines[:limit]
    more = len(lines) > limit
    return JournalPageView(
        lines=[line_view(line) for line in shown],
        next_cursor=shown[-1].mark.encoded() if more and shown else None,
    )


def run_view(run: Run) -> RunView:
    """View of a start."""
    return RunView(
        run_id=run.run_id,
        started_utc=run.started_utc,
        ended_utc=run.ended_utc,
        version=run.version,
        host=run.host,
        pid=run.pid,
        settings_sha256=run.settings_sha256,
    )
