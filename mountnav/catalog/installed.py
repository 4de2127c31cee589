"""The folder of imported catalogs: listing, finding, removing, and the lock that one import holds."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.companion_colors import COLORS_SUFFIX
from mountnav.errors import BadRequest, BadSettings, Busy, NotFound
from mountnav.files import open_lock

_LOCK = "lock"


@contextmanager
def held(unfinished: Path) -> Iterator[None]:
    """Hold the lock of an import.

    The lock lies in the import's own folder and goes with it: a file that was removed while we waited for it
    guards nothing, so what was locked is looked at once more.

    Parameters
    ----------
    unfinished : Path
        The import's folder; made if it isn't there.

    Raises
    ------
    Busy
        Another process holds it.
    OSError
        The folder can't be written.
    """
    path = unfinished / _LOCK
    while True:
        unfinished.mkdir(parents=True, exist_ok=True)
        try:
            number = open_lock(path)
        except FileNotFoundError:
            continue  # removed between the two lines by the process that had it
        try:
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise _busy(unfinished, number) from None
            if not _is(path, number):
                continue
            os.ftruncate(number, 0)
            os.write(number, str(os.getpid()).encode())
            yield
            return
        finally:
            os.close(number)


def _busy(unfinished: Path, number: int) -> Busy:
    holder = os.pread(number, 20, 0).decode("ascii", "replace").strip() or "unknown"
    return Busy(
        f"another import of this name is going on (process {holder})",
        device=unfinished.stem,
        advice="wait until it has ended, or give this one another name with --name",
    )


def _is(path: Path, number: int) -> bool:
    try:
        there = path.stat()
    except FileNotFoundError:
        return False
    mine = os.fstat(number)
    return (there.st_dev, there.st_ino) == (mine.st_dev, mine.st_ino)


SUFFIX = ".mnc"
UNFINISHED_SUFFIX = ".import"
"""Of the folder beside the catalogs in which an import keeps what it has so far."""
EMBEDDED_SLUG = "tycho2"
"""The embedded catalog's name in commands and settings; no import may take it."""

_SLUG = re.compile(r"[a-z0-9][a-z0-9_-]{0,39}")
_RIGHTS = "check the folder's rights, or name another: --folder, [catalogs] folder or MOUNTNAV_CATALOGS"


def catalogs_folder(configured: Path | None = None) -> Path:
    """Where imported catalogs lie.

    Parameters
    ----------
    configured : Path, optional
        `[catalogs] folder`; goes before all else.

    Returns
    -------
    Path
        Else $MOUNTNAV_CATALOGS, $XDG_DATA_HOME/mountnav/catalogs or ~/.local/share/mountnav/catalogs. It need
        not exist.
    """
    if configured is not None:
        return configured
    if told := os.environ.get("MOUNTNAV_CATALOGS"):
        return Path(told)
    data = os.environ.get("XDG_DATA_HOME")
    return (Path(data) if data else Path.home() / ".local" / "share") / "mountnav" / "catalogs"


@dataclass(frozen=True, slots=True)
class Installed:
    """A catalog in the folder.

    Attributes
    ----------
    slug : str
        The file's name without its suffix: what commands and settings call it.
    store : PackedStore or None
        None if the file can't be used.
    problem : str or None
        Why.
    """

    slug: str
    path: Path
    store: PackedStore | None
    problem: str | None = None


def installed(folder: Path) -> list[Installed]:
    """Open every catalog in the folder, in the order of their names; a folder that isn't there holds none.

    Returns
    -------
    list of Installed
        Damaged ones too, with the problem told.

    Raises
    ------
    BadSettings
        The folder is there and can't be looked into.
    """
    return [_opened(path) for path in _paths(folder) if path.suffix == SUFFIX]


