"""`mountnav key`: API keys are made, listed, renewed, changed, revoked; a running service follows at once."""

from __future__ import annotations

import re
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.access.callers import Role
from api.cli.options import Json, config_option
from api.cli.output import print_json

if TYPE_CHECKING:
    from api.access.keys import Key, KeyStore

key_app = typer.Typer(
    help="API keys: who may solve, view, operate or configure, which telescopes, until when.",
    no_args_is_help=True,
)

KeyConfig = Annotated[Path | None, config_option("Settings file of the service: its keys are meant.")]
KeyFile = Annotated[
    Path | None, typer.Option("--file", help="The file of keys itself, instead of that of --config.")
]
Name = Annotated[str, typer.Argument(help="Who uses it, such as a scheduler or a person.")]
Telescopes = Annotated[
    list[str] | None,
    typer.Option("--telescope", "-t", help="Only this one; may be repeated. Else all of the service."),
]
Lasts = Annotated[
    str | None, typer.Option("--for", help="How long it lasts: 90d, 12h, 8w. Else it has no end.")
]
Until = Annotated[
    str | None, typer.Option("--until", help="When it ends: 2027-06-30, 2027-06-30T18:00 (UTC).")
]

_SPAN = re.compile(r"([0-9]{1,6})\s*(m|h|d|w|y)?")
_UNITS = {"m": "minutes", "h": "hours", "d": "days", "w": "weeks"}
_YEAR_DAYS = 365
"""Days of a year, as people count when they give a key for one. Doubled, such keys last twice as long."""


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
    telescope: Telescopes = None,
    lasts: Lasts = None,
    until: Until = None,
    config: KeyConfig = None,
    file: KeyFile = None,
) -> None:
    """Make a key and print it, this once. A running service accepts it from now on."""
    store = _store(config, file)
    _require_there(telescope, config)
    key, secret = store.new(name, role, telescopes=telescope, lasts=_span(lasts), until=_instant(until))
    # the key alone goes to the standard output, for scripts; all words to the other
    sys.stderr.write(
        f"{key.name} may {key.role} from now on{_scope_words(key)}, {_end_words(key)}, with this key. It is "
        f"shown this once: only its hash is kept, in {store.path}\n"
    )
    sys.stdout.write(f"{secret}\n")


