"""Print what identifying a measured frame costs in CPU, hinted; and how that compares with another checkout.

Run: python -m benchmarks.identification [--against FOLDER] [word in the file's name]

Every rendered frame is measured once; both checkouts then identify the same lists, in turns.
"""

from __future__ import annotations

import argparse
import os
import pickle
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

REPEATS = 7
TURNS = 2
TITLES = ("frame", "pairs", "identify ms", "of it the plate ms")

Row = tuple[int, float, float]
"""Pairs, CPU seconds of `identify`, and of growing the plate."""


def measured(word: str) -> list[tuple[str, Any]]:
    """Names of the rendered frames, and the arguments of `identify`."""
    from benchmarks.frames import rendered, shared_folder
    from mountnav.measuring.measure import measure
    from mountnav.reading import demosaiced, read_frame
    from mountnav.units import julian_year

    out = []
    for known in rendered(shared_folder()):
        if word not in known.path.name:
            continue
        frame = read_frame(known.path, raw=True)
        epoch_yr = 2026.0 if frame.mid_exposure_utc is None else julian_year(frame.mid_exposure_utc)
        out.append((known.path.name, (measure(demosaiced(frame)), known.hint, epoch_yr)))
    return out


def timed(lists: list[tuple[str, Any]]) -> dict[str, Row]:
    """Best CPU times of several runs in this process, with whatever mountnav is imported here."""
    from mountnav.catalog.embedded import embedded_catalog
    from mountnav.identification import reference
    from mountnav.identification.search import identify

    catalog, grow, spent = embedded_catalog(), reference.Selection.grow, [0.0]

    def clocked(*arguments: Any) -> Any:
        began = time.process_time()
        try:
            return grow(*arguments)
        finally:
            spent[0] += time.process_time() - began

    setattr(reference.Selection, "grow", clocked)  # noqa: B010  (a method is replaced on purpose)
    rows: dict[str, Row] = {}
    for name, (measurements, hint, epoch_yr) in lists:
        times = []
        for _ in range(REPEATS):
            spent[0], began = 0.0, time.process_time()
            found = identify(measurements, catalog, hint, epoch_yr=epoch_yr)
            times.append((time.process_time() - began, spent[0]))
        pairs = 0 if found.reference is None else len(found.reference.pairs)
        rows[name] = (pairs, min(one[0] for one in times), min(one[1] for one in times))
    return rows


def elsewhere(lists: Path, checkout: Path) -> dict[str, Row]:
    """`timed` in a process of its own, with the mountnav of a checkout."""
    command = [sys.executable, "-P", str(Path(__file__).resolve()), "--worker", str(lists)]
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    said = subprocess.run(command, cwd=checkout, env=environment, check=True, capture_output=True)
    rows: dict[str, Row] = pickle.loads(said.stdout)
    return rows


def best(turns: list[dict[str, Row]]) -> dict[str, Row]:
    """The least times of several turns."""
    return {
        name: (row[0], min(one[name][1] for one in turns), min(one[name][2] for one in turns))
        for name, row in turns[0].items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("word", nargs="?", default="")
    parser.add_argument("--against", type=Path, help="folder of another checkout of this project")
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.worker is not None:
        sys.stdout.buffer.write(pickle.dumps(timed(pickle.loads(chosen.worker.read_bytes()))))
        return
    here = Path(__file__).resolve().parents[1]
    checkouts = [here] if chosen.against is None else [chosen.against.resolve(), here]
    with tempfile.TemporaryDirectory() as folder:
        lists = Path(folder) / "lists.pickle"
        lists.write_bytes(pickle.dumps(measured(chosen.word)))
        turns = [[elsewhere(lists, one) for one in checkouts] for _ in range(TURNS)]
    *other, ours = (best([turn[number] for turn in turns]) for number in range(len(checkouts)))
    titles = TITLES if not other else (*TITLES, "pairs there", "identify", "plate")
    print("| " + " | ".join(titles) + " |")
    print("|---" * len(titles) + "|")
    for name, (pairs, whole_s, plate_s) in ours.items():
        cells = [name.split(".")[0], str(pairs), f"{1e3 * whole_s:.1f}", f"{1e3 * plate_s:.1f}"]
        if other:
            there, whole, plate = other[0][name]
            cells += [str(there), f"{whole / whole_s:.1f} ×", f"{plate / max(plate_s, 1e-9):.1f} ×"]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
