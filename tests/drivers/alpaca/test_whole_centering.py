"""A whole centering over Alpaca: the service, its mount and its camera both behind the tests' own server."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.clock import utc_now
from mountnav.settings.observatory import Settings
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Air, Apparent
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.alpaca.alpaca_server import HERE, AlpacaServer, FakeCamera, FakeTelescope

WIDTH_PX, HEIGHT_PX = 1200, 900
OPTICS = SimulatedOptics(width_px=WIDTH_PX, height_px=HEIGHT_PX, scale_arcsec_px=6.0, rotation_deg=30.0)


class SkyCamera(FakeCamera):
    """One that sees what is truly there at the middle of its exposure."""

    def __init__(self, mechanics: Mechanics) -> None:
        super().__init__(WIDTH_PX, HEIGHT_PX)
        self.mechanics = mechanics
        self.frames = 0

    def pixels(self) -> np.ndarray[Any, Any]:
        assert self.began is not None
        self.frames += 1
        middle = self.began + timedelta(seconds=self.duration_s / 2.0)
        frame = draw_frame(
            self.mechanics.truth(middle),
            OPTICS,
            embedded_catalog(),
            exposure_s=self.duration_s,
            mid_exposure_utc=middle,
            seed=(1, self.frames),
        )
        # Alpaca has [X][Y]
        return np.asarray(np.rint(frame.pixels).clip(0, 65535)).astype(np.uint16).T


@pytest.mark.long
async def test_a_target_is_centered_over_alpaca(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # here alone a driver's test needs the faces
    from api.http.app import create_app

    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(tmp_path / "journal.sqlite"))
    errors = PointingErrors(ih_arcsec=500.0, id_arcsec=-400.0)
    machine = Machine(
        mounting="german", lowest_altitude_deg=0.0, slew_rate_deg_s=25.0, acceleration_deg_s2=150.0
    )
    zenith = Mechanics(HERE, Air(), errors, machine=machine).reported()
    start = Apparent((zenith.ra_deg - 30.0) % 360.0, 45.0, utc_now())
    mechanics = Mechanics(HERE, Air(), errors, machine=machine, start=start)
    camera = SkyCamera(mechanics)
    with AlpacaServer({"telescope/0": FakeTelescope(mechanics), "camera/0": camera}) as server:
        toml = f"""
        [solving]
        worker = false
        blind = "never"
        [site]
        latitude_deg = {HERE.latitude_deg}
        longitude_deg = {HERE.longitude_deg}
        height_m = {HERE.height_m}
        [[telescope]]
        id = "far"
        exposure_s = 0.2
        scale_arcsec_px = 6.0
        mount = {{ url = "{server.url("telescope/0", "poll_s=0.2")}", mounting = "german" }}
        camera = {{ kind = "alpaca", url = "{server.url("camera/0", "poll_s=0.05")}", gain = 20 }}
        centering = {{ settle_s = 0.0 }}
        limits = {{ sun_cone_deg = 0.0, solar_filter = true }}
        """
        app = create_app(Settings.parse(toml))
        transport = httpx.ASGITransport(app=app)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=120.0) as client,
        ):
            goal = apparent_to_icrs(Apparent(start.ra_deg, start.dec_deg - 6.0, utc_now()))
            body = {"ra_deg": goal.ra_deg, "dec_deg": goal.dec_deg, "tolerance_arcsec": 15.0}
            answer = await client.post("/v1/telescopes/far/center", params={"wait": 110}, json=body)
            job = answer.json()
            assert job["state"] == "succeeded", job["problem"]
            assert job["result"]["error_before_arcsec"] > 300.0
            assert camera.values["gain"] == 20
            # by where the tube truly looks, not by what anybody says
            assert separation_arcsec(mechanics.truth(), goal) < 20.0
