"""What a request says besides what is known is refused on every route, and moves nothing."""

from __future__ import annotations

import threading

import httpx
import pytest
from fastapi.routing import iter_route_contexts

from api.access.rate_limits import is_stop
from api.http.app import create_app
from mountnav.settings.observatory import Settings
from tests.api.http.stop_answers import stopped

EAST = "/v1/telescopes/east"


@pytest.mark.long
async def test_every_route_refuses_a_parameter_that_it_does_not_know(
    client: httpx.AsyncClient, observatory_toml: str
) -> None:
    asked = 0
    for route in iter_route_contexts(create_app(Settings.parse(observatory_toml)).routes):
        path = str(route.path)
        if not path.startswith("/v1"):
            continue
        for method in sorted((route.methods or {"GET"}) - {"HEAD"}):
            if is_stop(method, path):
                continue
            filled = (
                path.replace("{telescope_id}", "east").replace("{job_id}", "x").replace("{frame_id}", "x")
            )
            answer = await client.request(method, filled, params={"limt": "3"})
            assert answer.status_code == 422, (method, filled, answer.status_code, answer.text)
            assert "limt" in answer.text, (method, filled, answer.text)
            asked += 1
    assert asked > 50


@pytest.mark.long
@pytest.mark.parametrize(
    "query",
    [
        "/v1/journal?limit=-1",
        "/v1/journal?limit=0",
        "/v1/journal?limit=3&limit=4",
        "/v1/journal?limt=3",
        "/v1/audit?limit=-1",
        "/v1/jobs?count=-1",
        f"{EAST}/jobs?count=0",
        f"{EAST}/wire?after=-1",
        f"{EAST}/looks?limit=-1",
        f"{EAST}/offsets?hours=-1",
        f"{EAST}/pointing-doctor?hours=0",
        "/v1/objects?count=-1",
    ],
)
async def test_a_bound_that_is_none_is_refused(client: httpx.AsyncClient, query: str) -> None:
    answer = await client.get(query)
    assert answer.status_code == 422, answer.text
    assert answer.json()["type"].endswith(":bad-request")


async def test_a_list_may_be_repeated(client: httpx.AsyncClient) -> None:
    assert (await client.get("/v1/journal?kind=look&kind=command&limit=3")).status_code == 200


@pytest.mark.long
@pytest.mark.parametrize(
    "body",
    [
        '{"ra_deg": 10, "ra_deg": 200, "dec_deg": 40}',
        '{"target": {"kind": "icrs", "ra_deg": 10, "dec_deg": 40, "dec_deg": -40}}',
        '{"ra_deg": 10, "ra\\u005fdeg": 200, "dec_deg": 40}',
    ],
)
@pytest.mark.parametrize(
    "kind", ["application/json", "application/problem+json", "Application/JSON; charset=utf-8"]
)
async def test_a_key_that_stands_twice_is_refused(client: httpx.AsyncClient, body: str, kind: str) -> None:
    answer = await client.post(f"{EAST}/slew", content=body, headers={"Content-Type": kind})
    assert answer.status_code == 422, answer.text
    assert "more than once" in answer.text or "twice" in answer.text
    assert (await client.get("/v1/jobs")).json() == []


async def test_a_stop_is_taken_whatever_its_body(client: httpx.AsyncClient) -> None:
    answer = await stopped(
        client,
        f"{EAST}/stop?whatever=1",
        content='{"a": 1, "a": 2}',
        headers={"Content-Type": "application/json"},
    )
    assert answer.status_code == 200, answer.text


async def test_other_bodies_are_told_as_before(client: httpx.AsyncClient) -> None:
    too_large = '{"ra_deg": ' + "1" * 400 + ', "dec_deg": 1}'
    for body in ("{", "[" * 100_000, "nonsense", "", too_large, too_large.replace("1", "-1e9", 1)):
        answer = await client.post(f"{EAST}/slew", content=body, headers={"Content-Type": "application/json"})
        assert answer.status_code in (400, 422), (body[:10], answer.status_code)


async def test_twenty_thousand_keys_are_refused_unread(client: httpx.AsyncClient) -> None:
    headers = {"Content-Type": "application/json"}
    for count in (1001, 18_000):
        body = "{" + ", ".join(f'"k{number}": 0' for number in [*range(count), count - 1]) + "}"
        answer = await client.post(f"{EAST}/slew", content=body, headers=headers)
        assert answer.status_code == 422
        assert f"{count + 1} keys in one object" in answer.text
    body = "{" + ", ".join(f'"k{number}": 0' for number in [*range(900), 899]) + "}"
    answer = await client.post(f"{EAST}/slew", content=body, headers=headers)
    assert "'k899' stands twice" in answer.text


@pytest.mark.long
@pytest.mark.parametrize("method", ["GET", "POST", "PUT", "OPTIONS", "TRACE"])
async def test_an_address_without_end_is_refused_before_any_route_is_held_against_it(
    client: httpx.AsyncClient, method: str
) -> None:
    for address in ("/v1/telescopes/" + "a" * 9000, f"{EAST}?a=" + "1" * 9000, "/" + "a/" * 5000):
        answer = await client.request(method, address)
        assert answer.status_code == 414, (address[:40], answer.status_code)
        assert answer.json()["type"].endswith(":too-large")
    assert (await client.get(f"{EAST}/events/none?a=" + "1" * 8000)).status_code != 414


@pytest.mark.long
async def test_a_stop_is_taken_whatever_its_query(client: httpx.AsyncClient) -> None:
    answer = await stopped(client, f"{EAST}/stop?a=" + "1" * 9000)
    assert answer.status_code == 200, answer.text


@pytest.mark.long
async def test_the_description_is_made_beside_the_loop(observatory_toml: str) -> None:
    app = create_app(Settings.parse(observatory_toml))
    threads: list[int] = []
    make = app.openapi

    def noted() -> dict[str, object]:
        threads.append(threading.get_ident())
        return make()

    app.openapi = noted  # type: ignore[method-assign]
    transport = httpx.ASGITransport(app=app)
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as asking:
        answers = [await asking.get("/openapi.json") for _ in range(2)]
    assert [one.json()["info"]["title"] for one in answers] == ["mountnav"] * 2
    assert threads
    assert threading.get_ident() not in threads
