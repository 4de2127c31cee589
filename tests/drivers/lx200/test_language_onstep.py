"""Our mount on the wire of a fake OnStep: fine places, refusals with reasons, evidence of a power-up."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace

import pytest

from drivers.fakes.faults import AnswerKind, Fault, RandomFaults
from drivers.lx200.fake.onstep import OnStepSpeaker
from mountnav.clock import utc_now
from mountnav.devices import Direction, PierSide, SlewOutcome, SyncOutcome, TrackingRate
from mountnav.errors import DeviceError, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.lx200.german_fakes import QUICK, SITE, beside, german, opened, switched_on


@pytest.mark.parametrize("tcp", [False, pytest.param(True, marks=pytest.mark.long)])
async def test_it_conforms(tcp: bool) -> None:
    fake = german("onstep")
    async with opened(fake, tcp=tcp) as mount:
        await mount.slew(beside(fake.mechanics.reported(), -25.0, -10.0))
        await check_mount(mount)
    assert fake.unknown == []
    # never sent: it declares the present place to be its home
    assert b":hF#" not in fake.heard


@pytest.mark.long
@pytest.mark.parametrize("dialect", ["onstep", "am5"])
async def test_a_pulse_is_over_when_the_mount_says_so(dialect: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under load it took a pulse up late, and refused to park: it was "already in motion"."""
    fake = german(dialect)
    feed = fake.feed

    def late(data: bytes) -> bytes:
        if b":Mg" in data:
            time.sleep(0.4)  # the fake's thread is what is late
        return feed(data)

    monkeypatch.setattr(fake, "feed", late)
    async with opened(fake) as mount:
        for direction in Direction:
            await mount.guide(direction, 0.2)
            assert not fake.mechanics.guiding()
        assert await mount.park() is SlewOutcome.ARRIVED


async def test_connecting_tells_who_and_sets_nothing() -> None:
    fake = german("onstep", clock_offset_s=-40.0)
    before = fake.mechanics.reported()
    async with opened(fake, site=SITE) as mount:
        assert mount.report is not None
        assert mount.report.identity == "OnStep: On-Step 10.28b"
        assert mount.report.clock_off_s == pytest.approx(-40.0, abs=1.5)
        assert mount.report.site_off_arcsec == pytest.approx(0.0, abs=0.1)
        assert mount.trusted
        assert mount.guide_rates_deg_s == pytest.approx((0.5 * 15.041 / 3600.0,) * 2, rel=1e-4)
    assert not any(command.startswith((b":S", b":M", b":h", b":CM", b":T")) for command in fake.heard)
    assert fake.mechanics.reported().dec_deg == pytest.approx(before.dec_deg, abs=1e-6)


async def test_syncs_and_slews_are_finer_than_an_arcsecond() -> None:
    fake = german("onstep")
    async with opened(fake) as mount:
        place = beside(fake.mechanics.reported(), -20.0123456, -7.654321)
        assert await mount.slew(place) is SlewOutcome.ARRIVED
        seen = beside(place, 0.0001, 0.00007)
        result = await mount.sync(seen)
        assert result.outcome is SyncOutcome.SEEN
        believed = fake.mechanics.reported()
        assert separation_arcsec(believed, replace(seen, utc=believed.utc)) < 0.01
        assert result.miss_arcsec < 0.01


async def test_refused_slews_tell_why_and_change_nothing() -> None:
    fake = german("onstep", dec_limits_deg=(-10.0, 190.0))
    async with opened(fake) as mount:
        below = Apparent((fake.mechanics.reported().ra_deg + 180.0) % 360.0, 20.0, utc_now())
        south = beside(fake.mechanics.reported(), 0.0, -64.0)
        await mount.set_tracking(False)
        for place, reason in ((below, Refusal.BELOW_HORIZON), (south, Refusal.LIMIT)):
            with pytest.raises(DeviceRefused) as refused:
                await mount.slew(place)
            assert refused.value.reason is reason
        assert not fake.mechanics.slewing()
        assert (await mount.reading()).tracking is False
        assert (await mount.slew(beside(fake.mechanics.reported(), -10.0, -5.0))) is SlewOutcome.ARRIVED
        assert (await mount.reading()).tracking is True


