"""The commands of `mountnav`. What a command needs is imported when it runs, so that help comes at once."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated, Any, Final, NamedTuple

import typer


class Command(NamedTuple):
    """Where a command or a group of commands is declared: a file of `api.cli`, and its name there."""

    file: str
    name: str
    hidden: bool = False


COMMANDS: Final = {
    "status": Command("operate", "status"),
    "stop": Command("operate", "stop"),
    "center": Command("operate", "center"),
    "slew": Command("operate", "slew"),
    "follow": Command("operate", "follow"),
    "look": Command("operate", "look"),
    "sync": Command("operate", "sync"),
    "track": Command("operate", "track"),
    "park": Command("operate", "park"),
    "unpark": Command("operate", "unpark"),
    "watch": Command("operate", "watch"),
    "solve": Command("solve", "solve"),
    "series": Command("series", "series"),
    "accuracy": Command("accuracy", "accuracy"),
    "fake-mount": Command("fake_mount", "fake_mount"),
    "wire": Command("wire", "wire"),
    "bench": Command("bench", "bench"),
    "ports": Command("ports", "ports"),
    "first-light": Command("first_light", "first_light"),
    "site-time": Command("site_time", "site_time"),
    "replay": Command("replay", "replay"),
    "report": Command("report", "report"),
    "drift": Command("drift", "drift"),
    "pointing-doctor": Command("pointing_doctor", "pointing_doctor"),
    "init": Command("init", "init"),
    "check": Command("check", "check"),
    "serve": Command("serve", "serve"),
    "reload": Command("operate", "reload"),
    "site": Command("site", "site"),
    "indi-driver": Command("indi_driver", "indi_driver"),
    "demo": Command("demo", "demo"),
    "docs": Command("docs", "docs"),
}
"""Commands, in the order in which help lists them."""

GROUPS: Final = {
    "archive": Command("archive", "archive_app"),
    "calibrate": Command("calibrate", "calibrate_app"),
    "catalog": Command("catalog", "catalog_app"),
    "ephemeris": Command("ephemeris", "ephemeris_app"),
    "journal": Command("journal", "journal_app"),
    "model": Command("model", "model_app"),
    "night": Command("night", "night_app"),
    "key": Command("keys", "key_app"),
    # the same, for who writes the plural
    "keys": Command("keys", "key_app", hidden=True),
    "solver": Command("solver", "solver_app"),
}
"""Groups of commands; help lists them after the commands."""


def app_of(words: Sequence[str]) -> typer.Typer:
    """The command line with the command that is called; with all of them where it isn't known yet.

    Each file of a command takes time to import, and its options to set up: one command pays for its own.

    Parameters
    ----------
    words : sequence of str
        What was typed after `mountnav`.
    """
    wanted = words[0] if words and words[0] in COMMANDS | GROUPS else None
    app = typer.Typer(
        name="mountnav",
        help="Finds out where a telescope really points, and puts it where it should.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
    )
    app.callback(invoke_without_command=True)(top)
    for name, command in COMMANDS.items():
        if wanted in (None, name):
            app.command(name, hidden=command.hidden)(_declared(command))
    for name, group in GROUPS.items():
        if wanted in (None, name):
            app.add_typer(_declared(group), name=name, hidden=group.hidden)
    return app


def _declared(command: Command) -> Any:
    return getattr(import_module(f"api.cli.{command.file}"), command.name)


def top(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """Finds out where a telescope really points, and puts it where it should."""
    # `api.main` had it off: nothing imported for the command line is garbage, nor need be looked at again
    gc.freeze()
    gc.enable()
    if version:
        from mountnav import __version__

        typer.echo(f"mountnav {__version__}")
        raise typer.Exit
