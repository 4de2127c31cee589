"""`mountnav key`: API keys for programs and people: made, listed, revoked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api.access.callers import Role
from api.cli.options import Json

key_app = typer.Typer(help="API keys: who may view, operate or configure.", no_args_is_help=True)

KeyConfig = Annotated[
    Path | None,
    typer.Option("--config", "-c", help="Settings file of the service: its keys are meant."),
]
KeyFile = Annotated[
    Path | None, typer.Option("--file", help="The file of keys itself, instead of that of --config.")
]
Name = Annotated[str, typer.Argument(help="Who uses it, such as a scheduler or a person.")]


@key_app.command()
def new(
    name: Name,
    role: Annotated[
        Role,
        typer.Option(
            help="view: read everything. operate: also give orders. configure: also overrule the guards."
        ),
    ],
    config: KeyConfig = None,
    file: KeyFile = None,
) -> None:
    """Make a key and print it, this once. A running service takes it from now on."""
    from api.cli.keys import show_new

    show_new(name, role, config, file)


@key_app.command("list")
def list_(config: KeyConfig = None, file: KeyFile = None, as_json: Json = False) -> None:
    """List keys: names, roles, and the last characters of each."""
    from api.cli.keys import show_list

    show_list(config, file, as_json=as_json)


@key_app.command()
def revoke(name: Name, config: KeyConfig = None, file: KeyFile = None) -> None:
    """Revoke a key. A running service refuses it from the next request on."""
    from api.cli.keys import show_revoke

    show_revoke(name, config, file)
