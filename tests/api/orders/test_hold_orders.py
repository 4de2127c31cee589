"""The orders hold and dither: a hold on the whole telescope, its views, and a dither as a job within it."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace

import pytest
from pydantic import TypeAdapter, ValidationError

from api.orders.hold_orders import run_dither, run_hold
from api.orders.job_views import result_view
from api.orders.jobs import Jobs, JobState, TelescopeBusy
from api.orders.results import Attempt, DitherView, HoldView
from api.orders.vocabulary import DitherOrder, HoldOrder
from mountnav.client import orders as client_orders
from tests.api.orders.job_work import ended, forever, nothing
from tests.mount.following_rig import FollowingMount
from tests.navigation.virtual_rig import ERRORS, POLICY, VirtualRig, in_virtual_time

QUICK = replace(POLICY, exposure_s=2.0)
ATTEMPT: TypeAdapter[object] = TypeAdapter(Attempt)


@pytest.mark.long
def test_a_hold_tells_each_look_and_keeps_one_a_minute() -> None:
    told: list[tuple[str, dict[str, object]]] = []

    async def work(rig: VirtualRig) -> None:
        await rig.navigator.center(rig.up(-20.0, 30.0))
        order = HoldOrder(for_s=900.0, every_s=15.0, by="rates")
        report = await run_hold(rig.navigator, order, lambda kind, data: told.append((kind, data)), rig.clock)
        assert isinstance(report, HoldView)
        assert report.solved == report.looks == len(told)
        kept = [data for kind, data in told if kind == "attempt"]
        assert 12 <= len(kept) <= 18
        for data in kept:
            json.dumps(data, allow_nan=False)
            ATTEMPT.validate_python(data)
        view = result_view(report.model_dump(mode="json"))
        assert isinstance(view, HoldView)
        # by rates it is known what the mount does by itself
        assert view.known.drift_east_sigma_arcsec_min is not None

    in_virtual_time(work, errors=replace(ERRORS, me_arcsec=900.0), policy=QUICK, made=FollowingMount)


def test_a_dither_brings_where_it_settled() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.center(rig.up(-20.0, 30.0))
        order = DitherOrder(pattern="ring", bound=6.0, steps=4, number=2, settle_within=1.5)
        report = await run_dither(rig.navigator, order, lambda kind, data: None, rig.clock)
        assert isinstance(report, DitherView)
        assert report.number == 2
        assert report.off_arcsec is not None
        assert report.off_arcsec <= 1.5
        assert isinstance(result_view(report.model_dump(mode="json")), DitherView)

    in_virtual_time(work, policy=QUICK)


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        (HoldOrder, {"every_s": 0.0}),
        (HoldOrder, {"for_s": 1e9}),
        (HoldOrder, {"by": "sync"}),
        (HoldOrder, {"period_s": float("nan")}),
        (DitherOrder, {"bound": 601.0}),
        (DitherOrder, {"unit": "deg"}),
        (DitherOrder, {"steps": 1}),
        (DitherOrder, {"settle_looks": 0}),
        (DitherOrder, {"number": -1}),
    ],
)
def test_orders_that_make_no_sense_are_refused(
    kind: type[HoldOrder | DitherOrder], body: dict[str, object]
) -> None:
    with pytest.raises(ValidationError):
        kind.model_validate(body)


def test_the_clients_orders_are_the_services() -> None:
    hold = client_orders.hold(for_s=60.0, every_s=5.0, by="rates", looks="frames", play_arcsec=0.0)
    assert HoldOrder.model_validate(hold).looks == "frames"
    dither = client_orders.dither(pattern="spiral", bound=4.0, unit="px", number=3)
    assert DitherOrder.model_validate(dither).number == 3


async def test_a_job_within_another_leaves_that_the_telescope(jobs: Jobs) -> None:
    hold = jobs.start("hold", "east", {}, forever)
    inner = jobs.start("dither", "east", {}, nothing, within="hold")
    assert jobs.running_on("east") is hold
    assert (await ended(inner)).state is JobState.SUCCEEDED
    assert not hold.is_over
    with pytest.raises(TelescopeBusy):
        jobs.start("look", "east", {}, nothing, within=None)
    with pytest.raises(TelescopeBusy):
        jobs.start("dither", "east", {}, nothing, within="series")
    jobs.cancel(hold)
    await ended(hold)
    # where none is under way it holds the telescope by itself
    alone = jobs.start("dither", "east", {}, forever, within="hold")
    assert jobs.running_on("east") is alone
    jobs.cancel(alone)
    await ended(alone)


async def test_a_job_within_another_ends_with_it(jobs: Jobs) -> None:
    hold = jobs.start("hold", "east", {}, forever)
    running = jobs.start("dither", "east", {}, forever, within="hold")
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    queued = jobs.start("dither", "east", {"number": 2}, forever, within="hold")
    jobs.cancel(hold, "stopped on request")
    for job in (hold, running, queued):
        assert (await ended(job)).state is JobState.CANCELLED
    assert jobs.running_on("east") is None


async def test_a_job_within_another_ends_when_that_ends_by_itself(jobs: Jobs) -> None:
    over = asyncio.Event()
    hold = jobs.start("hold", "east", {}, over.wait)
    inner = jobs.start("dither", "east", {}, forever, within="hold")
    over.set()
    assert (await ended(hold)).state is JobState.SUCCEEDED
    assert (await ended(inner)).state is JobState.CANCELLED
