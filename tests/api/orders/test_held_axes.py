"""Axes that somebody holds and rates with an end: on a fake mount, by the way of every face."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest

from api.access.callers import Caller, Face, Role
from api.leases.lease import OnExpiry
from api.orders.held_axes import BY_THE_MOUNT, RELEASED, SILENT
from api.orders.job import Job, JobState, TelescopeBusy
from api.orders.kept_motions import KeptAxes, KeptRates, ladder, nearest_speed
from api.orders.results import AxesMovedView, RatesView
from api.orders.vocabulary import MoveAxisOrder, OffsetRatesOrder, ParkOrder, TrackingOrder, UnparkOrder
from api.problems import Problem, Refused
from api.service import Service
from mountnav.clock import utc_now
from mountnav.devices import MountAxis, OffsetRates, RateSpan
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import SIDEREAL_DEG_S
from mountnav.sky.sphere import separation_arcsec
from tests.api.indi_server.face_rig import OBSERVATORY, mechanics_of, observatory, up_now

pytestmark = pytest.mark.long

ANNA = Caller("anna", Role.OPERATE, Face.REST, "10.0.0.7")
BERT = Caller("bert", Role.OPERATE, Face.INDI, "10.0.0.8")
VIEWER = Caller("viewer", Role.VIEW, Face.REST, "10.0.0.9")


@pytest.fixture
async def service(tmp_path: Path) -> AsyncIterator[Service]:
    async with observatory(tmp_path, OBSERVATORY) as one:
        telescope = one.observatory.telescope("east")
        await telescope.ready()
        await telescope.navigator.mount.slew(up_now(-20.0, 30.0))
        yield one


def speeds(service: Service) -> tuple[float, ...]:
    """The four of a pad, from slow to fast: this mount knows some speeds, and nothing between them."""
    mount = service.observatory.telescope("east").navigator.mount
    return ladder(mount.axis_rates_deg_s["secondary"], mount.following_policy.most_axis_deg_s)


def move(rate_deg_s: float, for_s: float = 1.0, axis: MountAxis = "secondary") -> MoveAxisOrder:
    return MoveAxisOrder(axis=axis, rate_deg_s=rate_deg_s, for_s=for_s)


async def ordered(service: Service, order: MoveAxisOrder, caller: Caller = ANNA, **options: object) -> Job:
    return await service.dispatcher.order(caller, "east", order, **options)  # type: ignore[arg-type]


async def ended(job: Job) -> AxesMovedView:
    async with asyncio.timeout(60):
        await job.ended.wait()
    assert job.state is JobState.SUCCEEDED, job.problem
    assert isinstance(job.result, AxesMovedView)
    return job.result


async def at_rest(service: Service) -> None:
    """Whether the tube stands still among the stars, by where it truly looks."""
    mechanics = mechanics_of(service)
    mount = service.observatory.telescope("east").navigator.mount
    assert not mount.axis_moving
    before = mechanics.truth()
    await asyncio.sleep(0.3)
    assert separation_arcsec(before, mechanics.truth()) < 5.0


async def test_it_moves_while_it_is_held_and_ends_when_nobody_speaks(service: Service) -> None:
    _, _, find, _ = speeds(service)
    before = mechanics_of(service).truth()
    job = await ordered(service, move(find, 0.6))
    assert service.dispatcher.watch("east").latest.slewing
    (axis,) = (await ended(job)).axes
    assert (axis.axis, axis.rate_deg_s, axis.why) == ("secondary", find, SILENT)
    moved_deg = mechanics_of(service).truth().dec_deg - before.dec_deg
    assert 0.2 * find < moved_deg < 3.0 * find
    await at_rest(service)
    # and it tracks as before
    reading = await service.observatory.telescope("east").navigator.mount.reading()
    assert reading.tracking


async def test_further_orders_go_into_the_same_job_until_it_is_told_to_end(service: Service) -> None:
    _, center, find, _ = speeds(service)
    job = await ordered(service, move(find, 1.0))
    for _ in range(8):
        await asyncio.sleep(0.2)
        assert (await ordered(service, move(find, 1.0))).id == job.id
        assert not job.is_over
    # the other axis with it, and another speed
    assert (await ordered(service, move(-find, 1.0, "primary"))).id == job.id
    assert (await ordered(service, move(center, 1.0))).id == job.id
    assert set(service.dispatcher.held("east").rates()) == {"primary", "secondary"}
    assert (await ordered(service, move(0.0))).id == job.id
    assert (await ordered(service, move(0.0, axis="primary"))).id == job.id
    told = {one.axis: one for one in (await ended(job)).axes}
    assert {one.why for one in told.values()} == {RELEASED}
    assert told["secondary"].moved_s is not None
    assert told["secondary"].moved_s > 1.4
    await at_rest(service)
    assert service.dispatcher.held("east").rates() == {}


async def test_nobody_else_prolongs_it_or_ends_it_but_by_a_stop(service: Service) -> None:
    _, _, find, _ = speeds(service)
    job = await ordered(service, move(find, 5.0))
    for order in (move(find), move(0.0), move(find, axis="primary")):
        with pytest.raises(TelescopeBusy):
            await ordered(service, order, BERT)
    # the same name by another face is another program
    with pytest.raises(TelescopeBusy):
        await ordered(service, move(0.0), replace(ANNA, face=Face.ALPACA))
    with pytest.raises(Refused):
        await ordered(service, move(0.0), VIEWER)
    await service.dispatcher.stop(BERT, "east")
    async with asyncio.timeout(60):
        await job.ended.wait()
    assert job.state is JobState.CANCELLED
    await at_rest(service)


async def test_an_order_that_comes_again_under_its_key_moves_nothing_again(service: Service) -> None:
    _, _, find, _ = speeds(service)
    first = await ordered(service, move(find, 0.5), key="k-1")
    again = await ordered(service, move(find, 0.5), key="k-1")
    assert first.id == again.id
    prolonged = await ordered(service, move(find, 0.5), key="k-2")
    assert prolonged.id == first.id
    await ended(first)
    before = mechanics_of(service).truth()
    # their answers were lost, and they come once more when all is over
    for key in ("k-1", "k-2"):
        assert (await ordered(service, move(find, 0.5), key=key)).id == first.id
    await asyncio.sleep(0.3)
    assert separation_arcsec(before, mechanics_of(service).truth()) < 5.0


async def test_an_order_that_comes_late_moves_nothing(service: Service) -> None:
    """It was held up on its way: the motion that it was for has ended."""
    _, _, find, _ = speeds(service)
    job = await ordered(service, move(find, 0.5))
    mine = move(find, 0.5).model_copy(update={"job_id": job.id})
    assert (await ordered(service, mine)).id == job.id
    await ended(job)
    before = len(service.jobs.all())
    with pytest.raises(BadRequest, match="has ended"):
        await ordered(service, mine)
    with pytest.raises(BadRequest, match="has ended"):
        await ordered(service, move(find).model_copy(update={"job_id": "of no job"}))
    # to end what has ended is fine
    assert (await ordered(service, mine.model_copy(update={"rate_deg_s": 0.0}))).id == job.id
    assert len(service.jobs.all()) == before
    await at_rest(service)


async def test_without_the_lease_nothing_is_moved_on(service: Service) -> None:
    _, _, find, _ = speeds(service)
    job = await ordered(service, move(find, 2.0))
    await service.leases.take(BERT, "east", ttl_s=60.0, on_expiry=OnExpiry.STOP)
    with pytest.raises(Refused) as refused:
        await ordered(service, move(find, 2.0))
    assert refused.value.problem.type.endswith(":leased")
    (axis,) = (await ended(job)).axes
    assert axis.why == SILENT
    await at_rest(service)


async def test_it_ends_before_a_limit_and_doesnt_begin_again_by_itself(service: Service) -> None:
    """Towards the ground, held without an end: the mount ends it, or the next order is refused for it."""
    _, _, _, fast = speeds(service)
    telescope = service.observatory.telescope("east")
    await telescope.navigator.mount.slew(up_now(-20.0, -24.0))
    failures: list[str] = []
    job: Job | None = None
    for _ in range(200):
        try:
            job = await ordered(service, move(-fast, 1.0))
        except TelescopeBusy:  # the mount has ended it, and its job is about to be over
            assert job is not None
            await job.ended.wait()
        await asyncio.sleep(0.1)
        if job.is_over:
            failures.append("" if job.problem is None else job.problem.type)
            if job.problem is not None:
                break
            assert isinstance(job.result, AxesMovedView)
            assert job.result.axes[0].why == BY_THE_MOUNT
    assert failures[-1].endswith(":outside-limits")
    state = await telescope.state()
    assert state.altitude_deg is not None
    assert state.altitude_deg > 14.0
    await at_rest(service)


async def test_a_parked_mount_and_one_that_does_something_else_are_left_alone(service: Service) -> None:
    _, _, find, _ = speeds(service)
    await (await service.dispatcher.order(ANNA, "east", ParkOrder())).ended.wait()
    job = await ordered(service, move(find))
    await job.ended.wait()
    assert job.problem is not None
    assert (job.problem.reasons or [])[0] == "parked"
    await (await service.dispatcher.order(ANNA, "east", UnparkOrder())).ended.wait()


# -- rates -------------------------------------------------------------------------------------------


async def rates(service: Service, ra: float, dec: float, for_s: float = 60.0) -> Job:
    order = OffsetRatesOrder(ra_arcsec_s=ra, dec_arcsec_s=dec, for_s=for_s)
    job = await service.dispatcher.order(ANNA, "east", order)
    async with asyncio.timeout(60):
        await job.ended.wait()
    return job


async def test_rates_are_taken_told_and_end_by_themselves(service: Service) -> None:
    await (await service.dispatcher.order(ANNA, "east", TrackingOrder(on=True))).ended.wait()
    job = await rates(service, 0.0, 20.0, for_s=2.0)
    assert job.problem is None, job.problem
    assert isinstance(job.result, RatesView)
    assert job.result.dec_arcsec_s == pytest.approx(20.0)
    assert job.result.ends_utc is not None
    mount = service.observatory.telescope("east").navigator.mount
    assert mount.offset_rates_in_force is not None
    before = mechanics_of(service).truth()
    async with asyncio.timeout(60):
        while mount.offset_rates_in_force is not None:
            await asyncio.sleep(0.05)
    north_arcsec = 3600.0 * (mechanics_of(service).truth().dec_deg - before.dec_deg)
    assert 10.0 < north_arcsec < 90.0
    await at_rest(service)


async def test_rates_of_a_lease_that_runs_out_end_with_it(service: Service) -> None:
    """Its holder wanted it to track on: as for a star, not at the rates of what it followed."""
    _, secret = await service.leases.take(ANNA, "east", ttl_s=3.0, on_expiry=OnExpiry.KEEP_TRACKING)
    holder = replace(ANNA, lease_id=secret)
    order = OffsetRatesOrder(ra_arcsec_s=0.0, dec_arcsec_s=1.0, for_s=600.0)
    job = await service.dispatcher.order(holder, "east", order)
    await job.ended.wait()
    assert job.problem is None, job.problem
    mount = service.observatory.telescope("east").navigator.mount
    assert mount.offset_rates_in_force is not None
    async with asyncio.timeout(60):
        while service.leases.of("east") is not None:
            await asyncio.sleep(0.05)
    assert mount.offset_rates_in_force is None
    assert (await mount.reading()).tracking


@pytest.mark.parametrize(
    ("spans", "wanted", "found"),
    [
        ((RateSpan(0.0, 4.0),), 0.5, 0.5),
        ((RateSpan(0.0, 4.0),), 9.0, 4.0),
        ((RateSpan(0.5, 0.5), RateSpan(2.0, 2.0)), 1.0, 0.5),
        ((RateSpan(0.5, 0.5), RateSpan(2.0, 2.0)), 1.9, 2.0),
        ((), 1.0, None),
        ((RateSpan(0.0, 0.0),), 1.0, None),
    ],
)
def test_the_nearest_speed_is_one_that_the_axis_has(
    spans: tuple[RateSpan, ...], wanted: float, found: float | None
) -> None:
    assert nearest_speed(spans, wanted) == found


def test_a_pad_has_four_speeds_from_slow_to_fast() -> None:
    speeds = ladder((RateSpan(0.0, 5.0),), 3.0)
    assert speeds == pytest.approx((SIDEREAL_DEG_S, 16 * SIDEREAL_DEG_S, 64 * SIDEREAL_DEG_S, 3.0))
    assert ladder((), 3.0) == ()
    # an axis that knows one speed has it at every step
    assert ladder((RateSpan(0.1, 0.1),), 3.0) == (0.1, 0.1, 0.1, 0.1)


# -- programs that don't repeat themselves --------------------------------------------------------------


class Ends:
    """What a face is told of motions that ended by themselves."""

    def __init__(self) -> None:
        self.told: list[tuple[MountAxis, str, Problem | None]] = []
        self.news = asyncio.Event()

    def __call__(self, axis: MountAxis, why: str, problem: Problem | None) -> None:
        self.told.append((axis, why, problem))
        self.news.set()

    async def first(self) -> tuple[MountAxis, str, Problem | None]:
        async with asyncio.timeout(60):
            await self.news.wait()
        return self.told[0]


async def test_a_motion_is_kept_up_while_its_program_lives(service: Service) -> None:
    slow, _, _, _ = speeds(service)
    ends, dead = Ends(), ""
    kept = KeptAxes(service.dispatcher, "east", most_s=60.0, ended=ends)
    await kept.move(ANNA, "secondary", slow, lambda: dead or None)
    mount = service.observatory.telescope("east").navigator.mount
    for _ in range(15):
        await asyncio.sleep(0.2)
        assert mount.axis_moving
    assert kept.rates_deg_s == {"secondary": slow}
    dead = "its program is gone"
    axis, why, problem = await ends.first()
    assert (axis, why, problem) == ("secondary", "its program is gone", None)
    assert kept.rates_deg_s == {}
    await at_rest(service)


async def test_a_motion_that_is_never_ended_ends_by_its_time(service: Service) -> None:
    slow, _, _, _ = speeds(service)
    ends = Ends()
    kept = KeptAxes(service.dispatcher, "east", most_s=1.0, ended=ends)
    await kept.move(ANNA, "primary", -slow, lambda: None)
    _, why, problem = await ends.first()
    assert why == "it was not renewed within 1 s"
    assert problem is None
    await at_rest(service)


async def test_a_stop_of_anybody_ends_it_for_good(service: Service) -> None:
    slow, _, _, _ = speeds(service)
    ends = Ends()
    kept = KeptAxes(service.dispatcher, "east", most_s=60.0, ended=ends)
    await kept.move(ANNA, "secondary", slow, lambda: None)
    await service.dispatcher.stop(BERT, "east")
    _, _, problem = await ends.first()
    assert problem is not None
    assert problem.type.endswith(":cancelled")
    await asyncio.sleep(1.2)
    assert service.jobs.running_on("east") is None
    await at_rest(service)
    await kept.close()


async def test_released_twice_and_pressed_again(service: Service) -> None:
    slow, _, _, _ = speeds(service)
    kept = KeptAxes(service.dispatcher, "east", most_s=60.0, ended=Ends())
    await kept.end(ANNA, "secondary")
    await kept.move(ANNA, "secondary", slow, lambda: None)
    await kept.end(ANNA, "secondary")
    await kept.end(ANNA, "secondary")
    await at_rest(service)
    await kept.move(ANNA, "secondary", -slow, lambda: None)
    await kept.close()
    await at_rest(service)


async def test_rates_are_put_off_while_their_program_is_heard(service: Service) -> None:
    kept = KeptRates(service.dispatcher, "east", within_s=3.0)
    loop = asyncio.get_running_loop()
    last_s: float | None = None

    def silent_s() -> float:
        return 0.0 if last_s is None else loop.time() - last_s

    await kept.set(ANNA, OffsetRates(0.0, 1.0), silent_s)
    mount = service.observatory.telescope("east").navigator.mount
    first = mount.offset_rates_in_force
    assert first is not None
    await asyncio.sleep(3.5)
    later = mount.offset_rates_in_force
    assert later is not None
    assert later.ends_utc > first.ends_utc
    # it says nothing more: its last word, and not the last look, is what the end is counted from
    last_s, said_utc = loop.time(), utc_now()
    async with asyncio.timeout(60):
        while (force := mount.offset_rates_in_force) is not None:
            assert (force.ends_utc - said_utc).total_seconds() < 4.0  # 4.5, were it the look
            await asyncio.sleep(0.05)
    await kept.close()


async def test_rates_of_a_program_that_has_gone_are_put_off_no_more(service: Service) -> None:
    kept = KeptRates(service.dispatcher, "east", within_s=1.0)
    await kept.set(ANNA, OffsetRates(0.0, 1.0), lambda: None)
    mount = service.observatory.telescope("east").navigator.mount
    first = mount.offset_rates_in_force
    assert first is not None
    async with asyncio.timeout(60):
        while (force := mount.offset_rates_in_force) is not None:
            assert force.ends_utc == first.ends_utc
            await asyncio.sleep(0.05)
    await kept.close()
