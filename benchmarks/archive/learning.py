"""What a learned scale saves: the same drawn frames solved without it and with it, by whole archive runs.

    python -m benchmarks.archive.learning [--preset E] [--frames 9] [--radius 5] [--wrong 2]

Each frame is told its place within the radius and no scale; with --wrong, a scale wrong by that factor. CPU
seconds of all processes; starting them is taken out by the difference of a long part and a short one.
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.peers.drawing import PRESETS, drawn
from benchmarks.peers.running import Job
from mountnav.archive.folder import Folder
from mountnav.archive.tables import read_rows
from mountnav.catalog.embedded import embedded_catalog
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

COPIES = 4
"""Each frame is solved so often: drawing takes longer than solving."""


def listed(jobs: list[Job], table: Path, radius_deg: float, wrong: float) -> None:
    """Name the frames, each several times, with what is told of them."""
    with open(table, "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(
            ["file", "ra_deg", "dec_deg", "radius_deg", "scale_low_arcsec_px", "scale_high_arcsec_px"]
        )
        for copy in range(COPIES):
            for job in jobs:
                name = job.path.with_name(f"{copy}-{job.path.name}")
                os.link(job.path, name)
                center = job.hint.center
                assert center is not None
                scales = [wrong * float(side or 0.0) for side in _bounds(job)] if wrong else ["", ""]
                rows.writerow([name, center.ra_deg, center.dec_deg, radius_deg, *scales])


def _bounds(job: Job) -> tuple[float | None, float | None]:
    return job.hint.scale_low_arcsec_px, job.hint.scale_high_arcsec_px


def cpu_s(*words: str) -> float:
    """CPU seconds of a command and all that it starts."""
    before = os.times()
    subprocess.run([sys.executable, "-m", "api.main", "archive", *words], check=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def judged(archive: Path, jobs: list[Job], learned: bool) -> str:
    """What became of the frames."""
    run = Folder.open(archive).run(None)
    solved = false = held = 0
    for chunk in sorted(run.done()):
        held += sum(row["prior"] == "held" for row in read_rows(run.chunk(chunk) / "frames.parquet"))
        for row in read_rows(run.chunk(chunk) / "solutions.parquet"):
            job = jobs[int(row["number"] or 0) % len(jobs)]
            solved += 1
            place = Icrs(float(row["ra_deg"] or 0.0), float(row["dec_deg"] or 0.0))
            false += separation_arcsec(place, job.center) > 5.0 * job.scale_arcsec_px
    return f"{solved} of {COPIES * len(jobs)} solved, {false} false" + (f", {held} by it" if learned else "")


def main() -> None:
    """Measure both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", choices=tuple(PRESETS), default="E")
    parser.add_argument("--frames", type=int, default=9)
    parser.add_argument("--radius", type=float, default=5.0)
    parser.add_argument("--wrong", type=float, default=0.0)
    parser.add_argument("--blind", action="store_true", help="with the index of the whole sky")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as there:
        where = Path(there)
        jobs = [drawn(asked.preset, at, 4, embedded_catalog(), where) for at in range(asked.frames)]
        listed(jobs, where / "frames.csv", asked.radius, asked.wrong)
        archive = str(where / "archive")
        words = ["--frames", str(where / "frames.csv"), "--undated", "2026-01-01"]
        if not asked.blind:
            words.append("--no-blind")
        cpu_s("init", archive, "--chunk-frames", str(asked.frames), *words)
        for learned in (False, True):
            if learned:
                print(f"learn: {cpu_s('learn', archive):.1f} CPU s", flush=True)
            short = cpu_s("work", archive, "--chunk", f"1/{COPIES}")
            long = cpu_s("work", archive) - short
            frame_s = long / (COPIES - 2) / asked.frames
            told = judged(Path(archive), jobs, learned)
            print(f"{'with' if learned else 'without'}: {frame_s:.3f} CPU s a frame; {told}", flush=True)


if __name__ == "__main__":
    main()
