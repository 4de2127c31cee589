"""`mountnav solve --json` as a whole process: the interpreter's start and every import included."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

from benchmarks.peers.running import Attempt, Found, Job, run
from mountnav.sky.coordinates import Icrs

LIMIT_S = 120.0


class MountnavCommand:
    """The command of this very environment.

    Parameters
    ----------
    work : Path
        Folder for temporary files.
    """

    name = "mountnav solve"

    def __init__(self, work: Path) -> None:
        self._work = work
        self._command = Path(sys.executable).with_name("mountnav")

    def can(self, job: Job, *, blind: bool) -> str:
        """It takes everything."""
        del job, blind
        return ""

    def solve(self, job: Job, *, blind: bool) -> Attempt:
        """Run it once."""
        hint = job.hint
        command = [str(self._command), "solve", "--json"]
        if blind:
            command.append("--blind")
        elif hint.center is not None:
            command += ["--ra", f"{hint.center.ra_deg:.6f}", "--dec", f"{hint.center.dec_deg:.6f}"]
            command += ["--radius", f"{hint.radius_deg:g}"]
            if hint.scale_low_arcsec_px is not None and hint.scale_high_arcsec_px is not None:
                command += ["--scale-low", f"{hint.scale_low_arcsec_px:.6f}"]
                command += ["--scale-high", f"{hint.scale_high_arcsec_px:.6f}"]
        with tempfile.TemporaryDirectory(dir=self._work) as name:
            ran = run([*command, str(job.path)], Path(name), limit_s=LIMIT_S)
        try:
            record = json.loads(ran.output)
        except json.JSONDecodeError:
            return Attempt(None, ran.cpu_s, ran.wall_s, ran.peak_mb, f"no record, exit {ran.status}")
        found = None
        if record["solved"]:
            found = Found(Icrs(record["ra_deg"], record["dec_deg"]), record["scale_arcsec_px"])
        return Attempt(found, ran.cpu_s, ran.wall_s, ran.peak_mb, record.get("reason") or "")

    def close(self) -> None:
        """Nothing is held."""
