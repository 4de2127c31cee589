"""`mountnav journal`: the journal and the audit for people, and as JSON lines for programs."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from mountnav.clock import utc_now
from mountnav.errors import BadRequest, Unknown
from mountnav.journal.audit_and_leases import AuditRow
from mountnav.journal.database import database_url, default_url
from mountnav.journal.exporting import export
from mountnav.journal.reading import JournalReader, Line, Wanted, instant
from mountnav.journal.restart import named
from mountnav.journal.upgrading import upgrade as bring_up_to_date
from mountnav.journal.upkeep import Checked, check
from mountnav.journal.wording import as_json as json_of
from mountnav.journal.wording import in_words

_KIND_WIDTH = 9


def wanted_of(
    telescope: str | None,
    kinds: list[str] | None,
    since: str | None,
    until: str | None,
    job: str | None,
    night: str | None,
    outcome: str | None,
    text: str | None,
) -> Wanted:
    """Filters of options. Raises `BadRequest` for a time, kind or outcome that is none."""
    now = utc_now()
    return Wanted(
        telescope=telescope,
        kinds=frozenset(kinds or ()),
        since=None if since is None else instant(since, now),
        until=None if until is None else instant(until, now),
        job_id=job,
        night_id=night,
        outcome=outcome,
        text=text,
    )


def show_list(journal: str | None, config: Path | None, wanted: Wanted, limit: int, as_json: bool) -> None:
    """Print lines, oldest first: the newest `limit` of them, or all.

    Raises
    ------
    Unknown, BadSettings, JournalFailed
        There is no journal, or it can't be read.
    """
    reader = reader_of(journal, config)
    lines: Iterable[Line]
    lines = reader.lines(wanted, limit=limit, newest_first=True)[::-1] if limit else reader.story(wanted)
    for line in lines:
        _print(line, as_json)


def show_one(journal: str | None, config: Path | None, identity: str, as_json: bool) -> None:
    """Print all columns of a look or a command, or all lines of a job. Raises as `show_list`."""
    reader = reader_of(journal, config)
    found = [
        line
        for line in reader.lines(Wanted(text=identity), limit=100)
        if identity in (getattr(line.record, "look_id", None), getattr(line.record, "command_id", None))
    ]
    told = reader.job(identity)
    lines: list[Line] = found or list(reader.story(Wanted(job_id=identity)))
    if not lines and told is None:
        raise Unknown(
            f"there is no look, command or job {identity!r} in the journal",
            advice="`mountnav journal list --json` tells their ids",
        )
    if as_json:
        for line in lines:
            _print(line, as_json=True)
        return
    if told is not None and not found:
        sys.stdout.write(f"job {told.job_id}: {told.kind} of {told.telescope}, {told.state}\n")
        for line in lines:
            _print(line, as_json=False)
        return
    for line in lines:
        columns = json_of(line)
        width = max(len(name) for name in columns)
        for name, value in columns.items():
            shown = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            sys.stdout.write(f"{name.ljust(width)}  {shown}\n")


def write_export(journal: str | None, config: Path | None, what: str, path: Path, wanted: Wanted) -> None:
    """Write a table and tell its number of rows. Raises as `export`; `BadRequest` if it can't be written."""
    try:
        count = export(reader_of(journal, config), what, path, wanted)
    except OSError as error:
        raise BadRequest(
            f"{path} can't be written: {error.strerror or error}", advice="name a place that can"
        ) from error
    sys.stdout.write(f"{count} {what} written to {path}\n")


def run_follow(
    journal: str | None, config: Path | None, wanted: Wanted, every_s: float, as_json: bool
) -> None:
    """Print what is written from now on, until interrupted. Raises as `show_list`."""
    reader = reader_of(journal, config)
    newest = reader.newest()
    while True:
        lines, newest = reader.written_after(newest, wanted)
        for line in lines:
            _print(line, as_json)
        sys.stdout.flush()
        time.sleep(every_s)


