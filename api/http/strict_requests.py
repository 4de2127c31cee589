"""What a request says besides what is known is refused, not left out: a misspelt bound would bound nothing.

Parameters of the query that a route doesn't have, or that stand twice; keys that stand twice in one object of
a JSON body, of which the last would win. And what is longer than anything that is known: addresses, objects.
"""

from __future__ import annotations

import json
from typing import Any, get_args, get_origin

from fastapi import Depends, Request
from fastapi.dependencies.models import Dependant
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.rate_limits import is_stop
from api.problems import Refused, problem, refusal_response
from mountnav.parsing import repeated

_MOST_TOLD = 5
"""Wrong parameters that one refusal names; a query may hold thousands. Doubled: a longer answer."""

_LONGEST = 80
"""Characters of a stranger's name that a refusal repeats: ours have 30. Doubled: a longer answer."""

MOST_KEYS = 1000
"""In one object of a body; ours have 20. What is unknown is looked at and told key by key: of 19,000 that
takes 0.3 s in one go. Doubled, 30 ms instead of 15."""

LONGEST_TARGET = 8192
"""Characters of a path with its query, as other servers have it; ours have some 300. Each of 150 routes is
held against a path, for each method: 60,000 took 0.2 s of the loop. Doubled, 60 ms instead of 30."""


async def require_known_query(request: Request) -> None:
    """Let a request through whose parameters its route knows, each once but for lists.

    Raises
    ------
    Refused
        422 ``bad-request``.
    """
    if not request.query_params or is_stop(request.method, request.url.path):
        # a stop is taken whatever comes with it
        return
    dependant = getattr(request.scope.get("route"), "dependant", None)
    if dependant is None:
        return
    known = _parameters(dependant)
    is_order = request.method == "POST"
    wrong = []
    for name in sorted(set(request.query_params)):
        at = f"query.{name[:_LONGEST]}"
        if name not in known:
            what = "an order has no such parameter" if is_order else "there is no such parameter here"
            wrong.append({"at": at, "what": what})
        elif not known[name] and len(request.query_params.getlist(name)) > 1:
            wrong.append({"at": at, "what": "it stands there more than once"})
    if wrong:
        told = "; ".join(f"{fault['at']}: {fault['what']}" for fault in wrong[:_MOST_TOLD])
        advice = (
            "what is ordered stands in the body"
            if is_order
            else f"known here: {', '.join(sorted(known)) or 'none'}"
        )
        raise Refused(problem("bad-request", 422, told, advice=advice, errors=wrong[:_MOST_TOLD]))


KnownQueryOnly = Depends(require_known_query)
"""For routers: each of their routes refuses parameters that it doesn't know."""


def _parameters(dependant: Dependant) -> dict[str, bool]:
    """Names of the query, and whether each may stand there several times."""
    found = {field.alias: _takes_many(field.field_info.annotation) for field in dependant.query_params}
    for below in dependant.dependencies:
        found |= _parameters(below)
    return found


def _takes_many(annotation: Any) -> bool:
    return get_origin(annotation) in (list, tuple, set, frozenset) or any(
        _takes_many(argument) for argument in get_args(annotation)
    )


class _Twice(Exception):
    """A key that stands twice in one object."""


class _TooMany(Exception):
    """More keys in one object than anything has."""


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    if len(pairs) > MOST_KEYS:
        raise _TooMany(len(pairs))
    found = dict(pairs)
    if len(found) != len(pairs):
        raise _Twice(repeated(name for name, _ in pairs)[0])
    return found


class PlainJson:
    """Refuse JSON bodies in which a key stands twice, or far too many do. Plain ASGI.

    Whatever else is wrong others tell.

    Parameters
    ----------
    app : ASGIApp
        Behind a bound on the length of bodies: they are read whole here.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, with its body, or refuse it."""
        if scope["type"] != "http" or not _is_json(scope) or is_stop(scope["method"], scope["path"]):
            await self._app(scope, receive, send)
            return
        messages: list[Message] = []
        while True:
            message = await receive()
            messages.append(message)
            if message["type"] != "http.request" or not message.get("more_body", False):
                break
        body = b"".join(message.get("body", b"") for message in messages)
        try:
            json.loads(body, object_pairs_hook=_once)
        except _Twice as twice:
            name = str(twice)[:_LONGEST]
            found = problem(
                "bad-request",
                422,
                f"body: the key {name!r} stands twice in one object",
                advice="say each thing once",
                errors=[{"at": f"body.{name}", "what": "it stands there more than once"}],
            )
            await refusal_response(scope, found)(scope, receive, send)
            return
        except _TooMany as many:
            found = problem(
                "bad-request",
                422,
                f"body: {many} keys in one object",
                advice=f"nothing here has more than {MOST_KEYS}",
            )
            await refusal_response(scope, found)(scope, receive, send)
            return
        except (ValueError, RecursionError):
            # no JSON: its reader says so
            pass

        async def again() -> Message:
            return messages.pop(0) if messages else await receive()

        await self._app(scope, again, send)


class ShortTargets:
    """Refuse addresses that are longer than any of ours before they are looked at. Plain ASGI.

    A stop is taken whatever its query.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        if scope["type"] == "http":
            path = len(scope.get("raw_path") or scope["path"])
            length = path + len(scope.get("query_string", b""))
            if path > LONGEST_TARGET or (
                length > LONGEST_TARGET and not is_stop(scope["method"], scope["path"])
            ):
                found = problem(
                    "too-large",
                    414,
                    f"an address of {length} characters",
                    advice=f"{LONGEST_TARGET} are the most",
                )
                await refusal_response(scope, found)(scope, receive, send)
                return
        await self._app(scope, receive, send)


def _is_json(scope: Scope) -> bool:
    kind = Headers(scope=scope).get("content-type", "").partition(";")[0].strip().lower()
    return kind == "application/json" or kind.endswith("+json")


__all__ = ["KnownQueryOnly", "PlainJson", "ShortTargets", "require_known_query"]
