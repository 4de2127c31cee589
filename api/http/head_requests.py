"""HEAD is answered as GET is, without the body: watchdogs and load balancers ask so [RFC 9110 §9.3.2]."""

from __future__ import annotations

import asyncio

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send


class HeadAsGet:
    """ASGI: let the application see a GET, and keep its body back.

    Of a stream only the head is waited for: it would not end.

    Parameters
    ----------
    app : ASGI application
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        cut = asyncio.timeout(None)
        try:
            async with cut:
                await self._app({**scope, "method": "GET"}, receive, _head_alone(send, cut))
        except TimeoutError:
            if not cut.expired():
                raise


def _head_alone(send: Send, cut: asyncio.Timeout) -> Send:
    ended = False

    async def told(message: Message) -> None:
        nonlocal ended
        if message["type"] != "http.response.start":
            if message["type"] == "http.response.body" and not ended:
                ended = True
                await send({"type": "http.response.body"})
            return
        await send(message)
        if Headers(raw=message.get("headers", [])).get("content-type", "").startswith("text/event-stream"):
            ended = True
            await send({"type": "http.response.body"})
            cut.reschedule(asyncio.get_running_loop().time())

    return told
