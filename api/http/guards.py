"""What stands before all routes of all faces that speak HTTP: who comes, from where, how often, how large.

`OpenStreams` ends streams of events when the key that opened them is revoked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.audit import Audit, AuditedRequests
from api.access.callers import Caller, Role
from api.access.keys import KeyStore, open_keys
from api.access.log_rates import KnownCallers
from api.access.rate_limits import RateLimit, TokenBuckets
from api.access.security import LEASE_HEADER, STOPS_GIVEN, OwnMachineOnly, address_of, caller_from_headers
from api.alpaca.server import alpaca_caller
from api.http.bodies import BodyLimit, WholeBodies
from api.http.fair_scheduling import FairRequests, ReadingTurns, RequestTurns
from api.http.headers import BoundedHeads, HeadAsGet, SafeHeaders
from api.http.request_metrics import CountedRequests, HttpMetrics
from api.http.strict_requests import PlainJson, ShortTargets
from api.problems import ALPACA_PATHS, Refused, problem, refusal_response
from mountnav.settings.observatory import Settings


class OpenStreams:
    """Before each piece of a stream, ask again whether its listener may hear it. Plain ASGI.

    Parameters
    ----------
    caller_of : callable
        Who sent a request. Raises `Refused` when he is none any more: his key was revoked, or has ended.
    most : int
        Streams of one caller at a time, from however many addresses: one must not take all connections.
    """

    def __init__(self, app: ASGIApp, caller_of: Callable[[Scope], Caller], most: int = 128) -> None:
        self._app = app
        self._caller_of = caller_of
        self._most = most
        self._open: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        if scope["method"] == "GET" and scope["path"].rstrip("/").endswith("/events"):
            await self._counted(scope, receive, send)
            return
        await self._watched(scope, receive, send)

    async def _counted(self, scope: Scope, receive: Receive, send: Send) -> None:
        caller = self._caller(scope)
        name = f"({address_of(scope)})" if caller is None else caller.name
        if self._open[name] >= self._most:
            found = problem(
                "too-many-requests",
                429,
                f"{self._most} streams of events are open for this caller",
                retryable=True,
                retry_after_s=15,
                advice="close those that nobody reads; [service] streams_per_caller is the limit",
            )
            await refusal_response(scope, found)(scope, receive, send)
            return
        self._open[name] += 1
        try:
            await self._watched(scope, receive, send)
        finally:
            self._open[name] -= 1
            if not self._open[name]:
                del self._open[name]

    async def _watched(self, scope: Scope, receive: Receive, send: Send) -> None:
        streaming = ended = False
        opened: Caller | None = None

        async def checked(message: Message) -> None:
            nonlocal streaming, ended, opened
            if ended:
                return
            if message["type"] == "http.response.start":
                kind = Headers(raw=list(message.get("headers", ()))).get("content-type", "")
                streaming = kind.startswith("text/event-stream")
                opened = self._caller(scope) if streaming else None
            elif streaming and not self._may_hear(scope, opened):
                # the server takes this for the end, and tells the application that its listener has gone
                ended = True
                await send({"type": "http.response.body", "body": b"", "more_body": False})
                return
            await send(message)

        await self._app(scope, receive, checked)

    def _may_hear(self, scope: Scope, opened: Caller | None) -> bool:
        """Whether he is there, and may what he might as he came: what is told was chosen by that."""
        caller = self._caller(scope)
        if caller is None or opened is None:
            return False
        return (caller.role, caller.telescopes) == (opened.role, opened.telescopes)

    def _caller(self, scope: Scope) -> Caller | None:
        try:
            return self._caller_of(scope)
        except Refused:
            return None


_ASKED = (
    "Authorization",
    "X-API-Key",
    "Content-Type",
    "Idempotency-Key",
    "If-None-Match",
    "Last-Event-ID",
    "Prefer",
    LEASE_HEADER,
)
_TOLD = ("ETag", "Location", "Retry-After", "Preference-Applied", "Mountnav-Virtual")


@dataclass(frozen=True, slots=True)
class Turns:
    """Turns of the loop that all HTTP ports of a service share, so that a stop goes before all they do."""

    reading: ReadingTurns = field(default_factory=ReadingTurns)
    requests: RequestTurns = field(default_factory=RequestTurns)


def nova_guard(app: ASGIApp, turns: Turns, keys: KeyStore | None) -> ASGIApp:
    """Put before the nova API what stands before all faces that speak HTTP; its own bounds are its own.

    Parameters
    ----------
    keys : KeyStore or None
        None where everybody may come in.
    """
    inner: ASGIApp = ShortTargets(HeadAsGet(app))
    if keys is not None:
        inner = OwnMachineOnly(inner, keys=keys)
    # no stop is heard here, whatever its path says
    fair = FairRequests(inner, may_stop=lambda _: False, turns=turns.requests)
    return SafeHeaders(BoundedHeads(fair))


def install(app: FastAPI, settings: Settings) -> None:
    """Put the guards before an application; its keys are found at ``app.state.keys`` from now on.

    From the outside in: every answer gets the headers against foreign pages, heads with too many headers are
    refused, requests are counted and begin one by one, addresses that are too long are refused, HEAD becomes
    GET, other sites' pages are turned away, the log is told who comes, what would change something is noted,
    callers that ask too much are held back, bodies that are too large are refused, orders wait for all of
    theirs, streams end with the keys that opened them.

    Parameters
    ----------
    app : FastAPI
        Whose ``state.service`` is the running service, as soon as there is one.
    """
    service = settings.service
    keys = open_keys(settings)
    app.state.keys = keys
    app.state.http_metrics = HttpMetrics()
    app.state.turns = Turns()

    def caller_of(scope: Scope) -> Caller:
        if scope["path"].startswith(ALPACA_PATHS):
            return alpaca_caller(scope, keys, admits=settings.alpaca.admits)
        return caller_from_headers(Headers(scope=scope), address_of(scope), keys=keys)

    def shows_who(scope: Scope) -> Caller:
        return caller_from_headers(Headers(scope=scope), address_of(scope), keys=keys, basic=True)

    def name_of(scope: Scope) -> str | None:
        try:
            caller = caller_of(scope)
            # Alpaca has no events to follow: its programs ask again and again, and are told what is known
            asks_alpaca = scope["method"] == "GET" and scope["path"].startswith(ALPACA_PATHS)
            return None if asks_alpaca else caller.name
        except Refused:
            # all strangers behind one address share what one caller may
            return f"({address_of(scope)})"

    def may_stop(scope: Scope) -> bool:
        try:
            return caller_of(scope).role.includes(Role.OPERATE)
        except Refused:
            return False

    def audit_of() -> Audit | None:
        running = getattr(app.state, "service", None)
        return getattr(running, "audit", None)

    # what is added last stands outermost
    app.add_middleware(OpenStreams, caller_of=caller_of, most=service.streams_per_caller)
    app.add_middleware(PlainJson)
    app.add_middleware(WholeBodies)
    app.add_middleware(BodyLimit, max_body_kb=service.max_body_kb, max_upload_mb=service.max_upload_mb)
    if service.address_limit_per_s > 0:
        each_address = TokenBuckets(service.address_limit_per_s, round(2 * service.address_limit_per_s) + 1)
        app.add_middleware(RateLimit, buckets=each_address, name_of=address_of)
    if service.rate_limit_per_s > 0:
        buckets = TokenBuckets(service.rate_limit_per_s, service.rate_burst)
        app.add_middleware(RateLimit, buckets=buckets, name_of=name_of)
    app.add_middleware(AuditedRequests, audit_of=audit_of, caller_of=caller_of)
    app.add_middleware(KnownCallers, shows_who=shows_who)
    app.add_middleware(OwnMachineOnly, keys=keys, origins=service.cors_origins)
    if service.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=service.cors_origins,
            allow_methods=("GET", "POST", "PUT", "DELETE"),
            allow_headers=_ASKED,
            expose_headers=_TOLD,
        )
    app.add_middleware(HeadAsGet)
    app.add_middleware(ShortTargets)

    def arrived(scope: Scope) -> None:
        """Remember which stops were given before it came: what an order waits for may be a stop's turn."""
        running = getattr(app.state, "service", None)
        if running is not None:
            scope.setdefault("state", {})[STOPS_GIVEN] = running.dispatcher.all_stops_given()

    app.add_middleware(FairRequests, may_stop=may_stop, turns=app.state.turns.requests, arrived=arrived)
    app.add_middleware(CountedRequests, metrics=app.state.http_metrics)
    app.add_middleware(BoundedHeads)
    build = app.build_middleware_stack
    # around starlette's own answer to a fault as well, which no middleware that is added sees
    app.build_middleware_stack = lambda: SafeHeaders(build())  # type: ignore[method-assign]
