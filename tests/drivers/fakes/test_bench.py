"""Fakes on real wires: ports that vanish and come back, connections that are cut, floods nobody reads."""

from __future__ import annotations

import itertools
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from drivers.fakes.bench import Bench, FakeOnPty, FakeOnTcp, FakeOnUdp
from drivers.fakes.bench.thread import InFastTime
from drivers.fakes.faults import Fault
from drivers.fakes.recording import Recorder, read_dialogue
from drivers.fakes.wire_fake import WireFake
from drivers.wire.line import SerialLine
from mountnav.errors import DeviceMissing
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import Air, Site

LONG_S = 30.0


class Echo(WireFake):
    """Answers `x#` with `<x#`."""

    def __init__(self, *faults: Fault, monotonic: Callable[[], float] = time.monotonic) -> None:
        mechanics = Mechanics(Site(49.6, 36.9), Air(), PointingErrors())
        super().__init__(mechanics, faults=faults, monotonic=monotonic)

    def cut(self, buffer: bytes) -> tuple[bytes | None, bytes]:
        end = buffer.find(b"#")
        return (None, buffer) if end < 0 else (buffer[: end + 1], buffer[end + 1 :])

    def carry_out(self, command: bytes) -> bytes | None:
        return b"<" + command

    def deaf_reply(self, command: bytes) -> bytes:
        return b"<" + command


def on_wire(kind: str, fake: WireFake, tmp_path: Path) -> Bench:
    return FakeOnPty(fake, tmp_path / "mount") if kind == "pty" else FakeOnTcp(fake)


def port_to(bench: Bench) -> serial.Serial:
    port: serial.Serial = serial.serial_for_url(bench.address, timeout=LONG_S)
    return port


def asked(port: serial.Serial, command: bytes) -> bytes:
    port.write(command)
    return bytes(port.read_until(b"#"))


def read_to_the_end(port: serial.Serial) -> None:
    while True:
        port.read(1)


def until(true: Callable[[], object]) -> None:
    end_s = time.monotonic() + LONG_S
    while not true():
        assert time.monotonic() < end_s, "never"
        time.sleep(0.005)


@pytest.mark.parametrize("kind", ["pty", "tcp"])
async def test_a_line_that_vanishes_is_lost_and_comes_back(kind: str, tmp_path: Path) -> None:
    with on_wire(kind, Echo(), tmp_path) as bench:
        line = SerialLine(bench.address)
        await line.open()
        await line.write(b"a#")
        assert await line.read(LONG_S)
        bench.vanish()
        await line.lost()
        with pytest.raises(DeviceMissing):
            await line.open()
        bench.come_back()
        await line.open()
        await line.write(b"b#")
        came = b""
        while not came.endswith(b"#"):
            came += await line.read(LONG_S)
        assert came == b"<b#"
        await line.close()


def test_a_serial_port_comes_back_under_another_name_with_its_stable_one(tmp_path: Path) -> None:
    link = tmp_path / "usb-mount"
    with FakeOnPty(Echo(), link) as bench:
        assert bench.address == str(link)
        names = [bench.device]
        for _ in range(3):
            bench.vanish()
            assert not link.is_symlink()
            assert not os.path.exists(bench.device)
            bench.come_back()
            assert os.readlink(link) == bench.device
            names.append(bench.device)
        assert all(one != two for one, two in itertools.pairwise(names))
        with port_to(bench) as port:
            assert asked(port, b"a#") == b"<a#"
    assert not link.is_symlink()


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_a_fault_takes_the_port_away_and_brings_it_back(kind: str, tmp_path: Path) -> None:
    fake = Echo(Fault("vanish", on=b"v", for_s=0.3))
    with on_wire(kind, fake, tmp_path) as bench:
        with port_to(bench) as port:
            port.write(b"v#")
            with pytest.raises(serial.SerialException):
                read_to_the_end(port)
        answers: list[bytes] = []

        def answered() -> bool:
            try:
                with port_to(bench) as port:
                    answers.append(asked(port, b"a#"))
            except serial.SerialException:
                return False
            return True

        until(answered)
        assert answers == [b"<a#"]


@pytest.mark.parametrize("how", ["hang_up", "reset"])
def test_a_connection_that_is_cut_can_be_made_again(how: str) -> None:
    with FakeOnTcp(Echo()) as bench:
        host, port = bench.address.removeprefix("socket://").split(":")
        for _ in range(2):
            with socket.create_connection((host, int(port)), timeout=LONG_S) as client:
                client.sendall(b"a#")
                assert client.recv(9) == b"<a#"
                getattr(bench, how)()
                if how == "reset":
                    with pytest.raises(ConnectionResetError):
                        client.recv(9)
                else:
                    assert client.recv(9) == b""


@pytest.mark.parametrize("how", ["hang_up", "reset"])
def test_a_pseudo_terminal_that_is_cut_hangs_up(how: str, tmp_path: Path) -> None:
    with on_wire("pty", Echo(), tmp_path) as bench:
        with port_to(bench) as port:
            getattr(bench, how)()
            with pytest.raises(serial.SerialException):
                port.read(1)
        with port_to(bench) as port:
            assert asked(port, b"a#") == b"<a#"


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_a_black_hole_takes_everything_and_gives_nothing(kind: str, tmp_path: Path) -> None:
    fake = Echo()
    with on_wire(kind, fake, tmp_path) as bench, port_to(bench) as port:
        bench.black_hole(3600.0)
        port.write(b"a#")
        port.timeout = 0.2
        assert port.read(1) == b""
        bench.black_hole(0.0)
        port.timeout = LONG_S
        assert asked(port, b"b#") == b"<b#"
        assert fake.heard == [b"b#"]


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_a_flood_that_nobody_reads_blocks_nothing(kind: str, tmp_path: Path) -> None:
    fake = Echo(Fault("flood", on=b"f", data=b"!" * 60_000, delay_s=0.001, for_s=0.3))
    with on_wire(kind, fake, tmp_path) as bench, port_to(bench) as port:
        port.write(b"f#")
        until(lambda: fake.strikes)
        until(lambda: fake.due_in_s() is None)
        # it still hears, and still can be stopped
        port.write(b"a#")
        until(lambda: fake.heard == [b"f#", b"a#"])
        bench.hang_up()


