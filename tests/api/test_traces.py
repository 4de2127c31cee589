"""Traces of orders: what a collector gets, and what it never gets."""

from __future__ import annotations

import asyncio
import gzip
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest

from api.events import Events
from api.http.app import create_app
from api.traces import Traces, provider_of
from mountnav.errors import BadSettings
from mountnav.settings.observatory import Settings
from mountnav.settings.traces import TracesSettings

SECRET = "mnav_0123456789_do-not-tell"


def _recording() -> tuple[Any, Any]:
    """A provider that keeps what it would send, and where it keeps it."""
    trace = pytest.importorskip("opentelemetry.sdk.trace", reason="the extra otel is not installed")
    from opentelemetry.sdk.trace.export import SimpleSpanProcessor
    from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

    provider, kept = trace.TracerProvider(shutdown_on_exit=False), InMemorySpanExporter()
    provider.add_span_processor(SimpleSpanProcessor(kept))
    return provider, kept


async def _made_of(events: Events) -> list[Any]:
    """The spans of what has happened."""
    provider, kept = _recording()
    traces = Traces(events, provider)
    await traces.close()
    return list(kept.get_finished_spans())


@pytest.mark.long
async def test_the_way_of_an_order_is_one_trace_with_the_id_of_its_job(observatory_toml: str) -> None:
    app = create_app(Settings.parse(observatory_toml))
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(
            transport=httpx.ASGITransport(app=app), base_url="http://127.0.0.1", timeout=120
        ) as client,
    ):
        here = (await client.get("/v1/telescopes/east")).json()["icrs"]
        body = {
            "ra_deg": here["ra_deg"],
            "dec_deg": here["dec_deg"] - 3.0 * (1 if here["dec_deg"] > 0 else -1),
        }
        started = await client.post("/v1/telescopes/east/center", json=body)
        assert started.status_code == 202, started.text
        job = (await client.get(started.headers["location"], params={"wait": 100})).json()
        assert job["state"] == "succeeded", job
        spans = await _made_of(app.state.service.events)
    (root,) = [span for span in spans if span.parent is None]
    assert root.name == "order center"
    assert root.attributes["mountnav.job.id"] == job["id"]
    assert root.attributes["mountnav.telescope"] == "east"
    assert root.attributes["mountnav.job.state"] == "succeeded"
    assert root.status.is_ok
    # the mount points 6' off: it slews, looks, is synced, slews and looks again
    steps = sorted((span for span in spans if span is not root), key=lambda span: span.start_time)
    assert {span.context.trace_id for span in spans} == {root.context.trace_id}
    assert {span.name for span in steps} == {"slew", "look", "solve", "sync"}
    assert sum(span.name == "slew" for span in steps) >= 2
    looks = {span.context.span_id: span for span in steps if span.name == "look"}
    for span in steps:
        assert root.start_time <= span.start_time <= span.end_time <= root.end_time
        if span.name == "solve":
            look = looks[span.parent.span_id]
            assert look.start_time <= span.start_time <= span.end_time <= look.end_time
            assert span.attributes["mountnav.pairs"] >= 3
            assert span.attributes["mountnav.ended_by"] == "solved"
        else:
            assert span.parent.span_id == root.context.span_id
    slews = [span for span in steps if span.name == "slew"]
    assert {span.attributes["mountnav.outcome"] for span in slews} == {"arrived"}


async def test_nothing_that_is_not_named_becomes_an_attribute() -> None:
    events = Events(100)
    job: dict[str, object] = {"telescope": "east", "job_id": "a1", "kind": "center"}
    events.publish("job", {**job, "state": "running", "request": {"key": SECRET}, "key": SECRET})
    events.publish("slewing", {**job, "ra_deg": 1.5, "note": SECRET, "url": f"http://me:{SECRET}@host"})
    events.publish("slewed", {**job, "outcome": SECRET, "miss_arcsec": 2.0})
    events.publish("exposing", {**job, "exposure_s": 3.0})
    events.publish("solving", {**job, "source": f"/home/{SECRET}/frame.fits"})
    events.publish("not-solved", {**job, "reason": SECRET})
    problem = {"type": "urn:mountnav:problem:not-solved", "detail": SECRET, "device": SECRET}
    events.publish("job", {**job, "state": "failed", "problem": problem})
    spans = await _made_of(events)
    assert [span.name for span in spans] == ["slew", "solve", "look", "order center"]
    told = {key: value for span in spans for key, value in span.attributes.items()}
    assert SECRET not in str([span.to_json() for span in spans])
    assert told == {
        "mountnav.ra_deg": 1.5,
        "mountnav.miss_arcsec": 2.0,
        "mountnav.exposure_s": 3.0,
        "mountnav.ended_by": "not-solved",
        "mountnav.job.id": "a1",
        "mountnav.telescope": "east",
        "mountnav.order": "center",
        "mountnav.job.state": "failed",
        "mountnav.problem": "urn:mountnav:problem:not-solved",
    }
    assert not spans[-1].status.is_ok


