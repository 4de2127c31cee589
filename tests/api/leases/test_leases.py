"""Leases: others are refused, a stop never is, a silent holder's policy is done once, also over a restart."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from api.access.audit import Audit
from api.access.callers import Caller, Face, Role
from api.leases.lease import Lease, OnExpiry
from api.leases.leases import Leases
from api.orders.job import Job, JobState
from api.orders.targets import IcrsTarget
from api.orders.vocabulary import Order, ParkOrder, SlewOrder
from api.problems import Refused
from api.service import Service
from mountnav.errors import DeviceSilent, JournalFailed
from mountnav.journal.audit_and_leases import LeaseRow
from mountnav.journal.sql_journal import SqlJournal, open_journal
from tests.api.conftest import Serve
from tests.api.http.stop_answers import stopped

ROBOT = Caller("robot", Role.OPERATE, Face.REST, "10.0.0.7")
GUEST = Caller("guest", Role.OPERATE, Face.ALPACA, "10.0.0.8")
CHIEF = Caller("chief", Role.CONFIGURE, Face.REST, "10.0.0.9")
PATIENCE_S = 60.0


class Orders:
    """A dispatcher that writes down what it is asked for, and may fail."""

    def __init__(self) -> None:
        self.done: list[tuple[str, str]] = []
        self.silent = 0
        self.rates_ended = 0
        self.refuses: Exception | None = None
        self.job = Job("job-1", "park", "east", {}, datetime.now(UTC))

    async def stop(self, caller: Caller, telescope_id: str) -> Job | None:
        self.done.append((caller.name, f"stop {telescope_id}"))
        if self.silent > 0:
            self.silent -= 1
            raise DeviceSilent("no answer", device=telescope_id)
        return None

    async def end_rates(self, caller: Caller, telescope_id: str) -> None:
        self.rates_ended += 1

    async def order(
        self,
        caller: Caller,
        telescope_id: str,
        order: Order,
        *,
        key: str | None = None,
        supersede: bool = False,
    ) -> Job:
        self.done.append((caller.name, f"{order.kind} {telescope_id}"))
        if self.refuses is not None:
            raise self.refuses
        return self.job


class House:
    """Leases with a journal, and all that they tell."""

    def __init__(self, journal: SqlJournal) -> None:
        self.journal = journal
        self.orders = Orders()
        self.told: list[tuple[str, dict[str, object]]] = []
        self.news = asyncio.Event()
        self.leases = self.anew()

    def anew(self) -> Leases:
        """As after a restart of the service."""
        self.leases = Leases(self.journal, self._tell, Audit(self.journal), stop_again_s=0.001)
        return self.leases

    def open(self) -> None:
        self.leases.open(self.orders, self.journal.reader.leases(frozenset({"east", "west"})))

    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.told]

    async def until(self, kind: str) -> dict[str, object]:
        """Wait for an event."""
        async with asyncio.timeout(PATIENCE_S):
            while kind not in self.kinds():
                self.news.clear()
                await self.news.wait()
        return next(data for one, data in self.told if one == kind)

    def _tell(self, kind: str, data: dict[str, object]) -> None:
        self.told.append((kind, data))
        self.news.set()


@pytest.fixture(scope="module")
def blank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A journal that has just been made: making one costs more than a test."""
    path = tmp_path_factory.mktemp("blank") / "journal.sqlite"
    open_journal(path).close()
    return path


@pytest.fixture
def journal(blank: Path, tmp_path: Path) -> Iterator[SqlJournal]:
    """A real one."""
    copied = shutil.copy(blank, tmp_path / "leases.sqlite")
    opened = open_journal(copied, inline=True, fsync="never")
    yield opened
    opened.close()


@pytest.fixture
async def house(journal: SqlJournal) -> AsyncIterator[House]:
    """Open leases, nothing taken."""
    house = House(journal)
    house.open()
    yield house
    await house.leases.close()


def holding(caller: Caller, secret: str) -> Caller:
    """That caller, showing a lease."""
    return replace(caller, lease_id=secret)


def slug_of(refused: pytest.ExceptionInfo[Refused]) -> str:
    """What it was refused for."""
    return refused.value.problem.type.rpartition(":")[2]


