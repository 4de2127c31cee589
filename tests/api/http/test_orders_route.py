"""Orders over HTTP that have no picture, and what the looks in the journal tell: real service, fake mount."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.api.conftest import Serve

EAST = "/v1/telescopes/east"


async def _ended(client: httpx.AsyncClient, answer: httpx.Response) -> dict[str, Any]:
    assert answer.status_code == 202, answer.text
    job: dict[str, Any] = (await client.get(answer.headers["location"], params={"wait": 60})).json()
    assert job["finished_utc"], job
    return job


@pytest.mark.long
async def test_a_parked_telescope_moves_only_after_unpark(serving: Serve, observatory_toml: str) -> None:
    onstep = observatory_toml.replace("fake+lx200://", "fake+lx200://?dialect=onstep")
    async with serving(onstep) as client:
        state = (await client.get(EAST)).json()
        place = {"ra_deg": state["icrs"]["ra_deg"], "dec_deg": state["icrs"]["dec_deg"] - 3.0}
        parked = await _ended(client, await client.post(f"{EAST}/park"))
        assert (parked["state"], parked["result"]) == ("succeeded", {"kind": "moved", "outcome": "arrived"})
        refused = await _ended(client, await client.post(f"{EAST}/slew", json=place))
        assert refused["problem"]["reasons"] == ["parked"], refused
        assert (await _ended(client, await client.post(f"{EAST}/unpark")))["state"] == "succeeded"
        slewed = await _ended(client, await client.post(f"{EAST}/slew", json=place))
        assert slewed["state"] == "succeeded", slewed["problem"]


async def test_a_nudge_goes_that_far_and_is_written_down(client: httpx.AsyncClient) -> None:
    before = (await client.get(EAST)).json()["icrs"]
    order = {"east_arcsec": 0.0, "north_arcsec": -1800.0}
    job = await _ended(client, await client.post(f"{EAST}/offset", json=order))
    assert job["state"] == "succeeded", job["problem"]
    after = (await client.get(EAST)).json()["icrs"]
    assert after["dec_deg"] - before["dec_deg"] == pytest.approx(-0.5, abs=0.01)
    story = (await client.get("/v1/journal", params={"kind": "command", "job_id": job["id"]})).json()
    assert "slew" in str(story)


async def test_below_the_limit_nothing_moves_and_the_limit_is_named(client: httpx.AsyncClient) -> None:
    state = (await client.get(EAST)).json()["icrs"]
    south = {"ra_deg": state["ra_deg"], "dec_deg": -60.0}
    job = await _ended(client, await client.post(f"{EAST}/slew", json=south))
    assert job["problem"]["type"] == "urn:mountnav:problem:outside-limits"
    assert job["problem"]["reasons"] == ["altitude"]
    refusals = (await client.get("/v1/journal", params={"kind": "refusal"})).json()
    assert "altitude" in str(refusals)
    commands = (await client.get("/v1/journal", params={"kind": "command", "job_id": job["id"]})).json()
    assert "slew" not in str(commands)


@pytest.mark.long
async def test_looks_feed_the_doctor_and_the_drift_report(client: httpx.AsyncClient) -> None:
    few = await client.get(f"{EAST}/pointing-doctor")
    assert few.status_code == 200, few.text
    for _ in range(2):
        job = await _ended(client, await client.post(f"{EAST}/look"))
        assert job["state"] == "succeeded", job["problem"]
    told = await client.get(f"{EAST}/pointing-doctor")
    assert told.status_code == 200, told.text
    drift = await client.get(f"{EAST}/drift", params={"hours": 1})
    assert drift.status_code == 200, drift.text
    assert (await client.get(f"{EAST}/drift", params={"hours": 0})).status_code == 422
    looks = await client.get(f"{EAST}/looks")
    assert looks.status_code == 200, looks.text


@pytest.mark.long
async def test_tracking_and_an_acknowledgment(client: httpx.AsyncClient) -> None:
    job = await _ended(client, await client.post(f"{EAST}/tracking", json={"on": True, "rate": "sidereal"}))
    assert job["state"] == "succeeded" or job["problem"]["reasons"] == ["unsupported"], job
    assert (await client.post(f"{EAST}/tracking", json={"on": "yes"})).status_code == 422
    assert (await client.post(f"{EAST}/acknowledge")).json() == {"telescope": "east", "notice": None}
