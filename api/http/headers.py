"""Headers: safe ones on every answer, a bound on a request's, and HEAD answered as GET.

A page of another site that frames ours needs no key: three clicks that were meant for something else would
press its buttons. Each guard looks through a request's headers: 6,000 held the loop for up to 0.2 s.
Watchdogs and load balancers ask by HEAD [RFC 9110 §9.3.2].
"""

from __future__ import annotations

import asyncio

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.rate_limits import is_stop
from api.problems import Problem, problem, refusal_response

__all__ = ["SAFE_HEADERS", "BoundedHeads", "SafeHeaders"]


_POLICY = "Content-Security-Policy"
_NO_FRAMES = "frame-ancestors 'none'"
_HEADERS = {
    _POLICY: _NO_FRAMES,
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    # pages that `cors_origins` names ask by CORS, which this doesn't touch
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
}
SAFE_HEADERS = tuple((name.lower().encode(), value.encode()) for name, value in _HEADERS.items())
"""As bytes, for answers that no application makes."""


class SafeHeaders:
    """Put the headers on whatever goes out; a stricter policy of the answer's own stays. Plain ASGI."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def told(message: Message) -> None:
            if message["type"] == "http.response.start":
                message.setdefault("headers", [])
                headers = MutableHeaders(scope=message)
                own = headers.get(_POLICY, _NO_FRAMES)
                for name, value in _HEADERS.items():
                    headers[name] = value
                headers[_POLICY] = own if "frame-ancestors" in own else f"{own}; {_NO_FRAMES}"
            await send(message)

        await self._app(scope, receive, told)


_MOST_HEADERS = 100
"""As common servers have it; a browser behind a proxy sends some 30. Each guard looks through all of them."""


class BoundedHeads:
    """Refuse heads that no client of ours sends; a stop is taken without what is too much. Plain ASGI."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        refusal = None if scope["type"] != "http" else _refusal(scope)
        if refusal is None:
            await self._app(scope, receive, send)
        elif is_stop(scope["method"], scope["path"]):
            taken = {**scope, "headers": scope["headers"][:_MOST_HEADERS]}
            await self._app(taken, receive, send)
        else:
            await refusal_response(scope, refusal)(scope, receive, send)


def _refusal(scope: Scope) -> Problem | None:
    if len(scope["headers"]) > _MOST_HEADERS:
        return problem("too-large", 431, f"there are more than {_MOST_HEADERS} headers")
    return None


class HeadAsGet:
    """ASGI: let the application see a GET, and keep its body back.

    Of a stream only the head is waited for: it would not end.
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
