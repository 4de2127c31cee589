"""Leases as the journal keeps them: one row for each telescope that is held, until it isn't."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.sql.dml import Insert

from mountnav.journal.tables import lease


@dataclass(frozen=True, slots=True)
class LeaseRow:
    """A lease in force.

    Attributes
    ----------
    telescope : str
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
    taken_utc, deadline_utc : datetime
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
