"""Who may use the API: holders of the token, or, without one, programs on this machine alone."""

from __future__ import annotations

import hashlib
import ipaddress
from secrets import compare_digest
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import Depends, Request
from fastapi.security import APIKeyHeader, HTTPAuthorizationCredentials, HTTPBearer
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from api.faults import Problem, Refused, problem, problem_response

_bearer = HTTPBearer(auto_error=False, description="The token whose sha256 is service.api_token_sha256")
_key = APIKeyHeader(name="X-API-Key", auto_error=False, description="The same token")


def require_token(
    request: Request,
    bearer: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)],
    key: Annotated[str | None, Depends(_key)],
) -> None:
    """Let the request through if no token is configured, or if it carries the right one.

    Raises
    ------
    Refused
        401 with WWW-Authenticate.
    """
    expected: str | None = request.app.state.settings.service.api_token_sha256
    if expected is None:
        return
    given = bearer.credentials if bearer is not None else key
    if given is None:
        found = problem("unauthorized", 401, "no token came with the request", advice=_HOW)
        raise Refused(found, {"WWW-Authenticate": 'Bearer realm="mountnav"'})
    if not compare_digest(hashlib.sha256(given.encode()).hexdigest(), expected):
        found = problem("unauthorized", 401, "the token is not the right one", advice=_HOW)
        raise Refused(found, {"WWW-Authenticate": 'Bearer realm="mountnav", error="invalid_token"'})


_HOW = "send it as `Authorization: Bearer TOKEN` or `X-API-Key: TOKEN`"


class OwnMachineOnly:
    """Refuse what a web page of another site sends through the operator's browser.

    Without a token nothing but the loopback address protects the telescope, and a browser on this machine
    carries requests of any page to it: by name (DNS rebinding: foreign Host) or straight (foreign Origin).
    Plain ASGI, so that event streams pass unbuffered.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        refusal: Problem | None = None
        if not _is_loopback_name(f"//{host}"):
            refusal = problem(
                "forbidden", 403, "the Host header names no loopback address", advice="use 127.0.0.1"
            )
        elif origin is not None and urlsplit(origin).netloc != host:
            refusal = problem("forbidden", 403, "the request comes from another site's page")
        if refusal is None:
            await self._app(scope, receive, send)
        else:
            await problem_response(refusal)(scope, receive, send)


def _is_loopback_name(url: str) -> bool:
    try:
        name = urlsplit(url).hostname
        return name == "localhost" or ipaddress.ip_address(name or "").is_loopback
    except ValueError:
        return False


TokenRequired = Depends(require_token)
