"""The judge of the fake motor controller: the real INDI driver drives it and must believe it."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from drivers.skywatcher.codec import Axis
from mountnav.clock import utc_now
from mountnav.devices import PierSide
from mountnav.sky.coordinates import Apparent, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi_process import Indi, running
from tests.drivers.skywatcher.quick_fakes import NORTH, SOUTH, WIRES, apart_arcsec, at, commands, quick

DRIVER, DEVICE, PACKAGE = "indi_eqmod_telescope", "EQMod Mount", "indi-eqmod"


async def tell_site_and_time(indi: Indi, site: Site) -> None:
    await indi.give(
        "Number",
        "GEOGRAPHIC_COORD",
        LAT=f"{site.latitude_deg}",
        LONG=f"{site.longitude_deg}",
        ELEV=f"{site.height_m}",
    )
    # it takes whole seconds only, and reckons its right ascension from them: told when one begins
    now = utc_now()
    await asyncio.sleep(1.0 - now.microsecond / 1e6)
    now = utc_now() + timedelta(milliseconds=100)
    await indi.give("Text", "TIME_UTC", UTC=f"{now:%Y-%m-%dT%H:%M:%S}", OFFSET="0")


async def connect(indi: Indi, wire: str, address: str) -> None:
    await indi.until(lambda: "CONNECTION" in indi.states, "introduced")
    if wire == "pty":
        await indi.give("Text", "DEVICE_PORT", PORT=address)
    else:
        await indi.give("Switch", "CONNECTION_MODE", CONNECTION_TCP="On")
        await indi.until(lambda: "CONNECTION_TYPE" in indi.states, "asking for an address")
        # datagrams are what it takes by itself
        kind = {"tcp": "TCP", "udp": "UDP"}[wire]
        await indi.give("Switch", "CONNECTION_TYPE", **{kind: "On"})
        await indi.until(lambda: indi.values["CONNECTION_TYPE", kind] == "On", f"on {kind}")
        parts = urlsplit(address)
        await indi.give("Text", "DEVICE_ADDRESS", ADDRESS=str(parts.hostname), PORT=str(parts.port))
    await indi.give("Switch", "CONNECTION", CONNECT="On")
    await indi.until(lambda: "TELESCOPE_ABORT_MOTION" in indi.states, "connected")


@pytest.mark.long
@pytest.mark.parametrize(
    ("wire", "site", "dialect"), [("pty", NORTH, "eq6"), ("tcp", NORTH, "az-eq6"), ("udp", SOUTH, "eq8")]
)
async def test_the_real_driver_believes_the_fake(tmp_path: Path, wire: str, site: Site, dialect: str) -> None:
    fake = quick(dialect, site)
    mechanics = fake.mechanics
    async with running(DRIVER, DEVICE, tmp_path, package=PACKAGE) as indi:
        with WIRES[wire](fake) as bench:
            await connect(indi, wire, bench.address)
            await tell_site_and_time(indi, site)
            await indi.give("Number", "POLLING_PERIOD", PERIOD_MS="200")
            await indi.give("Switch", "TELESCOPE_PARK", UNPARK="On")
            await indi.give("Switch", "ALIGNSYNCMODE", ALIGNSTANDARDSYNC="On")
            await indi.give("Switch", "TELESCOPE_TRACK_STATE", TRACK_ON="On")

            def off_arcsec(place: Apparent | None = None) -> float:
                now = utc_now()
                believed = replace(mechanics.reported(), utc=now)
                return separation_arcsec(replace(place or indi.place(), utc=now), believed)

            await indi.until(lambda: off_arcsec() < 2.0, "agreeing at the start")
            assert commands(fake, "F") == [b":F1\r", b":F2\r"]

            for ha_deg, side in ((-25.0, PierSide.WEST), (35.0, PierSide.EAST)):
                target = at(site, ha_deg, 0.4 * site.latitude_deg)
                indi.said.clear()
                await indi.aim("TRACK", target)
                await indi.until(lambda: any("slew is complete" in words for words in indi.said), "arrived")
                # it computes the sidereal time by itself, and leaves up to 70 arcsec of its target
                await indi.until(lambda: off_arcsec() < 3.0, "agreeing after the goto")
                assert off_arcsec(target) < 90.0
                assert mechanics.pier_side() is side
                seen = "PIER_WEST" if side is PierSide.WEST else "PIER_EAST"
                assert indi.values["TELESCOPE_PIER_SIDE", seen] == "On"

            # it tracks: half a minute of arc in two seconds if it did not
            before = mechanics.reported()
            await asyncio.sleep(2.0)
            assert apart_arcsec(mechanics.reported(), before) < 1.0

            orders = len(commands(fake, "EGHIJS"))
            shifted = replace(before, ra_deg=(before.ra_deg + 0.3) % 360.0, dec_deg=before.dec_deg + 0.1)
            await indi.aim("SYNC", shifted)
            await indi.until(lambda: apart_arcsec(indi.place(), shifted) < 3.0, "synced")
            assert commands(fake, "EGHIJS")[orders:] == []

            await indi.aim("TRACK", at(site, 75.0, 0.1 * site.latitude_deg))
            await indi.until(lambda: fake.motors[Axis.DECLINATION].status().goto, "setting out")
            await indi.give("Switch", "TELESCOPE_ABORT_MOTION", ABORT="On")
            await indi.until(lambda: not any(motor.running for motor in fake.motors.values()), "at rest")

            await indi.give("Switch", "TELESCOPE_PARK", PARK="On")
            await indi.until(lambda: any("parked" in words.lower() for words in indi.said), "parked")
            axes = mechanics.axes()
            assert axes.ha_axis_deg == pytest.approx(90.0, abs=0.01)
            assert abs(axes.dec_axis_deg) == pytest.approx(90.0, abs=0.01)
            await indi.give("Switch", "TELESCOPE_PARK", UNPARK="On")
            await indi.until(lambda: indi.values["TELESCOPE_PARK", "UNPARK"] == "On", "unparked")

            # nothing it said was beyond the fake
            assert fake.unknown == []
            await indi.give("Switch", "CONNECTION", DISCONNECT="On")
            await indi.until(lambda: indi.values["CONNECTION", "CONNECT"] == "Off", "disconnected")
