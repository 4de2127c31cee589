"""Print what one service with many telescopes and a solver pool needs: state latency, stop of all, memory.

A service in a process of its own with fake mounts and simulated cameras. Some of them look and are solved
all the time, one of these sends looks as fast as they are taken (the storm). Meanwhile a client asks for the
state of all, and another telescope's looks are timed beside the storm. Then all are slewed, and STOP ALL is
given. Memory is the proportional set size (PSS) of the service and of all it started, the largest seen.

Wanted: p99 of the state below 20 ms, STOP ALL below 2 s, at most 600 MB. A bare server on the same machine,
asked in the same way at the same time, tells what of the latency is the machine's.

Run: python -m benchmarks.twenty_telescopes [--telescopes 20] [--workers 2] [--looking 4] [--seconds 20]
"""

from __future__ import annotations

import argparse
import http.client
import json
import multiprocessing
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.faces_load import children
from benchmarks.latency import Served, ready
from benchmarks.state_latency import bare_server

STATE_MS, STOP_S, MEMORY_MB = 20.0, 2.0, 600.0
"""Wanted of the state's p99, of STOP ALL, and of the memory."""

PAUSE_S = 0.02
"""Between two questions for the state."""

_HEAD = """
[service]
port = 0
[solver]
engine = "pool"
workers = {workers}
[solving]
blind = "never"
[site]
latitude_deg = 47.0
longitude_deg = 11.0
"""
_ONE = """
[[telescope]]
id = "t{number:02d}"
exposure_s = 0.2
[telescope.mount]
url = "fake+lx200://?dialect=onstep"
mounting = "fork"
slew_rate_deg_s = 3.0
[telescope.camera]
kind = "simulated"
width_px = 800
height_px = 600
scale_arcsec_px = 4.0
"""


@dataclass(slots=True)
class Figures:
    """What was measured.

    Attributes
    ----------
    state_ms, bare_ms : list of float
        Of all telescopes' state, and of a bare server.
    looks_s : list of float
        Of one look of the telescope beside the storm, exposure included.
    storm : int
        Looks of the storm meanwhile.
    stop_s : float
    stopped : int
        Telescopes that STOP ALL told as stopped.
    memory_mb : float
    """

    state_ms: list[float] = field(default_factory=list)
    bare_ms: list[float] = field(default_factory=list)
    looks_s: list[float] = field(default_factory=list)
    storm: int = 0
    stop_s: float = 0.0
    stopped: int = 0
    memory_mb: float = 0.0


def settings_of(telescopes: int, workers: int) -> str:
    """Of a service with so many."""
    return _HEAD.format(workers=workers) + "".join(_ONE.format(number=one) for one in range(telescopes))


@contextmanager
def serving(folder: Path, telescopes: int, workers: int) -> Iterator[tuple[Served, int]]:
    """A service in a process of its own, and its number."""
    settings = folder / "observatory.toml"
    settings.write_text(settings_of(telescopes, workers))
    command = [sys.executable, "-m", "api.main", "serve", "--config", str(settings)]
    with (folder / "log").open("w+b") as log, subprocess.Popen(command, stdout=log, stderr=log) as process:
        try:
            yield ready(process, folder / "log"), process.pid
        finally:
            process.send_signal(signal.SIGTERM)


class Client:
    """Asks one service on a connection of its own."""

    def __init__(self, port: int) -> None:
        self._link = http.client.HTTPConnection("127.0.0.1", port, timeout=120)

    def ask(self, method: str, path: str, body: object = None, *, prefer: str = "") -> tuple[int, object]:
        """Ask, and read the answer whole."""
        sent = None if body is None else json.dumps(body)
        headers = {} if sent is None else {"content-type": "application/json"}
        if prefer:
            headers["prefer"] = prefer
        self._link.request(method, path, sent, headers)
        answer = self._link.getresponse()
        content = answer.read()
        return answer.status, json.loads(content) if content else None

    def looked(self, telescope: str) -> None:
        """Have a frame taken and solved, and wait for it."""
        status, job = self.ask("POST", f"/v1/telescopes/{telescope}/look", {})
        while isinstance(job, dict) and status in (200, 202) and job.get("state") in ("queued", "running"):
            status, job = self.ask("GET", f"/v1/jobs/{job['id']}", prefer="wait=30")


