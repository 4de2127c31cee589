"""`mountnav journal`: the journal and the audit for people, and as JSON lines for programs."""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import Json, config_option
from api.cli.output import print_json, refusing_os_errors

if TYPE_CHECKING:
    from mountnav.journal.audit_and_leases import AuditRow
    from mountnav.journal.audit_chain import AuditHead, AuditKey, AuditProof
    from mountnav.journal.reading import JournalReader, Line, Wanted
    from mountnav.journal.upkeep import Checked

journal_app = typer.Typer(
    help="The journal: every look, command, refusal, fault and change.", no_args_is_help=True
)

Where = Annotated[
    str | None,
    typer.Option(
        "--journal", "-j", help="Its file or URL; else that of --config, MOUNTNAV_JOURNAL, or yours."
    ),
]
JournalConfig = Annotated[Path | None, config_option("Settings file: its journal table is used.")]
Telescope = Annotated[str | None, typer.Option("--telescope", "-t", help="Of this telescope alone.")]
Kinds = Annotated[
    list[str] | None,
    typer.Option("--kind", "-k", help="look, command, sync, refusal, fault, model, ...; may be repeated."),
]
Since = Annotated[
    str | None, typer.Option(help="From this time on: 2h, 3d (ago), 2026-11-22, 2026-11-22T03:00 (UTC).")
]
Until = Annotated[str | None, typer.Option(help="Before this time; as --since.")]
JobId = Annotated[str | None, typer.Option("--job", help="What was done for this job.")]
NightId = Annotated[str | None, typer.Option("--night", help="What was done for this night, by its id.")]
Outcome = Annotated[
    str | None,
    typer.Option(help="Of commands: done, refused, unknown, ..., open; of looks: solved, unsolved."),
]
Text = Annotated[str | None, typer.Option(help="Text that the entry contains.")]

_KIND_WIDTH = 9
"""Columns of the longest kind of a line, `centering`, so that the words begin below each other."""
MOST_MENTIONS = 100
"""Lines that mention an id, of which `show` takes those that are about it. chosen by hand: an id is unique,
so that few lines name it; where more do, the line that it is about could be cut off."""


@journal_app.command("list")
def list_(
    telescope: Telescope = None,
    kind: Kinds = None,
    since: Since = None,
    until: Until = None,
    job: JobId = None,
    night: NightId = None,
    outcome: Outcome = None,
    text: Text = None,
    limit: Annotated[int, typer.Option("--limit", "-n", min=0, help="The newest so many; 0 for all.")] = 50,
    journal: Where = None,
    config: JournalConfig = None,
    as_json: Json = False,
) -> None:
    """List what was written down, the newest last."""
    wanted = _wanted(telescope, kind, since, until, job, night, outcome, text)
    reader = _reader(journal, config)
    lines: Iterable[Line]
    lines = reader.lines(wanted, limit=limit, newest_first=True)[::-1] if limit else reader.story(wanted)
    for line in lines:
        _print(line, as_json)


@journal_app.command()
def show(
    identity: Annotated[
        str, typer.Argument(help="Of a look, a command or a job (all that was done for it).")
    ],
    journal: Where = None,
    config: JournalConfig = None,
    as_json: Json = False,
) -> None:
    """Show all that is known of one look, command or job."""
    from mountnav.errors import NotFound
    from mountnav.journal.reading import Wanted
    from mountnav.journal.wording import as_json as columns_of

    reader = _reader(journal, config)
    found = [
        line
        for line in reader.lines(Wanted(text=identity), limit=MOST_MENTIONS)
        if identity in (getattr(line.record, "look_id", None), getattr(line.record, "command_id", None))
    ]
    job = reader.job(identity)
    lines: list[Line] = found or list(reader.story(Wanted(job_id=identity)))
    if not lines and job is None:
        raise NotFound(
            f"there is no look, command or job {identity!r} in the journal",
            advice="`mountnav journal list --json` shows their ids",
        )
    if as_json:
        for line in lines:
            _print(line, as_json=True)
        return
    if job is not None and not found:
        sys.stdout.write(f"job {job.job_id}: {job.kind} of {job.telescope}, {job.state}\n")
        for line in lines:
            _print(line, as_json=False)
        return
    for line in lines:
        columns = columns_of(line)
        width = max(len(name) for name in columns)
        for name, value in columns.items():
            cell = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            sys.stdout.write(f"{name.ljust(width)}  {cell}\n")


