"""Every request that would change something leaves a row in the audit, also one that no desk ever saw.

What the desk takes or refuses it notes itself, with the order; here the rest is noted: words to a night,
uploads, and all that was refused before it got so far.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.audit import Audit, watching_notes
from api.access.callers import Caller
from api.access.noted_seldom import Seldom
from api.access.roles import route_of
from api.http.faults import PROBLEM_TYPE, Refused

_ASKING = frozenset({"GET", "HEAD", "OPTIONS", "TRACE"})
_HEARTBEAT = "PUT /v1/telescopes/{telescope_id}/lease"
_STRANGERS_MOST = 60
"""So many notes a minute of all who have no key, one of each address: they must not fill the journal, not
from as many addresses as they like either. Doubled, 40 MB a day."""
_LONGEST_PROBLEM_BYTES = 65_536


class AuditedRequests:
    """Note requests that are no mere questions. Plain ASGI.

    Parameters
    ----------
    app : ASGIApp
    audit_of : callable
        The audit of the running service; None before and after.
    caller_of : callable
        Who sends a request. Raises `Refused`.
    """

    def __init__(
        self,
        app: ASGIApp,
        audit_of: Callable[[], Audit | None],
        caller_of: Callable[[Scope], Caller],
        *,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._app = app
        self._audit_of = audit_of
        self._caller_of = caller_of
        self._strangers = Seldom(1, _STRANGERS_MOST, clock_s)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and note what became of it."""
        if scope["type"] != "http" or scope["method"] in _ASKING:
            await self._app(scope, receive, send)
            return
        noted = watching_notes()
        answer = _Answer(send)
        try:
            await self._app(scope, receive, answer.send)
        finally:
            audit = self._audit_of()
            if audit is not None and not noted:
                self._note(audit, scope, answer)

    def _note(self, audit: Audit, scope: Scope, answer: _Answer) -> None:
        status = answer.status or 500
        route = route_of(scope["method"], scope["path"])
        if route == _HEARTBEAT and status < 400:
            return
        what = route or f"{scope['method']} {scope['path'][:200]}"
        try:
            caller = self._caller_of(scope)
        except Refused:
            self._note_stranger(audit, scope, what, status, answer.outcome)
            return
        audit.note(
            caller,
            what,
            telescope=str(scope.get("path_params", {}).get("telescope_id", "")),
            request=_query(scope),
            outcome=answer.outcome,
            detail=answer.detail,
            status=status,
        )

    def _note_stranger(self, audit: Audit, scope: Scope, what: str, status: int, outcome: str) -> None:
        address = _host(scope)
        if (unnoted := self._strangers.due(address)) is not None:
            audit.stranger(address, what, status=status, outcome=outcome, unnoted=unnoted)


class _Answer:
    """Looks at an answer as it passes: its status, and what its problem is."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self._problem: bytearray | None = None
        self.status: int | None = None

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
            kind = Headers(raw=list(message.get("headers", ()))).get("content-type", "")
            self._problem = bytearray() if kind.startswith(PROBLEM_TYPE) else None
        elif self._problem is not None and len(self._problem) < _LONGEST_PROBLEM_BYTES:
            self._problem += message.get("body", b"")
        await self._send(message)

    @property
    def outcome(self) -> str:
        """``answered``, or the slug of the problem."""
        if self.status is None:
            return "internal"
        if self.status < 400:
            return "answered"
        found = self._told()
        return str(found.get("type", "")).rpartition(":")[2] or f"http-{self.status}"

    @property
    def detail(self) -> str:
        """The problem in words."""
        return str(self._told().get("detail", ""))

    def _told(self) -> dict[str, object]:
        try:
            found = json.loads(bytes(self._problem or b"{}"))
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}


def _query(scope: Scope) -> dict[str, object]:
    text = scope.get("query_string", b"").decode("ascii", "replace")
    return {"query": text} if text else {}


def _host(scope: Scope) -> str:
    client = scope.get("client")
    return "" if client is None else str(client[0])


__all__ = ["AuditedRequests"]
