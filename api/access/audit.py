"""The audit: a journal row for each order and each request that would change something, refused ones too.

The dispatcher notes what it takes or refuses, with the order (`Audit`). `AuditedRequests` notes the rest:
words to a night, uploads, and all that was refused before it got so far. What is repeated is noted so often
a minute, then counted (`Seldom`).
"""

from __future__ import annotations

import json
import logging
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Protocol

from pydantic import BaseModel
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.callers import Caller, Face
from api.access.roles import route_of
from api.problems import PROBLEM_TYPE, Problem, Refused, internal_problem, problem_of
from mountnav.clock import utc_now
from mountnav.errors import MountnavError
from mountnav.journal.audit_and_leases import AuditRow
from mountnav.masking import masked

__all__ = [
    "EACH_S",
    "TAKEN",
    "Audit",
    "AuditKeeper",
    "AuditedRequests",
    "Seldom",
    "Unnoted",
    "watching_notes",
]


EACH_S = 60.0
"""How long is counted before it is noted again, s. Doubled, half as many rows, each a minute later."""
_MOST_KEPT = 1000
"""Of whom counts are kept: some 100 bytes each. Who is forgotten is noted as if he were new."""


@dataclass(slots=True)
class Unnoted:
    """What was not noted since the last time.

    Attributes
    ----------
    same : int
        Of the same key.
    others : int
        Of other keys, that were too many together.
    """

    same: int = 0
    others: int = 0


@dataclass(slots=True)
class _Count:
    since_s: float
    noted: int = 0
    unnoted: int = 0


