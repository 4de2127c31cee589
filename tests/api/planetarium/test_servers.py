"""LX200 over TCP and Stellarium's protocol against a running service with a fake mount."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass

import pytest
import pytest_asyncio

from api.planetarium.lx200_server import Lx200Server
from api.planetarium.stellarium_codec import Goto
from api.planetarium.stellarium_server import StellariumServer
from api.service import Service
from drivers.generic.mount import GenericMount
from drivers.lx200.codec.angles import dec_from_text, dec_to_text, ra_from_text, ra_to_text
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import SlewOutcome, SyncOutcome
from mountnav.errors import BadSettings, DeviceRefused, Refusal
from mountnav.settings.faces import Lx200ServerSettings, StellariumSettings
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import separation_arcsec
from tests.api.indi_server.face_rig import SITE, apart_arcsec, mechanics_of, observatory, up_now
from tests.api.planetarium.stellarium_client import goto_message, read_position

pytestmark = pytest.mark.asyncio(loop_scope="module")


@dataclass
class Rig:
    service: Service
    lx200: Lx200Server
    stellarium: StellariumServer

    def reported(self) -> Apparent:
        found = mechanics_of(self.service).reported(utc_now())
        assert isinstance(found, Apparent)
        return found

    def beside(self, north_deg: float) -> Apparent:
        here = self.reported()
        return Apparent(here.ra_deg, here.dec_deg + north_deg, utc_now())


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    async with observatory(tmp_path_factory.mktemp("planetarium")) as service:
        found = Rig(service, Lx200Server(service), StellariumServer(service))
        await found.lx200.start()
        await found.stellarium.start()
        await service.dispatcher.watch("east").refresh()
        try:
            yield found
        finally:
            await found.lx200.stop()
            await found.stellarium.stop()


class App:
    """A program on one connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def ask(self, command: bytes, like: str) -> bytes:
        """Send, and read an answer of a form."""
        self.writer.write(command)
        got = b""
        async with asyncio.timeout(60.0):
            while re.fullmatch(like, got.decode("latin-1")) is None:
                more = await self.reader.read(1)
                assert more, f"closed after {got!r}"
                got += more
        return got

    async def tell(self, command: bytes) -> None:
        """Send what has no answer; the next answer is another command's."""
        self.writer.write(command)
        assert await self.ask(b"\x06", "P") == b"P"

    async def set_target(self, place: Apparent) -> None:
        assert await self.ask(b":Sr" + ra_to_text(place.ra_deg, decimals=1) + b"#", "[01]") == b"1"
        assert await self.ask(b":Sd" + dec_to_text(place.dec_deg) + b"#", "[01]") == b"1"

    async def close(self) -> None:
        self.writer.close()
        await self.writer.wait_closed()


async def app(rig: Rig) -> App:
    return App(*await asyncio.open_connection(*rig.lx200.address))


async def at_rest(rig: Rig) -> None:
    job = rig.service.jobs.running_on("east")
    if job is not None:
        await asyncio.wait_for(job.ended.wait(), 60.0)


RA, DEC = r"\d\d:\d\d:\d\d#", r"[+-]\d\d\*\d\d:\d\d#"


async def test_an_app_reads_the_place_of_date_in_its_format(rig: Rig) -> None:
    one, other = await app(rig), await app(rig)
    ra = ra_from_text((await one.ask(b":GR#", RA))[:-1])
    dec = dec_from_text((await one.ask(b":GD#", DEC))[:-1])
    assert apart_arcsec(Apparent(ra.deg, dec.deg, utc_now()), rig.reported()) < 15.0
    # the format is each connection's own
    await one.tell(b":U#")
    assert re.fullmatch(rb"\d\d:\d\d\.\d#", await one.ask(b":GR#", r".*#"))
    assert re.fullmatch(rb"[+-]\d\d\*\d\d#", await one.ask(b":GD#", r".*#"))
    assert re.fullmatch(RA.encode(), await other.ask(b":GR#", r".*#"))
    await one.tell(b":U#")
    assert re.fullmatch(RA.encode(), await one.ask(b":GR#", r".*#"))
    for each in (one, other):
        await each.close()


