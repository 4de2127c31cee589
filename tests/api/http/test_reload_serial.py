"""Settings read again where mounts hang on serial lines, clients on the doors, and motions are under way."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from api.http.app import create_app
from drivers.fakes.bench import Fake, FakeOnPty
from drivers.registry import make_fake
from mountnav.clock import utc_now
from mountnav.settings.observatory import Settings
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Air, HourAngle, Site
from tests.settings_text import SERVICE_AND_SITE

pytestmark = pytest.mark.long

SITE = Site(47.0, 11.0)
DOORS = """
[indi_server]
enabled = true
port = 0
[lx200_server]
enabled = true
port = 0
telescope = "east"
[stellarium]
enabled = true
port = 0
telescope = "east"
"""
ONE = """
[[telescope]]
id = "{id}"
exposure_s = {exposure_s}
mount = {{ url = "{url}", mounting = "fork" }}
camera = {{ kind = "folder", path = "/" }}
"""
FAR = {"target": {"kind": "altaz", "alt_deg": 40.0, "az_deg": 200.0}}


@dataclass(slots=True)
class Mounts:
    """Two mounts on lines of their own, that outlive every reload."""

    mechanics: dict[str, Mechanics]
    fakes: dict[str, Fake]
    urls: dict[str, str]


@pytest.fixture
def mounts() -> Iterator[Mounts]:
    with ExitStack() as standing:
        mechanics: dict[str, Mechanics] = {}
        fakes: dict[str, Fake] = {}
        urls: dict[str, str] = {}
        for name in ("east", "west"):
            made = Mechanics(
                SITE, Air(), PointingErrors(), machine=Machine(), slew_rate_deg_s=1.0, acceleration_deg_s2=5.0
            )
            bench = standing.enter_context(FakeOnPty(make_fake("lx200", "onstep", made)))
            mechanics[name], fakes[name] = made, bench.fake
            urls[name] = f"lx200+serial://{bench.address}"
        yield Mounts(mechanics, fakes, urls)


class Running:
    """A service whose file can be changed."""

    def __init__(self, app: FastAPI, client: httpx.AsyncClient) -> None:
        self.app, self.client, self.text = app, client, ""
        app.state.read_again = lambda: Settings.parse(self.text)

    async def reload(self, text: str) -> httpx.Response:
        self.text = text
        return await self.client.post("/v1/reload")

    async def state(self, telescope: str) -> dict[str, Any]:
        told: dict[str, Any] = (await self.client.get(f"/v1/telescopes/{telescope}")).json()
        return told

    async def until(self, telescope: str, **wanted: object) -> dict[str, Any]:
        async with asyncio.timeout(60):
            while True:
                state = await self.state(telescope)
                if all(state[name] == value for name, value in wanted.items()):
                    return state
                await asyncio.sleep(0.05)

    def port(self, door: str) -> int:
        found: int = self.app.state.service.listeners.states[door].port
        return found


def text_of(**telescopes: tuple[str, float]) -> str:
    ones = (ONE.format(id=name, url=url, exposure_s=s) for name, (url, s) in telescopes.items())
    return SERVICE_AND_SITE + DOORS + "".join(ones)


@asynccontextmanager
async def running(text: str) -> AsyncIterator[Running]:
    app = create_app(Settings.parse(text))
    async with AsyncExitStack() as standing:
        await standing.enter_async_context(app.router.lifespan_context(app))
        transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
        client = await standing.enter_async_context(
            httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60)
        )
        yield Running(app, client)


async def test_lines_change_hands_and_the_mounts_with_them(mounts: Mounts) -> None:
    east, west = mounts.urls["east"], mounts.urls["west"]
    async with running(text_of(east=(east, 1.0), west=(west, 1.0))) as one:
        for name in ("east", "west"):
            await one.until(name, connected=True)
        # swapped: each line is let go before it is opened for the other
        told = await one.reload(text_of(east=(west, 1.0), west=(east, 1.0)))
        assert told.status_code == 200, told.text
        assert told.json()["changed"] == ["east", "west"]
        for name in ("east", "west"):
            await one.until(name, connected=True)
        assert (await one.client.post("/v1/telescopes/east/slew", json=FAR)).status_code == 202
        await one.until("east", slewing=True)
        async with asyncio.timeout(20):
            while not mounts.mechanics["west"].slewing():
                await asyncio.sleep(0.02)
        assert not mounts.mechanics["east"].slewing()
        await one.client.post("/v1/telescopes/east/stop")
        await one.until("east", slewing=False)
        # from one that goes to one that comes; "east", whom two doors name, stays
        told = await one.reload(text_of(east=(west, 1.0), north=(east, 1.0)))
        assert told.status_code == 200, told.text
        assert (told.json()["added"], told.json()["removed"]) == (["north"], ["west"])
        await one.until("north", connected=True)
        # the same line for two of them is wrong, and changes nothing
        twice = await one.reload(text_of(east=(west, 1.0), north=(west, 1.0)))
        assert twice.json()["type"].endswith("bad-settings"), twice.text
        assert "both on" in twice.json()["detail"]
        assert (await one.state("north"))["connected"] is True


async def test_a_mount_that_slews_by_another_hand_is_not_let_go(mounts: Mounts) -> None:
    urls = mounts.urls
    async with running(text_of(east=(urls["east"], 1.0), west=(urls["west"], 1.0))) as one:
        await one.until("west", connected=True)
        mechanics = mounts.mechanics["west"]
        utc = utc_now()
        there = icrs_to_apparent(hour_angle_to_icrs(HourAngle(50.0, 5.0, utc), SITE, Air()), utc)
        hours, degrees = there.ra_deg / 15.0, there.dec_deg
        # its own hand control
        mounts.fakes["west"].feed(
            f":Sr{int(hours):02d}:{hours % 1.0 * 60.0:04.1f}#:Sd+{int(degrees):02d}*00#:MS#".encode()
        )
        await one.until("west", slewing=True)
        for other in (
            text_of(east=(urls["east"], 1.0), west=(urls["west"], 2.0)),
            text_of(east=(urls["east"], 1.0)),
        ):
            refused = await one.reload(other)
            assert refused.status_code == 409, refused.text
            assert "west can't be changed or taken out: it slews" in refused.json()["detail"]
        assert mechanics.slewing()
        # the other one is nobody's hindrance
        told = await one.reload(text_of(east=(urls["east"], 2.0), west=(urls["west"], 1.0)))
        assert told.json()["changed"] == ["east"], told.text
        assert mechanics.slewing()


async def test_a_mount_that_tracks_goes_on_tracking(mounts: Mounts) -> None:
    urls = mounts.urls
    async with running(text_of(east=(urls["east"], 1.0))) as one:
        await one.until("east", connected=True, tracking=True)
        assert (await one.reload(text_of(east=(urls["east"], 2.0)))).status_code == 200
        await one.until("east", connected=True, tracking=True)
        assert mounts.mechanics["east"].tracking


async def test_a_wrong_file_and_two_at_once_change_nothing_twice(mounts: Mounts) -> None:
    urls = mounts.urls
    right = text_of(east=(urls["east"], 1.0), west=(urls["west"], 1.0))
    async with running(right) as one:
        for name in ("east", "west"):
            await one.until(name, connected=True)
        slew = (await one.client.post("/v1/telescopes/west/slew", json=FAR)).json()
        for wrong in (right + "[[telescope]]", right.replace("fork", "sofa"), "nonsense = [", ""):
            told = await one.reload(wrong)
            assert told.json()["type"].endswith("bad-settings"), told.text
        assert (await one.client.get(f"/v1/jobs/{slew['id']}")).json()["state"] == "running"
        other = text_of(east=(urls["east"], 3.0), west=(urls["west"], 1.0))
        told_twice = await asyncio.gather(*(one.reload(other) for _ in range(3)))
        assert [told.status_code for told in told_twice] == [200] * 3
        assert sorted(told.json()["changed"] for told in told_twice) == [[], [], ["east"]]
        await one.until("east", connected=True)
        assert (await one.client.get(f"/v1/jobs/{slew['id']}")).json()["state"] == "running"


async def test_clients_of_the_doors_come_again_and_find_the_new_telescope(mounts: Mounts) -> None:
    urls = mounts.urls
    async with running(text_of(east=(urls["east"], 1.0), west=(urls["west"], 1.0))) as one:
        for name in ("east", "west"):
            await one.until(name, connected=True)

        async def declination() -> bytes:
            reader, writer = await asyncio.open_connection("127.0.0.1", one.port("lx200"))
            async with asyncio.timeout(20):
                writer.write(b":GD#")
                heard = await reader.readuntil(b"#")
            clients.append((reader, writer))
            return heard

        async def indi() -> bytes:
            reader, writer = await asyncio.open_connection("127.0.0.1", one.port("indi"))
            async with asyncio.timeout(20):
                writer.write(b'<getProperties version="1.7"/>')
                heard = await reader.readuntil(b"EQUATORIAL_EOD_COORD")
            clients.append((reader, writer))
            return heard

        clients: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []
        await declination()
        await indi()
        # another telescope is touched: the door that shows "east" alone is left as it is
        lx200 = one.port("lx200")
        assert (
            await one.reload(text_of(east=(urls["east"], 1.0), west=(urls["west"], 2.0)))
        ).status_code == 200
        assert one.port("lx200") == lx200
        reader, writer = clients[0]
        writer.write(b":GD#")
        async with asyncio.timeout(20):
            assert (await reader.readuntil(b"#")).endswith(b"#")
        await one.until("west", connected=True)
        # the one that it shows is touched: its clients are let go, and come again
        assert (
            await one.reload(text_of(east=(urls["east"], 2.0), west=(urls["west"], 2.0)))
        ).status_code == 200
        async with asyncio.timeout(20):
            await clients[0][0].read()
        await one.until("east", connected=True)
        assert (await declination()).endswith(b"#")
        assert b"east" in await indi()
        for _, writer in clients:
            writer.close()


async def test_a_client_of_many_devices_stays_while_one_of_them_is_changed_taken_out_and_added(
    mounts: Mounts,
) -> None:
    urls = mounts.urls
    east, west = (urls["east"], 1.0), (urls["west"], 1.0)
    async with running(text_of(east=east, west=west)) as one:
        for name in ("east", "west"):
            await one.until(name, connected=True)
        reader, writer = await asyncio.open_connection("127.0.0.1", one.port("indi"))
        of_east, east_writer = await asyncio.open_connection("127.0.0.1", one.port("indi"))

        async def heard(words: bytes, of: asyncio.StreamReader = reader) -> bytes:
            async with asyncio.timeout(30):
                return await of.readuntil(words)

        # a key that is held down moves east the whole time, by a client that asks for it alone
        east_writer.write(b'<getProperties version="1.7" device="east"/>')
        await heard(b'device="east" name="EQUATORIAL_EOD_COORD"', of_east)
        east_writer.write(
            b'<newSwitchVector device="east" name="TELESCOPE_MOTION_NS">'
            b'<oneSwitch name="MOTION_NORTH">On</oneSwitch></newSwitchVector>'
        )
        moving = mounts.mechanics["east"]
        before = moving.truth()
        async with asyncio.timeout(20):
            while moving.truth() == before:
                await asyncio.sleep(0.02)
        writer.write(b'<getProperties version="1.7"/>')
        writer.write(
            b'<newSwitchVector device="west" name="ON_COORD_SET">'
            b'<oneSwitch name="SYNC">On</oneSwitch></newSwitchVector>'
        )
        await heard(b'device="west" name="EQUATORIAL_EOD_COORD"')
        # changed: it goes as a whole, and comes again; a sync that was chosen for the old one is gone
        assert (await one.reload(text_of(east=east, west=(urls["west"], 2.0)))).status_code == 200
        await heard(b'<delProperty device="west" timestamp')
        again = await heard(b'device="west" name="EQUATORIAL_EOD_COORD"')
        assert b'device="west" name="CONNECTION"' in again
        assert b'name="TRACK" label="Track">On' in again, again.decode()
        # taken out, and another one comes on its line
        assert (await one.reload(text_of(east=east, north=west))).status_code == 200
        await heard(b'<delProperty device="west" timestamp')
        await heard(b'device="north" name="EQUATORIAL_EOD_COORD"')
        # no word of the other devices, for a client that asked for east alone, which moves all the while
        place = moving.truth()
        assert (await one.state("east"))["connected"] is True
        async with asyncio.timeout(20):
            while moving.truth() == place:
                await asyncio.sleep(0.02)
        east_writer.write(
            b'<newSwitchVector device="east" name="TELESCOPE_MOTION_NS">'
            b'<oneSwitch name="MOTION_NORTH">Off</oneSwitch></newSwitchVector>'
        )
        told = await heard(b'state="Idle"', of_east)
        assert b'device="east"' in told
        assert b'device="west"' not in told
        assert b'device="north"' not in told
        # a new device takes orders
        writer.write(
            b'<newSwitchVector device="north" name="TELESCOPE_TRACK_STATE">'
            b'<oneSwitch name="TRACK_OFF">On</oneSwitch></newSwitchVector>'
        )
        await one.until("north", tracking=False)
        for each in (writer, east_writer):
            each.close()
