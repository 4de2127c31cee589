"""URLs to mounts, names to fakes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from drivers.generic.options import yes_of
from drivers.registry import open_mount, read_url
from mountnav.errors import BadSettings


def test_serial_and_socket() -> None:
    mount = open_mount("lx200+serial:///dev/ttyUSB0?baud=19200&epoch=icrs&timeout_s=3", name="main")
    assert (mount.name, mount.epoch) == ("main", "icrs")
    assert open_mount("lx200+socket://mount.local:4030").name == "socket://mount.local:4030"
    assert read_url("lx200+serial:///dev/serial/by-id/usb-x?baud=9600").line == "/dev/serial/by-id/usb-x"
    assert read_url("lx200+socket://[::1]:4030").line == "socket://[::1]:4030"


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("/dev/ttyUSB0", "lx200"),
        ("nexus+serial:///dev/ttyUSB0", "known: alpaca, indi, ioptron, lx200, nexstar, skywatcher, synscan"),
        ("lx200:///dev/ttyUSB0", "serial, socket"),
        ("lx200+serial://dev/ttyUSB0", "serial, socket"),
        ("lx200+socket://host", "socket"),
        ("lx200+socket://host:port", "lx200"),
        ("lx200+serial:///dev/ttyUSB0?speed=9600", "baud"),
        ("lx200+serial:///dev/ttyUSB0?baud=fast", "whole number"),
        ("lx200+serial:///dev/ttyUSB0?baud", "lx200"),
        ("lx200+serial:///dev/ttyUSB0?epoch=B1950", "JNow"),
    ],
)
def test_bad_urls_tell_what_is_known(url: str, told: str) -> None:
    with pytest.raises(BadSettings, match=told):
        open_mount(url)


@pytest.mark.parametrize(
    ("word", "meant"), [("yes", True), ("TRUE", True), ("1", True), ("no", False), ("0", False)]
)
def test_yes_and_no_are_the_same_words_for_every_option(word: str, meant: bool) -> None:
    assert yes_of({"connect": word}, "connect", default=not meant) is meant
    with pytest.raises(BadSettings, match="neither yes nor no"):
        yes_of({"connect": "maybe"}, "connect", default=True)


@pytest.mark.long
def test_records_are_read_without_what_they_open() -> None:
    code = (
        "import sys; from drivers.registry import fake_protocols, families, read_url\n"
        "names = [one.name for one in families()]\n"
        "read_url('alpaca+http://host/telescope/0'); read_url('skywatcher+udp://host:11880')\n"
        "print(*names); print(*fake_protocols())\n"
        "print(*(set(sys.modules) & {'asyncio', 'serial', 'httpx', 'mountnav.simulation'}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names, fakes, heavy = done.stdout.split("\n")[:3]
    assert names == "lx200 nexstar synscan ioptron skywatcher indi alpaca"
    assert fakes == "lx200 nexstar synscan ioptron skywatcher"
    assert heavy == ""


@pytest.mark.parametrize(
    ("url", "line", "device"),
    [
        ("skywatcher+udp://host:11880", "udp://host:11880", ""),
        ("indi://host/Telescope%20Simulator", "host:7624", "Telescope Simulator"),
        ("alpaca+http://host/telescope/0", "http://host:11111", "telescope/0"),
        ("alpaca+https://host/camera/1", "https://host:443", "camera/1"),
    ],
)
def test_each_family_reads_its_own_urls(url: str, line: str, device: str) -> None:
    read = read_url(url)
    assert (read.line, read.device) == (line, device)


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("meade+serial:///dev/ttyUSB0", r"did you mean lx200\+serial:///dev/ttyUSB0\?"),
        ("eqmod+serial:///dev/ttyUSB0", r"did you mean skywatcher\+serial:///dev/ttyUSB0\?"),
        ("onstep+tcp://host:9999", r"a dialect of lx200: write lx200\+tcp://host:9999\?dialect=onstep"),
        ("nexstar+tcp://host", r"nexstar\+tcp://host:2000, or the port it has"),
        ("skywatcher+udp://host", r"skywatcher\+udp://host:11880, or the port it has"),
        ("lx200+udp://host:9999", "known for lx200: serial, socket, tcp; write"),
        ("indi://host", "indi://host:7624/Telescope%20Simulator"),
        ("indi://me@host/Scope", "indi takes none: leave out what stands before @"),
        ("alpaca+http://me:secret@host/dome/0", r"URL 'alpaca\+http://…@host/dome/0' names no device"),
    ],
)
def test_what_a_family_tells_of_itself_is_in_the_advice(url: str, told: str) -> None:
    with pytest.raises(BadSettings, match=told) as refused:
        read_url(url)
    assert "secret" not in str(refused.value)