async def test_without_a_lease_everybody_may_order(house: House) -> None:
    for caller in (ROBOT, GUEST, CHIEF):
        house.leases.require(caller, "east")


async def test_others_are_refused_and_told_who_holds_it(house: House) -> None:
    lease, secret = await house.leases.take(ROBOT, "east", ttl_s=30.0, note="ten targets")
    assert lease.holder == "robot"
    house.leases.require(holding(ROBOT, secret), "east")
    # the secret is what counts: another program of the holder's may work with another key
    house.leases.require(holding(GUEST, secret), "east")
    for caller, slug in (
        (ROBOT, "leased"),
        (GUEST, "leased"),
        (CHIEF, "leased"),
        (holding(GUEST, secret[:-1]), "lease-lost"),
        (holding(GUEST, ""), "lease-lost"),
    ):
        with pytest.raises(Refused, match="robot holds the telescope") as refused:
            house.leases.require(caller, "east")
        assert slug_of(refused) == slug
        assert refused.value.problem.status == 409
        assert "ten targets" in refused.value.problem.detail
        assert secret not in str(refused.value.problem.model_dump())
    house.leases.require(GUEST, "west")


async def test_a_lease_that_is_over_is_not_shown_in_vain(house: House) -> None:
    _, secret = await house.leases.take(ROBOT, "east", ttl_s=30.0)
    house.leases.release(holding(ROBOT, secret), "east")
    house.leases.require(GUEST, "east")
    for give in (house.leases.require, house.leases.heartbeat, house.leases.release):
        with pytest.raises(Refused) as refused:
            give(holding(ROBOT, secret), "east")
        assert slug_of(refused) == "lease-lost"


async def test_nobody_else_takes_keeps_or_releases_it(house: House) -> None:
    lease, _ = await house.leases.take(ROBOT, "east", ttl_s=30.0)
    until_s = lease.until_s
    with pytest.raises(Refused, match="robot holds"):
        await house.leases.take(GUEST, "east", ttl_s=30.0)
    for act in (house.leases.heartbeat, house.leases.release):
        with pytest.raises(Refused, match="robot holds"):
            act(GUEST, "east")
    assert house.leases.of("east") is lease
    assert lease.until_s == until_s


async def test_force_is_for_those_who_configure_and_ends_the_others_lease(house: House) -> None:
    _, robots = await house.leases.take(ROBOT, "east", ttl_s=30.0)
    for act in (
        house.leases.take(GUEST, "east", ttl_s=30.0, force=True),
        house.leases.take(replace(GUEST, role=Role.VIEW), "west", ttl_s=30.0),
    ):
        with pytest.raises(Refused) as refused:
            await act
        assert slug_of(refused) == "role-too-low"
    with pytest.raises(Refused):
        house.leases.release(GUEST, "east", force=True)
    _, chiefs = await house.leases.take(CHIEF, "east", ttl_s=30.0, force=True)
    house.leases.require(holding(CHIEF, chiefs), "east")
    # whoever was robbed is told so by whatever it does: it is not to wait for its turn and go on
    for give in (house.leases.require, house.leases.heartbeat, house.leases.release):
        with pytest.raises(Refused, match="chief holds the telescope") as refused:
            give(holding(ROBOT, robots), "east")
        assert slug_of(refused) == "lease-lost"
        assert not refused.value.problem.retryable
    assert house.kinds() == ["lease-taken", "lease-broken", "lease-taken"]
    assert house.told[1][1]["by"] == "chief"


async def test_its_holder_may_take_it_anew_with_other_terms(house: House) -> None:
    _, first = await house.leases.take(ROBOT, "east", ttl_s=30.0)
    lease, second = await house.leases.take(
        holding(ROBOT, first), "east", ttl_s=60.0, on_expiry=OnExpiry.PARK
    )
    assert lease.on_expiry is OnExpiry.PARK
    house.leases.require(holding(ROBOT, second), "east")
    with pytest.raises(Refused):
        house.leases.require(holding(ROBOT, first), "east")


async def test_of_many_at_once_one_gets_it(house: House) -> None:
    async def one() -> str | None:
        with suppress(Refused):
            return (await house.leases.take(GUEST, "east", ttl_s=30.0))[1]
        return None

    secrets = [found for found in await asyncio.gather(*(one() for _ in range(20))) if found is not None]
    assert len(secrets) == 1
    house.leases.require(holding(GUEST, secrets[0]), "east")


