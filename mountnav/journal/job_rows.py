"""Jobs as the journal keeps them: how each stands, and the client's key that started it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from sqlalchemy import Connection
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.sql.dml import Insert

from mountnav.journal.tables import job


@dataclass(frozen=True, slots=True)
class JobRow:
    """A job as it stands.

    Attributes
    ----------
    request : mapping
        As the client sent it.
    result, problem : mapping or None
        As the API shows them.
    started_utc, finished_utc : datetime or None
        None: not yet.
    key : str or None
        The client's Idempotency-Key.
    request_sha256 : str
        Of kind, telescope and request: the same key with another request is refused.
    """

    job_id: str
    telescope: str
    kind: str
    state: str
    phase: str
    request: Mapping[str, object]
    created_utc: datetime
    request_sha256: str
    attempts: tuple[Mapping[str, object], ...] = ()
    result: Mapping[str, object] | None = None
    problem: Mapping[str, object] | None = None
    started_utc: datetime | None = None
    finished_utc: datetime | None = None
    key: str | None = field(default=None)


def save_statement(connection: Connection, row: JobRow, run_id: str) -> Insert:
    """A statement that writes a job, over what was written of it before."""
    values: dict[str, Any] = {
        "job_id": row.job_id,
        "run_id": run_id,
        "telescope": row.telescope,
        "kind": row.kind,
        "request": dict(row.request),
        "state": row.state,
        "phase": row.phase,
        "attempts": list(row.attempts),
        "result": row.result,
        "problem": row.problem,
        "created_utc": row.created_utc,
        "started_utc": row.started_utc,
        "finished_utc": row.finished_utc,
        "idempotency_key": row.key,
        "request_sha256": row.request_sha256,
    }
    changing = {name: value for name, value in values.items() if name != "job_id"}
    if connection.dialect.name == "postgresql":
        made = postgresql.insert(job).values(values)
        return made.on_conflict_do_update(index_elements=[job.c.job_id], set_=changing)
    return (
        sqlite.insert(job).values(values).on_conflict_do_update(index_elements=[job.c.job_id], set_=changing)
    )


def job_of(row: Mapping[str, Any]) -> JobRow:
    """The job of a row of `tables.job`."""
    return JobRow(
        job_id=row["job_id"],
        telescope=row["telescope"],
        kind=row["kind"],
        state=row["state"],
        phase=row["phase"],
        request=row["request"],
        created_utc=row["created_utc"],
        request_sha256=row["request_sha256"],
        attempts=tuple(row["attempts"]),
        result=row["result"],
        problem=row["problem"],
        started_utc=row["started_utc"],
        finished_utc=row["finished_utc"],
        key=row["idempotency_key"],
    )
