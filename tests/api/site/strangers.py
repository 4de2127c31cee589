"""Services of a site as they may be: one that is well, and all that a roll-up has to live with."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

Answer = Callable[["Stranger", asyncio.StreamWriter, str, str], Awaitable[None]]

HEALTH: dict[str, Any] = {"status": "ok", "ready": True, "version": "1.2", "why_not": [], "concerns": []}
EAST: dict[str, Any] = {
    "id": "east",
    "connected": True,
    "activity": "tracking",
    "tracking": True,
    "icrs": {"ra_deg": 85.0, "dec_deg": -0.5},
    "altitude_deg": 55.5,
    "warnings": [],
}
STOPPED: dict[str, Any] = {
    "stopped": True,
    "telescopes": [{"telescope": "east", "stopped": True, "cancelled_job_id": None}],
}


@dataclass
class Stranger:
    """What listens at a port, and what it was asked."""

    answer: Answer
    port: int = 0
    asked: list[str] = field(default_factory=list)
    keys: set[str] = field(default_factory=set)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"


def said(status: int, body: object, headers: str = "") -> bytes:
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    head = f"HTTP/1.1 {status} x\r\ncontent-length: {len(content)}\r\n{headers}\r\n"
    return head.encode() + content


async def well(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    bodies = {"GET /v1/health": HEALTH, "GET /v1/telescopes": [EAST], "POST /v1/stop": STOPPED}
    out.write(said(200, bodies[asked]))


async def silent(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    await asyncio.Event().wait()


async def drips(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    out.write(b"HTTP/1.1 200 x\r\ncontent-type: application/json\r\ncontent-length: 100000\r\n\r\n")
    while True:
        out.write(b" ")
        await out.drain()
        await asyncio.sleep(0.05)


async def endless(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    out.write(b"HTTP/1.1 200 x\r\ncontent-type: application/json\r\n\r\n")
    while True:
        out.write(b"[" * 65536)
        await out.drain()


async def nested(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    out.write(said(200, b"[" * 200_000))


async def not_numbers(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    odd = {**EAST, "id": "<script>alert(1)</script>", "altitude_deg": float("inf"), "icrs": {"ra_deg": 1e300}}
    odd |= {"activity": ["x"], "warnings": "abc", "connected": "yes", "problem": "\x1b[2J" + "x" * 10_000}
    bodies = {
        "GET /v1/health": {**HEALTH, "concerns": {"a": 1}, "version": 7},
        "GET /v1/telescopes": [odd, 5, None, *[EAST] * 500],
        "POST /v1/stop": {"stopped": "yes", "telescopes": [1, {"telescope": 3, "stopped": 1}]},
    }
    out.write(said(200, bodies[asked]))


async def packed(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    out.write(said(200, b"\x1f\x8b" + bytes(100), "content-encoding: gzip\r\n"))


async def elsewhere(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    out.write(said(307, {}, "location: http://127.0.0.1:1/v1/stop\r\n"))


async def echoes(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    if asked == "GET /v1/health":
        out.write(said(200, {**HEALTH, "version": key, "concerns": [f"who sent {key}?"]}))
    elif asked == "GET /v1/telescopes":
        out.write(said(200, [{**EAST, "id": key, "problem": f"the key {key} is nice"}]))
    else:
        out.write(said(502, {"detail": f"no stop for {key}"}))


async def shut(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    out.write(said(401, {"detail": "the key is not known, or was revoked"}))


async def hangs_on_stop(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    if asked == "POST /v1/stop":
        await asyncio.sleep(2.5)
    await well(me, out, asked, key)


async def hangs_up(me: Stranger, out: asyncio.StreamWriter, asked: str, key: str) -> None:
    out.close()


@asynccontextmanager
async def listening(answer: Answer) -> AsyncIterator[Stranger]:
    """A stranger at a free port; all it does is ended with it."""
    me = Stranger(answer)
    tasks: set[asyncio.Task[Any]] = set()

    async def met(reader: asyncio.StreamReader, out: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        tasks.add(task)
        try:
            while head := await reader.readuntil(b"\r\n\r\n"):
                lines = head.decode().split("\r\n")
                asked = " ".join(lines[0].split()[:2])
                key = next(
                    (line.partition(": ")[2] for line in lines if line.lower().startswith("x-api-key")), ""
                )
                me.asked.append(asked)
                me.keys.add(key)
                await answer(me, out, asked, key)
                await out.drain()
        except (asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            pass
        finally:
            out.transport.abort()

    server = await asyncio.start_server(met, "127.0.0.1", 0)
    me.port = server.sockets[0].getsockname()[1]
    try:
        yield me
    finally:
        server.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await server.wait_closed()
        for _ in range(3):  # sockets are closed in the next turns of the loop
            await asyncio.sleep(0)
