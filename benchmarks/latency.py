"""Print how long a status answer and a stop take while frames are solved without pause, against without.

A service of its own with a fake mount; two clients, each a process, send a drawn 9.3 Mpx frame again and
again; a third asks for the telescope's state and stops it. Memory is the proportional set size (PSS) of the
service and of its solving process at the end, the mapped catalog included.

Run: python -m benchmarks.latency [seconds] [--threads]    (--threads: without the worker, in threads)
"""

from __future__ import annotations

import http.client
import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np

from api.solver.process import as_fits
from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs

SECONDS = 20.0
CLIENTS = 2
SIDE_PX = 3056
SCALE_ARCSEC_PX = 2.06
PLACE = Icrs(85.0, 30.0)
QUERY = (
    f"ra_deg={PLACE.ra_deg + 0.3}&dec_deg={PLACE.dec_deg}&radius_deg=1"
    f"&scale_low_arcsec_px={0.95 * SCALE_ARCSEC_PX}&scale_high_arcsec_px={1.05 * SCALE_ARCSEC_PX}&blind=never"
)
SETTINGS = """
[service]
port = {port}
[solving]
worker = {worker}
[site]
latitude_deg = 47.0
longitude_deg = 11.0
[[telescope]]
id = "east"
mount = {{ url = "fake+lx200://" }}
camera = {{ kind = "simulated", width_px = 800, height_px = 600, scale_arcsec_px = 4.0 }}
"""


@dataclass(frozen=True, slots=True)
class Served:
    """A running service.

    Attributes
    ----------
    process : subprocess.Popen
    port : int
    """

    process: subprocess.Popen[bytes]
    port: int

    def ask(self, method: str, path: str) -> dict[str, object]:
        """Answer of one request."""
        link = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        link.request(method, path)
        answer: dict[str, object] = json.loads(link.getresponse().read())
        link.close()
        return answer


def ready(process: subprocess.Popen[bytes], log: Path) -> Served:
    """A service that was just started, as soon as its solver is warm; its port is the one that it logs."""
    while True:
        time.sleep(0.2)
        said = log.read_text(encoding="utf-8", errors="replace")
        assert process.poll() is None, f"the service did not start: {said}"
        at = re.search(r"observatory at http://127\.0\.0\.1:(\d+)", said)
        if at is not None:
            break
    served = Served(process, int(at[1]))
    while served.ask("GET", "/v1/health")["solver"] not in ("ready", "in this process"):
        time.sleep(0.2)
    return served


def started(folder: Path, *, worker: bool) -> Served:
    settings, log = folder / "observatory.toml", folder / "log"
    settings.write_text(SETTINGS.format(port=0, worker=str(worker).lower()))
    with log.open("wb") as told:
        process = subprocess.Popen(
            [sys.executable, "-m", "api.main", "serve", "--config", str(settings)], stdout=told, stderr=told
        )
    return ready(process, log)


def solve_on(port: int, content: bytes, stop: Event, times: multiprocessing.SimpleQueue[float]) -> None:
    """Send the frame until told to stop."""
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    while not stop.is_set():
        began = time.perf_counter()
        link.request("POST", f"/v1/solve?{QUERY}", content, {"Content-Type": "application/fits"})
        answer = json.loads(link.getresponse().read())
        assert answer["solved"], answer
        times.put(time.perf_counter() - began)


def probed(port: int, seconds: float, method: str, path: str, pause_s: float) -> list[float]:
    """Latencies of one request, over and over, in seconds."""
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    taken = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        began = time.perf_counter()
        link.request(method, path)
        answer = link.getresponse()
        answer.read()
        taken.append(time.perf_counter() - began)
        assert answer.status == 200, answer.status
        time.sleep(pause_s)
    return taken


def both_probed(port: int, seconds: float) -> dict[str, list[float]]:
    return {
        "GET /v1/telescopes/east": probed(port, seconds / 2, "GET", "/v1/telescopes/east", 0.01),
        "GET /v1/health": probed(port, seconds / 8, "GET", "/v1/health", 0.01),
        "POST .../stop": probed(port, seconds * 3 / 8, "POST", "/v1/telescopes/east/stop", 0.01),
    }


def while_solving(
    port: int, content: bytes, work: Callable[[], dict[str, list[float]]]
) -> tuple[dict[str, list[float]], list[float]]:
    """What `work` finds while the clients send frames, and how long each of their frames took."""
    context = multiprocessing.get_context("spawn")
    stop, times = context.Event(), context.SimpleQueue()
    clients = [context.Process(target=solve_on, args=(port, content, stop, times)) for _ in range(CLIENTS)]
    for one in clients:
        one.start()
    for _ in range(CLIENTS):
        times.get()  # all are at work
    found = work()
    stop.set()
    solves = []
    while any(one.is_alive() for one in clients) or not times.empty():
        while not times.empty():
            solves.append(times.get())
        time.sleep(0.05)
    return found, solves


def pss_mb(pid: int) -> dict[int, float]:
    """PSS of a process and its children, MB."""
    own = re.search(r"^Pss:\s+(\d+) kB", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.M)
    assert own is not None
    found = {pid: int(own[1]) / 1000.0}
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found |= pss_mb(int(child))
    return found


def row(values: list[float]) -> list[float]:
    return [1000.0 * float(value) for value in (*np.percentile(values, [50, 99]), max(values))]


def main() -> None:
    numbers = [one for one in sys.argv[1:] if not one.startswith("-")]
    seconds = float(numbers[0]) if numbers else SECONDS
    worker = "--threads" not in sys.argv
    optics = SimulatedOptics(SIDE_PX, SIDE_PX, SCALE_ARCSEC_PX)
    instant = datetime(2026, 11, 21, tzinfo=UTC)
    frame = draw_frame(
        PLACE, optics, embedded_catalog(), exposure_s=5.0, mid_exposure_utc=instant, seed=(4, 1)
    )
    content = as_fits(frame)
    with tempfile.TemporaryDirectory() as folder:
        served = started(Path(folder), worker=worker)
        try:
            both_probed(served.port, 2.0)
            idle = both_probed(served.port, seconds)
            busy, solves = while_solving(served.port, content, lambda: both_probed(served.port, seconds))
            memory = pss_mb(served.process.pid)
        finally:
            served.process.send_signal(signal.SIGTERM)
            served.process.wait()
    print(
        f"{'worker process' if worker else 'threads'}, {os.cpu_count()} cores, {CLIENTS} clients; "
        f"{len(solves)} frames of {SIDE_PX}² solved meanwhile, median "
        f"{1000 * float(np.median(solves)):.0f} ms from request to answer\n"
    )
    print("| request, ms | idle p50 | p99 | max | solving p50 | p99 | max | ratio p50 | p99 |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in idle:
        one, two = row(idle[name]), row(busy[name])
        cells = [f"{value:.1f}" for value in (*one, *two)] + [f"{two[i] / one[i]:.1f}" for i in (0, 1)]
        print(f"| {name} ({len(busy[name])}) | {' | '.join(cells)} |")
    pids = list(memory)
    told = ", ".join(f"{'service' if pid == pids[0] else 'solver'} {memory[pid]:.0f}" for pid in pids)
    print(f"\nmemory, PSS in MB: {told}; together {sum(memory.values()):.0f}")


if __name__ == "__main__":
    main()
