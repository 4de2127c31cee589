"""Render frames and let mountnav and other solvers solve them side by side; print a markdown table.

Run: python -m benchmarks.solve [--preset A,B,C,E,D] [--frames 3] [--seed 4] [--hinted | --blind]
         [--peers resident,mountnav,solve-field,astap] [--rendered] [--real] [--json FILE]

Each frame is drawn, solved by one solver after the other, one process at a time, and forgotten. CPU seconds
are user and system time of a program and all it started, so a busy machine changes them little; "resident"
is mountnav in a warm process, as the service keeps it. Solved counts right answers; an answer that is off by
more than 3 px or 1 % in scale is wrong. What a solver is told: benchmarks/peers/ and docs/figures/speed.md.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from benchmarks.frames import shared_folder
from benchmarks.peers.astap import Astap
from benchmarks.peers.drawing import PRESETS, drawn
from benchmarks.peers.given import real_jobs, rendered_jobs
from benchmarks.peers.mountnav_command import MountnavCommand
from benchmarks.peers.mountnav_resident import MountnavResident
from benchmarks.peers.running import Job, Solver
from benchmarks.peers.solve_field import SolveField
from benchmarks.peers.table import Done, rows
from mountnav.catalog.embedded import embedded_catalog
from mountnav.identification.blind.cache import cached_index, index_path

PEERS = ("resident", "mountnav", "solve-field", "astap")
SEED = 4


def say(line: str) -> None:
    """Progress, kept apart from the table."""
    print(line, file=sys.stderr, flush=True)


def solvers(wanted: list[str], work: Path, kept: ExitStack) -> list[Solver]:
    """The wanted solvers that are here; of the others the reason is told."""
    found: list[Solver] = []
    for name in wanted:
        missing = ""
        if name == "resident":
            found.append(MountnavResident(drawn("E", 99, SEED, embedded_catalog(), work)))
        elif name == "mountnav":
            found.append(MountnavCommand(work))
        elif name == "solve-field":
            missing = SolveField.missing()
            if not missing:
                found.append(SolveField(work))
        else:
            missing = Astap.missing()
            if not missing:
                say("writing the embedded catalog as ASTAP's star database")
                found.append(Astap(work, embedded_catalog()))
        if missing:
            say(f"{name} is left out: {missing}")
        else:
            kept.callback(found[-1].close)
    return found


def jobs(said: argparse.Namespace, folder: Path) -> Iterator[Job]:
    """The frames that were asked for, one at a time."""
    letters = said.preset.split(",")
    for letter in letters:
        for number in range(said.frames):
            job = drawn(letter, number, said.seed, embedded_catalog(), folder)
            yield job
            job.path.unlink()
    if said.rendered:
        yield from rendered_jobs(shared_folder(), "".join(letters), folder)
    if said.real:
        yield from real_jobs(shared_folder())


def build_index() -> None:
    """Build the index of the sky if there is none yet, so that no solve pays for it."""
    path = index_path(embedded_catalog())
    if not path.exists():
        say(f"building the index of the sky, {path}")
    cached_index(embedded_catalog())


def compared(said: argparse.Namespace, work: Path, done: list[Done]) -> None:
    """Let every solver solve every frame; what is done so far is in `done` even if interrupted."""
    modes = [False] * (not said.blind) + [True] * (not said.hinted)
    peers = said.peers.split(",")
    if not {"resident", "mountnav"}.isdisjoint(peers):
        build_index()
    with ExitStack() as kept:
        able = solvers(peers, work, kept)
        frames = work / "frames"
        frames.mkdir()
        for job in jobs(said, frames):
            real = job.preset.startswith("real")
            for blind in modes:
                for solver in able:
                    # a real frame is in every format there is, and is asked for blind only
                    if real and not (blind and "mountnav" in solver.name):
                        continue
                    if solver.can(job, blind=blind):
                        continue
                    one = Done(job, blind, solver.name, solver.solve(job, blind=blind))
                    done.append(one)
                    say(told(one))


def told(one: Done) -> str:
    """A line about an attempt."""
    attempt = one.attempt
    error = attempt.error_px(one.job)
    start = f"{one.job.name:4s} {one.asked:6s} {one.solver:17s} {attempt.cpu_s:7.3f} s"
    if attempt.found is None:
        return f"{start}  not solved: {attempt.note}"
    word = "WRONG" if attempt.wrong(one.job) else "right"
    return f"{start}  {word}, {error:.3f} px off" if error is not None else f"{start}  {word}"


def options(words: list[str] | None = None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--preset", default=",".join(PRESETS), help="which kinds of frames")
    parser.add_argument("--frames", type=int, default=3, help="how many of each are drawn")
    parser.add_argument("--seed", type=int, default=SEED, help="another seed, other places")
    parser.add_argument("--peers", default=",".join(PEERS), help="which solvers")
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--hinted", action="store_true", help="only with place (1°) and scale (5 %%)")
    mode.add_argument("--blind", action="store_true", help="only with nothing at all")
    parser.add_argument("--rendered", action="store_true", help="the shared rendered frames too")
    parser.add_argument("--real", action="store_true", help="the shared real frames too, blind")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every attempt here")
    said = parser.parse_args(words)
    for name, known, given in (("preset", tuple(PRESETS), said.preset), ("peers", PEERS, said.peers)):
        unknown = [one for one in given.split(",") if one not in known]
        if unknown:
            parser.error(f"--{name}: no {', '.join(unknown)}; there are {', '.join(known)}")
    if said.frames < 0 or (said.frames == 0 and not (said.rendered or said.real)):
        parser.error("no frames")
    return said


def main(words: list[str] | None = None) -> int:
    said = options(words)
    done: list[Done] = []
    stopped = 0
    # being ended is like Ctrl-C: solvers are ended and files removed
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with tempfile.TemporaryDirectory(prefix="mountnav-solve-") as name:
            compared(said, Path(name), done)
    except KeyboardInterrupt:
        stopped = 130
        say("interrupted; what was done:")
    finally:
        signal.signal(signal.SIGTERM, before)
        if done:
            print("\n".join(rows(done)))
        if said.json is not None:
            text = json.dumps([one.record() for one in done], indent=1, ensure_ascii=False)
            said.json.write_text(text + "\n", encoding="utf-8")
    return stopped


if __name__ == "__main__":
    sys.exit(main())
