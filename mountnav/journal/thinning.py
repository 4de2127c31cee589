"""Old looks and passing notes are removed, a little at a time; commands and what explains them stay.

Forever stay: commands with their outcomes, runs, and entries of models, settings, segments, syncs, refusals,
faults and the service. Removed, when they are older than asked or the file grows too big: looks, jobs
that are over, and entries of decisions, links, nights, jobs, centerings, what was learned, and notes. Audits
are removed when they are older than asked; a file that grows too big loses none but those of guide pulses,
so that nobody can push his own out of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta

from sqlalchemy import Column, Connection, Table, delete, func, select, text
from sqlalchemy.sql.elements import ColumnElement

from mountnav.journal.records import EntryKind
from mountnav.journal.tables import audit, entry, job, look
from mountnav.sky.coordinates import utc_now

PASSING = frozenset(
    {
        EntryKind.DECISION,
        EntryKind.LINK,
        EntryKind.NIGHT,
        EntryKind.JOB,
        EntryKind.CENTERING,
        EntryKind.LEARNED,
        EntryKind.NOTE,
    }
)
"""Kinds of entries that may be removed when they are old."""

_PULSE = "guide"
_AT_ONCE = 200
_EVERY_S = 6 * 3600.0
_NEWEST_KEPT = 100
"""So many of the newest entries stay in any case: what a restart takes up again."""


@dataclass(slots=True)
class Thinning:
    """What may go, and when it was looked at last.

    Attributes
    ----------
    keep_days : float
        0 for no bound.
    max_size_mb : float
        Of a file; 0 for no bound.
    """

    keep_days: float = 0.0
    max_size_mb: float = 0.0
    clock_s: Callable[[], float] = time.monotonic
    _next_s: float = 0.0

    @property
    def wanted(self) -> bool:
        """Whether anything is ever removed."""
        return self.keep_days > 0 or self.max_size_mb > 0

    def step(self, connection: Connection) -> bool:
        """Remove a little; return whether there is more to remove now."""
        if self.clock_s() < self._next_s:
            return False
        removed = 0
        if self.keep_days > 0:
            limit = utc_now() - timedelta(days=self.keep_days)
            removed += _remove(connection, look, look.c.row_id, look.c.utc < limit)
            removed += _remove(connection, entry, entry.c.row_id, entry.c.utc < limit, _passing(connection))
            over = job.c.finished_utc.is_not(None)
            removed += _remove(connection, job, job.c.job_id, job.c.created_utc < limit, over)
            removed += _remove(connection, audit, audit.c.row_id, audit.c.utc < limit)
        if removed == 0 and self.max_size_mb > 0 and _size_mb(connection) > self.max_size_mb:
            removed += _remove(connection, look, look.c.row_id)
            removed += _remove(connection, entry, entry.c.row_id, _passing(connection))
            removed += _remove(connection, audit, audit.c.row_id, audit.c.what == _PULSE)
        if removed == 0:
            self._next_s = self.clock_s() + _EVERY_S
        return removed > 0


def _passing(connection: Connection) -> ColumnElement[bool]:
    newest = connection.execute(select(func.max(entry.c.row_id))).scalar() or 0
    return entry.c.kind.in_([str(kind) for kind in PASSING]) & (entry.c.row_id < newest - _NEWEST_KEPT)


def _remove(
    connection: Connection, table: Table, key: Column[object], *conditions: ColumnElement[bool]
) -> int:
    """Remove the oldest rows that fulfill all conditions, a few at once."""
    oldest = select(key).where(*conditions).order_by(key).limit(_AT_ONCE)
    return connection.execute(delete(table).where(key.in_(oldest))).rowcount


def _size_mb(connection: Connection) -> float:
    """What the rows take in a file; 0 on a server, whose size is the site's business."""
    if connection.dialect.name != "sqlite":
        return 0.0
    pages, free, size = (
        connection.execute(text(f"PRAGMA {what}")).scalar_one()
        for what in ("page_count", "freelist_count", "page_size")
    )
    return float((pages - free) * size / 1e6)
