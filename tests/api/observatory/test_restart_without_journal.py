"""Without a journal the service starts: states, stops and parks; orders as soon as the journal is back."""

from __future__ import annotations

import asyncio
import json
import os
import resource
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from api.http.app import create_app
from api.orders.jobs import Jobs
from api.service import Service
from mountnav.errors import JournalDamaged
from mountnav.journal.sql_journal import open_journal
from mountnav.mount import CheckedMount
from mountnav.settings.observatory import Settings
from tests.api.conftest import OBSERVATORY
from tests.api.http.stop_answers import stopped

EAST = "/v1/telescopes/east"
HIGH = {"target": {"kind": "altaz", "alt_deg": 60.0, "az_deg": 5.0}}
"""Not far from where the mounts stand: a short slew."""

TWIN = """
[[telescope]]
id = "twin"
mount = { url = "fake+lx200://?dialect=onstep", slew_rate_deg_s = 45.0, acceleration_deg_s2 = 8.0 }
camera = { kind = "folder", path = "/" }
"""


@pytest.fixture
def away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A journal that can't be opened: a folder is in its place. Removing that brings the journal back."""
    in_the_way = tmp_path / "journal.sqlite"
    in_the_way.mkdir()
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(in_the_way))
    return in_the_way


@asynccontextmanager
async def served(toml: str) -> AsyncIterator[tuple[httpx.AsyncClient, Service]]:
    """A service that runs, and a client of it."""
    app = create_app(Settings.parse(toml))
    transport = httpx.ASGITransport(app=app)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as client,
    ):
        yield client, app.state.service


@pytest.fixture
async def degraded(observatory_toml: str, away: Path) -> AsyncIterator[tuple[httpx.AsyncClient, Service]]:
    async with served(observatory_toml.replace("fake+lx200://", "fake+lx200://?dialect=onstep")) as ours:
        yield ours


async def _back(service: Service) -> None:
    async with asyncio.timeout(60):
        async for event in service.events.follow("0"):
            if event.kind == "journal-back":
                return


@pytest.mark.long
async def test_states_stop_and_park_work_orders_are_refused_with_the_reason_and_it_mends_itself(
    degraded: tuple[httpx.AsyncClient, Service], away: Path
) -> None:
    client, service = degraded
    state = (await client.get(EAST)).json()
    assert state["connected"], state
    assert state["icrs"] is not None
    health = (await client.get("/v1/health")).json()
    assert (health["status"], health["ready"]) == ("degraded", False)
    assert "journal" in " ".join(health["why_not"])
    refused = await client.post(f"{EAST}/slew", json=HIGH, headers={"Idempotency-Key": "one"})
    assert refused.status_code == 503, refused.text
    assert refused.json()["type"].endswith(":journal-failed")
    assert "journal" in refused.json()["detail"]
    assert (await stopped(client, f"{EAST}/stop")).json()["stopped"] is True
    parked = await client.post(f"{EAST}/park", params={"wait": 60})
    assert parked.json()["state"] == "succeeded", parked.text
    assert (await client.get(EAST)).json()["parked"] is True
    away.rmdir()
    await _back(service)
    unparked = await client.post(f"{EAST}/unpark", params={"wait": 60})
    assert unparked.json()["state"] == "succeeded", unparked.text
    # a refused key stands for nothing
    slewed = await client.post(
        f"{EAST}/slew", json=HIGH, headers={"Idempotency-Key": "one"}, params={"wait": 60}
    )
    assert slewed.json()["state"] == "succeeded", slewed.text
    # what was done meanwhile is written down by now
    orders = [command.order for command, _ in service.journal.reader.commands()]
    assert {"stop", "park", "unpark", "slew"} <= set(orders), orders


async def _told(client: httpx.AsyncClient, telescope: str, words: str) -> dict[str, Any]:
    """The first state of a telescope whose problem says so."""
    async with asyncio.timeout(60):
        while words not in ((state := (await client.get(telescope)).json())["problem"] or ""):
            await asyncio.sleep(0.05)
    return dict(state)


