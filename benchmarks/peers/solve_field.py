"""astrometry.net's solve-field, asked as a user who wants speed asks it."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from benchmarks.peers.running import Attempt, Job, run
from benchmarks.peers.wcs_files import claimed_in

CPU_LIMIT_S = 30
# no plots and none of the files that nobody reads here
QUIET = [
    "--overwrite",
    "--no-plots",
    "--new-fits", "none",
    "--match", "none",
    "--rdls", "none",
    "--corr", "none",
    "--index-xyls", "none",
    "--temp-axy",
]  # fmt: skip


class SolveField:
    """The command with its Tycho-2 indexes.

    Parameters
    ----------
    work : Path
        Folder for temporary files.
    """

    name = "solve-field"

    def __init__(self, work: Path) -> None:
        self._work = work

    @staticmethod
    def missing() -> str:
        """Why it can't be run here; empty if it can."""
        if shutil.which("solve-field") is None:
            return "solve-field is not installed (Debian: astrometry.net, astrometry-data-tycho2)"
        return ""

    def can(self, job: Job, *, blind: bool) -> str:
        """It takes everything."""
        del job, blind
        return ""

    def solve(self, job: Job, *, blind: bool) -> Attempt:
        """Solve; hinted with position (1.5°) and scale (5 %), blind with neither."""
        with tempfile.TemporaryDirectory(dir=self._work) as name:
            folder = Path(name)
            told = self._options(job, blind=blind)
            output = ["--dir", name, "--temp-dir", name, "--wcs", "found.wcs", "--solved", "none"]
            command = ["solve-field", *QUIET, *told, *output, str(job.path)]
            ran = run(command, folder, limit_s=3 * CPU_LIMIT_S)
            found = claimed_in(folder / "found.wcs", job.width_px, job.height_px)
        note = "" if found else ("out of time" if ran.late else "did not solve")
        return Attempt(found, ran.cpu_s, ran.wall_s, ran.peak_mb, note)

    def close(self) -> None:
        """Nothing is held."""

    @staticmethod
    def _options(job: Job, *, blind: bool) -> list[str]:
        # of what was tried on frames A, B, C and E the options that cost least and still solve all: quarter
        # the frame, and leave out the steps that start Python
        options = ["--cpulimit", f"{CPU_LIMIT_S}", "--downsample", "4", "--no-remove-lines"]
        options += ["--uniformize", "0"]
        if blind:
            return options
        hint = job.hint
        if hint.center is not None:
            options += ["--ra", f"{hint.center.ra_deg:.6f}", "--dec", f"{hint.center.dec_deg:.6f}"]
            options += ["--radius", f"{1.5 * hint.radius_deg:g}"]
        if hint.scale_low_arcsec_px is not None and hint.scale_high_arcsec_px is not None:
            options += ["--scale-units", "arcsecperpix"]
            options += ["--scale-low", f"{hint.scale_low_arcsec_px:.6f}"]
            options += ["--scale-high", f"{hint.scale_high_arcsec_px:.6f}"]
        return options
