"""A warm solver in a process of its own: jobs in as lines of JSON, out what it found and what it took.

Run: python -m benchmarks.peers.resident_worker   (benchmarks.solve starts it)

It does what the service's worker does, file to solution: `solve_file`, with the catalog and the index open.
"""

from __future__ import annotations

import contextlib
import json
import re
import sys
import time
from pathlib import Path
from typing import Any

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Hint
from mountnav.identification.blind.cache import cached_index
from mountnav.sky.coordinates import Icrs
from mountnav.solving.solve import SolveSettings, solve_file


def settings_for(*, blind: bool) -> SolveSettings:
    """Settings of a hinted or a blind run, with the index as the service has it."""
    index = cached_index(embedded_catalog())
    return SolveSettings(index=index, blind="only" if blind else "after")


def status_kb(key: str) -> int:
    """A line of this process's status, kilobytes; 0 where the system has none."""
    try:
        text = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return 0
    match = re.search(rf"^{key}:\s+(\d+) kB", text, re.MULTILINE)
    return int(match.group(1)) if match else 0


def forget_peak() -> None:
    """Let the kernel count the peak memory again."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def answered(job: dict[str, Any], settings: SolveSettings) -> dict[str, Any]:
    """Solve one job."""
    hint = None
    if not job["blind"] and job["ra_deg"] is not None:
        hint = Hint(
            Icrs(job["ra_deg"], job["dec_deg"]), job["radius_deg"], job["scale_low"], job["scale_high"]
        )
    forget_peak()
    began, cpu = time.monotonic(), time.process_time()
    verdict = solve_file(Path(job["path"]), embedded_catalog(), hint, settings=settings)
    took = {"cpu_s": time.process_time() - cpu, "wall_s": time.monotonic() - began}
    memory = {"peak_kb": status_kb("VmHWM"), "own_kb": status_kb("RssAnon")}
    solution = verdict.solution
    if solution is None:
        return took | memory | {"found": None, "note": f"{verdict.reason}: {verdict.detail}"}
    place = [solution.center.ra_deg, solution.center.dec_deg, solution.scale_arcsec_px]
    return took | memory | {"found": place, "note": "", "identify_s": verdict.times.identify_s}


def main() -> None:
    kept: dict[bool, SolveSettings] = {}
    for line in sys.stdin:
        job = json.loads(line)
        blind = bool(job["blind"])
        if blind not in kept:
            kept[blind] = settings_for(blind=blind)
        print(json.dumps(answered(job, kept[blind])), flush=True)


if __name__ == "__main__":
    main()