@journal_app.command()
def export(
    path: Annotated[Path, typer.Argument(help="What to write: a .csv, .parquet or .fits file.")],
    what: Annotated[str, typer.Option(help="looks, commands or entries.")] = "looks",
    telescope: Telescope = None,
    kind: Annotated[
        list[str] | None, typer.Option("--kind", "-k", help="Of entries; may be repeated.")
    ] = None,
    since: Since = None,
    until: Until = None,
    job: JobId = None,
    night: NightId = None,
    outcome: Outcome = None,
    text: Text = None,
    journal: Where = None,
    config: JournalConfig = None,
) -> None:
    """Export looks, commands or entries as a table, every column with its unit."""
    from mountnav.journal.exporting import export as write_table

    wanted = _wanted(telescope, kind, since, until, job, night, outcome, text)
    with refusing_os_errors(f"{path} can't be written", advice="name a place that can"):
        count = write_table(_reader(journal, config), what, path, wanted)
    sys.stdout.write(f"{count} {what} written to {path}\n")


@journal_app.command()
def follow(
    telescope: Telescope = None,
    kind: Kinds = None,
    outcome: Outcome = None,
    text: Text = None,
    every: Annotated[float, typer.Option(min=0.1, max=60, help="Seconds between two looks into it.")] = 1.0,
    journal: Where = None,
    config: JournalConfig = None,
    as_json: Json = False,
) -> None:
    """Print what is written from now on, until interrupted. Commands are printed when they begin."""
    wanted = _wanted(telescope, kind, outcome=outcome, text=text)
    reader = _reader(journal, config)
    newest = reader.newest()
    while True:
        lines, newest = reader.written_after(newest, wanted)
        for line in lines:
            _print(line, as_json)
        sys.stdout.flush()
        time.sleep(every)


@journal_app.command()
def audit(
    telescope: Telescope = None,
    caller: Annotated[str | None, typer.Option("--caller", help="The name of a key.")] = None,
    since: Since = None,
    until: Until = None,
    limit: Annotated[int, typer.Option("--limit", "-n", min=1, help="The newest so many.")] = 50,
    journal: Where = None,
    config: JournalConfig = None,
    as_json: Json = False,
) -> None:
    """List who ordered what, by which face, and what became of it; the newest last."""
    wanted = _wanted(telescope, since=since, until=until)
    rows = _reader(journal, config).audits(
        telescope=wanted.telescope, caller=caller, since=wanted.since, until=wanted.until, limit=limit
    )
    for row in reversed(rows):
        if as_json:
            print_json({**asdict(row), "utc": row.utc.isoformat()})
        else:
            sys.stdout.write(_audit_line(row))


@journal_app.command("verify-audit")
def verify_audit(
    key: Annotated[
        list[Path] | None,
        typer.Option(
            "--key", help="A file with the key that sealed it; may be repeated. Else the one of the settings."
        ),
    ] = None,
    expect: Annotated[
        list[str] | None,
        typer.Option(
            help="An earlier position, NUMBER:HASH, as the log and reports show it; may be repeated."
        ),
    ] = None,
    journal: Where = None,
    config: JournalConfig = None,
    as_json: Json = False,
) -> None:
    """Prove that nobody has rewritten the audit; exit code 1 names the first row that was touched.

    Rows that no available key proves (written without one, or by another machine) are listed; with a key, the
    exit code is 1 for them, too.
    """
    from mountnav.journal.audit_chain import prove
    from mountnav.journal.database import database_url

    keys = _audit_keys(key, journal, config)
    proof = prove(database_url(_where(journal, config)), keys, [_head_of(one) for one in expect or ()])
    if as_json:
        print_json(_proof_record(proof, keys))
    else:
        sys.stdout.write("".join(f"{line}\n" for line in _proof_lines(proof, keys)))
    raise typer.Exit(1 if proof.fault is not None or (keys and proof.unproven) else 0)