class Seldom:
    """Counts by keys, and says when one is due to be noted.

    Parameters
    ----------
    each : int
        So often a minute each key is noted.
    all_together : int
        So often a minute anything is.
    """

    def __init__(self, each: int, all_together: int, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._each, self._all_together = each, all_together
        self._clock_s = clock_s
        self._counts: OrderedDict[Hashable, _Count] = OrderedDict()
        self._together = _Count(-EACH_S)

    def due(self, key: Hashable) -> Unnoted | None:
        """Whether this one is to be noted, with what was not before it; None: it is counted."""
        now_s = self._clock_s()
        if now_s - self._together.since_s >= EACH_S:
            self._together = _Count(now_s, unnoted=self._together.unnoted)
        count = self._counts.setdefault(key, _Count(now_s))
        self._counts.move_to_end(key)
        while len(self._counts) > _MOST_KEPT:
            _, forgotten = self._counts.popitem(last=False)
            self._together.unnoted += forgotten.unnoted
        if now_s - count.since_s >= EACH_S:
            count.since_s, count.noted = now_s, 0
        if count.noted >= self._each or self._together.noted >= self._all_together:
            count.unnoted += 1
            return None
        found = Unnoted(count.unnoted, self._together.unnoted)
        count.noted, count.unnoted = count.noted + 1, 0
        self._together.noted, self._together.unnoted = self._together.noted + 1, 0
        return found


_log = logging.getLogger(__name__)

TAKEN = "taken"
_SECRETS = ("secret", "token", "password", "authorization", "api_key", "apikey", "lease_id")
_LONGEST_TEXT = 500
"""Characters of one value in a row; with `_MOST_VALUES` and `_DEEPEST` it bounds a row. Doubled, rows made
of nonsense take twice the disk."""
_MOST_VALUES = 50
"""Values of one list or object that are kept; chosen by hand, far above our orders. Doubled, as above."""
_DEEPEST = 4
"""Levels of nested values that are kept; chosen by hand. Each more lets a nested body make a row 50 times
as long."""
_KEYLESS = frozenset({Face.INDI, Face.LX200, Face.STELLARIUM, Face.ALPACA})
"""Anyone who reaches these may order, and no rate is set to them."""
_MOST_REPEATED = 20
"""So often a minute one address is noted for one refusal, or for stops, by such a face, and ten times that
all of them. Doubled, clients that order what is refused without end fill 200 MB a day."""

_noted: ContextVar[list[str] | None] = ContextVar("mountnav_audit_noted", default=None)
"""What the request that is being answered has noted so far; see `watching_notes`."""


class AuditKeeper(Protocol):
    """Where audits are kept."""

    def audit_now(self, row: AuditRow) -> None:
        """Keep it, without waiting. Never raises."""
        ...


class Audit:
    """Notes orders. An order waits for no note; none is lost as long as the journal can be written.

    While it can't, notes are kept in memory (ten thousand of them) and written later.
    """

    def __init__(self, keeper: AuditKeeper) -> None:
        self._keeper = keeper
        self._repeated = Seldom(_MOST_REPEATED, 10 * _MOST_REPEATED)

    def note(
        self,
        caller: Caller,
        what: str,
        *,
        telescope: str | None = None,
        request: Mapping[str, object] | BaseModel | None = None,
        outcome: str = TAKEN,
        detail: str = "",
        status: int | None = None,
        job_id: str | None = None,
    ) -> None:
        """Note an order. Never raises, waits for nothing.

        Where no keys are asked for, one address's refused orders and stops are noted so often a minute, with
        how many there were between.

        Parameters
        ----------
        what : str
            The order's kind, such as ``slew``.
        telescope : str, optional
            None for the whole service.
        request : mapping or model, optional
            What was asked for. Values whose names tell of secrets are left out, long ones cut.
        outcome : str
            ``taken``, or the slug of the problem.
        detail : str
            In words.
        status : int, optional
            Of HTTP.
        job_id : str, optional
            Which job it became.
        """
        try:
            if (noted := _noted.get()) is not None:
                noted.append(what)
            unnoted: Unnoted | None = None
            if caller.face in _KEYLESS and (outcome != TAKEN or what == "stop"):
                unnoted = self._repeated.due((caller.address, caller.face, what, outcome))
                if unnoted is None:
                    return
            self._keeper.audit_now(
                AuditRow(
                    utc=utc_now(),
                    telescope=telescope or "",
                    caller=caller.name,
                    role=str(caller.role),
                    face=str(caller.face),
                    address=caller.address,
                    what=masked(what),
                    request=_shown(request) | _told_of(unnoted),
                    outcome=outcome,
                    detail=masked(detail[:_LONGEST_TEXT]),
                    status=status,
                    job_id=job_id,
                )
            )
        except Exception:
            # an order must not fail for its note
            _log.exception("the audit entry of %s by %s was not written", what, caller.name)

    def stranger(
        self, address: str, what: str, *, status: int, outcome: str, unnoted: Unnoted | None = None
    ) -> None:
        """Note that somebody unknown tried something. Never raises.

        Parameters
        ----------
        unnoted : Unnoted, optional
            What he and others did since their last notes.
        """
        request = _told_of(unnoted)
        row = AuditRow(
            utc_now(), "", "(unknown)", "", "", address, masked(what), request, outcome, status=status
        )
        try:
            self._keeper.audit_now(row)
        except Exception:
            _log.exception("the audit entry of %s from %s was not written", what, address)

    def refused(
        self,
        caller: Caller,
        what: str,
        error: BaseException,
        *,
        telescope: str | None = None,
        request: Mapping[str, object] | BaseModel | None = None,
    ) -> None:
        """Note an order that was refused with `error`. Never raises."""
        found = _problem(error)
        self.note(
            caller,
            what,
            telescope=telescope,
            request=request,
            outcome=found.type.rpartition(":")[2],
            detail=found.detail,
            status=found.status,
            job_id=found.job_id,
        )


def _told_of(unnoted: Unnoted | None) -> dict[str, object]:
    if unnoted is None:
        return {}
    told = {"more_since_the_last_note": unnoted.same, "others_not_noted": unnoted.others}
    return {name: count for name, count in told.items() if count}


def watching_notes() -> list[str]:
    """Begin a list of what is noted from now on in this task, and in what it awaits."""
    noted: list[str] = []
    _noted.set(noted)
    return noted


def _problem(error: BaseException) -> Problem:
    if isinstance(error, Refused):
        return error.problem
    return problem_of(error) if isinstance(error, MountnavError) else internal_problem()


def _shown(request: Mapping[str, object] | BaseModel | None) -> dict[str, object]:
    if request is None:
        return {}
    plain = request.model_dump(mode="json", exclude_none=True) if isinstance(request, BaseModel) else request
    return {str(name): _cut(value) for name, value in _kept(plain)}


def _kept(mapping: Mapping[str, object]) -> list[tuple[str, object]]:
    named = [(str(name), value) for name, value in mapping.items()]
    shown = [(name, value) for name, value in named if not any(word in name.lower() for word in _SECRETS)]
    return shown[:_MOST_VALUES]


def _cut(value: object, depth: int = 1) -> object:
    if isinstance(value, str):
        value = masked(value)
        return (
            value if len(value) <= _LONGEST_TEXT else f"{value[:_LONGEST_TEXT]}... ({len(value)} characters)"
        )
    if isinstance(value, Mapping):
        if depth >= _DEEPEST:
            return f"({len(value)} values)"
        return {name: _cut(one, depth + 1) for name, one in _kept(value)}
    if isinstance(value, list | tuple):
        if depth >= _DEEPEST:
            return f"({len(value)} values)"
        return [_cut(one, depth + 1) for one in value[:_MOST_VALUES]]
    return value


_ASKING = frozenset({"GET", "HEAD", "OPTIONS", "TRACE"})
_HEARTBEAT = "PUT /v1/telescopes/{telescope_id}/lease"
_STRANGERS_MOST = 60
"""So many notes a minute of all who have no key, one of each address: they must not fill the journal, not
from as many addresses as they like either. Doubled, 40 MB a day."""
_LONGEST_PROBLEM_BYTES = 65_536
"""Of an answer's problem body that is read for its detail, bytes; chosen by hand, far above ours. Doubled,
a long one holds twice the memory."""


class AuditedRequests:
    """Note requests that are no mere questions. Plain ASGI.

    Parameters
    ----------
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