@pytest.mark.parametrize(
    ("on_expiry", "done"),
    [
        (OnExpiry.STOP, ["stop east"]),
        (OnExpiry.PARK, ["stop east", "park east"]),
        (OnExpiry.KEEP_TRACKING, []),
    ],
)
async def test_a_silent_holders_policy_is_done_once(
    house: House, on_expiry: OnExpiry, done: list[str]
) -> None:
    house.orders.job.state = JobState.SUCCEEDED
    house.orders.job.ended.set()
    await house.leases.take(ROBOT, "east", ttl_s=0.02, on_expiry=on_expiry)
    told = await house.until("lease-policy-done")
    assert (told["telescope"], told["holder"], told["on_expiry"]) == ("east", "robot", str(on_expiry))
    assert house.orders.done == [("lease of robot", one) for one in done]
    # a stop and a park end them by themselves
    assert house.orders.rates_ended == (1 if on_expiry is OnExpiry.KEEP_TRACKING else 0)
    assert house.kinds() == ["lease-taken", "lease-expired", "lease-policy-done"]
    house.leases.require(GUEST, "east")
    assert house.journal.reader.leases(frozenset({"east"})) == []
    [row] = [row for row in house.journal.reader.audits() if row.what == "lease-expired"]
    assert (row.caller, row.face, row.telescope) == ("lease of robot", "service", "east")


async def test_heartbeats_keep_it_for_longer_than_it_lasts(house: House) -> None:
    """Ten heartbeats, each in time: the lease is held for far longer than its ttl from the beginning."""
    lease, secret = await house.leases.take(ROBOT, "east", ttl_s=30.0)
    deadlines = []
    for _ in range(10):
        deadlines.append(house.leases.heartbeat(holding(ROBOT, secret), "east").until_s)
        await asyncio.sleep(0)
    assert deadlines == sorted(deadlines)
    assert deadlines[-1] > deadlines[0]
    [row] = house.journal.reader.leases(frozenset({"east"}))
    assert row.deadline_utc == lease.until_utc
    assert house.kinds() == ["lease-taken"]


async def test_while_its_policy_is_done_nobody_else_may_order(house: House) -> None:
    house.orders.silent = 3
    _, secret = await house.leases.take(ROBOT, "east", ttl_s=0.02, on_expiry=OnExpiry.STOP)
    await house.until("lease-expired")
    for caller, slug in ((GUEST, "leased"), (holding(ROBOT, secret), "lease-lost")):
        with pytest.raises(Refused, match="has run out, and stop is being done") as refused:
            house.leases.require(caller, "east")
        assert slug_of(refused) == slug
    with pytest.raises(Refused) as late:
        house.leases.heartbeat(holding(ROBOT, secret), "east")
    assert slug_of(late) == "lease-lost"
    await house.until("lease-policy-done")
    # the stop was sent until it arrived
    assert house.orders.done == [("lease of robot", "stop east")] * 4
    house.leases.require(GUEST, "east")


async def test_a_stop_that_never_arrives_is_told_and_written_down(house: House) -> None:
    house.orders.silent = 10_000
    await house.leases.take(ROBOT, "east", ttl_s=0.02, on_expiry=OnExpiry.PARK)
    told = await house.until("lease-policy-failed")
    assert "no answer" in str(told["why"])
    assert len(house.orders.done) == 12
    assert "park east" not in [what for _, what in house.orders.done]
    failed = [row.outcome for row in house.journal.reader.audits()]
    assert failed == ["lease-policy-failed", "taken"]


@pytest.mark.parametrize("by", ["refusal", "end"])
async def test_a_park_that_fails_is_told(house: House, by: str) -> None:
    if by == "refusal":
        house.orders.refuses = JournalFailed("it can't be written")
    house.orders.job.state = JobState.FAILED
    house.orders.job.ended.set()
    await house.leases.take(ROBOT, "east", ttl_s=0.02, on_expiry=OnExpiry.PARK)
    told = await house.until("lease-policy-failed")
    assert ("can't be written" if by == "refusal" else "parking ended failed") in str(told["why"])


