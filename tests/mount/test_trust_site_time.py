"""Mount and settings that contradict each other on site or time: told, nothing slewed, and ways out."""

from __future__ import annotations

import contextlib
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Any

import pytest

from drivers.fakes.bench import FakeOnPty
from drivers.registry import make_fake, open_mount
from mountnav.clock import SystemClock, utc_now
from mountnav.devices import ConnectReport, for_mount
from mountnav.errors import DeviceRefused, DeviceSilent, Refusal
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import EntryKind
from mountnav.mount import CheckedMount
from mountnav.mount.trust import ACCEPTED, APART_DEG, Difference
from mountnav.pointing.limits import Limits
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Icrs, Site
from mountnav.sky.sphere import half_turn_deg
from tests.drivers.alpaca import test_language as alpaca
from tests.drivers.alpaca.alpaca_server import HERE as ALPACA_SITE
from tests.navigation.sync_rig import SITE, SyncRig, rigged

OTHER = replace(SITE, longitude_deg=-SITE.longitude_deg)

FAMILIES = [
    ("lx200", "classic"),
    ("lx200", "autostar"),
    ("lx200", "lx200gps"),
    ("lx200", "onstep"),
    ("lx200", "10micron"),
    ("lx200", "am5"),
    ("lx200", "gemini"),
    ("ioptron", None),
]


class Met:
    """A mount behind its checks, and what was told and written of it."""

    def __init__(self, mount: CheckedMount, journal: MemoryJournal) -> None:
        self.mount = mount
        self.journal = journal
        self.told: list[str] = []
        mount.listen(lambda what, _: self.told.append(what))

    def place(self) -> Apparent | Icrs:
        utc = utc_now()
        up = hour_angle_to_icrs(HourAngle(-20.0, 40.0, utc), SITE, Air())
        return for_mount(up, self.mount.epoch, utc)


@contextlib.asynccontextmanager
async def met(
    protocol: str,
    dialect: str | None,
    *,
    believes: Site = OTHER,
    ahead_s: float = 0.0,
    options: str = "",
    parked: bool = False,
) -> AsyncIterator[Met]:
    """A fake that believes to stand elsewhere, on a real pseudo-terminal."""
    mechanics = Mechanics(
        SITE,
        Air(),
        PointingErrors(),
        machine=Machine(mounting="german", clock_offset_s=ahead_s, starts_at="park" if parked else "zenith"),
        slew_rate_deg_s=40.0,
        acceleration_deg_s2=8.0,
    )
    fake = make_fake(protocol, dialect, mechanics, clock=utc_now, monotonic=time.monotonic)
    mechanics.set_believed_site(believes)
    with FakeOnPty(fake) as bench:
        url = f"{protocol}+serial://{bench.address}{options}"
        journal = MemoryJournal()
        mount = CheckedMount(
            open_mount(url, site=SITE),
            telescope="east",
            limits=Limits(5.0, sun_cone_deg=0.0),
            site=SITE,
            air=Air(),
            journal=journal,
            clock=SystemClock(),
            mounting="german",
        )
        found = Met(mount, journal)
        await mount.open()
        try:
            yield found
        finally:
            await mount.close()


@pytest.mark.long
@pytest.mark.parametrize(("protocol", "dialect"), FAMILIES)
async def test_no_family_is_slewed_by_another_site_until_it_is_set_right(
    protocol: str, dialect: str | None
) -> None:
    async with met(protocol, dialect) as found:
        mount = found.mount
        assert mount.contradiction is not None
        assert "longitude is -44.5" in mount.contradiction
        mount.trust()
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(found.place())
        assert refused.value.reason is Refusal.SITE_OR_TIME
        assert "set-site-time" in str(refused.value.advice)
        with pytest.raises(DeviceRefused):
            await mount.would_slew(found.place())
        # a stop is always sent
        await mount.stop()
        written = [entry.what for entry in found.journal.entries if entry.kind is EntryKind.FAULT]
        assert any("contradict each other" in what for what in written), written
        mount.trust()
        report = await mount.set_site_and_time()
        assert "site set" in report.done
        assert mount.contradiction is None
        assert "contradiction-over" in found.told
        # whether the place or the axes were right nobody has seen
        assert not mount.trusted
        assert "turned its sky by +44.5°" in mount.why_untrusted
        with pytest.raises(DeviceRefused) as lost:
            await mount.slew(found.place())
        assert lost.value.reason is Refusal.UNTRUSTED
        assert "recover" in str(lost.value.advice)
        mount.trust()
        await mount.would_slew(found.place())


