"""Every error as a problem+json (RFC 9457): a stable type, what happened, to what, and what to do."""

from __future__ import annotations

import json
import logging
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from mountnav.errors import MountnavError

PROBLEM_TYPE = "application/problem+json"
_PREFIX = "urn:mountnav:problem:"
_log = logging.getLogger(__name__)

STATUS_OF_SLUG = {
    "device-error": 502,
    "device-missing": 503,
    "device-silent": 504,
    "device-garbled": 502,
    "device-refused": 502,
    "sync-ignored": 502,
    "solve-failed": 422,
    "offset-too-large": 409,
    "outside-limits": 422,
    "mount-moved": 409,
    "target-not-reached": 504,
    "bad-frame": 422,
    "bad-request": 422,
    "not-found": 404,
    "busy": 409,
    "cancelled": 409,
}
_TITLES = {
    "device-missing": "The device can't be reached",
    "device-silent": "The device gives no answer",
    "device-garbled": "The device's answers make no sense",
    "device-refused": "The device refused",
    "sync-ignored": "The mount accepted a sync and ignored it",
    "solve-failed": "The frame could not be identified",
    "offset-too-large": "The offset is too large to be believed",
    "outside-limits": "The target is outside the limits",
    "mount-moved": "The mount moved during the exposure",
    "target-not-reached": "The target was not reached",
    "bad-frame": "No usable image",
    "bad-request": "The request makes no sense",
    "not-found": "There is nothing of that name",
    "busy": "The telescope is busy",
    "cancelled": "Stopped on request",
    "unauthorized": "A token is needed",
    "forbidden": "Not from there",
    "too-large": "The upload is too large",
    "internal": "A fault in mountnav",
}


class Problem(BaseModel):
    """What went wrong, as RFC 9457 has it."""

    type: str = Field(description="urn:mountnav:problem:<slug>; stable, meant for programs")
    title: str
    status: int
    detail: str = Field(description="What happened, in one sentence")
    retryable: bool = Field(description="Whether the same request may succeed later")
    device: str | None = None
    advice: str | None = Field(default=None, description="What the user can do")
    job_id: str | None = Field(default=None, description="busy: the job that holds the telescope")
    errors: list[dict[str, str]] | None = Field(default=None, description="bad-request: each wrong field")


def problem(
    slug: str,
    status: int,
    detail: str,
    *,
    retryable: bool = False,
    device: str | None = None,
    advice: str | None = None,
    job_id: str | None = None,
    errors: list[dict[str, str]] | None = None,
) -> Problem:
    """Make a problem of a slug."""
    return Problem(
        type=_PREFIX + slug,
        title=_TITLES.get(slug, slug.replace("-", " ").capitalize()),
        status=status,
        detail=detail,
        retryable=retryable,
        device=device,
        advice=advice,
        job_id=job_id,
        errors=errors,
    )


def problem_of(error: MountnavError) -> Problem:
    """Make a problem of one of our errors."""
    return problem(
        error.slug,
        STATUS_OF_SLUG.get(error.slug, 500),
        error.what,
        retryable=error.retryable,
        device=error.device,
        advice=error.advice,
        job_id=getattr(error, "job_id", None),
    )


def internal_problem() -> Problem:
    """Make the problem for a fault of our own; what it was goes to the log, not to the caller."""
    return problem(
        "internal", 500, "this should not have happened", advice="see the service's log, and report it"
    )


def problem_response(found: Problem, headers: dict[str, str] | None = None) -> Response:
    """Answer with a problem. ASCII JSON, since a message may echo text that UTF-8 can't hold."""
    body = json.dumps(found.model_dump(exclude_none=True), allow_nan=False)
    return Response(body, status_code=found.status, media_type=PROBLEM_TYPE, headers=headers)


class Refused(Exception):
    """A request that the web face itself refuses; carries its problem.

    Parameters
    ----------
    found : Problem
    headers : dict, optional
        Extra response headers.
    """

    def __init__(self, found: Problem, headers: dict[str, str] | None = None) -> None:
        super().__init__(found.detail)
        self.problem = found
        self.headers = headers


def install(app: FastAPI) -> None:
    """Let `app` answer every error as problem+json."""

    @app.exception_handler(MountnavError)
    async def ours(request: Request, error: MountnavError) -> Response:
        return problem_response(problem_of(error))

    @app.exception_handler(Refused)
    async def refused(request: Request, error: Refused) -> Response:
        return problem_response(error.problem, error.headers)

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> Response:
        # `input` and `ctx` stay out: they echo what was sent, NaN among it, which no JSON can hold.
        wrong = [{"at": ".".join(str(part) for part in e["loc"]), "what": e["msg"]} for e in error.errors()]
        told = "; ".join(f"{one['at']}: {one['what']}" for one in wrong[:5])
        found = problem(
            "bad-request", 422, told, advice="docs/api.md and /docs tell what is expected", errors=wrong
        )
        return problem_response(found)

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> Response:
        slugs = {400: "bad-request", 404: "not-found", 405: "method-not-allowed", 413: "too-large"}
        slug = slugs.get(error.status_code, f"http-{error.status_code}")
        headers = dict(error.headers) if error.headers else None
        return problem_response(problem(slug, error.status_code, str(error.detail)), headers)

    @app.exception_handler(Exception)
    async def unforeseen(request: Request, error: Exception) -> Response:
        _log.error("unforeseen error in %s %s", request.method, request.url.path, exc_info=error)
        return problem_response(internal_problem())


def responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """OpenAPI entries for problems of these statuses."""
    content = {PROBLEM_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    described = {401: "A token is needed", 404: "Nothing of that name", 409: "Busy", 413: "Too large"}
    return {
        status: {"description": described.get(status, "The request can't be carried out"), "content": content}
        for status in (401, 403, *statuses, 422)
    }
