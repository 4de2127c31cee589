"""How large a request's body may be: frames may be large where frames are sent, nothing else may."""

from __future__ import annotations

import re

from starlette.datastructures import Headers
from starlette.middleware.body_limit import RequestBodyLimitMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.limits_of_rate import is_stop
from api.http.faults import PROBLEM_TYPE, problem
from api.http.refusals import refusal_response

UPLOADS = re.compile(r"/v1/solve|/v1/telescopes/[^/]+/frames")
"""Where frames are sent."""
_FORM_BYTES = 1_000_000
"""What a form puts around a frame, at the most."""


class BodyLimit:
    """Answer 413 to what is too large: before anything is done if its length is told, else when it shows.

    A stop is passed on whatever comes with it: nobody reads its body. Plain ASGI, so that event streams pass
    unbuffered.

    Parameters
    ----------
    app : ASGIApp
    max_body_kb : float
    max_upload_mb : float
        Where frames are sent; their routes count for themselves as well.
    """

    def __init__(self, app: ASGIApp, *, max_body_kb: float, max_upload_mb: float) -> None:
        self._app = app
        self._small = RequestBodyLimitMiddleware(app, int(max_body_kb * 1e3))
        self._large = RequestBodyLimitMiddleware(app, int(max_upload_mb * 1e6) + _FORM_BYTES)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, with an eye on its body."""
        if scope["type"] != "http" or is_stop(scope["method"], scope["path"]):
            await self._app(scope, receive, send)
            return
        limited = self._large if UPLOADS.fullmatch(scope["path"]) else self._small
        refusal = refusal_response(
            scope, problem("too-large", 413, f"the body is larger than {limited.max_body_size} bytes")
        )
        # else an order that needs no body would be carried out, and its answer be 413 nevertheless
        if _length(Headers(scope=scope)) > limited.max_body_size:
            await refusal(scope, receive, send)
            return
        replaced = False

        async def told(message: Message) -> None:
            nonlocal replaced
            if message["type"] == "http.response.start" and message["status"] == 413:
                kind = Headers(raw=list(message.get("headers", ()))).get("content-type", "")
                if not kind.startswith(PROBLEM_TYPE):
                    # starlette answers in plain words
                    replaced = True
                    await refusal(scope, receive, send)
            if not replaced:
                await send(message)

        await limited(scope, receive, told)


def _length(headers: Headers) -> int:
    """What the request says of its length; 0 if it doesn't, or nonsense, which the server refuses itself."""
    told = headers.get("content-length", "")
    return int(told) if told.isascii() and told.isdigit() and len(told) < 19 else 0
