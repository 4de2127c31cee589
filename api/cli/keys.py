"""`mountnav key`: API keys are made, listed, revoked; a running service follows at once."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.access.callers import Role
from api.cli.options import Json, config_option
from api.cli.output import print_json

if TYPE_CHECKING:
    from api.access.keys import KeyStore

key_app = typer.Typer(help="API keys: who may solve, view, operate or configure.", no_args_is_help=True)

KeyConfig = Annotated[Path | None, config_option("Settings file of the service: its keys are meant.")]
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
            help="solve: have images solved, nothing else. view: read everything. operate: both, and give "
            "orders. configure: also overrule the guards."
        ),
    ],
    config: KeyConfig = None,
    file: KeyFile = None,
) -> None:
    """Make a key and print it, this once. A running service takes it from now on."""
    store = _store(config, file)
    key, secret = store.new(name, role)
    # the key alone goes to the standard output, for scripts; all words to the other
    sys.stderr.write(
        f"{key.name} may {key.role} from now on, with this key. It is shown this once: only its "
        f"hash is kept, in {store.path}\n"
    )
    sys.stdout.write(f"{secret}\n")


@key_app.command("list")
def list_(config: KeyConfig = None, file: KeyFile = None, as_json: Json = False) -> None:
    """List keys: names, roles, and the last characters of each."""
    store = _store(config, file)
    keys = store.readable()
    if as_json:
        rows = [
            {
                "name": key.name,
                "role": str(key.role),
                "hint": key.hint,
                "created_utc": None if key.created_utc is None else key.created_utc.isoformat(),
            }
            for key in keys
        ]
        print_json(rows, indent=1)
        return
    if not keys:
        sys.stdout.write(f"there are no keys in {store.path}\n")
    width = max((len(key.name) for key in keys), default=0)
    for key in keys:
        created = "" if key.created_utc is None else f"made {key.created_utc:%Y-%m-%d %H:%M} UTC"
        sys.stdout.write(f"{key.name.ljust(width)}  {str(key.role).ljust(9)}  ...{key.hint}  {created}\n")


@key_app.command()
def revoke(name: Name, config: KeyConfig = None, file: KeyFile = None) -> None:
    """Revoke a key. A running service refuses it from the next request on."""
    store = _store(config, file)
    store.revoke(name)
    sys.stdout.write(f"the key of {name} is revoked; a running service refuses it from now on\n")
    if not store.keys:
        sys.stdout.write(
            "no key is left: nobody is let in any more but by the settings' token. To be without keys again, "
            f"on this machine alone, remove {store.path}\n"
        )


def _store(config: Path | None, file: Path | None) -> KeyStore:
    """The file that --file names, else that of the settings, else the one beside the user's journal."""
    from api.access.keys import KeyStore, keys_path
    from mountnav.journal.database import default_url

    if file is not None:
        return KeyStore(file)
    if config is None:
        return KeyStore(keys_path(None, default_url()))
    from mountnav.settings.observatory import Settings

    settings = Settings.load(config)
    return KeyStore(keys_path(settings.service.keys_file, settings.journal.where))
