"""The NexStar driver against the fake hand control over real wires: pseudo-terminals and TCP."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise
from typing import Any

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.nexstar.codec import base
from drivers.nexstar.codec.dialect import Handset, Version
from drivers.nexstar.codec.passthrough import Axis
from drivers.nexstar.fake import FakeNexstar
from drivers.nexstar.family import NEXSTAR, SYNSCAN
from drivers.nexstar.parking import Horizon
from drivers.registry import MountUrl
from drivers.wire.exchange import Patience
from mountnav.clock import utc_now
from mountnav.devices import SlewOutcome, SyncOutcome
from mountnav.errors import BadRequest, BadSettings, DeviceMissing, DeviceRefused, Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.chain import apparent_to_icrs, sidereal_time_deg
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.mounts import nexstar_mount

HERE = Site(49.6, 36.9)
PATIENCE = Patience(deadline_s=2.0, try_s=0.25, quiet_s=0.02)
QUICK = Timing(poll_s=0.05, start_grace_s=0.3, rest_s=0.2, heartbeat_s=0.0, resting_arcsec=10.0)
OLD = Handset(Version(1, 2))


def fake_at_zenith(*, slew_rate_deg_s: float = 30.0, german: bool = False, **more: Any) -> FakeNexstar:
    machine = Machine(mounting="german" if german else "fork")
    mechanics = Mechanics(
        HERE,
        Air(),
        PointingErrors(),
        machine=machine,
        slew_rate_deg_s=slew_rate_deg_s,
        acceleration_deg_s2=200.0,
        start=in_the_west() if german else None,
    )
    return FakeNexstar(mechanics, **more)


@asynccontextmanager
async def opened(
    fake: FakeNexstar, timing: Timing = QUICK, *, tcp: bool = False, **more: Any
) -> AsyncIterator[GenericMount]:
    with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
        mount = nexstar_mount(bench.address, patience=PATIENCE, timing=timing, site=HERE, **more)
        await mount.open()
        try:
            yield mount
        finally:
            await mount.close()


def in_the_west() -> Apparent:
    """Away from the meridian: a degree to the north or south is no reason to change sides."""
    now = utc_now()
    return Apparent((sidereal_time_deg(now, HERE) - 40.0) % 360.0, 30.0, now)


def beside(place: Apparent | Icrs, ra_deg: float, dec_deg: float) -> Apparent:
    return Apparent((place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg, utc_now())


async def read_often(mount: GenericMount, times: int) -> None:
    for _ in range(times):
        await mount.reading()


@pytest.mark.parametrize(
    ("tcp", "german"),
    [(False, True), pytest.param(True, False, marks=pytest.mark.long)],
)
async def test_conforms(tcp: bool, german: bool) -> None:
    park = Horizon(250.0, 40.0) if german else Horizon(180.0, 80.0)
    async with opened(fake_at_zenith(german=german), tcp=tcp, park=park) as mount:
        await check_mount(mount)


@pytest.mark.long
async def test_conforms_in_j2000() -> None:
    async with opened(fake_at_zenith(epoch="icrs"), epoch="icrs") as mount:
        await check_mount(mount)


async def test_reading_is_where_the_fake_believes_to_point() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        reading = await mount.reading()
        assert isinstance(reading.place, Apparent)
        assert separation_arcsec(reading.place, fake.mechanics.reported(reading.utc)) < 1.0
    # the same hand control in J2000 is 20 arcminutes off for whoever takes it for JNow
    fake = fake_at_zenith(epoch="icrs")
    async with opened(fake, epoch="icrs") as mount:
        reading = await mount.reading()
        assert isinstance(reading.place, Icrs)
        believed = fake.mechanics.reported(reading.utc)
        assert separation_arcsec(reading.place, apparent_to_icrs(believed)) < 1.0
        assert separation_arcsec(reading.place, Icrs(believed.ra_deg, believed.dec_deg)) > 300.0


async def test_opening_moves_syncs_and_sets_nothing() -> None:
    fake = fake_at_zenith()
    async with opened(fake):
        pass
    asked = {command[:1] for command in fake.heard}
    assert asked == {b"K", b"V", b"v", b"m", b"P", b"e", b"w", b"J", b"L", b"t", b"p", b"i"}
    # of the boards only those that are always there, and only questions: version and guide rate
    assert {command[2:4] for command in fake.heard if command[:1] == b"P"} == {
        b"\x10\xfe",
        b"\x11\xfe",
        b"\x10\x47",
    }


async def test_an_old_hand_control_is_asked_in_the_short_form() -> None:
    fake = fake_at_zenith(handset=OLD)
    async with opened(fake) as mount:
        assert mount.resolution_arcsec == pytest.approx(19.78, abs=0.01)
        target = beside((await mount.reading()).place, 2.0, -2.0)
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        assert fake.heard.count(base.slew(target.ra_deg, target.dec_deg, short=True).sent) == 1
        with pytest.raises(DeviceRefused, match=r"1\.02 has no sync command") as refusal:
            await mount.sync(target)
        assert refusal.value.reason is Refusal.UNSUPPORTED
    # what it was asked and does not know: its kind
    assert set(fake.unknown) == {b"v"}


async def test_stop_ends_a_slew() -> None:
    fake = fake_at_zenith(slew_rate_deg_s=1.0)
    async with opened(fake) as mount:
        slew = asyncio.create_task(mount.slew(beside((await mount.reading()).place, 40.0, -20.0)))
        while not fake.mechanics.slewing():
            await asyncio.sleep(0.01)
        await mount.stop()
        assert await slew is SlewOutcome.STOPPED
        assert not fake.mechanics.slewing()
        assert fake.mechanics.tracking
        # the answers to the stop have not become those of the next questions
        reading = await mount.reading()
        assert (reading.slewing, reading.tracking) == (False, True)


async def test_stop_is_not_queued_behind_a_reply_that_does_not_come() -> None:
    fake = fake_at_zenith(slew_rate_deg_s=1.0)
    async with opened(fake) as mount:
        slew = asyncio.create_task(mount.slew(beside((await mount.reading()).place, 40.0, -20.0)))
        while not fake.mechanics.slewing():
            await asyncio.sleep(0.01)
        fake.faults.append(Fault("lose", on=b"e", times=1))
        asked = len(fake.heard)
        while b"e" not in fake.heard[asked:]:
            await asyncio.sleep(0.005)
        before = len(fake.heard)
        stop = asyncio.create_task(mount.stop())
        while len(fake.heard) == before:
            await asyncio.sleep(0.005)
        assert fake.heard[before] == b"M"
        await stop
        assert await slew is SlewOutcome.STOPPED


async def test_stop_ends_what_the_keys_began() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        fake.mechanics.move("n", 0.5)
        await mount.stop()
        assert not fake.mechanics.slewing()
        assert fake.mechanics.tracking


async def test_a_slew_into_the_limits_is_refused() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        with pytest.raises(DeviceRefused, match="didn't move"):
            await mount.slew(Apparent((await mount.reading()).place.ra_deg, -80.0, utc_now()))
        assert not fake.mechanics.slewing()


async def test_an_unaligned_mount_is_not_sent_anywhere() -> None:
    fake = fake_at_zenith(aligned=False)
    async with opened(fake) as mount:
        assert mount.report is not None
        assert not mount.report.trusted
        assert "not aligned" in mount.report.problems[0]
        place = beside((await mount.reading()).place, 1.0, -1.0)
        with pytest.raises(DeviceRefused) as untrusted:
            await mount.slew(place)
        assert untrusted.value.reason is Refusal.UNTRUSTED
        # neither the word of an operator nor a sync makes an alignment
        mount.trust()
        for order in (mount.slew(place), mount.sync(place)):
            with pytest.raises(DeviceRefused, match="not aligned") as refusal:
                await order
            assert refusal.value.reason is Refusal.NOT_ALIGNED
    assert not [command for command in fake.heard if command[:1] in b"rRsS"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "on"),
    [
        *((kind, b"e") for kind in ("lose", "cut", "garble", "late")),
        ("late", b"L"),
        ("cut", b"t"),
        ("garble", b"J"),
        ("lose", b"p"),
    ],
)
async def test_one_bad_answer_never_shows(kind: str, on: bytes) -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        before = await mount.reading()
        # later than one try, within the deadline: it comes when another question is out
        fake.faults.append(Fault(kind, on=on, delay_s=0.4))  # type: ignore[arg-type]
        for _ in range(4):
            now = await mount.reading()
            assert separation_arcsec(now.place, before.place) < 30.0  # type: ignore[type-var]
            assert (now.slewing, now.tracking, now.parked) == (False, True, False)
            assert now.pier_side is before.pier_side
        assert mount.trusted


@pytest.mark.long
@pytest.mark.parametrize("byte", [0, 4, 8, 9, 17])
async def test_a_flipped_bit_is_never_published(byte: int) -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        places = [(await mount.reading()).place]
        for bit in (0, 2, 5, 7):
            fake.faults.append(Fault("garble", on=b"e", byte=byte, bit=bit))
            places.append((await mount.reading()).place)
        for before, after in pairwise(places):
            # the lowest digits can't be told from a little motion
            assert separation_arcsec(before, after) < 30.0  # type: ignore[type-var]


async def test_lost_answers_are_not_sent_again() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        fake.faults += [Fault("lose", on=b"r"), Fault("lose", on=b"s")]
        target = beside((await mount.reading()).place, 5.0, -5.0)
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        # its answer lost, it is seen in the readings all the same
        result = await mount.sync(beside(target, 0.1, -0.1))
        assert result.outcome is SyncOutcome.SEEN
        assert len([command for command in fake.heard if command[:1] in b"rs"]) == 2


async def test_a_late_answer_of_an_order_is_not_that_of_the_next() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        start = (await mount.reading()).place
        # the sync is ignored, and its '#' comes after its try, when the slew is about to be sent
        fake.faults += [
            Fault("sync-ignored", on=b"s", for_s=60.0),
            Fault("late", on=b"s", delay_s=0.3),
            Fault("lose", on=b"r"),
        ]
        language = mount.language
        sent = await language.send_sync(beside(start, 1.0, -1.0), lambda: True)
        assert sent.lost is not None
        sent = await language.send_slew(beside(start, 1.0, -1.0), lambda: True)
        # the late '#' did not stand in for the one that was lost
        assert sent.lost is not None
        sent = await language.send_slew(beside(start, 1.0, -1.0), lambda: True)
        assert sent.lost is None


async def test_a_cut_connection_is_opened_again() -> None:
    with FakeOnTcp(fake_at_zenith()) as bench:
        mount = nexstar_mount(bench.address, patience=PATIENCE, timing=QUICK)
        with pytest.raises(DeviceMissing):
            await mount.reading()
        await mount.open()
        bench.hang_up()
        with pytest.raises(DeviceMissing):
            await read_often(mount, 100)
        assert (await mount.reading()).slewing is False
        # whatever happened meanwhile: nobody has looked at the sky
        assert not mount.trusted
        await mount.close()


async def test_a_reboot_is_noticed() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        assert mount.trusted
        fake.reboot()
        await mount.reading()
        assert not mount.trusted


async def test_other_kind_of_place_is_refused() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        heard = len(fake.heard)
        with pytest.raises(BadRequest, match="convert"):
            await mount.slew(Icrs(10.0, 20.0))
        assert len(fake.heard) == heard


async def test_a_timed_pulse_moves_and_ends() -> None:
    fake = fake_at_zenith()
    before = fake.mechanics.reported().dec_deg
    assert fake.feed(base.guide(Axis.DEC, -50, 0.2).sent) == b"#"
    assert fake.feed(base.guiding(Axis.DEC).sent) == b"\x01#"
    while (due_in_s := fake.due_in_s()) is not None:
        await asyncio.sleep(due_in_s)
        fake.feed(b"")
    assert fake.feed(base.guiding(Axis.DEC).sent) == b"\x00#"
    assert -3.0 < (fake.mechanics.reported().dec_deg - before) * 3600.0 < -0.5


def test_the_fake_reads_back_what_it_was_set_to() -> None:
    fake = fake_at_zenith()
    site = fake.feed(b"w")[:-1]
    assert base.GET_SITE.read(site + b"#", False) is not None
    time = bytes([15, 26, 0, 4, 6, 5, 251, 1])
    assert fake.feed(b"H" + time) == b"#"
    assert fake.feed(b"h") in (time + b"#", bytes([15, 26, 1, 4, 6, 5, 251, 1]) + b"#")
    assert fake.feed(b"T\0t") == b"#\x00#"
    assert fake.feed(b"T\3t") == b"#\x03#"
    # half a sync keeps the hand control waiting, for whatever comes next
    assert fake.feed(b"s1234") == b""
    assert fake.feed(b"Kx") == b""


def test_from_a_url() -> None:
    options = {"epoch": "icrs", "timeout_s": "3", "park_az_deg": "0", "park_alt_deg": "49.6"}
    mount = NEXSTAR.open_mount(MountUrl("nexstar", "/dev/ttyUSB0", options), "main", None)
    assert (mount.name, mount.epoch) == ("main", "icrs")
    assert SYNSCAN.open_mount(MountUrl("synscan", "/dev/ttyUSB0", {}), None, HERE).epoch == "icrs"
    for wrong in (
        {"speed": "9600"},
        {"epoch": "B1950"},
        {"baud": "fast"},
        {"park_az_deg": "0"},
        {"park_az_deg": "0", "park_alt_deg": "91"},
    ):
        with pytest.raises(BadSettings):
            NEXSTAR.open_mount(MountUrl("nexstar", "/dev/ttyUSB0", wrong), None, None)
