"""A running service with fast fake mounts, for the faces that are no HTTP; a client that speaks raw INDI."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from api.indi_server.server import IndiServer
from api.service import Service, open_service
from drivers.indi.codec import messages as orders
from drivers.indi.codec.messages import Changed, Defined, Event, Reader, State
from mountnav.catalog.embedded import embedded_catalog
from mountnav.clock import utc_now
from mountnav.settings.observatory import Settings
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from tests.waiting import PATIENCE_S

SITE = Site(47.0, 11.0, 600.0)
OBSERVATORY = """
[service]
port = 0
state_poll_s = 0.1
[solving]
worker = false
blind = "never"
[site]
latitude_deg = 47.0
longitude_deg = 11.0
height_m = 600.0
[indi_server]
port = 0
[lx200_server]
port = 0
[stellarium]
port = 0
[[telescope]]
id = "east"
[telescope.mount]
url = "fake+lx200://?dialect=onstep"
mounting = "fork"
slew_rate_deg_s = 40.0
acceleration_deg_s2 = 8.0
[telescope.camera]
kind = "simulated"
width_px = 400
height_px = 300
scale_arcsec_px = 4.0
[[telescope]]
id = "gone"
mount = { url = "lx200+serial:///dev/there-is-no-such-port" }
camera = { kind = "folder", path = "/" }
"""


@asynccontextmanager
async def observatory(folder: Path, toml: str = OBSERVATORY) -> AsyncIterator[Service]:
    """A service without HTTP with real jobs, dispatcher and journal, which lies in `folder`."""
    journal = f"[journal]\nurl = '{folder / 'journal.sqlite'}'\n"
    service = await open_service(Settings.parse(journal + toml), embedded_catalog())
    try:
        yield service
    finally:
        await service.halt()


@asynccontextmanager
async def indi_observatory(
    folder: Path, toml: str = OBSERVATORY
) -> AsyncIterator[tuple[Service, IndiServer]]:
    """The same with an INDI server."""
    async with observatory(folder, toml) as service:
        server = IndiServer(service)
        await server.start()
        try:
            yield service, server
        finally:
            await server.stop()


def mechanics_of(service: Service, telescope_id: str = "east") -> Mechanics:
    """Where the fake truly looks: the judge of what a client has reached."""
    found = service.observatory.telescope(telescope_id).mechanics
    assert found is not None
    return found


def up_now(ha_deg: float, dec_deg: float) -> Apparent:
    """A place of date that is up there now."""
    return icrs_to_apparent(hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc_now()), SITE, Air()), utc_now())


def apart_arcsec(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    """Distance of two places of the same kind."""
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))


class Raw:
    """A client that sends what it likes, and keeps all that it hears."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.heard: list[Event] = []
        self.closed = False
        self._news = asyncio.Event()
        self._stream = Reader()
        self._task = asyncio.create_task(self._listen())

    async def _listen(self) -> None:
        with contextlib.suppress(OSError):
            while data := await self.reader.read(65536):
                self.heard += self._stream.feed(data)
                self._news.set()
        self.closed = True
        self._news.set()

    async def say(self, *messages: bytes) -> None:
        """Send in one write."""
        self.writer.write(b"".join(messages))
        await self.writer.drain()

    async def until(self, true: Callable[[], bool], what: str) -> None:
        """Wait for what is heard to make something true."""
        try:
            async with asyncio.timeout(PATIENCE_S):
                while not true():
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            raise AssertionError(f"not {what}; heard {self.heard[-20:]}") from None

    async def asked(self, name: str = "", device: str = "east") -> None:
        """Ask for properties, and wait for the one that comes last, or that one."""
        mark = len(self.heard)
        last = name or "POLLING_PERIOD"
        await self.say(orders.get_properties(device, name))
        await self.until(
            lambda: any(isinstance(one, Defined) and one.name == last for one in self.heard[mark:]),
            f"told {last}",
        )

    def told(self, name: str, mark: int = 0, device: str = "east") -> list[Defined | Changed]:
        """All that was told of a property since a mark."""
        return [
            one
            for one in self.heard[mark:]
            if isinstance(one, Defined | Changed) and one.device == device and one.name == name
        ]

    def states(self, name: str, mark: int = 0, device: str = "east") -> list[State | None]:
        """The states it went through since a mark."""
        return [one.state for one in self.told(name, mark, device)]

    def words(self, mark: int = 0) -> list[str]:
        """All messages since a mark."""
        return [text for one in self.heard[mark:] if (text := getattr(one, "message", ""))]

    def now(self, name: str, device: str = "east") -> Defined | Changed:
        """What was told of it last."""
        return self.told(name, device=device)[-1]

    async def close(self) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self.writer.close()


@asynccontextmanager
async def raw_client(server: IndiServer, *, asking: bool = True, device: str = "east") -> AsyncIterator[Raw]:
    """A raw client that knows the device `east`; with "" it asks for all there are, as no server does."""
    raw = Raw(*await asyncio.open_connection(*server.address))
    try:
        if asking:
            await raw.asked(device=device)
        yield raw
    finally:
        await raw.close()


def switch(name: str, on: str, device: str = "east") -> bytes:
    """An order to turn one switch on."""
    return orders.new_switches(device, name, {on: True})


def coordinates(place: Apparent, device: str = "east") -> bytes:
    """An order to the coordinates."""
    return orders.new_numbers(
        device, "EQUATORIAL_EOD_COORD", {"RA": place.ra_deg / 15.0, "DEC": place.dec_deg}
    )
