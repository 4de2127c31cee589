"""Every error as a problem+json (RFC 9457): a stable type, what happened, to what, and what to do.

Refusals from before all routes are problems for programs of REST, plain words for those of Alpaca.
"""

from __future__ import annotations

import json
import logging
import math
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.responses import PlainTextResponse
from starlette.routing import Match
from starlette.types import Scope

from mountnav.errors import (
    DeviceRefused,
    MountnavError,
    OutsideLimits,
    SolveFailed,
    SyncRefused,
    TargetNotReached,
)
from mountnav.masking import masked

__all__ = ["ALPACA_PATHS", "refusal_response"]


PROBLEM_TYPE = "application/problem+json"
_PREFIX = "urn:mountnav:problem:"
_METHODS = ("DELETE", "GET", "PATCH", "POST", "PUT")
_ERRORS_MOST, _LONGEST = 20, 300
"""Of an answer about nonsense: that may be as long as a body may."""
_log = logging.getLogger(__name__)

# the HTTP status of each problem [RFC 9110 §15]: 502 to 504 the device's fault, 4xx the caller's, 5xx ours
STATUS_OF_SLUG = {
    "device-error": 502,
    "device-missing": 503,
    "device-silent": 504,
    "device-garbled": 502,
    "device-refused": 502,
    "camera-stale": 502,
    "refused-but-done": 502,
    "sync-ignored": 502,
    "sync-elsewhere": 502,
    "solve-failed": 422,
    "offset-too-large": 409,
    "outside-limits": 422,
    "sync-refused": 409,
    "sync-undone": 409,
    "sync-undo-failed": 502,
    "model-refused": 409,
    "journal-failed": 503,
    "mount-moved": 409,
    "target-not-reached": 504,
    "bad-frame": 422,
    "bad-settings": 503,
    "bad-catalog": 503,
    "stars-unavailable": 503,
    "store-failed": 503,
    "results-differ": 409,
    "bad-request": 422,
    "not-found": 404,
    "busy": 409,
    "cancelled": 409,
    "interrupted": 503,
}
RETRY_AFTER_S: dict[str, float] = {
    "busy": 2.0,
    "device-missing": 5.0,
    "device-silent": 5.0,
    "device-garbled": 5.0,
    "device-error": 5.0,
    "solve-failed": 30.0,
    "mount-moved": 5.0,
    "target-not-reached": 30.0,
    "journal-failed": 5.0,
    "stars-unavailable": 60.0,
    "closing": 10.0,
    "too-many-requests": 1.0,
    "too-many-connections": 2.0,
}
"""How long to wait before the same request is sent again, where it may succeed then."""
_ANY_RETRY_AFTER_S = 5.0
"""Seconds to wait where `RETRY_AFTER_S` names no slug of a status that may be retried; chosen by hand.
Doubled, clients that obey come back twice as late."""
_TITLES = {
    "device-error": "A device failed",
    "device-missing": "The device can't be reached",
    "device-silent": "The device gives no answer",
    "device-garbled": "The device's answers make no sense",
    "device-refused": "The device refused",
    "camera-stale": "The camera hands out old frames",
    "refused-but-done": "The device refused, but did it anyway",
    "sync-ignored": "The mount accepted a sync and ignored it",
    "sync-elsewhere": "The mount synced to another place",
    "solve-failed": "The frame could not be identified",
    "offset-too-large": "The offset is too large to be believed",
    "outside-limits": "The target is outside the limits",
    "sync-refused": "The mount was not synced on this frame",
    "sync-undone": "A sync was contradicted, and undone",
    "sync-undo-failed": "A sync was contradicted, and could not be undone",
    "model-refused": "The pointing model was refused",
    "journal-failed": "The journal can't be written",
    "mount-moved": "The mount moved during the exposure",
    "target-not-reached": "The target was not reached",
    "bad-frame": "No usable image",
    "bad-settings": "The settings are wrong",
    "bad-catalog": "A star catalog is damaged",
    "stars-unavailable": "No star catalog answers",
    "store-failed": "The store of results can't be written",
    "results-differ": "The same frames gave other results",
    "bad-request": "The request makes no sense",
    "not-found": "Nothing has that name",
    "busy": "The telescope is busy",
    "cancelled": "Stopped on request",
    "interrupted": "The service was restarted meanwhile",
    "unauthorized": "A key is needed",
    "forbidden": "Not allowed from that address",
    "role-too-low": "That key may not do this",
    "leased": "Somebody else holds the lease",
    "lease-lost": "The lease has ended",
    "too-many-requests": "Too many requests",
    "too-many-connections": "Too many connections",
    "too-large": "The body is too large",
    "idempotency-key-reused": "The Idempotency-Key was used for another request",
    "closing": "The service is shutting down",
    "method-not-allowed": "This address does not take that method",
    "not-ready": "The service is not ready",
    "stop-failed": "Not every telescope could be told to stop",
    "internal": "A fault in mountnav",
}
SLUGS = frozenset(_TITLES)
"""All problems that may be answered; docs/reference/problems.md has cause and cure of each."""


