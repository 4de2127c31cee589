"""Aiming over HTTP: points, angles, mosaics and searches; real service, fake mount, drawn frames."""

from __future__ import annotations

import asyncio

import httpx
import pytest
from pydantic import TypeAdapter, ValidationError

from api.access.callers import Role
from api.orders.vocabulary import MosaicOrder, Order, role_for
from tests.api.conftest import Serve

EAST = "/v1/telescopes/east"
AIMED = """
exposure_s = 0.5
[[telescope.point]]
name = "slit"
x_px = 900.0
y_px = 300.0
width_px = 1200
height_px = 900
turned_deg = 20.0
[telescope.rotator]
url = "simulated://"
least_deg = -180.0
most_deg = 180.0
sense = 1
"""


@pytest.fixture
def aimed_toml(observatory_toml: str) -> str:
    return observatory_toml.replace("exposure_s = 0.5\n", "exposure_s = 0.5\n", 1).replace(
        "[telescope.centering]\nsettle_s = 0.0\n",
        "[telescope.centering]\nsettle_s = 0.0\n" + AIMED.replace("\nexposure_s = 0.5\n", "\n"),
        1,
    )


async def ended(client: httpx.AsyncClient, answer: httpx.Response) -> dict[str, object]:
    assert answer.status_code == 202, answer.text
    job: dict[str, object] = (await client.get(answer.headers["location"], params={"wait": 120})).json()
    assert job["finished_utc"], job
    return job


async def place_near(client: httpx.AsyncClient, off_deg: float = -2.0) -> dict[str, float]:
    state = (await client.get(EAST)).json()
    return {"ra_deg": state["icrs"]["ra_deg"], "dec_deg": state["icrs"]["dec_deg"] + off_deg}


@pytest.mark.long
async def test_a_target_is_brought_to_a_slit_along_an_angle(serving: Serve, aimed_toml: str) -> None:
    async with serving(aimed_toml) as client:
        place = await place_near(client)
        order = place | {"at": "slit", "position_angle_deg": 60.0}
        job = await ended(client, await client.post(f"{EAST}/center", json=order))
        assert job["state"] == "succeeded", job["problem"]
        result = job["result"]
        assert isinstance(result, dict)
        assert result["at"]["name"] == "slit"
        assert (result["at"]["x_px"], result["at"]["y_px"]) == (900.0, 300.0)
        assert result["at"]["position_angle_deg"] == pytest.approx(60.0, abs=0.6)
        assert result["rotation"]["sense"] == 1
        assert result["rotation"]["turns"]
        # 300 px to the right, 150 px down, of 4″
        assert result["at"]["from_middle_arcsec"] == pytest.approx(1340.0, abs=10.0)
        look = await ended(client, await client.post(f"{EAST}/look", json={"at": {"x_px": 0.0, "y_px": 0.0}}))
        shown = look["result"]
        assert isinstance(shown, dict)
        assert shown["at"]["from_middle_arcsec"] == pytest.approx(
            4.0 * (599.5**2 + 449.5**2) ** 0.5, rel=0.01
        )
        rows = (await client.get("/v1/journal", params={"kind": "note"})).text
        assert "rotator-turn" in rows


@pytest.mark.long
async def test_the_field_is_turned_where_it_stands(serving: Serve, aimed_toml: str) -> None:
    async with serving(aimed_toml) as client:
        job = await ended(
            client, await client.post(f"{EAST}/rotate", json={"position_angle_deg": 90.0, "either_way": True})
        )
        assert job["state"] == "succeeded", job["problem"]
        result = job["result"]
        assert isinstance(result, dict)
        assert abs(result["off_deg"]) <= 0.5
        assert (await client.post(f"{EAST}/rotate", json={})).status_code == 422
        unknown = await ended(client, await client.post(f"{EAST}/look", json={"at": "slot"}))
        assert unknown["problem"]["type"].endswith("bad-request")  # type: ignore[index]
        assert "slit" in str(unknown["problem"])


