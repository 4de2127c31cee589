"""Requests as they pass: how many of which route with which status, how long they took, how many are open."""

from __future__ import annotations

import time

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.access.roles import route_of

_SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)
"""Bucket bounds of the histogram of request times, s; part of the Prometheus interface: changed bounds
break recorded dashboards."""
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


class HttpMetrics:
    """What is counted of requests, in a registry of its own."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.requests = Counter(
            "mountnav_http_requests",
            "Requests that were answered, by the template of their route.",
            ("method", "route", "status"),
            registry=self.registry,
        )
        self.duration = Histogram(
            "mountnav_http_request_duration_seconds",
            "From the request to the end of its answer; event streams are left out.",
            ("method", "route"),
            buckets=_SECONDS,
            registry=self.registry,
        )
        self.streams = Gauge(
            "mountnav_event_listeners",
            "Event streams that are open.",
            registry=self.registry,
        )


class CountedRequests:
    """Count requests. Plain ASGI, so that event streams pass unbuffered."""

    def __init__(self, app: ASGIApp, metrics: HttpMetrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and count it when it has been answered."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began_s = time.perf_counter()
        status, streaming = 500, False

        async def counted(message: Message) -> None:
            nonlocal status, streaming
            if message["type"] == "http.response.start":
                status = message["status"]
                kind = Headers(raw=list(message.get("headers", ()))).get("content-type", "")
                if kind.startswith("text/event-stream"):
                    streaming = True
                    self._metrics.streams.inc()
            await send(message)

        try:
            await self._app(scope, receive, counted)
        finally:
            method = scope["method"] if scope["method"] in _METHODS else "(other)"
            route = _template(scope)
            self._metrics.requests.labels(method, route, str(status)).inc()
            if streaming:
                self._metrics.streams.dec()
            else:
                self._metrics.duration.labels(method, route).observe(time.perf_counter() - began_s)


def _template(scope: Scope) -> str:
    """The route's template; never the path as it was sent, of which there could be any number."""
    if (known := route_of(scope["method"], scope["path"])) is not None:
        return known.partition(" ")[2]
    path = getattr(scope.get("route"), "path", None)
    return path if isinstance(path, str) else "(none)"
