"""Print how long a stop by HTTP takes while 100 clients flood the doors, and what that costs in memory.

A service of its own with a fake LX200 mount and all doors open; the flood is a process of its own, its
connections come from many addresses of this machine. Each kind of flood lasts some seconds; meanwhile
``POST /v1/stop`` is sent with a key, twice a second. It counts as known when it is answered as sent.

Run: python -m benchmarks.door_floods [--seconds 6] [--only NAME ...]
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import hashlib
import http.client
import json
import multiprocessing
import os
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

CLIENTS = 100
EACH_S = 0.5
KEY = "mnk_for-this-benchmark-alone"
SETTINGS = """
[service]
port = {http}
api_token_sha256 = "{digest}"
[solving]
worker = false
blind = "never"
[site]
latitude_deg = 47.0
longitude_deg = 11.0
[lx200_server]
enabled = true
port = {lx200}
[indi_server]
enabled = true
port = {indi}
[stellarium]
enabled = true
port = {stellarium}
[[telescope]]
id = "east"
mount = {{ url = "fake+lx200://" }}
camera = {{ kind = "simulated", width_px = 800, height_px = 600, scale_arcsec_px = 4.0 }}
"""
DOORS = ("http", "lx200", "indi", "stellarium")


def _number(name: str, **values: float) -> bytes:
    inside = "".join(f'<oneNumber name="{key}">{value}</oneNumber>' for key, value in values.items())
    return f'<newNumberVector device="east" name="{name}">{inside}</newNumberVector>'.encode()


def _switch(name: str, value: str) -> bytes:
    inside = f'<oneSwitch name="{value}">On</oneSwitch>'
    return f'<newSwitchVector device="east" name="{name}">{inside}</newSwitchVector>'.encode()


GOTO = (20).to_bytes(2, "little") + bytes(10) + (1 << 30).to_bytes(4, "little") + bytes(4)
LX_GOTO, LX_BELOW = b":Sr10:00:00#:Sd+80*00:00#:MS#", b":Sr10:00:00#:Sd-89*00:00#:MS#"
INDI_GOTO = _number("EQUATORIAL_EOD_COORD", RA=10.0, DEC=80.0)
INDI_BELOW = _number("EQUATORIAL_EOD_COORD", RA=10.0, DEC=-89.0)
CONNECT = b"<getProperties version='1.7'/>" + _switch("CONNECTION", "CONNECT")


@dataclass(frozen=True, slots=True)
class Flood:
    """What 100 clients do.

    Attributes
    ----------
    door : str
    said : bytes
        Again and again.
    first : bytes
        Before that.
    reads : bool
        Whether they read what they are told.
    stays : bool
        Whether they say it on one connection; else they come again for each.
    """

    door: str
    said: bytes
    first: bytes = b""
    reads: bool = True
    stays: bool = True


FLOODS = {
    "lx200 gotos": Flood("lx200", LX_GOTO),
    "lx200 gotos below the limits": Flood("lx200", LX_BELOW),
    "lx200 gotos, unread": Flood("lx200", LX_BELOW, reads=False),
    "lx200 syncs": Flood("lx200", b":Sr10:00:00#:Sd-89*00:00#:CM#"),
    "lx200 questions": Flood("lx200", b":GR#:GD#:GVP#"),
    "lx200 questions, unread": Flood("lx200", b":GR#:GD#:GVP#" * 50, reads=False),
    "lx200 stops": Flood("lx200", b":Q#"),
    "lx200 pulses": Flood("lx200", b":Mgn0100#:Mge0100#"),
    "lx200 one long command": Flood("lx200", b":" + b"S" * 4000),
    "lx200 nonsense": Flood("lx200", bytes(range(256)) * 16),
    "lx200 newcomers": Flood("lx200", b"", stays=False),
    "lx200 newcomers that ask": Flood("lx200", b":GR#", stays=False),
    "indi gotos": Flood("indi", INDI_GOTO, CONNECT),
    "indi gotos below the limits": Flood("indi", INDI_BELOW, CONNECT),
    "indi gotos, unread": Flood("indi", INDI_BELOW, CONNECT, reads=False),
    "indi syncs": Flood("indi", _switch("ON_COORD_SET", "SYNC") + INDI_BELOW, CONNECT),
    "indi questions": Flood("indi", b"<getProperties version='1.7'/>"),
    "indi questions, unread": Flood("indi", b"<getProperties version='1.7'/>" * 20, reads=False),
    "indi stops": Flood("indi", _switch("TELESCOPE_ABORT_MOTION", "ABORT"), CONNECT),
    "indi one long message": Flood("indi", b">" * 4000, b'<newNumberVector a="'),
    "indi nonsense": Flood("indi", b"<a><b/></a>text", stays=False),
    "indi newcomers": Flood("indi", b"", stays=False),
    "stellarium gotos": Flood("stellarium", GOTO),
    "stellarium gotos, unread": Flood("stellarium", GOTO * 20, reads=False),
    "stellarium newcomers": Flood("stellarium", b"", stays=False),
}


def _flood(flood: Flood, port: int, until_s: float) -> None:
    """Run a flood, in a process of its own."""
    with contextlib.suppress(TimeoutError):
        asyncio.run(_all_of(flood, port, until_s))


async def _all_of(flood: Flood, port: int, until_s: float) -> None:
    async with asyncio.timeout(max(0.0, until_s - time.monotonic())):
        await asyncio.gather(*(_client(flood, port, number) for number in range(CLIENTS)))


async def _client(flood: Flood, port: int, number: int) -> None:
    while True:
        with contextlib.suppress(OSError):
            reader, writer = await asyncio.open_connection(
                "127.0.0.1", port, local_addr=(f"127.0.1.{1 + number}", 0)
            )
            reading = asyncio.create_task(_drained(reader)) if flood.reads else None
            try:
                writer.write(flood.first)
                while flood.said or not flood.stays:
                    writer.write(flood.said)
                    await writer.drain()
                    if not flood.stays:
                        break
                    await asyncio.sleep(0)
            finally:
                if reading is not None:
                    reading.cancel()
                writer.close()
        await asyncio.sleep(0.001)


async def _drained(reader: asyncio.StreamReader) -> None:
    with contextlib.suppress(OSError):
        while await reader.read(65_536):
            pass


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as held:
        made = [held.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(count)]
        return [one.getsockname()[1] for one in made]


def _memory_mb(pid: int) -> float:
    told = re.search(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    return 0.0 if told is None else int(told[1]) / 1000.0


def _stop(port: int) -> tuple[float, bool]:
    """How long a stop took, s, and whether it is known to have been sent."""
    begun_s = time.monotonic()
    known = False
    with contextlib.suppress(OSError, http.client.HTTPException, ValueError, KeyError):
        link = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        link.request("POST", "/v1/stop", headers={"X-API-Key": KEY})
        answer = link.getresponse()
        told = json.loads(answer.read())
        known = answer.status == 200 and told["stopped"] is True
        link.close()
    return time.monotonic() - begun_s, known


def _measured(name: str, ports: dict[str, int], pid: int, seconds: float) -> None:
    flood = FLOODS[name]
    before_mb = _memory_mb(pid)
    until_s = time.monotonic() + seconds
    process = multiprocessing.get_context("spawn").Process(
        target=_flood, args=(flood, ports[flood.door], until_s)
    )
    process.start()
    took_s, unknown, most_mb = [], 0, before_mb
    time.sleep(1.0)  # until its process is there
    while time.monotonic() < until_s:
        one_s, known = _stop(ports["http"])
        took_s.append(one_s)
        unknown += not known
        most_mb = max(most_mb, _memory_mb(pid))
        time.sleep(max(0.0, EACH_S - one_s))
    process.join()
    print(
        f"{name:30s} stop {statistics.median(took_s):5.2f} s, at most {max(took_s):5.2f} s, of {len(took_s)} "
        f"{unknown} not known; memory {most_mb - before_mb:+5.0f} MB ({most_mb:.0f})",
        flush=True,
    )


def main() -> None:
    """Measure all of them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.door_floods")
    parser.add_argument("--seconds", type=float, default=6.0, help="for each")
    parser.add_argument("--only", nargs="+", choices=FLOODS, default=list(FLOODS))
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        ports = dict(zip(DOORS, _free_ports(len(DOORS)), strict=True))
        config, log = Path(folder, "observatory.toml"), Path(folder, "log")
        digest = hashlib.sha256(KEY.encode()).hexdigest()
        config.write_text(SETTINGS.format(digest=digest, **ports))
        with log.open("w") as said:
            process = subprocess.Popen(
                [sys.executable, "-m", "api.main", "serve", "--config", str(config)],
                stdout=said,
                stderr=said,
                env=os.environ | {"MOUNTNAV_JOURNAL": str(Path(folder, "journal.sqlite"))},
            )
        try:
            while not _stop(ports["http"])[1]:
                if process.poll() is not None:
                    sys.exit(log.read_text())
                time.sleep(0.2)
            idle_s = [_stop(ports["http"])[0] for _ in range(3)]
            print(f"{'idle':30s} stop {statistics.median(idle_s):5.2f} s; {_memory_mb(process.pid):.0f} MB")
            for name in chosen.only:
                _measured(name, ports, process.pid, chosen.seconds)
            journal = sum(one.stat().st_size for one in Path(folder).glob("journal.sqlite*"))
            print(f"log {log.stat().st_size / 1e3:.0f} kB, journal {journal / 1e6:.1f} MB")
        finally:
            process.terminate()
            process.wait(60)


if __name__ == "__main__":
    main()
