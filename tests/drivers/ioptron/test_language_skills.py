"""What iOptron mounts can do besides: park, home, track, guide, tell side, clock, site; what power takes."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from datetime import timedelta

import pytest

from drivers import registry
from drivers.fakes.bench import FakeOnPty
from drivers.generic.mount import GenericMount
from drivers.ioptron.codec.values import MountState
from drivers.ioptron.fake import FAKES, MACHINE, make_fake
from drivers.ioptron.language import IoptronLanguage
from drivers.registry import open_mount
from drivers.wire.link import link_to
from mountnav.clock import utc_now
from mountnav.devices import TRACKING_DEG_S, Direction, PierSide, Skill, SlewOutcome, TrackingRate
from mountnav.errors import BadRequest, DeviceRefused, Refusal
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.ioptron.german_fakes import (
    HERE,
    PATIENCE,
    QUICK,
    TRACKING,
    at_hour_angle,
    beside,
    fake_of,
    mechanics_of,
    opened,
)
from tests.drivers.mounts import ioptron_mount

FAST_DEG_S = 300.0
BOTH = pytest.mark.parametrize("dialect", ["v3", "v2"])


@BOTH
async def test_a_slew_changes_sides_and_the_side_is_told(dialect: str) -> None:
    fake = fake_of(dialect=dialect, slew_rate_deg_s=FAST_DEG_S)
    async with opened(fake) as mount:
        reading = await mount.reading()
        assert reading.pier_side is (PierSide.EAST if dialect == "v3" else None)
        assert await mount.slew(at_hour_angle(-30.0, 40.0)) is SlewOutcome.ARRIVED
        assert fake.mechanics.pier_side() is PierSide.WEST
        reading = await mount.reading()
        # the v2 set has no word for it
        assert reading.pier_side is (PierSide.WEST if dialect == "v3" else None)
        assert (Skill.PIER_SIDE in mount.skills) is (dialect == "v3")


@pytest.mark.parametrize("swapped", [False, True])
async def test_a_mount_that_tells_the_other_side_is_read_as_the_settings_say(swapped: bool) -> None:
    fake = fake_of()
    with FakeOnPty(fake) as bench:
        option = "?swap_sides=yes" if swapped else ""
        mount = open_mount(f"ioptron+serial://{bench.address}{option}", site=HERE)
        await mount.open()
        try:
            told = PierSide.WEST if swapped else PierSide.EAST
            assert (await mount.reading()).pier_side is told
            assert await mount.destination_side(at_hour_angle(30.0, 60.0)) is told  # type: ignore[attr-defined]
        finally:
            await mount.close()


async def test_the_side_of_a_destination_is_foretold_except_near_the_meridian() -> None:
    fake = fake_of(slew_rate_deg_s=FAST_DEG_S)
    fake.feed(b":SMT105#")
    async with opened(fake) as mount:
        assert mount.report is not None
        assert "flips 5° past the meridian" in mount.report.identity
        for ha_deg, side in ((-30.0, PierSide.WEST), (30.0, PierSide.EAST), (-120.0, PierSide.WEST)):
            place = at_hour_angle(ha_deg, 60.0)
            assert await mount.destination_side(place) is side
            assert fake.mechanics.destination_side(place) is side
        for ha_deg in (-5.0, 0.0, 5.0, 179.0):
            assert await mount.destination_side(at_hour_angle(ha_deg, 60.0)) is None


@BOTH
async def test_parked_it_rests_and_unparked_it_goes_on_being_trusted(dialect: str) -> None:
    fake = fake_of(dialect=dialect, slew_rate_deg_s=FAST_DEG_S)
    async with opened(fake) as mount:
        assert await mount.park() is SlewOutcome.ARRIVED
        reading = await mount.reading()
        assert (reading.parked, reading.tracking) == (True, False)
        assert fake.mechanics.parked
        await mount.unpark()
        reading = await mount.reading()
        # its park position is the pole, where its home is: that is no power-up
        assert (reading.parked, reading.at_home) == (False, True)
        assert mount.trusted
        await mount.set_tracking(True)
        assert fake.mechanics.tracking


@BOTH
async def test_the_park_position_is_taken_where_it_stands(dialect: str) -> None:
    fake = fake_of(dialect=dialect, slew_rate_deg_s=FAST_DEG_S)
    async with opened(fake) as mount:
        await mount.set_park()
        axes = fake.mechanics.axes()
        assert await mount.slew(at_hour_angle(50.0, 20.0)) is SlewOutcome.ARRIVED
        assert await mount.park() is SlewOutcome.ARRIVED
        parked = fake.mechanics.axes()
        # within what the sky turned between the question and the reading of the axes
        assert parked.ha_axis_deg == pytest.approx(axes.ha_axis_deg, abs=0.01)
        assert parked.dec_axis_deg == pytest.approx(axes.dec_axis_deg, abs=1e-3)


async def test_a_stop_ends_parking() -> None:
    fake = fake_of(slew_rate_deg_s=2.0)
    async with opened(fake) as mount:
        parking = asyncio.create_task(mount.park())
        while not fake.mechanics.slewing():
            await asyncio.sleep(0.01)
        await mount.stop()
        assert await parking is SlewOutcome.STOPPED
        assert not fake.mechanics.parked


async def test_home_found_by_sensors_gives_the_position_back() -> None:
    mechanics = mechanics_of(slew_rate_deg_s=FAST_DEG_S)
    fake = fake_of(mechanics)
    async with opened(fake) as mount:
        fake.reboot()
        await seen(mount, lambda: not mount.trusted)
        assert _off_arcsec(mechanics) > 3600.0
        with pytest.raises(DeviceRefused) as refusal:
            await mount.slew(at_hour_angle(30.0, 40.0))
        assert refusal.value.reason is Refusal.UNTRUSTED
        assert await mount.home() is SlewOutcome.ARRIVED
        assert b":MSH#" in fake.heard
        assert mount.trusted
        assert await mount.slew(at_hour_angle(30.0, 40.0)) is SlewOutcome.ARRIVED
        assert mechanics.pier_side() is PierSide.EAST
        assert _off_arcsec(mechanics) < 1.0


def _off_arcsec(mechanics: Mechanics) -> float:
    return separation_arcsec(mechanics.truth(), apparent_to_icrs(mechanics.reported()))


async def test_without_sensors_home_is_only_where_it_believes_it() -> None:
    machine = replace(TRACKING, home_sensor=False)
    fake = fake_of(mechanics_of(machine, slew_rate_deg_s=FAST_DEG_S), model="0028")
    async with opened(fake) as mount:
        assert Skill.FIND_HOME not in mount.skills
        assert await mount.home() is SlewOutcome.ARRIVED
        assert b":MH#" in fake.heard
        assert fake.status().state is MountState.HOME
        # it went there by an order of ours
        assert mount.trusted
        fake.reboot()
        await mount.set_tracking(True)
        fake.reboot()
        await seen(mount, lambda: not mount.trusted)


async def seen(mount: GenericMount, true: object) -> None:
    """Read until it is so."""
    assert callable(true)
    async with asyncio.timeout(30.0):
        while not true():
            await mount.reading()


@BOTH
async def test_a_mount_just_switched_on_is_not_trusted(dialect: str) -> None:
    fake = fake_of(mechanics_of(MACHINE, ha_deg=None), dialect=dialect)
    async with opened(fake) as mount:
        assert fake.status().state is MountState.HOME
        assert not mount.trusted
        assert mount.report is not None
        assert not mount.report.trusted


async def test_a_reboot_in_a_slew_is_told_and_not_hidden() -> None:
    fake = fake_of(slew_rate_deg_s=2.0)
    async with opened(fake) as mount:
        slew = asyncio.create_task(mount.slew(at_hour_angle(60.0, 10.0)))
        while not fake.mechanics.slewing():
            await asyncio.sleep(0.01)
        fake.reboot()
        assert await slew is SlewOutcome.STALLED
        assert not mount.trusted


@BOTH
async def test_it_tracks_at_the_rate_that_is_ordered(dialect: str) -> None:
    fake = fake_of(dialect=dialect)
    async with opened(fake) as mount:
        for rate in (TrackingRate.SOLAR, TrackingRate.KING, TrackingRate.SIDEREAL, TrackingRate.LUNAR):
            await mount.set_tracking(True, rate)
            assert fake.mechanics.rate is rate
            assert fake.mechanics.axis_velocity("ha") == pytest.approx(TRACKING_DEG_S[rate])
        await mount.set_tracking(False)
        assert fake.mechanics.axis_velocity("ha") == pytest.approx(0.0)
        assert (await mount.reading()).tracking is False
    async with opened(fake) as again:
        assert again.report is not None
        assert any("lunar rate" in problem for problem in again.report.problems)


async def test_a_custom_rate_without_a_number_is_refused() -> None:
    fake = fake_of()
    async with opened(fake) as mount:
        fake.feed(b":RR09500#")
        with pytest.raises(BadRequest, match="does not say how fast"):
            await mount.set_tracking(True, TrackingRate.CUSTOM)
        assert fake.mechanics.axis_velocity("ha") != pytest.approx(0.95 * SIDEREAL_DEG_S)


@pytest.mark.parametrize(("dialect", "ha_deg"), [("v3", 25.0), ("v3", -25.0), ("v2", 25.0)])
async def test_pulses_go_where_they_are_named(dialect: str, ha_deg: float) -> None:
    fake = fake_of(mechanics_of(ha_deg=ha_deg), dialect=dialect)
    fake.feed(b":RG5090#")
    step_arcsec = 0.1 * SIDEREAL_DEG_S * 3600.0
    async with opened(fake) as mount:
        for direction, ra, dec in (
            (Direction.NORTH, 0.0, 0.9),
            (Direction.SOUTH, 0.0, -0.9),
            (Direction.EAST, 0.5, 0.0),
            (Direction.WEST, -0.5, 0.0),
        ):
            before = fake.mechanics.reported()
            await mount.guide(direction, 0.1)
            while fake.mechanics.guiding():
                await asyncio.sleep(0.01)
            after = fake.mechanics.reported()
            assert (after.ra_deg - before.ra_deg) * 3600.0 == pytest.approx(ra * step_arcsec, abs=0.02)
            assert (after.dec_deg - before.dec_deg) * 3600.0 == pytest.approx(dec * step_arcsec, abs=0.02)
        assert mount.trusted


@BOTH
async def test_clock_and_site_that_are_wrong_are_told(dialect: str) -> None:
    machine = replace(TRACKING, clock_offset_s=3600.0)
    fake = fake_of(mechanics_of(machine), dialect=dialect)
    fake.mechanics.set_believed_site(Site(49.6, -36.9))
    async with opened(fake) as mount:
        report = mount.report
        assert report is not None
        assert report.clock_off_s == pytest.approx(3600.0, abs=0.6)
        assert report.longitude_off_deg == pytest.approx(-73.8, abs=1e-3)
        assert any("time zone" in problem for problem in report.problems)
        assert any("sign of the longitude" in problem for problem in report.problems)


@BOTH
async def test_the_zone_and_summer_time_are_reckoned(dialect: str) -> None:
    fake = fake_of(dialect=dialect)
    fake.feed(b":SG-300#:SDS1#")
    async with opened(fake) as mount:
        assert mount.report is not None
        assert mount.report.clock_off_s == pytest.approx(0.0, abs=0.6)


@BOTH
async def test_clock_and_site_are_set_only_if_asked_for(dialect: str) -> None:
    machine = replace(TRACKING, clock_offset_s=-400.0)
    fake = fake_of(mechanics_of(machine), dialect=dialect)
    fake.feed(b":SG+120#:SDS1#:SHE0#")
    fake.mechanics.set_believed_site(Site(-10.0, 100.0))
    with FakeOnPty(fake) as bench:
        language = IoptronLanguage(link_to(bench.address, patience=PATIENCE))
        mount = GenericMount(language, timing=QUICK, site=HERE, set_clock=True, set_site=True)
        await mount.open()
        assert mount.report is not None
        assert mount.report.done == ("site set", "clock set")
        assert mount.report.problems == ()
        await mount.close()
    assert fake.mechanics.believed_site.longitude_deg == pytest.approx(36.9, abs=1e-3)
    assert abs(fake.mechanics.believed_utc() - utc_now()) < timedelta(seconds=1.0)
    assert fake.status().northern


async def test_the_wrong_hemisphere_is_told() -> None:
    fake = fake_of()
    fake.feed(b":SHE0#")
    async with opened(fake) as mount:
        assert mount.report is not None
        assert any("southern hemisphere" in problem for problem in mount.report.problems)


async def test_an_alt_azimuth_model_refuses_what_it_takes_otherwise() -> None:
    async with opened(fake_of(dialect="v2", model="0046")) as mount:
        assert Skill.GUIDE not in mount.skills
        with pytest.raises(DeviceRefused) as refusal:
            await mount.sync(beside((await mount.reading()).place, 0.1, 0.1))
        assert refusal.value.reason is Refusal.UNSUPPORTED


async def test_a_model_without_parking_refuses_it() -> None:
    fake = fake_of(dialect="v2", model="0025")
    async with opened(fake) as mount:
        with pytest.raises(DeviceRefused) as refusal:
            await mount.park()
        assert refusal.value.reason is Refusal.UNSUPPORTED
        with pytest.raises(DeviceRefused):
            await mount.language.send_park(lambda: True)
    assert b":MP1#" not in fake.heard


async def test_a_sync_while_it_slews_is_not_sent() -> None:
    fake = fake_of(slew_rate_deg_s=1.0)
    with FakeOnPty(fake) as bench:
        mount = ioptron_mount(bench.address, timing=QUICK, patience=PATIENCE)
        await mount.open()
        place = at_hour_angle(60.0, 10.0)
        fake.mechanics.slew(place)
        with pytest.raises(DeviceRefused) as refusal:
            await mount.language.send_sync(place, lambda: True)
        assert refusal.value.reason is Refusal.BUSY
        assert b":CM#" not in fake.heard
        await mount.stop()
        await mount.close()


def test_the_fake_counts_the_postures_and_takes_the_one_that_is_asked_for() -> None:
    fake = fake_of(slew_rate_deg_s=FAST_DEG_S)
    place = at_hour_angle(5.0, 45.0)
    fake.feed(b":SRA%09d#:Sd+16200000#" % round(place.ra_deg * 360_000))
    assert fake.feed(b":QAP#") == b"2#"
    # 5° west of the meridian the west side reaches it as well, with the counterweight up
    assert fake.feed(b":MS2#") == b"1"
    far = at_hour_angle(40.0, 45.0)
    fake.feed(b":SRA%09d#" % round(far.ra_deg * 360_000))
    assert fake.feed(b":QAP#:MS2#") == b"1#0"
    low = at_hour_angle(-120.0, -30.0)
    fake.feed(b":SRA%09d#:Sd-10800000#" % round(low.ra_deg * 360_000))
    assert fake.feed(b":QAP#:MS1#") == b"0#0"


def test_fakes_are_had_by_the_name_of_their_set() -> None:
    mechanics = mechanics_of()
    for name, question in zip(FAKES.dialects, (b":GEP#", b":GEC#"), strict=True):
        fake = make_fake(name, mechanics, monotonic=lambda: 0.0)
        assert fake.feed(question).endswith(b"#")
    assert registry.make_fake("ioptron", None, mechanics, monotonic=lambda: 0.0).feed(b":GEC#") == b""
    with pytest.raises(BadRequest):
        registry.make_fake("ioptron", "v9", mechanics)
