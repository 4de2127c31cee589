"""`mountnav journal`: what was done and seen: listed, shown, exported, followed, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.cli.options import Json

journal_app = typer.Typer(
    help="The journal: every look, command, refusal, fault and change.", no_args_is_help=True
)

Where = Annotated[
    str | None,
    typer.Option(
        "--journal", "-j", help="Its file or URL; else that of --config, MOUNTNAV_JOURNAL, or yours."
    ),
]
JournalConfig = Annotated[
    Path | None, typer.Option("--config", "-c", help="Settings file: its journal table is used.")
]
Telescope = Annotated[str | None, typer.Option("--telescope", "-t", help="Of this telescope alone.")]
Kinds = Annotated[
    list[str] | None,
    typer.Option("--kind", "-k", help="look, command, sync, refusal, fault, model, ...; may be repeated."),
]
Since = Annotated[
    str | None, typer.Option(help="From then on: 2h, 3d (ago), 2026-11-22, 2026-11-22T03:00 (UTC).")
]
Until = Annotated[str | None, typer.Option(help="Before then; as --since.")]
JobId = Annotated[str | None, typer.Option("--job", help="What was done for this job.")]
NightId = Annotated[str | None, typer.Option("--night", help="What was done for this night, by its id.")]
Outcome = Annotated[
    str | None,
    typer.Option(help="Of commands: done, refused, unknown, ..., open; of looks: solved, unsolved."),
]
Text = Annotated[str | None, typer.Option(help="Somewhere in its words.")]


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
    from api.cli.journal import show_list, wanted_of

    wanted = wanted_of(telescope, kind, since, until, job, night, outcome, text)
    show_list(journal, config, wanted, limit, as_json)


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
    from api.cli.journal import show_one

    show_one(journal, config, identity, as_json)


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
    from api.cli.journal import wanted_of, write_export

    wanted = wanted_of(telescope, kind, since, until, job, night, outcome, text)
    write_export(journal, config, what, path, wanted)


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
    from api.cli.journal import run_follow, wanted_of

    wanted = wanted_of(telescope, kind, None, None, None, None, outcome, text)
    run_follow(journal, config, wanted, every, as_json)


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
    from api.cli.journal import show_audit

    show_audit(journal, config, telescope, caller, since, until, limit, as_json)


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
    from api.cli.journal import show_check

    raise typer.Exit(show_check(journal, config, upgrade, as_json))
