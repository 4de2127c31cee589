"""Filters as conditions of the database."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Select, Table, false, func, or_, select
from sqlalchemy.sql.elements import ColumnElement

from mountnav.journal.column_types import plain_text
from mountnav.journal.records import EntryKind
from mountnav.journal.tables import command, entry, look
from mountnav.journal.wanted import COMMAND, LOOK, Wanted

_WORDS = {
    "look": ("reason", "detail", "camera", "source", "mode", "catalog", "used", "why", "look_id"),
    "command": ("order", "end_detail", "outcome", "why", "command_id"),
    "entry": ("what", "kind", "why"),
}


def tables_of(wanted: Wanted) -> tuple[Table, ...]:
    """Tables that may hold a line that passes."""
    kinds = wanted.kinds
    found = []
    if not kinds or kinds & {str(kind) for kind in EntryKind}:
        found.append(entry)
    if not kinds or COMMAND in kinds:
        found.append(command)
    if not kinds or LOOK in kinds:
        found.append(look)
    if wanted.outcome is not None:
        found = [look if wanted.outcome in ("solved", "unsolved") else command]
        if kinds and found[0].name not in kinds:
            return ()
    return tuple(found)


def chosen(table: Table, wanted: Wanted) -> Select[Any]:
    """All columns of the rows that pass, in no order."""
    columns = table.c
    query = select(table)
    for column, value in (
        (columns.telescope, wanted.telescope),
        (columns.cause_job_id, wanted.job_id),
        (columns.cause_night_id, wanted.night_id),
        (columns.run_id, wanted.run_id),
    ):
        if value is not None:
            query = query.where(column == value)
    if wanted.since is not None:
        query = query.where(columns.utc >= wanted.since)
    if wanted.until is not None:
        query = query.where(columns.utc < wanted.until)
    if wanted.segment_id is not None:
        query = query.where(false() if table is entry else columns.segment_id == wanted.segment_id)
    if table is entry and wanted.kinds:
        query = query.where(columns.kind.in_(sorted(wanted.kinds)))
    if wanted.outcome is not None:
        query = query.where(_outcome(table, wanted.outcome))
    if wanted.text:
        words = plain_text(wanted.text).lower()
        query = query.where(
            or_(*(func.lower(columns[name]).contains(words, autoescape=True) for name in _WORDS[table.name]))
        )
    return query


def _outcome(table: Table, outcome: str) -> ColumnElement[bool]:
    if table is look:
        return look.c.solved.is_(outcome == "solved")
    if table is command:
        return command.c.outcome.is_(None) if outcome == "open" else command.c.outcome == outcome
    return false()
