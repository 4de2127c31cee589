"""What the bookkeeping of an archive costs: work list, store and report of frames that nobody solves.

    python -m benchmarks.archive.bookkeeping [--frames 100000]

The verdict of one star list, solved once, stands for all that are solved; each hundredth is refused.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

from api.archive.chosen import RunOptions, prepared
from benchmarks.archive.drawn import draw
from mountnav.archive.accounting import status_of, verify
from mountnav.archive.folder import Folder
from mountnav.archive.recipe import begin_run
from mountnav.archive.report import as_html, reported
from mountnav.archive.store import Result, chunk_written
from mountnav.archive.work_list import Entry, WorkList, add_batch
from mountnav.solution import Reason, Times, Verdict
from mountnav.solving.solve import solve_file


def main() -> None:
    """Measure each step."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100_000)
    count = parser.parse_args().frames
    with tempfile.TemporaryDirectory() as there:
        where = Path(there)
        draw(where / "drawn", 2, 1)
        ready = prepared(
            RunOptions(blind="never", ra_deg=0.0, dec_deg=0.0, radius_deg=180.0, scale_arcsec_px=6.0)
        )
        hint = next(_hints(where / "drawn" / "frames.csv"))
        solved = solve_file(where / "drawn/lists/000000.xy", ready.catalog, hint, settings=ready.settings)
        assert solved.solution is not None, solved.detail
        refused = Verdict(None, Reason.NO_MATCH, "drawn", 60, Times())
        began, whole_s = time.process_time(), 0.0

        def told(what: str) -> None:
            nonlocal began, whole_s
            spent = time.process_time() - began
            whole_s += spent
            print(f"{what:12} {spent:7.1f} CPU s  {1e6 * spent / count:7.0f} µs a frame")
            began = time.process_time()

        folder = Folder.make(where / "archive", 1000)
        add_batch(
            folder, (Entry(f"/frames/{n // 1000:04d}/{n:08d}.fits", None, 18_000_000) for n in range(count))
        )
        run, _ = begin_run(folder, ready.recipe)
        told("work list")
        for chunk in WorkList.open(folder).chunks:
            with chunk_written(run, chunk, ready.recipe) as writer:
                for entry in chunk.entries():
                    verdict = refused if entry.number % 100 == 50 else solved
                    writer.add(Result(entry, f"{entry.number:064x}", 18_000_000, verdict))
        told("store")
        assert status_of(folder, run).complete
        told("status")
        page = as_html(reported(folder, run))
        assert str(count) in page
        told("report")
        audit = verify(folder, run)
        assert (audit.trouble_count, audit.counts.frames) == (0, count), audit.troubles[:3]
        told("verify")
        files = [one for one in (where / "archive").rglob("*") if one.is_file()]
        megabytes = sum(one.stat().st_size for one in files) / 1e6
        print(f"whole        {whole_s:7.1f} CPU s; {len(files)} files, {megabytes:.1f} MB")
        print(f"most memory  {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def _hints(table: Path):  # type: ignore[no-untyped-def]
    from api.archive.listing import listed_frames

    return (entry.hint for entry in listed_frames([str(table)], None))


if __name__ == "__main__":
    main()
