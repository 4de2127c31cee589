"""Figures for Prometheus: well formed, true, and silent about what isn't known."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from tests.api.conftest import Serve
from tests.conftest import ROOT

PATIENCE_S = 60.0
Samples = dict[tuple[str, frozenset[tuple[str, str]]], float]


@pytest.fixture
async def client(serving: Serve, observatory_toml: str) -> AsyncIterator[httpx.AsyncClient]:
    """Talk to the observatory."""
    async with serving(observatory_toml) as opened:
        yield opened


async def scraped(client: httpx.AsyncClient) -> Samples:
    """All samples, as Prometheus' own reader understands them."""
    answer = await client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain; version=")
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def value(samples: Samples, name: str, **labels: str) -> float | None:
    """One sample; None if it isn't told."""
    return samples.get((name, frozenset(labels.items())))


async def finished(client: httpx.AsyncClient, path: str, body: object = None) -> str:
    """Order something, and wait for its end: the job's state."""
    job = (await client.post(path, json=body)).json()
    ended = await client.get(f"/v1/jobs/{job['id']}", params={"wait": PATIENCE_S})
    return str(ended.json()["state"])


@pytest.mark.long
async def test_a_sync_and_its_look_are_counted_once(client: httpx.AsyncClient) -> None:
    assert await finished(client, "/v1/telescopes/east/sync") == "succeeded"
    state = (await client.get("/v1/telescopes/east")).json()
    looks = (await client.get("/v1/telescopes/east/looks")).json()["lines"]
    samples = await scraped(client)
    assert value(samples, "mountnav_looks_total", telescope="east", outcome="solved") == len(looks) > 0
    assert value(samples, "mountnav_syncs_total", telescope="east", outcome="seen") == 1
    jobs = {"telescope": "east", "kind": "sync", "state": "succeeded"}
    assert value(samples, "mountnav_jobs_total", **jobs) == 1
    assert value(samples, "mountnav_solve_duration_seconds_count", telescope="east") == len(looks)
    solve_s = value(samples, "mountnav_solve_duration_seconds_sum", telescope="east")
    assert solve_s is not None
    assert solve_s > 0
    # the fake mount points wrong by some hundred arcseconds
    sum_arcsec = value(samples, "mountnav_look_offset_arcseconds_sum", telescope="east")
    east, north = (
        value(samples, "mountnav_last_look_offset_arcseconds", telescope="east", direction=one)
        for one in ("east", "north")
    )
    assert sum_arcsec is not None
    assert east is not None
    assert north is not None
    assert 100 < (east**2 + north**2) ** 0.5 < 1000
    assert sum_arcsec == pytest.approx(len(looks) * (east**2 + north**2) ** 0.5, rel=0.1)
    assert value(samples, "mountnav_telescope_connected", telescope="east") == 1
    # this mount's protocol doesn't tell whether it tracks
    assert state["tracking"] is None
    assert value(samples, "mountnav_telescope_tracking", telescope="east") is None
    altitude_deg = value(samples, "mountnav_telescope_altitude_degrees", telescope="east")
    assert altitude_deg == pytest.approx(state["altitude_deg"], abs=0.1)
    assert value(samples, "mountnav_events_missed_total") == 0


@pytest.mark.long
async def test_two_services_in_one_process_count_for_themselves_and_tell_what_is_known(
    serving: Serve, observatory_toml: str
) -> None:
    async with serving(observatory_toml) as one, serving(observatory_toml.replace('"east"', '"west"')) as two:
        await asyncio.gather(one.get("/v1/version"), one.get("/v1/version"), two.get("/v1/version"))
        labels = {"method": "GET", "route": "/v1/version", "status": "200"}
        first, second = await scraped(one), await scraped(two)
        assert value(first, "mountnav_http_requests_total", **labels) == 2
        assert value(second, "mountnav_http_requests_total", **labels) == 1
        assert value(second, "mountnav_telescope_connected", telescope="west") == 1
        assert value(second, "mountnav_telescope_connected", telescope="east") is None
        await _zero_is_known_and_the_unknown_left_out_and_a_lease_told(one)
        await _requests_are_counted_by_their_templates_and_names_follow_the_rules(one)


