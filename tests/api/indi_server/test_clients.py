"""What programs of all kinds do to the INDI server: one-shot scripts, odd stops, thousands of questions."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from api.indi_server.server import IndiServer
from api.service import Service
from drivers.indi.codec import messages
from drivers.indi.codec.messages import State
from mountnav.clock import utc_now
from mountnav.sky.coordinates import Apparent
from tests.api.indi_server.face_rig import (
    apart_arcsec,
    coordinates,
    indi_observatory,
    mechanics_of,
    raw_client,
    switch,
    up_now,
)
from tests.waiting import until

pytestmark = pytest.mark.asyncio(loop_scope="module")
EOD, ABORT = "EQUATORIAL_EOD_COORD", "TELESCOPE_ABORT_MOTION"
STOP = switch(ABORT, "ABORT")
Rig = tuple[Service, IndiServer]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    async with indi_observatory(tmp_path_factory.mktemp("clients")) as rig:
        yield rig


def beside(service: Service, north_deg: float) -> Apparent:
    here = mechanics_of(service).reported(utc_now())
    return Apparent(here.ra_deg, here.dec_deg + north_deg, utc_now())


async def test_a_script_may_choose_in_one_connection_and_send_the_place_in_the_next(rig: Rig) -> None:
    """As `indi_setprop` for ON_COORD_SET, then for the coordinates: a sync that was meant is no goto."""
    service, server = rig
    async with raw_client(server) as chooses:
        await chooses.say(switch("ON_COORD_SET", "SYNC"))
        await chooses.until(lambda: chooses.now("ON_COORD_SET").values["SYNC"] is True, "chosen")
        async with raw_client(server) as other:
            # while it is here its choice is its own
            assert other.now("ON_COORD_SET").values["TRACK"] is True
    aside, jobs = beside(service, 0.1), len(service.jobs.all())
    async with raw_client(server) as sends:
        await sends.until(lambda: sends.now("ON_COORD_SET").values["SYNC"] is True, "shown")
        mark = len(sends.heard)
        await sends.say(coordinates(aside))
        await sends.until(lambda: "[INFO] synced" in sends.words(mark), "synced")
        assert sends.now("ON_COORD_SET").values["TRACK"] is True
    async with raw_client(server) as last:
        assert last.now("ON_COORD_SET").values["TRACK"] is True
    assert [one.kind for one in service.jobs.all()][: len(service.jobs.all()) - jobs] == ["sync-to"]
    assert apart_arcsec(mechanics_of(service).reported(utc_now()), aside) < 5.0


async def test_a_stop_is_taken_from_a_client_that_has_disconnected(rig: Rig) -> None:
    service, server = rig
    async with raw_client(server) as raw:
        mark = len(raw.heard)
        await raw.say(coordinates(up_now(60.0, 30.0)))
        await raw.until(lambda: State.BUSY in raw.states(EOD, mark), "busy")
        job = service.jobs.all()[0]
        await raw.say(switch("CONNECTION", "DISCONNECT"))
        await raw.until(lambda: raw.now("CONNECTION").values["DISCONNECT"] is True, "disconnected")
        assert not job.is_over
        await raw.say(STOP)
        await raw.until(lambda: "[INFO] stopped" in raw.words(mark), "told")
        await asyncio.wait_for(job.ended.wait(), 60.0)
        assert job.state == "cancelled"
    await until(lambda: not mechanics_of(service).slewing(), "at rest")


async def test_a_stop_that_can_not_be_carried_out_says_so(rig: Rig) -> None:
    _, server = rig
    async with raw_client(server) as raw:
        await raw.say(messages.get_properties("gone"))
        mistaken = (
            (switch(ABORT, "ABORT", "nobody"), "there is no device nobody"),
            (switch(ABORT, "ABORT", "gone"), "could not be sent"),
            (switch(ABORT, "STOP"), "one switch: ABORT"),
            (messages.new_texts("east", ABORT, {"ABORT": "On"}), "one switch: ABORT"),
        )
        for message, words in mistaken:
            mark = len(raw.heard)
            await raw.say(message)
            await raw.until(lambda m=mark, w=words: any(w in one for one in raw.words(m)), words)  # type: ignore[misc]
            assert all(one.startswith("[ERROR]") for one in raw.words(mark) if words in one)


@pytest.mark.long
async def test_thousands_of_questions_are_answered_to_a_client_that_reads(rig: Rig) -> None:
    _, server = rig
    reader, writer = await asyncio.open_connection(*server.address)
    ask, site = messages.get_properties("east"), messages.get_properties("east", "GEOGRAPHIC_COORD")
    writer.write(ask * 110 + site * 1000 + b"<pingRequest uid='1'/>" * 500 + b"<pingRequest uid='last'/>")
    heard = b""
    async with asyncio.timeout(60.0):
        while b"pingReply uid='last'" not in heard[-70_000:].replace(b'"', b"'"):
            data = await reader.read(65_536)
            assert data, heard[-300:]
            heard += data
    writer.close()
    assert heard.count(b'<defNumberVector device="east" name="GEOGRAPHIC_COORD"') == 1110
    assert heard.count(b"<pingReply") == 501


async def test_a_server_that_chains_all_devices_asks_for_a_star(rig: Rig) -> None:
    async with raw_client(rig[1], asking=False) as raw:
        await raw.say(b"<getProperties device='*' version='1.7'/>")
        await raw.until(lambda: bool(raw.told("DRIVER_INFO", device="gone")), "told of all")
        assert raw.told(EOD)
