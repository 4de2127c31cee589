"""Writes the stub under the names of other plate solvers' commands into a folder, and takes it away again."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from api.solver_commands.registry import NAMES
from api.solver_daemon import stub
from mountnav.errors import BadRequest
from mountnav.files import replace_bytes

MARK = "# a command of mountnav's plate solver; written by `mountnav solver install`"
"""Line that tells our files from others."""
LONGEST_SHEBANG = 120
"""Characters of a first line that every system reads whole: Linux before 5.1 takes 127."""
_HEAD_BYTES = 2000
"""Of a file, in which the mark stands."""
_EXECUTABLE = 0o755
"""Mode of a command: everybody may run it, its owner replace it."""


@dataclass(frozen=True, slots=True)
class Installed:
    """What an installation has come to.

    Attributes
    ----------
    written, kept : tuple of Path
        Commands that were written, and files of others that were left alone.
    """

    folder: Path
    written: tuple[Path, ...]
    kept: tuple[Path, ...]


def own_folder() -> Path:
    """A folder of ours for the commands: ~/.local/share/mountnav/solver-commands."""
    data = os.environ.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share")
    return Path(data) / "mountnav" / "solver-commands"


def install(folder: Path, names: Iterable[str] = NAMES, *, force: bool = False) -> Installed:
    """Write the commands.

    Parameters
    ----------
    folder : Path
        Made if there is none.
    names : iterable of str
        Which.
    force : bool
        Also in place of files that aren't ours.

    Raises
    ------
    BadRequest
        There is no such command, or the folder can't be written.
    """
    wanted = list(names)
    unknown = [name for name in wanted if name not in NAMES]
    if unknown:
        raise BadRequest(f"there is no command {unknown[0]!r}", advice=f"there are: {', '.join(NAMES)}")
    text = _script().encode()
    written, kept = [], []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in wanted:
            path = folder / name
            if os.path.lexists(path) and not force and not is_ours(path):
                kept.append(path)
                continue
            if path.is_symlink():
                path.unlink()  # never write through a link into somebody else's program
            replace_bytes(path, text)
            path.chmod(_EXECUTABLE)
            written.append(path)
    except OSError as fault:
        raise BadRequest(
            f"the commands can't be written: {fault}", device=str(folder), advice="name another folder: --dir"
        ) from fault
    return Installed(folder, tuple(written), tuple(kept))


def uninstall(folder: Path) -> tuple[Path, ...]:
    """Take our commands out of a folder; files of others stay. The paths that are gone."""
    ours = [folder / name for name in NAMES if is_ours(folder / name)]
    for path in ours:
        path.unlink(missing_ok=True)
    return tuple(ours)


def is_ours(path: Path) -> bool:
    """Whether a file was written by `install`."""
    try:
        if path.is_symlink():
            return False
        with path.open("rb") as file:
            return MARK.encode() in file.read(_HEAD_BYTES)
    except OSError:
        return False


def _script() -> str:
    """The stub as a program for this interpreter."""
    assert stub.__file__ is not None
    source = Path(stub.__file__).read_text(encoding="utf-8")
    shebang = f"#!{sys.executable} -IS"
    if len(shebang) > LONGEST_SHEBANG or " " in sys.executable:
        # a shell reads the first three lines as a command; Python reads them as a string
        shebang = f"#!/bin/sh\n'''exec' \"{sys.executable}\" -IS \"$0\" \"$@\"\n' '''"
    return f"{shebang}\n{MARK}\n{source}"
