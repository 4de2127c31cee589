"""10micron's words: the one-line reading, refusals, the model; and our mount on its wire."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fakes.faults import Fault
from drivers.lx200.codec import tenmicron as codec
from drivers.lx200.codec.base import Answer
from drivers.lx200.codec.tenmicron import MountStatus
from drivers.wire.command import Command, Unreadable
from mountnav.clock import utc_now
from mountnav.devices import PierSide, SlewOutcome, SyncOutcome, TrackingRate
from mountnav.errors import DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.lx200.german_fakes import SITE, beside, german, opened

# the form of the protocol document: hours with five decimals, degrees with four
INFO = b"12.67842,+42.5125,E,123.4567,+45.1234,2460000.50000000,0,0#"


def whole(command: Command[Any], reply: bytes) -> Any:
    """What is understood of a reply; nothing may be understood of a part of it while more may come."""
    for end in range(len(reply)):
        assert command.read(reply[:end], False) is None, reply[:end]
    read = command.read(reply, False)
    assert read is not None
    assert read.length == len(reply)
    return read.value


def test_one_line_tells_everything() -> None:
    info = whole(codec.INFO, INFO)
    assert info.ra.deg == pytest.approx(12.67842 * 15.0)
    assert info.dec.deg == pytest.approx(42.5125)
    assert info.ra.step_arcsec == pytest.approx(0.54)
    assert info.dec.step_arcsec == pytest.approx(0.36)
    assert info.pier_side is PierSide.EAST
    assert (info.azimuth_deg, info.altitude_deg) == (123.4567, 45.1234)
    assert info.utc == datetime(2023, 2, 25, tzinfo=UTC)
    assert info.status is MountStatus.TRACKING
    assert info.slewing is False


@pytest.mark.parametrize(
    "reply",
    [
        # a leap second's flag, a longer line of a later version, no fraction lost
        b"00.00000,-00.0001,W,000.0000,-00.5000,2460000.50000000L,5,0#",
        b"23.99999,+90.0000,E,359.9999,+90.0000,2460000.50000000,6,1,9,more#",
        b"000.00000,+00.0000,E,000.0000,+00.0000,2460000.5000,98,0#",
    ],
)
def test_other_lines_of_the_document_are_understood(reply: bytes) -> None:
    assert whole(codec.INFO, reply)


@pytest.mark.parametrize(
    "reply",
    [
        b"#",
        b"24.00000,+42.5125,E,123.4567,+45.1234,2460000.50000000,0,0#",
        b"12.67842,+92.5125,E,123.4567,+45.1234,2460000.50000000,0,0#",
        b"12.67842,+42.5125,N,123.4567,+45.1234,2460000.50000000,0,0#",
        b"12.67842,+42.5125,E,123.4567,+45.1234,2460000.50000000,12,0#",
        b"12.67842,+42.5125,E,123.4567,+45.1234,2460000.50000000,0,2#",
        b"12.67842,+42.5125,E,123.4567,+45.1234,2460000.50000000,0#",
        b"12.6784,+42.51,E,123.4567,+45.1234,2460000.50000000,0#",
        b"12.67842,+42.5125,E,123.4567,+45.1234,0460000.50000000,0,0#",
        b"12:40:42.31#",
        b"10micron GM1000HPS#",
    ],
)
def test_what_is_no_reading_is_refused(reply: bytes) -> None:
    with pytest.raises(Unreadable):
        codec.INFO.read(reply, False)


@given(st.integers(0, len(INFO) - 2), st.integers(0, 7))
def test_a_flipped_bit_is_refused_or_changes_one_number(place: int, bit: int) -> None:
    reply = bytearray(INFO)
    reply[place] ^= 1 << bit
    try:
        read = codec.INFO.read(bytes(reply), False)
    except Unreadable:
        return
    # a `#` in the middle ends it early, then it isn't whole; otherwise all numbers are still in range
    assert read is not None
    assert read.value.ra.deg < 360.0
    assert abs(read.value.dec.deg) <= 90.0


@pytest.mark.parametrize(
    ("reply", "reason"),
    [
        (b"1Object Below Horizon        #", Refusal.BELOW_HORIZON),
        (b"2Object Below Higher         #", Refusal.LIMIT),
        (b"3Cannot Perform Slew         #", Refusal.OTHER),
        (b"4Mount Parked                #", Refusal.PARKED),
        (b"5Object on the  other side   #", Refusal.LIMIT),
    ],
)
def test_slews_are_refused_in_words(reply: bytes, reason: Refusal) -> None:
    answer = whole(codec.SLEW, reply)
    assert answer.refusal == reply[1:-1].decode().strip()
    assert answer.reason is reason


def test_syncs_match_or_are_too_far() -> None:
    assert whole(codec.SLEW, b"0") == Answer()
    assert whole(codec.SYNC, b"Coordinates     matched        #") == Answer()
    assert whole(codec.SYNC, b"Match fail: dist. too large#").reason is Refusal.LIMIT
    for reply in (b"N/A#", b"12:34:56.78#", b"+42:30:45.0#"):
        with pytest.raises(Unreadable):
            codec.SYNC.read(reply, False)


def test_clock_sides_and_status() -> None:
    utc = whole(codec.GET_UTC, b"2021-12-02,23:17:52.56#")
    assert utc == datetime(2021, 12, 2, 23, 17, 52, 560_000, tzinfo=UTC)
    assert whole(codec.PIER_SIDE, b"West#") is PierSide.WEST
    assert whole(codec.DESTINATION_SIDE, b"3") is PierSide.EAST
    assert whole(codec.STATUS, b"11#") is MountStatus.NEEDS_OK
    for command, reply in (
        (codec.GET_UTC, b"2021-13-02,23:17:52.56#"),
        (codec.GET_UTC, b"23:17:52.56#"),
        (codec.PIER_SIDE, b"E#"),
        (codec.DESTINATION_SIDE, b"1"),
        (codec.STATUS, b"12#"),
    ):
        with pytest.raises(Unreadable):
            command.read(reply, False)


def test_a_model_is_entered_and_counted() -> None:
    fake = german("10micron")

    def point(number: int) -> bytes:
        return b":newalpt%02d:00:00.00,+20:00:00.0,W,00:40:02.40,20:00:36.0,02:40:00.00#" % number

    assert fake.feed(point(1)) == b"E#"
    assert fake.feed(b":newalig#") == b"V#"
    assert [fake.feed(point(number)) for number in (1, 2, 3)] == [b"001#", b"002#", b"003#"]
    assert fake.feed(b":endalig#") == b"V#"
    assert fake.feed(b"#:getalst#") == b"3#"
    assert fake.feed(b":newalig#") == b"V#"
    # too few points make none, and the old one stays
    assert fake.feed(b":endalig#") == b"E#"
    assert fake.feed(b"#:getalst#") == b"3#"
    assert fake.unknown == []


# -- on the wire -----------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("tcp", [False, True])
async def test_it_conforms(tcp: bool) -> None:
    fake = german("10micron")
    async with opened(fake, tcp=tcp) as mount:
        await mount.slew(beside(fake.mechanics.reported(), -25.0, -10.0))
        await check_mount(mount)
    assert fake.unknown == []


async def test_connecting_asks_for_ultra_precision_and_sets_nothing_else() -> None:
    fake = german("10micron", clock_offset_s=7.0)
    async with opened(fake, site=SITE) as mount:
        assert mount.report is not None
        assert mount.report.identity == "10micron: 10micron GM1000HPS 2.15.1"
        assert mount.report.clock_off_s == pytest.approx(7.0, abs=0.5)
        assert mount.report.site_off_arcsec == pytest.approx(0.0, abs=0.2)
    assert fake.heard.count(b":U2#") == 1
    assert not any(command.startswith((b":S", b":M", b":K", b":CM", b":A", b":P")) for command in fake.heard)


async def test_a_reading_is_one_question() -> None:
    fake = german("10micron")
    async with opened(fake) as mount:
        fake.heard.clear()
        reading = await mount.reading()
        assert fake.heard == [b":Ginfo#"]
        assert (reading.tracking, reading.parked, reading.pier_side) == (True, False, PierSide.EAST)


async def test_an_old_firmware_is_read_in_four_questions() -> None:
    fake = german("10micron")
    fake.take_profile({b":GVN#": b"2.13.2#"})
    async with opened(fake) as mount:
        fake.heard.clear()
        reading = await mount.reading()
        assert fake.heard == [b":GR#", b":GD#", b":Gstat#", b":pS#"]
        assert (reading.tracking, reading.parked, reading.pier_side) == (True, False, PierSide.EAST)
        assert mount.resolution_arcsec == pytest.approx(0.15)


async def test_places_are_precise_and_refusals_are_told() -> None:
    fake = german("10micron")
    async with opened(fake) as mount:
        place = beside(fake.mechanics.reported(), -20.0123456, -7.654321)
        assert await mount.slew(place) is SlewOutcome.ARRIVED
        result = await mount.sync(beside(place, 0.001, 0.001))
        assert result.outcome is SyncOutcome.SEEN
        assert result.miss_arcsec < 0.6
        below = Apparent((place.ra_deg + 180.0) % 360.0, 20.0, utc_now())
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(below)
        assert refused.value.reason is Refusal.BELOW_HORIZON
        fake.mechanics.sync_behavior = "refuse"
        with pytest.raises(DeviceRefused) as refused:
            await mount.sync(place)
        assert refused.value.reason is Refusal.LIMIT
        await mount.set_tracking(True, TrackingRate.SOLAR)
        assert fake.mechanics.rate is TrackingRate.SOLAR
        await mount.set_tracking(False)
        assert (await mount.reading()).tracking is False


@pytest.mark.long
async def test_a_parked_one_refuses_and_is_trusted_after_a_reboot() -> None:
    fake = german("10micron", boots_believing="kept", remembers_sync=True)
    async with opened(fake) as mount:
        assert await mount.park() is SlewOutcome.ARRIVED
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(beside(fake.mechanics.reported(), 10.0, -10.0))
        assert refused.value.reason is Refusal.PARKED
        fake.reboot()
        assert (await mount.reading()).parked is True
        assert mount.trusted
        await mount.unpark()
        assert (await mount.reading()).parked is False


async def test_a_clock_is_set_to_the_hundredth_when_asked() -> None:
    fake = german("10micron", clock_offset_s=-3000.0)
    async with opened(fake, set_clock=True):
        assert abs((fake.mechanics.believed_utc() - utc_now()).total_seconds()) < 0.5
    assert fake.unknown == []


@pytest.mark.parametrize(
    "fault",
    [
        Fault("lose", on=b":Ginfo"),
        Fault("late", on=b":Ginfo", delay_s=0.7),
        Fault("cut", on=b":Ginfo"),
        Fault("garble", on=b":Ginfo", byte=1, bit=1),
        Fault("garble", on=b":Ginfo", byte=10, bit=2),
    ],
)
async def test_a_spoiled_reading_is_asked_again(fault: Fault) -> None:
    fake = german("10micron")
    async with opened(fake) as mount:
        await mount.reading()
        fake.add_fault(fault)
        reading = await mount.reading()
        assert isinstance(reading.place, Apparent)
        assert separation_arcsec(reading.place, fake.mechanics.reported()) < 1.0
