"""What schedulers' authors trip over: wishes in several lines, fields in vain, bodies of no kind, ends."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from api.access.callers import Role
from api.access.keys import KeyStore
from api.http.app import create_app
from mountnav.settings.observatory import Settings
from tests.api.conftest import Serve

EAST = "/v1/telescopes/east"
JOBS = f"{EAST}/jobs"
LONG = {"kind": "look", "exposure_s": 500.0}
PREFERRED = [
    ((), None),
    (("wait=7",), "wait=7"),
    (("respond-async", "wait=7"), "wait=7"),
    (("respond-async, wait=7", "handling=lenient"), "wait=7"),
    (("wait=7", "wait=9"), "wait=7"),
    ((f'note="{"x" * 5000}"', "wait=7"), "wait=7"),
    (("wait=99999",), "wait=3600"),
    (("wait=soon", "await=3"), None),
]
WITHOUT_EFFECT: list[dict[str, Any]] = [
    {"path": "frame.fits", "exposure_s": 2.0},
    {"path": "frame.fits", "ra_deg": 10.0},
    {"path": "frame.fits", "radius_deg": 1.0},
    {"path": "frame.fits", "scale_low_arcsec_px": 3.0, "scale_high_arcsec_px": 2.0},
    {"ra_deg": 10.0, "dec_deg": 20.0},
    {"blind": "only"},
    {"exposure_s": 2.0, "budget_s": 5.0},
]


def _slug(answer: httpx.Response) -> str:
    assert answer.headers["content-type"] == "application/problem+json"
    return str(answer.json()["type"]).removeprefix("urn:mountnav:problem:")


async def test_a_wish_to_wait_counts_in_whichever_line_it_stands(client: httpx.AsyncClient) -> None:
    """[RFC 7240 §2]: several lines are one list, the first of several counts, and none is ever an error."""
    job = (await client.post(JOBS, json={"kind": "unpark"}, params={"wait": 60})).json()["id"]
    for lines, applied in PREFERRED:
        told = await client.get(f"/v1/jobs/{job}", headers=[("Prefer", one) for one in lines])
        assert (told.status_code, told.headers.get("preference-applied")) == (200, applied), lines
    # the query goes before the header, also where it says not to wait
    told = await client.get(f"/v1/jobs/{job}", params={"wait": 0}, headers={"Prefer": "wait=30"})
    assert "preference-applied" not in told.headers


async def test_what_makes_no_sense_is_told_before_there_is_a_job(
    client: httpx.AsyncClient,
) -> None:
    for fields in WITHOUT_EFFECT:
        answer = await client.post(JOBS, json={"kind": "solve", **fields})
        assert (answer.status_code, _slug(answer)) == (422, "bad-request"), fields
    # curl -d without a header: the commonest of all mistakes
    for kind in (None, "application/x-www-form-urlencoded", "text/plain"):
        headers = {} if kind is None else {"Content-Type": kind}
        answer = await client.post(JOBS, content=b'{"kind": "park"}', headers=headers)
        assert (answer.status_code, _slug(answer)) == (422, "bad-request"), kind
        assert "Content-Type: application/json" in answer.json()["advice"], kind
    # an answer is not as long as the nonsense it is about
    for body in ({"kind": "park", **{f"field{n}": 1 for n in range(3000)}}, {"kind": "x" * 100_000}):
        answer = await client.post(JOBS, json=body)
        assert (answer.status_code, _slug(answer)) == (422, "bad-request")
        assert len(answer.content) < 10_000
    answer = await client.post(JOBS, json={"kind": "slew"})
    assert "Content-Type" not in answer.json()["advice"]
    # a frame that stands in the query instead of the body would be taken for the ICRS: 20 arcmin off
    place = {"ra_deg": 10.0, "dec_deg": 80.0}
    for query in ({"frame": "jnow-apparent"}, {"supercede": "true"}, {"wait": 5, "Wait": 5}):
        answer = await client.post(f"{EAST}/slew", json=place, params=query)
        assert (answer.status_code, _slug(answer)) == (422, "bad-request"), query
    assert answer.json()["errors"] == [{"at": "query.Wait", "what": "an order has no such parameter"}]
    assert (await client.get("/v1/jobs")).json() == []


async def test_a_body_of_an_order_is_bounded_as_every_body_without_a_frame(observatory_toml: str) -> None:
    """An order for `jobs` has no frame in it: a large one is not read, let alone parsed while others wait."""
    toml = observatory_toml.replace("[service]", "[service]\nmax_body_kb = 10\nmax_upload_mb = 1")
    large = json.dumps({"kind": "park", "x": "x" * 20_000}).encode()

    async def stream() -> AsyncIterator[bytes]:
        for at in range(0, len(large), 1000):
            yield large[at : at + 1000]

    transport = httpx.ASGITransport(app=create_app(Settings.parse(toml)), raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as client:
        for body in (large, stream()):
            refused = await client.post(JOBS, content=body, headers={"Content-Type": "application/json"})
            assert (refused.status_code, _slug(refused)) == (413, "too-large")


@pytest.mark.long
async def test_a_cancelled_job_says_who_ended_it_also_after_a_restart(
    serving: Serve, observatory_toml: str, tmp_path: Path
) -> None:
    """One that the service took along was nobody's wish, and nobody is to look for whoever it was."""
    store = KeyStore(tmp_path / "keys.json")
    robot, chief = ({"X-API-Key": store.new(name, Role.OPERATE)[1]} for name in ("robot", "chief"))
    ended = []
    async with serving(observatory_toml) as client:
        for _ in range(2):
            job = (await client.post(JOBS, json=LONG, headers=robot)).json()["id"]
            ended.append(job)
            if len(ended) == 1:
                await client.post("/v1/stop", headers=chief)
    async with serving(observatory_toml) as client:
        told = [(await client.get(f"/v1/jobs/{job}", headers=robot)).json() for job in ended]
    assert [one["state"] for one in told] == ["cancelled", "cancelled"]
    assert [one["problem"]["detail"] for one in told] == [
        "stopped on request of chief (rest)",
        "the service was shut down",
    ]
