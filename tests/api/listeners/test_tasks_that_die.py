"""A task of a face that dies of a fault ends its connections: no client sees what stands still."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio

from api.access.callers import Caller, Face, Role
from api.alpaca.connection import Client
from api.alpaca.errors import AlpacaError
from api.alpaca.motion import Motion, Pulses
from api.indi_server import connection
from api.indi_server import server as indi_server
from api.indi_server.device import IndiTelescope
from api.indi_server.publisher import Publisher
from api.indi_server.server import IndiServer
from api.orders.goto_orders import GotoOrders
from api.orders.targets import ApparentTarget
from api.orders.vocabulary import GuideOrder, SlewOrder
from api.orders.watching import Watch
from api.planetarium import lx200_server, stellarium_server
from api.planetarium.lx200_server import Lx200Server
from api.planetarium.lx200_session import Lx200Client
from api.planetarium.stellarium_server import StellariumServer
from api.service import Service
from tests.api.indi_server.face_rig import observatory, raw_client, switch, up_now
from tests.waiting import until

pytestmark = pytest.mark.asyncio(loop_scope="module")
CALLER = Caller("a program", Role.OPERATE, Face.ALPACA)


def dies(*_: Any, **__: Any) -> Any:
    raise RuntimeError("a fault of ours")


async def died(*_: Any, **__: Any) -> Any:
    dies()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def service(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Service]:
    async with observatory(tmp_path_factory.mktemp("faces")) as found:
        await found.dispatcher.watch("east").refresh()
        yield found


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def indi(service: Service) -> AsyncIterator[IndiServer]:
    found = IndiServer(service)
    await found.start()
    yield found
    await found.stop()


@pytest.mark.parametrize(
    ("room", "name"),
    [
        (connection.Connection, "_take"),
        (Publisher, "out"),
        (connection.Connection, "_order"),
        (Publisher, "ask"),
    ],
)
async def test_a_task_of_an_indi_connection_ends_it(
    indi: IndiServer, room: type, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with raw_client(indi) as other, raw_client(indi, asking=False) as raw:
        with monkeypatch.context() as patch:
            patch.setattr(room, name, died if name == "_order" else dies)
            await raw.say(b"<getProperties version='1.7'/>", switch("TELESCOPE_TRACK_STATE", "TRACK_ON"))
            await raw.until(lambda: raw.closed, "closed")
        if name != "out":
            await other.asked("TELESCOPE_PARK")


@pytest.mark.parametrize(("room", "name"), [(indi_server, "words_of_event"), (IndiTelescope, "_renew")])
async def test_what_all_indi_clients_are_told_from_ends_them_and_begins_anew(
    service: Service, indi: IndiServer, room: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with raw_client(indi) as raw:
        with monkeypatch.context() as patch:
            patch.setattr(room, name, dies)
            service.events.publish("synced", {"telescope": "east", "outcome": "seen"})
            await raw.until(lambda: raw.closed, "closed")
    async with raw_client(indi) as raw:
        mark = len(raw.heard)
        service.events.publish("synced", {"telescope": "east", "outcome": "seen"})
        await raw.until(lambda: "[INFO] sync: seen" in raw.words(mark), "told")
        # positions are fresh
        await raw.until(lambda: bool(raw.told("HORIZONTAL_COORD", mark)), "renewed")


async def test_a_stop_over_indi_that_hits_a_fault_is_not_told_as_done(
    indi: IndiServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with raw_client(indi) as raw:
        monkeypatch.setattr(GotoOrders, "stop", died)
        mark = len(raw.heard)
        await raw.say(switch("TELESCOPE_ABORT_MOTION", "ABORT"))
        await raw.until(lambda: any("not known" in words for words in raw.words(mark)), "told")
        assert "[INFO] stopped" not in raw.words(mark)


async def closes(address: tuple[str, int], said: bytes) -> None:
    reader, writer = await asyncio.open_connection(*address)
    writer.write(said)
    async with asyncio.timeout(30.0):
        while await reader.read(100):
            pass
    writer.close()


@pytest.mark.parametrize(
    ("room", "name", "said"),
    [
        (lx200_server, "is_http", b":GR#"),
        (Lx200Client, "answer", b":GR#"),
        (Lx200Client, "stop", b":Q#"),
        (GotoOrders, "short", b":Mgn100#"),
        (GotoOrders, "sync", b":Sr05:00:00#:Sd+20*00:00#:CM#"),
    ],
)
async def test_a_task_of_an_lx200_connection_ends_it(
    service: Service, room: Any, name: str, said: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = Lx200Server(service)
    await port.start()
    try:
        monkeypatch.setattr(room, name, dies if name == "is_http" else died)
        await closes(port.address, said)
    finally:
        await port.stop()


@pytest.mark.parametrize("name", ["GotoStream", "_message"])
async def test_a_task_of_a_stellarium_connection_ends_it(
    service: Service, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = StellariumServer(service)
    await port.start()
    try:
        monkeypatch.setattr(stellarium_server, name, dies)
        await closes(port.address, b"\x00")
    finally:
        await port.stop()


async def test_a_watch_that_dies_says_that_nothing_is_known_and_begins_anew(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = service.dispatcher.watch("east")
    seen: list[str | None] = []
    take = Watch._take

    def keep(self: Watch, state: Any) -> None:
        seen.append(state.problem if not state.connected else None)
        take(self, state)

    monkeypatch.setattr(Watch, "_take", keep)
    with monkeypatch.context() as patch:
        # the pause between two looks is what nothing else guards
        patch.setattr("api.orders.watching.real_s", dies)
        watch.wake()
        await until(lambda: any(words and "a fault of ours" in words for words in seen), "told")
    await until(lambda: watch.latest.state.connected, "read again")


async def test_an_alpaca_motion_whose_end_is_lost_has_not_arrived(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = Client("127.0.0.1", 7)
    motion = Motion(service.dispatcher, "east")
    far = up_now(20.0, 30.0)
    order = SlewOrder(target=ApparentTarget(ra_deg=far.ra_deg, dec_deg=far.dec_deg))
    await motion.begin(CALLER, client, order, stops_given=service.dispatcher.stops_given("east"))
    monkeypatch.setattr(Watch, "refresh", died)
    with pytest.raises(AlpacaError, match="how it ended is not known"):
        await motion.ended()
    failure = motion.failed_before(client)
    assert failure is not None
    await motion.close()


async def test_an_alpaca_pulse_whose_end_is_lost_is_a_failure(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    await until(lambda: service.jobs.running_on("east") is None, "idle")
    pulses = Pulses(service.dispatcher, "east")
    monkeypatch.setattr(Pulses, "_end_of", died)
    await pulses.guide(
        CALLER,
        GuideOrder.model_validate({"direction": "n", "duration_s": 0.01}),
        stops_given=service.dispatcher.stops_given("east"),
    )
    await until(lambda: not pulses.running, "over")
    await asyncio.sleep(0)
    assert pulses.failed_before() is not None
