"""The judges of the fake SynScan hand control: both real INDI drivers for it.

INDI 1.9.9 converts between J2000 and the equinox of date wrongly, by up to 13″. So it is the J2000 numbers on
the wire that are compared with what the fake believes, and the driver's own with what it was asked for.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.nexstar.codec.dialect import Handset, Version
from drivers.nexstar.codec.replies import pair_from_text
from drivers.nexstar.fake import SYNC_REACH_DEG, FakeNexstar
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.chain import apparent_to_icrs, sidereal_time_deg
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi_process import Indi, running

HERE = Site(49.6, 36.9)
HEQ5 = Handset(Version(4, 39, 5, synscan=True), None, 1)
CONVERSION_ARCSEC = 20.0
"""Its bug, and some room: nutation and aberration."""
DRIVERS = {"indi_synscan_telescope": "SynScan", "indi_synscanlegacy_telescope": "SynScan Legacy"}


class Rig:
    """A fake, its driver, and what can be compared."""

    def __init__(self, indi: Indi, fake: FakeNexstar) -> None:
        self.indi, self.fake, self.mechanics = indi, fake, fake.mechanics

    def on_the_wire(self, letter: bytes) -> Icrs:
        """What the last order with this letter said."""
        sent = [command for command in self.fake.heard if command[:1] == letter][-1]
        pair = pair_from_text(sent[1:])
        return Icrs(pair.first_deg, pair.second_deg)

    def believed(self) -> Icrs:
        return apparent_to_icrs(self.mechanics.reported())

    def off_arcsec(self, place: Apparent) -> float:
        """How far the driver's own numbers lie from some."""
        return separation_arcsec(self.indi.place(), replace(place, utc=utc_now()))


def fake_heq5() -> FakeNexstar:
    now = utc_now()
    mechanics = Mechanics(
        HERE,
        Air(),
        PointingErrors(),
        machine=Machine(mounting="german"),
        slew_rate_deg_s=20.0,
        acceleration_deg_s2=40.0,
        start=Apparent((sidereal_time_deg(now, HERE) - 40.0) % 360.0, 30.0, now),
    )
    return FakeNexstar(mechanics, handset=HEQ5, sync_reach_deg=SYNC_REACH_DEG)


@pytest.mark.long
@pytest.mark.parametrize(
    ("driver", "tcp"),
    [
        ("indi_synscan_telescope", False),
        ("indi_synscan_telescope", True),
        ("indi_synscanlegacy_telescope", False),
        ("indi_synscanlegacy_telescope", True),
    ],
)
async def test_the_real_driver_believes_the_fake(tmp_path: Path, driver: str, tcp: bool) -> None:
    fake = fake_heq5()
    mechanics = fake.mechanics
    async with running(driver, DRIVERS[driver], tmp_path) as indi:
        with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
            rig = Rig(indi, fake)
            await indi.connect(bench)
            await indi.give("Number", "POLLING_PERIOD", PERIOD_MS="200")
            assert not mechanics.slewing()
            await indi.until(
                lambda: rig.off_arcsec(mechanics.reported()) < CONVERSION_ARCSEC, "agreeing at the start"
            )
            # over TCP the older driver asks for no version
            told = any("Firmware version: 4.39" in words for words in indi.said)
            assert told or (tcp and "legacy" in driver)

            start = mechanics.reported()
            target = Apparent((start.ra_deg + 12.3) % 360.0, 42.0, utc_now())
            await indi.aim("TRACK", target)
            await indi.until(mechanics.slewing, "setting out")
            await indi.until(lambda: not mechanics.slewing(), "at rest")
            await indi.until(lambda: rig.off_arcsec(target) < 1.0, "reporting what it was asked for")
            # the last two of eight digits are cut by one of the drivers: 0.08 arcseconds a step
            assert separation_arcsec(rig.on_the_wire(b"r"), rig.believed()) < 0.2
            assert rig.off_arcsec(mechanics.reported()) < CONVERSION_ARCSEC
            assert mechanics.tracking

            tube = mechanics.axes()
            shifted = Apparent((target.ra_deg + 0.3) % 360.0, target.dec_deg + 0.1, utc_now())
            await indi.aim("SYNC", shifted)
            await indi.until(lambda: rig.off_arcsec(shifted) < 1.0, "synced")
            assert separation_arcsec(rig.on_the_wire(b"s"), rig.believed()) < 0.2
            assert abs(mechanics.axes().dec_axis_deg - tube.dec_axis_deg) < 1e-6
            await indi.until(lambda: mechanics.tracking, "tracking after the sync")

            await indi.give("Switch", "TELESCOPE_PARK", PARK="On")
            await indi.until(lambda: any("Mount is parked" in words for words in indi.said), "parked")
            assert not mechanics.tracking
            assert not mechanics.slewing()
            await indi.give("Switch", "TELESCOPE_PARK", UNPARK="On")
            await indi.until(lambda: indi.values["TELESCOPE_PARK", "UNPARK"] == "On", "unparked")
            if driver == "indi_synscan_telescope":
                await indi.until(lambda: mechanics.tracking, "tracking after unparking")

            away = Apparent((target.ra_deg - 30.0) % 360.0, 0.0, utc_now())
            await indi.aim("TRACK", away)
            await indi.until(mechanics.slewing, "setting out again")
            await indi.give("Switch", "TELESCOPE_ABORT_MOTION", ABORT="On")
            await indi.until(lambda: not mechanics.slewing(), "at rest after the abort")
            # its abort switches tracking off [INDI synscandriver]
            await indi.until(lambda: not mechanics.tracking, "tracking off after the abort")
            off_arcsec = separation_arcsec(mechanics.reported(), replace(away, utc=utc_now()))
            assert off_arcsec > 3600.0
            if not tcp or "legacy" in driver:
                # over TCP the one driver is an answer behind from then on: it reads none to its abort, and
                # what it does instead (tcflush) empties no socket
                await indi.until(
                    lambda: rig.off_arcsec(mechanics.reported()) < CONVERSION_ARCSEC, "agreeing after it"
                )

            assert fake.unknown == []
            await indi.give("Switch", "CONNECTION", DISCONNECT="On")
            await indi.until(lambda: indi.values["CONNECTION", "CONNECT"] == "Off", "disconnected")


async def test_it_does_not_connect_before_the_alignment(tmp_path: Path) -> None:
    fake = fake_heq5()
    fake.aligned = False
    async with running("indi_synscan_telescope", "SynScan", tmp_path) as indi:
        with FakeOnPty(fake) as bench:
            await indi.until(lambda: "CONNECTION" in indi.states, "introduced")
            await indi.give("Switch", "DEVICE_AUTO_SEARCH", INDI_DISABLED="On")
            await indi.give("Text", "DEVICE_PORT", PORT=bench.address)
            await indi.give("Switch", "CONNECTION", CONNECT="On")
            await indi.until(lambda: any("not aligned" in words for words in indi.said), "saying why")
    assert not [command for command in fake.heard if command[:1] in b"rsT"]