def test_faults_may_be_added_while_it_sleeps(tmp_path: Path) -> None:
    fake = Echo()
    with on_wire("pty", fake, tmp_path) as bench, port_to(bench) as port:
        assert asked(port, b"a#") == b"<a#"
        fake.add_fault(Fault("flood", data=b"awake#", at_s=0.05, for_s=0.0005))
        assert port.read_until(b"#") == b"awake#"
        fake.add_fault(Fault("late", on=b"l", delay_s=0.1))
        assert asked(port, b"l#") == b"<l#"


def test_a_slow_line_is_as_slow_as_its_baud(tmp_path: Path) -> None:
    with FakeOnPty(Echo(), baud=1200) as bench, port_to(bench) as port:
        began_s = time.monotonic()
        assert asked(port, b"x" * 40 + b"#") == b"<" + b"x" * 40 + b"#"
        # 41 bytes there, 42 back, 10 bits each
        assert time.monotonic() - began_s >= 83 * 10 / 1200


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_udp_answers_each_datagram_with_one(host: str) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.socket(family, socket.SOCK_DGRAM).close()
        bench = FakeOnUdp(Echo(Fault("late", on=b"l", delay_s=0.05)), host).start()
    except (OSError, DeviceMissing):
        pytest.skip(f"this machine has no {host}")
    with bench, socket.socket(family, socket.SOCK_DGRAM) as client:
        address = host, int(bench.address.rpartition(":")[2])
        assert bench.address == (
            f"udp://{host}:{address[1]}" if host != "::1" else f"udp://[::1]:{address[1]}"
        )
        client.settimeout(LONG_S)
        for _ in range(2):
            client.sendto(b"a#b#", address)
            assert client.recv(99) == b"<a#<b#"
            client.sendto(b"l#", address)
            assert client.recv(99) == b"<l#"
            bench.vanish()
            bench.come_back()


def test_a_port_in_use_is_told() -> None:
    with FakeOnTcp(Echo()) as bench, pytest.raises(DeviceMissing, match="another program listens there"):
        FakeOnTcp(Echo(), port=int(bench.address.rpartition(":")[2])).start()


def test_many_fakes_run_side_by_side(tmp_path: Path) -> None:
    fakes = [Echo(Fault("late", on=b"l", delay_s=0.01 * number)) for number in range(12)]
    benches: list[Bench] = [
        FakeOnPty(fake, tmp_path / f"mount{number}") if number % 2 else FakeOnTcp(fake)
        for number, fake in enumerate(fakes)
    ]
    try:
        ports = [port_to(bench.start()) for bench in benches]
        for number, port in enumerate(ports):
            port.write(b"l%d#" % number)
        assert [port.read_until(b"#") for port in ports] == [b"<l%d#" % number for number in range(12)]
        for port in ports:
            port.close()
    finally:
        for bench in benches:
            bench.stop()
            bench.stop()


def test_a_fake_in_fast_time_is_late_in_its_own_seconds(tmp_path: Path) -> None:
    clock = FastClock(1000.0)
    fake = Echo(Fault("late", on=b"l", delay_s=60.0), monotonic=clock.monotonic)
    with FakeOnPty(InFastTime(fake, clock)) as bench, port_to(bench) as port:
        began_s = time.monotonic()
        assert asked(port, b"l#") == b"<l#"
        assert 0.06 <= time.monotonic() - began_s < 20.0


def test_a_recording_is_a_dialogue(tmp_path: Path) -> None:
    path = tmp_path / "dialogue.jsonl"
    fake = Echo(Fault("hang-up", on=b"h"))
    with (
        Recorder(fake, path, {"fake": "echo"}) as recorder,
        FakeOnTcp(recorder) as bench,
        port_to(bench) as port,
    ):
        assert asked(port, b"a#") == b"<a#"
        assert asked(port, b"b#") == b"<b#"
        port.write(b"h#")
        with pytest.raises(serial.SerialException):
            read_to_the_end(port)
        # written as it goes
        assert read_dialogue(path)[:2] == [(b"a#", b"<a#"), (b"b#", b"<b#")]
    lines = path.read_text().splitlines()
    assert '"fake": "echo"' in lines[0]
    assert "line: hang-up" in lines[-1]


def test_nothing_is_left_open() -> None:
    before = len(os.listdir("/proc/self/fd"))
    for bench in (FakeOnPty(Echo()), FakeOnTcp(Echo()), FakeOnUdp(Echo())):
        with bench:
            bench.vanish()
            bench.come_back()
            bench.hang_up()
        bench.stop()
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_machine_without_pseudo_terminals_is_told_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> tuple[int, int]:
        raise OSError(19, "No such device")

    monkeypatch.setattr(os, "openpty", none)
    with pytest.raises(DeviceMissing, match="no pseudo-terminal can be had") as told:
        FakeOnPty(Echo()).start()
    assert "devpts" in (told.value.advice or "")
