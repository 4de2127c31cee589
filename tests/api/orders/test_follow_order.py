"""Following as an order of the service: its bounds, its looks and result; its rates end with its job."""

from __future__ import annotations

from datetime import timedelta

import httpx
import pytest
from pydantic import TypeAdapter, ValidationError

from api.access.callers import Caller, Face, Role
from api.orders.job import Job, JobState
from api.orders.job_views import job_view
from api.orders.results import FollowLookView, FollowView
from api.orders.targets import NamedTarget, RatesTarget
from api.orders.vocabulary import FollowBody, FollowOrder, Order
from mountnav.clock import utc_now
from tests.api.all_faces.attacked_service import OBSERVATORY, Standing, standing, until, up_now

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
    order = FollowOrder(
        target=mover(), look_every_s=5.0, tolerance_arcsec=15.0, **(given or {"duration_s": 600.0})
    )
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


@pytest.mark.long
async def test_a_target_is_followed_to_the_end_and_its_looks_are_kept() -> None:
    async with standing(WIDE) as stand, httpx.AsyncClient(base_url=f"http://127.0.0.1:{stand.port}") as http:
        job = await following(stand, duration_s=120.0)
        await job.ended.wait()
        assert job.state is JobState.SUCCEEDED, job.problem
        view = job_view(job)
        result = view.result
        assert isinstance(result, FollowView)
        assert result.outcome == "time"
        assert result.by == "rates"
        assert result.looks >= 2
        looks = [one for one in view.attempts if isinstance(one, FollowLookView)]
        assert looks
        assert looks[-1].off_arcsec is not None
        assert looks[-1].off_arcsec < 30.0
        assert stand.mechanics.beside_arcsec_s == (0.0, 0.0)
        shown = (await http.get("/v1/telescopes/east")).json()
        assert "rates" in shown["rates_kept"]
        # as it is written down, so it is read again
        again = (await http.get(f"/v1/jobs/{job.id}")).json()
        assert again["result"]["kind"] == "follow"
        assert again["request"]["kind"] == "follow"


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
