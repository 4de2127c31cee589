"""A night served over a serial line, INDI (by our server or a real one) or Alpaca, and recorded."""

from __future__ import annotations

import asyncio
import io
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import httpx
import uvicorn
from astropy.io import fits
from fastapi import FastAPI

from api.http.app import create_app
from api.indi_server.server import IndiServer
from api.service import Service
from drivers.fakes.bench import FakeOnPty
from drivers.indi.codec import messages
from drivers.lx200.fake.dialects import make_fake
from mountnav.catalog.embedded import embedded_catalog
from mountnav.clock import in_virtual_time, real_s, utc_now
from mountnav.settings.observatory import Settings
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.simulation.render import draw_frame
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import Air, Site
from mountnav.sky.sphere import displaced
from tests.drivers.indi.real_server import IndiServer as RealIndiServer

Way = Literal["serial", "indi", "indiserver", "alpaca"]

OPTICS = SimulatedOptics(640, 480, 10.0, rotation_deg=20.0)
EXPOSURE_S = 0.5
SITE = Site(47.0, 11.0)
ERRORS = PointingErrors(ih_arcsec=150.0, id_arcsec=-120.0)
ONSTEP = "LX200 OnStep"
"""Name of the device of INDI's own driver for OnStep, `indi_lx200_OnStep`."""
AT = datetime(2026, 11, 21, 22, 0, tzinfo=UTC)

SERVICE = """
[service]
port = 0
state_poll_s = 0.1
rate_limit_per_s = 0
[solving]
worker = false
blind = "never"
[site]
latitude_deg = 47.0
longitude_deg = 11.0
[alpaca]
discovery = false
[indi_server]
port = 0
"""
FAKE = """
[telescope.mount]
url = "fake+lx200://?dialect=onstep"
slew_rate_deg_s = 45.0
acceleration_deg_s2 = 8.0
mounting = "fork"
[telescope.mount.errors]
ih_arcsec = 150.0
id_arcsec = -120.0
"""
BEHIND = f"""{SERVICE}
[[telescope]]
id = "far"
camera = {{ kind = "folder", path = "/" }}
{FAKE}
"""
NIGHT = """
[[telescope]]
id = "east"
scale_arcsec_px = 10.0
[telescope.camera]
kind = "folder"
path = "/"
[telescope.night]
enabled = true
begin_sun_below_deg = -90
end_sun_above_deg = 90
correct_by = "{by}"
correct_when_off_by_arcsec = 20.0
max_corrections_per_hour = 100
read_mount_every_s = {every_s}
poll_s = 0.1
quiet_s = 600.0
settle_s = 0.0
folder = "{folder}"
record = "{record}"
"""


@dataclass
class ServedNight:
    """A service with a night, over HTTP, and the scheduler that takes its frames."""

    client: httpx.AsyncClient
    app: FastAPI
    mechanics: Mechanics
    folder: Path
    record: Path
    knocked_east_arcsec: float = 0.0
    drawn: int = 0

    def knock(self, east_arcsec: float) -> None:
        """Push the tube in its rings: the mount can't know."""
        self.knocked_east_arcsec += east_arcsec

    async def exposed(self) -> bytes:
        """A frame of where the tube truly looks, as a FITS file."""
        began = utc_now()
        await asyncio.sleep(real_s(EXPOSURE_S))
        middle = began + timedelta(seconds=EXPOSURE_S / 2)
        self.drawn += 1
        return await asyncio.to_thread(self._drawn, middle, self.drawn)

    async def uploaded(self, **params: str | float) -> dict[str, Any]:
        """Send a frame, and wait for what comes of it."""
        found = await self.client.post(
            "/v1/telescopes/east/frames",
            params={"wait": 60, **params},
            files={"file": ("frame.fits", await self.exposed())},
        )
        assert found.status_code == 200, found.text
        told: dict[str, Any] = found.json()
        return told

    async def written(self) -> dict[str, Any]:
        """Put a frame into the folder, and wait for what comes of it."""
        path = self.folder / f"frame{self.drawn:04d}.fits"
        content = await self.exposed()
        # whole at once, as a camera's program renames what it has written
        path.with_suffix(".part").write_bytes(content)
        path.with_suffix(".part").rename(path)
        while True:
            listed = (await self.client.get("/v1/telescopes/east/frames")).json()
            for one in listed:
                if one["source"] == str(path) and one["done"]:
                    told: dict[str, Any] = one
                    return told
            await asyncio.sleep(0.05)

    async def said(self, word: str, **body: object) -> dict[str, Any]:
        """A word to the night."""
        found = await self.client.post(f"/v1/telescopes/east/night/{word}", json=body)
        assert found.status_code == 200, found.text
        told: dict[str, Any] = found.json()
        return told

    async def slewed(self, east_deg: float) -> None:
        """Somebody else's slew, to its end."""
        here = (await self.client.get("/v1/telescopes/east")).json()["icrs"]
        place = {"ra_deg": (here["ra_deg"] + east_deg) % 360.0, "dec_deg": here["dec_deg"]}
        job = await self.client.post("/v1/telescopes/east/slew", json=place)
        assert job.status_code == 202, job.text
        done = (await self.client.get(job.headers["location"], params={"wait": 60})).json()
        assert done["state"] == "succeeded", done

    async def closed(self) -> Path:
        """End the recording; its file."""
        recording = self.app.state.service.nights.of("east").parts.recording
        await asyncio.to_thread(recording.close)
        (path,) = self.record.glob("*.jsonl")
        return path

    def _drawn(self, middle: datetime, number: int) -> bytes:
        center = displaced(self.mechanics.truth(middle), self.knocked_east_arcsec, 0.0)
        frame = draw_frame(
            center, OPTICS, embedded_catalog(), exposure_s=2.0, mid_exposure_utc=middle, seed=(4, number)
        )
        hdu = fits.PrimaryHDU(frame.pixels)
        began = middle - timedelta(seconds=EXPOSURE_S / 2)
        hdu.header["DATE-OBS"] = began.replace(tzinfo=None).isoformat(timespec="microseconds")
        hdu.header["EXPTIME"] = EXPOSURE_S
        file = io.BytesIO()
        hdu.writeto(file)
        return file.getvalue()


