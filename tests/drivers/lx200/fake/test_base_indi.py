"""Real INDI drivers against the fake LX200s: connect, slew, track, sync, abort, park; on both wires."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.lx200.fake.base import FakeLx200
from drivers.lx200.fake.dialects import make_fake
from mountnav.clock import utc_now
from mountnav.devices import TrackingRate
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi_process import Indi, running

# they write right ascensions cut to a second of time, 15 arcsec, and declinations to one of arc
RESOLUTION_ARCSEC = 16.0
# slower than a poll, so that the drivers see a slew under way
SLEW_RATE_DEG_S = 6.0


@dataclass(frozen=True)
class Judge:
    driver: str
    device: str
    dialect: str
    parks: str = "by command"
    unparks: bool = True
    # it flushes what it has just written (TCIOFLUSH) before it asks for the side of the pier: a pty forgets
    # then what the fake has not read yet, such as the order to park; a socket forgets nothing
    flushes: bool = False


CLASSIC = Judge("indi_lx200classic", "LX200 Classic", "classic", parks="by slewing")
BASIC = Judge("indi_lx200basic", "LX200 Basic", "basic", parks="never")
GENERIC = Judge("indi_lx200generic", "Standard LX200", "generic", unparks=False)
OTHERS = [
    Judge("indi_lx200autostar", "LX200 Autostar", "autostar", unparks=False),
    Judge("indi_lx200gps", "LX200 GPS", "lx200gps"),
    Judge("indi_lx200_16", "LX200 16", "lx200-16"),
    Judge("indi_lx200ap_v2", "AstroPhysics V2", "ap", flushes=True),
]


def fake_for(judge: Judge) -> FakeLx200:
    mechanics = Mechanics(
        Site(49.6, 36.9), Air(), PointingErrors(), slew_rate_deg_s=SLEW_RATE_DEG_S, acceleration_deg_s2=20.0
    )
    return make_fake(judge.dialect, mechanics)


def beside(place: Apparent, ra_deg: float, dec_deg: float) -> Apparent:
    return Apparent((place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg, utc_now())


async def judge_it(judge: Judge, home: Path, *, tcp: bool) -> None:
    fake = fake_for(judge)
    with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
        async with running(judge.driver, judge.device, home) as indi:
            await indi.connect(bench)
            if "POLLING_PERIOD" in indi.states:
                await indi.give("Number", "POLLING_PERIOD", PERIOD_MS="250")
            await goto_and_track(indi, fake)
            await sync(indi, fake)
            await abort(indi, fake)
            if "TELESCOPE_TRACK_MODE" in indi.states:
                await rates(indi, fake)
            if judge.parks != "never":
                await park(indi, fake, judge)
    assert fake.unknown == []


async def reports(indi: Indi, fake: FakeLx200, place: Apparent) -> None:
    """The driver says what the fake believes, and both are where they were told to be."""

    def agreed() -> bool:
        believed = fake.mechanics.reported()
        near = separation_arcsec(believed, replace(place, utc=believed.utc)) < RESOLUTION_ARCSEC
        return near and separation_arcsec(indi.place(), believed) < RESOLUTION_ARCSEC

    await indi.until(agreed, f"at {place}")


async def goto_and_track(indi: Indi, fake: FakeLx200) -> None:
    target = beside(fake.mechanics.reported(), 12.0, -8.0)
    await indi.aim("TRACK", target)
    await indi.until(fake.mechanics.slewing, "slewing")
    await indi.until(lambda: not fake.mechanics.slewing(), "at rest")
    await reports(indi, fake, target)
    await indi.until(lambda: indi.states["EQUATORIAL_EOD_COORD"] != "Busy", "tracking")
    assert fake.mechanics.tracking


async def sync(indi: Indi, fake: FakeLx200) -> None:
    target = beside(fake.mechanics.reported(), 0.3, 0.2)
    tube = fake.mechanics.axes()
    await indi.aim("SYNC", target)
    await reports(indi, fake, target)
    assert abs(fake.mechanics.axes().dec_axis_deg - tube.dec_axis_deg) < 1e-6


async def abort(indi: Indi, fake: FakeLx200) -> None:
    far = beside(fake.mechanics.reported(), 60.0, -20.0)
    await indi.aim("TRACK", far)
    await indi.until(fake.mechanics.slewing, "slewing")
    await indi.give("Switch", "TELESCOPE_ABORT_MOTION", ABORT="On")
    await indi.until(lambda: not fake.mechanics.slewing(), "stopped")
    assert separation_arcsec(fake.mechanics.reported(), far) > 3600.0
    assert fake.mechanics.tracking


async def rates(indi: Indi, fake: FakeLx200) -> None:
    await indi.give("Switch", "TELESCOPE_TRACK_MODE", TRACK_LUNAR="On")
    await indi.until(lambda: fake.mechanics.rate is TrackingRate.LUNAR, "tracking at the lunar rate")
    await indi.give("Switch", "TELESCOPE_TRACK_MODE", TRACK_SIDEREAL="On")
    await indi.until(lambda: fake.mechanics.rate is TrackingRate.SIDEREAL, "tracking at the sidereal rate")


async def park(indi: Indi, fake: FakeLx200, judge: Judge) -> None:
    fake.mechanics.slew_rate_deg_s, fake.mechanics.acceleration_deg_s2 = 60.0, 200.0
    await indi.give("Switch", "TELESCOPE_PARK", PARK="On")
    await indi.until(lambda: indi.states["TELESCOPE_PARK"] == "Busy" or fake.mechanics.slewing(), "parking")
    await indi.until(
        lambda: indi.values["TELESCOPE_PARK", "PARK"] == "On" and indi.states["TELESCOPE_PARK"] == "Ok",
        "parked",
    )
    if judge.parks == "by command":
        await indi.until(lambda: fake.mechanics.parked, "at its park position")
    assert not fake.mechanics.slewing()
    if not judge.unparks:
        return
    heard = len(fake.heard)
    await indi.give("Switch", "TELESCOPE_PARK", UNPARK="On")
    await indi.until(lambda: indi.values["TELESCOPE_PARK", "UNPARK"] == "On", "unparked")
    if judge.parks == "by slewing":
        # the classic driver has no park data yet: it syncs on the origin, and the mount takes it
        await indi.until(lambda: b":CM#" in fake.heard[heard:], "synced at unparking")
        await reports(indi, fake, Apparent(0.0, 0.0, utc_now()))
    else:
        await indi.until(lambda: not fake.mechanics.parked, "free")


@pytest.mark.long
@pytest.mark.parametrize("tcp", [False, True], ids=["pty", "tcp"])
@pytest.mark.parametrize("judge", [CLASSIC, BASIC, GENERIC], ids=lambda judge: judge.dialect)
async def test_a_real_driver_gets_its_way(judge: Judge, tcp: bool, tmp_path: Path) -> None:
    await judge_it(judge, tmp_path, tcp=tcp)


@pytest.mark.long
@pytest.mark.parametrize("judge", OTHERS, ids=lambda judge: judge.dialect)
async def test_other_drivers_of_the_family_do_too(judge: Judge, tmp_path: Path) -> None:
    await judge_it(judge, tmp_path, tcp=judge.flushes)