class Problem(BaseModel):
    """What went wrong, as RFC 9457 has it."""

    type: str = Field(description="urn:mountnav:problem:<slug>; stable, meant for programs")
    title: str
    status: int
    detail: str = Field(description="What happened, in one sentence")
    retryable: bool = Field(description="Whether the same request may succeed later")
    retry_after_s: float | None = Field(
        default=None, description="retryable: so long to wait first; the header Retry-After says the same"
    )
    device: str | None = None
    advice: str | None = Field(default=None, description="What the user can do")
    job_id: str | None = Field(default=None, description="busy: the job that holds the telescope")
    reasons: list[str] | None = Field(
        default=None,
        description="Which limit, doubt, refusal or end it was, for programs: sync-refused, outside-limits, "
        "device-refused, target-not-reached, solve-failed",
    )
    errors: list[dict[str, str]] | None = Field(default=None, description="bad-request: each wrong field")
    superseded_by: str | None = Field(default=None, description="cancelled: the job that took its place")


def problem(
    slug: str,
    status: int,
    detail: str,
    *,
    retryable: bool = False,
    device: str | None = None,
    advice: str | None = None,
    job_id: str | None = None,
    reasons: list[str] | None = None,
    errors: list[dict[str, str]] | None = None,
    retry_after_s: float | None = None,
) -> Problem:
    """Make a problem of a slug. One that is retryable says after how long, else by `RETRY_AFTER_S`."""
    if retryable and retry_after_s is None:
        retry_after_s = RETRY_AFTER_S.get(slug, _ANY_RETRY_AFTER_S)
    return Problem(
        type=_PREFIX + slug,
        title=_TITLES.get(slug, slug.replace("-", " ").capitalize()),
        status=status,
        detail=detail,
        retryable=retryable,
        retry_after_s=retry_after_s if retryable else None,
        device=device,
        advice=advice,
        job_id=job_id,
        reasons=reasons,
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
        reasons=_reasons(error),
    )


def _reasons(error: MountnavError) -> list[str] | None:
    """What an error names for programs, the gravest first."""
    match error:
        case SyncRefused(doubts=doubts):
            named: tuple[str, ...] = doubts
        case OutsideLimits(limit=limit):
            named = (limit,)
        case DeviceRefused(reason=reason) | TargetNotReached(reason=reason) | SolveFailed(reason=reason):
            named = (reason,)
        case _:
            named = ()
    return [str(reason) for reason in named if reason] or None


def internal_problem() -> Problem:
    """Make the problem for a fault of our own; what it was goes to the log, not to the caller."""
    return problem(
        "internal", 500, "this should not have happened", advice="see the service's log, and report it"
    )


