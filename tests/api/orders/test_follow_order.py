"""Following as an order of the service: its bounds, its looks and result; its rates end with its job."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import httpx
import pytest
from pydantic import TypeAdapter, ValidationError

from api.access.callers import Caller, Face, Role
from api.orders.job import Job, JobState
from api.orders.job_views import job_view, result_view
from api.orders.results import FollowLookView, FollowView
from api.orders.targets import NamedTarget, RatesTarget
from api.orders.vocabulary import FollowBody, FollowOrder, Order
from mountnav.clock import utc_now
from mountnav.ephemeris import SkyRatesTarget
from mountnav.navigation.follow_report import FollowReport
from tests.api.all_faces.attacked_service import OBSERVATORY, Standing, standing, up_now
from tests.navigation.rated_mount import RatedMount
from tests.navigation.virtual_rig import VirtualRig, in_virtual_time
from tests.waiting import until

pytestmark = pytest.mark.long

BOSS = Caller("tests", Role.CONFIGURE, Face.REST)
ORDERS: TypeAdapter[Order] = TypeAdapter(Order)
WIDE = OBSERVATORY.replace("width_px = 400", "width_px = 1200").replace("height_px = 300", "height_px = 900")
"""Wherever the sky stands now, there are stars enough in a frame."""
MOON = {"kind": "name", "name": "Moon"}


def mover(ra: float = 2.0, dec: float = 1.0, *, ha_deg: float = -20.0) -> RatesTarget:
    place, now = up_now(ha_deg, 20.0), utc_now()
    return RatesTarget(
        ra_deg=place.ra_deg,
        dec_deg=place.dec_deg,
        ra_arcsec_s=ra,
        dec_arcsec_s=dec,
        begins_utc=(now - timedelta(minutes=1)).isoformat(),
        ends_utc=(now + timedelta(hours=1)).isoformat(),
        name="a mover",
    )


async def following(stand: Standing, **given: float) -> Job:
    """A job that follows, with rates in the mount."""
    wanted: dict[str, Any] = {
        "look_every_s": 5.0,
        "tolerance_arcsec": 15.0,
        **(given or {"duration_s": 600.0}),
    }
    order = FollowOrder(target=mover(), **wanted)
    job = await stand.service.dispatcher.order(BOSS, "east", order)
    await until(lambda: job.is_over or stand.mechanics.beside_arcsec_s != (0.0, 0.0), "rates in the mount")
    assert not job.is_over, job.problem
    return job


@pytest.mark.parametrize(
    "body",
    [
        {"target": MOON},
        {"target": MOON, "duration_s": 60.0, "until_utc": "2030-01-01T00:00:00Z"},
        {"target": MOON, "duration_s": 0.0},
        {"target": MOON, "duration_s": 1e9},
        {"target": MOON, "duration_s": float("nan")},
        {"target": MOON, "until_utc": "tomorrow"},
        {"target": MOON, "until_utc": "2030-01-01T00:00:00"},
        {"target": MOON, "duration_s": 60.0, "look_every_s": 0.1},
        {"target": MOON, "duration_s": 60.0, "tolerance_arcsec": -1.0},
        {"target": MOON, "duration_s": 60.0, "rates": 3},
        {"duration_s": 60.0},
    ],
)
def test_what_makes_no_order_is_refused(body: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        ORDERS.validate_python({"kind": "follow", **body})


def test_the_short_body_makes_the_same_order() -> None:
    body = FollowBody(target=NamedTarget(name="Moon"), duration_s=60.0, tolerance_arcsec=5.0)
    assert body.order(FollowOrder) == FollowOrder(
        target=NamedTarget(name="Moon"), duration_s=60.0, tolerance_arcsec=5.0
    )


def test_how_it_ended_is_shown_and_read_again_as_it_was_written() -> None:
    told: list[dict[str, object]] = []

    async def work(rig: VirtualRig) -> FollowReport:
        begins = rig.clock.utc()
        target = SkyRatesTarget(rig.up(-30.0, 30.0), 1.0, 0.5, begins, begins + timedelta(hours=1), "a mover")
        report = await rig.navigator.follow(target, until_utc=begins + timedelta(minutes=8))
        told.extend(facts for kind, facts in rig.events if kind == "attempt" and "kind" in facts)
        return report

    report = in_virtual_time(work, made=RatedMount)
    job = Job("job-1", "follow", "east", {"kind": "follow"}, utc_now(), result=report)
    job.attempts.extend(told)
    view = job_view(job)
    assert isinstance(view.result, FollowView)
    assert view.result.outcome == "time"
    assert view.result.by == "rates"
    assert view.result.looks == report.looks >= 4
    looks = [one for one in view.attempts if isinstance(one, FollowLookView)]
    assert len(looks) == report.looks
    assert looks[-1].verdict == "right"
    assert looks[-1].seen_dec_arcsec_s == pytest.approx(0.5, abs=0.05)
    again = result_view(view.result.model_dump(mode="json"), epoch=None, utc=None)
    assert again == view.result


@pytest.mark.long
async def test_looks_are_told_while_a_target_is_followed() -> None:
    async with standing(WIDE) as stand, httpx.AsyncClient(base_url=f"http://127.0.0.1:{stand.port}") as http:
        job = await following(stand)
        await until(
            lambda: job.is_over or sum("mid_exposure_utc" in one for one in job.attempts) >= 2, "two looks"
        )
        assert not job.is_over, job.problem
        shown = (await http.get(f"/v1/jobs/{job.id}")).json()
        looks = [one for one in shown["attempts"] if one["kind"] == "follow-look"]
        assert looks[0]["off_arcsec"] < 60.0
        assert looks[0]["by"] == "rates"
        assert "rates" in (await http.get("/v1/telescopes/east")).json()["rates_kept"]


@pytest.mark.long
@pytest.mark.parametrize("how", ["cancel", "stop", "park"])
async def test_rates_end_with_their_job(how: str) -> None:
    async with standing(WIDE) as stand, httpx.AsyncClient(base_url=f"http://127.0.0.1:{stand.port}") as http:
        job = await following(stand)
        match how:
            case "cancel":
                assert (await http.delete(f"/v1/jobs/{job.id}")).status_code == 200
            case "stop":
                assert (await http.post("/v1/telescopes/east/stop")).status_code in (200, 202)
            case "park":
                answer = await http.post(
                    "/v1/telescopes/east/park", headers={"Prefer": "wait=0"}, params={"supersede": "true"}
                )
                assert answer.status_code in (200, 202), answer.text
        await job.ended.wait()
        assert job.state is JobState.CANCELLED
        await until(lambda: stand.mechanics.beside_arcsec_s == (0.0, 0.0), "rates ended")
        await stand.idle()
        assert stand.service.observatory.telescope("east").navigator.mount.offset_rates_in_force is None


@pytest.mark.long
async def test_a_target_too_fast_for_the_mount_is_refused_with_the_numbers() -> None:
    async with standing(WIDE) as stand:
        mark = stand.mark()
        job = await stand.service.dispatcher.order(
            BOSS, "east", FollowOrder(target=mover(-3_000.0, 0.0), duration_s=15.0)
        )
        await job.ended.wait()
        assert job.state is JobState.FAILED
        assert job.problem is not None
        assert "too fast" in job.problem.detail
        assert stand.gotos(mark) == 0