async def test_a_chief_may_take_it_while_the_policy_is_in_trouble(house: House) -> None:
    house.orders.silent = 10_000
    house.leases = Leases(house.journal, house._tell, Audit(house.journal), stop_again_s=3600.0)
    house.open()
    await house.leases.take(ROBOT, "east", ttl_s=0.02)
    await house.until("lease-expired")
    _, secret = await house.leases.take(CHIEF, "east", ttl_s=30.0, force=True)
    house.leases.require(holding(CHIEF, secret), "east")
    # the old holder's stop is not sent into the new holder's work
    assert len(house.orders.done) <= 1


async def test_a_lease_outlives_a_restart(house: House) -> None:
    _, secret = await house.leases.take(ROBOT, "east", ttl_s=30.0, on_expiry=OnExpiry.PARK, note="night")
    await house.leases.close()
    house.anew()
    house.open()
    house.leases.require(holding(ROBOT, secret), "east")
    with pytest.raises(Refused, match="robot holds the telescope"):
        house.leases.require(GUEST, "east")
    again = house.leases.heartbeat(holding(ROBOT, secret), "east")
    assert (again.holder, again.on_expiry, again.note) == ("robot", OnExpiry.PARK, "night")
    assert house.orders.done == []


async def test_a_deadline_that_passed_while_down_is_acted_on_at_start_once(house: House) -> None:
    await house.leases.take(ROBOT, "east", ttl_s=0.02, on_expiry=OnExpiry.STOP)
    await house.leases.close()
    await asyncio.sleep(0.05)
    assert house.orders.done == []
    house.anew()
    house.open()
    with pytest.raises(Refused, match="has run out"):
        house.leases.require(GUEST, "east")
    await house.until("lease-policy-done")
    assert house.orders.done == [("lease of robot", "stop east")]
    await house.leases.close()
    house.anew()
    house.open()
    await asyncio.sleep(0)
    house.leases.require(GUEST, "east")
    assert len(house.orders.done) == 1


async def test_a_clock_set_back_makes_no_lease_longer_than_agreed(house: House) -> None:
    now = datetime.now(UTC)
    far = LeaseRow(
        "east", "robot", "operate", "rest", "", "ab" * 32, "", 30.0, "stop", now, now + timedelta(days=1)
    )
    await house.journal.save_lease(far)
    house.anew()
    house.open()
    lease = house.leases.of("east")
    assert isinstance(lease, Lease)
    assert lease.until_s - asyncio.get_running_loop().time() <= 30.0