def find_installed(folder: Path, slug: str) -> Installed:
    """One catalog of the folder, damaged or not.

    Raises
    ------
    NotFound
        There is none of that name; tells which there are.
    BadSettings
        As `installed`.
    """
    names = []
    for path in _paths(folder):
        if path.suffix == SUFFIX:
            if path.stem == slug:
                return _opened(path)
            names.append(path.stem)
    there = ", ".join([EMBEDDED_SLUG, *names])
    raise NotFound(f"there is no catalog {slug!r} in {folder}", advice=f"there are: {there}")


def unfinished(folder: Path) -> list[str]:
    """Names of imports that were begun in the folder and not ended.

    Returns
    -------
    list of str
        In the order of their names. One that is going on right now is among them.

    Raises
    ------
    BadSettings
        As `installed`.
    """
    return [path.stem for path in _paths(folder) if path.suffix == UNFINISHED_SUFFIX and path.is_dir()]


def catalog_path(folder: Path, slug: str) -> Path:
    """Where a catalog of a name lies or would lie.

    Raises
    ------
    BadRequest
        It can't be a catalog's name, or is the embedded catalog's.
    """
    if problem := _name_problem(slug):
        raise BadRequest(problem, advice="choose another with --name")
    return folder / f"{slug}{SUFFIX}"


def unfinished_path(folder: Path, slug: str) -> Path:
    """Where an import of that name keeps what it has so far."""
    return folder / f"{slug}{UNFINISHED_SUFFIX}"


def remove(folder: Path, slug: str) -> int:
    """Remove a catalog, and what an unfinished import of that name left.

    A process that has the catalog open keeps its stars until it closes it.

    Parameters
    ----------
    slug : str
        A damaged file goes as well, and colors that lie beside it.

    Returns
    -------
    int
        Bytes freed.

    Raises
    ------
    BadRequest
        The embedded catalog can't be removed.
    NotFound
        There is nothing of that name.
    BadSettings
        It can't be removed.
    Busy
        An import of that name is going on.
    """
    if slug == EMBEDDED_SLUG:
        raise BadRequest(
            f"{slug} is the embedded catalog, a part of mountnav, and stays",
            advice="[catalogs] use = [...] in the settings decides which catalogs are used",
        )
    left = unfinished_path(folder, slug)
    names = {path.name for path in _paths(folder)}
    if f"{slug}{UNFINISHED_SUFFIX}" not in names:  # names, not paths: nothing outside the folder is meant
        file = find_installed(folder, slug).path
        beside = folder / f"{slug}{COLORS_SUFFIX}"
        return _unlinked([file, *([beside] if beside.name in names else [])], folder)
    with held(left):
        found = [folder / name for name in (f"{slug}{SUFFIX}", f"{slug}{COLORS_SUFFIX}") if name in names]
        kept = [path for path in left.rglob("*") if path.is_file()]
        freed = _unlinked([*found, *kept], folder)
        shutil.rmtree(left, ignore_errors=True)
    return freed


def _unlinked(paths: list[Path], folder: Path) -> int:
    try:
        freed = sum(path.lstat().st_size for path in paths)
        for path in paths:
            path.unlink()
    except OSError as refused:
        raise BadSettings(
            f"can't be removed: {refused.strerror}", device=str(refused.filename or folder), advice=_RIGHTS
        ) from refused
    return freed


def _paths(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except FileNotFoundError:
        return []
    except OSError as refused:
        raise BadSettings(
            f"the folder of catalogs can't be read: {refused.strerror}", device=str(folder), advice=_RIGHTS
        ) from refused


def _opened(path: Path) -> Installed:
    if problem := _name_problem(path.stem):
        return Installed(path.stem, path, None, problem)
    try:
        return Installed(path.stem, path, PackedStore(path))
    except BadSettings as error:
        return Installed(path.stem, path, None, str(error))


def _name_problem(slug: str) -> str | None:
    if slug == EMBEDDED_SLUG:
        return f"{slug!r} is the name of the embedded catalog"
    if not _SLUG.fullmatch(slug):
        return f"{slug!r} can't be a catalog's name: a-z, 0-9, _ and -, at most 40 characters, no path"
    return None
