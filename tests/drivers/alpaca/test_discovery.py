"""Who answers the question for Alpaca servers, over real UDP."""

from __future__ import annotations

import asyncio
import json
import socket
import threading

import pytest

from drivers.alpaca.discovery import servers
from tests.drivers.alpaca.alpaca_server import AlpacaServer, FakeCamera, FakeTelescope, quick_mechanics

NONSENSE = [b"hello", b"[]", b'{"AlpacaPort": "11111"}', b'{"AlpacaPort": 0}', b"\xff\xfe", b'{"Port": 1}']


async def test_those_who_answer_are_listed_with_their_devices() -> None:
    telescope = FakeTelescope(quick_mechanics())
    with AlpacaServer({"telescope/0": telescope, "camera/0": FakeCamera()}) as server:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        listener.bind(("127.0.0.1", 0))
        asked: list[bytes] = []

        def answer() -> None:
            question, where = listener.recvfrom(100)
            asked.append(question)
            for one in (*NONSENSE, json.dumps({"AlpacaPort": server.port}).encode()):
                listener.sendto(one, where)

        threading.Thread(target=answer, daemon=True).start()
        port = listener.getsockname()[1]
        found = await servers(wait_s=0.5, port=port, hosts=("127.0.0.1",))
        listener.close()
    assert asked == [b"alpacadiscovery1"]
    (one,) = found
    assert one.address == f"127.0.0.1:{server.port}"
    assert one.devices == ("telescope/0 (Small telescope)", "camera/0 (Small camera)")
    assert telescope.connected is False, "nothing is connected by looking for it"


async def test_nobody_there_is_nobody_there() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    async with asyncio.timeout(60.0):
        assert await servers(wait_s=0.2, port=port, hosts=("127.0.0.1",)) == []


@pytest.mark.long
async def test_our_own_server_is_found() -> None:
    from api.alpaca.discovery import Discovery
    from mountnav.settings.faces import AlpacaSettings

    with AlpacaServer({"telescope/0": FakeTelescope(quick_mechanics())}) as server:
        ours = Discovery(AlpacaSettings(discovery_port=0), ("127.0.0.1", server.port))
        await ours.start()
        try:
            found = await servers(wait_s=0.5, port=ours.address[1], hosts=("127.0.0.1",))
        finally:
            await ours.stop()
    assert [one.address for one in found] == [f"127.0.0.1:{server.port}"]
