"""mountnav in a warm process, as the service keeps one: what the second and every later frame costs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.peers.running import ONE_CORE, Attempt, Found, Job
from mountnav.sky.coordinates import Icrs

RESIDENT = "mountnav resident"
ROOT = Path(__file__).resolve().parents[2]


class MountnavResident:
    """A process that stays, one for each mode: neither has seen a frame that the other solved.

    Parameters
    ----------
    warm_up : Job
        Another frame, which each process solves before anything is measured: the first solve imports and
        opens files.
    """

    name = RESIDENT

    def __init__(self, warm_up: Job) -> None:
        self._warm_up = warm_up
        self._processes: dict[bool, subprocess.Popen[str]] = {}

    def can(self, job: Job, *, blind: bool) -> str:
        """It takes everything."""
        del job, blind
        return ""

    def solve(self, job: Job, *, blind: bool) -> Attempt:
        """Solve in the mode's process."""
        if blind not in self._processes:
            self._processes[blind] = _started()
            self._asked(self._warm_up, blind=blind)
        told = self._asked(job, blind=blind)
        found = None
        if told["found"] is not None:
            ra, dec, scale = told["found"]
            found = Found(Icrs(ra, dec), scale)
        return Attempt(
            found,
            told["cpu_s"],
            told["wall_s"],
            told["peak_kb"] * 1024 / 1e6,
            told["note"],
            told.get("identify_s"),
            told["own_kb"] * 1024 / 1e6,
        )

    def close(self) -> None:
        """End the processes."""
        for process in self._processes.values():
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
            process.communicate()

    def _asked(self, job: Job, *, blind: bool) -> dict[str, Any]:
        process, hint = self._processes[blind], job.hint
        question = {
            "path": str(job.path),
            "blind": blind,
            "ra_deg": hint.center.ra_deg if hint.center else None,
            "dec_deg": hint.center.dec_deg if hint.center else None,
            "radius_deg": hint.radius_deg,
            "scale_low": hint.scale_low_arcsec_px,
            "scale_high": hint.scale_high_arcsec_px,
        }
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(question) + "\n")
        process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            raise RuntimeError("the resident solver ended; its message stands above")
        answer: dict[str, Any] = json.loads(line)
        return answer


def _started() -> subprocess.Popen[str]:
    # a session of its own: Ctrl-C is for the benchmark, which ends it
    return subprocess.Popen(
        [sys.executable, "-m", "benchmarks.peers.resident_worker"],
        cwd=ROOT,
        env=os.environ | ONE_CORE,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