async def test_what_cant_be_written_down_is_not_taken(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    async def fails(row: LeaseRow) -> None:
        raise JournalFailed("no space left")

    monkeypatch.setattr(house.journal, "save_lease", fails)
    with pytest.raises(JournalFailed):
        await house.leases.take(ROBOT, "east", ttl_s=30.0)
    house.leases.require(GUEST, "east")
    assert house.kinds() == []


# -- the whole service, over HTTP ------------------------------------------------------------------------


@pytest.fixture
async def client(serving: Serve, observatory_toml: str) -> AsyncIterator[httpx.AsyncClient]:
    """Talk to the observatory."""
    async with serving(observatory_toml) as opened:
        yield opened


def service_of(client: httpx.AsyncClient) -> Service:
    """The service behind a client."""
    transport = client._transport
    assert isinstance(transport, httpx.ASGITransport)
    app = transport.app
    assert isinstance(app, FastAPI)
    service: Service = app.state.service
    return service


LEASE = "/v1/telescopes/east/lease"


@pytest.mark.long
async def test_over_http_and_over_a_restart(serving: Serve, observatory_toml: str) -> None:
    async with serving(observatory_toml) as client:
        await _taken_kept_refused_and_released(client)
        secret = (await client.post(LEASE, json={"ttl_s": 600.0})).json()["lease"]
    async with serving(observatory_toml) as client:
        assert (await client.get(LEASE)).json()["held"] is True
        assert (await client.post("/v1/telescopes/east/look")).status_code == 409
        mine = {"Mountnav-Lease": secret}
        assert (await client.put(LEASE, headers=mine)).status_code == 200
        assert (await client.delete(LEASE, headers=mine)).status_code == 200


async def _taken_kept_refused_and_released(client: httpx.AsyncClient) -> None:
    for nonsense in (
        {"ttl_s": 4.9},
        {"ttl_s": 3601.0},
        {"ttl_s": "20"},
        {"ttl_s": 20.0, "on_expiry": "explode"},
        {"ttl_s": 20.0, "x": 1},
        {},
    ):
        assert (await client.post(LEASE, json=nonsense)).status_code == 422
    free = (await client.get(LEASE)).json()
    assert (free["held"], free["holder"]) == (False, None)
    taken = await client.post(LEASE, json={"ttl_s": 20.0, "on_expiry": "park", "note": "survey"})
    assert taken.status_code == 201
    secret = taken.json()["lease"]
    shown = await client.get(LEASE)
    assert secret not in shown.text
    assert (shown.json()["holder"], shown.json()["note"]) == ("this machine", "survey")
    assert 0.0 < shown.json()["seconds_left"] <= 20.0
    for path in ("slew", "park", "home", "look", "night/start", "night/resume"):
        body = {"ra_deg": 10.0, "dec_deg": 60.0} if path == "slew" else None
        refused = await client.post(f"/v1/telescopes/east/{path}", json=body)
        assert (path, refused.status_code) == (path, 409)
        assert refused.json()["type"] == "urn:mountnav:problem:leased"
        assert refused.json()["retryable"] is True
    mine = {"Mountnav-Lease": secret}
    assert (await client.post("/v1/telescopes/east/look", headers=mine)).status_code == 202
    assert (await client.put(LEASE)).status_code == 409
    assert (await client.put(LEASE, headers=mine)).status_code == 200
    # a stop is taken from anybody who may operate
    assert (await stopped(client, "/v1/telescopes/east/stop")).status_code == 200
    assert (await client.delete(LEASE)).status_code == 409
    assert (await client.delete(LEASE, headers=mine)).json()["held"] is False
    lost = await client.post("/v1/telescopes/east/look", headers=mine)
    assert (lost.status_code, lost.json()["type"]) == (409, "urn:mountnav:problem:lease-lost")
    rows: list[dict[str, str]] = []
    async with asyncio.timeout(PATIENCE_S):
        # they are written behind the orders, which wait for none
        while not rows or rows[0]["outcome"] != "lease-lost":
            rows = (await client.get("/v1/audit")).json()["rows"]
    assert secret not in str(rows)
    told = [(row["what"], row["outcome"]) for row in reversed(rows)]
    assert ("lease-taken", "taken") in told
    assert ("slew", "leased") in told
    assert ("stop", "taken") in told
    assert told[-2:] == [("lease-released", "taken"), ("look", "lease-lost")]
    # heartbeats are no orders
    assert not [what for what, outcome in told if what.startswith("PUT ") and outcome == "answered"]


async def _within(condition: Callable[[], Awaitable[bool]]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not await condition():
            await asyncio.sleep(0.01)


@pytest.mark.long
async def test_when_the_holder_dies_its_slew_is_stopped(client: httpx.AsyncClient) -> None:
    """A real slew of the fake mount, ended by the silence of who ordered it."""
    service = service_of(client)
    lease, secret = await service.leases.take(ROBOT, "east", ttl_s=1.0, on_expiry=OnExpiry.STOP)
    slewing = SlewOrder(target=IcrsTarget(kind="icrs", ra_deg=10.0, dec_deg=85.0))
    centering = await service.dispatcher.order(holding(ROBOT, secret), "east", slewing)
    with pytest.raises(Refused):
        await service.dispatcher.order(GUEST, "east", ParkOrder())

    async def expired() -> bool:
        return service.leases.of("east") is None

    await _within(expired)
    assert lease.ending
    async with asyncio.timeout(PATIENCE_S):
        await centering.ended.wait()
    snapshot = await service.dispatcher.watch("east").refresh()
    assert not snapshot.slewing
    rows: list[dict[str, str]] = []
    async with asyncio.timeout(PATIENCE_S):
        while len(rows) < 2:
            rows = (await client.get("/v1/audit", params={"caller": "lease of robot"})).json()["rows"]
    assert {(row["what"], row["outcome"]) for row in rows} == {("lease-expired", "taken"), ("stop", "taken")}
