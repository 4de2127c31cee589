"""A line over UDP: datagrams both ways, and what a port says that nobody listens on."""

from __future__ import annotations

import asyncio
import socket

import pytest

from drivers.fakes.bench import FakeOnUdp
from drivers.wire.line import UdpLine
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceMissing
from tests.drivers.skywatcher.quick_fakes import quick


async def heard(line: UdpLine) -> bytes:
    while not (came := await line.read(5.0)):
        pass
    return came


async def test_one_datagram_there_and_one_back() -> None:
    log = WireLog()
    with FakeOnUdp(quick()) as bench:
        host, port = bench.address.removeprefix("udp://").split(":")
        line = UdpLine(host, int(port), log=log)
        assert line.address == bench.address
        assert not line.usable
        await line.open()
        await line.write(b":j1\r")
        assert await heard(line) == b"=000080\r"
        await line.write_now(b":a1\r")
        assert await heard(line) == b"=00B289\r"
        assert [entry.data for entry in log.entries() if entry.way == "driver->mount"] == [b":j1\r", b":a1\r"]
        assert await line.read(0.01) == b""
        await line.close()
        await line.close()
        with pytest.raises(DeviceMissing, match="not open"):
            await line.write(b":j1\r")


async def test_a_port_that_nobody_listens_on_is_a_lost_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    line = UdpLine("127.0.0.1", port)
    await line.open()
    await line.write(b":j1\r")
    assert "refused" in await line.lost()
    assert not line.usable
    with pytest.raises(DeviceMissing, match="Wi-Fi"):
        await line.read(1.0)
    await line.open()
    assert line.usable
    await line.close()


async def test_a_host_without_an_address_is_missing() -> None:
    with pytest.raises(DeviceMissing, match="can't be opened"):
        await UdpLine("no-such-host.invalid", 11880).open()


async def test_what_came_is_thrown_away_by_a_drain() -> None:
    with FakeOnUdp(quick()) as bench:
        host, port = bench.address.removeprefix("udp://").split(":")
        line = UdpLine(host, int(port))
        await line.open()
        await line.write(b":g1\r")
        await line.write(b":g2\r")
        came = b""
        while len(came) < 8:
            await asyncio.sleep(0.01)
            came += line.drain()
        assert came == b"=10\r=10\r"
        await line.close()