async def test_what_changes_next_to_nothing_leaves_the_position_trusted() -> None:
    async with met("lx200", "onstep", believes=SITE, ahead_s=20.0) as found:
        found.mount.trust()
        await found.mount.set_site_and_time()
        assert found.mount.trusted
        await found.mount.would_slew(found.place())


async def test_at_its_park_position_the_axes_tell_where_it_stands() -> None:
    async with met("lx200", "onstep") as found:
        mount = found.mount
        mount.trust()
        await mount.park()
        await mount.set_site_and_time()
        assert mount.trusted


@pytest.mark.long
@pytest.mark.parametrize(("protocol", "dialect"), FAMILIES)
@pytest.mark.parametrize("wrong", ["site", "clock"])
async def test_what_connecting_sets_counts_as_what_an_order_sets(
    protocol: str, dialect: str | None, wrong: str
) -> None:
    believes, ahead_s = (OTHER, 0.0) if wrong == "site" else (SITE, 3600.0)
    options = "?set_site=yes&set_clock=yes"
    async with met(protocol, dialect, believes=believes, ahead_s=ahead_s, options=options) as found:
        mount = found.mount
        assert mount.contradiction is None
        assert not mount.trusted
        assert "its site and clock were set to ours, which turned its sky" in mount.why_untrusted
        assert mount.turned_deg is not None
        with pytest.raises(DeviceRefused) as lost:
            await mount.slew(found.place())
        assert lost.value.reason is Refusal.UNTRUSTED
        mount.trust()
        await mount.would_slew(found.place())


async def test_connecting_that_sets_next_to_nothing_leaves_the_position_trusted() -> None:
    options = "?set_site=yes&set_clock=yes"
    async with met("lx200", "onstep", believes=SITE, ahead_s=20.0, options=options) as found:
        assert found.mount.trusted
        assert found.mount.turned_deg is None


async def test_a_parked_mount_is_set_at_connecting_and_its_axes_tell() -> None:
    options = "?set_site=yes&set_clock=yes"
    async with met("lx200", "onstep", ahead_s=3600.0, options=options, parked=True) as found:
        assert found.mount.trusted


async def test_what_it_was_turned_by_is_kept_until_the_sky_or_a_second_order_confirms_it() -> None:
    async with met("lx200", "onstep") as found:
        mount = found.mount
        assert mount.turned_deg is None
        await mount.set_site_and_time()
        assert mount.turned_deg == pytest.approx(-44.54, abs=0.1)
        await mount.set_site_and_time()
        assert mount.turned_deg is None


async def test_what_cannot_be_told_its_site_says_so_and_may_be_accepted() -> None:
    # an aligned hand control keeps the site that its alignment was made with
    async with met("nexstar", None) as found:
        mount = found.mount
        assert mount.contradiction is not None
        mount.trust()
        with pytest.raises(DeviceRefused):
            await mount.slew(found.place())
        with pytest.raises(DeviceRefused) as refused:
            await mount.set_site_and_time()
        assert "hand control" in str(refused.value.advice)
        assert mount.accept_site_and_time() is not None
        await mount.reading()
        mount.trust()
        await mount.would_slew(found.place())


async def test_a_clock_an_hour_off_is_no_less() -> None:
    async with met("lx200", "onstep", believes=SITE, ahead_s=3600.0) as found:
        assert found.mount.contradiction is not None
        assert "clock is 3600 s ahead" in found.mount.contradiction
        found.mount.trust()
        with pytest.raises(DeviceRefused) as refused:
            await found.mount.slew(found.place())
        assert refused.value.reason is Refusal.SITE_OR_TIME
        report = await found.mount.set_site_and_time()
        assert "clock set" in report.done
        assert found.mount.contradiction is None


async def test_a_mount_that_agrees_is_slewed() -> None:
    async with met("lx200", "onstep", believes=SITE, ahead_s=20.0) as found:
        assert found.mount.contradiction is None
        found.mount.trust()
        await found.mount.would_slew(found.place())


