"""The command line without a process of its own: what it prints and how it ends, where only that is asked.

A process costs a second of CPU before it reads its first option. What depends on being one (signals, streams
that break, what is imported) is tried with real ones.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
import typer

from api.main import main


def run_here(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """What `mountnav` with these arguments would have printed, and its exit code."""
    told, complained = StringIO(), StringIO()
    command = ["mountnav", *map(str, arguments)]
    code: object = 0
    with (
        pytest.MonkeyPatch.context() as patched,
        redirect_stdout(told),
        redirect_stderr(complained),
    ):
        patched.setattr(sys, "argv", command)
        try:
            main()
        except SystemExit as ended:
            code = ended.code or 0
    assert isinstance(code, int), code
    return subprocess.CompletedProcess(command, code, told.getvalue(), complained.getvalue())


def exit_code(command: Callable[..., None], *arguments: object, **options: object) -> int:
    """How a command ends that is called as a function, with its options by name."""
    try:
        command(*arguments, **options)
    except typer.Exit as ended:
        return ended.exit_code
    return 0
