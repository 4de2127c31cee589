"""A task of a driver that dies of a fault ends its link: nothing looks alive that nobody reads any more."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivers.alpaca.client import AlpacaClient
from drivers.alpaca.codec.base import DeviceAddress
from drivers.alpaca.language import Moving
from drivers.alpaca.readings import MountReader
from drivers.generic.link_supervisor import LinkState
from drivers.indi.client import IndiClient
from drivers.indi.codec import messages
from drivers.wire.exchange import Patience
from drivers.wire.line import SerialLine
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceMissing
from tests.drivers.generic.plain_rig import QUICK, rigged


def dies(*_: Any, **__: Any) -> Any:
    raise ValueError("Exceeds the limit (4300 digits) for integer string conversion")


async def died(*_: Any, **__: Any) -> Any:
    dies()


async def greets(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.write(b"<message device='a' message='hello'/>")
    while await reader.read(100):
        pass
    writer.close()


@pytest.fixture
def indi_faults(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    room, name = request.param
    monkeypatch.setattr(room, name, died if name == "_watch" else dies)


@pytest.mark.parametrize(
    "indi_faults",
    [(messages.Reader, "parts"), (IndiClient, "_take"), (IndiClient, "_watch")],
    indirect=True,
)
async def test_an_indi_client_without_its_reader_or_its_watch_is_lost(indi_faults: None) -> None:
    server = await asyncio.start_server(greets, "127.0.0.1", 0)
    async with server:
        client = IndiClient("127.0.0.1", server.sockets[0].getsockname()[1], log=WireLog(kept=10))
        await client.open()
        async with asyncio.timeout(10.0):
            assert "a fault in mountnav: ValueError" in await client.lost()
        assert not client.usable
        with pytest.raises(DeviceMissing):
            client.send(b"<getProperties version='1.7'/>")
        await client.close()


@pytest.mark.parametrize("member", ["readout", "lost", "unanswered_s"])
async def test_a_mounts_link_ends_with_its_beat_and_its_watch_and_comes_back(member: str) -> None:
    async with rigged(timing=replace(QUICK, backoff_s=0.02)) as rig:
        fault = died if member != "unanswered_s" else dies
        setattr(rig.language, member, fault)
        await rig.until(lambda: rig.heard("link-lost"))
        assert "a fault in mountnav: ValueError" in str(rig.heard("link-lost")[0])
        assert not rig.mount.trusted
        delattr(rig.language, member)
        await rig.until(lambda: rig.mount.link is LinkState.UP)


@pytest.mark.parametrize(("order", "member"), [(True, "put"), (False, "put_past_all")])
async def test_an_alpaca_order_in_the_background_that_dies_ends_the_link(
    order: bool, member: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asking = AlpacaClient(DeviceAddress("http://127.0.0.1:1", "telescope", 0), log=WireLog(kept=10))
    await asking.open()
    monkeypatch.setattr(asking, member, died)
    moving = Moving(asking, MountReader.__new__(MountReader), 10.0)
    monkeypatch.setattr(moving, "_reader", type("Kept", (), {"ordered": lambda self: 1})())
    with pytest.raises(ValueError, match="4300"):
        await (moving.order("park", {}, at_once=False) if order else moving.stop())
    await asyncio.sleep(0)
    assert not asking.usable
    assert "a fault in mountnav" in await asking.lost()
    await moving.end()
    await asking.close()


async def test_a_serial_link_that_a_dead_task_has_lost_answers_nothing_until_it_is_opened_anew() -> None:
    server = await asyncio.start_server(greets, "127.0.0.1", 0)
    async with server:
        port = server.sockets[0].getsockname()[1]
        link = Link(SerialLine(f"socket://127.0.0.1:{port}"), Patience(), WireLog(kept=10))
        await link.open()
        assert link.usable
        link.lose("a fault in mountnav: ValueError")
        async with asyncio.timeout(10.0):
            assert "ValueError" in await link.lost()
        assert not link.usable
        await link.open()
        assert link.usable
        await link.close()
