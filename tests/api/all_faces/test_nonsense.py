"""Nonsense, floods and clients that hang, by every face: nothing moves, nothing breaks, others are served."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import pytest

from drivers.fakes.faults import Fault
from tests.api.all_faces.attacked_service import Standing, standing, up_now
from tests.api.all_faces.programs import EAST, hands
from tests.waiting import until

REST_BODIES = (
    b'{"ra_deg": NaN, "dec_deg": 10.0}',
    b'{"ra_deg": Infinity, "dec_deg": 10.0}',
    b'{"ra_deg": 1e999, "dec_deg": 10.0}',
    b'{"ra_deg": "12:30:00", "dec_deg": "+10:00:00"}',
    b'{"ra_deg": 360.0, "dec_deg": 10.0}',
    b'{"ra_deg": -0.0001, "dec_deg": 10.0}',
    b'{"ra_deg": 10.0, "dec_deg": 90.0001}',
    b'{"ra_deg": true, "dec_deg": 10.0}',
    b'{"ra_deg": null, "dec_deg": null}',
    b'{"ra_deg": [10.0], "dec_deg": {"a": 1}}',
    b'{"ra_deg": 10.0, "dec_deg": 10.0, "frame": "B1950"}',
    b'{"ra_deg": 10.0, "dec_deg": 50.0, "target": {"kind": "icrs", "ra_deg": 10.0, "dec_deg": 50.0}}',
    b'{"target": {"kind": "name", "name": "no such thing at all"}}',
    b'{"target": {"kind": "name", "name": "\\ud800\\u0000"}}',
    b'{"target": {"kind": "altaz", "alt_deg": 60.0, "az_deg": NaN}}',
    b'{"target": {"kind": "icrs", "ra_deg": 1, "dec_deg": 2, "pm_dec_masyr": 1e308}}',
    b'{"ra_deg": 10.0, "dec_deg": 50.0, "speed": 11}',
    b'\xff\xfe{"ra_deg": 10.0}',
    b"{" * 5000,
    b"[" * 100_000,
    b'"' + b"x" * 400_000 + b'"',
    b"",
    b"ra_deg=10&dec_deg=50",
)
# fmt: off
ALPACA_PLACES = (
    "NaN", "Infinity", "-Infinity", "1e400", "12:30:00", "12,5", "", " ", "١٢", "0x10", "1_0", "24.1",
)
INDI_PLACES = (
    "NaN", "inf", "-inf", "1e999", "abc", "", "12:99:99:99", "٣:30", "25", "-0:00:00.1", "12:30:00x",
)
# fmt: on
LX200_WORDS = (
    b":Sr99:99:99#:MS#",
    b":SrNaN#:SdNaN#:MS#",
    b":Sr12:30:00#:Sd+99*00:00#:MS#",
    b":Sd\xff\xfe\xdf#:CM#",
    b":Sr" + b"1" * 5000,
    b"\x00\x01\x02:\x06#::::####",
    b":Mg n9999999#:Mgn99999#:Mgx100#",
    b":MS#" * 300,
    b":CM#" * 20,
)
STELLARIUM_MESSAGES = (
    struct.pack("<HHqIi", 20, 0, 0, 0, 2**31 - 1),
    struct.pack("<HHqIi", 20, 0, -(2**63), 2**32 - 1, -(2**31)),
    struct.pack("<HHqIi", 20, 7, 0, 0, 0),
    struct.pack("<HH", 65535, 0),
    struct.pack("<HH", 0, 0),
    struct.pack("<HHqI", 20, 0, 0, 0),
    b"GET / HTTP/1.1\r\n\r\n",
)


@asynccontextmanager
async def lives_through(stand: Standing, by: dict[str, Any]) -> AsyncIterator[None]:
    """Nothing that moves goes out meanwhile, and afterwards all is as it was."""
    with stand.silent_wire():
        yield
        await stand.idle()
    state = await by["rest"].state()
    assert state["connected"] is True
    assert state["slewing"] is False


async def test_rest_takes_no_nonsense() -> None:
    async with standing() as stand, hands(stand) as by, lives_through(stand, by):
        http = by["rest"].http
        for path in ("/slew", "/center", "/jobs"):
            for body in REST_BODIES:
                answer = await http.post(
                    f"{EAST}{path}", content=body, headers={"Content-Type": "application/json"}
                )
                if answer.status_code == 202:
                    # an unknown name may be found out by the job
                    ended = await by["rest"].ended(answer)
                    assert ended["state"] == "failed", (path, body[:60], ended)
                    continue
                assert 400 <= answer.status_code < 500, (path, body[:60], answer.text[:300])
                assert answer.headers["content-type"] == "application/problem+json", (path, body[:60])
        for headers in ({"Idempotency-Key": "k" * 5000}, {"Mountnav-Lease": "\xe9" * 300}):
            place = {"ra_deg": 10.0, "dec_deg": 60.0}
            raw = {name: value.encode("latin-1") for name, value in headers.items()}
            answer = await http.post(f"{EAST}/slew", json=place, headers=raw)
            assert 400 <= answer.status_code < 500, answer.text[:300]
        for wait in ("NaN", "inf", "-1", "1e9", "x"):
            answer = await http.get("/v1/jobs/nothing", params={"wait": wait})
            assert answer.status_code in (404, 422), (wait, answer.status_code, answer.text[:300])


async def test_alpaca_takes_no_nonsense() -> None:
    async with standing() as stand, hands(stand) as by, lives_through(stand, by):
        for text in ALPACA_PLACES:
            for form in (
                {"RightAscension": text, "Declination": "10"},
                {"RightAscension": "10", "Declination": text if text != "24.1" else "90.1"},
                {"rightascension": "10", "declination": "10"},
            ):
                for member in ("slewtocoordinatesasync", "slewtocoordinates", "synctocoordinates"):
                    told = await by["alpaca"].put(member, **form)
                    assert not told.taken, (member, form, told)
                    assert told.words, (member, form)
        http = by["alpaca"].http
        path = "/api/v1/telescope/0/slewtocoordinatesasync"
        for content in (b"RightAscension=%ff%fe&Declination=%00", b"=&" * 5000, b"x" * 1_000_000):
            answer = await http.put(
                path, content=content, headers={"Content-Type": "application/x-www-form-urlencoded"}
            )
            assert answer.status_code in (400, 413), (content[:40], answer.text[:300])


async def test_indi_takes_no_nonsense() -> None:
    async with standing() as stand, hands(stand) as by, lives_through(stand, by):
        name = "EQUATORIAL_EOD_COORD"

        def order(ra: str, dec: str) -> bytes:
            return (
                f"<newNumberVector device='east' name='{name}'><oneNumber name='RA'>{ra}</oneNumber>"
                f"<oneNumber name='DEC'>{dec}</oneNumber></newNumberVector>"
            ).encode()

        for text in INDI_PLACES:
            for message in (order(text, "10"), order("10", text if text != "25" else "90.5")):
                # -0:00:00.1 is a declination, and a good one
                if text == "-0:00:00.1" and message == order("10", text):
                    continue
                told = await by["indi"].give(name, message)
                assert not told.taken, (text, told)
        half = (
            f"<newNumberVector device='east' name='{name}'>"
            "<oneNumber name='RA'>5</oneNumber></newNumberVector>"
        )
        for message in (
            half.encode(),
            half.replace("Number", "Switch").encode(),
            half.replace("east", "nobody").encode(),
            half.replace(name, "NO_SUCH_THING").encode(),
            b"<newSwitchVector device='east' name='TELESCOPE_PARK'><oneSwitch name='PARK'>Maybe</oneSwitch>"
            b"</newSwitchVector>",
            b"<newSwitchVector device='east' name='TELESCOPE_PARK'><oneSwitch name='PARK'>On</oneSwitch>"
            b"<oneSwitch name='UNPARK'>On</oneSwitch></newSwitchVector>",
            b"<getProperties version='99'/>",
            b"<enableBLOB device='\xc3\xa9'>Never</enableBLOB>",
        ):
            told = await by["indi"].give(name if b"RA" in message else "TELESCOPE_PARK", message)
            assert not told.taken or b"east" not in message or b"NO_SUCH" in message, (message, told)


@pytest.mark.long
@pytest.mark.parametrize(
    ("door", "messages"),
    [
        ("lx200", LX200_WORDS),
        ("stellarium", STELLARIUM_MESSAGES),
        (
            "indi",
            (
                b"\xff\xfe\x00" * 100,
                b"<" * 10_000,
                b"<newNumberVector device='east'>" * 2000,
                b"<!DOCTYPE a [<!ENTITY b 'bbbb'><!ENTITY c '&b;&b;&b;'>]><a>&c;</a>",
                b"<getProperties version='1.7'" + b" a='b'" * 50_000,
            ),
        ),
    ],
)
async def test_garbage_at_a_door(door: str, messages: tuple[bytes, ...]) -> None:
    """Each on a connection of its own; whoever is there already notices nothing."""
    async with standing() as stand, hands(stand) as by, lives_through(stand, by):
        for message in messages:
            reader, writer = await asyncio.open_connection(*stand.door(door))
            writer.write(message)
            await writer.drain()
            if writer.can_write_eof():
                writer.write_eof()
            async with asyncio.timeout(60):
                try:
                    while await reader.read(65536):
                        pass
                except ConnectionError:
                    pass
            writer.close()
        await by["indi"].say()
        assert await by["lx200"].ask(":GVP#") == "mountnav#"


@pytest.mark.long
async def test_clients_that_hang_hold_nobody_up() -> None:
    """Half a request, half a message, and clients that never read: orders and stops go through meanwhile."""
    async with standing() as stand, hands(stand) as by, AsyncExitStack() as stack:
        http = "127.0.0.1", stand.port
        halves = (
            [(http, b"POST /v1/telescopes/east/slew HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Le")] * 20
            + [
                (
                    http,
                    b"POST /v1/telescopes/east/slew HTTP/1.1\r\nHost: 127.0.0.1\r\n"
                    b"Content-Type: application/json\r\nContent-Length: 60\r\n\r\n{",
                )
            ]
            * 20
            + [(http, b"GET /v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")] * 20
            + [(stand.door("indi"), b"<getProperties version='1.7'/>" * 50)] * 10
            + [(stand.door("indi"), b"<newNumberVector device='east' na")] * 10
            + [(stand.door("lx200"), b":GR#:GD#" * 20 + b":Sr12:3")] * 20
            + [(stand.door("stellarium"), b"\x14\x00\x00")] * 20
        )
        for address, half in halves:
            _, writer = await asyncio.open_connection(*address)
            stack.callback(writer.close)
            writer.write(half)
        for face in ("rest", "alpaca", "indi", "lx200"):
            stand.mechanics.slew_rate_deg_s = 1.0
            mark = stand.mark()
            told = await by[face].goto(up_now(-30.0, 30.0))
            assert told.taken, (face, told)
            await stand.on_its_way(mark)
            assert (await by[face].stop()).taken is not False, face
            await stand.idle()


@pytest.mark.long
async def test_a_stop_behind_many_commands_of_one_app_goes_past_them() -> None:
    """An app that has a hundred questions waiting behind a slow sync, and then says :Q#."""
    async with standing() as stand, hands(stand) as by:
        app = by["lx200"]
        await app.aim(stand.mechanics.reported())
        stand.fake.add_fault(Fault("late", on=b":CM", delay_s=3.0))
        mark = stand.mark()
        await app.say(":CM#" + ":GR#" * 400)
        await until(lambda: any(one.startswith(b":CM") for one in stand.fake.heard[mark:]), "syncing")
        sync = stand.service.jobs.running_on("east")
        assert sync is not None
        await app.say(":Q#")
        await until(lambda: b":Q#" in stand.fake.heard[mark:], "the stop on the wire")
        assert str(sync.state) in ("running", "cancelled"), "the stop has waited for the end of the sync"