@key_app.command("list")
def list_(config: KeyConfig = None, file: KeyFile = None, as_json: Json = False) -> None:
    """List keys: names, roles, telescopes, the last characters of each, when they were made and end."""
    store = _store(config, file)
    keys = store.readable()
    if as_json:
        rows = [
            {
                "name": key.name,
                "role": str(key.role),
                "hint": key.hint,
                "created_utc": None if key.created_utc is None else key.created_utc.isoformat(),
                "telescopes": None if key.telescopes is None else sorted(key.telescopes),
                "expires_utc": None if key.expires_utc is None else key.expires_utc.isoformat(),
                "ended": store.has_ended(key),
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
        cells = [key.name.ljust(width), str(key.role).ljust(9), f"...{key.hint}", created]
        if key.expires_utc is not None:
            word = "ENDED" if store.has_ended(key) else "ends"
            cells.append(f"{word} {key.expires_utc:%Y-%m-%d %H:%M} UTC")
        if key.telescopes is not None:
            cells.append(f"only {', '.join(sorted(key.telescopes))}")
        sys.stdout.write("  ".join(cells).rstrip() + "\n")


@key_app.command()
def renew(
    name: Name,
    lasts: Lasts = None,
    until: Until = None,
    overlap: Annotated[
        str, typer.Option(help="How long the old one still works; 0 ends it at once.")
    ] = "24h",
    config: KeyConfig = None,
    file: KeyFile = None,
) -> None:
    """Make a new secret for a key and print it, this once; the old one goes on for --overlap.

    It lasts as long as the old one was made for, unless something else is given.
    """
    store = _store(config, file)
    over = _span(overlap, zero=True)
    assert over is not None
    key, secret = store.renew(name, lasts=_span(lasts), until=_instant(until), overlap=over)
    sys.stderr.write(
        f"{key.name} may {key.role} with this key as well from now on{_scope_words(key)}, {_end_words(key)}; "
        f"the old one is {'refused at once' if not over else f'taken for {overlap} yet'}\n"
    )
    sys.stdout.write(f"{secret}\n")


@key_app.command()
def change(
    name: Name,
    role: Annotated[Role | None, typer.Option(help="What it may from now on.")] = None,
    telescope: Telescopes = None,
    all_telescopes: Annotated[
        bool, typer.Option("--all-telescopes", help="It opens all telescopes again.")
    ] = False,
    lasts: Lasts = None,
    until: Until = None,
    endless: Annotated[bool, typer.Option("--endless", help="It has no end any more.")] = False,
    config: KeyConfig = None,
    file: KeyFile = None,
) -> None:
    """Change what a key may, of which telescopes, or until when; its secret stays. Its streams end."""
    from mountnav.errors import BadRequest

    if (telescope and all_telescopes) or (endless and (lasts or until)):
        raise BadRequest("those options contradict each other", advice="say one of them")
    if role is None and not telescope and not all_telescopes and not endless and not lasts and not until:
        raise BadRequest("nothing was named to change", advice="such as --for 90d or --telescope east")
    store = _store(config, file)
    _require_there(telescope, config)
    key = store.change(
        name,
        role=role,
        telescopes=telescope or None,
        all_telescopes=all_telescopes,
        lasts=_span(lasts),
        until=_instant(until),
        endless=endless,
    )
    sys.stdout.write(f"{key.name} may {key.role} from now on{_scope_words(key)}, {_end_words(key)}\n")


@key_app.command()
def revoke(
    name: Name,
    hint: Annotated[
        str | None,
        typer.Option(help="Only the secret that ends with these characters, of one that was renewed."),
    ] = None,
    config: KeyConfig = None,
    file: KeyFile = None,
) -> None:
    """Revoke a key with all its secrets. A running service refuses it from the next request on."""
    store = _store(config, file)
    store.revoke(name, hint=hint)
    sys.stdout.write(f"the key of {name} is revoked; a running service refuses it from now on\n")
    if not store.keys:
        sys.stdout.write(
            "no key is left: nobody is let in any more except by the settings' "
            "token. To run without keys again, "
            f"on this machine alone, remove {store.path}\n"
        )


def _scope_words(key: Key) -> str:
    return "" if key.telescopes is None else f" on {', '.join(sorted(key.telescopes))}"


def _end_words(key: Key) -> str:
    return "without an end" if key.expires_utc is None else f"until {key.expires_utc:%Y-%m-%d %H:%M} UTC"


def _span(text: str | None, *, zero: bool = False) -> timedelta | None:
    """Such as 90d; days if no unit is given. Raises `BadRequest`."""
    from mountnav.errors import BadRequest

    if text is None:
        return None
    found = _SPAN.fullmatch(text.strip())
    if found is None or (int(found[1]) == 0 and not zero):
        raise BadRequest(f"{text!r} is not a length of time", advice="such as 90d, 12h, 8w, 30m, 1y")
    count, unit = int(found[1]), found[2] or "d"
    return timedelta(days=_YEAR_DAYS * count) if unit == "y" else timedelta(**{_UNITS[unit]: count})


def _instant(text: str | None) -> datetime | None:
    """A date or an instant, UTC unless it tells a zone. Raises `BadRequest`."""
    from mountnav.errors import BadRequest

    if text is None:
        return None
    try:
        found = datetime.fromisoformat(text.strip())
        return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)
    except (ValueError, OverflowError) as wrong:
        raise BadRequest(
            f"{text!r} is not a date", advice="such as 2027-06-30 or 2027-06-30T18:00"
        ) from wrong


def _require_there(telescopes: list[str] | None, config: Path | None) -> None:
    """Refuse a telescope that the settings don't know: a key for a name that was mistyped opens nothing."""
    if not telescopes or config is None:
        return
    from mountnav.errors import NotFound
    from mountnav.settings.observatory import Settings

    ids = [one.id for one in Settings.load(config).telescope]
    for one in telescopes:
        if one not in ids:
            raise NotFound(f"there is no telescope {one!r}", advice=f"there is: {', '.join(ids)}")


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
