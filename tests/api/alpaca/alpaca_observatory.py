"""An observatory as Alpaca clients meet it: a service in this process, a client that checks envelopes."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import httpx
from fastapi import FastAPI

from api.http.app import create_app
from api.service import Service
from mountnav.clock import in_virtual_time, utc_now
from mountnav.settings.observatory import Settings
from mountnav.simulation.sky_clock import FastClock

OBSERVATORY = """
[service]
port = 0
rate_limit_per_s = 0
[solving]
worker = false
blind = "never"
[site]
latitude_deg = 47.0
longitude_deg = 11.0
height_m = 580.0
[alpaca]
discovery = false
location = "a test"
[[telescope]]
id = "german"
focal_length_mm = 800
aperture_mm = 200
camera = { kind = "simulated", width_px = 100, height_px = 100 }
[telescope.mount]
url = "fake+lx200://?dialect=onstep"
mounting = "german"
slew_rate_deg_s = 40.0
acceleration_deg_s2 = 8.0
[[telescope]]
id = "fork"
camera = { kind = "simulated", width_px = 100, height_px = 100 }
mount = { url = "fake+lx200://", slew_rate_deg_s = 40.0, acceleration_deg_s2 = 8.0 }
[[telescope]]
id = "gone"
mount = { url = "lx200+serial:///dev/there-is-no-such-port" }
camera = { kind = "folder", path = "/" }
"""

KEYS = {"ClientTransactionID", "ServerTransactionID", "ErrorNumber", "ErrorMessage"}
SPEED = 40.0
"""How many times as fast as the sky, where slews are awaited."""
WITH_VALUE = {"action", "commandbool", "commandstring"}
"""PUTs whose answer has a value."""


@dataclass
class Answer:
    """An answer with HTTP 200."""

    number: int
    words: str
    value: Any = None


@dataclass
class AlpacaProbe:
    """A client of one telescope, which holds every answer against the rules of envelopes."""

    http: httpx.AsyncClient
    number: int = 0
    client_id: int = 42
    _transactions: Any = field(default_factory=lambda: count(1000))
    _last_server: int = 0

    def as_client(self, client_id: int) -> AlpacaProbe:
        """The same telescope for another client."""
        return AlpacaProbe(self.http, self.number, client_id)

    def at(self, number: int) -> AlpacaProbe:
        """Another telescope for the same client."""
        return AlpacaProbe(self.http, number, self.client_id)

    async def raw(self, verb: str, member: str, given: dict[str, object]) -> httpx.Response:
        """One request as it is."""
        path = f"/api/v1/telescope/{self.number}/{member}"
        sent = {name: str(value) for name, value in given.items()}
        if verb == "GET":
            return await self.http.get(path, params=sent)
        return await self.http.request(verb, path, data=sent)

    async def ask(self, verb: str, member: str, **given: object) -> Answer:
        """One request with ids; its envelope is checked."""
        transaction = next(self._transactions)
        ids: dict[str, object] = {"ClientID": self.client_id, "ClientTransactionID": transaction}
        found = await self.raw(verb, member, {**given, **ids})
        assert found.status_code == 200, (verb, member, found.status_code, found.text)
        return self.checked(verb, member, found, transaction)

    def checked(self, verb: str, member: str, found: httpx.Response, transaction: int) -> Answer:
        """The envelope of an answer, held against the rules."""
        assert found.headers["content-type"].partition(";")[0] == "application/json"
        answer = json.loads(found.content, parse_constant=_no_constant)
        has_value = verb == "GET" or member in WITH_VALUE
        assert set(answer) == (KEYS | {"Value"} if has_value else KEYS), (verb, member)
        assert answer["ClientTransactionID"] == transaction
        assert type(answer["ServerTransactionID"]) is int
        assert 0 < answer["ServerTransactionID"] < 2**32
        assert answer["ServerTransactionID"] > self._last_server
        self._last_server = answer["ServerTransactionID"]
        assert type(answer["ErrorNumber"]) is int
        assert answer["ErrorNumber"] == 0 or 0x400 <= answer["ErrorNumber"] <= 0xFFF
        assert isinstance(answer["ErrorMessage"], str)
        assert (answer["ErrorNumber"] == 0) == (answer["ErrorMessage"] == "")
        return Answer(answer["ErrorNumber"], answer["ErrorMessage"], answer.get("Value"))

    async def get(self, member: str, **given: object) -> Any:
        """A value; an error is the test's."""
        found = await self.ask("GET", member, **given)
        assert found.number == 0, (member, hex(found.number), found.words)
        return found.value

    async def put(self, member: str, **given: object) -> None:
        """An order; an error is the test's."""
        found = await self.ask("PUT", member, **given)
        assert found.number == 0, (member, hex(found.number), found.words)

    async def refused(self, verb: str, member: str, **given: object) -> int:
        """The number of the error; none is the test's."""
        found = await self.ask(verb, member, **given)
        assert found.number != 0, (verb, member, "was not refused")
        return found.number

    async def until_rest(self) -> None:
        """Wait until Slewing is False; an error of it is the test's."""
        async with asyncio.timeout(60):
            while await self.get("slewing"):
                await asyncio.sleep(0.02)

    async def until(self, member: str, value: object) -> None:
        """Wait until a member has a value."""
        async with asyncio.timeout(60):
            while await self.get(member) != value:
                await asyncio.sleep(0.02)

    async def at_hour_angle(self, hour_angle_h: float) -> float:
        """The right ascension that stands at an hour angle now."""
        return float((await self.get("siderealtime") - hour_angle_h) % 24.0)

    async def slew_to(self, hour_angle_h: float, dec_deg: float) -> float:
        """Slew, and come to rest; the right ascension."""
        ra_h = await self.at_hour_angle(hour_angle_h)
        await self.put("slewtocoordinatesasync", RightAscension=ra_h, Declination=dec_deg)
        assert await self.get("slewing") is True
        await self.until_rest()
        return ra_h

    async def miss_arcsec(self, ra_h: float, dec_deg: float) -> float:
        """How far from a place it reads, in the worse axis; RA in its own arc."""
        ra = abs((await self.get("rightascension") - ra_h + 12.0) % 24.0 - 12.0) * 54_000.0
        return float(max(ra, abs(await self.get("declination") - dec_deg) * 3600.0))

    async def took_s(self, verb: str, member: str, **given: object) -> float:
        """How long one request takes."""
        began = time.perf_counter()
        await self.ask(verb, member, **given)
        return time.perf_counter() - began


def _no_constant(text: str) -> object:
    raise AssertionError(f"{text} is not JSON")


@dataclass
class Running:
    """A service and a client of its first telescope."""

    app: FastAPI
    service: Service
    http: httpx.AsyncClient
    probe: AlpacaProbe


@asynccontextmanager
async def running(
    toml: str = OBSERVATORY, *, speed: float | None = None, headers: dict[str, str] | None = None
) -> AsyncIterator[Running]:
    """A service without a socket; what can be connected is. With a speed it lives in a time of its own."""
    with nullcontext() if speed is None else in_virtual_time(FastClock(speed, utc_now())):
        async with _running(toml, headers) as found:
            yield found


@asynccontextmanager
async def _running(toml: str, headers: dict[str, str] | None) -> AsyncIterator[Running]:
    app = create_app(Settings.parse(toml))
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(
            transport=transport, base_url="http://127.0.0.1", timeout=60, headers=headers
        ) as http,
    ):
        service: Service = app.state.service
        for one in service.dispatcher.telescopes:
            await service.dispatcher.watch(one.id).refresh()
        yield Running(app, service, http, AlpacaProbe(http))
