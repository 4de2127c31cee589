"""The journal: what was seen, ordered, refused and changed, a page at a time."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request

from api.access.security import TheCaller, require_telescope
from api.http.journal_views import Instant, JournalPageView, RunView, page_view, run_view
from api.problems import responses
from api.service import TheTelescope
from mountnav.journal.reading import LOOK, JournalReader, Mark, Wanted
from mountnav.journal.sql_journal import SqlJournal

router = APIRouter(tags=["journal"])

Limit = Annotated[int, Query(ge=1, le=1000, description="Lines on a page")]
CursorText = Annotated[str | None, Query(max_length=200, description="`next_cursor` of the page before")]
From = Annotated[Instant | None, Query(description="Only from this time on; UTC unless it tells a zone")]
Before = Annotated[Instant | None, Query(description="Only before this time; UTC unless it tells a zone")]
Newest = Annotated[bool, Query(description="Whether the newest line comes first")]


async def _reader(request: Request) -> JournalReader:
    journal: SqlJournal = request.app.state.service.journal
    return journal.reader


TheReader = Annotated[JournalReader, Depends(_reader)]


# These are no coroutines on purpose: a database is waited for in threads, never in the event loop.


@router.get("/journal", responses=responses())
def list_journal(
    reader: TheReader,
    caller: TheCaller,
    telescope: Annotated[str | None, Query(max_length=100)] = None,
    kind: Annotated[
        list[str] | None,
        Query(
            description="Only lines of this kind: look, command, sync, refusal, fault, ...; may be repeated"
        ),
    ] = None,
    since: From = None,
    until: Before = None,
    job_id: Annotated[str | None, Query(max_length=100)] = None,
    night_id: Annotated[str | None, Query(max_length=100)] = None,
    outcome: Annotated[
        str | None,
        Query(
            description="Only lines that ended so. Commands: done, refused, unknown, ..., open; "
            "looks: solved, unsolved"
        ),
    ] = None,
    text: Annotated[str | None, Query(max_length=200, description="A text that the line must hold")] = None,
    newest_first: Newest = False,
    limit: Limit = 100,
    cursor: CursorText = None,
) -> JournalPageView:
    """Everything that was written down, as one story in the order of time.

    A key for some telescopes is shown the lines of those.
    """
    if telescope is not None:
        require_telescope(caller, telescope)
    wanted = Wanted(
        telescope=telescope,
        telescopes=caller.telescopes,
        kinds=frozenset(kind or ()),
        since=since,
        until=until,
        job_id=job_id,
        night_id=night_id,
        outcome=outcome,
        text=text,
    )
    return _page(reader, wanted, newest_first, limit, cursor)


@router.get("/telescopes/{telescope_id}/looks", responses=responses(404))
def list_looks(
    reader: TheReader,
    telescope: TheTelescope,
    since: From = None,
    until: Before = None,
    newest_first: Newest = True,
    limit: Limit = 100,
    cursor: CursorText = None,
) -> JournalPageView:
    """Looks of a telescope, solved or not, with absolute values: what models are made from."""
    wanted = Wanted(telescope=telescope.id, kinds=frozenset({LOOK}), since=since, until=until)
    return _page(reader, wanted, newest_first, limit, cursor)


@router.get("/journal/runs", responses=responses())
def list_runs(reader: TheReader, limit: Limit = 100) -> list[RunView]:
    """Starts of the service, newest first: version, machine, a fingerprint of the configuration."""
    return [run_view(run) for run in reader.runs(limit)]


def _page(
    reader: JournalReader, wanted: Wanted, newest_first: bool, limit: int, cursor: str | None
) -> JournalPageView:
    after = None if cursor is None else Mark.decoded(cursor)
    return page_view(reader.lines(wanted, after=after, limit=limit + 1, newest_first=newest_first), limit)
