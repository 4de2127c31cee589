"""Clients of INDI and LX200 that send without end: one order in a turn, none beside a stop, few stops."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass

import pytest
import pytest_asyncio

from api.access.callers import Caller, Face, Role
from api.indi_server.publisher import Publisher
from api.indi_server.server import IndiServer
from api.listeners.tcp import STOPS_AT_ONCE
from api.observatory.observatory import Telescope
from api.planetarium.lx200_server import Lx200Server
from api.planetarium.lx200_session import Lx200Client
from api.service import Service
from tests.api.indi_server.face_rig import observatory, raw_client, switch
from tests.waiting import until

pytestmark = pytest.mark.asyncio(loop_scope="module")
BELOW = b":Sr10:00:00#:Sd-89*00:00#:MS#"
SCHEDULER = Caller("a scheduler", Role.OPERATE, Face.REST)


@dataclass
class Rig:
    service: Service
    lx200: Lx200Server
    indi: IndiServer


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    async with observatory(tmp_path_factory.mktemp("flood")) as service:
        found = Rig(service, Lx200Server(service), IndiServer(service))
        await found.lx200.start()
        await found.indi.start()
        await service.dispatcher.watch("east").refresh()
        try:
            yield found
        finally:
            await found.lx200.stop()
            await found.indi.stop()


class Clock:
    """Counts the loop's turns."""

    def __init__(self) -> None:
        self.turn = 0
        self._ticking = asyncio.create_task(self._tick())

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(0)
            self.turn += 1

    async def turns(self, count: int) -> None:
        """Wait for so many."""
        end = self.turn + count
        while self.turn < end:
            await asyncio.sleep(0)

    def end(self) -> None:
        self._ticking.cancel()


@contextlib.contextmanager
def _noted(monkeypatch: pytest.MonkeyPatch, rig: Rig, clock: Clock) -> Iterator[list[int]]:
    """In which turn each goto is looked at."""
    seen: list[int] = []
    check = rig.service.dispatcher.check

    async def noting(*given: object, **more: object) -> None:
        seen.append(clock.turn)
        await check(*given, **more)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        patched.setattr(rig.service.dispatcher, "check", noting)
        yield seen


async def _lx200(rig: Rig) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    return await asyncio.open_connection(*rig.lx200.address)


async def test_gotos_of_many_lx200_clients_begin_in_turns_of_their_own(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    with _noted(monkeypatch, rig, clock) as seen:
        clients = [await _lx200(rig) for _ in range(4)]
        for _, writer in clients:
            writer.write(BELOW * 5)
        async with asyncio.timeout(60):
            for reader, writer in clients:
                for _ in range(5):
                    await reader.readuntil(b"#")
                writer.close()
    clock.end()
    assert len(seen) == 20
    assert len(set(seen)) == 20, "two gotos in one turn of the loop"


async def test_no_goto_is_looked_at_while_another_faces_stop_is_under_way(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, over = Clock(), asyncio.Event()
    stop = Telescope.stop

    async def long_stop(telescope: Telescope) -> None:
        await over.wait()
        await stop(telescope)

    monkeypatch.setattr(Telescope, "stop", long_stop)
    monkeypatch.setattr("api.orders.dispatcher._HELD_S", 60.0)
    with _noted(monkeypatch, rig, clock) as seen:
        stopping = asyncio.create_task(rig.service.dispatcher.stop(SCHEDULER, "east"))
        await clock.turns(2)
        reader, writer = await _lx200(rig)
        heard: list[bytes] = []
        monkeypatch.setattr(Lx200Client, "_slew", _publisher(heard))
        writer.write(BELOW)
        await until(lambda: bool(heard), "the goto is heard")
        await clock.turns(200)
        assert not seen
        over.set()
        await stopping
        async with asyncio.timeout(60):
            await reader.readuntil(b"#")
        assert len(seen) == 1
        writer.close()
    clock.end()


def _publisher(heard: list[bytes]) -> Callable[..., Awaitable[bytes]]:
    slew = Lx200Client._slew

    async def told(client: Lx200Client) -> bytes:
        heard.append(b"MS")
        return await slew(client)

    return told


async def test_a_stop_that_never_ends_holds_gotos_for_a_while_only(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    over = asyncio.Event()

    async def never(_: Telescope) -> None:
        await over.wait()

    monkeypatch.setattr("api.orders.dispatcher._HELD_S", 0.01)
    with monkeypatch.context() as patched:
        patched.setattr(Telescope, "stop", never)
        stopping = asyncio.create_task(rig.service.dispatcher.stop(SCHEDULER, "east"))
        await asyncio.sleep(0)
        async with asyncio.timeout(60):
            await rig.service.dispatcher.turn()
        assert not stopping.done()
        over.set()
        await stopping


async def test_questions_of_many_indi_clients_are_answered_in_turns_of_their_own(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, seen = Clock(), []
    ask = Publisher.ask

    def noting(telling: Publisher, asked: object) -> None:
        seen.append(clock.turn)
        ask(telling, asked)  # type: ignore[arg-type]

    monkeypatch.setattr(Publisher, "ask", noting)
    async with contextlib.AsyncExitStack() as open_ones:
        clients = [await open_ones.enter_async_context(raw_client(rig.indi, asking=False)) for _ in range(8)]
        for one in clients:
            await one.say(b"<getProperties version='1.7' device='east' name='CONNECTION'/>" * 20)
        await until(lambda: len(seen) == 160, "all answered")
    clock.end()
    assert len(set(seen)) == 160, "two questions in one turn of the loop"


@pytest.mark.parametrize("face", ["lx200", "indi"])
async def test_of_one_clients_stops_few_are_under_way_and_the_last_one_counts(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, face: str
) -> None:
    clock, over = Clock(), asyncio.Event()
    ordering = rig.lx200._ordering if face == "lx200" else rig.indi._devices["east"]._ordering
    under_way = most = ended = 0

    async def counted(_: Caller) -> None:
        nonlocal under_way, most, ended
        under_way += 1
        most = max(most, under_way)
        await over.wait()
        under_way -= 1
        ended += 1

    monkeypatch.setattr(ordering, "stop", counted)
    address = rig.lx200.address if face == "lx200" else rig.indi.address
    stop = b":Q#" if face == "lx200" else switch("TELESCOPE_ABORT_MOTION", "ABORT")
    _, writer = await asyncio.open_connection(*address)
    writer.write(stop * 300)
    writer.write_eof()
    await until(lambda: under_way >= STOPS_AT_ONCE, "the first ones are under way")
    await clock.turns(1000)
    assert most == STOPS_AT_ONCE
    over.set()
    await until(lambda: ended == 300, "all were sent")
    clock.end()
    writer.close()


async def test_a_refused_lx200_sync_is_no_fault_of_ours(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    reader, writer = await _lx200(rig)
    with caplog.at_level(logging.ERROR):
        writer.write(b":Sr10:00:00#:Sd-89*00:00#:CM#")
        async with asyncio.timeout(60):
            assert (await reader.readuntil(b"#")).startswith(b"11Not synced: ")
    assert not caplog.records
    writer.close()
