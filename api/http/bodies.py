"""Request bodies: how large they may be, whole before an order begins, and uploads as files."""

from __future__ import annotations

import os
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import Request
from starlette.datastructures import Headers, UploadFile
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.middleware.body_limit import RequestBodyLimitMiddleware
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.rate_limits import is_stop
from api.problems import PROBLEM_TYPE, Refused, problem, refusal_response
from api.solver.link import Upload
from mountnav.errors import BadFrame, BadRequest, Cancelled

__all__ = ["WholeBodies"]


UPLOADS = re.compile(r"/v1/solve|/v1/telescopes/[^/]+/frames")
"""Where frames are sent."""
_FORM_BYTES = 1_000_000
"""What a form puts around a frame, at the most."""


class BodyLimit:
    """Answer 413 to what is too large: before anything is done if its length is given, else when it shows.

    A stop is passed on whatever comes with it: nobody reads its body. Plain ASGI, so that event streams pass
    unbuffered.

    Parameters
    ----------
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


@asynccontextmanager
async def received(request: Request, limit_bytes: int) -> AsyncIterator[Upload]:
    """Receive a request's file: the part `file` of a form, or else the body itself.

    Parameters
    ----------
    limit_bytes : int
        Longest body.

    Yields
    ------
    Upload
        Open until the context ends.

    Raises
    ------
    Refused
        413: it is longer than the limit.
    BadFrame
        It is empty.
    BadRequest
        The form can't be read, or has no such part.
    Cancelled
        The client left before it was sent completely.
    """
    announced = request.headers.get("content-length", "0")
    if announced.isascii() and announced.isdigit() and int(announced[:20]) > limit_bytes:
        raise _too_large(limit_bytes)
    limited = Request(request.scope, _limited(request.receive, limit_bytes))
    a_form = request.headers.get("content-type", "").startswith("multipart/form-data")
    async with _of_form(limited) if a_form else _of_body(limited) as upload:
        if os.fstat(upload.file).st_size == 0:
            raise BadFrame(
                "the upload is empty", advice="send the file as the body, or as the form part `file`"
            )
        yield upload


@asynccontextmanager
async def _of_body(limited: Request) -> AsyncIterator[Upload]:
    """The body, written to memory piece by piece."""
    with os.fdopen(os.memfd_create("mountnav-upload"), "wb", buffering=0) as file:
        try:
            async for piece in limited.stream():
                left = memoryview(piece)
                while left:
                    left = left[file.write(left) :]
        except ClientDisconnect as gone:
            raise _gone() from gone
        yield Upload("upload", file.fileno())


@asynccontextmanager
async def _of_form(limited: Request) -> AsyncIterator[Upload]:
    """The part `file`, where the reader of forms spooled it."""
    try:
        form = await limited.form(max_files=1, max_fields=20)
    except ClientDisconnect as gone:
        raise _gone() from gone
    except (MultiPartException, HTTPException) as error:
        told = error.message if isinstance(error, MultiPartException) else error.detail
        raise BadRequest(f"the form can't be read: {told}", advice="curl -F file=@frame.fits URL") from error
    try:
        part = form.get("file")
        if not isinstance(part, UploadFile):
            raise BadRequest("the form has no part `file`", advice="curl -F file=@frame.fits URL")
        part.file.flush()
        yield Upload(part.filename or "upload", part.file.fileno())
    finally:
        await limited.close()


def _gone() -> Cancelled:
    return Cancelled("the client disconnected during its upload", advice="send it again")


def _limited(receive: Receive, limit_bytes: int) -> Receive:
    taken = 0

    async def receive_limited() -> Message:
        nonlocal taken
        message = await receive()
        taken += len(message.get("body", b""))
        if taken > limit_bytes:
            raise _too_large(limit_bytes)
        return message

    return receive_limited


def _too_large(limit_bytes: int) -> Refused:
    limit_mb = limit_bytes / 1e6
    found = problem(
        "too-large",
        413,
        f"the upload is larger than {limit_mb:g} MB",
        advice="send a smaller file, or raise service.max_upload_mb",
    )
    return Refused(found)