def pss_mb(pid: int) -> float:
    """PSS of a process, MB; 0 for one that is gone."""
    with suppress(OSError):
        found = re.search(r"^Pss:\s+(\d+) kB", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.M)
        return 0.0 if found is None else int(found[1]) * 1024 / 1e6
    return 0.0


def measure(served: Served, pid: int, bare: int, telescopes: int, looking: int, seconds: float) -> Figures:
    """Load it for so long, then stop all."""
    found, over = Figures(), threading.Event()

    def storm() -> None:
        client = Client(served.port)
        while not over.is_set():
            client.looked("t00")
            found.storm += 1

    def looks(telescope: str, times: list[float]) -> None:
        client = Client(served.port)
        while not over.is_set():
            began_s = time.monotonic()
            client.looked(telescope)
            times.append(time.monotonic() - began_s)
            over.wait(0.5)

    def memory() -> None:
        while not over.is_set():
            whole = pss_mb(pid) + sum(pss_mb(one) for one in children(pid))
            found.memory_mb = max(found.memory_mb, whole)
            over.wait(1.0)

    threads = [threading.Thread(target=storm), threading.Thread(target=memory)]
    for number in range(1, min(looking, telescopes)):
        times = found.looks_s if number == 1 else []
        threads.append(threading.Thread(target=looks, args=(f"t{number:02d}", times)))
    for one in threads:
        one.start()
    asking, control = Client(served.port), http.client.HTTPConnection("127.0.0.1", bare, timeout=60)
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        began_s = time.perf_counter()
        status, states = asking.ask("GET", "/v1/telescopes")
        found.state_ms.append(1000.0 * (time.perf_counter() - began_s))
        assert status == 200
        assert isinstance(states, list)
        assert len(states) == telescopes
        began_s = time.perf_counter()
        control.request("GET", "/")
        control.getresponse().read()
        found.bare_ms.append(1000.0 * (time.perf_counter() - began_s))
        time.sleep(PAUSE_S)
    over.set()
    for one in threads:
        one.join()
    asking = Client(served.port)  # the other one lay idle, and was let go
    for number in range(telescopes):
        where = {"target": {"kind": "altaz", "alt_deg": 60.0, "az_deg": (90.0 + 7.0 * number) % 360.0}}
        status, refusal = asking.ask("POST", f"/v1/telescopes/t{number:02d}/slew", where)
        assert status == 202, refusal
    began_s = time.monotonic()
    _, told = asking.ask("POST", "/v1/stop")
    found.stop_s = time.monotonic() - began_s
    assert isinstance(told, dict)
    found.stopped = sum(one["stopped"] is True for one in told["telescopes"])
    return found


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; 1 where something is above what is wanted."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--telescopes", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--looking", type=int, default=4, help="telescopes that look all the time")
    parser.add_argument("--seconds", type=float, default=20.0)
    asked = parser.parse_args(arguments)
    context = multiprocessing.get_context("spawn")
    ports: multiprocessing.SimpleQueue[int] = context.SimpleQueue()
    bare = context.Process(target=bare_server, args=(ports,), daemon=True)
    bare.start()
    with (
        tempfile.TemporaryDirectory() as folder,
        serving(Path(folder), asked.telescopes, asked.workers) as (
            served,
            pid,
        ),
    ):
        found = measure(served, pid, ports.get(), asked.telescopes, asked.looking, asked.seconds)
    bare.terminate()
    p50, p99 = np.percentile(found.state_ms, (50, 99))
    bare_p99 = float(np.percentile(found.bare_ms, 99))
    print(f"{asked.telescopes} telescopes, a pool of {asked.workers}, {asked.looking} of them looking")
    print(f"state of all: p50 {p50:.1f} ms, p99 {p99:.1f} ms (a bare server's: {bare_p99:.1f} ms)")
    if found.looks_s:
        print(
            f"a look beside the storm: median {np.median(found.looks_s):.2f} s, "
            f"longest {max(found.looks_s):.2f} s ({len(found.looks_s)} looks; the storm had {found.storm})"
        )
    print(f"stop of all: {found.stop_s:.2f} s, {found.stopped} of {asked.telescopes} told as stopped")
    print(f"memory: {found.memory_mb:.0f} MB")
    good = p99 - bare_p99 < STATE_MS and found.stop_s < STOP_S and found.memory_mb <= MEMORY_MB
    return 0 if good and found.stopped == asked.telescopes else 1


if __name__ == "__main__":
    sys.exit(main())
