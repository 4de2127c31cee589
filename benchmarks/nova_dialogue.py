"""Print how long N.I.N.A.'s whole dialogue with the nova API takes: wall seconds, blind, on a 9.3 Mpx frame.

A service of its own in a process of its own; this one logs in, uploads a drawn frame without any hint, asks
for the submission at once and then each second, for the job likewise, and reads the calibration: each request
by a new connection, as N.I.N.A.'s. With `--flood`, eight processes upload noise meanwhile, and a stop is
ordered ten times a second.

Run: python -m benchmarks.nova_dialogue [dialogues] [--flood]
"""

from __future__ import annotations

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
from datetime import UTC, datetime
from multiprocessing.synchronize import Event
from pathlib import Path
from urllib.parse import urlencode

import numpy as np

from api.solver.process import as_fits
from benchmarks.latency import PLACE, SCALE_ARCSEC_PX, SETTINGS, SIDE_PX, Served, ready
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame

DIALOGUES = 20
FLOODS = 8
FORM = {"Content-Type": "application/x-www-form-urlencoded"}
MULTIPART = {"Content-Type": "multipart/form-data; boundary=bound"}


def asked(
    port: int, method: str, path: str, body: bytes = b"", headers: dict[str, str] | None = None
) -> dict:
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    link.request(method, path, body or None, headers or {})
    answer = link.getresponse()
    told = json.loads(answer.read())
    link.close()
    return dict(told, http=answer.status)


def login(port: int) -> str:
    body = urlencode({"request-json": json.dumps({"apikey": "key"})}).encode()
    return str(asked(port, "POST", "/api/login/", body, FORM)["session"])


def form(session: str, content: bytes) -> bytes:
    given = json.dumps({"session": session, "publicly_visible": "n"})
    return b"".join(
        (
            f'--bound\r\nContent-Disposition: form-data; name="request-json"\r\n\r\n{given}\r\n'.encode(),
            b'--bound\r\nContent-Disposition: form-data; name="file"; filename="a.fits"\r\n\r\n',
            content,
            b"\r\n--bound--\r\n",
        )
    )


def dialogue(port: int, content: bytes) -> tuple[float, int]:
    """Wall seconds of one, and how often it had to wait a second."""
    began, waits = time.perf_counter(), 0
    session = login(port)
    submission = asked(port, "POST", "/api/upload", form(session, content), MULTIPART)["subid"]
    while not (jobs := asked(port, "GET", f"/api/submissions/{submission}")["jobs"]):
        time.sleep(1)
        waits += 1
    while (status := asked(port, "GET", f"/api/jobs/{jobs[0]}")["status"]) != "success":
        assert status in ("processing", "solving"), status
        time.sleep(1)
        waits += 1
    found = asked(port, "GET", f"/api/jobs/{jobs[0]}/calibration/")
    assert abs(found["ra"] - PLACE.ra_deg) < 0.01, found
    return time.perf_counter() - began, waits


def flood(port: int, content: bytes, end: Event, counts: multiprocessing.SimpleQueue[int]) -> None:
    session = login(port)
    while not end.is_set():
        try:
            counts.put(asked(port, "POST", "/api/upload", form(session, content), MULTIPART)["http"])
        except OSError:
            counts.put(0)


def told(values: list[float]) -> str:
    return (
        f"median {np.median(values):.3f} s, p95 {np.percentile(values, 95):.3f} s, most {max(values):.3f} s"
    )


def stopped(served: Served, count: int) -> str:
    """How long stops take."""
    stops = []
    for _ in range(count):
        began = time.perf_counter()
        served.ask("POST", "/v1/stop")
        stops.append(time.perf_counter() - began)
        time.sleep(0.1)
    return f"{count} stops: {told(stops)}"


def flooded(served: Served, port: int, content: bytes) -> None:
    """Print how long stops take while uploads are sent without end."""
    context = multiprocessing.get_context("spawn")
    end, counts = context.Event(), context.SimpleQueue()
    floods = [context.Process(target=flood, args=(port, content, end, counts)) for _ in range(FLOODS)]
    codes: dict[int, int] = {}

    def count() -> None:
        while (code := counts.get()) >= 0:
            codes[code] = codes.get(code, 0) + 1

    counting = threading.Thread(target=count)
    counting.start()
    for one in floods:
        one.start()
    while len(codes) < 2:
        time.sleep(0.1)
    stops = stopped(served, 100)
    end.set()
    for one in floods:
        one.join()
    counts.put(-1)
    counting.join()
    print(f"{FLOODS} floods: answers {dict(sorted(codes.items()))}; {stops}")


def main() -> None:
    numbers = [one for one in sys.argv[1:] if not one.startswith("-")]
    count = int(numbers[0]) if numbers else DIALOGUES
    optics, instant = SimulatedOptics(SIDE_PX, SIDE_PX, SCALE_ARCSEC_PX), datetime(2026, 11, 21, tzinfo=UTC)
    frame = draw_frame(
        PLACE, optics, embedded_catalog(), exposure_s=5.0, mid_exposure_utc=instant, seed=(4, 1)
    )
    content = as_fits(frame)
    rng = np.random.default_rng(1)
    noise = as_fits(Frame(pixels=rng.normal(1000.0, 10.0, (2000, 2000)).astype(np.uint16)))
    with tempfile.TemporaryDirectory() as folder:
        settings, log = Path(folder) / "observatory.toml", Path(folder) / "log"
        more = "[nova]\nenabled = true\nport = 0\n[journal]\n"
        where = f'url = "{folder}/journal.sqlite"\n'
        settings.write_text(SETTINGS.format(port=0, worker="true") + more + where)
        with log.open("wb") as said:
            process = subprocess.Popen(
                [sys.executable, "-m", "api.main", "serve", "--config", str(settings)],
                stdout=said,
                stderr=said,
            )
        try:
            served = ready(process, log)
            states = served.ask("GET", "/v1/health")
            port = int(re.findall(r"'nova': \{[^}]*'port': (\d+)", str(states))[0])
            first, _ = dialogue(port, content)
            taken = [dialogue(port, content) for _ in range(count)]
            seconds = told([one for one, _ in taken])
            print(f"{len(content) / 1e6:.1f} MB; the first {first:.3f} s; {count} more: {seconds}")
            print(f"seconds waited between polls: {sum(waits for _, waits in taken)}")
            if "--flood" in sys.argv:
                print(f"without a flood: {stopped(served, 20)}")
                flooded(served, port, noise)
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait()


if __name__ == "__main__":
    main()