@pytest.mark.long
async def test_a_parked_one_refuses_until_it_is_unparked() -> None:
    fake = german("onstep")
    async with opened(fake) as mount:
        assert await mount.park() is SlewOutcome.ARRIVED
        reading = await mount.reading()
        assert (reading.parked, reading.tracking) == (True, False)
        orders = (
            lambda: mount.slew(reading.place),
            lambda: mount.sync(reading.place),
            lambda: mount.set_tracking(True),
        )
        for order in orders:
            with pytest.raises(DeviceRefused) as refused:
                await order()
            assert refused.value.reason is Refusal.PARKED
        await mount.unpark()
        reading = await mount.reading()
        assert (reading.parked, reading.tracking) == (False, True)
        assert mount.trusted


async def test_unparking_one_that_is_not_parked_is_done_already() -> None:
    """As a scheduler does at the start of each night; it refuses that away from home [ONSTEP]."""
    fake = german("onstep")
    async with opened(fake) as mount:
        assert not fake.mechanics.at_home
        await mount.unpark()
        reading = await mount.reading()
        assert (reading.parked, reading.tracking) == (False, True)


def test_a_goto_may_follow_the_beginning_of_tracking_at_once() -> None:
    """That its axis takes up speed is no motion; a key that was let go of is one until it rests."""
    fake = german("onstep")
    fake.mechanics.tracking = False
    fake.mechanics.acceleration_deg_s2 = 0.001
    speaker = OnStepSpeaker(fake.mechanics)
    here = fake.mechanics.reported()
    speaker.motion.target_ra_deg, speaker.motion.target_dec_deg = here.ra_deg - 1.0, here.dec_deg - 1.0
    assert speaker.say("Te") == b"1"
    assert fake.mechanics.slewing()
    assert speaker.say("MS") == b"0"
    other = OnStepSpeaker(german("onstep").mechanics)
    other.motion.target_ra_deg, other.motion.target_dec_deg = here.ra_deg - 1.0, here.dec_deg - 1.0
    other.say("Mn")
    assert other.say("MS") == b"8"


@pytest.mark.long
async def test_a_sync_on_the_other_side_of_the_pier_is_refused() -> None:
    fake = german("onstep", meridian_limits_deg=(5.0, 5.0))
    async with opened(fake) as mount:
        await mount.slew(beside(fake.mechanics.reported(), -30.0, -10.0))
        assert (await mount.reading()).pier_side is PierSide.EAST
        across = beside(fake.mechanics.reported(), 60.0, 0.0)
        assert await mount.destination_side(across) is PierSide.WEST
        with pytest.raises(DeviceRefused) as refused:
            await mount.sync(across)
        assert refused.value.reason is Refusal.LIMIT
        assert await mount.slew(across) is SlewOutcome.ARRIVED
        assert (await mount.reading()).pier_side is PierSide.WEST


async def test_one_just_switched_on_is_not_trusted_until_a_sync_is_seen() -> None:
    fake = switched_on("onstep")
    async with opened(fake) as mount:
        assert not mount.trusted
        reading = await mount.reading()
        assert (reading.at_home, reading.tracking) == (True, False)
        assert reading.pier_side is PierSide.UNKNOWN
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(beside(reading.place, 10.0, -20.0))  # type: ignore[arg-type]
        assert refused.value.reason is Refusal.UNTRUSTED
        # nor does it take a sync before its clock is set
        with pytest.raises(DeviceRefused) as refused:
            await mount.sync(reading.place)
        assert refused.value.reason is Refusal.LIMIT
        assert "date and time" in str(refused.value)
    async with opened(fake, set_clock=True, site=SITE) as mount:
        assert not mount.trusted
        here = (await mount.reading()).place
        assert (await mount.sync(here)).outcome is SyncOutcome.SEEN
        assert mount.trusted
        assert fake.mechanics.tracking
        assert abs((fake.mechanics.believed_utc() - utc_now()).total_seconds()) < 2.0