async def test_a_job_whose_end_was_missed_is_ended_and_a_strange_event_harms_nothing() -> None:
    events = Events(2)
    provider, kept = _recording()
    traces = Traces(events, provider)
    job: dict[str, object] = {"telescope": "east", "job_id": "a1", "kind": "look"}
    traces.take(events.publish("job", {**job, "state": "running"}))
    traces.take(events.publish("exposing", {**job, "exposure_s": "long", "attempt": True}))
    traces.take(events.publish("solved", {"job_id": 7}))
    traces.take(events.publish("solved", {"job_id": "of nobody"}))
    traces.take(events.gap("3 events are no longer kept"))
    await traces.close()
    look, root = kept.get_finished_spans()
    assert (look.name, dict(look.attributes)) == ("look", {})
    assert root.attributes["mountnav.job.state"] == "missed"


@pytest.mark.parametrize(
    "endpoint", ["ftp://host/x", "http://me:pass@host/v1/traces", "host:4318", "http://host/x?key=1"]
)
def test_an_endpoint_that_is_none_or_holds_a_secret_is_refused(observatory_toml: str, endpoint: str) -> None:
    with pytest.raises(BadSettings, match="endpoint"):
        Settings.parse(f"{observatory_toml}\n[traces]\nendpoint = '{endpoint}'")


def test_off_by_default_nothing_of_it_is_loaded() -> None:
    code = (
        "import sys; from api.traces import provider_of; "
        "from mountnav.settings.traces import TracesSettings; "
        "assert provider_of(TracesSettings()) is None; "
        "assert not any(name.startswith('opentelemetry') for name in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_the_extra_its_name_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "opentelemetry.exporter.otlp.proto.http.trace_exporter", None)
    monkeypatch.setitem(sys.modules, "opentelemetry.sdk.trace", None)
    with pytest.raises(BadSettings, match="not installed") as told:
        provider_of(TracesSettings(endpoint="http://127.0.0.1:4318/v1/traces"))
    assert told.value.advice == "pip install 'mountnav[otel]'"


async def test_a_collector_gets_them_by_http_and_one_that_is_away_holds_nobody_up(tmp_path: Path) -> None:
    pytest.importorskip("opentelemetry.exporter.otlp.proto.http", reason="the extra otel is not installed")
    from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

    got: list[Any] = []

    class Collector(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            if self.headers.get("Content-Encoding") == "gzip":
                body = gzip.decompress(body)
            got.append((self.path, ExportTraceServiceRequest.FromString(body)))
            self.send_response(200)
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Collector)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    events = Events(10)
    try:
        provider = provider_of(
            TracesSettings(endpoint=f"http://127.0.0.1:{server.server_port}/v1/traces", service_name="dome")
        )
        assert provider is not None
        traces = Traces(events, provider)
        traces.start()
        job: dict[str, object] = {"telescope": "east", "job_id": "a1", "kind": "look"}
        events.publish("job", {**job, "state": "running"})
        await asyncio.sleep(0)
        events.publish("job", {**job, "state": "succeeded"})
        await traces.close()
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    ((path, request),) = got
    assert path == "/v1/traces"
    (resource,) = request.resource_spans
    assert "dome" in {one.value.string_value for one in resource.resource.attributes}
    assert [span.name for span in resource.scope_spans[0].spans] == ["order look"]
    # the collector is gone now: its end is told by the log, and waited for no longer than it may take
    provider = provider_of(TracesSettings(endpoint=f"http://127.0.0.1:{server.server_port}/v1/traces"))
    assert provider is not None
    away = Traces(events, provider)
    async with asyncio.timeout(60):
        await away.close()
