"""An observatory with a night, and a scheduler of its own that draws what the fake mount truly sees."""

from __future__ import annotations

import asyncio
import io
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
from astropy.io import fits

from api.http.app import create_app
from mountnav.catalog.embedded import embedded_catalog
from mountnav.clock import utc_now
from mountnav.settings.observatory import Settings
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from tests.settings_text import SERVICE_AND_SITE

# a night is named from noon to noon, so that no test may run on the machine's time, across its noon
EVENING = datetime(2026, 11, 21, 19, 0, tzinfo=UTC)
OPTICS = SimulatedOptics(640, 480, 10.0, rotation_deg=20.0)
EXPOSURE_S = 0.3

NIGHT = (
    SERVICE_AND_SITE
    + """
[[telescope]]
id = "east"
scale_arcsec_px = 10.0
[telescope.mount]
url = "fake+lx200://"
slew_rate_deg_s = 45.0
acceleration_deg_s2 = 8.0
[telescope.mount.errors]
ih_arcsec = 150.0
id_arcsec = -120.0
[telescope.camera]
kind = "folder"
path = "/"
[telescope.night]
enabled = true
correct_by = "sync"
read_mount_every_s = 0.1
poll_s = 0.1
quiet_s = 120.0
settle_s = 0.0
folder = "{folder}"
pattern = "**/*.fits"
allowed_folders = ["{folder}/elsewhere"]
record = "{record}"
safety_file = "{safety}"
safety_max_age_s = 3600
[[telescope]]
id = "west"
mount = {{ url = "fake+lx200://" }}
camera = {{ kind = "folder", path = "/" }}
"""
)


@dataclass
class NightSite:
    """A running service with a night, over HTTP."""

    client: httpx.AsyncClient
    app: Any
    folder: Path
    record: Path
    safety: Path
    drawn: int = 0

    async def exposed(self) -> bytes:
        """A frame of where the tube truly looks, as a FITS file."""
        began = utc_now()
        await asyncio.sleep(EXPOSURE_S)
        middle = began + timedelta(seconds=EXPOSURE_S / 2)
        self.drawn += 1
        return await asyncio.to_thread(self._drawn, middle, self.drawn)

    async def night(self) -> dict[str, Any]:
        """The night, as told."""
        answer = await self.client.get("/v1/telescopes/east/night")
        assert answer.status_code == 200, answer.text
        told: dict[str, Any] = answer.json()
        return told

    async def said(self, word: str, **body: object) -> dict[str, Any]:
        """A word to the night."""
        answer = await self.client.post(f"/v1/telescopes/east/night/{word}", json=body)
        assert answer.status_code == 200, answer.text
        told: dict[str, Any] = answer.json()
        return told

    def _drawn(self, middle: datetime, number: int) -> bytes:
        mechanics = self.app.state.service.observatory.telescope("east").mechanics
        frame = draw_frame(
            mechanics.truth(middle), OPTICS, embedded_catalog(), exposure_s=2.0, mid_exposure_utc=middle,
            seed=(4, number),
        )  # fmt: skip
        hdu = fits.PrimaryHDU(frame.pixels)
        began = middle - timedelta(seconds=EXPOSURE_S / 2)
        hdu.header["DATE-OBS"] = began.replace(tzinfo=None).isoformat(timespec="milliseconds")
        hdu.header["EXPTIME"] = EXPOSURE_S
        file = io.BytesIO()
        hdu.writeto(file)
        return file.getvalue()


def night_toml(folder: Path, record: Path, safety: Path, **changes: str) -> str:
    """Settings with a night."""
    text = NIGHT.format(folder=folder, record=record, safety=safety)
    for old, new in changes.items():
        text = text.replace(old, new)
    return text


@asynccontextmanager
async def served(toml: str, folder: Path, record: Path, safety: Path):
    """Open the service in this process, without a socket; no night begins by itself, whatever the hour."""
    toml = toml.replace("enabled = true", "enabled = true\nbegin_sun_below_deg = -90", 1)
    app = create_app(Settings.parse(toml))
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as client,
    ):
        yield NightSite(client, app, folder, record, safety)


Served = AbstractAsyncContextManager[NightSite]
