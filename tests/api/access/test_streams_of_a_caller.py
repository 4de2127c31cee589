"""Streams of events are bounded for each caller, from however many addresses; all others have room."""

from __future__ import annotations

import asyncio
from typing import Any

from starlette.types import Message, Receive, Scope, Send

from api.access.callers import Caller, Face, Role
from api.http.guards import OpenStreams
from api.problems import Refused, problem


class Streams:
    """An application whose streams go on until they are let go."""

    def __init__(self) -> None:
        self.go = asyncio.Event()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        kind = b"text/event-stream" if scope["path"].endswith("/events") else b"application/json"
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-type", kind)]})
        await send({"type": "http.response.body", "body": b": first\n\n", "more_body": True})
        await self.go.wait()
        await send({"type": "http.response.body", "body": b"", "more_body": False})


async def test_one_caller_can_not_take_all_streams() -> None:
    app, known = Streams(), {"a": Role.VIEW, "b": Role.VIEW}

    def caller_of(scope: Scope) -> Caller:
        if scope["who"] not in known:
            raise Refused(problem("unauthorized", 401, "no key"))
        return Caller(scope["who"], known[scope["who"]], Face.REST)

    guard = OpenStreams(app, caller_of, most=3)

    async def ask(
        who: str, path: str = "/v1/events", method: str = "GET"
    ) -> tuple[asyncio.Task[None], list[Any]]:
        came: list[Message] = []

        async def send(message: Message) -> None:
            came.append(message)

        async def receive() -> Message:
            return {"type": "http.request", "body": b"", "more_body": False}

        scope = {
            "type": "http",
            "method": method,
            "path": path,
            "who": who,
            "client": ("::1", 1),
            "headers": [],
        }
        task = asyncio.create_task(guard(scope, receive, send))
        while not came:
            await asyncio.sleep(0)
        return task, came

    open_ones = [await ask("a") for _ in range(3)]
    refused = [(await ask("a", path))[1] for path in ("/v1/events", "/v1/jobs/x/events", "/v1/events/")]
    assert [one[0]["status"] for one in refused] == [429, 429, 429]
    assert b"streams_per_caller" in refused[0][1]["body"]
    assert dict(refused[0][0]["headers"])[b"retry-after"] == b"15"
    # others, and what is no stream, have room; strangers have one count for each address
    for who, path in (("b", "/v1/events"), ("a", "/v1/jobs"), ("x", "/v1/events")):
        open_ones.append(await ask(who, path))
        assert open_ones[-1][1][0]["status"] == 200
    # one that goes makes room
    open_ones[0][0].cancel()
    await asyncio.gather(open_ones[0][0], return_exceptions=True)
    open_ones.append(await ask("a"))
    assert open_ones[-1][1][0]["status"] == 200
    app.go.set()
    await asyncio.gather(*(task for task, _ in open_ones[1:]))
    assert not guard._open
