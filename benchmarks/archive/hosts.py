"""Four hosts with narrow lines that solve one archive: network namespaces, each with a bounded bandwidth.

    python -m benchmarks.archive.hosts [--hosts 4] [--frames 16] [--mbit 16]      (as root, with ip and tc)

A web server here has the frames; each host fetches its part over a line of its own (`tc tbf`), and solves it
by `archive work --chunk K/N` into the shared store. What the report says of it is printed.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from benchmarks.peers.drawing import drawn
from mountnav.catalog.embedded import embedded_catalog

NET = "10.213.7"
"""Of the simulated site; nothing else here uses it."""


def _ip(*words: str) -> None:
    subprocess.run(words, check=True, capture_output=True)


@contextlib.contextmanager
def hosts(count: int, mbit: float) -> Iterator[list[str]]:
    """Namespaces behind a bridge; their names."""
    bridge, names = f"mnb{os.getpid()}", [f"mn{os.getpid()}h{at}" for at in range(count)]
    try:
        _ip("ip", "link", "add", bridge, "type", "bridge")
        _ip("ip", "addr", "add", f"{NET}.1/24", "dev", bridge)
        _ip("ip", "link", "set", bridge, "up")
        for at, name in enumerate(names):
            here = f"v{os.getpid()}h{at}"
            _ip("ip", "netns", "add", name)
            _ip("ip", "link", "add", here, "type", "veth", "peer", "name", "eth0", "netns", name)
            _ip("ip", "link", "set", here, "master", bridge, "up")
            rate = ("rate", f"{mbit:g}mbit", "burst", "64kb", "latency", "200ms")
            _ip("tc", "qdisc", "add", "dev", here, "root", "tbf", *rate)
            inside = ("ip", "-n", name)
            _ip(*inside, "addr", "add", f"{NET}.{10 + at}/24", "dev", "eth0")
            _ip(*inside, "link", "set", "eth0", "up")
            _ip(*inside, "link", "set", "lo", "up")
        yield names
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)
        subprocess.run(["ip", "link", "del", bridge], capture_output=True, check=False)


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


def main() -> None:
    """Draw, serve, solve, report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hosts", type=int, default=4)
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--mbit", type=float, default=16.0)
    asked = parser.parse_args()
    command = [sys.executable, "-m", "api.main", "archive"]
    with tempfile.TemporaryDirectory() as there, hosts(asked.hosts, asked.mbit) as names:
        folder = Path(there)
        jobs = [drawn("A", at, 4, embedded_catalog(), folder) for at in range(2)]
        server = ThreadingHTTPServer((f"{NET}.1", 0), partial(_Quiet, directory=there))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        lines = ["file,ra_deg,dec_deg,radius_deg,scale_arcsec_px"]
        for at in range(asked.frames):
            job = jobs[at % 2]
            link = folder / f"frame{at:03d}.fits"
            link.symlink_to(job.path)
            hint = job.hint
            assert hint.center is not None
            assert hint.scale_low_arcsec_px is not None
            url = f"http://{NET}.1:{server.server_port}/{link.name}"
            scale = hint.scale_low_arcsec_px / 0.95
            place = f"{hint.center.ra_deg},{hint.center.dec_deg},{hint.radius_deg}"
            lines.append(f"{url},{place},{scale}")
        table, archive = folder / "list.csv", folder / "archive"
        table.write_text("\n".join(lines) + "\n")
        size = str(-(-asked.frames // asked.hosts))
        words = ["--frames", str(table), "--no-blind", "--chunk-frames", size, "--undated", "2026-01-01"]
        subprocess.run([*command, "init", str(archive), *words], check=True)
        began_s = time.monotonic()
        workers = [
            subprocess.Popen(
                [
                    "ip",
                    "netns",
                    "exec",
                    name,
                    *command,
                    "work",
                    str(archive),
                    "--chunk",
                    f"{at}/{asked.hosts}",
                ]
            )
            for at, name in enumerate(names)
        ]
        codes = [worker.wait() for worker in workers]
        whole_s = time.monotonic() - began_s
        subprocess.run([*command, "report", str(archive), "-o", str(folder / "r.html")], check=True)
        subprocess.run([*command, "verify", str(archive)], check=True)
        megabytes = sum((folder / f"frame{at:03d}.fits").stat().st_size for at in range(asked.frames)) / 1e6
        print(f"exit codes {codes}; {whole_s:.0f} s; {megabytes / whole_s:.2f} MB/s, all hosts together")
        text = (folder / "r.html").read_text()
        (said,) = re.findall(r"<p>(\d+ frames with an account.*?)</p>", text)
        print(re.sub("<.*?>", "", said))


if __name__ == "__main__":
    main()
