"""Uploads: taken in as they come, into files without a name, and refused as soon as they are too long."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import Request
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.requests import ClientDisconnect
from starlette.types import Message, Receive

from api.http.faults import Refused, problem
from api.solver.solver_work import Upload
from mountnav.errors import BadFrame, BadRequest, Cancelled


@asynccontextmanager
async def received(request: Request, limit_bytes: int) -> AsyncIterator[Upload]:
    """Receive a request's file: the part `file` of a form, or else the body itself.

    Parameters
    ----------
    request : Request
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
    return Cancelled("the client left in the middle of its upload", advice="send it again")


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
