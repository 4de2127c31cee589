"""Headers of every answer of every face: no foreign page may frame it, load it, or guess its type.

A page of another site that frames ours needs no key: three clicks that were meant for something else would
press its buttons.
"""

from __future__ import annotations

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

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
    """Put the headers on whatever goes out; a stricter policy of the answer's own stays. Plain ASGI.

    Parameters
    ----------
    app : ASGIApp
    """

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


__all__ = ["SAFE_HEADERS", "SafeHeaders"]
