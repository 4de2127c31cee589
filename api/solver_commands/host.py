"""Where a command runs: the files and the terminal of its caller.

A command may be carried out in another process than the one that was called (the solver daemon). It touches
files only through its `Host`, so that they are read and written by the caller, with the caller's rights and
in the caller's folder.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal, Protocol

from mountnav.frames import Frame, Hint
from mountnav.reading.star_lists import ListFormat
from mountnav.solution import Verdict


class Host(Protocol):
    """Files and terminal of a command. Paths are as the caller typed them: relative ones in its folder."""

    def open(self, path: str) -> BinaryIO:
        """Open a regular file for reading; it has a descriptor. Raises `OSError`."""
        ...

    def write(self, path: str, content: bytes) -> None:
        """Write a whole file at once, or not at all; one that is there keeps its mode.

        The null device takes all; anything else that is no plain file is refused. Raises `OSError`.
        """
        ...

    def exists(self, path: str) -> bool:
        """Whether there is such a file; the null device counts as none."""
        ...

    def remove(self, path: str) -> None:
        """Remove a plain file or a link; one that isn't there is no error, and the null device stays.

        Raises `OSError`.
        """
        ...

    def make_folder(self, path: str) -> None:
        """Make a folder, and those above it, where they aren't there. Raises `OSError`."""
        ...

    def read_input(self) -> bytes:
        """Read all of standard input."""
        ...

    def out(self, text: str) -> None:
        """Print, without adding a line end."""
        ...

    def err(self, text: str) -> None:
        """Print to standard error, without adding a line end."""
        ...


@dataclass(frozen=True, slots=True)
class Asked:
    """What a command asks the solver.

    Attributes
    ----------
    file : BinaryIO
        An image or a list of stars, with a descriptor; stays the caller's to close.
    name : str
        What to call it.
    hint : Hint or None
        What the command's options say.
    cpu_limit_s : float or None
        Of identifying; the solver's own budget where it is less or None.
    stars : ListFormat or None
        How to read the file if it is a list of stars.
    """

    file: BinaryIO
    name: str
    hint: Hint | None = None
    blind: Literal["after", "only", "never"] = "after"
    cpu_limit_s: float | None = None
    stars: ListFormat | None = None


class Solver(Protocol):
    """Solves and reads for commands, in whatever process."""

    def solve(self, asked: Asked, *, cancelled: Callable[[], bool] | None = None) -> Verdict:
        """Solve.

        Parameters
        ----------
        cancelled : callable, optional
            Asked now and then; when it says so, the frame is given up.

        Raises
        ------
        BadFrame
            Neither an image nor a list of stars.
        Cancelled
            As `cancelled` said.
        MountnavError
            The solver can't be had.
        """
        ...

    def read(self, file: BinaryIO, name: str) -> Frame:
        """Read an image, its mosaic evened out. Raises `BadFrame`."""
        ...


Command = Callable[[list[str], Host, Solver], int]
"""A command: its arguments without its name, where it runs, what solves for it; gives its exit code."""


class LocalHost:
    """The files and the terminal of this process. Implements `Host`."""

    def open(self, path: str) -> BinaryIO:
        """As `Host.open`."""
        # without waiting: opening a pipe would wait for a writer into it
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            file.close()
            raise OSError(f"{path} is not a regular file")
        return file

    def write(self, path: str, content: bytes) -> None:
        """As `Host.write`."""
        from mountnav.files import replace_bytes

        if os.path.realpath(path) != os.devnull:
            replace_bytes(Path(path), content)

    def exists(self, path: str) -> bool:
        """As `Host.exists`."""
        return os.path.exists(path) and os.path.realpath(path) != os.devnull

    def remove(self, path: str) -> None:
        """As `Host.remove`."""
        if os.path.realpath(path) == os.devnull:
            return
        with contextlib.suppress(FileNotFoundError):
            if not stat.S_ISREG(mode := os.lstat(path).st_mode) and not stat.S_ISLNK(mode):
                raise OSError(errno.EINVAL, "it is not a regular file", path)
            os.unlink(path)

    def make_folder(self, path: str) -> None:
        """As `Host.make_folder`."""
        os.makedirs(path, exist_ok=True)

    def read_input(self) -> bytes:
        """As `Host.read_input`."""
        return sys.stdin.buffer.read()

    def out(self, text: str) -> None:
        """As `Host.out`."""
        sys.stdout.write(text)
        sys.stdout.flush()

    def err(self, text: str) -> None:
        """As `Host.err`."""
        sys.stderr.write(text)
        sys.stderr.flush()
