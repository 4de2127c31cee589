"""Audit and leases in the journal: who ordered what, and who holds which telescope.

Audit: a row for each order from each face, whether it was accepted or refused. Leases: one row for each
telescope that is held, deleted when it no longer is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Select, desc, select
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.sql.dml import Insert

from mountnav.journal.tables import audit, lease


@dataclass(frozen=True, slots=True)
class AuditRow:
    """One order, or attempt at one.

    Attributes
    ----------
    telescope : str
        Empty for what concerns the whole service.
    caller, role, face, address : str
        Who, and by which way; a name in parentheses is of somebody who could not say who he was.
    what : str
        The order's kind, such as ``slew``; or the route, such as ``POST /v1/telescopes/{id}/night/start``.
    request : mapping
        What was asked for, without secrets.
    outcome : str
        ``taken``, ``answered`` (what is no order), or the slug of the problem it was refused for.
    detail : str
        Why it was refused, in words.
    status : int or None
        The HTTP status, if it came that way.
    job_id : str or None
        The job it became.
    row_id : int
        Its number in the journal; 0 before it is written.
    """

    utc: datetime
    telescope: str
    caller: str
    role: str
    face: str
    address: str
    what: str
    request: Mapping[str, object]
    outcome: str
    detail: str = ""
    status: int | None = None
    job_id: str | None = None
    row_id: int = 0


def audit_values(row: AuditRow, run_id: str) -> dict[str, Any]:
    """A row of `tables.audit`."""
    return {
        "run_id": run_id,
        "utc": row.utc,
        "telescope": row.telescope,
        "caller": row.caller,
        "role": row.role,
        "face": row.face,
        "address": row.address,
        "what": row.what,
        "request": dict(row.request),
        "outcome": row.outcome,
        "detail": row.detail,
        "status": row.status,
        "job_id": row.job_id,
    }


def audit_of(row: Mapping[str, Any]) -> AuditRow:
    """The audit of a row of `tables.audit`."""
    return AuditRow(**{name: row[name] for name in AuditRow.__dataclass_fields__})


def audit_query(
    *,
    telescope: str | None,
    caller: str | None,
    since: datetime | None,
    until: datetime | None,
    before_row: int | None,
    limit: int,
    telescopes: frozenset[str] | None = None,
) -> Select[Any]:
    """Rows that pass, the newest first; with `before_row`, those that were written before it."""
    query = select(audit).order_by(desc(audit.c.row_id)).limit(limit)
    if telescope is not None:
        query = query.where(audit.c.telescope == telescope)
    if telescopes is not None:
        query = query.where(audit.c.telescope.in_(sorted(telescopes)))
    if caller is not None:
        query = query.where(audit.c.caller == caller)
    if since is not None:
        query = query.where(audit.c.utc >= since)
    if until is not None:
        query = query.where(audit.c.utc < until)
    if before_row is not None:
        query = query.where(audit.c.row_id < before_row)
    return query


@dataclass(frozen=True, slots=True)
class LeaseRow:
    """A lease in force.

    Attributes
    ----------
    holder : str
        The caller's name.
    role, face, address : str
        Of the caller who took it.
    secret_sha256 : str
        Of what the holder sends to show that it is the holder.
    note : str
        The holder's words.
    ttl_s : float
        How long it lasts without a heartbeat.
    on_expiry : str
        What is done then: ``stop``, ``park`` or ``keep-tracking``.
    """

    telescope: str
    holder: str
    role: str
    face: str
    address: str
    secret_sha256: str
    note: str
    ttl_s: float
    on_expiry: str
    taken_utc: datetime
    deadline_utc: datetime


_COLUMNS = tuple(LeaseRow.__dataclass_fields__)


def lease_statement(connection: Connection, row: LeaseRow, run_id: str) -> Insert:
    """A statement that writes a lease, over the telescope's last."""
    values: dict[str, Any] = {name: getattr(row, name) for name in _COLUMNS} | {"run_id": run_id}
    changing = {name: value for name, value in values.items() if name != "telescope"}
    if connection.dialect.name == "postgresql":
        made = postgresql.insert(lease).values(values)
        return made.on_conflict_do_update(index_elements=[lease.c.telescope], set_=changing)
    return (
        sqlite.insert(lease)
        .values(values)
        .on_conflict_do_update(index_elements=[lease.c.telescope], set_=changing)
    )


def lease_of(row: Mapping[str, Any]) -> LeaseRow:
    """The lease of a row of `tables.lease`."""
    return LeaseRow(**{name: row[name] for name in _COLUMNS})
