"""What every family's driver must do, over a real wire, whatever the fake does to it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.fakes.faults import Fault
from drivers.fakes.wire_fake import WireFake
from drivers.generic.link_supervisor import LinkState
from drivers.generic.mount import GenericMount
from drivers.lx200.codec.greeting import names
from drivers.registry import fake_dialects, fake_machine, fake_protocols, fakes, make_fake, open_mount
from drivers.wire.wire_log import WireEntry
from mountnav.clock import utc_now
from mountnav.devices import SlewOutcome, SlewState, SyncOutcome
from mountnav.errors import DeviceError, DeviceMissing, DeviceRefused, Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site
from mountnav.testing.check_mount import check_mount
from tests.pace import slowness

pytestmark = pytest.mark.first  # they wait for mounts: not at the end, when nothing else is left to do

HERE = Site(49.6, 36.9)
QUICK = "poll_s=0.1&start_grace_s=0.6&rest_s=0.4&stall_s=2&sync_wait_s=1.0&late_s=0.5&backoff_s=0.1"
FAKES_ALONE = set(fake_dialects("lx200")) - {*names(), "lx200-16"}
"""Mounts that INDI's drivers are tried on, and ours doesn't drive."""
ALL = [
    (protocol, dialect)
    for protocol in fake_protocols()
    for dialect in fake_dialects(protocol)
    if protocol != "lx200" or dialect not in FAKES_ALONE
]
USUAL = [(protocol, fake_dialects(protocol)[0]) for protocol in fake_protocols()]
QUICK_ONES = [case for case in USUAL if case[0] in ("lx200", "nexstar")]
NOTICED_S = 2.0
SILENT_S = 2.5
"""A question that is owed its answer waits so long for it, or a little less."""
ON_WIRE_S = 0.1 * SILENT_S
"""A stop that waits for no answer is on the wire in a tenth of that: it takes a millisecond or two."""


def fake_of(protocol: str, dialect: str) -> WireFake:
    machine = Machine() if protocol == "synscan" else fake_machine(protocol)
    mechanics = Mechanics(
        HERE,
        Air(),
        PointingErrors(),
        machine=machine,
        slew_rate_deg_s=20.0,
        acceleration_deg_s2=40.0,
    )
    return make_fake(protocol, dialect, mechanics, clock=utc_now, monotonic=time.monotonic)


class Rig:
    """A mount on its fake."""

    def __init__(self, mount: GenericMount, fake: WireFake, bench: Any) -> None:
        self.mount, self.fake, self.bench = mount, fake, bench
        self.told: list[tuple[float, str]] = []
        mount.listen(lambda what, _facts: self.told.append((time.monotonic(), what)))

    def when(self, what: str) -> float | None:
        """When something was told first."""
        return next((at_s for at_s, said in self.told if said == what), None)

    async def until(self, true: Callable[[], object], *, within_s: float = 60.0) -> None:
        async with asyncio.timeout(within_s):
            while not true():
                await asyncio.sleep(0.01)

    async def beside(self, ra_deg: float, dec_deg: float) -> Apparent | Icrs:
        """A place not far, as the mount speaks of places; always away from the zenith to the south."""
        place = (await self.mount.reading()).place
        ra, dec = (place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg
        return Icrs(ra, dec) if isinstance(place, Icrs) else Apparent(ra, dec, utc_now())

    async def set_out(self) -> asyncio.Task[SlewOutcome]:
        """Begin a long slew and wait until it is under way."""
        slew = asyncio.create_task(self.mount.slew(await self.beside(25.0, -30.0)))
        await self.until(lambda: self.mount.slew_state is SlewState.UNDER_WAY or slew.done())
        assert not slew.done(), slew
        return slew

    def stop_sent(self, noted: int, stops: tuple[bytes, ...]) -> WireEntry:
        """The stop that went out after what was noted of the log, behind no more than one question.

        One may be on its way to the port, in a thread of its own, in the moment in which the stop is asked.
        """
        out = [one for one in self.mount.wire_log.entries(noted) if one.way == "driver->mount"]
        found = [one for one in out[:2] if one.data.startswith(stops)]
        assert found, out[:4]
        return found[0]


@asynccontextmanager
async def rigged(
    protocol: str,
    dialect: str,
    *,
    tcp: bool = False,
    link: Path | None = None,
    slew_rate_deg_s: float = 20.0,
    more: str = "",
) -> AsyncIterator[Rig]:
    fake = fake_of(protocol, dialect)
    with FakeOnTcp(fake) if tcp else FakeOnPty(fake, link) as bench:
        where = bench.address.replace("socket://", "tcp://") if tcp else f"serial://{bench.address}"
        mount = open_mount(f"{protocol}+{where}?{QUICK}{more}", site=HERE)
        assert isinstance(mount, GenericMount)
        await mount.open()
        if not mount.trusted:
            mount.trust()
        # a controller that knows no sky stands at its home, the pole: everyone begins on the same sky
        place = (await mount.reading()).place
        if place.dec_deg > 80.0:
            there = fake.mechanics.reported()
            start = Apparent(there.ra_deg, 45.0, utc_now())
            assert await mount.slew(start) is SlewOutcome.ARRIVED
        fake.mechanics.slew_rate_deg_s = slew_rate_deg_s
        rig = Rig(mount, fake, bench)
        try:
            yield rig
        finally:
            await mount.close()


def _by_patience(cases: list[tuple[str, str]]) -> pytest.MarkDecorator:
    """Two quick families in every run, the others where there is time."""
    return pytest.mark.parametrize(
        ("protocol", "dialect"),
        [
            pytest.param(*case, id="-".join(case), marks=[] if case in QUICK_ONES else [pytest.mark.long])
            for case in cases
        ],
    )


# boards of motor controllers differ in their gears alone
@_by_patience([case for case in ALL if case[0] != "skywatcher" or case == USUAL[-1]])
async def test_each_dialect_conforms(protocol: str, dialect: str) -> None:
    async with rigged(protocol, dialect) as rig:
        await check_mount(rig.mount)


usual = _by_patience(USUAL)
# its gotos take their time, and a family of its own tests does the same
hand_controlled = _by_patience([case for case in USUAL if case[0] != "skywatcher"])


@usual
async def test_connecting_orders_nothing(protocol: str, dialect: str) -> None:
    fake = fake_of(protocol, dialect)
    before = fake.mechanics.axes()
    believed = fake.mechanics.believed_utc() - utc_now()
    with FakeOnTcp(fake) as bench:
        mount = open_mount(f"{protocol}+{bench.address}?{QUICK}", site=HERE)
        await mount.open()
        await asyncio.sleep(1.0)
        await mount.close()
    after = fake.mechanics.axes()
    # the hour angle axis may have tracked
    assert abs(after.dec_axis_deg - before.dec_axis_deg) < 1e-9
    assert abs(after.ha_axis_deg - before.ha_axis_deg) < 0.1
    assert abs((fake.mechanics.believed_utc() - utc_now() - believed).total_seconds()) < 0.01
    assert fake.mechanics.believed_site == fake.mechanics.site
    assert not [
        said for said in fake.heard if said.startswith((*fakes(protocol).moves, *fakes(protocol).stops))
    ]


@usual
async def test_a_stop_is_on_the_wire_at_once(protocol: str, dialect: str) -> None:
    async with rigged(protocol, dialect, slew_rate_deg_s=2.0) as rig:
        slew = await rig.set_out()
        log = rig.mount.wire_log
        noted, asked_s = log.count, log.now_s()
        most_s = ON_WIRE_S * slowness()
        await rig.mount.stop()
        assert rig.stop_sent(noted, fakes(protocol).stops).t_s - asked_s < most_s
        assert await slew is SlewOutcome.STOPPED
        assert not rig.fake.mechanics.slewing()


@usual
@pytest.mark.parametrize("kind", ["silence", "flood"])
async def test_a_stop_gets_through_silence_and_floods(protocol: str, dialect: str, kind: str) -> None:
    async with rigged(protocol, dialect, slew_rate_deg_s=2.0) as rig:
        slew = await rig.set_out()
        most_s = ON_WIRE_S * slowness()
        rig.fake.add_fault(
            Fault(kind, for_s=SILENT_S, delay_s=0.002, data=b"\x23\x30\x55\x0d")  # type: ignore[arg-type]
        )
        await rig.until(lambda: rig.fake.strikes)
        log = rig.mount.wire_log
        begun: list[tuple[int, float]] = []

        async def stopped_from_now_on() -> None:
            # what the loop had to do before this is no part of the stop
            begun.append((log.count, log.now_s()))
            await rig.mount.stop()

        stop = asyncio.create_task(stopped_from_now_on())
        await rig.until(lambda: not rig.fake.mechanics.slewing())
        noted, asked_s = begun[0]
        assert rig.stop_sent(noted, fakes(protocol).stops).t_s - asked_s < most_s
        (stopped, end) = await asyncio.gather(stop, slew, return_exceptions=True)
        # it rests; whether that could be read, and what the slew came to, depends on the noise
        assert stopped is None or isinstance(stopped, DeviceError)
        assert end is SlewOutcome.STOPPED or isinstance(end, DeviceError)


@usual
async def test_a_pulled_plug_is_noticed_and_the_mount_found_again(
    protocol: str, dialect: str, tmp_path: Path
) -> None:
    async with rigged(protocol, dialect, link=tmp_path / "by-id", slew_rate_deg_s=2.0) as rig:
        slew = await rig.set_out()
        device = rig.bench.device
        pulled_s = time.monotonic()
        rig.bench.vanish()
        with pytest.raises(DeviceMissing):
            await slew
        await rig.until(lambda: rig.when("link-lost"))
        lost_s = rig.when("link-lost")
        assert lost_s is not None
        assert lost_s - pulled_s < NOTICED_S * slowness()
        assert rig.mount.slew_state is SlewState.LOST
        rig.bench.come_back()
        assert rig.bench.device != device
        await rig.until(lambda: rig.when("link-back"))
        assert not rig.mount.trusted
        # it had gone on moving without us: stopped as soon as it could be reached
        await rig.until(lambda: not rig.fake.mechanics.slewing())
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.slew(await rig.beside(1.0, -1.0))
        assert refusal.value.reason is Refusal.UNTRUSTED


@usual
async def test_a_mount_without_power_is_noticed(protocol: str, dialect: str) -> None:
    async with rigged(protocol, dialect, more="&lost_after_s=3&timeout_s=2") as rig:
        rig.fake.add_fault(Fault("dead", for_s=6.0))
        off_s = time.monotonic()
        await rig.until(lambda: rig.when("link-silent"))
        silent_s = rig.when("link-silent")
        assert silent_s is not None
        assert silent_s - off_s < NOTICED_S * slowness()
        await rig.until(lambda: rig.when("link-lost"))
        await rig.until(lambda: rig.when("link-back"))
        assert rig.mount.link is LinkState.UP
        assert not rig.mount.trusted


@hand_controlled
@pytest.mark.parametrize("ending", ["hang_up", "reset"])
async def test_a_closed_connection_is_noticed_and_made_again(
    protocol: str, dialect: str, ending: str
) -> None:
    async with rigged(protocol, dialect, tcp=True) as rig:
        cut_s = time.monotonic()
        getattr(rig.bench, ending)()
        await rig.until(lambda: rig.when("link-lost"))
        lost_s = rig.when("link-lost")
        assert lost_s is not None
        assert lost_s - cut_s < NOTICED_S * slowness()
        await rig.until(lambda: rig.when("link-back"))
        assert (await rig.mount.reading()).slewing is not True


@usual
async def test_a_reboot_on_the_way_never_says_arrived(protocol: str, dialect: str) -> None:
    async with rigged(protocol, dialect, slew_rate_deg_s=2.0, more="&lost_after_s=2&timeout_s=1.5") as rig:
        slew = await rig.set_out()
        rig.fake.add_fault(Fault("reboot", for_s=4.0))
        (end,) = await asyncio.gather(slew, return_exceptions=True)
        assert end is not SlewOutcome.ARRIVED
        await rig.until(lambda: not rig.mount.trusted)
        await rig.until(lambda: rig.mount.link is LinkState.UP)
        with pytest.raises(DeviceRefused):
            await rig.mount.slew(await rig.beside(1.0, -1.0))


@hand_controlled
async def test_syncs_are_classified(protocol: str, dialect: str) -> None:
    # a motor controller knows no syncs: its driver's own offset is seen at once
    async with rigged(protocol, dialect) as rig:
        mechanics = rig.fake.mechanics
        assert (await rig.mount.sync(await rig.beside(0.3, -0.3))).outcome is SyncOutcome.SEEN
        mechanics.sync_behavior = "ignore"
        assert (await rig.mount.sync(await rig.beside(0.3, -0.3))).outcome is SyncOutcome.IGNORED
        mechanics.sync_behavior, mechanics.sync_late_s = "late", 0.7
        assert (await rig.mount.sync(await rig.beside(0.3, -0.3))).outcome is SyncOutcome.LATE
        mechanics.sync_behavior = "refuse"
        try:
            result = await rig.mount.sync(await rig.beside(0.3, -0.3))
        except DeviceRefused:
            return
        # a family without words for it answers as always
        assert result.outcome is SyncOutcome.IGNORED


@pytest.mark.long
@hand_controlled
async def test_a_stuck_axis_is_no_arrival(protocol: str, dialect: str) -> None:
    async with rigged(protocol, dialect, slew_rate_deg_s=4.0) as rig:
        rig.fake.mechanics.stick("dec")
        (end,) = await asyncio.gather(rig.mount.slew(await rig.beside(3.0, -3.0)), return_exceptions=True)
        assert end is SlewOutcome.STALLED or isinstance(end, DeviceError), end
        assert rig.mount.slew_state is not SlewState.ARRIVED


@pytest.mark.long
@hand_controlled
async def test_a_runaway_is_stopped(protocol: str, dialect: str) -> None:
    async with rigged(protocol, dialect, slew_rate_deg_s=4.0, more="&slew_timeout_s=12") as rig:
        rig.fake.mechanics.run_away("ha")
        (end,) = await asyncio.gather(rig.mount.slew(await rig.beside(3.0, -3.0)), return_exceptions=True)
        assert end is SlewOutcome.STALLED or isinstance(end, DeviceError), end
        assert not rig.fake.mechanics.slewing()
