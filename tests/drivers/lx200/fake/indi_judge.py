"""A real INDI driver has its way with a fake German mount: goto, track, sync, abort, park, unpark."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.lx200.fake.base import FakeLx200
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi_process import Indi, running
from tests.drivers.lx200.german_fakes import beside


@dataclass(frozen=True, slots=True)
class Judge:
    """A driver, and how finely it speaks.

    `written_arcsec` is what its targets are rounded to, `read_arcsec` how near it reports what the mount
    believes; `parks_home` when its park is the mount's home, and there is no way back but a goto.
    """

    driver: str
    device: str
    written_arcsec: float
    read_arcsec: float
    parks_home: bool = False


async def let_it_judge(judge: Judge, fake: FakeLx200, home: Path, *, tcp: bool) -> None:
    with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
        async with running(judge.driver, judge.device, home) as indi:
            await _connect(indi, bench)
            await _goto_and_track(judge, indi, fake)
            await _sync(judge, indi, fake)
            await _abort(indi, fake)
            await _park(judge, indi, fake)
            if not judge.parks_home:
                await _unpark(judge, indi, fake)
    assert fake.unknown == []


async def _connect(indi: Indi, bench: FakeOnPty | FakeOnTcp) -> None:
    await indi.until(lambda: "CONNECTION" in indi.states, "introduced")
    # some look for mounts on the network before they look at the line they are given
    mode = "CONNECTION_TCP" if isinstance(bench, FakeOnTcp) else "CONNECTION_SERIAL"
    await indi.give("Switch", "CONNECTION_MODE", **{mode: "On"})
    await indi.give("Switch", "DEVICE_LAN_SEARCH", INDI_DISABLED="On")
    await indi.give("Number", "POLLING_PERIOD", PERIOD_MS="250")
    await indi.connect(bench)
    await indi.until(lambda: ("EQUATORIAL_EOD_COORD", "RA") in indi.values, "telling a place")


async def _reports(judge: Judge, indi: Indi, fake: FakeLx200, place: Apparent) -> None:
    def agree() -> bool:
        believed = fake.mechanics.reported()
        near = separation_arcsec(believed, place) < judge.written_arcsec
        return near and separation_arcsec(indi.place(), believed) < judge.read_arcsec

    await indi.until(agree, f"at {place}")


async def _goto_and_track(judge: Judge, indi: Indi, fake: FakeLx200) -> None:
    target = beside(fake.mechanics.reported(), -31.234567, -12.345678)
    await indi.aim("TRACK", target)
    await indi.until(lambda: b":MS#" in fake.obeyed, "slewing")
    await indi.until(lambda: not fake.mechanics.slewing(), "at rest")
    await _reports(judge, indi, fake, target)
    await indi.until(lambda: indi.states["EQUATORIAL_EOD_COORD"] == "Ok", "tracking")
    assert fake.mechanics.tracking


async def _sync(judge: Judge, indi: Indi, fake: FakeLx200) -> None:
    target = beside(fake.mechanics.reported(), 0.3, 0.2)
    tube = fake.mechanics.axes()
    await indi.aim("SYNC", target)
    await _reports(judge, indi, fake, target)
    assert abs(fake.mechanics.axes().dec_axis_deg - tube.dec_axis_deg) < 1e-6


async def _abort(indi: Indi, fake: FakeLx200) -> None:
    fake.mechanics.slew_rate_deg_s = 3.0
    far = beside(fake.mechanics.reported(), -25.0, -10.0)
    await indi.aim("TRACK", far)
    await indi.until(fake.mechanics.slewing, "slewing")
    await indi.give("Switch", "TELESCOPE_ABORT_MOTION", ABORT="On")
    await indi.until(lambda: not fake.mechanics.slewing(), "stopped")
    assert separation_arcsec(fake.mechanics.reported(), far) > 3600.0
    assert fake.mechanics.tracking
    fake.mechanics.slew_rate_deg_s = 60.0


async def _park(judge: Judge, indi: Indi, fake: FakeLx200) -> None:
    await indi.give("Switch", "TELESCOPE_PARK", PARK="On")
    stands = (lambda: fake.mechanics.at_home) if judge.parks_home else (lambda: fake.mechanics.parked)
    await indi.until(stands, "parked")
    # its switch says so before it has seen it, and it takes another order then for an abort
    await indi.until(lambda: "[INFO] Mount is parked." in indi.said, "saying that it is parked")


async def _unpark(judge: Judge, indi: Indi, fake: FakeLx200) -> None:
    await indi.give("Switch", "TELESCOPE_PARK", UNPARK="On")
    await indi.until(
        lambda: indi.values["TELESCOPE_PARK", "UNPARK"] == "On" and indi.states["TELESCOPE_PARK"] != "Busy",
        "saying that it is unparked",
    )
    await indi.until(lambda: not fake.mechanics.parked, "unparked")
    await indi.until(
        lambda: separation_arcsec(indi.place(), fake.mechanics.reported()) < judge.read_arcsec + 30.0,
        "telling where it stands",
    )