@journal_app.command()
def check(
    upgrade: Annotated[
        bool, typer.Option("--upgrade", help="Bring a journal of an older version up to date first.")
    ] = False,
    journal: Where = None,
    config: JournalConfig = None,
    as_json: Json = False,
) -> None:
    """Check it: is it sound, what does it hold, which commands are open; exit code 1 if it is damaged."""
    from mountnav.journal.upgrading import upgrade as bring_up_to_date
    from mountnav.journal.upkeep import check as check_journal

    reader = _reader(journal, config)
    if upgrade and _exists(reader):
        bring_up_to_date(reader.url)
    found = check_journal(reader.url)
    if as_json:
        print_json(_check_record(found))
    else:
        _print_check(found)
    raise typer.Exit(1 if found.damage else 0)


@journal_app.command()
def backup(
    target: Annotated[Path, typer.Argument(help="The file to write, or a folder.")],
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    journal: Where = None,
    config: JournalConfig = None,
) -> None:
    """Copy it whole into a file, also while the service runs. The copy is a journal of its own."""
    from mountnav.clock import utc_now
    from mountnav.journal.backup import back_up

    written = back_up(_where(journal, config), target, utc_now(), force=force)
    typer.echo(f"{written}: {written.stat().st_size / 1e6:.1f} MB, sound")


@journal_app.command()
def restore(
    file: Annotated[Path, typer.Argument(help="What `mountnav journal backup` has written.")],
    journal: Where = None,
    config: JournalConfig = None,
) -> None:
    """Put a backup in its place, while no service runs. The present one is kept beside it."""
    from mountnav.clock import utc_now
    from mountnav.journal.backup import restore as put_back

    where = _where(journal, config)
    kept = put_back(file, where, utc_now())
    typer.echo(f"{where} is that of {file} now")
    if kept is not None:
        typer.echo(f"what was there is kept as {kept}")
    typer.echo(
        "mounts that stand elsewhere than it says won't be trusted until a look shows where they point"
    )


def _wanted(
    telescope: str | None,
    kinds: list[str] | None = None,
    since: str | None = None,
    until: str | None = None,
    job: str | None = None,
    night: str | None = None,
    outcome: str | None = None,
    text: str | None = None,
) -> Wanted:
    """The filter of the options. Raises `BadRequest` for a time, kind or outcome that is none."""
    from mountnav.clock import utc_now
    from mountnav.journal.reading import Wanted, instant

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


def _reader(journal: str | None, config: Path | None) -> JournalReader:
    """A reader of the journal that is meant."""
    from mountnav.journal.reading import JournalReader

    return JournalReader(_where(journal, config))


def _where(journal: str | None, config: Path | None) -> str:
    """The journal that --journal names, else the settings file, else the environment, else the user's own."""
    from mountnav.journal.database import default_url

    if journal is not None:
        return journal
    if config is None:
        return default_url()
    # importing the models of the settings file takes long: most commands need none
    from mountnav.settings.observatory import Settings

    return Settings.load(config).journal.where


def _audit_keys(files: list[Path] | None, journal: str | None, config: Path | None) -> list[AuditKey]:
    """Keys of the files that are named, else the one that the service uses, if it can be read."""
    from mountnav.errors import BadSettings, NotFound
    from mountnav.journal.audit_chain import read_audit_key
    from mountnav.journal.database import audit_key_beside

    if files:
        keys = []
        for file in files:
            try:
                keys.append(read_audit_key(file))
            except FileNotFoundError as missing:
                raise NotFound("there is no such key", device=str(file), advice="check the name") from missing
        return keys
    path = audit_key_beside(_where(journal, config))
    if config is not None and journal is None:
        from mountnav.settings.observatory import Settings

        path = Settings.load(config).journal.audit_key_path
    try:
        return [read_audit_key(path)]
    except FileNotFoundError:
        return []
    except BadSettings as unreadable:
        sys.stderr.write(f"seals are not checked: {unreadable}\n")
        return []


