"""`mountnav fake-mount`: every protocol and dialect, files of faults and mechanics, recordings both ways."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import serial

from api.cli.fake_mount import FakeMountOptions, serve_fake
from drivers.fakes.faults import Fault, read_faults
from drivers.fakes.recording import profile_of, read_dialogue
from drivers.fakes.wire_fake import WireFake
from drivers.registry import fake_dialects, fake_machine, fake_protocols, make_fake
from mountnav.errors import BadRequest, BadSettings
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import Air, Site

GREETINGS = {
    "lx200": (b":GR#", b"#"),
    "nexstar": (b"Kx", b"x#"),
    "synscan": (b"Kx", b"x#"),
    "ioptron": (b":MountInfo#", b""),
    "skywatcher": (b":e1\r", b"\r"),
}


@contextmanager
def serving(*arguments: object) -> Iterator[tuple[subprocess.Popen[str], str]]:
    command = [sys.executable, "-m", "api.main", "fake-mount", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        try:
            address = process.stdout.readline().strip()
            assert address, process.stderr.read()
            yield process, address
        finally:
            process.kill()


def ended(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGTERM)
    assert process.wait() == 0


def fake_of(protocol: str, dialect: str | None = None) -> WireFake:
    clock = FastClock()
    mechanics = Mechanics(
        Site(47.0, 11.0), Air(), PointingErrors(), machine=fake_machine(protocol), clock=clock
    )
    return make_fake(protocol, dialect, mechanics, clock=clock, monotonic=clock.monotonic)


@pytest.mark.parametrize("protocol", fake_protocols())
def test_every_dialect_answers_and_is_told_apart(protocol: str) -> None:
    assert len(set(fake_dialects(protocol))) == len(fake_dialects(protocol)) >= 1
    question, end = GREETINGS[protocol]
    for dialect in (None, *fake_dialects(protocol)):
        fake = fake_of(protocol, dialect)
        answer = fake.feed(question)
        assert answer.endswith(end), dialect
        assert fake.obeyed == [question]
    with pytest.raises(BadRequest, match=f"{protocol} dialect morse.*there is: {fake_dialects(protocol)[0]}"):
        fake_of(protocol, "morse")


def test_the_same_faults_strike_every_family() -> None:
    for protocol in fake_protocols():
        question, _ = GREETINGS[protocol]
        fake = fake_of(protocol)
        whole = fake.feed(question)
        fake.faults += [Fault("lose", on=question), Fault("double", on=question, skip=1)]
        assert [fake.feed(question) for _ in range(3)] == [b"", whole * 2, whole], protocol


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"protocol": "morse"}, "there is: lx200, nexstar, synscan, ioptron, skywatcher"),
        ({"protocol": "lx200", "dialect": "morse"}, "there is: "),
        ({"protocol": "lx200", "tcp": "localhost:1", "udp": "localhost:2"}, "--tcp and --udp together"),
        ({"protocol": "lx200", "udp": "localhost:1", "baud": 9600}, "--udp has no speed"),
        ({"protocol": "lx200", "udp": "localhost"}, "--udp localhost is not HOST:PORT"),
        ({"protocol": "lx200", "errors": Path("a"), "mechanics": Path("b")}, "--mechanics and --errors"),
        ({"protocol": "lx200", "struck": Path("/there/is/none.toml")}, "/there/is is not a folder"),
    ],
)
def test_options_that_make_no_sense_are_refused(asked: dict[str, Any], told: str) -> None:
    with pytest.raises(BadRequest, match=told):
        serve_fake(FakeMountOptions(**asked))


@pytest.mark.parametrize("option", ["faults", "mechanics", "errors", "replay", "record"])
def test_files_that_are_not_there_are_named(option: str) -> None:
    with pytest.raises(BadSettings, match="/there/is/none"):
        serve_fake(FakeMountOptions(protocol="lx200", **{option: Path("/there/is/none")}))  # type: ignore[arg-type]


def test_a_refused_file_leaves_the_signals_as_they_were() -> None:
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    with pytest.raises(BadSettings):
        serve_fake(FakeMountOptions(protocol="lx200", mechanics=Path("/there/is/none")))
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before
    assert signal.set_wakeup_fd(-1) == -1


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
@pytest.mark.parametrize("when", ["before it waits", "when it waits"])
def test_a_signal_ends_it_tidily_whichever_thread_takes_it(
    tmp_path: Path, number: signal.Signals, when: str
) -> None:
    """numpy's BLAS starts threads when it is imported: they take signals that the main thread doesn't."""
    link = tmp_path / "mount"
    # the signal is sent to a thread of the library's kind, once before the command waits, once after
    code = f"""