@asynccontextmanager
async def served_night(
    folder: Path, way: Way, *, speed: float | None = None, by: str = "sync"
) -> AsyncIterator[ServedNight]:
    """Serve it; behind INDI and Alpaca the fake mount belongs to a second service in this process.

    Parameters
    ----------
    folder : Path
    way : {"serial", "indi", "indiserver", "alpaca"}
        How the night reaches its mount; "indi" is our own INDI server, "indiserver" the real one with its
        driver for OnStep, which has a fake on a pseudo-terminal.
    speed : float, optional
        Of a virtual time, which begins on an evening in November; the machine's if left out.
    by : str
        `correct_by`.
    """
    frames, record = folder / "frames", folder / "recordings"
    frames.mkdir()
    # a few times in one of the machine's seconds: both ends share one loop
    night = NIGHT.format(folder=frames, record=record, by=by, every_s=0.3 * (speed or 1.0))
    async with AsyncExitStack() as stack:
        stack.enter_context(nullcontext() if speed is None else in_virtual_time(FastClock(speed, AT)))
        if way == "serial":
            front = create_app(Settings.parse(_journal(folder, "east") + SERVICE + night + FAKE))
            client = await _opened(stack, front)
            mechanics = front.state.service.observatory.telescope("east").mechanics
        elif way == "indiserver":
            mechanics, url = await stack.enter_async_context(_behind_indiserver(folder / "home"))
            mount = f'[telescope.mount]\nurl = "{url}"\nmounting = "fork"\n'
            front = create_app(Settings.parse(_journal(folder, "east") + SERVICE + night + mount))
            client = await _opened(stack, front)
        else:
            back = create_app(Settings.parse(_journal(folder, "far") + BEHIND))
            await _opened(stack, back)
            mechanics = back.state.service.observatory.telescope("far").mechanics
            url = await stack.enter_async_context(_door(back, way))
            mount = f'[telescope.mount]\nurl = "{url}"\nmounting = "fork"\n'
            front = create_app(Settings.parse(_journal(folder, "east") + SERVICE + night + mount))
            client = await _opened(stack, front)
        assert mechanics is not None
        yield ServedNight(client, front, mechanics, frames, record)


def _journal(folder: Path, name: str) -> str:
    return f"[journal]\nurl = '{folder / name}.sqlite'\n"


async def _opened(stack: AsyncExitStack, app: FastAPI) -> httpx.AsyncClient:
    await stack.enter_async_context(app.router.lifespan_context(app))
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    return await stack.enter_async_context(
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60)
    )


@asynccontextmanager
async def _behind_indiserver(home: Path) -> AsyncIterator[tuple[Mechanics, str]]:
    """A fake OnStep whose line INDI's own driver has, and the URL of that device."""
    machine = Machine(mounting="fork", slew_rate_deg_s=45.0, acceleration_deg_s2=200.0)
    mechanics = Mechanics(SITE, Air(), ERRORS, machine=machine)
    server = RealIndiServer(("indi_lx200_OnStep",), home)
    with FakeOnPty(make_fake("onstep", mechanics)) as bench:
        await server.start()
        try:
            await _told_its_line(server, bench.address)
            yield mechanics, f"indi://127.0.0.1:{server.port}/{ONSTEP.replace(' ', '%20')}?poll_s=0.1"
        finally:
            await server.kill()


async def _told_its_line(server: RealIndiServer, line: str) -> None:
    """As an operator does in INDI's control panel; to connect is left to our service."""
    panel = server.device(ONSTEP)
    await panel.client.open()
    assert await panel.client.until(lambda: panel.get("DEVICE_PORT") is not None, 30.0)
    await panel.ordered(
        # a driver that fails would go on to every other port of the machine
        messages.new_switches(ONSTEP, "DEVICE_AUTO_SEARCH", {"INDI_DISABLED": True}),
        messages.new_texts(ONSTEP, "DEVICE_PORT", {"PORT": line}),
        messages.new_numbers(ONSTEP, "POLLING_PERIOD", {"PERIOD_MS": 100.0}),
        asking="DEVICE_PORT",
    )
    await panel.client.close()


@asynccontextmanager
async def _door(app: FastAPI, way: Way) -> AsyncIterator[str]:
    """The URL at which the far service hands out its mount."""
    service: Service = app.state.service
    if way == "indi":
        indi = IndiServer(service)
        await indi.start()
        host, port = indi.address
        try:
            yield f"indi://{host}:{port}/far?poll_s=0.1"
        finally:
            await indi.stop()
        return
    # the app has begun already: the server must not begin it once more
    server = uvicorn.Server(uvicorn.Config(app, port=0, lifespan="off", log_level="error"))
    server.install_signal_handlers = lambda: None  # type: ignore[attr-defined]
    serving = asyncio.create_task(server.serve())
    try:
        while not server.started:
            await asyncio.sleep(0.01)
        port = server.servers[0].sockets[0].getsockname()[1]
        yield f"alpaca+http://127.0.0.1:{port}/telescope/0?poll_s=0.1"
    finally:
        server.should_exit = True
        await serving