async def jumped(rig: SyncRig) -> None:
    """Another site or clock is another place among the stars; somebody says that it is right."""
    await rig.mount.reading()
    rig.mount.trust()


def test_set_right_at_its_hand_control_it_is_slewed_without_a_restart() -> None:
    async def night(rig: SyncRig) -> None:
        await rig.driver.language.write_site(OTHER)
        await rig.driver.compare()
        assert rig.mount.contradiction is not None
        with pytest.raises(DeviceRefused):
            await rig.slew(rig.up())
        await rig.driver.language.write_site(SITE)
        # nobody has told us: the refusal itself asks once more
        await jumped(rig)
        await rig.slew(rig.up())
        assert rig.mount.contradiction is None

    rigged(night)


def test_a_link_lost_while_its_site_is_set_leaves_no_trust(monkeypatch: pytest.MonkeyPatch) -> None:
    async def night(rig: SyncRig) -> None:
        assert rig.mount.trusted

        async def cut_short() -> None:
            raise DeviceSilent("no answer")

        monkeypatch.setattr(rig.driver, "set_site_and_time", cut_short)
        with pytest.raises(DeviceSilent):
            await rig.mount.set_site_and_time()
        assert not rig.mount.trusted
        with pytest.raises(DeviceRefused, match="how far isn't known"):
            await rig.slew(rig.up())

    rigged(night)


def test_what_is_accepted_is_written_down_and_forgotten_when_it_changes() -> None:
    journal = MemoryJournal()

    async def first(rig: SyncRig) -> None:
        await rig.driver.language.write_site(OTHER)
        await rig.driver.compare()
        assert rig.mount.accept_site_and_time() is not None
        assert rig.mount.contradiction is None
        assert rig.mount.accept_site_and_time() is None
        await jumped(rig)
        await rig.mount.would_slew(for_mount(rig.up(), "apparent", rig.clock.utc()))

    async def second(rig: SyncRig) -> None:
        await rig.driver.language.write_site(OTHER)
        await rig.driver.compare()
        said = [one.facts for one in journal.entries if one.facts.get("about") == ACCEPTED]
        rig.mount.restore_agreement(said[-1])
        assert rig.mount.contradiction is None
        # another place again: nobody has accepted that
        await rig.driver.language.write_site(replace(SITE, longitude_deg=100.0))
        await rig.driver.compare()
        assert rig.mount.contradiction is not None
        await jumped(rig)
        with pytest.raises(DeviceRefused):
            await rig.slew(rig.up())
        # and the first one isn't accepted for ever
        await rig.driver.language.write_site(OTHER)
        await rig.driver.compare()
        assert rig.mount.contradiction is not None

    rigged(first, journal=journal)
    rigged(second, journal=journal)


def test_how_far_apart_is_apart() -> None:
    def words(**off: Any) -> str | None:
        return Difference.of(ConnectReport("a mount", "apparent", **off)).words

    assert (
        words(latitude_off_deg=0.9 * APART_DEG, longitude_off_deg=-0.9 * APART_DEG, clock_off_s=59.0) is None
    )
    assert words() is None
    assert words(latitude_off_deg=1.1 * APART_DEG) is not None
    assert words(longitude_off_deg=-1.1 * APART_DEG) is not None
    assert words(clock_off_s=-61.0) == "its clock is 61 s behind ours"


@pytest.mark.long
async def test_an_alpaca_mount_that_keeps_its_place_among_the_stars_is_not_trusted_for_that() -> None:
    async with alpaca.rigged() as rig:
        rig.telescope.site[1] -= 44.5
        mount = CheckedMount(
            rig.mount, telescope="east", limits=Limits(5.0, sun_cone_deg=0.0), site=ALPACA_SITE, air=Air()
        )
        await rig.mount.compare()
        mount.trust()
        before = (await mount.reading()).place
        await mount.set_site_and_time()
        after = (await mount.reading()).place
        # nothing has jumped that a driver could see
        assert abs(half_turn_deg(after.ra_deg - before.ra_deg)) < 1.0
        assert rig.mount.trusted
        assert not mount.trusted
        assert "turned its sky by +44.5°" in mount.why_untrusted
        with pytest.raises(DeviceRefused) as lost:
            await mount.slew(before)
        assert lost.value.reason is Refusal.UNTRUSTED
