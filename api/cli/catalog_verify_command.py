"""`mountnav catalog verify` and `remove`: every byte of a catalog is read; a catalog goes."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from api.cli.catalog_folder import folder_of
from api.http.file_names import shown
from mountnav.catalog.embedded import EMBEDDED_PATH, verify_embedded
from mountnav.catalog.installed import (
    EMBEDDED_SLUG,
    Installed,
    find_installed,
    installed,
    remove,
    unfinished,
)
from mountnav.catalog.packed import PackedStore
from mountnav.errors import BadRequest, BadSettings


def show_verify(
    name: str | None, every: bool, folder: Path | None, config: Path | None, as_json: bool
) -> int:
    """Compare catalogs with their checksums; one line for each.

    Returns
    -------
    int
        0 if all are sound, 1 if one isn't.

    Raises
    ------
    BadRequest
        Both a name and `every`.
    Unknown
        There is no catalog of that name.
    BadSettings
        The settings file is wrong, or the folder can't be looked into.
    """
    if every and name is not None:
        raise BadRequest("both a name and --all", advice="give one of them")
    where = folder_of(folder, config)
    embedded = Installed(EMBEDDED_SLUG, EMBEDDED_PATH, None)
    if every:
        chosen = [embedded, *installed(where)]
    else:
        chosen = [embedded if name in (None, EMBEDDED_SLUG) else find_installed(where, str(name))]
    problems = 0
    for one in chosen:
        problem = _problem(one)
        problems += problem is not None
        if as_json:
            fact = {"slug": one.slug, "file": shown(one.path), "sound": problem is None, "problem": problem}
            sys.stdout.write(json.dumps(fact) + "\n")
        else:
            sys.stdout.write(f"{one.slug}: {'sound' if problem is None else problem}\n")
        sys.stdout.flush()
    return 1 if problems else 0


def show_remove(name: str, yes: bool, folder: Path | None, config: Path | None) -> int:
    """Remove a catalog, after asking once.

    Returns
    -------
    int
        0 when it is gone, 1 when the answer was no.

    Raises
    ------
    MountnavError
        As `mountnav.catalog.installed.remove`.
    BadRequest
        There is nobody to ask, and no --yes.
    """
    where = folder_of(folder, config)
    if name != EMBEDDED_SLUG and name not in unfinished(where):
        find_installed(where, name)  # a question about nothing is none
    if not yes and name != EMBEDDED_SLUG:
        if not _somebody_to_ask():
            raise BadRequest(f"{name} would be removed for good", advice="say so with --yes")
        import typer

        what = shown(where / f"{name}.mnc")
        if not typer.confirm(f"Remove {what}?", err=True):
            return 1
    freed = remove(where, name)
    sys.stdout.write(f"{name} is removed: {freed / 1e6:.1f} MB are free again\n")
    return 0


def _somebody_to_ask() -> bool:
    return sys.stdin.isatty()


def _verify(slug: str, store: PackedStore) -> None:
    """Under a progress bar, if somebody looks: some GB take some seconds."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(f"reading {slug}", total=1.0)
        store.verify(progress=lambda share: bar.update(task, completed=share))


def _problem(one: Installed) -> str | None:
    try:
        if one.slug == EMBEDDED_SLUG and one.path == EMBEDDED_PATH:
            verify_embedded()
        elif one.store is None:
            return one.problem
        else:
            _verify(one.slug, one.store)
    except (BadSettings, OSError) as error:
        return str(error)
    return None
