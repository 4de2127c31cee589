"""The tests' Alpaca devices in the same process: real drivers in virtual time, without a socket."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from typing import Any
from urllib.parse import parse_qsl

import httpx
import pytest

from drivers.alpaca import client as alpaca_client
from drivers.alpaca.codec.base import DeviceAddress
from tests.drivers.alpaca import alpaca_server
from tests.drivers.alpaca.alpaca_server import AlpacaError, Bad, FakeDevice


class InMemory(httpx.AsyncBaseTransport):
    """A server of some devices, by their paths ("telescope/0").

    Parameters
    ----------
    answers_in_s : float
        Of each request.
    """

    def __init__(self, devices: Mapping[str, FakeDevice], answers_in_s: float = 0.02) -> None:
        self.devices, self.answers_in_s = devices, answers_in_s
        self.asked: list[tuple[str, str, dict[str, str]]] = []

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        """Answer as `AlpacaServer` does."""
        await asyncio.sleep(self.answers_in_s)
        verb, path = request.method.lower(), request.url.path
        sent = request.url.query if verb == "get" else await request.aread()
        form = dict(parse_qsl(sent.decode(), keep_blank_values=True))
        where, _, member = path.removeprefix("/api/v1/").rpartition("/")
        self.asked.append((verb, member, form))
        lower = {name.lower(): value for name, value in form.items()}
        said: dict[str, Any] = {
            "ClientTransactionID": int(lower.get("clienttransactionid", "0")),
            "ServerTransactionID": len(self.asked),
            "ErrorNumber": 0,
            "ErrorMessage": "",
        }
        value: Any = None
        try:
            if where not in self.devices:
                raise Bad("no such device")
            value = self.devices[where].answer(verb, member, form)
        except Bad as bad:
            return httpx.Response(400, stream=httpx.ByteStream(str(bad).encode()))
        except AlpacaError as error:
            said |= {"ErrorNumber": error.number, "ErrorMessage": error.message}
        if verb == "get":
            said["Value"] = value
        # unread, as from a socket
        body = httpx.ByteStream(json.dumps(said).encode())
        return httpx.Response(200, stream=body, headers={"Content-Type": "application/json"})


@contextmanager
def reached_in_memory(server: InMemory, clock: Callable[[], datetime]) -> Iterator[None]:
    """Have all Alpaca clients that are made here reach this server, whatever their address.

    Parameters
    ----------
    clock : callable
        Of its devices.
    """

    class Connected(alpaca_client.Connections):
        def __init__(self, where: DeviceAddress) -> None:
            self.looks, self.orders, self.stops = (httpx.AsyncClient(transport=server) for _ in range(3))

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(alpaca_client, "Connections", Connected)
        patched.setattr(alpaca_server, "utc_now", clock)
        yield