async def test_a_reboot_is_noticed() -> None:
    fake = german("onstep", remembers_clock=False)
    told: list[str] = []
    async with opened(fake) as mount:
        mount.listen(lambda what, facts: told.append(what))
        await mount.slew(beside(fake.mechanics.reported(), -30.0, -20.0))
        assert mount.trusted
        fake.reboot()
        reading = await mount.reading()
        assert reading.at_home
        assert not mount.trusted
        assert "untrusted" in told


@pytest.mark.long
async def test_one_that_went_home_by_order_stays_trusted() -> None:
    fake = german("onstep")
    async with opened(fake) as mount:
        await mount.slew(beside(fake.mechanics.reported(), -30.0, -20.0))
        assert await mount.home() is SlewOutcome.ARRIVED
        reading = await mount.reading()
        assert (reading.at_home, reading.tracking, reading.pier_side) == (True, False, PierSide.UNKNOWN)
        assert mount.trusted
        assert await mount.slew(beside(fake.mechanics.reported(), 100.0, -50.0)) is SlewOutcome.ARRIVED
        assert (await mount.reading()).tracking is True


async def test_an_ended_park_tracks_again() -> None:
    fake = german("onstep", slew_rate_deg_s=3.0, acceleration_deg_s2=3.0)
    async with opened(fake) as mount:
        parking = asyncio.create_task(mount.park())
        while not fake.mechanics.parking:
            await asyncio.sleep(0.02)
        await mount.stop()
        assert await parking is SlewOutcome.STOPPED
        reading = await mount.reading()
        assert (reading.parked, reading.tracking, reading.slewing) == (False, True, False)


async def test_rates_and_pulses_reach_the_motors() -> None:
    fake = german("onstep")
    async with opened(fake) as mount:
        for rate in (TrackingRate.LUNAR, TrackingRate.SOLAR, TrackingRate.KING, TrackingRate.SIDEREAL):
            await mount.set_tracking(True, rate)
            assert fake.mechanics.rate is rate
        before = fake.mechanics.reported()
        await mount.guide(Direction.NORTH, 0.3)
        moved_arcsec = (fake.mechanics.reported().dec_deg - before.dec_deg) * 3600.0
        assert moved_arcsec == pytest.approx(0.3 * 0.5 * 15.04, rel=0.1)


@pytest.mark.parametrize(
    "faults",
    [
        [Fault("lose", on=b":GRH")],
        [Fault("late", on=b":GRH", delay_s=0.7)],
        [Fault("cut", on=b":GDH")],
        [Fault("garble", on=b":GU", byte=0, bit=5)],
        [Fault("garble", on=b":GDH", byte=1, bit=1), Fault("lose", on=b":GU")],
    ],
)
async def test_a_spoiled_reading_is_asked_again(faults: list[Fault]) -> None:
    fake = german("onstep")
    async with opened(fake) as mount:
        await mount.reading()
        for fault in faults:
            fake.add_fault(fault)
        reading = await mount.reading()
        assert isinstance(reading.place, Apparent)
        assert separation_arcsec(reading.place, fake.mechanics.reported()) < 1.0
        assert reading.tracking is True


@pytest.mark.long
@pytest.mark.parametrize("dialect", ["onstep", "10micron", "am5"])
async def test_no_fault_publishes_a_wrong_place(dialect: str) -> None:
    fake = german(dialect)
    async with opened(fake, timing=replace(QUICK, poll_s=0.02)) as mount:
        await mount.slew(beside(fake.mechanics.reported(), -20.0, -10.0))
        kinds: tuple[AnswerKind, ...] = ("lose", "late", "cut", "garble", "double")
        fake.chance = RandomFaults(seed=7, rate=0.1, kinds=kinds, longest_s=0.6)
        read = 0
        for _ in range(15):
            try:
                reading = await mount.reading()
            except DeviceError:
                continue
            read += 1
            believed = fake.mechanics.reported()
            assert isinstance(reading.place, Apparent)
            assert separation_arcsec(reading.place, believed) < 20.0, (reading, believed)
        assert read > 7
        assert fake.strikes
