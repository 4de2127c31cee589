"""Print whether 200 event streams and 50 requests per second cost the service an event, or ever more memory.

A service of its own with a fake mount. Listeners follow `/v1/events` without pause; one in twenty drops its
connection again and again and resumes by Last-Event-ID. Other clients send requests at a fixed pace, by REST
and by Alpaca, and orders (slews, looks, stops) that make events. At the end each listener must have heard
each event once and in order. Memory is the service's own RSS (and its solver's); growth is told of the
second half. For a quarter of an hour SQLite's page caches fill while the journal grows: runs of half an hour
and more fail if it still grows after that. With `--trace` the service runs under tracemalloc (slower):
what it holds more at the end than after a third is printed by line.

Run: python -m benchmarks.faces_load [--minutes 10] [--listeners 200] [--rate 50] [--trace]
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np

from benchmarks.latency import Served, ready

DROP_EVERY_S = 7.0
ORDERS_EVERY_S = 0.7
SAMPLES_EVERY_S = 2.0
WARM_AFTER_MINUTES = 15.0
STEADY_MB_PER_MINUTE = 0.1
# small rings: full after the warm-up, so that what still grows is a leak
SETTINGS = """
[service]
port = 0
events_kept = 500
jobs_kept = 50
[site]
latitude_deg = 48.93
longitude_deg = 22.27
[[telescope]]
id = "east"
exposure_s = 0.5
scale_arcsec_px = 4.0
mount = { url = "fake+lx200://?dialect=onstep", slew_rate_deg_s = 30.0 }
camera = { kind = "simulated", width_px = 800, height_px = 600, scale_arcsec_px = 4.0 }
"""
EAST = "/v1/telescopes/east"
REQUESTS = (
    EAST,
    "/v1/health",
    "/v1/jobs?limit=5",
    "/api/v1/telescope/0/rightascension?ClientID=7&ClientTransactionID=1",
    EAST,
    "/v1/journal?limit=5",
    "/api/v1/telescope/0/slewing?ClientID=7&ClientTransactionID=1",
)


@dataclass(slots=True)
class Listener:
    """One who follows the events.

    Attributes
    ----------
    port : int
    drops : bool
        Whether it drops its connection now and then, and resumes.
    numbers : list of int
        Of the events, as they came.
    gaps, drops_done : int
    """

    port: int
    drops: bool
    numbers: list[int] = field(default_factory=list)
    last_id: str = ""
    gaps: int = 0
    drops_done: int = 0
    listening: asyncio.Event = field(default_factory=asyncio.Event)

    async def follow(self) -> None:
        """Listen until cancelled."""
        while True:
            reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
            resume = f"Last-Event-ID: {self.last_id}\r\n" if self.last_id else ""
            writer.write(f"GET /v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\n{resume}\r\n".encode())
            try:
                async with asyncio.timeout(DROP_EVERY_S if self.drops else None):
                    async for line in _lines(reader):
                        self._take(line)
            except TimeoutError:
                self.drops_done += 1
            finally:
                writer.close()

    def _take(self, line: str) -> None:
        self.listening.set()
        name, _, value = line.partition(": ")
        if name == "id":
            self.last_id = value
            self.numbers.append(int(value.rpartition("-")[2]))
        elif name == "event" and value == "gap":
            self.gaps += 1

    @property
    def lost(self) -> int:
        """Events that are missing between the first and the last that it heard."""
        heard = set(self.numbers)
        return 0 if not heard else max(heard) - min(heard) + 1 - len(heard)

    @property
    def disorder(self) -> int:
        """Events that came twice or too late."""
        return sum(after <= before for before, after in itertools.pairwise(self.numbers))


async def _lines(reader: asyncio.StreamReader) -> AsyncIterator[str]:
    """The lines of a chunked answer's body."""
    head = await reader.readuntil(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200 "), head
    assert b"transfer-encoding: chunked" in head.lower(), head
    rest = b""
    while size := int((await reader.readline()).split(b";")[0], 16):
        rest += (await reader.readexactly(size + 2))[:-2]
        *whole, rest = rest.split(b"\n")
        for line in whole:
            yield line.decode().rstrip("\r")


@dataclass(slots=True)
class Sent:
    """What became of the requests."""

    took_ms: list[float] = field(default_factory=list)
    statuses: Counter[int] = field(default_factory=Counter)
    late: int = 0
    again: int = 0


async def ask_at_pace(port: int, rate: float, until: float, sent: Sent) -> None:
    """Send the requests in turn, each at its time, however long the others take."""
    limits = httpx.Limits(max_connections=20, max_keepalive_connections=20, keepalive_expiry=2.0)
    base = f"http://127.0.0.1:{port}"
    async with (
        httpx.AsyncClient(base_url=base, timeout=60, limits=limits, trust_env=False) as client,
        asyncio.TaskGroup() as tasks,
    ):
        began = time.monotonic()
        for number, path in enumerate(itertools.cycle(REQUESTS)):
            due = began + number / rate
            if due > until:
                return
            if due > time.monotonic():
                await asyncio.sleep(due - time.monotonic())
            elif time.monotonic() - due > 1.0:
                sent.late += 1
            tasks.create_task(_ask(client, path, sent))


async def _ask(client: httpx.AsyncClient, path: str, sent: Sent) -> None:
    began = time.perf_counter()
    try:
        answer = await client.get(path)
    except httpx.ReadError:
        # one that idled may be closed just as the request goes out: HTTP's own race, any client asks again
        sent.again += 1
        answer = await client.get(path)
    sent.took_ms.append(1000.0 * (time.perf_counter() - began))
    sent.statuses[answer.status_code] += 1


async def order_things(port: int, until: float, statuses: Counter[int]) -> None:
    """Slews, looks and stops, so that there is something to tell."""
    base = f"http://127.0.0.1:{port}"
    # a connection of its own for each: one that idles may be closed just as the next order goes out
    fresh = httpx.Limits(max_keepalive_connections=0)
    async with httpx.AsyncClient(base_url=base, timeout=60, limits=fresh, trust_env=False) as client:
        state = (await client.get(EAST)).json()
        ra_deg = float(state["icrs"]["ra_deg"])
        for number in itertools.count():
            if time.monotonic() > until:
                return
            place = {"ra_deg": (ra_deg + 5.0 * (number % 4)) % 360.0, "dec_deg": 45.0 + 5.0 * (number % 3)}
            match number % 5:
                case 4:
                    answer = await client.post(f"{EAST}/stop")
                case 1 | 3:
                    answer = await client.post(f"{EAST}/look?supersede=true")
                case _:
                    answer = await client.post(f"{EAST}/slew?supersede=true", json=place)
            statuses[answer.status_code] += 1
            await asyncio.sleep(ORDERS_EVERY_S)


def rss_mb(pid: int) -> float:
    """RSS of one process, MB."""
    found = re.search(r"^VmRSS:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text(), re.M)
    return 0.0 if found is None else int(found[1]) / 1000.0


def children(pid: int) -> list[int]:
    """Of a process, at any depth."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found += [int(child), *children(int(child))]
    return found


async def sample(pid: int, until: float, samples: list[tuple[float, float, float]]) -> None:
    """Seconds, RSS of the service, RSS of what it started."""
    began = time.monotonic()
    while time.monotonic() < until:
        with suppress(FileNotFoundError, ProcessLookupError):
            others = sum(rss_mb(one) for one in children(pid))
            samples.append((time.monotonic() - began, rss_mb(pid), others))
        await asyncio.sleep(SAMPLES_EVERY_S)


@contextmanager
def serving(folder: Path, *, trace: bool) -> Iterator[Served]:
    """A service in a process of its own; with `trace` it marks as `traced` says."""
    settings = folder / "observatory.toml"
    settings.write_text(SETTINGS)
    module = ["-m", "benchmarks.faces_load", "--traced", str(folder)] if trace else ["-m", "api.main"]
    environment = {**os.environ, "MOUNTNAV_JOURNAL": str(folder / "journal.sqlite")}
    with (
        (folder / "log").open("w+b") as log,
        subprocess.Popen(
            [sys.executable, *module, "serve", "--config", str(settings)],
            stdout=log,
            stderr=log,
            env=environment,
        ) as process,
    ):
        try:
            yield ready(process, folder / "log")
        finally:
            process.send_signal(signal.SIGINT)


def traced(folder: Path) -> None:
    """Be the service, under tracemalloc: asked for mark1 it marks, for mark2 it writes what is held more."""
    import gc
    import threading
    import tracemalloc

    from api.main import main as serve

    marks: list[tracemalloc.Snapshot] = []

    def mark() -> None:
        gc.collect()
        ours = [tracemalloc.Filter(False, tracemalloc.__file__)]
        marks.append(tracemalloc.take_snapshot().filter_traces(ours))
        if len(marks) == 2:
            differences = marks[1].compare_to(marks[0], "lineno")
            total_kb = sum(one.size_diff for one in differences) / 1000.0
            lines = [
                f"{one.size_diff / 1000.0:+9.1f} kB {one.count_diff:+6d} {one.traceback}"
                for one in differences[:15]
            ]
            (folder / "held").write_text("\n".join([f"{total_kb:+.1f} kB in all", *lines]), encoding="utf-8")
        (folder / f"mark{len(marks)}").touch()

    def mark_when_asked() -> None:
        while len(marks) < 2:
            time.sleep(0.5)
            if (folder / f"ask-mark{len(marks) + 1}").exists():
                mark()

    tracemalloc.start(1)
    threading.Thread(target=mark_when_asked, daemon=True).start()
    sys.argv = ["mountnav", *sys.argv[3:]]
    serve()


async def load(served: Served, asked: argparse.Namespace, folder: Path) -> bool:
    """Do it all; whether nothing was lost and nothing grew."""
    seconds = 60.0 * asked.minutes
    until = time.monotonic() + seconds
    listeners = [Listener(served.port, drops=number % 20 == 19) for number in range(asked.listeners)]
    following = [asyncio.create_task(one.follow()) for one in listeners]
    await asyncio.gather(*(one.listening.wait() for one in listeners))
    sent, ordered = Sent(), Counter[int]()
    samples: list[tuple[float, float, float]] = []

    async def mark(after_s: float, name: str) -> None:
        await asyncio.sleep(after_s)
        if asked.trace:
            (folder / f"ask-{name}").touch()
            while not (folder / name).exists():  # noqa: ASYNC110 - another process makes it
                await asyncio.sleep(0.1)

    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(ask_at_pace(served.port, asked.rate, until, sent))
        tasks.create_task(order_things(served.port, until, ordered))
        tasks.create_task(sample(served.process.pid, until, samples))
        tasks.create_task(mark(0.3 * seconds, "mark1"))
    # a last event that all of them must hear, also those who are away at this moment
    before = max((one.numbers[-1] for one in listeners if one.numbers), default=0)
    served.ask("POST", f"{EAST}/look")
    with suppress(TimeoutError):
        async with asyncio.timeout(60.0):
            while not all(one.numbers and one.numbers[-1] > before for one in listeners):  # noqa: ASYNC110
                await asyncio.sleep(0.1)
    await mark(0.0, "mark2")
    for task in following:
        task.cancel()
    await asyncio.gather(*following, return_exceptions=True)
    return told(listeners, sent, ordered, samples, before)


def told(
    listeners: list[Listener],
    sent: Sent,
    ordered: Counter[int],
    samples: list[tuple[float, float, float]],
    last: int,
) -> bool:
    """Print all of it; whether it is good."""
    heard = [len(one.numbers) for one in listeners]
    lost, disorder = sum(one.lost for one in listeners), sum(one.disorder for one in listeners)
    late = sum(not one.numbers or one.numbers[-1] <= last for one in listeners)
    gaps, drops = sum(one.gaps for one in listeners), sum(one.drops_done for one in listeners)
    print(
        f"{len(listeners)} listeners heard {min(heard)} to {max(heard)} events each ({sum(heard)} in all): "
        f"{lost} lost, {disorder} twice or out of order, {gaps} gaps, {late} didn't hear the last; "
        f"{drops} dropped connections were resumed"
    )
    p50, p99 = np.percentile(sent.took_ms, [50, 99])
    print(
        f"{len(sent.took_ms)} requests, statuses {dict(sent.statuses)}, {sent.late} sent over 1 s late, "
        f"{sent.again} sent again; "
        f"p50 {p50:.1f} ms, p99 {p99:.1f} ms, max {max(sent.took_ms):.1f} ms; orders {dict(ordered)}"
    )
    table = np.array(samples)
    half = table[len(table) // 2 :]
    growth = 60.0 * float(np.polyfit(half[:, 0], half[:, 1], 1)[0]) if len(half) > 2 else float("nan")
    tenth = max(1, len(table) // 10)
    print(
        f"RSS of the service: {table[0, 1]:.1f} MB at first, {np.median(half[:tenth, 1]):.1f} at half time, "
        f"{np.median(table[-tenth:, 1]):.1f} at the end, {table[:, 1].max():.1f} at most; in the second "
        f"half {growth:+.2f} MB a minute; of its solver {table[0, 2]:.1f} at first, "
        f"{np.median(table[-tenth:, 2]):.1f} MB at the end"
    )
    warm = half[0, 0] >= 60.0 * WARM_AFTER_MINUTES * 0.99
    grows = bool(warm and growth > STEADY_MB_PER_MINUTE)
    good = lost == disorder == gaps == late == 0 and all(status < 500 for status in sent.statuses)
    good = good and not grows
    steady = " and memory didn't grow" if warm else ""
    print(f"no event was lost{steady}" if good else "NOT GOOD: see above")
    return good


def main() -> int:
    """Run; 0 only if nothing was lost."""
    if sys.argv[1:2] == ["--traced"]:
        traced(Path(sys.argv[2]))
        return 0
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--listeners", type=int, default=200)
    parser.add_argument("--rate", type=float, default=50.0, help="requests per second")
    parser.add_argument("--trace", action="store_true", help="the service under tracemalloc")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            with serving(folder, trace=asked.trace) as served:
                good = asyncio.run(load(served, asked, folder))
        except* (httpx.HTTPError, OSError):
            print((folder / "log").read_text(encoding="utf-8")[-3000:])
            raise
        if asked.trace:
            print((folder / "held").read_text(encoding="utf-8"))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
