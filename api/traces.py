"""Traces for OpenTelemetry: the way of each order, slew, look, solve and sync, made of the events.

A trace is one job. It is made of what everybody may read in the event stream: the rooms that move and look
know nothing of it, and a collector that is away costs them nothing. Only what is named here becomes an
attribute, numbers and words of ours: no request, no key, no file name, no free text.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Protocol

from api.events import Event, Events
from mountnav.devices import SlewOutcome, SyncOutcome
from mountnav.errors import BadSettings
from mountnav.extras import extra
from mountnav.settings.traces import TracesSettings
from mountnav.tasks import begun, cancelled

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

__all__ = ["Traces", "provider_of"]

_log = logging.getLogger(__name__)

_SEND_S = 2.0
"""How long a collector may take to accept spans, s; chosen by hand. Doubled, a service whose collector hangs
goes down 2 s later."""
_BEGINS = {"slewing": "slew", "exposing": "look", "solving": "solve", "syncing": "sync"}
"""Kinds of events that begin a step, and its name."""
_ENDS = {
    "slewed": ("slew",),
    "solved": ("solve", "look"),
    "not-solved": ("solve", "look"),
    "synced": ("sync",),
    "sync-refused": ("sync",),
    "sync-undone": ("sync",),
}
"""Kinds that end steps."""
_WITHIN = {"solve": "look"}
"""A step that is a part of another one."""
_NUMBERS = (
    "ra_deg",
    "dec_deg",
    "exposure_s",
    "attempt",
    "miss_arcsec",
    "elapsed_s",
    "offset_arcsec",
    "off_arcsec",
    "read_back_miss_arcsec",
    "solve_s",
    "pairs",
    "rms_arcsec",
    "false_probability",
    "fwhm_arcsec",
    "limiting_mag",
)
"""Figures of events that become attributes, named ``mountnav.`` and this."""
_OUTCOMES = frozenset(map(str, (*SlewOutcome, *SyncOutcome)))
"""Words of outcomes that become an attribute; another one is left out."""
_OVER = {"succeeded", "failed", "cancelled", "interrupted"}


class Span(Protocol):
    """What a span of OpenTelemetry is to this module."""

    def set_attribute(self, key: str, value: str | int | float | bool) -> None: ...

    def set_status(self, status: object) -> None: ...

    def end(self, end_time: int | None = None) -> None: ...


class _Order:
    """A job that goes on: its span, and those of its steps."""

    def __init__(self, root: Span) -> None:
        self.root = root
        self.steps: dict[str, Span] = {}


class Traces:
    """Makes spans of events, from the start of the service to its end.

    Parameters
    ----------
    provider : TracerProvider
        Sends them; shut down with this.
    """

    def __init__(self, events: Events, provider: TracerProvider) -> None:
        self._reader = events.reader(f"{events.run}-0")
        self._provider = provider
        self._tracer = provider.get_tracer("mountnav")
        self._orders: dict[str, _Order] = {}
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin to listen."""
        self._task = begun(self._follow(), "traces", died=lambda _: self.start())

    async def close(self) -> None:
        """Send what is there, and listen no more."""
        await cancelled(self._task)
        self._task = None
        for event in self._reader.all_at_hand():
            self.take(event)
        await asyncio.to_thread(self._provider.shutdown)

    async def _follow(self) -> None:
        while (events := await self._reader.next()) is not None:
            for event in events:
                self.take(event)

    def take(self, event: Event) -> None:
        """Take in one event."""
        if event.kind == "gap":
            # ends of jobs may be among what was missed
            for open_id in tuple(self._orders):
                self._end(open_id, event.utc, {"state": "missed"})
            return
        job_id = event.data.get("job_id")
        if not isinstance(job_id, str):
            return
        if event.kind == "job":
            state = event.data.get("state")
            if state == "running" and job_id not in self._orders:
                self._begin(job_id, event)
            elif state in _OVER:
                if job_id not in self._orders:
                    # refused or cancelled before it ran: a trace without steps
                    self._begin(job_id, event)
                self._end(job_id, event.utc, event.data)
        elif (order := self._orders.get(job_id)) is not None:
            self._step(order, event)

    def _begin(self, job_id: str, event: Event) -> None:
        root = self._tracer.start_span(
            f"order {_word(event.data.get('kind'))}",
            attributes={
                "mountnav.job.id": job_id,
                "mountnav.telescope": str(event.data.get("telescope") or ""),
                "mountnav.order": _word(event.data.get("kind")),
            },
            start_time=_ns(event.utc),
        )
        self._orders[job_id] = _Order(root)

    def _step(self, order: _Order, event: Event) -> None:
        from opentelemetry import trace

        if (name := _BEGINS.get(event.kind)) is not None:
            self._end_step(order, name, event.utc)
            parent = order.steps.get(_WITHIN.get(name, ""), order.root)
            order.steps[name] = self._tracer.start_span(
                name,
                context=trace.set_span_in_context(parent),
                attributes=_attributes(event.data),
                start_time=_ns(event.utc),
            )
        for name in _ENDS.get(event.kind, ()):
            if (span := order.steps.get(name)) is not None:
                for key, value in _attributes(event.data).items():
                    span.set_attribute(key, value)
                span.set_attribute("mountnav.ended_by", event.kind)
            self._end_step(order, name, event.utc)

    @staticmethod
    def _end_step(order: _Order, name: str, utc: datetime) -> None:
        span = order.steps.pop(name, None)
        if span is not None:
            span.end(_ns(utc))

    def _end(self, job_id: str, utc: datetime, data: Mapping[str, object]) -> None:
        from opentelemetry.trace import Status, StatusCode

        order = self._orders.pop(job_id)
        for name in tuple(reversed(order.steps)):
            self._end_step(order, name, utc)
        state = _word(data.get("state"))
        order.root.set_attribute("mountnav.job.state", state)
        problem = data.get("problem")
        slug = _word(problem.get("type")) if isinstance(problem, Mapping) else ""
        if slug:
            order.root.set_attribute("mountnav.problem", slug)
        if state == "failed":
            order.root.set_status(Status(StatusCode.ERROR, slug))
        elif state == "succeeded":
            order.root.set_status(Status(StatusCode.OK))
        order.root.end(_ns(utc))


