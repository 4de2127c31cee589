"""The HTTP face: orders, jobs, problems, and what bad input meets."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from typing import Any

import httpx
import pytest

from tests.api.http.stop_answers import stopped

Serve = Callable[[str], AbstractAsyncContextManager[httpx.AsyncClient]]

EAST = "/v1/telescopes/east"


def _slug(response: httpx.Response) -> str:
    assert response.headers["content-type"] == "application/problem+json"
    body = response.json()
    assert body["status"] == response.status_code
    return str(body["type"]).removeprefix("urn:mountnav:problem:")


async def _near_zenith(client: httpx.AsyncClient, dec_off_deg: float = 0.0) -> dict[str, float]:
    icrs = (await client.get(EAST)).json()["icrs"]
    return {"ra_deg": icrs["ra_deg"], "dec_deg": icrs["dec_deg"] + dec_off_deg}


async def _ended(client: httpx.AsyncClient, started: httpx.Response) -> dict[str, Any]:
    assert started.status_code == 202, started.text
    found = await client.get(started.headers["location"], params={"wait": 60})
    body: dict[str, Any] = found.json()
    return body


async def test_the_state_tells_where_it_points(client: httpx.AsyncClient) -> None:
    state = (await client.get(EAST)).json()
    assert state["connected"] is True
    assert state["reading"]["frame"] == "jnow-apparent"
    assert state["altitude_deg"] == pytest.approx(90.0, abs=0.2)
    assert [one["id"] for one in (await client.get("/v1/telescopes")).json()] == ["east", "gone"]


@pytest.mark.long
async def test_a_centering_goes_the_whole_way(client: httpx.AsyncClient) -> None:
    target = await _near_zenith(client, -5.0)
    job = await _ended(client, await client.post(f"{EAST}/center", json=target))
    assert job["state"] == "succeeded", job
    result = job["result"]
    assert result["target"] == {**target, "frame": "icrs", "utc": None}
    assert result["error_before_arcsec"] > 120.0
    assert result["error_after_arcsec"] <= 30.0
    assert job["attempts"] == result["attempts"]
    assert job["attempts"][0]["synced"] is True


@pytest.mark.long
async def test_look_and_sync_need_no_body(client: httpx.AsyncClient) -> None:
    look = await _ended(client, await client.post(f"{EAST}/look"))
    assert look["result"]["kind"] == "look", look
    assert look["result"]["offset"]["total_arcsec"] > 120.0
    sync = await _ended(client, await client.post(f"{EAST}/sync"))
    assert sync["result"]["read_back_miss_arcsec"] < 30.0, sync
    again = await _ended(client, await client.post(f"{EAST}/look", json={"exposure_s": 0.25}))
    assert again["result"]["offset"]["total_arcsec"] < 30.0


@pytest.mark.long
async def test_a_recovery_confirms_by_a_second_look_and_syncs(client: httpx.AsyncClient) -> None:
    # a mount that isn't lost: the hint leads there, and the way is the same
    job = await _ended(client, await client.post(f"{EAST}/recover", json={"exposure_s": 0.2}))
    assert (job["state"], job["kind"]) == ("succeeded", "recover"), job
    result = job["result"]
    assert result["kind"] == "recover"
    assert result["first"]["look_id"] != result["second"]["look_id"]
    assert result["first"]["mid_exposure_utc"] < result["second"]["mid_exposure_utc"]
    assert result["apart_arcsec"] < 5.0
    assert result["altitude_deg"] == pytest.approx(90.0, abs=0.5)
    assert result["read_back_miss_arcsec"] < 30.0
    look = await _ended(client, await client.post(f"{EAST}/look"))
    assert look["result"]["offset"]["total_arcsec"] < 30.0


async def test_a_slew_in_apparent_coordinates_of_now(client: httpx.AsyncClient) -> None:
    reading = (await client.get(EAST)).json()["reading"]
    body = {"ra_deg": reading["ra_deg"], "dec_deg": reading["dec_deg"] - 3, "frame": "jnow-apparent"}
    job = await _ended(client, await client.post(f"{EAST}/slew", json=body))
    assert job["state"] == "succeeded", job
    there = (await client.get(EAST)).json()["reading"]
    assert there["dec_deg"] == pytest.approx(body["dec_deg"], abs=0.01)
    assert there["ra_deg"] == pytest.approx(body["ra_deg"], abs=0.02)


async def test_busy_names_the_running_job_and_stop_is_never_refused(client: httpx.AsyncClient) -> None:
    target = await _near_zenith(client)
    started = await client.post(f"{EAST}/look", json={"exposure_s": 60.0})
    busy = await client.post(f"{EAST}/slew", json=target)
    assert (busy.status_code, _slug(busy)) == (409, "busy")
    assert busy.json()["job_id"] == started.json()["id"]
    assert busy.json()["retryable"] is True
    first = (await client.post(f"{EAST}/stop")).json()
    assert (first["telescope"], first["cancelled_job_id"]) == ("east", started.json()["id"])
    assert first["stopped"] in (True, None), first
    job = await _ended(client, started)
    assert (job["state"], job["problem"]["type"]) == ("cancelled", "urn:mountnav:problem:cancelled")
    idle = await stopped(client, f"{EAST}/stop")
    assert idle.status_code == 200
    assert idle.json() == {"telescope": "east", "stopped": True, "cancelled_job_id": None}


@pytest.mark.long
async def test_deleting_a_job_stops_the_slew_and_twice_is_fine(client: httpx.AsyncClient) -> None:
    before = await _near_zenith(client)
    started = await client.post(f"{EAST}/slew", json={**before, "dec_deg": before["dec_deg"] + 40.0})
    path = started.headers["location"]
    for _ in range(2):
        cancelled = await client.delete(path)
        assert (cancelled.status_code, cancelled.json()["state"]) == (200, "cancelled")
    first, second = [(await client.get(EAST)).json() for _ in range(2)]
    assert second["icrs"]["dec_deg"] < before["dec_deg"] + 39.0
    assert second["icrs"]["dec_deg"] == pytest.approx(first["icrs"]["dec_deg"], abs=0.01) or first["slewing"]


async def test_a_target_below_the_horizon_moves_nothing(client: httpx.AsyncClient) -> None:
    before = (await client.get(EAST)).json()["altitude_deg"]
    job = await _ended(client, await client.post(f"{EAST}/center", json={"ra_deg": 0.0, "dec_deg": -85.0}))
    assert job["state"] == "failed"
    assert job["problem"]["type"] == "urn:mountnav:problem:outside-limits"
    assert (await client.get(EAST)).json()["altitude_deg"] == pytest.approx(before, abs=0.1)


async def test_a_missing_port_names_those_that_exist_and_kills_nothing(client: httpx.AsyncClient) -> None:
    state = (await client.get("/v1/telescopes/gone")).json()
    assert state["connected"] is False
    assert "there-is-no-such-port" in state["problem"]
    job = await _ended(client, await client.post("/v1/telescopes/gone/look"))
    assert job["problem"]["type"] == "urn:mountnav:problem:device-missing"
    assert job["problem"]["advice"]
    stop = await client.post("/v1/telescopes/gone/stop")
    assert (stop.status_code, _slug(stop)) == (503, "device-missing")
    health = (await client.get("/v1/health")).json()
    assert (health["status"], health["telescopes"]) == ("degraded", {"east": True, "gone": False})
    assert health["solver"] == "in this process"
    assert health["blind_index"].split(":")[0] in {"ready", "none"}
    assert abs(health["earth_rotation"]["dut1_s"]) < 0.9
    assert not health["earth_rotation"]["dut1_overridden"]


@pytest.mark.long
@pytest.mark.parametrize(
    "body",
    [
        '{"ra_deg": NaN, "dec_deg": 1}',
        '{"ra_deg": 1e999, "dec_deg": 1}',
        '{"ra_deg": "10", "dec_deg": 1}',
        '{"ra_deg": 10, "dec_deg": true}',
        '{"ra_deg": 360, "dec_deg": 1}',
        '{"ra_deg": 10, "dec_deg": 90.1}',
        '{"ra_deg": 10}',
        '{"ra_deg": 10, "dec_deg": 1, "frame": "fk5-j2000"}',
        '{"ra_deg": 10, "dec_deg": 1, "\\ud800": 1}',
        '{"ra_deg": 10, "dec_deg": 1, "tolerance_arcsec": 0}',
        '{"ra_deg": 10, "dec_deg": 1, "max_tries": 2.5}',
        "[]",
        "null",
        "",
        "{",
        "\xff",
        "[" * 100_000,
        f'{{"ra_deg": {"9" * 5000}, "dec_deg": 1}}',
    ],
)
async def test_bad_bodies_are_told_and_start_nothing(client: httpx.AsyncClient, body: str) -> None:
    headers = {"content-type": "application/json"}
    answer = await client.post(f"{EAST}/center", content=body.encode("latin-1"), headers=headers)
    assert answer.status_code in {400, 422}, answer.text
    assert _slug(answer) == "bad-request"
    assert (await client.get("/v1/jobs")).json() == []


@pytest.mark.long
async def test_unknown_things_are_not_found(client: httpx.AsyncClient) -> None:
    for method, path in (
        ("GET", "/v1/telescopes/nowhere"),
        ("POST", "/v1/telescopes/nowhere/stop"),
        ("GET", "/v1/telescopes/%ED%A0%80"),
        ("GET", "/v1/jobs/nothing"),
        ("DELETE", "/v1/jobs/nothing"),
        ("GET", "/v2"),
    ):
        answer = await client.request(method, path)
        assert (answer.status_code, _slug(answer)) == (404, "not-found")
    wrong = await client.put(EAST)
    assert (wrong.status_code, _slug(wrong)) == (405, "method-not-allowed")


@pytest.mark.long
@pytest.mark.parametrize("wait", ["nan", "inf", "-1", "x"])
async def test_a_bad_wait_is_told(client: httpx.AsyncClient, wait: str) -> None:
    answer = await client.get("/v1/jobs/nothing", params={"wait": wait})
    assert answer.status_code in {404, 422}
    _slug(answer)


@pytest.mark.long
async def test_an_idempotency_key_never_slews_twice(client: httpx.AsyncClient) -> None:
    target = await _near_zenith(client, -1.0)
    headers = {"Idempotency-Key": "abc"}
    first = await client.post(f"{EAST}/slew", json=target, headers=headers)
    await _ended(client, first)
    second = await client.post(f"{EAST}/slew", json=target, headers=headers)
    assert second.json()["id"] == first.json()["id"]
    other = await client.post(f"{EAST}/slew", json={**target, "dec_deg": 1.0}, headers=headers)
    assert (other.status_code, _slug(other)) == (422, "idempotency-key-reused")
    assert len((await client.get("/v1/jobs")).json()) == 1


async def test_other_sites_pages_are_refused(client: httpx.AsyncClient) -> None:
    for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
        answer = await client.post(f"{EAST}/stop", headers=headers)
        assert (answer.status_code, _slug(answer)) == (403, "forbidden")
    own = {"Host": "localhost:8000", "Origin": "http://localhost:8000"}
    assert (await stopped(client, f"{EAST}/stop", headers=own)).status_code == 200


async def test_a_token_is_asked_for_and_taken_two_ways(serving: Serve, observatory_toml: str) -> None:
    sha256 = hashlib.sha256(b"open sesame").hexdigest()
    toml = observatory_toml.replace(
        "[service]", f'[service]\nhost = "0.0.0.0"\napi_token_sha256 = "{sha256}"'
    )
    async with serving(toml) as client:
        for headers in ({}, {"X-API-Key": "wrong"}, {"Authorization": "Bearer wrong"}, {"X-API-Key": "é"}):
            for method, path in (("GET", EAST), ("POST", f"{EAST}/stop"), ("GET", "/v1/events")):
                encoded = {name.encode(): value.encode() for name, value in headers.items()}
                answer = await client.request(method, path, headers=encoded)
                assert (answer.status_code, _slug(answer)) == (401, "unauthorized")
                assert answer.headers["www-authenticate"].startswith("Bearer")
        for headers in ({"X-API-Key": "open sesame"}, {"Authorization": "Bearer open sesame"}):
            assert (await client.get(EAST, headers=headers)).status_code == 200
        assert (await client.get("/v1/health")).status_code == 200