def _head_of(text: str) -> AuditHead:
    from mountnav.errors import BadRequest
    from mountnav.journal.audit_chain import AuditHead

    number, _, sha256 = text.strip().partition(":")
    if (
        not number.isascii()
        or not number.isdigit()
        or len(number) > 18
        or not re.fullmatch("[0-9a-f]{64}", sha256)
    ):
        raise BadRequest(
            f"{text!r} is not a position in the chain", advice="NUMBER:HASH, as the log shows it"
        )
    return AuditHead(int(number), sha256)


def _proof_lines(proof: AuditProof, keys: list[AuditKey]) -> list[str]:
    lines = []
    if proof.fault is not None:
        at = proof.fault
        row = "at its end" if at.row_id is None else f"row {at.row_id}"
        number = "" if at.chain_no is None else f" (number {at.chain_no})"
        lines.append(f"BROKEN: {row}{number}: {at.what}")
    removed = f", {proof.removed} more removed by retention" if proof.removed else ""
    lines.append(f"{proof.rows} rows looked at{removed}; the seals of {proof.sealed} hold")
    if not keys:
        lines.append(
            "no key is available: seals were not checked, so the whole chain could have been rewritten"
        )
    elif proof.unproven:
        lines.append(f"NOT PROVEN by the available key: {'; '.join(proof.unproven)}")
    if proof.fault is None:
        lines.append(
            "nothing was altered, removed, inserted or reordered" if proof.head else "there is no row yet"
        )
        if proof.head is not None:
            lines.append(f"it is now at {proof.head}")
    return lines


def _proof_record(proof: AuditProof, keys: list[AuditKey]) -> dict[str, object]:
    return {
        "sound": proof.fault is None,
        "proven": proof.fault is None and bool(keys) and not proof.unproven,
        "fault": None if proof.fault is None else asdict(proof.fault),
        "rows": proof.rows,
        "removed": proof.removed,
        "sealed": proof.sealed,
        "unproven": list(proof.unproven),
        "head": None if proof.head is None else str(proof.head),
    }


def _exists(reader: JournalReader) -> bool:
    """Whether there is a file to upgrade: an upgrade would make one."""
    from mountnav.journal.database import database_url

    url = database_url(reader.url.render_as_string(hide_password=False))
    return url.get_backend_name() != "sqlite" or Path(str(url.database)).exists()


def _print(line: Line, as_json: bool) -> None:
    from mountnav.journal.wording import as_json as columns_of
    from mountnav.journal.wording import in_words

    if as_json:
        print_json(columns_of(line))
        return
    telescope = line.record.telescope or "-"
    words = " ".join(in_words(line).split())
    sys.stdout.write(
        f"{line.utc:%Y-%m-%d %H:%M:%S}  {telescope.ljust(8)}  {line.kind.ljust(_KIND_WIDTH)}  {words}\n"
    )


def _print_check(found: Checked) -> None:
    from mountnav.journal.restart import named

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
                "command_id": command.command_id,
                "telescope": command.telescope,
                "utc": command.utc.isoformat(),
                "order": command.order,
            }
            for command in found.open_commands
        ],
    }


def _audit_line(row: AuditRow) -> str:
    who = f"{row.caller} ({row.face or 'http'} {row.address})".replace(" )", ")")
    became = row.outcome + (f": {row.detail}" if row.detail else "")
    job = f", job {row.job_id}" if row.job_id else ""
    line = f"{row.utc:%Y-%m-%d %H:%M:%S}  {(row.telescope or '-').ljust(8)}  {who}: {row.what}: {became}{job}"
    # paths and names come from strangers, and this goes to a terminal
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in line) + "\n"
