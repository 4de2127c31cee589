"""An observatory without hardware: a fast fake mount on a real pseudo-terminal, a small simulated camera."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from api.http.app import create_app
from mountnav.settings.observatory import Settings
from tests.settings_text import SERVICE_AND_SITE

OBSERVATORY = (
    SERVICE_AND_SITE
    + """
[[telescope]]
id = "east"
exposure_s = 0.5
[telescope.mount]
url = "fake+lx200://"
slew_rate_deg_s = 45.0
acceleration_deg_s2 = 8.0
[telescope.mount.errors]
ih_arcsec = 300.0
id_arcsec = -240.0
[telescope.camera]
kind = "simulated"
width_px = 1200
height_px = 900
scale_arcsec_px = 4.0
[telescope.centering]
settle_s = 0.0
[[telescope]]
id = "gone"
mount = { url = "lx200+serial:///dev/there-is-no-such-port" }
camera = { kind = "folder", path = "/" }
"""
)


@pytest.fixture(autouse=True)
def _own_journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each test write into a journal of its own, and never into the user's."""
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(tmp_path / "journal.sqlite"))


Serve = Callable[[str], AbstractAsyncContextManager[httpx.AsyncClient]]


@pytest.fixture
def observatory_toml() -> str:
    """Settings with one telescope that works, `east`, and one whose port is missing, `gone`.

    Frames are solved in threads: a process for each of so many services would cost more than all the rest.
    """
    return OBSERVATORY


@pytest.fixture
def serving() -> Serve:
    """Open an application in this process, without a socket."""

    @asynccontextmanager
    async def opened(toml: str) -> AsyncIterator[httpx.AsyncClient]:
        app: FastAPI = create_app(Settings.parse(toml))
        # raise_app_exceptions off: a fault must come back as the problem a client would see
        transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as client,
        ):
            yield client

    return opened


@pytest.fixture
async def client(serving: Serve, observatory_toml: str) -> AsyncIterator[httpx.AsyncClient]:
    """Talk to the observatory."""
    async with serving(observatory_toml) as opened:
        yield opened
