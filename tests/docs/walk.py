"""Walks a page of the tutorials as a newcomer does: its blocks, in order, in an empty folder.

A block of ``sh`` is run by bash, one of ``python`` by the interpreter with `await` on its first level, in one
and the same session; one with a file's name as its title is written to that file; one with the title "first
terminal" is a service that is left running. A comment ``<!-- shows: PATTERN -->`` after a block says what its
output must have.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
INSTALLED = "MOUNTNAV_WALK_PYTHON"
"""The variable that names the Python of an environment into which the wheels alone were installed.

CI sets it: the walks then see that environment's commands and packages, and nothing of this checkout.
Without it they run this checkout."""
_BLOCK = re.compile(
    r'^```(sh|python)(?: title="([^"]+)")?\n(.*?)^```$|^<!-- shows: ([^\n]+) -->$', re.MULTILINE | re.DOTALL
)
_TERMINAL = "first terminal"
_LONGEST_S = 300.0
"""Until a walk is given up, s: a hanging block must not hang the tests. It is no limit of speed."""
_DATA_BYTES = 1_000_000
"""Files of the checkout above this size, bytes, are catalogs. No walk changes them: they are linked."""
# the cells of a notebook: as IPython runs them
_CELLS = """
import ast, asyncio, inspect, sys
space = {"__name__": "__main__"}
async def all_cells():
    for number, cell in enumerate(open(sys.argv[1]).read().split("\\x00")):
        print(f"@@{number}", flush=True)
        code = compile(cell, "cell", "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
        found = eval(code, space)
        if inspect.isawaitable(found):
            await found
asyncio.run(all_cells())
"""


@dataclass
class Block:
    """A piece of a page that is run, and what it must show."""

    language: str
    title: str
    text: str
    shows: list[str] = field(default_factory=list)


def blocks_of(page: Path) -> list[Block]:
    """The blocks of a page that are run or written, in order."""
    found: list[Block] = []
    for language, title, text, shows in _BLOCK.findall(page.read_text(encoding="utf-8")):
        if shows:
            found[-1].shows.append(shows)
        else:
            found.append(Block(language, title, text))
    return found


class Walk:
    """A newcomer's folder, environment and terminals.

    Parameters
    ----------
    folder : Path
        Empty.
    replaced : mapping
        Texts of the page to run with others instead: a port that is free, fewer frames.
    checkout : bool
        The folder is a copy of this checkout, and nothing else is to be imported.
    """

    def __init__(self, folder: Path, replaced: Mapping[str, str], *, checkout: bool = False) -> None:
        self._folder = folder
        self._replaced = dict(replaced)
        installed = None if checkout else os.environ.get(INSTALLED)
        self._python = installed or sys.executable
        self._environment = {
            **{
                name: value
                for name, value in os.environ.items()
                if not name.startswith(("MOUNTNAV_", "PYTEST_"))
            },
            "HOME": str(folder),
            "NO_COLOR": "1",
            "COLUMNS": "200",
        }
        if checkout:
            self._environment["PYTHONPATH"] = str(folder)
        elif installed:
            self._environment.pop("PYTHONPATH", None)
            self._environment["PATH"] = f"{Path(installed).parent}:/usr/local/bin:/usr/bin:/bin"
        else:
            self._environment["PYTHONPATH"] = str(ROOT)
            self._environment["PATH"] = f"{self._commands_of_the_checkout()}:{os.environ['PATH']}"
        for name in ("MOUNTNAV_CACHE", "MOUNTNAV_SERVICE"):
            if name in os.environ:
                self._environment[name] = os.environ[name]
        self._terminals: list[subprocess.Popen[bytes]] = []

    def _commands_of_the_checkout(self) -> Path:
        """A folder with `mountnav` and `python3` of this checkout, whatever is installed."""
        commands = self._folder / "bin"
        commands.mkdir()
        for name, what in (("mountnav", "-m api.main"), ("python3", "")):
            (commands / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {what} "$@"\n')
            (commands / name).chmod(0o755)
        return commands

    def told(self, text: str) -> str:
        """The text of a page, with what is replaced."""
        for old, new in self._replaced.items():
            text = text.replace(old, new)
        return text

    def walk(self, blocks: list[Block], port: int | None) -> list[tuple[Block, str]]:
        """Run all blocks; return each that was run with its output."""
        outputs: list[tuple[Block, str]] = []
        cells = [block for block in blocks if block.language == "python" and not block.title]
        for block in blocks:
            text = self.told(block.text)
            if block.title == _TERMINAL:
                self._begin(text, port)
            elif block.title:
                (self._folder / block.title).write_text(text)
            elif block.language == "sh":
                outputs.append((block, self._ran(["bash", "-euo", "pipefail", "-c", text])))
        if cells:
            script = self._folder / "cells.txt"
            script.write_text("\x00".join(self.told(cell.text) for cell in cells))
            shown = self._ran([self._python, "-c", _CELLS, str(script)])
            outputs += zip(cells, re.split(r"^@@\d+\n", shown, flags=re.MULTILINE)[1:], strict=True)
        return outputs

    def _ran(self, command: list[str]) -> str:
        ran = subprocess.run(
            command,
            cwd=self._folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=_LONGEST_S,
            check=False,
        )
        shown = ran.stdout.decode("utf-8", "replace")
        assert ran.returncode == 0, f"{command[-1]}\n{shown}"
        return shown

    def _begin(self, text: str, port: int | None) -> None:
        with (self._folder / "terminal.txt").open("wb") as out:
            begun = subprocess.Popen(
                ["bash", "-c", f"exec {text}"],
                cwd=self._folder,
                env=self._environment,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._terminals.append(begun)
        until = time.monotonic() + _LONGEST_S
        while not self._answers(port):
            assert begun.poll() is None, (self._folder / "terminal.txt").read_text()
            assert time.monotonic() < until, "it doesn't come up"
            time.sleep(0.1)

    def _answers(self, port: int | None) -> bool:
        if port is None:
            return (self._folder / "mount").exists()
        with socket.socket() as asked:
            asked.settimeout(1.0)
            return asked.connect_ex(("127.0.0.1", port)) == 0

    def close(self) -> None:
        """End what was left running, as Ctrl-C does."""
        for begun in self._terminals:
            if begun.poll() is None:
                os.killpg(begun.pid, signal.SIGINT)
        for begun in self._terminals:
            begun.wait(_LONGEST_S)


def copy_of_the_checkout(folder: Path) -> None:
    """Copy all files of this checkout that aren't ignored into a folder, and its environment as a link."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("this is no checkout that git knows")
    for name in filter(None, listed.stdout.decode().split("\0")):
        source, copy = ROOT / name, folder / name
        if not source.is_file():
            continue
        copy.parent.mkdir(parents=True, exist_ok=True)
        if source.stat().st_size > _DATA_BYTES:
            copy.symlink_to(source)
        else:
            shutil.copy(source, copy)
    (folder / ".venv").symlink_to(sys.prefix)


def free_port() -> int:
    """A TCP port of loopback that nobody uses just now."""
    with socket.create_server(("127.0.0.1", 0)) as bound:
        port: int = bound.getsockname()[1]
        return port
