"""Each dialect of LX200 against its fake, over a real wire: recognized, conforming, with its own ways."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta

import pytest

from drivers import registry
from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.lx200.codec.dialect import Handshake
from drivers.lx200.codec.greeting import dialect_named, names, recognized
from drivers.lx200.fake.base import FakeLx200
from drivers.lx200.fake.dialects import make_fake
from drivers.registry import fake_dialects
from drivers.wire.exchange import Patience
from mountnav.clock import utc_now
from mountnav.devices import Direction, PierSide, Skill, SlewOutcome, TrackingRate
from mountnav.errors import BadRequest, BadSettings, DeviceError, DeviceRefused, Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent, Site
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.mounts import lx200_mount

HERE = Site(49.6, 36.9)
PATIENCE = Patience(deadline_s=2.0, try_s=0.4, quiet_s=0.05)
QUICK = Timing(poll_s=0.05, start_grace_s=0.5, rest_s=0.2, sync_wait_s=0.6, late_s=0.5, heartbeat_s=0.0)
MINE = ("generic", "classic", "autostar", "lx200gps", "basic", "gemini", "ap")
# what answers no greeting has to be named
NAMED = {"ap": "ap", "basic": "basic"}


def faked(dialect: str, machine: Machine | None = None) -> FakeLx200:
    mechanics = Mechanics(
        HERE,
        Air(),
        PointingErrors(),
        machine=machine,
        slew_rate_deg_s=20.0,
        acceleration_deg_s2=40.0,
    )
    return make_fake(dialect, mechanics)


@asynccontextmanager
async def opened(
    fake: FakeLx200,
    dialect: str | None = None,
    *,
    tcp: bool = False,
    set_site: bool = False,
    set_clock: bool = False,
) -> AsyncIterator[GenericMount]:
    with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
        mount = lx200_mount(
            bench.address,
            dialect=dialect,
            timing=QUICK,
            patience=PATIENCE,
            site=HERE,
            set_site=set_site,
            set_clock=set_clock,
        )
        await mount.open()
        try:
            yield mount
        finally:
            await mount.close()


async def beside(mount: GenericMount, ra_deg: float, dec_deg: float) -> Apparent:
    place = (await mount.reading()).place
    return Apparent((place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg, utc_now())


# -- recognition ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("handshake", "dialect"),
    [
        (Handshake("P"), "classic"),
        (Handshake("A"), "classic"),
        (Handshake("L"), "classic"),
        (Handshake("A", product="Autostar", firmware="43Eg"), "autostar"),
        (Handshake("P", product="ETX Autostar"), "autostar"),
        (Handshake("P", product="LX2001", firmware="4.2g"), "lx200gps"),
        (Handshake("P", product="Autostar II"), "lx200gps"),
        (Handshake("G", True, "Losmandy Gemini", "5.21"), "gemini"),
        (Handshake("b", True), "gemini"),
        (Handshake("P", product="My own mount"), "generic"),
        (Handshake(), "basic"),
        (Handshake(product="something"), "basic"),
    ],
)
def test_a_handshake_tells_the_dialect(handshake: Handshake, dialect: str) -> None:
    assert recognized(handshake).name == dialect


def test_every_named_dialect_and_fake_is_there() -> None:
    assert all(dialect_named(name).name for name in names())
    assert all(
        make_fake(name, Mechanics(HERE, Air(), PointingErrors())).dialect.name
        for name in fake_dialects("lx200")
    )
    assert recognized(Handshake("P", product="On-Step", firmware="10.24c")).name == "onstep"


def test_unknown_dialects_are_told_with_the_known_ones() -> None:
    with pytest.raises(BadSettings, match="gemini"):
        dialect_named("ten-micron")
    with pytest.raises(BadRequest, match="gemini"):
        registry.make_fake("lx200", "ten-micron", Mechanics(HERE, Air(), PointingErrors()))
    assert set(MINE) <= set(names())
    assert set(MINE) <= set(fake_dialects("lx200"))


# -- conformance ---------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("dialect", MINE)
async def test_conforms(dialect: str) -> None:
    fake = faked(dialect)
    async with opened(fake, NAMED.get(dialect)) as mount:
        assert mount.report is not None
        assert mount.report.problems == ()
        await check_mount(mount)
    assert set(fake.unknown) <= {b":GVP#"}


@pytest.mark.parametrize("dialect", MINE)
async def test_opening_sets_and_moves_nothing(dialect: str) -> None:
    fake = faked(dialect)
    axes = fake.mechanics.axes()
    async with opened(fake, NAMED.get(dialect), tcp=True):
        pass
    assert all(command[1:2] in (b"G", b"D", b"p", b"h", b"", b"9") for command in fake.heard), fake.heard
    assert not any(
        command.startswith((b":hP", b":hN", b":hW", b":S", b":M", b":C", b":U")) for command in fake.heard
    )
    assert fake.mechanics.axes().dec_axis_deg == axes.dec_axis_deg


# -- clock and site ------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", ["classic", "autostar", "lx200gps", "gemini", "ap"])
async def test_clock_and_site_are_compared_and_set_when_asked_for(dialect: str) -> None:
    wrong = Machine(clock_offset_s=3600.0)
    fake = faked(dialect, wrong)
    fake.mechanics.set_believed_site(Site(49.6, -36.9))
    fake.hours_to_utc = -2.0
    async with opened(fake, NAMED.get(dialect)) as mount:
        report = mount.report
        assert report is not None
        assert report.clock_off_s == pytest.approx(3600.0, abs=1.6)
        assert report.longitude_off_deg == pytest.approx(-73.8, abs=0.02)
        assert any("sign of the longitude" in problem for problem in report.problems)
    async with opened(fake, NAMED.get(dialect), set_site=True, set_clock=True) as mount:
        report = mount.report
        assert report is not None
        assert report.done == ("site set", "clock set")
        assert report.clock_off_s == pytest.approx(0.0, abs=1.6)
        assert report.site_off_arcsec is not None
        assert report.site_off_arcsec < 60.0
    assert abs((fake.mechanics.believed_utc() - utc_now()).total_seconds()) < 1.6


# -- power-ups -----------------------------------------------------------------------------------


async def test_a_classic_whose_clock_was_never_set_is_not_trusted() -> None:
    fake = faked(
        "classic",
        Machine(clock_offset_s=-(datetime.now(UTC) - datetime(2000, 1, 1, tzinfo=UTC)).total_seconds()),
    )
    async with opened(fake) as mount:
        assert not mount.trusted
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(await beside(mount, 1.0, -1.0))
        assert refused.value.reason is Refusal.UNTRUSTED


async def test_an_lx200gps_that_was_switched_off_and_on_is_not_trusted_until_synced() -> None:
    fake = faked("lx200gps")
    async with opened(fake) as mount:
        assert mount.trusted
        fake.reboot()
        await mount.reading()
        assert not mount.trusted
        await mount.sync(Apparent(120.0, 40.0, utc_now()))
        assert mount.trusted
        assert (await mount.reading()).tracking is False


async def test_a_gemini_that_waits_for_its_startup_mode_is_left_waiting() -> None:
    fake = faked("gemini")
    fake.reboot()
    with FakeOnPty(fake) as bench:
        mount = lx200_mount(bench.address, timing=QUICK, patience=PATIENCE)
        with pytest.raises(DeviceError, match="startup mode"):
            await mount.open()
        assert not any(command.startswith(b"b") for command in fake.heard)
        fake.feed(b"bC#")
        await mount.open()
        assert not mount.trusted
        await mount.close()


async def test_an_ap_controller_that_was_never_calibrated_is_not_trusted() -> None:
    fake = faked("ap")
    fake.reboot()
    async with opened(fake, "ap") as mount:
        assert not mount.trusted
        fake.mechanics.tracking = True
        await mount.sync(Apparent(120.0, 40.0, utc_now()))
        assert mount.trusted


# -- ways of their own ---------------------------------------------------------------------------


@pytest.mark.long
async def test_a_gemini_refuses_with_its_reasons() -> None:
    fake = faked("gemini")
    async with opened(fake) as mount:
        assert (await mount.reading()).pier_side is PierSide.EAST
        await mount.park()
        assert (await mount.reading()).parked is True
        fake.feed(b":Sr10:00:00#:Sd+40*00:00#")
        assert fake.feed(b":MS#") == b"7Rejected - Mount is parked!#"
        await mount.unpark()
        assert (await mount.reading()).tracking is True


async def test_an_ap_controller_recalibrates_rather_than_calibrates() -> None:
    fake = faked("ap")
    async with opened(fake, "ap") as mount:
        await mount.sync(await beside(mount, 0.1, 0.1))
    assert b":CMR#" in fake.heard
    assert b":CM#" not in fake.heard


async def test_targets_of_an_ap_controller_have_a_space() -> None:
    fake = faked("ap")
    async with opened(fake, "ap") as mount:
        assert await mount.slew(await beside(mount, 3.0, -2.0)) is SlewOutcome.ARRIVED
    assert sum(command.startswith((b":Sr ", b":Sd ")) for command in fake.heard) == 2


@pytest.mark.parametrize(
    ("dialect", "rate"),
    [("gemini", TrackingRate.KING), ("gemini", TrackingRate.LUNAR), ("ap", TrackingRate.SOLAR)],
)
async def test_tracking_rates(dialect: str, rate: TrackingRate) -> None:
    fake = faked(dialect)
    async with opened(fake, NAMED.get(dialect)) as mount:
        await mount.set_tracking(True, rate)
        assert fake.mechanics.rate is rate
        await mount.set_tracking(False)
        assert not fake.mechanics.tracking


@pytest.mark.long
async def test_parked_is_what_an_autostar_was_seen_to_do() -> None:
    fake = faked("autostar")
    async with opened(fake) as mount:
        assert (await mount.reading()).parked is None
        assert await mount.park() is SlewOutcome.ARRIVED
        assert (await mount.reading()).parked is True
        assert Skill.UNPARK not in mount.skills
        with pytest.raises(DeviceRefused):
            await mount.unpark()


@pytest.mark.parametrize("dialect", ["classic", "ap"])
async def test_guide_pulses_go_their_way_and_end(dialect: str) -> None:
    fake = faked(dialect)
    async with opened(fake, NAMED.get(dialect)) as mount:
        for direction in Direction:
            before = fake.mechanics.axes(), utc_now()
            await mount.guide(direction, 0.3)
            async with asyncio.timeout(30.0):
                # a nudge is ended by a word that is still on its way
                while fake.mechanics.slewing():
                    await asyncio.sleep(0.01)
            after = fake.mechanics.axes(), utc_now()
            tracked_deg = (after[1] - before[1]) / timedelta(seconds=1) * 360.0 / 86164.0905
            ha_arcsec = (after[0].ha_axis_deg - before[0].ha_axis_deg - tracked_deg) * 3600.0
            dec_arcsec = (after[0].dec_axis_deg - before[0].dec_axis_deg) * 3600.0
            moved = {"n": dec_arcsec, "s": -dec_arcsec, "w": ha_arcsec, "e": -ha_arcsec}[direction.value]
            still = ha_arcsec if direction in (Direction.NORTH, Direction.SOUTH) else dec_arcsec
            assert moved > 1.0, direction
            assert abs(still) < 0.5, direction


async def test_a_nudge_that_is_given_up_is_ended() -> None:
    fake = faked("classic")
    async with opened(fake) as mount:
        guiding = asyncio.create_task(mount.guide(Direction.NORTH, 30.0))
        while b":Mn#" not in fake.heard:
            await asyncio.sleep(0.01)
        guiding.cancel()
        with pytest.raises(asyncio.CancelledError):
            await guiding
        async with asyncio.timeout(30.0):
            while b":Qn#" not in fake.heard or fake.mechanics.slewing():
                await asyncio.sleep(0.01)


@pytest.mark.long
async def test_long_pulses_of_an_ap_controller_go_in_pieces() -> None:
    fake = faked("ap")
    async with opened(fake, "ap") as mount:
        await mount.guide(Direction.WEST, 1.2)
    assert [command for command in fake.heard if command.startswith(b":Mw")] == [b":Mw999#", b":Mw201#"]


async def test_what_a_minimal_clone_lacks_is_refused_as_unsupported() -> None:
    async with opened(faked("basic"), "basic") as mount:
        assert mount.skills == frozenset()
        for order in (mount.park(), mount.home(), mount.set_tracking(True), mount.guide(Direction.EAST, 0.1)):
            with pytest.raises(DeviceRefused) as refused:
                await order
            assert refused.value.reason is Refusal.UNSUPPORTED


@pytest.mark.long
async def test_a_clone_without_distance_bars_is_followed_by_its_places() -> None:
    fake = faked("generic")
    fake.faults.append(Fault("lose", on=b":D#", times=10**9))
    async with opened(fake) as mount:
        assert (await mount.reading()).slewing is None
        target = await beside(mount, 5.0, -5.0)
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        assert separation_arcsec(fake.mechanics.reported(), target) < 16.0
