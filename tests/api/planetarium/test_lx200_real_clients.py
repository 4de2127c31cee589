"""INDI's own LX200 drivers as clients of our LX200 server: programs that others wrote for real mounts."""

from __future__ import annotations

from pathlib import Path

import pytest

from api.planetarium.lx200_server import Lx200Server
from mountnav.clock import utc_now
from mountnav.sky.coordinates import Apparent
from tests.api.indi_server.face_rig import apart_arcsec, mechanics_of, observatory
from tests.drivers.indi_process import Indi, running


async def connected(indi: Indi, server: Lx200Server) -> None:
    host, port = server.address
    await indi.until(lambda: "CONNECTION" in indi.states, "introduced")
    await indi.give("Switch", "CONNECTION_MODE", CONNECTION_TCP="On")
    await indi.until(lambda: "DEVICE_ADDRESS" in indi.states, "asking for an address")
    await indi.give("Text", "DEVICE_ADDRESS", ADDRESS=host, PORT=str(port))
    await indi.give("Switch", "CONNECTION", CONNECT="On")
    await indi.until(lambda: "TELESCOPE_ABORT_MOTION" in indi.states, "connected")


@pytest.mark.long
@pytest.mark.parametrize(
    ("driver", "device"),
    [
        ("indi_lx200basic", "LX200 Basic"),
        ("indi_lx200classic", "LX200 Classic"),
        ("indi_lx200autostar", "LX200 Autostar"),
    ],
)
async def test_indis_driver_moves_syncs_and_stops_it(driver: str, device: str, tmp_path: Path) -> None:
    async with observatory(tmp_path) as service:
        server = Lx200Server(service)
        await server.start()
        await service.dispatcher.watch("east").refresh()
        mechanics = mechanics_of(service)
        try:
            async with running(driver, device, tmp_path / "home") as indi:
                await connected(indi, server)
                await indi.until(lambda: ("EQUATORIAL_EOD_COORD", "RA") in indi.values, "reading")
                await indi.until(
                    lambda: apart_arcsec(indi.place(), mechanics.reported(utc_now())) < 30.0, "reading it"
                )
                here = mechanics.reported(utc_now())
                there = Apparent(here.ra_deg, here.dec_deg - 0.3, utc_now())
                await indi.aim("TRACK", there)
                await indi.until(
                    lambda: apart_arcsec(mechanics.reported(utc_now()), there) < 30.0, "where it was sent"
                )
                await indi.until(
                    lambda: indi.states["EQUATORIAL_EOD_COORD"] == "Ok", "arrived for the driver"
                )
                aside = Apparent(there.ra_deg, there.dec_deg + 0.1, utc_now())
                await indi.aim("SYNC", aside)
                await indi.until(
                    lambda: apart_arcsec(mechanics.reported(utc_now()), aside) < 30.0, "where it was synced"
                )
                await indi.aim("TRACK", Apparent(there.ra_deg, -60.0, utc_now()))
                await indi.until(lambda: indi.states["EQUATORIAL_EOD_COORD"] == "Alert", "refused")
                await indi.give("Switch", "TELESCOPE_ABORT_MOTION", ABORT="On")
                await indi.until(lambda: indi.states["TELESCOPE_ABORT_MOTION"] in ("Ok", "Idle"), "stopped")
                assert apart_arcsec(mechanics.reported(utc_now()), aside) < 30.0
        finally:
            await server.stop()
        kinds = [job.kind for job in service.jobs.all()]
        assert kinds == ["sync-to", "slew"], (kinds, indi.said)
