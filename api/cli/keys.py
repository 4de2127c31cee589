"""`mountnav key`: API keys are made, listed, revoked; a running service follows at once."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from api.access.callers import Role
from api.access.keys import KeyStore, keys_path
from mountnav.journal.database import default_url


def show_new(name: str, role: Role, config: Path | None, file: Path | None) -> None:
    """Make a key. The key alone goes to the standard output, all words to the other.

    Raises
    ------
    BadRequest, BadSettings
    """
    store = _store(config, file)
    key, secret = store.new(name, role)
    sys.stderr.write(
        f"{key.name} may {key.role} from now on, with this key. It is shown this once: only its "
        f"hash is kept, in {store.path}\n"
    )
    sys.stdout.write(f"{secret}\n")


def show_list(config: Path | None, file: Path | None, *, as_json: bool) -> None:
    """Print names, roles, hints and dates. Raises `BadSettings` for a file that makes no sense."""
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
        sys.stdout.write(json.dumps(rows, indent=1) + "\n")
        return
    if not keys:
        sys.stdout.write(f"there are no keys in {store.path}\n")
    width = max((len(key.name) for key in keys), default=0)
    for key in keys:
        created = "" if key.created_utc is None else f"made {key.created_utc:%Y-%m-%d %H:%M} UTC"
        sys.stdout.write(f"{key.name.ljust(width)}  {str(key.role).ljust(9)}  ...{key.hint}  {created}\n")


def show_revoke(name: str, config: Path | None, file: Path | None) -> None:
    """Revoke a key. Raises `Unknown`, `BadSettings`."""
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
    if file is not None:
        return KeyStore(file)
    if config is None:
        return KeyStore(keys_path(None, default_url()))
    from mountnav.settings.observatory import Settings

    settings = Settings.load(config)
    return KeyStore(keys_path(settings.service.keys_file, settings.journal.where))
