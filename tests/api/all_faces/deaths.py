"""A running service whose clients die, in several ways; and what the mount's motors do then."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

from tests.api.all_faces.attacked_service import up_now
from tests.api.all_faces.dying_client import EAST, LEASE_S, RATES_S
from tests.api.observatory.test_dead_man import ONSTEP, TrueMount, mount_of, sidereal
from tests.drivers.indi.real_server import free_port
from tests.settings_text import FREE_GERMAN_MOUNT
from tests.waiting import PATIENCE_S

ROOT = Path(__file__).resolve().parents[3]
SILENCE_S, KEY_S = 2.0, 10.0
"""Ends of a motion: of a program that is silent, and of one whose silence can't be known."""
LATE_S = 4.0
"""How much later than its end a motion may be seen to be over, on a busy machine: it brakes, and is read."""
SETTINGS = (
    """
[service]
port = {http}
state_poll_s = 0.2
rate_limit_per_s = 0
[solving]
worker = false
blind = "never"
[site]
latitude_deg = 47.0
longitude_deg = 11.0
height_m = 600.0
[alpaca]
discovery = false
silence_s = {silence}
move_axis_s = {key}
offset_rates_s = {rates}
[indi_server]
enabled = true
port = {indi}
silence_s = {silence}
move_axis_s = {key}
offset_rates_s = {rates}
[lx200_server]
enabled = true
port = {lx200}
silence_s = {silence}
move_axis_s = {key}
"""
    + FREE_GERMAN_MOUNT
)
DEATHS = ("killed", "reset", "silent", "suspended")
KINDS: dict[tuple[str, str], tuple[float, float]] = {
    ("http", "axis"): (2.0, 2.0),
    ("http", "rates"): (RATES_S, RATES_S),
    ("http-leased", "axis"): (2.0, 2.0),
    ("http-leased", "rates"): (LEASE_S, LEASE_S),
    ("alpaca", "axis"): (SILENCE_S, SILENCE_S),
    ("alpaca", "rates"): (RATES_S, RATES_S),
    ("indi", "axis"): (0.0, SILENCE_S),
    ("indi", "rates"): (RATES_S, RATES_S),
    ("indi-mute", "axis"): (0.0, KEY_S),
    ("indi-mute", "rates"): (RATES_S, RATES_S),
    ("indiserver", "axis"): (KEY_S, KEY_S),
    ("indiserver", "rates"): (RATES_S, RATES_S),
    ("lx200", "axis"): (SILENCE_S, SILENCE_S),
}
"""Faces and what goes on there: its end after the death of a client whose connection ends, and of one whose
connection stays."""


class Line:
    """A cable to a port, which can be cut, and at whose end nobody may be any more."""

    def __init__(self, port: int) -> None:
        self._to = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._silent = threading.Event()
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection(("127.0.0.1", self._to))
                self._pairs.append((near, far))
                for one, other in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=(one, other), daemon=True).start()

    def _pass_on(self, one: socket.socket, other: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := one.recv(65_536):
                if self._silent.is_set():
                    return  # whatever comes is lost, and nobody closes anything
                other.sendall(data)
            if not self._silent.is_set():
                other.shutdown(socket.SHUT_WR)

    @property
    def service_side_ports(self) -> list[int]:
        """Where the connections to the service begin."""
        return [int(far.getsockname()[1]) for _, far in self._pairs]

    def silence(self) -> None:
        """Pass nothing on any more."""
        self._silent.set()

    def reset(self) -> None:
        """Cut it, and have the service told by a reset."""
        self._silent.set()
        for _, far in self._pairs:
            far.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            # close alone ends nothing while a thread reads
            with contextlib.suppress(OSError):
                far.shutdown(socket.SHUT_RD)
            far.close()

    def close(self) -> None:
        """No such cable."""
        self._listener.close()
        for pair in self._pairs:
            for one in pair:
                one.close()


@dataclass
class Observed:
    """A service with all faces, its mount as it truly moves, and where the faces listen."""

    mount: TrueMount
    ports: dict[str, int]
    folder: Path
    process: subprocess.Popen[bytes]

    def port_of(self, face: str) -> int:
        """Of the service, by the client's face."""
        return self.ports[{"lx200": "lx200", "indi": "indi", "indi-mute": "indi"}.get(face, "http")]

    def rested(self) -> None:
        """As for a star again, held by nobody."""
        with httpx.Client(base_url=f"http://127.0.0.1:{self.ports['http']}", timeout=PATIENCE_S) as http:
            http.post(f"{EAST}/stop")
            while http.get(f"{EAST}/lease").json()["held"]:
                time.sleep(0.1)
            while http.get(EAST).json()["job_id"] is not None:
                time.sleep(0.1)
            done(http, "/tracking", on=True)
        self.mount.until(sidereal)


@contextmanager
def observed(folder: Path) -> Iterator[Observed]:
    """Run it."""
    ports = {name: free_port() for name in ("http", "indi", "lx200")}
    with mount_of() as mount:
        (folder / "frames").mkdir()
        config = folder / "observatory.toml"
        config.write_text(
            SETTINGS.format(
                **ports,
                silence=SILENCE_S,
                key=KEY_S,
                rates=RATES_S,
                url=ONSTEP.format(device=mount.device),
                folder=folder / "frames",
            )
        )
        environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "MOUNTNAV_JOURNAL": str(folder / "journal.sqlite"),
            "MOUNTNAV_CACHE": str(folder / "cache"),
        }
        with (folder / "service.log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "api.main", "serve", "--config", str(config)],
                cwd=ROOT,
                env=environment,
                stdout=log,
                stderr=log,
            )
        try:
            place = up_now(-30.0, 30.0)
            with httpx.Client(base_url=f"http://127.0.0.1:{ports['http']}", timeout=PATIENCE_S) as http:
                while True:
                    with contextlib.suppress(httpx.HTTPError):
                        if http.get(EAST).json()["connected"]:
                            break
                    assert process.poll() is None, (folder / "service.log").read_text()
                    time.sleep(0.05)
                done(http, "/trust")
                done(http, "/tracking", on=True)
                done(http, "/slew", ra_deg=place.ra_deg, dec_deg=place.dec_deg, frame="jnow-apparent")
            yield Observed(mount, ports, folder, process)
        finally:
            process.kill()
            process.wait()


