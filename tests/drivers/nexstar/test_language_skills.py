"""What hand controls do besides going places: tracking, parking, guiding, clock, site, side of the pier."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from drivers import registry
from drivers.fakes.bench import FakeOnPty
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.nexstar.codec.dialect import STARSENSE, Handset, Tracking, Version
from drivers.nexstar.fake import AVX, CELESTRON_FAKES, FakeNexstar, make_fake
from drivers.nexstar.parking import Horizon
from drivers.wire.exchange import Patience
from mountnav.clock import utc_now
from mountnav.devices import Direction, PierSide, Skill, SlewOutcome, TrackingRate
from mountnav.errors import BadRequest, DeviceRefused, Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import Air, Apparent, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.mounts import nexstar_mount

HERE = Site(49.6, 36.9)
SOUTH = Site(-33.9, 151.2)
PATIENCE = Patience(deadline_s=2.0, try_s=0.25, quiet_s=0.02)
QUICK = Timing(poll_s=0.05, start_grace_s=0.3, rest_s=0.2, heartbeat_s=0.0)
CGEM = Handset(Version(4, 21), None, 14, Version(5, 21))
HEQ5 = Handset(Version(4, 39, 5, synscan=True), None, 1)
OTHERS = [(AVX, 40.0), (HEQ5, -40.0)]


def fake_at(hour_angle_deg: float, dec_deg: float, *, site: Site = HERE, **more: Any) -> FakeNexstar:
    now = utc_now()
    mechanics = Mechanics(
        site,
        Air(),
        PointingErrors(),
        machine=Machine(mounting="german"),
        slew_rate_deg_s=30.0,
        acceleration_deg_s2=200.0,
        start=Apparent((sidereal_time_deg(now, site) - hour_angle_deg) % 360.0, dec_deg, now),
    )
    return FakeNexstar(mechanics, **more)


@asynccontextmanager
async def opened(fake: FakeNexstar, **more: Any) -> AsyncIterator[GenericMount]:
    with FakeOnPty(fake) as bench:
        mount = nexstar_mount(bench.address, patience=PATIENCE, timing=QUICK, site=HERE, **more)
        await mount.open()
        try:
            yield mount
        finally:
            await mount.close()


def orders(fake: FakeNexstar, letters: bytes) -> list[bytes]:
    return [command for command in fake.heard if command[:1] in letters]


# -- which one is it ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("handset", "can", "cannot"),
    [
        (AVX, "knows_sync tells_pier_side quarter_zones times_pulses keeps_time has_rates", "short_places"),
        (CGEM, "knows_sync tells_pier_side keeps_time mirrors_pier_side", "quarter_zones times_pulses"),
        (Handset(Version(4, 9), None, 14), "keeps_time tells_model", "knows_sync tells_pier_side"),
        (Handset(Version(1, 2)), "short_places", "tells_model tells_tracking keeps_time knows_sync"),
        # a StarSense is new although its version is not
        (
            Handset(Version(1, 20), STARSENSE, 23, Version(7, 13)),
            "knows_sync tells_pier_side times_pulses keeps_time tells_tracking",
            "quarter_zones short_places mirrors_pier_side",
        ),
        (Handset(Version(5, 31), 0x11, 22), "knows_sync keeps_time", "tells_pier_side german has_rates"),
        (
            Handset(Version(4, 39, 5, synscan=True), None, 1),
            "knows_sync tells_pier_side keeps_time synscan",
            "times_pulses has_rates quarter_zones short_places",
        ),
        (Handset(Version(3, 36, 0, synscan=True), None, 0), "keeps_time", "knows_sync tells_pier_side"),
        (Handset(Version(4, 39, 5, synscan=True), None, 130), "knows_sync", "tells_pier_side german"),
    ],
)
def test_what_a_hand_control_can_do_for_its_age(handset: Handset, can: str, cannot: str) -> None:
    assert all(getattr(handset, name) for name in can.split())
    assert not any(getattr(handset, name) for name in cannot.split())


def test_tracking_modes_by_maker_and_firmware() -> None:
    assert AVX.usual_mode(-30.0) is Tracking.EQUATORIAL_SOUTH
    assert AVX.number(Tracking.EQUATORIAL_SOUTH) == 3
    # Celestron's communication protocol: CGE and Advanced GT 3.01 to 3.04
    shifted = Handset(Version(3, 3), None, 5)
    assert shifted.mode(1) is Tracking.EQUATORIAL_NORTH
    assert shifted.number(Tracking.EQUATORIAL_SOUTH) == 2
    assert shifted.number(Tracking.OFF) == 0
    # a SynScan has one equatorial mode for both hemispheres, and one with PEC
    synscan = Handset(Version(4, 39, 5, synscan=True), None, 1)
    assert synscan.mode(3) is Tracking.EQUATORIAL
    assert synscan.number(synscan.usual_mode(-30.0)) == 2
    fork = Handset(Version(5, 31), 0x11, 22)
    assert fork.usual_mode(50.0) is Tracking.ALTAZ


async def test_identity_and_clock_are_told() -> None:
    fake = fake_at(40.0, 30.0)
    fake.mechanics.set_believed_utc(utc_now() + timedelta(hours=1))
    async with opened(fake) as mount:
        report = mount.report
        assert report is not None
        assert report.identity == "NexStar hand control 5.31, Advanced VX"
        assert report.clock_off_s == pytest.approx(3600.0, abs=0.9)
        assert "1 h, so its time zone or daylight saving is wrong" in report.problems[0]
        assert report.site_off_arcsec == pytest.approx(0.0, abs=1.0)


async def test_each_dialect_is_recognized() -> None:
    texts = {}
    for dialect in CELESTRON_FAKES.dialects:
        fake = make_fake(dialect, fake_at(40.0, 30.0).mechanics, monotonic=asyncio.get_running_loop().time)
        async with opened(fake) as mount:
            assert mount.report is not None
            texts[dialect] = mount.report.identity
    assert texts == {
        "nexstar": "NexStar hand control 5.31, Advanced VX",
        "nexstar-4": "NexStar hand control 4.21, CGEM",
        "nexstar-old": "NexStar hand control 1.02",
        "starsense": "StarSense hand control 1.20, CGX",
    }
    with pytest.raises(BadRequest, match="nexstar-9"):
        registry.make_fake("nexstar", "nexstar-9", fake.mechanics)


# -- tracking ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("site", "mode"), [(HERE, b"T\x02"), (SOUTH, b"T\x03")])
async def test_tracking_is_switched_on_in_the_mode_of_the_hemisphere(site: Site, mode: bytes) -> None:
    fake = fake_at(40.0, 10.0, site=site)
    fake.mechanics.tracking = False
    async with opened(fake) as mount:
        await mount.set_tracking(True)
        assert (await mount.reading()).tracking is True
        await mount.set_tracking(False)
        assert (await mount.reading()).tracking is False
        assert orders(fake, b"T") == [mode, b"T\0"]


async def test_tracking_is_switched_on_in_the_mode_it_had() -> None:
    fake = fake_at(40.0, 30.0)
    fake.feed(b"T\x01")
    async with opened(fake) as mount:
        await mount.set_tracking(False)
        await mount.set_tracking(True)
    assert orders(fake, b"T")[1:] == [b"T\0", b"T\x01"]


async def test_a_slew_tracks_afterwards() -> None:
    fake = fake_at(40.0, 30.0)
    fake.feed(b"T\0")
    async with opened(fake) as mount:
        there = (await mount.reading()).place
        target = Apparent(there.ra_deg, there.dec_deg + 2.0, utc_now())
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        assert (await mount.reading()).tracking is True


async def test_the_moon_is_followed_by_the_motors_own_rate() -> None:
    fake = fake_at(40.0, 30.0)
    async with opened(fake) as mount:
        await mount.set_tracking(True, TrackingRate.LUNAR)
        assert fake.mechanics.rate is TrackingRate.LUNAR
        await mount.set_tracking(True)
        assert fake.mechanics.rate is TrackingRate.SIDEREAL
        with pytest.raises(DeviceRefused) as refusal:
            await mount.set_tracking(True, TrackingRate.KING)
        assert refusal.value.reason is Refusal.UNSUPPORTED


# -- parking -----------------------------------------------------------------------------------------


async def test_it_parks_where_it_was_told_to_and_is_found_there() -> None:
    fake = fake_at(40.0, 30.0)
    async with opened(fake) as mount:
        assert Skill.PARK not in mount.skills
        with pytest.raises(DeviceRefused):
            await mount.park()
        await mount.set_park()
        start = (await mount.reading()).place
        away = Apparent(start.ra_deg, start.dec_deg + 5.0, utc_now())
        assert await mount.slew(away) is SlewOutcome.ARRIVED
        assert await mount.park() is SlewOutcome.ARRIVED
        reading = await mount.reading()
        assert (reading.parked, reading.tracking) == (True, False)
        assert not fake.mechanics.tracking
        with pytest.raises(DeviceRefused) as refusal:
            await mount.slew(away)
        assert refusal.value.reason is Refusal.PARKED
        # the line breaks and comes back: it still stands there
        await mount.close()
        await mount.open()
        assert (await mount.reading()).parked is True
        # somebody moves it at its hand control
        fake.feed(b"T\x02")
        assert (await mount.reading()).parked is False


async def test_a_stop_ends_parking() -> None:
    fake = fake_at(40.0, 30.0)
    fake.mechanics.slew_rate_deg_s = 2.0
    async with opened(fake, park=Horizon(0.0, 49.6)) as mount:
        parking = asyncio.create_task(mount.park())
        while not fake.mechanics.slewing():
            await asyncio.sleep(0.01)
        await mount.stop()
        assert await parking is SlewOutcome.STOPPED
        assert (await mount.reading()).parked is False


# -- guiding -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("handset", "hour_angle_deg"),
    [(AVX, -40.0), (CGEM, 40.0), *(pytest.param(*one, marks=pytest.mark.long) for one in OTHERS)],
)
async def test_pulses_go_where_they_say(handset: Handset, hour_angle_deg: float) -> None:
    fake = fake_at(40.0, 30.0, handset=handset)
    if hour_angle_deg < 0.0:
        # over the meridian, through the pole: the declination motor is turned over
        there = fake.mechanics.reported()
        fake.mechanics.slew_rate_deg_s = fake.mechanics.acceleration_deg_s2 = 3000.0
        fake.mechanics.slew(Apparent((there.ra_deg + 80.0) % 360.0, 30.0, utc_now()))
        while fake.mechanics.slewing():
            await asyncio.sleep(0.02)
    epoch = "icrs" if handset.synscan else "apparent"
    async with opened(fake, epoch=epoch) as mount:
        side = (await mount.reading()).pier_side
        assert side is (PierSide.EAST if hour_angle_deg > 0.0 else PierSide.WEST)
        for direction, sign in ((Direction.NORTH, 1), (Direction.SOUTH, -1)):
            before = fake.mechanics.reported()
            await mount.guide(direction, 0.2)
            moved_arcsec = (fake.mechanics.reported().dec_deg - before.dec_deg) * 3600.0
            # half the sidereal rate by the motors, twice it by the key
            assert math.copysign(1.0, moved_arcsec) == sign
            assert 1.0 < abs(moved_arcsec) < 40.0
        for direction, sign in ((Direction.WEST, -1), (Direction.EAST, 1)):
            before = fake.mechanics.reported()
            await mount.guide(direction, 0.2)
            moved_arcsec = (fake.mechanics.reported().ra_deg - before.ra_deg) * 3600.0
            assert math.copysign(1.0, moved_arcsec) == sign
        assert not fake.mechanics.slewing()
        assert fake.mechanics.tracking


@pytest.mark.long
async def test_a_long_pulse_goes_in_pieces() -> None:
    fake = fake_at(40.0, 30.0)
    async with opened(fake) as mount:
        await mount.guide(Direction.EAST, 2.8)
    pulses = [command[5] for command in orders(fake, b"P") if command[3] == 0x26]
    assert pulses == [255, 25]


# -- clock, site, side of the pier -------------------------------------------------------------------


@pytest.mark.parametrize("handset", [AVX, CGEM])
async def test_clock_and_site_are_set_only_before_the_alignment(handset: Handset) -> None:
    fake = fake_at(40.0, 30.0, handset=handset, aligned=False)
    utc = datetime(2031, 2, 3, 4, 5, 6, 400000, tzinfo=UTC)
    async with opened(fake) as mount:
        language = mount.language
        await language.write_site(Site(-33.5, 200.0))
        await language.write_clock(utc)
        site, clock = await language.read_site(), await language.read_clock()
        assert site is not None
        assert (site.latitude_deg, site.longitude_deg) == (-33.5, -160.0)
        assert clock is not None
        assert abs((clock - utc).total_seconds()) < 2.0
        fake.aligned = True
        for order in (language.write_site(HERE), language.write_clock(utc)):
            with pytest.raises(DeviceRefused, match="alignment"):
                await order
    assert len(orders(fake, b"WHI")) == 2


def test_a_zone_of_quarter_hours_is_read() -> None:
    fake = fake_at(40.0, 30.0)
    # Kathmandu: 5 h 45 min; and the whole hours of the older word
    assert fake.feed(b"I" + bytes([5, 45, 0, 1, 2, 30, 23, 0])) == b"#"
    assert fake.feed(b"i")[6:8] == bytes([23, 0])
    assert fake.mechanics.believed_utc().replace(second=0, microsecond=0) == datetime(
        2030, 1, 2, 0, 0, tzinfo=UTC
    )


@pytest.mark.parametrize(
    ("handset", "letter"),
    [(AVX, b"W#"), (CGEM, b"E#"), (Handset(Version(1, 20), STARSENSE, 23, Version(7, 13)), b"W#")],
)
async def test_the_letter_of_the_pier_side_is_mirrored_in_the_south_by_old_ones(
    handset: Handset, letter: bytes
) -> None:
    fake = fake_at(40.0, 10.0, site=SOUTH, handset=handset)
    assert fake.mechanics.pier_side() is PierSide.EAST
    assert fake.feed(b"p") == letter
    async with opened(fake) as mount:
        assert (await mount.reading()).pier_side is PierSide.EAST


async def test_a_reboot_forgets_alignment_and_clock() -> None:
    fake = fake_at(40.0, 30.0)
    forgetful = Machine(mounting="german", remembers_clock=False)
    fake.mechanics.machine = forgetful
    fake.reboot()
    assert fake.feed(b"J") == b"\x00#"
    assert fake.feed(b"t") == b"\x00#"
    assert fake.feed(b"i")[3:6] == bytes([1, 1, 0])
    before = fake.mechanics.reported()
    place = fake.feed(b"e")[:-1]
    assert fake.feed(b"s" + place) == b"#"
    assert separation_arcsec(before, fake.mechanics.reported()) < 60.0