async def _zero_is_known_and_the_unknown_left_out_and_a_lease_told(client: httpx.AsyncClient) -> None:
    samples = await scraped(client)
    assert value(samples, "mountnav_looks_total", telescope="east", outcome="solved") == 0
    assert value(samples, "mountnav_syncs_total", telescope="east", outcome="ignored") == 0
    assert value(samples, "mountnav_last_look_offset_arcseconds", telescope="east", direction="east") is None
    # a telescope that can't be reached: nothing is said of where it points
    assert value(samples, "mountnav_telescope_connected", telescope="gone") == 0
    for unknown in ("slewing", "tracking", "parked", "altitude_degrees", "azimuth_degrees"):
        assert value(samples, f"mountnav_telescope_{unknown}", telescope="gone") is None
    assert value(samples, "mountnav_journal_writable") == 1
    assert value(samples, "mountnav_telescope_leased", telescope="east") == 0
    await client.post("/v1/telescopes/east/lease", json={"ttl_s": 60.0})
    assert value(await scraped(client), "mountnav_telescope_leased", telescope="east") == 1


async def _requests_are_counted_by_their_templates_and_names_follow_the_rules(
    client: httpx.AsyncClient,
) -> None:
    for number in range(3):
        await client.get(f"/v1/jobs/{number}")
    await client.get("/v1/telescopes/east")
    await client.get("/no/such/place")
    await client.request("BREW", "/coffee")
    samples = await scraped(client)
    total = "mountnav_http_requests_total"
    assert value(samples, total, method="GET", route="/v1/jobs/{job_id}", status="404") == 3
    assert value(samples, total, method="GET", route="/v1/telescopes/{telescope_id}", status="200") == 1
    assert value(samples, total, method="GET", route="(none)", status="404") == 1
    # what strangers send makes no new rows
    assert not [labels for _, labels in samples if ("method", "BREW") in labels or "/no/such" in str(labels)]
    timed = "mountnav_http_request_duration_seconds_count"
    assert value(samples, timed, method="GET", route="/v1/jobs/{job_id}") == 3
    text = (await client.get("/metrics")).text
    families = list(text_string_to_metric_families(text))
    names = [family.name for family in families]
    assert len(names) == len(set(names))
    for family in families:
        assert family.name.startswith(("mountnav_", "process_")), family.name
        assert family.documentation
        for sample in family.samples:
            assert family.type != "counter" or sample.name.endswith(("_total", "_created")), sample.name


DEPLOY = ROOT / "deploy"
ALERTS, DASHBOARD = DEPLOY / "prometheus" / "mountnav.rules.yml", DEPLOY / "grafana" / "mountnav.json"
LABELS = {"telescope", "outcome", "state", "kind", "on_expiry", "direction", "le", "job", "version"}
"""Those of `docs/reference/metrics.md`, and Prometheus' own."""


def _expressions(file: Path) -> list[str]:
    """All queries of a file of alerts or of a dashboard."""
    if file.suffix == ".yml":
        rules = yaml.safe_load(file.read_text())["groups"]
        return [rule["expr"] for group in rules for rule in group["rules"]]
    panels = json.loads(file.read_text())["panels"]
    return [target["expr"] for panel in panels for target in panel["targets"]]


@pytest.mark.long
@pytest.mark.parametrize("file", [ALERTS, DASHBOARD], ids=lambda file: file.name)
async def test_what_alerts_and_dashboard_ask_for_is_told(file: Path, client: httpx.AsyncClient) -> None:
    text = (await client.get("/metrics")).text
    told = {family.name for family in text_string_to_metric_families(text)}
    asked = _expressions(file)
    assert len(asked) > 10
    for expression in asked:
        for name in re.findall(r"\b(?:mountnav|process)_\w+", expression):
            family = re.sub(r"_(total|bucket|count|sum)$", "", name)
            assert family in told or name in told, f"{name} in {expression}"
        for inside in re.findall(r"\{([^}]*)\}", expression):
            assert set(re.findall(r"(\w+)\s*(?:=~|!~|!=|=)", inside)) <= LABELS, expression


def test_alerts_come_when_they_should() -> None:
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("promtool is not on this machine (Debian: prometheus)")
    for told in (["check", "rules", ALERTS], ["test", "rules", ALERTS.with_suffix(".test.yml")]):
        done = subprocess.run([promtool, *map(str, told)], capture_output=True, text=True, cwd=ALERTS.parent)
        assert done.returncode == 0, done.stdout + done.stderr


def test_the_dashboards_panels_do_not_overlap() -> None:
    board = json.loads(DASHBOARD.read_text())
    taken: set[tuple[int, int]] = set()
    for panel in board["panels"]:
        place = panel["gridPos"]
        assert place["x"] + place["w"] <= 24
        cells = {(place["x"] + i, place["y"] + j) for i in range(place["w"]) for j in range(place["h"])}
        assert not cells & taken, panel["title"]
        taken |= cells
    assert len({panel["id"] for panel in board["panels"]}) == len(board["panels"])
