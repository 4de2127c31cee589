"""Requests by raw sockets: of doubtful ends, cut off, or for another protocol; half an order is none."""

from __future__ import annotations

import asyncio
import json
from contextlib import closing
from typing import Any
from urllib.parse import unquote

import pytest
from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from api.http.connections import Bounds, Gate, _take_origin_form
from tests.api.http.test_connections import TOKEN, _behind, _from, _Held, address  # noqa: F401

HOST = b"Host: 127.0.0.1\r\n"
KEY = b"X-API-Key: " + TOKEN.encode() + b"\r\n"
NEXT = b"GET /next HTTP/1.1\r\n" + HOST + b"\r\n"
DOUBTFUL = {
    "both": b" HTTP/1.1\r\n" + HOST + b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
    "both, the other way round": b" HTTP/1.1\r\n"
    + HOST
    + b"Transfer-Encoding: chunked\r\nContent-Length: 5\r\n\r\n0\r\n\r\n",
    "chunks in HTTP/1.0": b" HTTP/1.0\r\n"
    + HOST
    + b"Connection: keep-alive\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
}


async def _answers(data: bytes) -> tuple[bytes, list[str]]:
    heard: list[str] = []
    async with _behind(Gate(Bounds()), heard) as where, _Held() as held, asyncio.timeout(60):
        reader, writer = await held.open(where)
        writer.write(data)
        return await reader.read(), heard


@pytest.mark.parametrize("rest", DOUBTFUL.values(), ids=DOUBTFUL)
async def test_a_request_that_tells_its_length_in_two_ways_is_refused_and_the_last(rest: bytes) -> None:
    told, heard = await _answers(b"POST /a" + rest + NEXT)
    assert told.startswith(b"HTTP/1.1 400 ")
    assert told.count(b"HTTP/1.1 ") == 1
    assert heard == []


@pytest.mark.parametrize("rest", DOUBTFUL.values(), ids=DOUBTFUL)
async def test_a_stop_of_doubtful_length_counts_and_is_the_last(rest: bytes) -> None:
    told, heard = await _answers(b"POST /v1/stop" + rest + NEXT)
    assert told.startswith(b"HTTP/1.1 200 ")
    assert heard == ["/v1/stop"]


@pytest.mark.parametrize("protocol", [b"websocket", b"h2c"])
async def test_who_asks_for_another_protocol_is_answered_and_no_advice_is_logged(
    protocol: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    asking = b"Connection: Upgrade, close\r\nUpgrade: " + protocol + b"\r\n\r\n"
    advised: list[object] = []
    monkeypatch.setattr(H11Protocol, "_unsupported_upgrade_warning", lambda one: advised.append(one))
    told, _ = await _answers(b"GET /a HTTP/1.1\r\n" + HOST + asking)
    assert told.startswith(b"HTTP/1.1 200 ")
    assert not advised


HALVES = {
    "no body": b"Content-Length: 100\r\n\r\n",
    "a piece": b"Content-Length: 100\r\nContent-Type: application/json\r\n\r\n{}",
    "text": b"Content-Length: 100\r\nContent-Type: text/plain\r\n\r\n{}",
    "no chunk": b"Transfer-Encoding: chunked\r\n\r\n",
    "no last chunk": b"Transfer-Encoding: chunked\r\nContent-Type: application/json\r\n\r\n2\r\n{}\r\n",
}


@pytest.mark.parametrize("rest", HALVES.values(), ids=HALVES)
@pytest.mark.parametrize("kind", ["unpark", "look"])
def test_no_order_comes_of_half_a_request(address: tuple[str, int], kind: str, rest: bytes) -> None:  # noqa: F811
    head = f"POST /v1/telescopes/east/{kind} HTTP/1.1\r\n".encode() + HOST + KEY
    with closing(_from(address, "127.0.0.1", head + rest)) as cut:
        # the end of what we say is the end of the connection
        cut.shutdown(1)
        assert cut.recv(65_536) == b""
    assert not [one["kind"] for one in _jobs(address) if one["kind"] == kind]


def test_an_order_is_carried_out_when_its_body_is_whole(address: tuple[str, int]) -> None:  # noqa: F811
    head = b"POST /v1/telescopes/east/tracking HTTP/1.1\r\n" + HOST + KEY
    body = b'{"on": true}'
    head += b"Content-Type: application/json\r\nContent-Length: %d\r\n\r\n" % len(body)
    with closing(_from(address, "127.0.0.1", head + body[:5])) as slow:
        assert not _jobs(address)
        slow.sendall(body[5:])
        assert slow.recv(65_536).startswith(b"HTTP/1.1 202 ")
    assert [one["kind"] for one in _jobs(address)] == ["tracking"]


def _jobs(address: tuple[str, int]) -> list[dict[str, object]]:  # noqa: F811
    ask = b"GET /v1/jobs HTTP/1.1\r\n" + HOST + KEY + b"Connection: close\r\n\r\n"
    told = b""
    with closing(_from(address, "127.0.0.1", ask)) as asking:
        while piece := asking.recv(65_536):
            told += piece
    found = json.loads(told.partition(b"\r\n\r\n")[2])
    return list(found["jobs"] if isinstance(found, dict) else found)


@pytest.mark.parametrize("form", [b"http://127.0.0.1:%d/v1/stop", b"HTTP://somewhere.else/v1/stop?wait=1"])
async def test_a_stop_whose_address_names_its_host_counts(form: bytes) -> None:
    target = form.replace(b"%d", b"80")
    told, heard = await _answers(b"POST " + target + b" HTTP/1.1\r\n" + HOST + b"Connection: close\r\n\r\n")
    assert told.startswith(b"HTTP/1.1 200 ")
    assert heard == ["/v1/stop"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("target", "path", "host"),
    [
        ("http://a:80/b%20c/d", "/b c/d", b"a:80"),
        ("https://a", "/", b"a"),
        ("/http://a/b", "/http://a/b", b"h"),
        ("*", "*", b"h"),
    ],
)
def test_the_host_in_an_address_is_the_one_that_counts(target: str, path: str, host: bytes) -> None:
    scope: dict[str, Any] = {
        "raw_path": target.encode(),
        "path": unquote(target),
        "headers": [(b"host", b"h"), (b"a", b"b")],
    }
    _take_origin_form(scope)
    assert (scope["path"], dict(scope["headers"])) == (path, {b"host": host, b"a": b"b"})


@pytest.mark.long
@pytest.mark.parametrize("begun", [False, True], ids=["before it answers", "in its answer"])
async def test_a_body_that_breaks_off_in_nonsense_leaves_no_traceback(
    begun: bool, caplog: pytest.LogCaptureFixture
) -> None:
    body, over = asyncio.Event(), asyncio.Event()

    async def application(scope: Scope, receive: Receive, send: Send) -> None:
        if begun:
            await send({"type": "http.response.start", "status": 200, "headers": []})
        body.set()
        while (await receive()).get("more_body", False):
            pass
        if not begun:
            await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"x"})
        over.set()

    gate = Gate(Bounds())
    async with _behind(gate, application=application) as where, _Held() as held, asyncio.timeout(60):
        reader, writer = await held.open(where)
        writer.write(b"POST /a HTTP/1.1\r\n" + HOST + b"Transfer-Encoding: chunked\r\n\r\n")
        await body.wait()
        writer.write(b"nonsense\r\n")
        told = await reader.read()
        await over.wait()
    assert told.count(b"HTTP/1.1 ") == 1
    assert told.startswith(b"HTTP/1.1 200 " if begun else b"HTTP/1.1 400 ")
    assert not [one for one in caplog.records if one.exc_info], caplog.text
