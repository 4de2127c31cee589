"""A whole service on real sockets with the nova API open, frames to send, and clients' habits retold."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from functools import cache
from typing import Any
from urllib.parse import quote

import httpx
import numpy as np
from astropy.io import fits
from PIL import Image

from api.http.app import create_app
from api.http.serving import bind, make_server
from api.nova.app import NovaApp
from api.nova.server import NovaServer
from api.service import Service
from mountnav.catalog.embedded import embedded_catalog
from mountnav.settings.observatory import Settings
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from tests.api.conftest import OBSERVATORY

TRUTH = Icrs(85.0, 30.0)
SCALE_ARCSEC_PX = 4.0
WIDTH_PX, HEIGHT_PX = 800, 600
HINT: dict[str, Any] = {
    "scale_units": "arcsecperpix",
    "scale_type": "ul",
    "scale_lower": 3.8,
    "scale_upper": 4.2,
    "center_ra": 85.1,
    "center_dec": 29.95,
    "radius": 1.0,
}
"""For services without an index of the sky."""
PATIENCE_S = 120.0


class Standing:
    """The service, its nova port, and a client with one kept connection pool.

    Attributes
    ----------
    url : str
        Of the nova API, without a slash at its end.
    rest_url : str
    """

    def __init__(self, service: Service, url: str, rest_url: str, client: httpx.AsyncClient) -> None:
        self.service, self.url, self.rest_url, self.client = service, url, rest_url, client

    @property
    def app(self) -> NovaApp:
        """The application behind the port."""
        server = self.service.listeners._open["nova"]
        assert isinstance(server, NovaServer)
        assert server.app is not None
        return server.app

    async def post(self, path: str, asked: object) -> httpx.Response:
        """A url-encoded form with its JSON."""
        text = asked if isinstance(asked, str) else json.dumps(asked)
        return await self.client.post(f"{self.url}{path}", data={"request-json": text})

    async def get(self, path: str) -> httpx.Response:
        """Ask without a session."""
        return await self.client.get(f"{self.url}{path}")

    async def login(self, apikey: str = "any") -> str:
        """A session."""
        told = (await self.post("/api/login", {"apikey": apikey})).json()
        assert told["status"] == "success", told
        return str(told["session"])

    async def upload(self, content: bytes, name: str = "a.fits", **asked: Any) -> httpx.Response:
        """A file with what is asked; `session` is begun if left out."""
        asked = {"session": await self.login()} | asked if "session" not in asked else asked
        return await self.client.post(
            f"{self.url}/api/upload",
            data={"request-json": json.dumps(asked)},
            files={"file": (name, content)},
        )

    async def ended(self, told: dict[str, Any]) -> tuple[int, str]:
        """The job of an upload's reply, and its status at its end."""
        assert told["status"] == "success", told
        async with asyncio.timeout(PATIENCE_S):
            while True:
                jobs = (await self.get(f"/api/submissions/{told['subid']}")).json()["jobs"]
                if jobs:
                    status = (await self.get(f"/api/jobs/{jobs[0]}")).json()["status"]
                    if status in ("success", "failure"):
                        return jobs[0], status

    async def solved(self, content: bytes, name: str = "a.fits", **asked: Any) -> int:
        """The job of a file that is solved."""
        job, status = await self.ended((await self.upload(content, name, **asked)).json())
        assert status == "success", (await self.get(f"/joblog/{job}")).text
        return job


@asynccontextmanager
async def standing(nova: str = "", observatory: str = OBSERVATORY, **client: Any) -> AsyncIterator[Standing]:
    """Serve an observatory; `nova` is appended to its table."""
    toml = f"{observatory}\n[nova]\nenabled = true\nport = 0\n{nova}"
    app = create_app(Settings.parse(toml))
    listener = bind("127.0.0.1", 0)
    app.state.http_address = listener.getsockname()[:2]
    server = make_server(app, log_level="warning")
    serving = asyncio.create_task(server.serve(sockets=[listener]))
    try:
        async with asyncio.timeout(PATIENCE_S):
            while not server.started:
                assert not serving.done(), serving
                await asyncio.sleep(0.01)
        service: Service = app.state.service
        state = service.listeners.states["nova"]
        assert state.port is not None, state.problem
        scheme = "http" if "tls" not in nova else "https"
        async with httpx.AsyncClient(timeout=PATIENCE_S, trust_env=False, **client) as opened:
            yield Standing(
                service,
                f"{scheme}://127.0.0.1:{state.port}",
                f"http://127.0.0.1:{listener.getsockname()[1]}",
                opened,
            )
    finally:
        server.should_exit = True
        with contextlib.suppress(asyncio.CancelledError):
            await serving


@cache
def pixels() -> np.ndarray:
    """A drawn frame; row 0 is its lowest row, as in FITS."""
    optics = SimulatedOptics(WIDTH_PX, HEIGHT_PX, SCALE_ARCSEC_PX)
    instant = datetime(2026, 11, 21, tzinfo=UTC)
    return draw_frame(
        TRUTH, optics, embedded_catalog(), exposure_s=2.0, mid_exposure_utc=instant, seed=(1, 2)
    ).pixels


def as_fits(plane: np.ndarray, **cards: Any) -> bytes:
    """A FITS file."""
    file = io.BytesIO()
    fits.PrimaryHDU(plane, fits.Header(cards)).writeto(file)
    return file.getvalue()


def as_png(plane: np.ndarray) -> bytes:
    """A PNG of 8 bits, whose top row is the last one."""
    low, high = np.quantile(plane, (0.01, 0.9999))
    gray = np.clip((plane.astype(float) - low) / (high - low), 0, 1) * 255
    file = io.BytesIO()
    Image.fromarray(gray.astype(np.uint8)[::-1].copy()).save(file, "PNG")
    return file.getvalue()


def drawn() -> bytes:
    """The drawn frame as a FITS file without any hint in its header."""
    return as_fits(pixels())


def noise(seed: int = 3) -> bytes:
    """Noise alone."""
    rng = np.random.default_rng(seed)
    return as_fits(rng.normal(1000.0, 12.0, (HEIGHT_PX, WIDTH_PX)).astype(np.float32))


def stars(count: int = 60) -> tuple[list[float], list[float]]:
    """Where the brightest stars of the drawn frame are: pixels of FITS, 1-based, the brightest first."""
    from mountnav.frames import Frame
    from mountnav.measuring.measure import measure

    found = measure(Frame(pixels=pixels()))
    order = np.argsort(-found.flux)[:count]
    return (found.x_px[order] + 1.0).round(3).tolist(), (found.y_px[order] + 1.0).round(3).tolist()


def raw_form(parts: list[tuple[str, str, bytes]], boundary: str, line_end: str) -> bytes:
    """A multipart body by hand: heads' extra lines, disposition, content."""
    body = b""
    for extra, disposition, content in parts:
        head = f"--{boundary}{line_end}{extra}Content-disposition: {disposition}\r\n\r\n"
        body += head.encode() + content + line_end.encode()
    return body + f"--{boundary}--{line_end}".encode()


def unescaped_login(apikey: str) -> str:
    """As StellarSolver writes a form: the JSON as it is."""
    return f'request-json={{"apikey":"{apikey}"}}'


def escaped_login(apikey: str) -> str:
    """As N.I.N.A. writes it."""
    return "request-json=" + quote(json.dumps({"apikey": apikey}))