def problem_response(found: Problem, headers: dict[str, str] | None = None) -> Response:
    """Answer with a problem. ASCII JSON, since a message may echo text that UTF-8 can't hold."""
    body = masked(json.dumps(found.model_dump(exclude_none=True), allow_nan=False))
    if found.retry_after_s is not None:
        headers = {"Retry-After": str(math.ceil(found.retry_after_s)), **(headers or {})}
    return Response(body, status_code=found.status, media_type=PROBLEM_TYPE, headers=headers)


class Refused(Exception):
    """A request that the web face itself refuses; carries its problem.

    Parameters
    ----------
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
        found = error.errors()
        wrong = [
            {"at": ".".join(str(part) for part in fault["loc"])[:_LONGEST], "what": fault["msg"][:_LONGEST]}
            for fault in found[:_ERRORS_MOST]
        ]
        told = "; ".join(f"{fault['at']}: {fault['what']}" for fault in wrong[:5])
        advice = _advice(request, error)
        return problem_response(problem("bad-request", 422, told, advice=advice, errors=wrong))

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> Response:
        slugs = {400: "bad-request", 404: "not-found", 405: "method-not-allowed", 413: "too-large"}
        slug = slugs.get(error.status_code, f"http-{error.status_code}")
        headers = dict(error.headers) if error.headers else {}
        if error.status_code == 405:
            # the router tells only of the first route with this path
            headers["Allow"] = ", ".join(_methods_here(request))
        advice = "GET /docs lists what there is" if error.status_code in (404, 405) else None
        return problem_response(problem(slug, error.status_code, str(error.detail), advice=advice), headers)

    @app.exception_handler(Exception)
    async def unforeseen(request: Request, error: Exception) -> Response:
        _log.error("unexpected error in %s %s", request.method, request.url.path, exc_info=error)
        return problem_response(internal_problem())


def _advice(request: Request, error: RequestValidationError) -> str:
    """What to do about a request that makes no sense."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    is_json = kind == "application/json" or kind.endswith("+json")
    if isinstance(error.body, bytes) and error.body and not is_json:
        # such as `curl -d` sends it: the body was not even read as JSON
        return f"send the header Content-Type: application/json (it is {kind or 'missing'})"
    return "/docs of the service describes what is expected"


def _methods_here(request: Request) -> list[str]:
    """All methods that the path of a request has; who may GET may ask for the HEAD."""
    routes = request.app.router.routes
    scopes = {method: {**request.scope, "method": method} for method in _METHODS}
    found = [
        method
        for method, scope in scopes.items()
        if any(route.matches(scope)[0] is Match.FULL for route in routes)
    ]
    return sorted([*found, "HEAD"]) if "GET" in found else found


def responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """OpenAPI entries for problems of these statuses."""
    content = {PROBLEM_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    described = {
        400: "The body can't be read",
        401: "A key is needed",
        403: "The key, or the place that it comes from, may not do this",
        404: "Nothing has that name",
        409: "Busy",
        413: "Too large",
        422: "It makes no sense, or can't be done: `detail` says why",
        429: "Too many requests",
        503: "Not now: it is shutting down, not ready, or can't write it down",
    }
    return {
        status: {"description": described.get(status, "The request can't be carried out"), "content": content}
        for status in sorted({400, 401, 403, 413, 422, 429, *statuses})
    }


ALPACA_PATHS = ("/api/", "/management/", "/setup")
"""Where Alpaca is spoken: whatever is no 200 is plain text there [Alpaca §2]."""


def refusal_response(scope: Scope, found: Problem) -> Response:
    """Answer a request with why it is not let through, as its face has it."""
    answer = problem_response(found)
    if not scope["path"].startswith(ALPACA_PATHS):
        return answer
    words = found.detail if found.advice is None else f"{found.detail} ({found.advice})"
    again = {name: answer.headers[name] for name in ("retry-after",) if name in answer.headers}
    return PlainTextResponse(masked(words), found.status, again)
