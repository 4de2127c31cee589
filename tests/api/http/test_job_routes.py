"""Orders as jobs over HTTP: any kind, both frames, patience, superseding, cancelling, keys."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from api.orders.vocabulary import KINDS
from mountnav.clock import utc_now
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.conftest import Serve

EAST = "/v1/telescopes/east"
JOBS = f"{EAST}/jobs"
SOUTH = {"kind": "altaz", "alt_deg": 80.0, "az_deg": 170.0}
LONG = {"kind": "look", "exposure_s": 500.0}


def _slug(answer: httpx.Response) -> str:
    assert answer.headers["content-type"] == "application/problem+json"
    return str(answer.json()["type"]).removeprefix("urn:mountnav:problem:")


@pytest.mark.long
async def test_a_target_in_any_frame_is_reached_and_told_in_both(client: httpx.AsyncClient) -> None:
    answer = await client.post(JOBS, json={"kind": "slew", "target": SOUTH}, params={"wait": 60})
    assert answer.status_code == 200, answer.text
    job = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}"
    assert (job["kind"], job["state"], job["request"]["target"]) == ("slew", "succeeded", SOUTH)
    result = job["result"]
    icrs = Icrs(result["target"]["ra_deg"], result["target"]["dec_deg"])
    assert (result["target"]["frame"], result["target_mount"]["frame"]) == ("icrs", "jnow-apparent")
    of_date = icrs_to_apparent(icrs, utc_now())
    mount = result["target_mount"]
    assert separation_arcsec(
        Icrs(of_date.ra_deg, of_date.dec_deg), Icrs(mount["ra_deg"], mount["dec_deg"])
    ) == pytest.approx(0.0, abs=0.01)
    state = (await client.get(EAST)).json()
    assert state["altitude_deg"] == pytest.approx(80.0, abs=0.3)
    assert state["azimuth_deg"] == pytest.approx(170.0, abs=2.0)
    assert -10.0 < state["hour_angle_deg"] < 0.0
    assert state["local_sidereal_time_deg"] == pytest.approx(
        (state["reading"]["ra_deg"] + state["hour_angle_deg"]) % 360.0, abs=0.2
    )
    assert state["time_to_limit_s"] == state["next_limit"]["after_s"] > 3600.0
    # the short form is the same order: its key is known
    key = {"Idempotency-Key": "one"}
    first = await client.post(JOBS, json={"kind": "unpark"}, params={"wait": 60}, headers=key)
    again = await client.post(f"{EAST}/unpark", headers=key)
    assert (first.status_code, again.status_code) == (200, 202)
    assert again.json()["id"] == first.json()["id"]
    for path, body in ((JOBS, {"kind": "park"}), (f"{EAST}/slew", {"ra_deg": 1.0, "dec_deg": 2.0})):
        other = await client.post(path, json=body, headers=key)
        assert (other.status_code, _slug(other)) == (422, "idempotency-key-reused")


@pytest.mark.long
async def test_one_at_a_time_superseding_and_cancelling(client: httpx.AsyncClient) -> None:
    started = await client.post(JOBS, json=LONG)
    assert started.status_code == 202
    holder = started.json()["id"]
    busy = await client.post(f"{EAST}/slew", json={"target": SOUTH})
    assert (busy.status_code, _slug(busy), busy.json()["job_id"]) == (409, "busy", holder)
    assert busy.json()["retryable"] is True
    assert float(busy.headers["retry-after"]) >= busy.json()["retry_after_s"] > 0
    # patience that runs out is answered as it stands, and says that it was taken
    waited = await client.get(f"/v1/jobs/{holder}", headers={"Prefer": "respond-async, wait=1"})
    assert (waited.json()["state"], waited.headers["preference-applied"]) == ("running", "wait=1")

    key = {"Idempotency-Key": "two"}
    order = {"kind": "look", "exposure_s": 400.0}
    second = await client.post(JOBS, json=order, params={"supersede": True}, headers=key)
    assert second.status_code == 202, second.text
    ended = (await client.get(f"/v1/jobs/{holder}", params={"wait": 60})).json()
    assert (ended["state"], ended["problem"]["superseded_by"]) == ("cancelled", second.json()["id"])
    repeated = await client.post(JOBS, json=order, params={"supersede": True}, headers=key)
    assert repeated.json()["id"] == second.json()["id"]
    assert (await client.get(EAST)).json()["job_id"] == second.json()["id"]

    for _ in range(2):
        cancelled = await client.post(f"/v1/jobs/{second.json()['id']}/cancel")
        assert (cancelled.status_code, cancelled.json()["state"]) == (200, "cancelled")
    third = await client.post(JOBS, json=LONG)
    stopped = (await client.post("/v1/stop")).json()
    told = {one["telescope"]: one for one in stopped["telescopes"]}
    assert told["east"]["cancelled_job_id"] == third.json()["id"]
    # one that nobody can reach is not told to be at rest
    assert (told["gone"]["stopped"], stopped["stopped"]) == (False, False)
    # not seen at rest yet where the machine has other work
    assert told["east"]["stopped"] in (True, None)
    assert "there-is-no-such-port" in told["gone"]["problem"]
    mine = (await client.get(f"{EAST}/jobs")).json()
    assert [one["id"] for one in mine] == [third.json()["id"], second.json()["id"], holder]
    assert (await client.get("/v1/telescopes/gone/jobs")).json() == []


BAD_ORDERS = [
    '{"kind": "fly"}',
    '{"target": {"kind": "icrs", "ra_deg": 1, "dec_deg": 1}}',
    '{"kind": "slew"}',
    '{"kind": "slew", "target": {"ra_deg": 1, "dec_deg": 1}}',
    '{"kind": "slew", "target": {"kind": "icrs", "ra_deg": NaN, "dec_deg": 1}}',
    '{"kind": "slew", "target": {"kind": "icrs", "ra_deg": "1", "dec_deg": 1}}',
    '{"kind": "slew", "target": {"kind": "icrs", "ra_deg": 360, "dec_deg": 1}}',
    '{"kind": "slew", "target": {"kind": "icrs", "ra_deg": 1, "dec_deg": 1, "frame": "icrs"}}',
    '{"kind": "slew", "target": {"kind": "altaz", "alt_deg": 91, "az_deg": 1}}',
    '{"kind": "slew", "target": {"kind": "name", "name": "Betelgeu"}}',
    '{"kind": "slew", "target": {"kind": "name", "name": ""}}',
    '{"kind": "park", "target": {"kind": "name", "name": "Vega"}}',
    '{"kind": "guide", "direction": "up", "duration_s": 1}',
    '{"kind": "series", "looks": 2}',
    '{"kind": "model-run", "points": true}',
    '{"kind": "solve", "path": ""}',
    "[]",
    "",
]
BAD_PLACES: list[dict[str, Any]] = [
    {},
    {"ra_deg": 1.0},
    {"target": SOUTH, "ra_deg": 1.0, "dec_deg": 1.0},
    {"target": SOUTH, "frame": "icrs"},
    {"target": None},
    {"ra_deg": None, "dec_deg": None},
]


@pytest.mark.long
async def test_bad_orders_are_told_and_start_nothing(client: httpx.AsyncClient) -> None:
    for body in BAD_ORDERS:
        answer = await client.post(JOBS, content=body, headers={"content-type": "application/json"})
        assert (answer.status_code in {400, 422}, _slug(answer)) == (True, "bad-request"), body
    for place in BAD_PLACES:
        for path in ("slew", "center", "flip"):
            answer = await client.post(f"{EAST}/{path}", json=place)
            assert (answer.status_code, _slug(answer)) == (422, "bad-request"), (path, place)
    assert (await client.get("/v1/jobs")).json() == []


@pytest.mark.long
async def test_a_file_is_solved_only_from_allowed_folders(
    serving: Serve, observatory_toml: str, tmp_path: Any
) -> None:
    allowed = tmp_path / "frames"
    allowed.mkdir()
    (tmp_path / "secret.fits").write_bytes(b"no image")
    (allowed / "link.fits").symlink_to(tmp_path / "secret.fits")
    (allowed / "noise.fits").write_bytes(b"no image either")
    # of a telescope that isn't even there: a file needs no mount
    toml = observatory_toml.replace(
        'id = "gone"', f'id = "gone"\nnight = {{ allowed_folders = ["{allowed}"] }}'
    )
    async with serving(toml) as client:
        for path, slug in (
            (tmp_path / "secret.fits", "bad-request"),
            (allowed / "link.fits", "bad-request"),
            (allowed / ".." / "secret.fits", "bad-request"),
            (allowed / "nothing.fits", "not-found"),
            (allowed / "noise.fits", "bad-frame"),
        ):
            body = {"kind": "solve", "path": str(path)}
            job = (await client.post("/v1/telescopes/gone/jobs", json=body, params={"wait": 60})).json()
            assert job["state"] == "failed", job
            assert job["problem"]["type"].endswith(slug), (path, job["problem"])


@pytest.mark.long
async def test_what_the_service_tells_of_itself(client: httpx.AsyncClient) -> None:
    able = (await client.get("/v1/capabilities")).json()
    assert {one["kind"] for one in able["kinds"]} == set(KINDS)
    schemas = (await client.get("/openapi.json")).json()["components"]["schemas"]
    assert {one["body"] for one in able["kinds"]} <= set(schemas)
    assert {one["kind"] for one in able["kinds"] if one["role"] == "configure"} == {
        "trust",
        "accept-site-time",
    }
    assert [one["id"] for one in able["telescopes"]] == ["east", "gone"]
    assert able["telescopes"][0]["frame"] == "jnow-apparent"
    assert {"http", "alpaca", "indi", "lx200", "stellarium"} <= set(able["faces"])
    assert (await client.get("/v1/health/live")).json()["live"] is True
    ready = await client.get("/v1/health/ready")
    assert ready.status_code == 200
    assert any("gone" in one for one in ready.json()["concerns"])
    health = (await client.get("/v1/health")).json()
    assert (health["ready"], health["why_not"], health["virtual"]) == (True, [], None)
    jupiter, *_ = (await client.get("/v1/objects", params={"q": "jupi"})).json()
    assert (jupiter["name"], jupiter["kind"], jupiter["mag"]) == ("Jupiter", "planet", None)
    assert jupiter["icrs"]["frame"] == "icrs"
    assert -90.0 <= jupiter["altitude_deg"] <= 90.0
    assert (await client.get("/v1/objects", params={"q": "zzzz"})).json() == []
    assert len((await client.get("/v1/objects", params={"count": 5})).json()) == 5


async def test_a_service_without_any_telescope_is_not_ready_and_says_why(
    serving: Serve, observatory_toml: str
) -> None:
    alone = (
        observatory_toml[: observatory_toml.index("[[telescope]]")]
        + (observatory_toml[observatory_toml.rindex("[[telescope]]") :])
    )
    async with serving(alone) as client:
        answer = await client.get("/v1/health/ready")
        assert (answer.status_code, _slug(answer)) == (503, "not-ready")
        assert "gone: not connected" in answer.json()["detail"]
        assert int(answer.headers["retry-after"]) >= 1
        assert (await client.get("/v1/health/live")).status_code == 200
        health = (await client.get("/v1/health")).json()
        assert (health["status"], health["ready"], bool(health["why_not"])) == ("degraded", False, True)