async def test_questions_have_the_answers_of_the_protocol(rig: Rig) -> None:
    one = await app(rig)
    forms = {
        b":GVP#": "mountnav#",
        b":GVN#": r"[\d.]+.*#",
        b":GA#": r"[+-]\d\d\*\d\d'\d\d#",
        b":GZ#": r"\d{3}\*\d\d'\d\d#",
        b":GS#": r"\d\d:\d\d:\d\d#",
        b":GL#": r"\d\d:\d\d:\d\d#",
        b":GC#": r"\d\d/\d\d/\d\d#",
        b":GG#": r"[+-]\d\d(\.\d)?#",
        b":Gc#": "24#",
        b":Gt#": r"\+47\*00#",
        b":Gg#": r"349\*00#",
        b":GW#": "PT1#",
        b":D#": "#",
        b":P#": "LOW  PRECISION",
        b"#:GR#": RA,
    }
    for question, form in forms.items():
        await one.ask(question, form)
    # what nobody knows, and keys that are let go, have no answer and move nothing
    before = rig.reported()
    for command in (b":RS#", b":Qn#", b":Qe#", b":ED#", b"Ka", b":GX99#", b":RG#"):
        await one.tell(command)
    assert apart_arcsec(rig.reported(), before) < 2.0
    await one.close()


async def test_site_and_time_are_compared_and_never_taken(rig: Rig) -> None:
    one = await app(rig)
    now = utc_now()
    assert await one.ask(b":St+47*00#", "[01]") == b"1"
    assert await one.ask(b":St+48*00#", "[01]") == b"0"
    assert await one.ask(b":Sg349*00#", "[01]") == b"1"
    assert await one.ask(b":Sg011*00#", "[01]") == b"0"
    assert await one.ask(b":SG+00#", "[01]") == b"1"
    assert await one.ask(now.strftime(":SL%H:%M:%S#").encode(), "[01]") == b"1"
    assert await one.ask(b":SL%02d:00:00#" % ((now.hour + 5) % 24), "[01]") == b"0"
    said = await one.ask(now.strftime(":SC%m/%d/%y#").encode(), "0|1[^#]*#[^#]*#")
    assert said.startswith(b"1Updating")
    assert await one.ask(b":SC01/01/20#", "0|1[^#]*#[^#]*#") == b"0"
    assert await one.ask(b":GG#", ".*#") == b"+00#"
    assert await one.ask(b":Szzz#", "[01]") == b"0"
    assert await one.ask(b":Gt#", ".*#") == b"+47*00#"
    await one.close()


@pytest.mark.long
async def test_a_goto_moves_and_says_when_it_has_arrived(rig: Rig) -> None:
    one, there = await app(rig), rig.beside(-0.4)
    await one.set_target(there)
    assert await one.ask(b":MS#", "0|[1-9].*#") == b"0"
    assert await one.ask(b":D#", ".*#") == b"\x7f#"
    await at_rest(rig)
    await rig.service.dispatcher.watch("east").refresh()
    assert await one.ask(b":D#", ".*#") == b"#"
    assert apart_arcsec(rig.reported(), there) < 10.0
    assert rig.service.jobs.all()[0].kind == "slew"
    await one.close()


async def test_each_command_may_come_on_a_connection_of_its_own(rig: Rig) -> None:
    there = rig.beside(0.3)
    commands = (
        (b":Sr" + ra_to_text(there.ra_deg) + b"#", "[01]"),
        (b":Sd" + dec_to_text(there.dec_deg).replace(b"*", b"\xdf") + b"#", "[01]"),
        (b":MS#", "0|[1-9].*#"),
    )
    for command, form in commands:
        one = await app(rig)
        assert await one.ask(command, form) in (b"1", b"0")
        await one.close()
    await at_rest(rig)
    assert apart_arcsec(rig.reported(), there) < 20.0


async def test_refusals_have_their_digit_and_words(rig: Rig) -> None:
    one, before = await app(rig), rig.reported()
    await one.set_target(up_now(-100.0, -20.0))
    answer = await one.ask(b":MS#", "0|[1-9].*#")
    assert answer[:1] == b"1"
    assert b"altitude" in answer
    assert await one.ask(b":Sr25:00:00#", "[01]") == b"0"
    assert await one.ask(b":Sd+95*00#", "[01]") == b"0"
    # told far from where it believes: not synced
    await one.set_target(Apparent(before.ra_deg, before.dec_deg - 10.0, utc_now()))
    assert (await one.ask(b":CM#", ".*#")).startswith(b"Not synced")
    assert apart_arcsec(rig.reported(), before) < 5.0
    await one.close()


