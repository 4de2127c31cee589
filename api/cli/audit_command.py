"""`mountnav journal audit`: who ordered what, for people at a terminal and for programs that read lines."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

from api.cli.journal_command import reader_of, wanted_of
from mountnav.journal.audit_and_leases import AuditRow


def show_audit(
    journal: str | None,
    config: Path | None,
    telescope: str | None,
    caller: str | None,
    since: str | None,
    until: str | None,
    limit: int,
    as_json: bool,
) -> None:
    """Print the newest rows, the newest last.

    Raises
    ------
    Unknown, BadSettings, JournalFailed
        There is no journal, or it can't be read.
    BadRequest
        A time that is none.
    """
    wanted = wanted_of(telescope, None, since, until, None, None, None, None)
    rows = reader_of(journal, config).audits(
        telescope=wanted.telescope, caller=caller, since=wanted.since, until=wanted.until, limit=limit
    )
    for row in reversed(rows):
        sys.stdout.write(_json(row) if as_json else _words(row))


def _json(row: AuditRow) -> str:
    return json.dumps({**asdict(row), "utc": row.utc.isoformat()}, allow_nan=False) + "\n"


def _words(row: AuditRow) -> str:
    who = f"{row.caller} ({row.face or 'http'} {row.address})".replace(" )", ")")
    became = row.outcome + (f": {row.detail}" if row.detail else "")
    job = f", job {row.job_id}" if row.job_id else ""
    told = f"{row.utc:%Y-%m-%d %H:%M:%S}  {(row.telescope or '-').ljust(8)}  {who}: {row.what}: {became}{job}"
    # paths and names come from strangers, and this goes to a terminal
    return "".join(one if one.isprintable() else "\ufffd" for one in told) + "\n"
