"""Streams of events end when the key that opened them is revoked: nothing is told after that."""

from __future__ import annotations

from collections.abc import Callable

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.callers import Caller
from api.http.faults import Refused


class OpenStreams:
    """Before each piece of a stream, ask anew whether its listener may hear it. Plain ASGI.

    Parameters
    ----------
    app : ASGIApp
    caller_of : callable
        Who sent a request. Raises `Refused` when he is none any more.
    """

    def __init__(self, app: ASGIApp, caller_of: Callable[[Scope], Caller]) -> None:
        self._app = app
        self._caller_of = caller_of

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        streaming = ended = False

        async def checked(message: Message) -> None:
            nonlocal streaming, ended
            if ended:
                return
            if message["type"] == "http.response.start":
                kind = Headers(raw=list(message.get("headers", ()))).get("content-type", "")
                streaming = kind.startswith("text/event-stream")
            elif streaming and not self._may_hear(scope):
                # the server takes this for the end, and tells the application that its listener has gone
                ended = True
                await send({"type": "http.response.body", "body": b"", "more_body": False})
                return
            await send(message)

        await self._app(scope, receive, checked)

    def _may_hear(self, scope: Scope) -> bool:
        try:
            self._caller_of(scope)
        except Refused:
            return False
        return True