async def test_a_sync_is_answered_when_it_was_read_back(rig: Rig) -> None:
    one, aside = await app(rig), rig.beside(0.1)
    await one.set_target(aside)
    assert await one.ask(b":CM#", ".*#") == b"Coordinates     matched.        #"
    assert apart_arcsec(rig.reported(), aside) < 10.0
    assert rig.service.jobs.all()[0].kind == "sync-to"
    await one.close()


async def test_a_stop_comes_first(rig: Rig) -> None:
    one, far = await app(rig), up_now(60.0, 30.0)
    await one.set_target(far)
    assert await one.ask(b":MS#", "0|[1-9].*#") == b"0"
    job = rig.service.jobs.all()[0]
    await one.tell(b":Q#")
    await asyncio.wait_for(job.ended.wait(), 60.0)
    assert job.state == "cancelled"
    jobs = len(rig.service.jobs.all())
    # in one write: the goto before the stop is dropped, and says so
    answer = await one.ask(b":GR#:GR#:GR#:MS#:Q#", f"({RA}){{3}}(0|[1-9].*#)")
    assert answer.endswith(b"2A stop came first#") or rig.service.jobs.all()[0].is_over
    assert len(rig.service.jobs.all()) == jobs or rig.service.jobs.all()[0].state == "cancelled"
    await at_rest(rig)
    assert apart_arcsec(rig.reported(), far) > 3600.0
    await one.close()


@pytest.mark.long
@pytest.mark.parametrize("stop", [b":Q#", b":Qn#", b":Qw#", b":Sr12:34:5:Q#", b":G:Qe#"])
async def test_a_stop_is_heard_behind_a_command_that_was_cut_off_and_one_way_too(
    rig: Rig, stop: bytes
) -> None:
    """``:Qn#`` "also stops the telescope if a slew to an object is in progress" [Meade LX200 manual]."""
    one = await app(rig)
    await one.set_target(up_now(60.0, 30.0) if rig.reported().dec_deg > 35.0 else up_now(-40.0, 60.0))
    assert await one.ask(b":MS#", "0|[1-9].*#") == b"0"
    job = rig.service.jobs.all()[0]
    assert not job.is_over
    rows = await _stops(rig)
    one.writer.write(stop)
    await asyncio.wait_for(job.ended.wait(), 60.0)
    assert job.state == "cancelled"
    await _true(lambda: _more_stops(rig, rows))
    # the half that was cut off is refused in its turn
    assert await one.ask(b"\x06", "0?P") == (b"0P" if stop.startswith(b":S") else b"P")
    await one.close()


async def test_a_stop_one_way_disturbs_nothing_where_nothing_slews(rig: Rig) -> None:
    """Apps send it when a button is let go, guiders after each pulse: a series must not end by it."""
    one = await app(rig)
    await at_rest(rig)
    await rig.service.dispatcher.watch("east").refresh()
    rows = await _stops(rig)
    await one.tell(b":Qn#:Qs#:Qe#:Qw#")
    assert await _stops(rig) == rows
    await one.tell(b":Q#")
    await _true(lambda: _more_stops(rig, rows))
    await one.close()


async def _stops(rig: Rig) -> int:
    rows = await asyncio.to_thread(rig.service.journal.reader.audits, telescope="east", limit=200)
    return sum(row.what == "stop" for row in rows)


async def _more_stops(rig: Rig, than: int) -> bool:
    return await _stops(rig) > than


async def test_a_target_whose_half_was_refused_is_none(rig: Rig) -> None:
    one, jobs = await app(rig), len(rig.service.jobs.all())
    await one.set_target(rig.beside(0.2))
    assert await one.ask(b":Sr16:00:00#:Sd+95*00:00#:MS#", "10(0|[1-9].*#)") == b"102No target was set#"
    assert (await one.ask(b":CM#", ".*#")) == b"Not synced: no target was set#"
    assert len(rig.service.jobs.all()) == jobs
    await one.close()


