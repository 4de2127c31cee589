"""The same drawn frames by GNU parallel: a mountnav archive, solve-field and ASTAP side by side.

    python -m benchmarks.archive.peers [--preset A] [--frames 8] [--copies 3] [--jobs 1]

Each frame is told its place within 1° and its scale within 5 %. CPU seconds are those of all processes that
GNU parallel starts, starting them included: an archive's worker starts once for its chunk, the others once
for each frame. What each is told: benchmarks/peers/.
"""

from __future__ import annotations

import argparse
import csv
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.peers.astap import Astap
from benchmarks.peers.drawing import PRESETS, drawn
from benchmarks.peers.running import Job
from benchmarks.peers.solve_field import QUIET, SolveField
from mountnav.archive.folder import Folder
from mountnav.catalog.embedded import embedded_catalog


def parallel(commands: list[list[str]], asked: argparse.Namespace, folder: Path) -> tuple[float, float]:
    """Let GNU parallel run commands; CPU seconds of all, and wall seconds."""
    before, began_s = os.times(), time.monotonic()
    text = "".join(f"{shlex.join(command)} > /dev/null 2>&1\n" for command in commands)
    subprocess.run(
        [asked.parallel, "--jobs", str(asked.jobs)], input=text, text=True, cwd=folder, check=False
    )
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return spent, time.monotonic() - began_s


def archived(
    jobs: list[Job], folder: Path, asked: argparse.Namespace
) -> tuple[list[list[str]], Callable[[], int]]:
    """The commands of an archive of these frames, and who counts what it solved."""
    table = folder / "frames.csv"
    with open(table, "w", newline="") as file:
        rows = csv.writer(file)
        place, scale = ["ra_deg", "dec_deg", "radius_deg"], ["scale_low_arcsec_px", "scale_high_arcsec_px"]
        rows.writerow(["file", *place, *scale])
        for job in jobs:
            hint = job.hint
            assert hint.center is not None
            where = [hint.center.ra_deg, hint.center.dec_deg, hint.radius_deg]
            rows.writerow([job.path, *where, hint.scale_low_arcsec_px, hint.scale_high_arcsec_px])
    command = [sys.executable, "-m", "api.main", "archive"]
    size = -(-len(jobs) // asked.jobs)
    words = ["archive", "--frames", str(table), "--chunk-frames", str(size), "--undated", "2026-01-01"]
    subprocess.run([*command, "init", *words], cwd=folder, check=True)

    def solved() -> int:
        run = Folder.open(folder / "archive").run(None)
        return sum(1 for chunk in run.done() for _ in _solutions(run.chunk(chunk)))

    return [
        [*command, "work", "archive", "--chunk", f"{at}/{asked.jobs}"] for at in range(asked.jobs)
    ], solved


def _solutions(chunk: Path) -> list[object]:
    from mountnav.archive.tables import read_rows

    return list(read_rows(chunk / "solutions.parquet", ["number"]))


def main() -> None:
    """Measure all that are here."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", choices=tuple(PRESETS), default="A")
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--copies", type=int, default=3, help="each frame is solved so often")
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side")
    parser.add_argument(
        "--parallel", default="parallel", help="GNU's; moreutils has another one of this name"
    )
    asked = parser.parse_args()
    version = subprocess.run([asked.parallel, "--version"], capture_output=True, text=True, check=False)
    if "GNU parallel" not in version.stdout:
        parser.error(f"{asked.parallel} is not GNU parallel")
    with tempfile.TemporaryDirectory() as there:
        folder, catalog = Path(there), embedded_catalog()
        jobs = [drawn(asked.preset, at, 4, catalog, folder) for at in range(asked.frames)] * asked.copies

        def told(name: str, spent: tuple[float, float], solved: int) -> None:
            each = spent[0] / len(jobs)
            print(
                f"{name:12} {solved} of {len(jobs)} solved; {each:.3f} CPU s a frame; {spent[1]:.0f} s",
                flush=True,
            )

        commands, solved = archived(jobs, folder, asked)
        told("archive", parallel(commands, asked, folder), solved())
        if shutil.which("solve-field"):
            parts = []
            for at, job in enumerate(jobs):
                output = ["--dir", f"sf{at}", "--wcs", f"sf{at}.wcs", "--solved", "none"]
                options = SolveField._options(job, blind=False)
                parts.append(["solve-field", *QUIET, *options, *output, str(job.path)])
            spent = parallel(parts, asked, folder)
            told("solve-field", spent, len(list(folder.glob("sf*.wcs"))))
        if shutil.which("astap_cli"):
            astap = Astap(folder, catalog)
            parts = []
            for at, job in enumerate(jobs):
                words = ["-f", str(job.path), "-d", str(folder / "astap"), "-o", str(folder / f"as{at}")]
                parts.append(["astap_cli", *words, *astap._options(job, blind=False)])
            spent = parallel(parts, asked, folder)
            found = [path for path in folder.glob("as*.ini") if "PLTSOLVD=T" in path.read_text("latin-1")]
            told("astap_cli", spent, len(found))


if __name__ == "__main__":
    main()
