"""What is asked of every solver, what came of it, and how a solver that is a command is run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Protocol

from mountnav.frames import Hint
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

LAUNCHER = Path(__file__).with_name("launcher.py")
WRONG_PX, WRONG_SCALE = 3.0, 0.01
"""A solution that is farther off than this is wrong."""
ONE_CORE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


@dataclass(frozen=True, slots=True)
class Job:
    """A frame with its truth.

    Attributes
    ----------
    name : str
    preset : str
        Row of the table it belongs to.
    path : Path
        A plain FITS file, or a real frame as it is.
    width_px, height_px : int
    center : Icrs or None
        Truth of the geometric center; None where the frame must not solve.
    scale_arcsec_px : float or None
        Truth at the center.
    hint : Hint
        What a hinted run is told: place off by up to 1°, scale by up to 5 %.
    allowed_px : float
        How far off the center may be, in pixels.
    catalog_stars : int
        Stars of the embedded catalog in the frame; -1 if not known.
    """

    name: str
    preset: str
    path: Path
    width_px: int
    height_px: int
    center: Icrs | None
    scale_arcsec_px: float | None
    hint: Hint
    allowed_px: float = WRONG_PX
    catalog_stars: int = -1


@dataclass(frozen=True, slots=True)
class Found:
    """Where a solver says a frame's geometric center lies."""

    center: Icrs
    scale_arcsec_px: float


@dataclass(frozen=True, slots=True)
class Attempt:
    """One solver's work on one frame.

    Attributes
    ----------
    found : Found or None
    cpu_s, wall_s : float
        User and system time of the program and of all it started; time on the clock.
    peak_mb : float
        Most resident memory of any one process, megabytes (10^6 bytes).
    note : str
        Why it wasn't solved, or what else is worth telling.
    identify_s : float or None
        Wall time of the identification alone, where the solver tells.
    own_mb : float or None
        Memory that is this process's alone when it is done: without mapped files, which processes share.
    """

    found: Found | None
    cpu_s: float
    wall_s: float
    peak_mb: float
    note: str = ""
    identify_s: float | None = None
    own_mb: float | None = None

    def error_px(self, job: Job) -> float | None:
        """Distance of the center from the truth in pixels; None without a solution or a truth."""
        if self.found is None or job.center is None:
            return None
        scale = job.scale_arcsec_px or self.found.scale_arcsec_px
        return separation_arcsec(self.found.center, job.center) / scale

    def wrong(self, job: Job) -> bool:
        """Whether it claims a place that isn't so."""
        if self.found is None:
            return False
        error = self.error_px(job)
        if error is None or not error <= job.allowed_px:
            return True
        true = job.scale_arcsec_px
        return true is not None and abs(self.found.scale_arcsec_px / true - 1.0) > WRONG_SCALE


class Solver(Protocol):
    """A program to compare."""

    @property
    def name(self) -> str:
        """For the table."""
        ...

    def can(self, job: Job, *, blind: bool) -> str:
        """Why it can't be asked this at all; empty if it can."""
        ...

    def solve(self, job: Job, *, blind: bool) -> Attempt:
        """Solve one frame, alone on the machine as far as we can tell."""
        ...

    def close(self) -> None:
        """Let go of what it holds."""
        ...


@dataclass(frozen=True, slots=True)
class Ran:
    """What a command took, and what it printed."""

    status: int
    late: bool
    cpu_s: float
    wall_s: float
    peak_mb: float
    output: str


@cache
def _compiled() -> tempfile.TemporaryDirectory[str]:
    """Where Python's compiled modules are kept during this run; removed at its end."""
    return tempfile.TemporaryDirectory(prefix="mountnav-compiled-")


def _environment() -> dict[str, str]:
    """One core, and modules compiled once, as those of an installed package are."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | ONE_CORE | {"PYTHONPYCACHEPREFIX": _compiled().name}


def run(command: list[str], folder: Path, *, limit_s: float) -> Ran:
    """Run a command to its end and measure it.

    Parameters
    ----------
    command : list of str
    folder : Path
        Where it works and what it may fill.
    limit_s : float
        Wall seconds after which it is ended, with all it started.

    Returns
    -------
    Ran
        The standard output; errors are lost.
    """
    record = folder / "took.json"
    record.unlink(missing_ok=True)
    launcher = [sys.executable, "-I", "-S", str(LAUNCHER), str(record), f"{limit_s:g}", *command]
    # a session of its own: whatever ends this run ends all that it started, and nothing else
    process = subprocess.Popen(
        launcher,
        cwd=folder,
        env=_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        output, _ = process.communicate(timeout=limit_s + 10.0)
    except subprocess.TimeoutExpired:
        return Ran(-1, True, limit_s, limit_s, 0.0, "")
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    took = json.loads(record.read_text(encoding="utf-8"))
    return Ran(
        status=took["status"],
        late=took["late"],
        cpu_s=took["cpu_s"],
        wall_s=took["wall_s"],
        peak_mb=took["peak_kb"] * 1024 / 1e6,
        output=output.decode("utf-8", "replace"),
    )
