"""Print how long answers about a telescope's state take while frames are solved in a loop, against without.

A service of its own with a fake mount; a client in a process of its own sends a drawn 9.3 Mpx frame again
and again, each is solved in the solver's process; another asks for the state by each way that programs take.
Wanted: p99 below 10 ms while solving. A bare asyncio server on the same machine, asked in the same way at the
same time, tells what of it is the machine's.

Run: python -m benchmarks.state_latency [--seconds 20] [--solvers 1] [--profile FILE]
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import http.client
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np

from api.solver.process import as_fits
from benchmarks.latency import PLACE, SCALE_ARCSEC_PX, SETTINGS, SIDE_PX, Served, ready, solve_on
from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame

WANTED_MS = 10.0
PAUSE_S = 0.004
EAST = "/v1/telescopes/east"
WAYS = {
    "REST": ("GET", EAST, {}, 200),
    "REST, not modified": ("GET", EAST, {"If-None-Match": "*"}, 304),
    "Alpaca": ("GET", "/api/v1/telescope/0/rightascension?ClientID=1&ClientTransactionID=2", {}, 200),
    "health": ("GET", "/v1/health", {}, 200),
}
CONTROL = "a bare server"


@contextmanager
def serving(folder: Path, profile: str | None) -> Iterator[Served]:
    """A service in a process of its own, warm; with `profile` under cProfile."""
    settings = folder / "observatory.toml"
    settings.write_text(SETTINGS.format(port=0, worker="true"))
    profiled = [] if profile is None else ["-m", "cProfile", "-o", profile]
    command = [sys.executable, *profiled, "-m", "api.main", "serve", "--config", str(settings)]
    with (
        (folder / "log").open("w+b") as log,
        subprocess.Popen(command, stdout=log, stderr=log) as process,
    ):
        try:
            yield ready(process, folder / "log")
        finally:
            process.send_signal(signal.SIGINT)


def bare_server(ports: multiprocessing.SimpleQueue[int]) -> None:
    """Answer anything at once."""

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(asyncio.IncompleteReadError):
            while await reader.readuntil(b"\r\n\r\n"):
                writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}")

    async def serve() -> None:
        server = await asyncio.start_server(answer, "127.0.0.1", 0)
        ports.put(server.sockets[0].getsockname()[1])
        await server.serve_forever()

    asyncio.run(serve())


def probed(port: int, bare_port: int, seconds: float) -> dict[str, list[float]]:
    """Latencies of each way in turn, milliseconds."""
    link, bare = (http.client.HTTPConnection("127.0.0.1", one, timeout=60) for one in (port, bare_port))
    taken: dict[str, list[float]] = {name: [] for name in (*WAYS, CONTROL)}
    etag, end = "", time.monotonic() + seconds
    while time.monotonic() < end:
        for name in taken:
            method, path, headers, wanted = WAYS.get(name, ("GET", "/", {}, 200))
            if "If-None-Match" in headers:
                headers = {"If-None-Match": etag}
            to = bare if name == CONTROL else link
            began = time.perf_counter()
            to.request(method, path, headers=headers)
            answer = to.getresponse()
            answer.read()
            took_ms = 1000.0 * (time.perf_counter() - began)
            etag = answer.getheader("ETag") or etag
            # a state that changed between the two questions is a whole answer
            assert answer.status in (wanted, 200), (name, answer.status)
            taken[name].append(took_ms)
            time.sleep(PAUSE_S)
    return taken


@contextmanager
def solving(port: int, content: bytes, clients: int) -> Iterator[list[float]]:
    """Meanwhile frames are solved; the list holds how long each took, s, afterwards."""
    context = multiprocessing.get_context("spawn")
    stop: Event = context.Event()
    times: multiprocessing.SimpleQueue[float] = context.SimpleQueue()
    senders = [context.Process(target=solve_on, args=(port, content, stop, times)) for _ in range(clients)]
    for one in senders:
        one.start()
    # all are at work
    solves = [times.get() for _ in senders]
    solves.clear()
    yield solves
    stop.set()
    while any(one.is_alive() for one in senders) or not times.empty():
        while not times.empty():
            solves.append(times.get())
        time.sleep(0.05)


def main() -> int:
    """Measure, print, and return 0 only if the wanted figure is reached."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--solvers", type=int, default=1, help="clients that have frames solved in a loop")
    parser.add_argument("--profile", help="write a profile of the service here (slows it)")
    asked = parser.parse_args()
    optics = SimulatedOptics(SIDE_PX, SIDE_PX, SCALE_ARCSEC_PX)
    instant = datetime(2026, 11, 21, tzinfo=UTC)
    frame = draw_frame(
        PLACE, optics, embedded_catalog(), exposure_s=5.0, mid_exposure_utc=instant, seed=(4, 1)
    )
    context = multiprocessing.get_context("spawn")
    ports: multiprocessing.SimpleQueue[int] = context.SimpleQueue()
    bare = context.Process(target=bare_server, args=(ports,), daemon=True)
    bare.start()
    try:
        with tempfile.TemporaryDirectory() as folder, serving(Path(folder), asked.profile) as served:
            bare_port = ports.get()
            probed(served.port, bare_port, 2.0)
            idle = probed(served.port, bare_port, asked.seconds)
            with solving(served.port, as_fits(frame), asked.solvers) as solves:
                busy = probed(served.port, bare_port, asked.seconds)
    finally:
        bare.terminate()
    return told(idle, busy, solves, asked.seconds)


def told(
    idle: dict[str, list[float]], busy: dict[str, list[float]], solves: list[float], seconds: float
) -> int:
    """Print the table; 0 only if every way's p99 is as wanted."""
    print(
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; {len(solves)} frames of {SIDE_PX}² solved "
        f"in {seconds:.0f} s, median {1000.0 * float(np.median(solves)):.0f} ms from request to answer\n"
    )
    print("| answer, ms | idle p50 | p99 | max | solving p50 | p99 | max |")
    print("|---|---|---|---|---|---|---|")
    good = True
    for name in idle:
        cells = [
            f"{value:.1f}"
            for values in (idle[name], busy[name])
            for value in (*np.percentile(values, [50, 99]), max(values))
        ]
        good = good and (name == CONTROL or float(np.percentile(busy[name], 99)) < WANTED_MS)
        print(f"| {name} ({len(busy[name])}) | {' | '.join(cells)} |")
    print(f"\nwanted: p99 below {WANTED_MS:.0f} ms while solving: {'reached' if good else 'NOT reached'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
