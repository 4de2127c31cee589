"""What a telescope is on, and how well: told with its instant, and not told where it holds no more."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest

from api.http.headline_views import coming_night, night_times, noon_before
from api.http.sky_views import aim_of, has_target
from api.orders.job import Job
from mountnav.clock import utc_now
from mountnav.sky.coordinates import Air, Icrs, Site

SITE = Site(latitude_deg=47.0, longitude_deg=11.0, height_m=0.0)
EAST = "/v1/telescopes/east"


def test_the_night_of_an_instant_is_that_from_noon_to_noon() -> None:
    night = night_times(datetime(2026, 11, 26, 2, tzinfo=UTC), SITE)
    told = [night.sun_sets_utc, night.dark_from_utc, night.dark_until_utc, night.sun_rises_utc]
    known = [one for one in told if one is not None]
    assert len(known) == 4
    assert known == sorted(known)
    assert known[0].date() < known[-1].date() == datetime(2026, 11, 26).date()
    assert night == night_times(datetime(2026, 11, 25, 20, tzinfo=UTC), SITE)
    # an almanac has sunset at 15:32 and sunrise at 06:34 UTC there, to a minute or two
    assert abs(known[0] - datetime(2026, 11, 25, 15, 32, tzinfo=UTC)) < timedelta(minutes=3)
    assert abs(known[-1] - datetime(2026, 11, 26, 6, 34, tzinfo=UTC)) < timedelta(minutes=3)


def test_after_sunrise_the_coming_night_is_told() -> None:
    morning = coming_night(datetime(2026, 11, 26, 9, tzinfo=UTC), SITE)
    assert morning.sun_sets_utc is not None
    assert morning.sun_sets_utc.date() == datetime(2026, 11, 26).date()


@pytest.mark.parametrize("longitude_deg", [-179.0, -75.0, 0.0, 11.0, 149.0, 180.0])
def test_noon_is_at_most_a_day_before(longitude_deg: float) -> None:
    site = Site(latitude_deg=47.0, longitude_deg=longitude_deg, height_m=0.0)
    for hour in range(0, 24, 3):
        utc = datetime(2026, 11, 26, hour, 30, tzinfo=UTC)
        assert timedelta(0) <= utc - noon_before(utc, site) < timedelta(days=1)


def test_where_it_does_not_get_dark_nothing_is_told_of_the_dark() -> None:
    north = Site(latitude_deg=60.0, longitude_deg=25.0, height_m=0.0)
    night = night_times(datetime(2026, 6, 20, 22, tzinfo=UTC), north)
    assert night.dark_from_utc is None
    assert night.dark_until_utc is None
    assert night.sun_sets_utc is not None


async def _told(client: httpx.AsyncClient, path: str) -> dict[str, Any]:
    found: dict[str, Any] = (await client.get(f"{EAST}{path}")).json()
    return found


@pytest.mark.long
async def test_a_centering_is_told_until_the_mount_moves(client: httpx.AsyncClient) -> None:
    before = (await _told(client, "/sky"))["headline"]
    assert (before["target"], before["error_arcsec"], before["fwhm_arcsec"]) == (None, None, None)
    gone = (await client.get("/v1/telescopes/gone/sky")).json()["headline"]
    assert (gone["target"], gone["meridian_s"]) == (None, None)
    here = (await _told(client, ""))["icrs"]
    ordered = {"ra_deg": here["ra_deg"], "dec_deg": here["dec_deg"] - 2.0}
    job = (await client.post(f"{EAST}/center?wait=60", json=ordered)).json()
    assert job["state"] == "succeeded"
    sky = await _told(client, "/sky")
    on = sky["headline"]
    assert on["target_job_id"] == job["id"]
    assert on["arrived"] is True
    assert on["error_arcsec"] == pytest.approx(job["result"]["error_after_arcsec"])
    assert on["error_utc"] == on["fwhm_utc"]
    assert on["fwhm_arcsec"] > 0
    # the meridian is where the hour angle is 0
    assert on["meridian_s"] == pytest.approx(-sky["hour_angle_deg"] * 3600 / 15.0410686, abs=0.5)
    state = await _told(client, "")
    assert state["time_to_meridian_s"] == pytest.approx(on["meridian_s"], abs=10.0)
    # the state says the same of the target, for those who see many telescopes at once
    same = ("arrived", "error_arcsec", "error_utc")
    told = {"name": on["target"], "job_id": on["target_job_id"]} | {name: on[name] for name in same}
    assert (state["on"], state["job_kind"]) == (told, None)

    # the night as a strip: the looks with their widths and zero points, and what was done
    night = await _told(client, "/tonight")
    solved = [one for one in night["looks"] if one["solved"]]
    assert solved[-1]["utc"] == on["error_utc"]
    assert all(one["fwhm_arcsec"] > 0 and one["zero_point_mag"] is not None for one in solved)
    assert {"slew", "centering"} <= {one["kind"] for one in night["acts"]}
    utcs = [one["utc"] for one in night["sky"]]
    assert utcs == sorted(utcs)
    assert night["from_utc"] <= night["utc"] <= night["until_utc"]
    nearest = min(
        night["sky"],
        key=lambda one: abs(datetime.fromisoformat(one["utc"]) - datetime.fromisoformat(night["utc"])),
    )
    assert nearest["target_altitude_deg"] == pytest.approx(sky["altitude_deg"], abs=2.0)
    assert nearest["sun_altitude_deg"] == pytest.approx(sky["sun"]["altitude_deg"], abs=2.0)
    assert 0.0 <= night["moon_lit_percent"] <= 100.0

    # a nudge, and the look's error is of another place
    nudged = await client.post(f"{EAST}/offset?wait=60", json={"east_arcsec": 0.0, "north_arcsec": 300.0})
    assert nudged.json()["state"] == "succeeded"
    moved = (await _told(client, "/sky"))["headline"]
    assert moved["error_arcsec"] is None
    assert (await _told(client, ""))["on"]["error_arcsec"] is None
    assert moved["fwhm_arcsec"] == on["fwhm_arcsec"]  # of the sky, whatever was looked at


def test_the_place_by_which_a_frame_is_solved_is_no_target() -> None:
    here = Icrs(10.0, 20.0)
    place = {"ra_deg": here.ra_deg, "dec_deg": here.dec_deg}
    for kind, wanted in (("solve", None), ("slew", here)):
        job = Job("1", kind, "east", dict(place), utc_now())
        assert has_target(job) is (wanted is not None)
        assert aim_of(job, utc_now(), SITE, Air()) == wanted


def test_nobody_waits_for_an_orbit_to_see_a_state() -> None:
    jupiter = Job("1", "center", "east", {"target": {"kind": "name", "name": "Jupiter"}}, utc_now())
    vega = Job("1", "center", "east", {"target": {"kind": "name", "name": "Vega"}}, utc_now())
    assert has_target(jupiter)
    assert aim_of(jupiter, utc_now(), SITE, Air()) is not None
    assert aim_of(jupiter, utc_now(), SITE, Air(), bodies_too=False) is None
    assert aim_of(vega, utc_now(), SITE, Air(), bodies_too=False) is not None
