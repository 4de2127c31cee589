"""The INDI server as its clients meet it: raw messages to a running service with a fake mount."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from dataclasses import replace

import pytest
import pytest_asyncio

from api.access.callers import Caller, Face, Role
from api.indi_server.server import IndiServer
from api.orders.targets import ApparentTarget
from api.orders.vocabulary import SlewOrder, TrackingOrder
from api.service import Service
from drivers.indi.codec import messages
from drivers.indi.codec.messages import Changed, Defined, Deleted, State
from mountnav.clock import utc_now
from mountnav.sky.coordinates import Apparent
from tests.api.indi_server.face_rig import (
    Raw,
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
EOD = "EQUATORIAL_EOD_COORD"
SCHEDULER = Caller("a scheduler", Role.OPERATE, Face.REST)
Rig = tuple[Service, IndiServer]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    async with indi_observatory(tmp_path_factory.mktemp("indi")) as rig:
        yield rig


@pytest_asyncio.fixture(autouse=True, loop_scope="module")
async def _at_rest(rig: Rig) -> AsyncIterator[None]:
    """Let each test begin with an idle mount that tracks."""
    yield
    service, _ = rig
    job = service.jobs.running_on("east")
    if job is not None:
        await service.dispatcher.cancel(SCHEDULER, job)
        await job.ended.wait()


def beside(service: Service, north_deg: float) -> Apparent:
    here = mechanics_of(service).reported(utc_now())
    return Apparent(here.ra_deg, here.dec_deg + north_deg, utc_now())


async def test_all_properties_by_their_names(rig: Rig) -> None:
    async with raw_client(rig[1], asking=False) as raw:
        await raw.say(b'<getProperties version="1.7"/>')
        await raw.until(lambda: bool(raw.told("POLLING_PERIOD")), "told all")
        await raw.until(lambda: bool(raw.told("DRIVER_INFO", device="gone")), "told of the other")
        told = {one.name: one for one in raw.heard if isinstance(one, Defined) and one.device == "east"}
        assert {
            "CONNECTION",
            "DRIVER_INFO",
            "ON_COORD_SET",
            EOD,
            "HORIZONTAL_COORD",
            "TELESCOPE_ABORT_MOTION",
            "TELESCOPE_PARK",
            "TELESCOPE_PARK_OPTION",
            "TELESCOPE_HOME",
            "TELESCOPE_TRACK_STATE",
            "TELESCOPE_TRACK_MODE",
            "TELESCOPE_TRACK_RATE",
            "TELESCOPE_MOTION_NS",
            "TELESCOPE_MOTION_WE",
            "TELESCOPE_SLEW_RATE",
            "TELESCOPE_PIER_SIDE",
            "TELESCOPE_TIMED_GUIDE_NS",
            "TELESCOPE_TIMED_GUIDE_WE",
            "GEOGRAPHIC_COORD",
            "TIME_UTC",
        } <= told.keys()
        # a telescope and a guider; the site's longitude counts from 0 to 360 east
        assert told["DRIVER_INFO"].values["DRIVER_INTERFACE"] == "5"
        assert told["GEOGRAPHIC_COORD"].values == {"LAT": 47.0, "LONG": 11.0, "ELEV": 600.0}
        assert (told["GEOGRAPHIC_COORD"].perm, told["TIME_UTC"].perm) == ("ro", "ro")
        # what is of date is what the fake reports of date
        place = Apparent(float(told[EOD].values["RA"]) * 15.0, float(told[EOD].values["DEC"]), utc_now())  # type: ignore[arg-type]
        assert apart_arcsec(place, mechanics_of(rig[0]).reported(utc_now())) < 5.0
        # a mount that was never reached has nothing to show, and is not connected
        gone = {one.name for one in raw.heard if isinstance(one, Defined) and one.device == "gone"}
        assert gone == {"CONNECTION", "DRIVER_INFO"}
        assert raw.now("CONNECTION", device="gone").values["CONNECT"] is False


async def test_only_what_was_asked_for_is_told(rig: Rig) -> None:
    async with raw_client(rig[1], asking=False) as raw:
        await raw.say(messages.get_properties("east", "TELESCOPE_PIER_SIDE"))
        await raw.until(lambda: bool(raw.heard), "answered")
        await raw.say(messages.get_properties("nobody"), messages.enable_blob("east", "Also"))
        await asyncio.sleep(0.5)
        assert {one.name for one in raw.heard if isinstance(one, Defined | Changed)} == {
            "TELESCOPE_PIER_SIDE"
        }


async def test_a_slew_is_busy_then_ok_and_arrives(rig: Rig) -> None:
    service, server = rig
    async with raw_client(server) as raw:
        there, mark = beside(service, -0.6), len(raw.heard)
        await raw.say(switch("ON_COORD_SET", "TRACK"), coordinates(there))
        await raw.until(lambda: State.BUSY in raw.states(EOD, mark), "busy")
        busy = len(raw.heard)
        await raw.until(lambda: State.OK in raw.states(EOD, busy), "ok")
        assert State.ALERT not in raw.states(EOD, mark)
        assert apart_arcsec(mechanics_of(service).reported(utc_now()), there) < 3.0
        target = raw.now("TARGET_EOD_COORD").values
        assert float(target["DEC"]) == pytest.approx(there.dec_deg, abs=1e-6)  # type: ignore[arg-type]
        job = service.jobs.all()[0]
        assert (job.kind, job.state) == ("slew", "succeeded")
        # positions on the way were told
        assert len({str(one.values) for one in raw.told(EOD, mark)}) > 3


@pytest.mark.long
async def test_a_sync_of_one_client_is_no_sync_of_another(rig: Rig) -> None:
    service, server = rig
    async with raw_client(server) as ekos, raw_client(server) as other:
        await ekos.say(switch("ON_COORD_SET", "SYNC"))
        await ekos.until(lambda: ekos.now("ON_COORD_SET").values["SYNC"] is True, "selected")
        # the other's coordinates come between: a goto, as it knows no sync
        there, jobs = beside(service, 0.4), len(service.jobs.all())
        assert other.now("ON_COORD_SET").values["TRACK"] is True
        await other.say(coordinates(there))
        await until(lambda: len(service.jobs.all()) == jobs + 1, "ordered")
        assert service.jobs.all()[0].kind == "slew"
        await service.jobs.all()[0].ended.wait()
        assert apart_arcsec(mechanics_of(service).reported(utc_now()), there) < 3.0
        # and the first one's are the sync it asked for; after it SYNC isn't selected any more
        aside, mark = beside(service, 0.1), len(ekos.heard)
        await ekos.say(coordinates(aside))
        await ekos.until(lambda: "[INFO] synced" in ekos.words(mark), "synced")
        assert service.jobs.all()[0].kind == "sync-to"
        assert apart_arcsec(mechanics_of(service).reported(utc_now()), aside) < 5.0
        await ekos.until(lambda: ekos.now("ON_COORD_SET").values["TRACK"] is True, "back to TRACK")
        # the next coordinates after a sync are a goto, though the client selected nothing again
        await ekos.say(coordinates(beside(service, 0.1)))
        await until(lambda: len(service.jobs.all()) == jobs + 3, "ordered")
        assert service.jobs.all()[0].kind == "slew"


async def test_below_the_limit_is_alert_with_the_words_for_that_client_alone(rig: Rig) -> None:
    service, server = rig
    async with raw_client(server) as raw, raw_client(server) as other:
        mark, others, jobs = len(raw.heard), len(other.heard), len(service.jobs.all())
        await raw.say(coordinates(up_now(-100.0, -20.0)))
        await raw.until(lambda: State.ALERT in raw.states(EOD, mark), "refused")
        assert any("altitude" in words and words.startswith("[ERROR]") for words in raw.words(mark))
        # the truth follows, and others have seen no alarm of it
        alarm = len(raw.heard)
        await raw.until(lambda: State.OK in raw.states(EOD, alarm), "as it is")
        assert State.ALERT not in other.states(EOD, others)
        assert len(service.jobs.all()) == jobs

        async def noted() -> bool:
            rows = await asyncio.to_thread(service.journal.reader.audits, telescope="east", limit=5)
            return any(row.outcome == "outside-limits" and row.caller.startswith("indi 127.") for row in rows)

        async with asyncio.timeout(60.0):
            while not await noted():
                await asyncio.sleep(0.05)


@pytest.mark.parametrize(
    ("ra", "dec"), [("nan", "10"), ("25:00:00", "10"), ("1", "91"), ("1", "inf"), ("1", "x"), ("-1", "0")]
)
async def test_what_is_no_place_moves_nothing(rig: Rig, ra: str, dec: str) -> None:
    service, server = rig
    async with raw_client(server) as raw:
        mark, jobs = len(raw.heard), len(service.jobs.all())
        await raw.say(
            f'<newNumberVector device="east" name="{EOD}"><oneNumber name="RA">{ra}</oneNumber>'
            f'<oneNumber name="DEC">{dec}</oneNumber></newNumberVector>'.encode()
        )
        await raw.until(lambda: State.ALERT in raw.states(EOD, mark), "refused")
        assert not raw.closed
        assert len(service.jobs.all()) == jobs


async def test_abort_comes_before_what_waits_and_stops_what_moves(rig: Rig) -> None:
    service, server = rig
    async with raw_client(server) as raw, raw_client(server) as other:
        far = up_now(60.0, 30.0)
        mark = len(raw.heard)
        await raw.say(coordinates(far))
        await raw.until(lambda: State.BUSY in raw.states(EOD, mark), "busy")
        job = service.jobs.all()[0]
        # a stop of somebody who holds nothing
        await other.say(switch("TELESCOPE_ABORT_MOTION", "ABORT"))
        await other.until(lambda: State.OK in other.states("TELESCOPE_ABORT_MOTION", 0)[1:], "stopped")
        await job.ended.wait()
        assert job.state == "cancelled"
        await until(lambda: not mechanics_of(service).slewing(), "at rest")
        assert apart_arcsec(mechanics_of(service).reported(utc_now()), far) > 3600.0
        await raw.until(lambda: raw.now(EOD).state is State.OK, "ok")
        # in one write: orders, a stop, nothing of them moves
        jobs, mark = len(service.jobs.all()), len(raw.heard)
        await raw.say(
            switch("TELESCOPE_TRACK_MODE", "TRACK_SIDEREAL"),
            coordinates(far),
            switch("TELESCOPE_ABORT_MOTION", "ABORT"),
        )
        await raw.until(lambda: "[INFO] stopped" in raw.words(mark), "stopped")
        await raw.asked("TELESCOPE_ABORT_MOTION")
        assert all(job.is_over for job in service.jobs.all())
        assert [one.kind for one in service.jobs.all()][: len(service.jobs.all()) - jobs].count("slew") == 0


@pytest.mark.long
async def test_a_goto_replaces_the_same_clients_goto_and_nobody_elses(rig: Rig) -> None:
    service, server = rig
    async with raw_client(server) as raw, raw_client(server) as other:
        mark, others = len(raw.heard), len(other.heard)
        await raw.say(coordinates(up_now(60.0, 30.0)))
        await raw.until(lambda: State.BUSY in raw.states(EOD, mark), "busy")
        first = service.jobs.all()[0]
        await other.say(coordinates(beside(service, 0.3)))
        await other.until(lambda: State.ALERT in other.states(EOD, others), "refused")
        assert any(first.id in words for words in other.words(others)), "the holder is named"
        # a wrong click ends nothing
        await raw.say(coordinates(up_now(-100.0, -20.0)))
        await raw.until(lambda: State.ALERT in raw.states(EOD, mark), "refused")
        assert not first.is_over
        there = beside(service, 0.3)
        await raw.say(coordinates(there))
        await first.ended.wait()
        assert first.state == "cancelled"
        await until(lambda: service.jobs.all()[0] is not first, "another one")
        await service.jobs.all()[0].ended.wait()
        assert service.jobs.all()[0].state == "succeeded"
        assert apart_arcsec(mechanics_of(service).reported(utc_now()), there) < 3.0


async def test_a_lease_is_respected_but_for_the_stop(rig: Rig) -> None:
    service, server = rig
    _, secret = await service.leases.take(SCHEDULER, "east", ttl_s=600.0)
    try:
        async with raw_client(server) as raw:
            mark, jobs = len(raw.heard), len(service.jobs.all())
            await raw.say(coordinates(beside(service, 0.5)))
            await raw.until(lambda: State.ALERT in raw.states(EOD, mark), "refused")
            assert any("a scheduler" in words for words in raw.words(mark))
            await raw.say(switch("TELESCOPE_TRACK_STATE", "TRACK_OFF"))
            await raw.until(lambda: State.ALERT in raw.states("TELESCOPE_TRACK_STATE", mark), "refused")
            assert len(service.jobs.all()) == jobs
            await raw.say(switch("TELESCOPE_ABORT_MOTION", "ABORT"))
            await raw.until(lambda: "[INFO] stopped" in raw.words(mark), "stopped all the same")
    finally:
        service.leases.release(replace(SCHEDULER, lease_id=secret), "east")


async def test_another_faces_job_shows_and_is_not_replaced(rig: Rig) -> None:
    service, server = rig
    far = up_now(60.0, 30.0)
    async with raw_client(server) as raw:
        mark = len(raw.heard)
        job = await service.dispatcher.order(
            SCHEDULER, "east", SlewOrder(target=ApparentTarget(ra_deg=far.ra_deg, dec_deg=far.dec_deg))
        )
        await raw.until(lambda: State.BUSY in raw.states(EOD, mark), "busy")
        await raw.until(lambda: "[INFO] slew" in raw.words(mark), "told")
        await raw.say(coordinates(beside(service, 0.5)))
        await raw.until(lambda: State.ALERT in raw.states(EOD, mark), "refused")
        assert not job.is_over


async def test_site_and_time_are_compared_and_never_taken(rig: Rig) -> None:
    service, server = rig
    site = service.settings.site.site
    async with raw_client(server) as raw:
        for longitude_deg, state in ((371.0 - 360.0, State.OK), (349.0, State.ALERT)):
            mark = len(raw.heard)
            values = {"LAT": 47.0, "LONG": longitude_deg, "ELEV": 0.0}
            await raw.say(messages.new_numbers("east", "GEOGRAPHIC_COORD", values))
            await raw.until(lambda m=mark, s=state: s in raw.states("GEOGRAPHIC_COORD", m), str(state))  # type: ignore[misc]
            assert raw.now("GEOGRAPHIC_COORD").values["LONG"] == pytest.approx(11.0)
        assert any("longitude 11.0000" in words for words in raw.words())
        now = utc_now()
        for told, state in ((now, State.OK), (now.replace(year=now.year - 1), State.ALERT)):
            mark = len(raw.heard)
            text = told.strftime("%Y-%m-%dT%H:%M:%S")
            await raw.say(messages.new_texts("east", "TIME_UTC", {"UTC": text, "OFFSET": "1"}))
            await raw.until(lambda m=mark, s=state: s in raw.states("TIME_UTC", m), str(state))  # type: ignore[misc]
        assert service.settings.site.site == site
        mark = len(raw.heard)
        await raw.say(messages.new_texts("east", "TIME_UTC", {"UTC": "half past nine"}))
        await raw.until(lambda: State.ALERT in raw.states("TIME_UTC", mark), "refused")


async def test_orders_that_make_no_sense_are_refused_and_the_client_stays(rig: Rig) -> None:
    _, server = rig
    wrong = {
        "TELESCOPE_PARK": messages.new_switches("east", "TELESCOPE_PARK", {"PARK": True, "UNPARK": True}),
        "TELESCOPE_TRACK_STATE": messages.new_switches("east", "TELESCOPE_TRACK_STATE", {"FASTER": True}),
        "TELESCOPE_PIER_SIDE": switch("TELESCOPE_PIER_SIDE", "PIER_WEST"),
        "TELESCOPE_TIMED_GUIDE_NS": messages.new_numbers(
            "east", "TELESCOPE_TIMED_GUIDE_NS", {"TIMED_GUIDE_N": 100.0, "TIMED_GUIDE_S": 100.0}
        ),
        "TELESCOPE_TIMED_GUIDE_WE": messages.new_numbers(
            "east", "TELESCOPE_TIMED_GUIDE_WE", {"TIMED_GUIDE_W": -5.0}
        ),
        "HORIZONTAL_COORD": messages.new_numbers("east", "HORIZONTAL_COORD", {"ALT": 50.0, "AZ": 10.0}),
        EOD: messages.new_numbers("east", EOD, {"RA": 1.0}),
        "ON_COORD_SET": switch("ON_COORD_SET", "PARK"),
    }
    async with raw_client(server) as raw:
        for name, message in wrong.items():
            mark = len(raw.heard)
            await raw.say(message)
            await raw.until(lambda n=name, m=mark: State.ALERT in raw.states(n, m), f"{name} refused")  # type: ignore[misc]
        mark = len(raw.heard)
        await raw.say(switch("TELESCOPE_FOCUS", "FOCUS_IN"), switch("CONNECTION", "CONNECT", "nobody"))
        await raw.until(lambda: len(raw.words(mark)) >= 2, "both refused")
        assert raw.words(mark) == [
            "[ERROR] east has no TELESCOPE_FOCUS",
            "[ERROR] there is no device nobody",
        ]


async def test_disconnecting_is_each_clients_own(rig: Rig) -> None:
    _, server = rig
    async with raw_client(server) as raw, raw_client(server) as other:
        mark, others = len(raw.heard), len(other.heard)
        await raw.say(switch("CONNECTION", "DISCONNECT"))
        await raw.until(
            lambda: any(isinstance(one, Deleted) and one.name == EOD for one in raw.heard), "gone"
        )
        assert raw.now("CONNECTION").values == {"CONNECT": False, "DISCONNECT": True}
        await raw.say(coordinates(up_now(10.0, 40.0)))
        await raw.until(lambda: any("not connected" in words for words in raw.words(mark)), "refused")
        assert other.states("CONNECTION", others) == []
        mark = len(raw.heard)
        await raw.say(switch("CONNECTION", "CONNECT"))
        await raw.until(lambda: bool(raw.told(EOD, mark)), "back")


async def test_a_mount_that_is_not_there_says_why(rig: Rig) -> None:
    _, server = rig
    async with raw_client(server) as raw:
        await raw.say(messages.get_properties("gone"))
        await raw.until(lambda: bool(raw.told("CONNECTION", device="gone")), "told")
        await raw.say(switch("CONNECTION", "CONNECT", "gone"))
        # the next change of the device may tell it again, in the same breath
        await raw.until(lambda: State.ALERT in raw.states("CONNECTION", device="gone"), "refused")
        assert any("there-is-no-such-port" in words for words in raw.words())
        assert raw.now("CONNECTION", device="gone").values["CONNECT"] is False


async def test_a_client_that_goes_at_once_has_ordered_all_the_same(rig: Rig) -> None:
    """As `indi_setprop` does: it sends, and is gone."""
    service, server = rig
    there, jobs = beside(service, 0.2), len(service.jobs.all())
    raw = Raw(*await asyncio.open_connection(*server.address))
    await raw.say(messages.get_properties("east"), coordinates(there))
    await raw.close()
    await until(lambda: len(service.jobs.all()) == jobs + 1, "ordered")
    job = service.jobs.all()[0]
    raw = Raw(*await asyncio.open_connection(*server.address))
    await raw.say(switch("TELESCOPE_ABORT_MOTION", "ABORT"))
    await raw.close()
    await asyncio.wait_for(job.ended.wait(), 60.0)
    assert (job.kind, job.state) == ("slew", "cancelled")


async def test_a_stop_behind_hundreds_of_orders_is_heard(rig: Rig) -> None:
    service, server = rig
    far = up_now(60.0, 30.0)
    async with raw_client(server, asking=False) as raw:
        stop = switch("TELESCOPE_ABORT_MOTION", "ABORT")
        await raw.say(messages.get_properties("east"), *([coordinates(far)] * 300), *([stop] * 300))
        await raw.until(lambda: raw.closed, "let go")
        assert any("waiting" in words for words in raw.words())
    await until(lambda: service.jobs.running_on("east") is None, "nothing under way")
    await until(lambda: not mechanics_of(service).slewing(), "at rest")
    assert apart_arcsec(mechanics_of(service).reported(utc_now()), far) > 3600.0


async def test_what_is_no_indi_ends_the_connection_politely(rig: Rig) -> None:
    _, server = rig
    async with raw_client(server) as good:
        async with raw_client(server, asking=False) as bad:
            await bad.say(b"GET /index.html HTTP/1.1\r\n\r\n<html>")
            await bad.until(lambda: bad.closed, "closed")
            assert any("goodbye" in words for words in bad.words())
        # nor does a web page order by what it has its browser post here
        jobs = len(rig[0].jobs.all())
        async with raw_client(server, asking=False) as page:
            await page.say(b"POST / HTTP/1.1\r\nContent-Type: text/plain\r\n\r\n")
            await page.say(coordinates(beside(rig[0], 0.2)))
            await page.until(lambda: page.closed, "closed")
        assert len(rig[0].jobs.all()) == jobs
        await good.asked("TELESCOPE_PARK")
        assert not good.closed


@pytest.mark.long
async def test_a_client_that_never_reads_is_let_go_and_others_are_served(rig: Rig) -> None:
    _, server = rig
    loop = asyncio.get_running_loop()
    with socket.socket() as greedy:
        # small buffers here, so that the server's fill
        greedy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        greedy.setblocking(False)
        await loop.sock_connect(greedy, server.address)
        question = messages.get_properties()
        async with asyncio.timeout(60.0):
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                # without an end of its own: only the server ends it
                while True:
                    await loop.sock_sendall(greedy, question * 20)
                    await asyncio.sleep(0)
    async with raw_client(server) as raw:
        await raw.asked("TELESCOPE_PARK")


@pytest.mark.long
async def test_tracking_and_two_pulses_at_once(rig: Rig) -> None:
    service, server = rig
    async with raw_client(server) as raw:
        await raw.say(switch("TELESCOPE_TRACK_MODE", "TRACK_LUNAR"))
        await raw.until(lambda: raw.now("TELESCOPE_TRACK_MODE").values["TRACK_LUNAR"] is True, "lunar")
        job = service.jobs.all()[0]
        assert (job.kind, job.request["rate"]) == ("tracking", "lunar")
        jobs, mark = len(service.jobs.all()), len(raw.heard)
        # a guider moves both axes in one go: one after the other, none is lost
        await raw.say(
            messages.new_numbers(
                "east", "TELESCOPE_TIMED_GUIDE_NS", {"TIMED_GUIDE_N": 50.0, "TIMED_GUIDE_S": 0.0}
            ),
            messages.new_numbers(
                "east", "TELESCOPE_TIMED_GUIDE_WE", {"TIMED_GUIDE_W": 0.0, "TIMED_GUIDE_E": 50.0}
            ),
        )
        await raw.until(
            lambda: State.IDLE in raw.states("TELESCOPE_TIMED_GUIDE_WE", mark), "both pulses over"
        )
        # Busy, then Idle, each once [INDI GuiderInterface]; PHD2 takes a later Idle for its next pulse's end
        for _ in range(2):
            await service.dispatcher.watch("east").refresh()
        await raw.asked("TELESCOPE_PARK")
        for name in ("TELESCOPE_TIMED_GUIDE_NS", "TELESCOPE_TIMED_GUIDE_WE"):
            assert raw.states(name, mark) == [State.BUSY, State.IDLE]
        done = service.jobs.all()[: len(service.jobs.all()) - jobs]
        assert [(one.request["direction"], one.state) for one in done] == [
            ("e", "succeeded"),
            ("n", "succeeded"),
        ]
        back = await service.dispatcher.order(SCHEDULER, "east", TrackingOrder(on=True))
        await back.ended.wait()
        await raw.until(
            lambda: raw.now("TELESCOPE_TRACK_MODE").values["TRACK_SIDEREAL"] is True, "known here too"
        )
