"""ZWO's words: flags, refusals by number; and our mount on its wire."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fakes.faults import Fault
from drivers.lx200.codec import am5 as codec
from drivers.lx200.codec.am5 import AM5, ParkState, Status
from drivers.lx200.codec.base import Answer
from drivers.wire.command import Command, Unreadable
from mountnav.clock import utc_now
from mountnav.devices import Direction, PierSide, SlewOutcome, SyncOutcome
from mountnav.errors import DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Site
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.lx200.german_fakes import SITE, beside, german, opened, switched_on


def whole(command: Command[Any], reply: bytes) -> Any:
    """What is understood of a reply; nothing may be understood of a part of it while more may come."""
    for end in range(len(reply)):
        assert command.read(reply[:end], False) is None, reply[:end]
    read = command.read(reply, False)
    assert read is not None
    assert read.length == len(reply)
    return read.value


@pytest.mark.parametrize(
    ("reply", "status"),
    [
        # the first is the document's own example
        (b"nNG001000060#", Status(False, False, False, True, False, False, False)),
        (b"NG000000090#", Status(True, False, False, True, False, False, False)),
        (b"G#", Status(True, True, False, True, False, False, False)),
        (b"nNHG001000060#", Status(False, False, True, True, False, False, False)),
        (b"NLZsT#", Status(True, False, False, False, True, True, True)),
    ],
)
def test_flags_are_understood(reply: bytes, status: Status) -> None:
    assert whole(codec.STATUS, reply) == status


@pytest.mark.parametrize("reply", [b"#", b"nN#", b"NGZ#", b"NNG#", b"NQG#", b"NG12x#", b"12:34:56#", b"e7#"])
def test_what_is_no_status_is_refused(reply: bytes) -> None:
    with pytest.raises(Unreadable):
        codec.STATUS.read(reply, False)


@given(st.integers(1, 99))
def test_refusals_tell_why(number: int) -> None:
    reply = b"e%d#" % number
    answers = [whole(command, reply) for command in (codec.SLEW, codec.SYNC, codec.TRACKING_ON, codec.UNPARK)]
    assert all(answer == answers[0] for answer in answers)
    assert answers[0].refusal
    expected = codec.REFUSALS.get(number, ("", Refusal.OTHER))[1]
    assert answers[0].reason is expected
    assert whole(codec.set_dec(10.0), reply) is False


def test_orders_are_taken_up() -> None:
    assert whole(codec.SLEW, b"0") == Answer()
    assert whole(codec.SYNC, b"N/A#") == Answer()
    assert whole(codec.TRACKING_OFF, b"1") == Answer()
    assert whole(codec.UNPARK, b"0").refusal
    assert whole(codec.set_ra(15.0), b"1") is True
    assert whole(codec.TRACKING, b"1#") is True
    assert whole(codec.TRACKING, b"e6#") is False
    assert whole(codec.PARK_STATE, b"2#") is ParkState.PARKED
    assert whole(codec.PIER_SIDE, b"N#") is PierSide.UNKNOWN


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (codec.SLEW, b"7"),
        (codec.SLEW, b"ex#"),
        (codec.SYNC, b"+12*34:56#"),
        (codec.TRACKING, b"2#"),
        (codec.PARK_STATE, b"4#"),
        (codec.PIER_SIDE, b"T#"),
    ],
)
def test_what_is_no_answer_is_refused(command: Command[Any], reply: bytes) -> None:
    with pytest.raises(Unreadable):
        command.read(reply, False)


def test_the_site_is_written_as_indi_writes_it() -> None:
    # recorded: `:Sg-036*54:00#` for 36.9 E
    assert AM5.write_site is not None
    latitude, longitude = AM5.write_site(Site(-33.5, 36.9))
    assert (latitude.sent, longitude.sent) == (b":St-33*30:00#", b":Sg-036*54:00#")
    assert AM5.write_site(Site(0.0, -179.99))[1].sent == b":Sg+179*59:24#"


# -- on the wire -----------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("tcp", [False, True])
async def test_it_conforms(tcp: bool) -> None:
    fake = german("am5")
    async with opened(fake, tcp=tcp) as mount:
        await mount.slew(beside(fake.mechanics.reported(), -25.0, -10.0))
        await check_mount(mount)
    assert fake.unknown == []


async def test_connecting_tells_who_and_sets_nothing() -> None:
    fake = german("am5", clock_offset_s=-40.0)
    async with opened(fake, site=SITE) as mount:
        assert mount.report is not None
        assert mount.report.identity.startswith("ZWO AM: AM5")
        assert mount.report.clock_off_s == pytest.approx(-40.0, abs=1.5)
        assert mount.resolution_arcsec == 15.0
    assert not any(command.startswith((b":S", b":M", b":h", b":CM", b":T")) for command in fake.heard)


async def test_refusals_are_told() -> None:
    fake = german("am5")
    async with opened(fake) as mount:
        below = Apparent((fake.mechanics.reported().ra_deg + 180.0) % 360.0, 20.0, utc_now())
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(below)
        assert refused.value.reason is Refusal.BELOW_HORIZON
        await mount.set_tracking(False)
        assert await mount.slew(beside(fake.mechanics.reported(), -20.0, -5.0)) is SlewOutcome.ARRIVED
        assert (await mount.reading()).tracking is True
        before = fake.mechanics.reported()
        await mount.guide(Direction.SOUTH, 0.3)
        assert fake.mechanics.reported().dec_deg < before.dec_deg


async def test_one_just_switched_on_wants_its_clock_and_a_sync() -> None:
    fake = switched_on("am5")
    async with opened(fake) as mount:
        assert not mount.trusted
        with pytest.raises(DeviceRefused) as refused:
            await mount.sync((await mount.reading()).place)
        assert refused.value.reason is Refusal.NOT_ALIGNED
    async with opened(fake, set_clock=True, set_site=True, site=SITE) as mount:
        assert not mount.trusted
        result = await mount.sync((await mount.reading()).place)
        assert result.outcome is SyncOutcome.SEEN
        assert mount.trusted
        assert fake.mechanics.tracking


@pytest.mark.long
async def test_parking_latches_and_home_does_not() -> None:
    fake = german("am5")
    async with opened(fake) as mount:
        assert await mount.home() is SlewOutcome.ARRIVED
        reading = await mount.reading()
        assert (reading.at_home, reading.parked, reading.pier_side) == (True, False, PierSide.UNKNOWN)
        assert await mount.park() is SlewOutcome.ARRIVED
        assert (await mount.reading()).parked is True
        await mount.unpark()
        assert (await mount.reading()).parked is False


@pytest.mark.long
async def test_an_old_firmware_parks_by_going_home() -> None:
    fake = german("am5")
    async with opened(fake, dialect="am5-old") as mount:
        assert await mount.park() is SlewOutcome.ARRIVED
        assert (await mount.reading()).parked is True
        assert fake.mechanics.at_home
        await mount.unpark()
        assert (await mount.reading()).tracking is True
    assert not {b":hP#", b":Gps#", b":Spu#"} & set(fake.heard)


@pytest.mark.parametrize(
    "fault",
    [
        Fault("lose", on=b":GR"),
        Fault("late", on=b":GD", delay_s=0.7),
        Fault("cut", on=b":GU"),
        Fault("garble", on=b":GD", byte=0, bit=1),
    ],
)
async def test_a_spoiled_reading_is_asked_again(fault: Fault) -> None:
    fake = german("am5")
    async with opened(fake) as mount:
        await mount.reading()
        fake.add_fault(fault)
        reading = await mount.reading()
        assert isinstance(reading.place, Apparent)
        assert separation_arcsec(reading.place, fake.mechanics.reported()) < 16.0
