"""An order begins when all of its request is there: one that was cut off in its body is not carried out."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.limits_of_rate import is_stop
from api.http.body_limit import UPLOADS
from api.http.faults import problem
from api.http.refusals import refusal_response

_ASKING = frozenset({"GET", "HEAD", "OPTIONS", "TRACE"})


class WholeBodies:
    """Wait for the body that a request promises, whether its route reads one or not. Plain ASGI.

    A stop is passed on at once, whatever comes of its body; frames are read as they come, by who keeps them.

    Parameters
    ----------
    app : ASGIApp
        Behind a bound on the length of bodies: they are kept whole here.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, with its body."""
        if not _waits(scope):
            await self._app(scope, receive, send)
            return
        messages: list[Message] = []
        while not messages or messages[-1].get("more_body", False):
            message = await receive()
            if message["type"] != "http.request":
                # nobody reads this; the audit has it
                cut = problem("bad-request", 400, "the request ended before its body did")
                await refusal_response(scope, cut)(scope, receive, send)
                return
            messages.append(message)
        whole = iter(messages)

        async def again() -> Message:
            return next(whole, None) or await receive()

        await self._app(scope, again, send)


def _waits(scope: Scope) -> bool:
    if scope["type"] != "http" or scope["method"] in _ASKING or is_stop(scope["method"], scope["path"]):
        return False
    headers = Headers(scope=scope)
    promised = "transfer-encoding" in headers or headers.get("content-length", "0").strip("0") != ""
    return promised and UPLOADS.fullmatch(scope["path"]) is None


__all__ = ["WholeBodies"]