@pytest.mark.long
async def test_a_mosaic_goes_on_when_the_camera_says_so(client: httpx.AsyncClient) -> None:
    place = await place_near(client)
    order = place | {"across": 2, "down": 1, "frames": 2, "width_deg": 1.3, "height_deg": 1.0}
    answer = await client.post(f"{EAST}/mosaic", json=order)
    assert answer.status_code == 202, answer.text
    where = answer.headers["location"]
    early = await client.post(f"{where}/next")
    assert early.status_code in (400, 422), early.text
    for number in (1, 2):
        async with asyncio.timeout(120.0):
            while True:
                job = (await client.get(where)).json()
                panels = [one for one in job["attempts"] if one["kind"] == "panel"]
                if panels and (panels[-1]["number"], panels[-1]["end"]) == (number, "centered"):
                    break
                assert job["finished_utc"] is None, job
                await asyncio.sleep(0.1)
        assert (await client.post(f"{where}/next")).json() == {"left": 1}
        assert (await client.post(f"{where}/next")).json() == {"left": 0}
    job = (await client.get(where, params={"wait": 60})).json()
    assert job["state"] == "succeeded", job["problem"]
    assert [one["end"] for one in job["result"]["panels"]] == ["done", "done"]
    assert job["result"]["missing"] == []
    late = await client.post(f"{where}/next")
    assert late.status_code in (400, 422)
    assert "is over" in late.text


@pytest.mark.long
async def test_a_search_that_sees_at_once_centers(client: httpx.AsyncClient) -> None:
    job = await ended(client, await client.post(f"{EAST}/spiral-search", json=await place_near(client)))
    assert job["state"] == "succeeded", job["problem"]
    result = job["result"]
    assert isinstance(result, dict)
    assert result["looks"] == 1
    assert result["centered"]["outcome"] == "centered"


ORDER: TypeAdapter[Order] = TypeAdapter(Order)
TARGET = {"kind": "icrs", "ra_deg": 10.0, "dec_deg": 10.0}


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "mosaic", "target": TARGET},
        {"kind": "mosaic", "target": TARGET, "across": 2},
        {"kind": "mosaic", "target": TARGET, "across": 2, "down": 2, "offsets_arcsec": [[0.0, 0.0]]},
        {"kind": "mosaic", "target": TARGET, "across": 2, "down": 2, "until": "dwell"},
        {"kind": "mosaic", "target": TARGET, "across": 2, "down": 2, "dwell_s": 5.0},
        {"kind": "mosaic", "target": TARGET, "across": 2, "down": 2, "width_deg": 1.0},
        {"kind": "mosaic", "target": TARGET, "offsets_arcsec": [[0.0, 0.0]] * 401},
        {"kind": "mosaic", "target": TARGET, "offsets_arcsec": [[0.0]]},
        {"kind": "mosaic", "target": TARGET, "offsets_arcsec": [["0", 0.0]]},
        {"kind": "mosaic", "target": TARGET, "offsets_arcsec": [[float("nan"), 0.0]]},
        {"kind": "center", "target": TARGET, "either_way": True},
        {"kind": "center", "target": TARGET, "position_angle_deg": 360.0},
        {"kind": "center", "target": TARGET, "at": {"x_px": 1.0}},
        {"kind": "center", "target": TARGET, "at": {"x_px": float("nan"), "y_px": 1.0}},
        {"kind": "center", "target": TARGET, "at": ""},
        {"kind": "rotate"},
        {"kind": "spiral-search", "target": TARGET, "radius_deg": 100.0},
    ],
)
def test_orders_that_make_no_sense_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        ORDER.validate_python(wrong)


def test_a_pattern_comes_as_lists_as_json_has_them() -> None:
    given = {"kind": "mosaic", "target": TARGET, "offsets_arcsec": [[0.0, 0], [600, -300.5]]}
    made = ORDER.validate_python(given)
    assert isinstance(made, MosaicOrder)
    assert made.offsets_arcsec == [(0.0, 0.0), (600.0, -300.5)]


def test_to_say_that_the_cables_are_right_needs_more() -> None:
    made = ORDER.validate_python({"kind": "rotate", "position_angle_deg": 1.0, "trust_count": True})
    assert role_for(made) is Role.CONFIGURE
    plain = ORDER.validate_python({"kind": "rotate", "position_angle_deg": 1.0})
    assert role_for(plain) is Role.OPERATE
    grid = ORDER.validate_python({"kind": "mosaic", "target": TARGET, "across": 2, "down": 2})
    assert isinstance(grid, MosaicOrder)
