"""The state over HTTP: one body for each reading, 304 to who has it, and no device asked by who asks."""

from __future__ import annotations

import asyncio
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from api.http.app import create_app
from api.http.telescope_views import knows
from api.observatory.observatory import Telescope
from mountnav.devices import MountReading
from mountnav.navigation.reports import TelescopeState
from mountnav.settings.observatory import Settings

EAST = "/v1/telescopes/east"


@pytest.mark.parametrize(
    ("sent", "known"),
    [
        (None, False),
        ("", False),
        ('"a-1-"', True),
        ('W/"a-1-"', True),
        ('"x", "a-1-"', True),
        ("*", True),
        ('"a-2-"', False),
        ("a-1-", False),
    ],
)
def test_if_none_match_is_read_as_http_has_it(sent: str | None, known: bool) -> None:
    assert knows(sent, '"a-1-"') is known


@pytest.mark.long
async def test_a_hundred_questions_ask_the_mount_nothing(
    observatory_toml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    toml = observatory_toml.replace("[service]", "[service]\nstate_poll_s = 60.0")
    app: FastAPI = create_app(Settings.parse(toml))
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as client,
    ):
        service = app.state.service
        mount = service.observatory.telescope("east").navigator.mount
        asked: list[MountReading] = []
        mount.on_reading(asked.append)
        first = await client.get(EAST)
        assert first.status_code == 200
        assert first.json()["connected"] is True
        tag = first.headers["etag"]
        # a reading may still be under way from the start; from here on nobody reads
        asked.clear()
        for _ in range(50):
            full, short = await client.get(EAST), await client.get(EAST, headers={"If-None-Match": tag})
            assert (full.content, full.headers["etag"]) == (first.content, tag)
            assert (short.status_code, short.content, short.headers["etag"]) == (304, b"", tag)
        assert asked == []
        every = await client.get("/v1/telescopes")
        assert every.json()[0] == first.json()
        again = await client.get("/v1/telescopes", headers={"If-None-Match": every.headers["etag"]})
        assert again.status_code == 304

        # a new reading is a new answer
        await service.dispatcher.watch("east").refresh()
        fresh = await client.get(EAST, headers={"If-None-Match": tag})
        assert fresh.status_code == 200
        assert fresh.headers["etag"] != tag
        assert fresh.json()["read_utc"] > first.json()["read_utc"]

        # so is a job, at once
        started = await client.post(f"{EAST}/look", json={"exposure_s": 400.0})
        held = await client.get(EAST, headers={"If-None-Match": fresh.headers["etag"]})
        assert (held.status_code, held.json()["job_id"]) == (200, started.json()["id"])
        await client.post(f"{EAST}/stop")
        await asyncio.wait_for(service.jobs.get(started.json()["id"]).ended.wait(), 60)


@pytest.mark.long
async def test_a_reading_that_hits_a_fault_leaves_no_old_state_that_looks_new(
    observatory_toml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, faulty = Telescope.state, [True]

    async def with_a_fault(telescope: Telescope) -> TelescopeState:
        if faulty:
            raise ValueError("a reading that makes no sense")
        return await state(telescope)

    app = create_app(Settings.parse(observatory_toml))
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as client,
    ):

        async def until(*, connected: bool) -> dict[str, Any]:
            async with asyncio.timeout(60):
                while (found := (await client.get("/v1/telescopes/east")).json())[
                    "connected"
                ] is not connected:
                    await asyncio.sleep(0.02)
            return dict(found)

        await until(connected=True)
        monkeypatch.setattr(Telescope, "state", with_a_fault)
        assert "a reading that makes no sense" in (await until(connected=False))["problem"]
        faulty.clear()
        assert (await until(connected=True))["problem"] is None
