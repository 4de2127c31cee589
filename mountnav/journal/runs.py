"""Each start of the service: version, machine, configuration; and what of it is new since the last time."""

from __future__ import annotations

import difflib
import hashlib
import json
from datetime import datetime

from sqlalchemy import URL, Connection, desc, insert, select, update

from mountnav.journal.database import FAULTS, connectable, without_password
from mountnav.journal.records import Cause, Entry, EntryKind
from mountnav.journal.rows import entry_row
from mountnav.journal.tables import entry, run
from mountnav.journal.upgrading import is_begun, unusable
from mountnav.journal.writer import Statements

# Lines of changed settings that an entry lists; the rest is noted as "more". Chosen by hand to keep entries
# readable.
_SHOWN = 200

# Runs of the same host among which the last one of this service is sought: several may write one journal.
# Doubled, twice as many of them may be started meanwhile.
_LOOKED_BACK = 50


def begin_run(run_id: str, host: str, pid: int, version: str, settings: str, utc: datetime) -> Statements:
    """Statements that write a start down; the configuration's changes with it, if there are any."""
    text = without_password(settings)
    digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()

    def write(connection: Connection) -> None:
        older = select(run).where(run.c.host == host).order_by(desc(run.c.started_utc)).limit(_LOOKED_BACK)
        before = next((row for row in connection.execute(older) if _of_one_service(row.settings, text)), None)
        connection.execute(
            insert(run).values(
                run_id=run_id,
                started_utc=utc,
                version=version,
                host=host,
                pid=pid,
                settings_sha256=digest,
                settings=text,
            )
        )
        facts: dict[str, object] = {"version": version, "host": host, "pid": pid}
        what = f"mountnav {version} started"
        if before is not None:
            facts |= {"last_version": before.version, "last_started_utc": before.started_utc}
            facts["last_ended_utc"] = before.ended_utc
            if before.ended_utc is None:
                what += "; the last run was not ended, it was killed or is still there"
        _note(connection, run_id, Entry(utc, "", EntryKind.SERVICE, what, facts, Cause()))
        if text and (before is None or before.settings_sha256 != digest):
            lines = [] if before is None else _changes(before.settings, text)
            said = "the configuration is written down" if before is None else "the configuration has changed"
            told: dict[str, object] = {
                "sha256": digest,
                "changes": lines[:_SHOWN],
                "more": len(lines) > _SHOWN,
            }
            _note(connection, run_id, Entry(utc, "", EntryKind.SETTINGS, said, told, Cause()))

    return write


def settings_of_runs(url: URL) -> list[tuple[datetime, str]]:
    """When the service was started, and its settings then, of all starts; of a journal of any version.

    Raises
    ------
    BadSettings
        It was written by a newer mountnav, or the database is another program's.
    JournalFailed
        It can't be read.
    """
    engine = connectable(url, "read")
    try:
        with engine.connect() as connection, connection.begin():
            if not is_begun(connection, url):
                return []
            query = select(run.c.started_utc, run.c.settings).order_by(run.c.started_utc)
            return [(row.started_utc, row.settings) for row in connection.execute(query)]
    except FAULTS as error:
        raise unusable(error, url) from error
    finally:
        engine.dispose()


def end_run(run_id: str, utc: datetime) -> Statements:
    """Statements that write down that the service has ended as it should."""

    def write(connection: Connection) -> None:
        connection.execute(update(run).where(run.c.run_id == run_id).values(ended_utc=utc))
        _note(connection, run_id, Entry(utc, "", EntryKind.SERVICE, "mountnav ended", {}, Cause()))

    return write


def _of_one_service(settings: str, other: str) -> bool:
    """Whether two configurations share a telescope; those that name none may be of any service."""
    some, others = _telescopes(settings), _telescopes(other)
    return not some or not others or bool(some & others)


def _telescopes(settings: str) -> set[str]:
    try:
        told = json.loads(settings)
        return {str(one["id"]) for one in told["telescope"]}
    except (ValueError, KeyError, TypeError):
        return set()


def _note(connection: Connection, run_id: str, one: Entry) -> None:
    connection.execute(insert(entry).values(entry_row(one, run_id)))


def _changes(old: str, new: str) -> list[str]:
    """Lines that went (``-``) and came (``+``)."""
    lines = difflib.unified_diff(old.splitlines(), new.splitlines(), lineterm="", n=0)
    return [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]
