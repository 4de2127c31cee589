"""Whatever any face answers over HTTP, no foreign page can frame it, load it, or guess its type."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.routing import iter_route_contexts
from starlette.datastructures import Headers
from starlette.routing import Mount
from starlette.types import Message, Scope

from api.http.app import create_app
from api.http.headers import SAFE_HEADERS
from api.http.serving import bind, make_server
from mountnav.settings.observatory import Settings

METHODS = ("GET", "HEAD", "POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE")
BESIDES = (
    "/nothing",
    "/docs",
    "/docs/oauth2-redirect",
    "/redoc",
    "/openapi.json",
    "/static-offline-docs/swagger-ui.css",
    "/static-offline-docs/nothing",
    "/web/index.html",
    "/web/nothing",
    "/api/v1/telescope/0/connected",
    "/api/v1/telescope/99/connected",
    "/api/v1/nothing",
    "/management/nothing",
    "/setup",
    "/setup/v1/telescope/0/setup",
    "/setup/nothing",
    "//",
    "/v1/telescopes/%00/stop",
)


def _paths(app: FastAPI) -> Iterator[str]:
    for route in iter_route_contexts(app.routes):
        if isinstance(route.original_route, Mount):
            yield f"{route.path}/x"
        else:
            assert route.path is not None, route
            yield route.path
            # an id of ours, a number of Alpaca's
            yield route.path.replace("{telescope_id}", "east").replace("{device_number:int}", "0")


async def _head_of(app: FastAPI, method: str, path: str, headers: dict[str, str]) -> tuple[int, Headers]:
    """Ask, and take the answer's head; a stream is let go then."""
    head: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
    received = False

    async def receive() -> Message:
        nonlocal received
        if not received:
            received = True
            return {"type": "http.request", "body": b"", "more_body": False}
        await asyncio.wait({head})
        return {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        if message["type"] == "http.response.start" and not head.done():
            head.set_result(message)

    raw, _, query = path.partition("?")
    scope: Scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": method,
        "path": raw,
        "raw_path": raw.encode(),
        "root_path": "",
        "scheme": "http",
        "query_string": query.encode(),
        "headers": [
            (name.lower().encode(), value.encode())
            for name, value in ({"host": "127.0.0.1"} | headers).items()
        ],
        "client": ("127.0.0.1", 5),
        "server": ("127.0.0.1", 80),
        "state": {},
    }
    asked = asyncio.create_task(app(scope, receive, send))
    waited: set[Any] = {asked, head}
    await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED, timeout=60)
    assert head.done(), (method, path, asked)
    asked.cancel()
    await asyncio.gather(asked, return_exceptions=True)
    message = head.result()
    return message["status"], Headers(raw=list(message["headers"]))


def _is_safe(headers: Headers) -> bool:
    return (
        "frame-ancestors 'none'" in headers.get("content-security-policy", "")
        and len(headers.getlist("content-security-policy")) == 1
        and headers.getlist("x-frame-options") == ["DENY"]
        and headers.getlist("x-content-type-options") == ["nosniff"]
        and headers.getlist("cross-origin-resource-policy") == ["same-origin"]
    )


def _all_paths(app: FastAPI) -> list[str]:
    found = sorted({*_paths(app), *BESIDES})
    assert len(found) > 100
    assert any(path.startswith("/api/v1") for path in found)
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    "headers",
    [{}, {"origin": "https://elsewhere.example"}, {"host": "elsewhere.example"}],
    ids=["", "origin", "host"],
)
async def test_every_answer_of_every_route_and_method(observatory_toml: str, headers: dict[str, str]) -> None:
    """No service stands behind it: most answers are faults, and these are answers as well."""
    app = create_app(Settings.parse(observatory_toml))
    statuses = set()
    for path in _all_paths(app):
        for method in METHODS:
            status, found = await _head_of(app, method, path, headers)
            assert _is_safe(found), (method, path, status, dict(found))
            statuses.add(status)
    assert {403} == statuses if headers else {200, 404, 405, 500} <= statuses


@pytest.mark.long
async def test_every_answer_of_a_running_service(observatory_toml: str) -> None:
    app = create_app(Settings.parse(observatory_toml))
    async with app.router.lifespan_context(app):
        statuses = {}
        for path in _all_paths(app):
            for method in ("GET", "HEAD"):
                status, found = await _head_of(app, method, path, {})
                assert _is_safe(found), (method, path, status, dict(found))
                statuses[path] = status
        assert statuses["/v1/events"] == 200
        assert statuses["/v1/telescopes/east/last-frame"] == 204
        assert statuses["/setup/v1/telescope/0/setup"] == 200
        assert statuses["/docs"] == 200


async def test_what_is_no_http_is_answered_so_as_well(observatory_toml: str) -> None:
    server = make_server(create_app(Settings.parse(observatory_toml)), log_level="error")
    server.config.lifespan = "off"
    with bind("127.0.0.1", 0) as listener:
        task = asyncio.create_task(server._serve([listener]))
        while not server.started:
            await asyncio.sleep(0.01)
        reader, writer = await asyncio.open_connection(*listener.getsockname()[:2])
        writer.write(b"\x16\x03\x01 nonsense\r\n\r\n")
        answer = (await reader.read()).lower()
        writer.close()
        server.should_exit = True
        await task
    assert answer.startswith(b"http/1.1 400")
    for name, value in SAFE_HEADERS:
        assert name + b": " + value.lower() in answer
