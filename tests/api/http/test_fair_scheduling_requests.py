"""Requests begin one in each turn of the loop, stops before them; heads of too many headers are refused."""

from __future__ import annotations

import asyncio

import httpx
import pytest
from starlette.types import Message, Receive, Scope, Send

import api.http.fair_scheduling
from api.http.fair_scheduling import FairRequests
from api.http.headers import BoundedHeads

STOP, SLEW = "/v1/stop", "/v1/telescopes/east/slew"


async def nothing() -> Message:
    return {"type": "http.request"}


async def nowhere(_: Message) -> None:
    """Takes an answer that nobody reads."""


def asked(path: str) -> Scope:
    return {"type": "http", "method": "POST", "path": path}


class Service:
    """Notes in which turn of the loop each request begins; stops go on until they are let go."""

    def __init__(self) -> None:
        self.turn = 0
        self.begun: list[tuple[str, int]] = []
        self.over = asyncio.Event()
        self._ticking = asyncio.create_task(self._tick())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.begun.append((scope["path"], self.turn))
        if scope["path"] == STOP:
            await self.over.wait()

    @property
    def paths(self) -> list[str]:
        return [path for path, _ in self.begun]

    async def turns(self, count: int) -> None:
        end = self.turn + count
        while self.turn < end:
            await asyncio.sleep(0)

    def end(self) -> None:
        self._ticking.cancel()

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(0)
            self.turn += 1


async def test_each_begins_in_a_turn_of_its_own() -> None:
    service = Service()
    fair = FairRequests(service, lambda _: True)
    await asyncio.gather(*(fair(asked(SLEW), nothing, nowhere) for _ in range(100)))
    turns = [turn for _, turn in service.begun]
    assert len(turns) == len(set(turns)) == 100
    service.end()


async def test_a_stop_goes_before_those_that_wait_and_none_begins_until_it_is_over() -> None:
    service = Service()
    fair = FairRequests(service, lambda _: True)
    waiting = [asyncio.create_task(fair(asked(SLEW), nothing, nowhere)) for _ in range(50)]
    await service.turns(10)
    stop = asyncio.create_task(fair(asked(STOP), nothing, nowhere))
    await service.turns(10)
    assert STOP in service.paths
    before = len(service.begun)
    await service.turns(100)
    # one may have had its turn when the stop came
    assert len(service.begun) == before < 50
    service.over.set()
    await asyncio.gather(stop, *waiting)
    assert len(service.begun) == 51
    service.end()


async def test_a_strangers_stop_waits_with_the_others() -> None:
    service = Service()
    service.over.set()
    fair = FairRequests(service, lambda _: False)
    await asyncio.gather(*(fair(asked(path), nothing, nowhere) for path in (SLEW, SLEW, STOP, SLEW)))
    assert service.paths == [SLEW, SLEW, STOP, SLEW]
    assert len({turn for _, turn in service.begun}) == 4
    service.end()


async def test_a_stop_without_end_holds_the_others_for_a_while_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(api.http.fair_scheduling, "_HELD_S", 0.01)
    service = Service()
    fair = FairRequests(service, lambda _: True)
    stop = asyncio.create_task(fair(asked(STOP), nothing, nowhere))
    await service.turns(2)
    await fair(asked(SLEW), nothing, nowhere)
    assert service.paths == [STOP, SLEW]
    assert not stop.done()
    service.over.set()
    await stop
    service.end()


MANY = {f"x{number}": "1" for number in range(200)}


@pytest.mark.long
@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/v1/telescopes", MANY, 431),
        ("/api/v1/telescope/0/connected", MANY, 431),
        ("/v1/telescopes", {"Origin": "http://["}, 403),
    ],
)
async def test_a_head_that_no_client_sends_is_refused(
    client: httpx.AsyncClient, path: str, headers: dict[str, str], status: int
) -> None:
    assert (await client.get(path, headers=headers)).status_code == status


@pytest.mark.parametrize("path", [STOP, "/v1/telescopes", "/v1/telescopes/east/slew"])
async def test_a_stop_alone_is_taken_with_any_number_of_headers_and_the_first_ones_count(path: str) -> None:
    taken: list[int] = []

    async def counting(scope: Scope, receive: Receive, send: Send) -> None:
        taken.append(len(scope["headers"]))

    headers = [(f"x{number}".encode(), b"1") for number in range(200)]
    await BoundedHeads(counting)({**asked(path), "headers": headers}, nothing, nowhere)
    # guards behind it look at no more than these
    assert taken == ([100] if path == STOP else [])


@pytest.mark.long
@pytest.mark.parametrize("host", ["[", "[::1", "127.0.0.1]", "evil@127.0.0.1"])
async def test_a_host_that_is_none_is_no_loopback_name(client: httpx.AsyncClient, host: str) -> None:
    assert (await client.get("/v1/telescopes", headers={"Host": host})).status_code == 403