import signal, sys, threading, time
from pathlib import Path
signal.signal(signal.SIGHUP, signal.SIG_DFL)
idle = threading.Event()
older = threading.Thread(target=idle.wait, daemon=True)
older.start()
from api.cli.fake_mount import FakeMountOptions, serve_fake
from drivers.fakes.bench import Bench, FakeOnPty
strike = lambda: signal.pthread_kill(older.ident, signal.{number.name})
started = Bench.start
def start(bench):
    started(bench)
    if {when!r} == "before it waits":
        strike()
    else:
        threading.Timer(0.2, strike).start()
FakeOnPty.start = start
sys.exit(serve_fake(FakeMountOptions(protocol="lx200", link=Path({str(link)!r}))))
"""
    ended_as = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (ended_as.returncode, ended_as.stderr) == (0, "")
    assert not link.is_symlink()


@pytest.mark.long
def test_the_list_tells_all() -> None:
    command = [sys.executable, "-m", "api.main", "fake-mount", "--list"]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert listed == [f"{protocol}: {', '.join(fake_dialects(protocol))}" for protocol in fake_protocols()]


@pytest.mark.long
def test_a_motor_controller_answers_datagrams() -> None:
    with serving("--protocol", "skywatcher", "--udp", "127.0.0.1:0") as (process, address):
        assert address.startswith("udp://127.0.0.1:")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.settimeout(30.0)
            client.sendto(b":e1\r", ("127.0.0.1", int(address.rpartition(":")[2])))
            answer = client.recv(99)
        assert answer.startswith(b"=")
        assert answer.endswith(b"\r")
        ended(process)


@pytest.mark.long
def test_faults_and_mechanics_from_files_and_what_was_said_and_struck(tmp_path: Path) -> None:
    mechanics = tmp_path / "mount.toml"
    mechanics.write_text(
        '[machine]\nmounting = "german"\nstarts_at = "home"\n[site]\nlatitude_deg = -30\nlongitude_deg = 20\n'
    )
    faults = tmp_path / "faults.toml"
    faults.write_text(
        '[random]\nseed = 1\nrate = 1.0\nkinds = ["double"]\non = ":GVP"\n'
        '[[fault]]\nkind = "lose"\non = ":GD"\nskip = 1\n'
    )
    record, struck = tmp_path / "said.jsonl", tmp_path / "struck.toml"
    with (
        serving(
            *("--protocol", "lx200", "--dialect", "lx200gps", "--mechanics", mechanics, "--faults", faults),
            *("--seed", 9, "--record", record, "--struck", struck, "--speed", 10, "--baud", 115200),
            *("--link", tmp_path / "mount"),
        ) as (process, address),
        serial.Serial(address, 9600, timeout=30) as port,
    ):
        port.write(b":GD#")
        assert port.read_until(b"#")[:3] in (b"-90", b"-89")
        port.write(b":GD#:GVP#")
        product = port.read_until(b"#")
        assert product.endswith(b"#")
        assert port.read_until(b"#") == product
        ended(process)
    header, *entries = [json.loads(line) for line in record.read_text().splitlines()]
    assert (header["fake"], header["dialect"]) == ("lx200", "lx200gps")
    said = b"".join(bytes.fromhex(entry["hex"]) for entry in entries if entry["dir"] == "mount->driver")
    assert said.endswith(product * 2)
    script = read_faults(struck).faults
    assert [(fault.kind, fault.on, fault.skip) for fault in script] == [
        ("lose", b":GD#", 1),
        ("double", b":GVP#", 0),
    ]


@pytest.mark.shared
@pytest.mark.parametrize(
    ("transcript", "protocol", "identity"),
    [
        ("lx200_OnStep.jsonl", "lx200", b":GVP#"),
        ("celestron_gps.jsonl", "nexstar", b"V"),
        ("ioptronv3.jsonl", "ioptron", b":MountInfo#"),
        ("eqmod.jsonl", "skywatcher", b":e1\r"),
    ],
)
def test_a_recorded_mount_becomes_a_profile(
    shared: Path, transcript: str, protocol: str, identity: bytes
) -> None:
    fake = fake_of(protocol)
    turns = read_dialogue(shared / "protocols" / "transcripts" / transcript)
    taken = fake.take_profile(profile_of(turns, fake))
    assert identity in taken
    recorded = {answer for sent, answer in turns if sent == identity}
    assert {fake.feed(identity)} == recorded
    # nothing that the fake reckons itself comes from the recording
    assert not {b":GR#", b":GD#", b"e", b":GEP#", b":j1\r"} & set(taken)


def test_a_recording_of_another_protocol_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "said.jsonl"
    path.write_text('{"t": 0, "dir": "driver->mount", "hex": "3a4752"}\n')
    with pytest.raises(BadSettings, match="no answer that identifies a"):
        serve_fake(FakeMountOptions(protocol="lx200", replay=path))
    path.write_text('{"t": 0, "dir": "driver->mount", "hex": "3a4"}\n')
    with pytest.raises(BadSettings, match="line 1 is not a line of a recording"):
        serve_fake(FakeMountOptions(protocol="lx200", replay=path))