def provider_of(settings: TracesSettings) -> TracerProvider | None:
    """What sends traces where the settings say; None if they name no place.

    Raises
    ------
    BadSettings
        The extra isn't installed.
    """
    if not settings.endpoint:
        return None
    with extra("otel", "traces ([traces] endpoint)", BadSettings):
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor

        from mountnav import __version__

    resource = Resource({"service.name": settings.service_name, "service.version": __version__})
    provider = TracerProvider(resource=resource, shutdown_on_exit=False)
    # its queue is bounded: of a collector that is away, the oldest spans are lost, and nobody waits
    provider.add_span_processor(
        BatchSpanProcessor(OTLPSpanExporter(endpoint=settings.endpoint, timeout=_SEND_S))
    )
    _log.info("traces go to %s", settings.endpoint)
    return provider


def _attributes(data: Mapping[str, object]) -> dict[str, str | int | float | bool]:
    found: dict[str, str | int | float | bool] = {
        f"mountnav.{name}": value
        for name in _NUMBERS
        if isinstance(value := data.get(name), (int, float)) and not isinstance(value, bool)
    }
    if (outcome := str(data.get("outcome"))) in _OUTCOMES:
        found["mountnav.outcome"] = outcome
    return found


def _word(value: object) -> str:
    """A word of ours; whatever else it may be is left out."""
    text = str(value or "")
    return text if len(text) <= 100 and text.replace(":", "").replace("-", "").isalnum() else "unknown"


def _ns(utc: datetime) -> int:
    return round(utc.timestamp() * 1e9)
