"""Connecting, trust in the position, and what readings between orders mean; on a language without a wire."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivers.generic.link_supervisor import LinkState
from drivers.generic.mount import GenericMount
from mountnav.clock import utc_now
from mountnav.devices import (
    Skill,
    SlewOutcome,
    SlewState,
)
from mountnav.errors import DeviceMissing, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Site
from tests.drivers.generic.plain_rig import HERE, QUICK, plain, rigged


async def test_connecting_orders_nothing_and_compares() -> None:
    language = plain()
    language.clock_off_s, language.its_site = 3600.4, Site(49.6, -36.9)
    async with rigged(language) as rig:
        assert language.orders == ["open"]
        report = rig.mount.report
        assert report is not None
        assert report.clock_off_s == pytest.approx(3600.4, abs=0.1)
        assert report.longitude_off_deg == pytest.approx(-73.8)
        clock, site = report.problems
        assert "1 h, so its time zone or daylight saving is wrong" in clock
        assert "the sign of the longitude is wrong" in site
        assert rig.heard("connected")[0]["problems"] == [clock, site]


async def test_clock_and_site_are_set_if_the_configuration_says_so() -> None:
    language = plain()
    language.clock_off_s, language.its_site = 50.0, Site(0.0, 0.0)
    async with rigged(language, set_clock=True, set_site=True) as rig:
        assert language.orders == ["open", "set site", "set clock"]
        assert rig.mount.report is not None
        assert rig.mount.report.problems == ()
        assert rig.mount.report.done == ("site set", "clock set")


async def test_a_refused_setting_is_a_problem_not_a_failure() -> None:
    language = plain()
    language.refuses_settings = True
    async with rigged(language, set_clock=True, set_site=True) as rig:
        assert rig.mount.report is not None
        site, clock = rig.mount.report.problems
        assert "its site was to be set, and it said no" in site
        assert "its clock was to be set, and it said no" in clock


async def test_another_epoch_than_the_familys_is_told() -> None:
    language = plain()
    language.usual_epoch = "icrs"
    async with rigged(language) as rig:
        assert rig.mount.report is not None
        assert "its family usually speaks icrs" in rig.mount.report.problems[0]


async def test_a_mount_just_switched_on_does_not_slew_until_a_sync_was_seen() -> None:
    language = plain()
    language.fresh = True
    async with rigged(language) as rig:
        assert not rig.mount.trusted
        target = await rig.beside(1.0, -1.0)
        for order in (rig.mount.slew(target), rig.mount.park(), rig.mount.home()):
            with pytest.raises(DeviceRefused) as refusal:
                await order
            assert refusal.value.reason is Refusal.UNTRUSTED
        assert set(language.orders) == {"open"}
        await rig.mount.sync(await rig.beside(0.1, 0.1))
        assert rig.mount.trusted
        assert await rig.mount.slew(target) is SlewOutcome.ARRIVED


async def test_an_ignored_sync_gives_no_trust() -> None:
    language = plain()
    language.fresh = language.sync_ignored = True
    async with rigged(language) as rig:
        await rig.mount.sync(await rig.beside(0.1, 0.1))
        assert not rig.mount.trusted


async def test_finding_home_by_sensors_gives_trust_going_there_does_not() -> None:
    language = plain()
    language.fresh = True
    async with rigged(language) as rig:
        with pytest.raises(DeviceRefused):
            await rig.mount.home()
        language.skills |= {Skill.FIND_HOME}
        assert await rig.mount.home() is SlewOutcome.ARRIVED
        assert rig.mount.trusted


async def test_an_operators_word_counts() -> None:
    async with rigged(trust_on_connect=False) as rig:
        assert not rig.mount.trusted
        rig.mount.trust()
        assert await rig.mount.slew(await rig.beside(1.0, -1.0)) is SlewOutcome.ARRIVED


async def test_a_jump_without_an_order_takes_the_trust() -> None:
    async with rigged() as rig:
        rig.language.mechanics.sync(await rig.beside(40.0, -40.0))
        await rig.until(lambda: not rig.mount.trusted)
        assert "jumped by" in str(rig.heard("untrusted")[0]["why"])


async def test_a_reboot_takes_the_trust() -> None:
    async with rigged() as rig:
        rig.language.fresh = True
        await rig.until(lambda: not rig.mount.trusted)
        assert "switched off and on" in str(rig.heard("untrusted")[0]["why"])


async def test_a_clock_that_jumped_in_a_silence_means_a_reboot() -> None:
    language = plain()
    language.clock_off_s = 0.0
    async with rigged(language, replace(QUICK, lost_after_s=60.0)) as rig:
        language.silent, language.clock_off_s = True, -500.0
        await rig.until(lambda: rig.heard("link-silent"))
        language.silent = False
        await rig.until(lambda: not rig.mount.trusted)
        assert "clock has jumped" in str(rig.heard("untrusted")[0]["why"])


async def test_a_closed_mount_is_left_alone() -> None:
    async with rigged() as rig:
        await rig.mount.close()
        await rig.mount.close()
        with pytest.raises(DeviceMissing, match="open the mount first"):
            await rig.mount.reading()
        assert rig.mount.link is LinkState.CLOSED


async def test_a_place_that_changed_in_a_silence_takes_the_trust() -> None:
    async with rigged(timing=replace(QUICK, lost_after_s=60.0)) as rig:
        rig.language.silent = True
        await rig.until(lambda: rig.heard("link-silent"))
        here = rig.language.mechanics.reported()
        rig.language.mechanics.sync(replace(here, dec_deg=here.dec_deg - 0.5))
        rig.language.silent = False
        await rig.until(lambda: not rig.mount.trusted)
        assert "while it was silent" in str(rig.heard("untrusted")[0]["why"])


async def test_a_stop_that_was_lost_is_repeated_by_whoever_keeps_the_link() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0)) as rig:
        rig.language.stops_needed = 1
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        slew.cancel()
        with pytest.raises(asyncio.CancelledError):
            await slew
        assert rig.language.mechanics.slewing()
        await rig.until(lambda: not rig.language.mechanics.slewing())
        await rig.until(lambda: rig.mount.slew_state is SlewState.STOPPED)


async def test_a_long_rest_does_not_make_a_motion_look_like_rest() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0)) as rig:
        session = rig.mount._session
        await asyncio.sleep(1.3)
        since = session._since
        assert since is not None
        # however long it has rested, what it is compared with is a moment old
        assert (utc_now() - since.utc).total_seconds() < 1.3 + QUICK.heartbeat_s
        rig.language.stops_needed = 1
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        slew.cancel()
        with pytest.raises(asyncio.CancelledError):
            await slew
        await rig.until(lambda: rig.mount.slew_state is SlewState.STOPPED)
        assert not rig.language.mechanics.slewing()


async def test_orders_wait_for_a_connecting_that_goes_on() -> None:
    language = plain()
    mount = GenericMount(language, timing=QUICK, site=HERE)
    language.silent = True
    opening = asyncio.create_task(mount.open())
    await asyncio.sleep(0.05)
    sync = asyncio.create_task(mount.sync(Apparent(1.0, 2.0, utc_now())))
    await asyncio.sleep(0.05)
    assert language.orders == ["open"]
    sync.cancel()
    language.silent = False
    await opening
    assert "sync" not in language.orders
    await mount.close()
