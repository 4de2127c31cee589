"""The dispatcher: one way for all faces, with its roles, its one job at a time, and what it knows."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest

from api.access.callers import Caller, Face, Role
from api.http.app import create_app
from api.orders import dispatcher
from api.orders.goto_orders import GotoOrders, NotTaken
from api.orders.job import JobState
from api.orders.jobs import TelescopeBusy
from api.orders.targets import AltAzTarget, IcrsTarget, require_place
from api.orders.vocabulary import LookOrder, SlewOrder, SyncToOrder
from api.problems import Refused
from api.service import Service
from mountnav.devices import from_mount
from mountnav.errors import Cancelled, NotFound, OutsideLimits
from mountnav.settings.observatory import Settings
from mountnav.sky.sphere import separation_arcsec

OPERATOR = Caller("tests", Role.OPERATE, Face.REST)
SOUTH = AltAzTarget(alt_deg=50.0, az_deg=170.0)
NORTHEAST = AltAzTarget(alt_deg=40.0, az_deg=60.0)


@asynccontextmanager
async def running(toml: str) -> AsyncIterator[Service]:
    app = create_app(Settings.parse(toml))
    async with app.router.lifespan_context(app):
        yield app.state.service


@pytest.mark.long
async def test_an_order_counts_as_slewing_until_its_end_and_its_end_is_seen(observatory_toml: str) -> None:
    async with running(observatory_toml) as service:
        watch = service.dispatcher.watch("east")
        job = await service.dispatcher.order(OPERATOR, "east", SlewOrder(target=SOUTH))
        assert watch.latest.slewing
        assert watch.latest.job is job
        await asyncio.wait_for(job.ended.wait(), 60)
        assert job.state is JobState.SUCCEEDED
        # what is known then is newer than the slew: nobody has to ask the mount
        latest = watch.latest
        assert not latest.slewing
        assert latest.state.altitude_deg == pytest.approx(50.0, abs=0.3)
        assert latest.state.azimuth_deg == pytest.approx(170.0, abs=0.5)


async def test_one_order_at_a_time_unless_it_supersedes(observatory_toml: str) -> None:
    toml = observatory_toml.replace("slew_rate_deg_s = 45.0", "slew_rate_deg_s = 2.0")
    async with running(toml) as service:
        first = await service.dispatcher.order(OPERATOR, "east", SlewOrder(target=SOUTH))
        with pytest.raises(TelescopeBusy) as busy:
            await service.dispatcher.order(OPERATOR, "east", LookOrder())
        assert busy.value.job_id == first.id
        second = await service.dispatcher.order(OPERATOR, "east", SlewOrder(target=NORTHEAST), supersede=True)
        await asyncio.wait_for(first.ended.wait(), 60)
        assert first.state is JobState.CANCELLED
        assert first.problem is not None
        assert "superseded" in first.problem.detail
        assert service.jobs.running_on("east") is second
        ended = await service.dispatcher.stop(OPERATOR, "east")
        assert ended is second
        assert second.state is JobState.CANCELLED


async def test_a_key_is_known_while_its_job_holds_the_telescope(observatory_toml: str) -> None:
    async with running(observatory_toml) as service:
        order = SlewOrder(target=SOUTH)
        first = await service.dispatcher.order(OPERATOR, "east", order, key="k")
        again = await service.dispatcher.order(OPERATOR, "east", order, key="k", supersede=True)
        assert again is first
        with pytest.raises(Refused):
            await service.dispatcher.order(OPERATOR, "east", SlewOrder(target=NORTHEAST), key="k")


async def test_who_may_only_look_on_orders_nothing(observatory_toml: str) -> None:
    async with running(observatory_toml) as service:
        onlooker = replace(OPERATOR, role=Role.VIEW)
        with pytest.raises(Refused) as refused:
            await service.dispatcher.order(onlooker, "east", LookOrder())
        assert refused.value.problem.status == 403
        with pytest.raises(Refused):
            await service.dispatcher.stop(onlooker, "east")
        assert service.jobs.all() == []
        with pytest.raises(NotFound):
            await service.dispatcher.order(OPERATOR, "nowhere", LookOrder())


async def test_a_check_moves_nothing_and_a_told_sync_is_seen(observatory_toml: str) -> None:
    async with running(observatory_toml) as service:
        dispatcher, watch = service.dispatcher, service.dispatcher.watch("east")
        await asyncio.wait_for(
            (await dispatcher.order(OPERATOR, "east", SlewOrder(target=SOUTH))).ended.wait(), 60
        )
        with pytest.raises(OutsideLimits):
            await dispatcher.check("east", AltAzTarget(alt_deg=-30.0, az_deg=10.0))
        await dispatcher.check("east", NORTHEAST)
        before = watch.latest.state.icrs
        assert before is not None
        told = IcrsTarget(ra_deg=before.ra_deg, dec_deg=before.dec_deg + 0.03)
        job = await dispatcher.order(OPERATOR, "east", SyncToOrder(target=told))
        await asyncio.wait_for(job.ended.wait(), 60)
        assert job.state is JobState.SUCCEEDED
        reading = watch.latest.state.reading
        assert reading is not None
        assert separation_arcsec(from_mount(reading.place), before) == pytest.approx(108.0, abs=25.0)


async def test_a_telescope_that_is_not_there_is_known_to_be_so(observatory_toml: str) -> None:
    async with running(observatory_toml) as service:
        snapshot = await service.dispatcher.watch("gone").refresh()
        assert not snapshot.state.connected
        assert not snapshot.slewing
        assert "there-is-no-such-port" in (snapshot.state.problem or "")


class Held:
    """Holds the look at where a target is, which is done in a thread, until it is let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun, self.go = threading.Event(), threading.Event()

        def later(*given: Any) -> None:
            self.begun.set()
            assert self.go.wait(60)
            require_place(*given)

        monkeypatch.setattr(dispatcher, "require_place", later)

    async def __call__(self) -> None:
        assert await asyncio.to_thread(self.begun.wait, 60)


