"""Programs around StellarSolver, Ekos' library, compiled for tests."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

_PACKAGES = ("stellarsolver", "Qt5Core", "Qt5Network")


def compiled(source: Path, program: Path) -> Path:
    """The program, or a skip that says what is missing."""
    if shutil.which("g++") is None or shutil.which("pkg-config") is None:
        pytest.skip("there is no g++ or no pkg-config")
    asked = subprocess.run(["pkg-config", "--cflags", "--libs", *_PACKAGES], capture_output=True, text=True)
    if asked.returncode:
        pytest.skip("libstellarsolver-dev and qtbase5-dev are not installed")
    line = ["g++", "-std=c++17", "-fPIC", "-o", str(program), str(source), *asked.stdout.split()]
    subprocess.run(line, check=True)
    return program