def show_check(journal: str | None, config: Path | None, upgrade: bool, as_json: bool) -> int:
    """Print what a check found; 1 if the journal is damaged.

    Raises
    ------
    Unknown, BadSettings, JournalFailed
        There is none, or it can't be read at all.
    """
    reader = reader_of(journal, config)
    if upgrade and _exists(reader):
        bring_up_to_date(reader.url)
    found = check(reader.url)
    if as_json:
        sys.stdout.write(json.dumps(_check_record(found)) + "\n")
        return 1 if found.damage else 0
    size = "" if found.size_mb is None else f", {found.size_mb:.1f} MB"
    sys.stdout.write(f"{found.where}: version {found.version}{size}\n")
    for name, count in found.rows.items():
        sys.stdout.write(f"  {name.ljust(8)} {count:>10,} rows\n")
    if found.first_utc is not None and found.last_utc is not None:
        sys.stdout.write(
            f"  from {found.first_utc:%Y-%m-%d %H:%M:%S} to {found.last_utc:%Y-%m-%d %H:%M:%S} UTC\n"
        )
    for command in found.open_commands:
        sys.stdout.write(
            f"  open: {command.telescope}: {named(command)}, begun {command.utc:%Y-%m-%d %H:%M:%S} UTC\n"
        )
    if not found.open_commands:
        sys.stdout.write("  no command is open\n")
    for damage in found.damage:
        sys.stdout.write(f"  DAMAGED: {damage}\n")
    if not found.damage:
        sys.stdout.write("  sound\n")
    return 1 if found.damage else 0


def _check_record(found: Checked) -> dict[str, object]:
    return {
        "where": found.where,
        "version": found.version,
        "size_mb": found.size_mb,
        "rows": found.rows,
        "first_utc": found.first_utc.isoformat() if found.first_utc else None,
        "last_utc": found.last_utc.isoformat() if found.last_utc else None,
        "damage": list(found.damage),
        "open_commands": [
            {
                "command_id": one.command_id,
                "telescope": one.telescope,
                "utc": one.utc.isoformat(),
                "order": one.order,
            }
            for one in found.open_commands
        ],
    }


def _print(line: Line, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps(json_of(line), allow_nan=False) + "\n")
        return
    telescope = line.record.telescope or "-"
    words = " ".join(in_words(line).split())
    sys.stdout.write(
        f"{line.utc:%Y-%m-%d %H:%M:%S}  {telescope.ljust(8)}  {line.kind.ljust(_KIND_WIDTH)}  {words}\n"
    )


def reader_of(journal: str | None, config: Path | None) -> JournalReader:
    """The journal that --journal names, else the settings file, else the environment, else the user's own."""
    if journal is not None:
        return JournalReader(journal)
    if config is None:
        return JournalReader(default_url())
    # the models of the settings file are dear to import: most commands need none
    from mountnav.settings.observatory import Settings

    return JournalReader(Settings.load(config).journal.where)


def _exists(reader: JournalReader) -> bool:
    """Whether there is a file to upgrade: an upgrade would make one."""
    url = database_url(reader.url.render_as_string(hide_password=False))
    return url.get_backend_name() != "sqlite" or Path(str(url.database)).exists()


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
        sys.stdout.write(_audit_json(row) if as_json else _audit_words(row))


def _audit_json(row: AuditRow) -> str:
    return json.dumps({**asdict(row), "utc": row.utc.isoformat()}, allow_nan=False) + "\n"


def _audit_words(row: AuditRow) -> str:
    who = f"{row.caller} ({row.face or 'http'} {row.address})".replace(" )", ")")
    became = row.outcome + (f": {row.detail}" if row.detail else "")
    job = f", job {row.job_id}" if row.job_id else ""
    told = f"{row.utc:%Y-%m-%d %H:%M:%S}  {(row.telescope or '-').ljust(8)}  {who}: {row.what}: {became}{job}"
    # paths and names come from strangers, and this goes to a terminal
    return "".join(one if one.isprintable() else "\ufffd" for one in told) + "\n"
