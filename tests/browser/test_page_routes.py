"""What the page draws from: limits, sky, offsets and the last frame, asked of a real service."""

from __future__ import annotations

import io
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image

from api.http.frame_views import pixel_of
from api.observatory.last_frame import LARGEST_PX, preview_of
from mountnav.clock import utc_now
from mountnav.sky.chain import icrs_to_apparent, icrs_to_observed, sidereal_time_deg
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import offset_arcsec, separation_arcsec
from mountnav.sky.wcs import icrs_at_pixel
from tests.browser.watched_service import Served


@pytest.fixture
def ask(observatory: Served) -> Any:
    with httpx.Client(base_url=f"{observatory.url}/v1/telescopes", timeout=60) as client:
        yield client


@pytest.mark.long
def test_the_limits_are_those_of_the_settings(ask: httpx.Client) -> None:
    told = ask.get("/east/limits").json()
    assert [one["altitude_deg"] for one in told["horizon"]] == [10, 22, 8, 30]
    assert (told["min_altitude_deg"], told["mounting"], told["latitude_deg"]) == (15, "fork", 47)
    assert told["tolerance_arcsec"] == 30
    assert ask.get("/nobody/limits").status_code == 404


def test_the_sky_is_where_the_chain_says(ask: httpx.Client, observatory: Served) -> None:
    told = ask.get("/east/sky").json()
    settings = observatory.app.state.settings
    now = utc_now()
    assert told["sidereal_deg"] == pytest.approx(sidereal_time_deg(now, settings.site.site), abs=0.05)
    here = Icrs(told["icrs"]["ra_deg"], told["icrs"]["dec_deg"])
    of_date = icrs_to_apparent(here, now)
    assert told["of_date"]["dec_deg"] == pytest.approx(of_date.dec_deg, abs=1e-5)
    # the track is the place's own way over the sky, whatever way it was reckoned
    for point in told["track"]:
        then = now.fromisoformat(point["utc"])
        seen = icrs_to_observed(here, then, settings.site.site, settings.air.air)
        assert point["altitude_deg"] == pytest.approx(seen.alt_deg, abs=0.05)
    if told["ahead"] is not None:
        assert told["ahead"]["after_s"] >= 0
    assert told["track"]
    assert told["way"] == []


def test_a_place_that_is_asked_for_is_told_with_its_limit(ask: httpx.Client, observatory: Served) -> None:
    high, low = observatory.place_at(60.0, 180.0), observatory.place_at(5.0, 0.0)
    answers = [
        ask.get("/east/sky", params={"ra_deg": one.ra_deg, "dec_deg": one.dec_deg}).json()["asked"]
        for one in (high, low)
    ]
    assert [one["allowed"] for one in answers] == [True, False]
    assert answers[0]["altitude_deg"] == pytest.approx(60.0, abs=0.1)
    assert "altitude" in answers[1]["why"] or "horizon" in answers[1]["why"]
    assert ask.get("/east/sky", params={"ra_deg": "NaN", "dec_deg": 1}).status_code == 422
    assert ask.get("/east/sky", params={"ra_deg": 10}).json()["asked"] is None


@pytest.mark.long
def test_the_last_frame_and_its_offsets(ask: httpx.Client, observatory: Served) -> None:
    assert ask.get("/slow/last-frame").status_code == 204
    assert ask.get("/slow/last-frame.webp").status_code == 404
    job = ask.post("/east/look", json={}).json()
    done = httpx.get(f"{observatory.url}/v1/jobs/{job['id']}?wait=60", timeout=90).json()
    assert done["state"] == "succeeded", done["problem"]
    frame = ask.get("/east/last-frame").json()
    assert (frame["solved"], frame["width_px"], frame["job_id"]) == (True, 1200, job["id"])
    assert frame["measured"] >= len(frame["stars"]) > 0
    assert len(frame["stars"]) <= len(frame["measured_px"]) <= min(frame["measured"], 1000)
    seen = Icrs(frame["center"]["ra_deg"], frame["center"]["dec_deg"])
    told = done["result"]["seen"]
    assert separation_arcsec(seen, Icrs(told["ra_deg"], told["dec_deg"])) < 0.5
    first = ask.get("/east/last-frame.webp")
    assert first.headers["content-type"] == "image/webp"
    assert Image.open(io.BytesIO(first.content)).size == (1200, 900)
    again = ask.get("/east/last-frame.webp", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    offsets = ask.get("/east/offsets").json()["looks"]
    assert offsets[-1]["look_id"] == done["result"]["look_id"]
    assert offsets[-1]["east_arcsec"] == pytest.approx(done["result"]["offset"]["east_arcsec"], abs=3.0)


@pytest.mark.long
def test_a_preview_shows_stars_and_sky_and_is_never_large() -> None:
    noise = np.random.default_rng(5).normal(1000.0, 10.0, (2100, 3100))
    noise[300:306, 100:106] += 4000.0
    noise[0, :50] = np.nan
    found = preview_of(noise.astype(np.float32))
    picture = np.asarray(Image.open(io.BytesIO(found.content)).convert("L"), dtype=float)
    assert (found.width_px, found.height_px, found.binned) == (1033, 700, 3)
    assert picture.shape == (700, 1033)
    assert max(found.width_px, found.height_px) <= LARGEST_PX
    assert 5 < np.median(picture) < 90
    # rows run down: what stands low in the file stands low in the picture
    assert picture[700 - 101, 34] > np.median(picture) + 80
    flat = preview_of(np.full((30, 40), 7, dtype=np.uint16))
    assert Image.open(io.BytesIO(flat.content)).size == (40, 30)
    empty = preview_of(np.full((3, 4), np.nan, dtype=np.float32))
    assert Image.open(io.BytesIO(empty.content)).size == (4, 3)


@pytest.mark.parametrize("away_deg", [0.0, 0.3, 3.0, 20.0])
def test_the_pixel_of_a_place_is_where_the_wcs_has_it(away_deg: float) -> None:
    cards = {
        "CTYPE1": "RA---TAN",
        "CTYPE2": "DEC--TAN",
        "CRPIX1": 600.5,
        "CRPIX2": 450.5,
        "CRVAL1": 80.0,
        "CRVAL2": 60.0,
        "CD1_1": -1e-3,
        "CD1_2": 2e-4,
        "CD2_1": 2e-4,
        "CD2_2": 1e-3,
    }
    place = Icrs(80.0 + away_deg, 60.0 - 0.5 * away_deg)
    x_px, y_px = pixel_of(cards, place, 1200, 900)
    back = icrs_at_pixel(cards, x_px, y_px)
    assert offset_arcsec(back, place).total_arcsec < 0.1