@pytest.mark.parametrize("pieces", [(7,), (2, 5), ()])
async def test_a_web_page_can_not_order_through_its_browser(rig: Rig, pieces: tuple[int, ...]) -> None:
    """A form of any page may post plain text to this machine's ports; other noise is skipped."""
    there, jobs = rig.beside(0.2), len(rig.service.jobs.all())
    body = b":Sr" + ra_to_text(there.ra_deg) + b"#:Sd" + dec_to_text(there.dec_deg) + b"#:MS#"
    wire = b"POST / HTTP/1.1\r\nHost: 127.0.0.1:4030\r\nContent-Type: text/plain\r\n\r\n" + body
    one, at = await app(rig), 0
    for piece in (*pieces, len(wire)):
        one.writer.write(wire[at : at + piece])
        await one.writer.drain()
        at += piece
    assert await asyncio.wait_for(one.reader.read(), 60.0) == b""
    assert len(rig.service.jobs.all()) == jobs
    await one.close()


async def test_a_pulse_that_is_too_long_is_not_taken_and_the_app_stays(rig: Rig) -> None:
    one, jobs = await app(rig), len(rig.service.jobs.all())
    await one.tell(b":Mgn60001#:Mge99999#")
    assert len(rig.service.jobs.all()) == jobs
    await one.close()


@pytest.mark.long
async def test_our_own_driver_drives_it(rig: Rig) -> None:
    host, port = rig.lx200.address
    mount = open_mount(f"lx200+tcp://{host}:{port}?poll_s=0.1", site=SITE)
    assert isinstance(mount, GenericMount)
    await mount.open()
    try:
        assert mount.report is not None
        assert "mountnav" in mount.report.identity
        assert mount.report.site_off_arcsec is not None
        assert mount.report.site_off_arcsec < 60.0
        assert mount.report.clock_off_s == pytest.approx(0.0, abs=3.0)
        there = rig.beside(-0.3)
        assert await mount.slew(there) is SlewOutcome.ARRIVED
        assert apart_arcsec(rig.reported(), there) < 20.0
        aside = rig.beside(0.2)
        assert (await mount.sync(aside)).outcome is SyncOutcome.SEEN
        assert apart_arcsec(rig.reported(), aside) < 20.0
        with pytest.raises(DeviceRefused) as caught:
            await mount.slew(up_now(-100.0, -20.0))
        assert caught.value.reason is Refusal.BELOW_HORIZON
        await mount.stop()
    finally:
        await mount.close()


async def test_stellarium_sees_the_position_and_orders_a_goto(rig: Rig) -> None:
    reader, writer = await asyncio.open_connection(*rig.stellarium.address)
    async with asyncio.timeout(60.0):
        first = read_position(await reader.readexactly(24))
        assert first.status == 0
        # J2000 on the wire, whatever the mount speaks
        assert separation_arcsec(first.place, apparent_to_icrs(rig.reported())) < 5.0
        there = apparent_to_icrs(rig.beside(-0.3))
        writer.write(goto_message(Goto(there, 0)))
        while separation_arcsec(read_position(await reader.readexactly(24)).place, there) > 5.0:
            pass
    assert rig.service.jobs.all()[0].kind == "slew"
    await at_rest(rig)
    # below the horizon: it has no answer, and nothing moves
    jobs = len(rig.service.jobs.all())
    low = apparent_to_icrs(up_now(-100.0, -20.0))
    writer.write(goto_message(Goto(low, 0)))
    await _refused(rig, "stellarium")
    assert len(rig.service.jobs.all()) == jobs
    # what is no goto ends the connection
    writer.write(b"GET / HTTP/1.1\r\n\r\n")
    async with asyncio.timeout(60.0):
        while await reader.read(4096):
            pass
    writer.close()


async def test_a_goto_by_stellarium_is_ordered_though_its_client_is_gone(rig: Rig) -> None:
    await at_rest(rig)
    there, jobs = apparent_to_icrs(rig.beside(-0.2)), len(rig.service.jobs.all())
    server = StellariumServer(rig.service, StellariumSettings(port=0))
    await server.start()
    try:
        # another order is being taken: the goto waits its turn, and its client doesn't
        async with server._ordering._turn:
            reader, writer = await asyncio.open_connection(*server.address)
            await reader.readexactly(24)
            writer.write(goto_message(Goto(there, 0)))
            await _true(_is(lambda: bool(server._gotos)))
            writer.transport.abort()
            await _true(_is(lambda: not len(server._listening._here)))
        await _true(_is(lambda: len(rig.service.jobs.all()) > jobs))
        await at_rest(rig)
        assert separation_arcsec(apparent_to_icrs(rig.reported()), there) < 10.0
    finally:
        await server.stop()