def done(http: httpx.Client, path: str, **body: object) -> None:
    """Order something, and wait for its end."""
    answer = http.post(EAST + path, json=body or None, headers={"Idempotency-Key": os.urandom(8).hex()})
    assert answer.status_code == 202, answer.text
    job = answer.json()
    while job["state"] in ("waiting", "running"):
        job = http.get(f"/v1/jobs/{job['id']}", params={"wait": 30}).json()
    assert job["state"] == "succeeded", job


def outlives_s(at: Observed, face: str, what: str, death: str, give_up_s: float = 40.0) -> float | None:
    """How long after its client's death the mount goes on, s; None: longer than `give_up_s`."""
    with contextlib.ExitStack() as stack:
        port = at.port_of(face)
        spoken = face
        if face == "indiserver":
            port, spoken = stack.enter_context(_indiserver(at)), "indi"
        line = Line(port)
        stack.callback(line.close)
        client = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "tests.api.all_faces.dying_client",
                spoken,
                what,
                "127.0.0.1",
                str(line.port),
            ],
            cwd=ROOT,
            stdout=subprocess.PIPE,
        )
        assert client.stdout is not None
        stack.callback(client.stdout.close)
        stack.callback(client.wait)
        stack.callback(client.kill)
        assert client.stdout.readline().strip() == b"in force", f"{face} {what}: it was not taken"
        _begun(at, f"{face} {what}")
        # it lives, and is known to
        time.sleep(2.0)
        assert not sidereal(at.mount.now()), f"{face} {what}: a client that lives keeps nothing up"
        match death:
            case "killed":
                client.kill()
            case "reset":
                line.reset()
            case "silent":
                line.silence()
            case "suspended":
                client.send_signal(signal.SIGSTOP)
            case "cut":
                stack.enter_context(_cut(line.service_side_ports))
        began_s = time.monotonic()
        while not sidereal(at.mount.now()):
            if time.monotonic() - began_s > give_up_s:
                return None
        return time.monotonic() - began_s


def _begun(at: Observed, which: str) -> None:
    began_s = time.monotonic()
    while sidereal(at.mount.now()):
        assert time.monotonic() - began_s < PATIENCE_S, f"{which}: nothing goes on"


def allowed_s(face: str, what: str, death: str) -> float:
    """So long it may."""
    ends, stays = KINDS[face, what]
    return (ends if death in ("killed", "reset") else stays) + LATE_S


@contextmanager
def _indiserver(at: Observed) -> Iterator[int]:
    """A stock `indiserver` before the service, by our driver for it; its port."""
    port = free_port()
    driver = at.folder / "driver"
    if not driver.exists():
        driver.write_text(
            f"#!/bin/sh\nexec {sys.executable} -m api.main indi-driver --port {at.ports['indi']}\n"
        )
        driver.chmod(0o755)
    process = subprocess.Popen(
        ["indiserver", "-r", "0", "-p", str(port), "-u", str(at.folder / "socket"), str(driver)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port)):
                break
            time.sleep(0.05)
        yield port
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def can_cut() -> bool:
    """Whether packets can be dropped here: in a network of this process's own (`unshare -n`), as root."""
    return os.geteuid() == 0 and shutil.which("iptables") is not None and len(socket.if_nameindex()) == 1


@contextmanager
def _cut(ports: list[int]) -> Iterator[None]:
    """Drop every packet of these ports: nothing is acknowledged any more."""
    rules = [
        ["INPUT", "-p", "tcp", side, str(port), "-j", "DROP"]
        for port in ports
        for side in ("--sport", "--dport")
    ]
    for rule in rules:
        subprocess.run(["iptables", "-A", *rule], check=True)
    try:
        yield
    finally:
        for rule in rules:
            subprocess.run(["iptables", "-D", *rule], check=True)
