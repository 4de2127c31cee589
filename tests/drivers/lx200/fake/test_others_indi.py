"""INDI's drivers of rarer LX200 mounts against their fakes: connect, slew, track, sync, abort, park."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.lx200.fake.base import FakeLx200
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi_process import Indi, running
from tests.drivers.lx200.german_fakes import SITE, beside, german

RESOLUTION_ARCSEC = 16.0


@dataclass(frozen=True)
class Judge:
    """A driver, and what it can.

    `written_arcsec` is how coarsely it writes its targets; `told_site` whether it needs to be told of site
    and time before it parks where it should; `arrives_first` whether it sees a park end only after a slew
    that ended; `parks` is what its park does to the mount, `unparks` what its unpark does.
    """

    driver: str
    device: str
    dialect: str
    written_arcsec: float = RESOLUTION_ARCSEC
    told_site: bool = False
    tcp: bool = False
    arrives_first: bool = False
    parks: Callable[[FakeLx200], bool] | None = lambda fake: fake.mechanics.parked
    unparks: Callable[[FakeLx200], bool] | None = lambda fake: not fake.mechanics.parked
    says_unparked: bool = True


def is_high(fake: FakeLx200) -> bool:
    """At the altitude of the pole or above, at rest: where these drivers park by slewing."""
    mechanics = fake.mechanics
    altitude_deg = mechanics.believed_altitude_deg(mechanics.reported())
    return not mechanics.slewing() and altitude_deg > SITE.latitude_deg - 0.1


JUDGES = [
    # it throws its own order to park away on a pseudo-terminal, see docs/reference/mounts/lx200.md
    Judge("indi_lx200gemini", "Losmandy Gemini", "gemini", parks=None),
    # the others wait for a configuration that was saved by hand
    Judge("indi_lx200ap", "AstroPhysics", "ap", parks=None),
    # it writes its order to park without the `#` and flushes its output with the next one: over a
    # pseudo-terminal one or the other is thrown away whenever the fake hasn't read it yet
    Judge("indi_lx200ap_gtocp2", "AstroPhysics GTOCP2", "ap-gtocp2", told_site=True, tcp=True),
    Judge(
        "indi_lx200fs2",
        "Astro-Electronic FS-2",
        "fs2",
        told_site=True,
        parks=is_high,
        # it syncs on the place it was parked at
        unparks=lambda fake: fake.obeyed.count(b":CM#") == 2,
    ),
    Judge(
        "indi_lx200ss2000pc",
        "SkySensor2000PC",
        "ss2000pc",
        told_site=True,
        arrives_first=True,
        parks=lambda fake: is_high(fake) and not fake.mechanics.tracking,
        unparks=lambda fake: fake.mechanics.tracking,
    ),
    # these two have no word to unpark: the next slew does
    Judge("indi_ioptronHC8406", "iOptron HC8406", "hc8406", unparks=None),
    Judge("indi_lx200gotonova", "GotoNova", "gotonova", written_arcsec=100.0, unparks=None),
    # its driver's park is the mount's home; it writes the short format
    Judge(
        "indi_lx200zeq25",
        "ZEQ25",
        "zeq25",
        written_arcsec=100.0,
        parks=lambda fake: fake.mechanics.at_home,
    ),
    # its driver waits 5 s for a `#` that doesn't come after the answer to its unpark
    Judge("indi_lx200_TeenAstro", "LX200 TeenAstro", "teenastro", says_unparked=False),
    Judge("indi_lx200pulsar2", "Pulsar2", "pulsar2"),
    # over a pseudo-terminal it throws its own orders to park away, as the Gemini's does
    Judge(
        "indi_rainbow_telescope",
        "Rainbow",
        "rainbow",
        tcp=True,
        parks=lambda fake: is_high(fake) and not fake.mechanics.tracking,
        unparks=lambda fake: fake.mechanics.tracking,
    ),
]


async def connected(judge: Judge, indi: Indi, bench: FakeOnPty | FakeOnTcp) -> None:
    await indi.until(lambda: "CONNECTION" in indi.states, "introduced")
    if not judge.tcp:
        await indi.give("Switch", "CONNECTION_MODE", CONNECTION_SERIAL="On")
    await indi.give("Number", "POLLING_PERIOD", PERIOD_MS="250")
    await indi.connect(bench)
    await indi.until(lambda: ("EQUATORIAL_EOD_COORD", "RA") in indi.values, "telling a place")
    if judge.told_site:
        now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
        where = {"LAT": str(SITE.latitude_deg), "LONG": str(SITE.longitude_deg), "ELEV": "0"}
        await indi.give("Number", "GEOGRAPHIC_COORD", **where)
        await indi.give("Text", "TIME_UTC", UTC=now, OFFSET="0")
        await indi.give("Switch", "TELESCOPE_PARK_OPTION", PARK_DEFAULT="On")


async def reports(judge: Judge, indi: Indi, fake: FakeLx200, place: Apparent) -> None:
    """The driver says what the fake believes, and both are where they were told to be."""

    def agreed() -> bool:
        believed = fake.mechanics.reported()
        near = separation_arcsec(believed, place) < judge.written_arcsec
        return near and separation_arcsec(indi.place(), believed) < RESOLUTION_ARCSEC

    await indi.until(agreed, f"at {place}")


async def arrived(judge: Judge, indi: Indi, fake: FakeLx200) -> None:
    target = beside(fake.mechanics.reported(), 21.234567, -12.345678)
    await indi.aim("TRACK", target)
    await indi.until(lambda: b":MS#" in fake.obeyed, "ordering a slew")
    await reports(judge, indi, fake, target)
    await indi.until(lambda: indi.states["EQUATORIAL_EOD_COORD"] == "Ok", "tracking")
    assert fake.mechanics.tracking


async def synced(judge: Judge, indi: Indi, fake: FakeLx200) -> None:
    target = beside(fake.mechanics.reported(), 0.3, 0.2)
    tube = fake.mechanics.axes()
    await indi.aim("SYNC", target)
    await reports(judge, indi, fake, target)
    assert abs(fake.mechanics.axes().dec_axis_deg - tube.dec_axis_deg) < 1e-6


async def aborted(indi: Indi, fake: FakeLx200) -> None:
    fake.mechanics.slew_rate_deg_s = 3.0
    far = beside(fake.mechanics.reported(), 25.0, -10.0)
    await indi.aim("TRACK", far)
    await indi.until(fake.mechanics.slewing, "slewing")
    await indi.give("Switch", "TELESCOPE_ABORT_MOTION", ABORT="On")
    await indi.until(lambda: not fake.mechanics.slewing(), "stopped")
    assert separation_arcsec(fake.mechanics.reported(), far) > 3600.0
    assert fake.mechanics.tracking
    fake.mechanics.slew_rate_deg_s = 60.0


async def parked(judge: Judge, indi: Indi, fake: FakeLx200) -> None:
    if judge.parks is None:
        return
    if judge.arrives_first:
        await arrived(judge, indi, fake)
    await indi.give("Switch", "TELESCOPE_PARK", PARK="On")
    await indi.until(lambda: judge.parks is not None and judge.parks(fake), "parked")
    await indi.until(lambda: "[INFO] Mount is parked." in indi.said, "saying that it is parked")
    await indi.give("Switch", "TELESCOPE_PARK", UNPARK="On")
    if judge.says_unparked:
        await indi.until(lambda: indi.values["TELESCOPE_PARK", "UNPARK"] == "On", "saying it is unparked")
    await indi.until(lambda: judge.unparks is None or judge.unparks(fake), "unparked")


@pytest.mark.long
@pytest.mark.parametrize("judge", JUDGES, ids=lambda judge: judge.dialect + judge.driver[10:])
async def test_a_rarer_driver_gets_its_way(judge: Judge, tmp_path: Path) -> None:
    fake = german(judge.dialect)
    with FakeOnTcp(fake) if judge.tcp else FakeOnPty(fake) as bench:
        async with running(judge.driver, judge.device, tmp_path) as indi:
            await connected(judge, indi, bench)
            await arrived(judge, indi, fake)
            await synced(judge, indi, fake)
            await aborted(indi, fake)
            await parked(judge, indi, fake)
    assert fake.unknown == []