def _is(check: Callable[[], bool]) -> Callable[[], Awaitable[bool]]:
    async def checked() -> bool:
        return check()

    return checked


async def _refused(rig: Rig, face: str) -> None:
    async def noted() -> bool:
        rows = await asyncio.to_thread(rig.service.journal.reader.audits, telescope="east", limit=3)
        return any(row.outcome == "outside-limits" and row.face == face for row in rows)

    await _true(noted)


async def _true(check: Callable[[], Awaitable[bool]]) -> None:
    async with asyncio.timeout(60.0):
        while not await check():
            await asyncio.sleep(0.05)


async def test_a_mount_that_is_lost_has_no_position(rig: Rig) -> None:
    """The settings' other telescope has no port: nobody is told a place that isn't known."""
    service = rig.service
    lost = Lx200Server(service, Lx200ServerSettings(port=0, telescope="gone"))
    blind = StellariumServer(service, StellariumSettings(port=0, telescope="gone"))
    for server, question in ((lost, b":GR#"), (blind, b"")):
        await server.start()
        reader, writer = await asyncio.open_connection(*server.address)
        writer.write(question)
        assert await asyncio.wait_for(reader.read(100), 60.0) == b""
        writer.close()
        await server.stop()
    with pytest.raises(BadSettings, match="there is: east, gone"):
        Lx200Server(service, Lx200ServerSettings(port=0, telescope="nobody"))


async def test_a_taken_port_is_told(rig: Rig) -> None:
    _, port = rig.lx200.address
    with pytest.raises(BadSettings, match="another program"):
        await Lx200Server(rig.service, Lx200ServerSettings(port=port)).start()


async def test_a_door_that_is_read_only_tells_the_place_and_moves_and_stops_nothing(rig: Rig) -> None:
    await at_rest(rig)
    shown = Rig(
        rig.service,
        Lx200Server(rig.service, Lx200ServerSettings(port=0, read_only=True)),
        StellariumServer(rig.service, StellariumSettings(port=0, read_only=True)),
    )
    await shown.lx200.start()
    await shown.stellarium.start()
    try:
        before, jobs = rig.reported(), len(rig.service.jobs.all())
        one = await app(shown)
        assert re.fullmatch(RA.encode(), await one.ask(b":GR#", RA))
        await one.set_target(rig.beside(north_deg=-2.0))
        assert b"has the role view" in await one.ask(b":MS#", r"[12].*#")
        assert (await one.ask(b":CM#", r".*#")).startswith(b"Not synced: ")
        for quiet in (b":hP#", b":PO#", b":Mn#", b":Qn#", b":Mgn0500#"):
            await one.tell(quiet)
        reader, writer = await asyncio.open_connection(*shown.stellarium.address)
        read_position(await reader.readexactly(24))
        writer.write(goto_message(Goto(apparent_to_icrs(rig.beside(north_deg=-3.0)), 0)))
        read_position(await reader.readexactly(24))
        # a slew that another door has begun is not stopped by it either
        operator = await app(rig)
        await operator.set_target(rig.beside(north_deg=-4.0))
        assert await operator.ask(b":MS#", "0|[12].*#") == b"0"
        await one.tell(b":Q#")
        job = rig.service.jobs.running_on("east")
        assert job is not None
        await at_rest(rig)
        assert job.state.value == "succeeded"
        assert len(rig.service.jobs.all()) == jobs + 1
        assert apart_arcsec(before, rig.reported()) > 3.0 * 3600.0

        async def all_noted() -> bool:
            rows = await asyncio.to_thread(rig.service.journal.reader.audits, telescope="east", limit=200)
            refused = {row.what for row in rows if row.outcome == "role-too-low"}
            return {"slew", "sync-to", "park", "unpark", "guide"} <= refused

        await _true(all_noted)
        for each in (one, operator):
            await each.close()
        writer.close()
    finally:
        await shown.lx200.stop()
        await shown.stellarium.stop()