async def test_what_was_on_its_way_before_a_stop_never_begins_after_it(
    observatory_toml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running(observatory_toml) as service:
        held = Held(monkeypatch)
        orders = service.dispatcher
        ordering = asyncio.create_task(orders.order(OPERATOR, "east", SlewOrder(target=SOUTH), key="a"))
        await held()
        # nothing runs yet that a stop could end
        assert await orders.stop(OPERATOR, "east") is None
        held.go.set()
        with pytest.raises(Cancelled, match="a stop came first"):
            await ordering
        assert service.jobs.all() == []
        # with its key it may be sent again
        job = await orders.order(OPERATOR, "east", SlewOrder(target=SOUTH), key="a")
        await orders.stop(OPERATOR, "east")
        await asyncio.wait_for(job.ended.wait(), 60)
        assert job.state is JobState.CANCELLED


async def test_a_stop_of_any_face_ends_a_goto_that_is_still_looked_at(
    observatory_toml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running(observatory_toml) as service:
        looked, go = asyncio.Event(), asyncio.Event()

        async def check(*given: object, **named: object) -> None:
            looked.set()
            await go.wait()

        monkeypatch.setattr(service.dispatcher, "check", check)
        face = GotoOrders(service.dispatcher, service.audit, "east")
        going = asyncio.create_task(face.goto(OPERATOR, SOUTH))
        await asyncio.wait_for(looked.wait(), 60)
        await service.dispatcher.give_stop(replace(OPERATOR, face=Face.ALPACA), "east")
        go.set()
        with pytest.raises(NotTaken, match="a stop came first"):
            await going
        assert service.jobs.all() == []


async def test_a_stop_of_one_telescope_ends_no_order_of_another(
    observatory_toml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running(observatory_toml) as service:
        held = Held(monkeypatch)
        orders = service.dispatcher
        ordering = asyncio.create_task(orders.order(OPERATOR, "east", SlewOrder(target=SOUTH)))
        await held()
        others = [one.id for one in orders.telescopes if one.id != "east"]
        assert others
        for other in others:
            await orders.give_stop(OPERATOR, other)
        held.go.set()
        job = await ordering
        assert job.problem is None
        await orders.stop(OPERATOR, "east")