@pytest.mark.long
@pytest.mark.parametrize("journal", ["away at the start", "there"])
async def test_a_fault_in_taking_a_telescope_up_keeps_that_one_alone_from_orders_until_it_is_done(
    journal: str, observatory_toml: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    two = observatory_toml.replace("fake+lx200://", "fake+lx200://?dialect=onstep") + TWIN
    in_the_way = tmp_path / "journal.sqlite"
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(in_the_way))
    take_up, faulty = CheckedMount.take_up, ["east"]

    async def with_a_fault(mount: CheckedMount, *given: Any) -> str | None:
        if mount.name in faulty:
            raise ValueError("a row that makes no sense")
        return await take_up(mount, *given)

    monkeypatch.setattr(CheckedMount, "take_up", with_a_fault)
    if journal != "there":
        in_the_way.mkdir()
    async with served(two) as (client, service):
        if journal != "there":
            in_the_way.rmdir()
            await _back(service)
        state = await _told(client, EAST, "a row that makes no sense")
        assert state["connected"]
        assert not state["trusted"]
        health = (await client.get("/v1/health")).json()
        assert "a row that makes no sense" in json.dumps(health)
        for order, body in (("slew", HIGH), ("unpark", None), ("trust", None)):
            job = await client.post(f"{EAST}/{order}", json=body, params={"wait": 60})
            assert job.json()["state"] == "failed", job.text
            assert "a row that makes no sense" in job.text
        # nothing goes by a place that may not count, and a stop always goes
        parked = await client.post(f"{EAST}/park", params={"wait": 60})
        assert parked.json()["state"] == "failed", parked.text
        assert (await stopped(client, f"{EAST}/stop")).json()["stopped"] is True
        # its neighbor is no worse for it
        slewed = await client.post("/v1/telescopes/twin/slew", json=HIGH, params={"wait": 60})
        assert slewed.json()["state"] == "succeeded", slewed.text
        # tried again by itself; what is not known of it meanwhile an operator's word settles
        faulty.clear()
        state = await _told(client, EAST, "its position can't be trusted")
        assert not state["trusted"]
        trusted = await client.post(f"{EAST}/trust", params={"wait": 60})
        assert trusted.json()["state"] == "succeeded", trusted.text
        slewed = await client.post(f"{EAST}/slew", json=HIGH, params={"wait": 60})
        assert slewed.json()["state"] == "succeeded", slewed.text


@pytest.mark.long
@pytest.mark.parametrize("journal", ["away at the start", "there"])
async def test_no_order_is_taken_while_the_keys_of_earlier_runs_can_not_be_read_for_a_fault(
    journal: str, observatory_toml: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_the_way = tmp_path / "journal.sqlite"
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(in_the_way))
    take_up, faulty, tried = Jobs.take_up, [True], asyncio.Event()

    async def with_a_fault(jobs: Jobs) -> Any:
        if faulty:
            if in_the_way.is_file():
                tried.set()
            raise ValueError("a row that makes no sense")
        return await take_up(jobs)

    monkeypatch.setattr(Jobs, "take_up", with_a_fault)
    if journal != "there":
        in_the_way.mkdir()
    async with served(observatory_toml) as (client, service):
        if journal != "there":
            in_the_way.rmdir()
        async with asyncio.timeout(60):
            await tried.wait()
        refused = await client.post(f"{EAST}/slew", json=HIGH)
        assert refused.status_code == 503, refused.text
        assert "a row that makes no sense" in refused.json()["detail"]
        health = (await client.get("/v1/health")).json()
        assert not health["ready"]
        assert "a row that makes no sense" in " ".join(health["why_not"])
        assert (await stopped(client, f"{EAST}/stop")).json()["stopped"] is True
        faulty.clear()
        await _back(service)
        slewed = await client.post(f"{EAST}/slew", json=HIGH, params={"wait": 60})
        assert slewed.json()["state"] == "succeeded", slewed.text


