"""URLs to mounts."""

from __future__ import annotations

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