@pytest.mark.long
async def test_keys_of_earlier_runs_are_known_before_an_order_is_taken(
    observatory_toml: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, hidden = tmp_path / "journal.sqlite", tmp_path / "hidden"
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(file))

    async def order(client: httpx.AsyncClient) -> httpx.Response:
        return await client.post(f"{EAST}/slew", json=HIGH, headers={"Idempotency-Key": "k"})

    ids = []
    for run in range(2):
        async with served(observatory_toml) as (client, service):
            if run == 1:
                assert (await order(client)).status_code == 503
                file.rmdir()
                hidden.rename(file)
                await _back(service)
            answer = await order(client)
            assert answer.status_code == 202, answer.text
            ids.append(answer.json()["id"])
        if run == 0:
            file.rename(hidden)
            file.mkdir()
    assert ids[0] == ids[1]


async def test_an_order_is_on_the_disk_before_it_is_answered(observatory_toml: str) -> None:
    async with served(observatory_toml) as (client, service):
        journal, written = service.journal, []
        save = journal.save_job

        async def slowly(row: object) -> None:
            await asyncio.sleep(0.3)
            await save(row)  # type: ignore[arg-type]
            written.append(row)

        journal.save_job = slowly  # type: ignore[method-assign,assignment]
        answers = await asyncio.gather(
            *(client.post(f"{EAST}/look", headers={"Idempotency-Key": "k"}) for _ in range(2))
        )
        assert written
        assert len({answer.json()["id"] for answer in answers}) == 1
        # another process would find it
        assert journal.reader.job(answers[0].json()["id"]) is not None


@pytest.mark.parametrize("cut", ["end", "middle", "zeros"])
def test_a_damaged_journal_is_refused_and_left_alone(tmp_path: Path, cut: str) -> None:
    file = tmp_path / "journal.sqlite"
    open_journal(file, settings_text="x" * 20_000).close()
    whole = file.read_bytes()
    damaged = {
        "end": whole[:-3000],
        "middle": whole[:20_000] + whole[23_000:],
        "zeros": whole[:20_000] + bytes(3000) + whole[23_000:],
    }[cut]
    file.write_bytes(damaged)
    for patient in (False, True):
        with pytest.raises(JournalDamaged, match="damaged"):
            open_journal(file, patient=patient).close()
    assert file.read_bytes() == damaged


@pytest.mark.long
@pytest.mark.parametrize("kept", [False, True], ids=["first start", "a journal of earlier nights"])
def test_a_real_service_starts_on_a_full_disk(tmp_path: Path, kept: bool) -> None:
    """No file may grow, as on a full disk: what is left of a journal that couldn't be made is no other's."""
    config, file = tmp_path / "observatory.toml", tmp_path / "night.sqlite"
    config.write_text(OBSERVATORY)
    if kept:
        open_journal(file).close()
    process = subprocess.Popen(
        [sys.executable, "-m", "api.main", "serve", "--config", str(config)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | {"MOUNTNAV_JOURNAL": str(file)},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (512, resource.RLIM_INFINITY)),
    )
    assert process.stdout is not None
    try:
        told = process.stdout.readline()
        assert "http" in told, process.wait(60)
        with httpx.Client(base_url=told.split()[-1], trust_env=False, timeout=60) as client:
            while True:
                try:
                    refused = client.post(f"{EAST}/slew", json=HIGH)
                    break
                except httpx.TransportError:
                    assert process.poll() is None
            assert refused.json()["type"].endswith(":journal-failed"), refused.text
            while (answer := client.post(f"{EAST}/stop")).status_code == 202:
                pass  # not known yet, on a machine that has other work
            assert answer.json()["stopped"] is True
            with client.stream("GET", "/v1/events", headers={"Last-Event-ID": "0"}) as events:
                resource.prlimit(
                    process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
                )
                assert any("journal-back" in line for line in events.iter_lines())
            slewed = client.post(f"{EAST}/slew", json=HIGH, params={"wait": 60})
            assert slewed.json()["state"] == "succeeded", slewed.text
    finally:
        process.terminate()
        process.wait(60)
        process.stdout.close()
