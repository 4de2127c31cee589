"""What all mounts do alike, tried on a language without a wire over the real mechanics."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import timedelta

import pytest

from drivers.generic.language import Readout
from drivers.generic.link_supervisor import LinkState
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.generic.reading_filter import Believed
from mountnav.clock import in_virtual_time, utc_now
from mountnav.devices import (
    Announces,
    Direction,
    Skill,
    Skilled,
    SlewOutcome,
    SlewState,
    SyncOutcome,
    TrackingRate,
    Trusts,
)
from mountnav.errors import BadRequest, Busy, DeviceMissing, DeviceRefused, DeviceSilent, Refusal
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.generic.plain_language import PlainLanguage

HERE = Site(49.6, 36.9)
QUICK = Timing(
    poll_s=0.05,
    start_grace_s=0.4,
    rest_s=0.2,
    stall_s=1.0,
    sync_wait_s=0.6,
    late_s=0.3,
    heartbeat_s=0.1,
    silence_s=0.3,
    lost_after_s=1.0,
    backoff_s=0.05,
    near_arcsec=5.0,
)


class Rig:
    """A driven mount, its language, and all that it told."""

    def __init__(self, language: PlainLanguage, mount: GenericMount) -> None:
        self.language, self.mount = language, mount
        self.told: list[tuple[str, dict[str, object]]] = []
        mount.listen(lambda what, facts: self.told.append((what, dict(facts))))

    def heard(self, what: str) -> list[dict[str, object]]:
        return [facts for said, facts in self.told if said == what]

    async def until(self, true: Callable[[], object]) -> None:
        async with asyncio.timeout(30.0):
            while not true():
                await asyncio.sleep(0.01)

    async def beside(self, ra_deg: float, dec_deg: float) -> Apparent:
        place = (await self.mount.reading()).place
        return Apparent((place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg, utc_now())


def plain(*, slew_rate_deg_s: float = 20.0) -> PlainLanguage:
    mechanics = Mechanics(
        HERE, Air(), PointingErrors(), slew_rate_deg_s=slew_rate_deg_s, acceleration_deg_s2=40.0
    )
    return PlainLanguage(mechanics)


@asynccontextmanager
async def rigged(
    language: PlainLanguage | None = None, timing: Timing = QUICK, **given: object
) -> AsyncIterator[Rig]:
    language = language or plain()
    rig = Rig(language, GenericMount(language, timing=timing, site=HERE, **given))  # type: ignore[arg-type]
    await rig.mount.open()
    try:
        yield rig
    finally:
        await rig.mount.close()


async def test_conforms() -> None:
    async with rigged() as rig:
        await check_mount(rig.mount)
        assert isinstance(rig.mount, Trusts)
        assert isinstance(rig.mount, Announces)
        assert isinstance(rig.mount, Skilled)


# -- connecting ------------------------------------------------------------------------------------


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
        assert "its family speaks icrs" in rig.mount.report.problems[0]


# -- trust -----------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(("speed", "counts"), [(1.0, False), (20.0, True)])
def test_a_pause_of_the_machine_is_no_silence_under_a_fast_sky(speed: float, counts: bool) -> None:
    """What lasts seconds of the sky is a blink to us there: nobody was silent."""
    with in_virtual_time(FastClock(speed, ticks=lambda: 0.0)):
        mount = GenericMount(plain(), timing=replace(QUICK, heartbeat_s=1.0, silence_s=1.2), site=HERE)
        session = mount._session
        before = Readout(Apparent(10.0, 20.0, utc_now()), utc_now(), slewing=False)
        later = before.utc + timedelta(seconds=4.0)
        after = replace(before, place=Apparent(10.0, 20.05, later), utc=later)
        session.trust("for the test")
        session._watch_for_jumps(before, Believed(after))
        assert mount.trusted is counts


async def test_a_reboot_takes_the_trust() -> None:
    async with rigged() as rig:
        rig.language.fresh = True
        await rig.until(lambda: not rig.mount.trusted)
        assert "switched off and on" in str(rig.heard("untrusted")[0]["why"])


# -- readings --------------------------------------------------------------------------------------


async def test_an_odd_reading_is_never_published() -> None:
    async with rigged() as rig:
        before = (await rig.mount.reading()).place
        rig.language.odd = [Apparent(1.0, 2.0, utc_now())]
        for _ in range(5):
            after = (await rig.mount.reading()).place
            assert (
                separation_arcsec(Icrs(before.ra_deg, before.dec_deg), Icrs(after.ra_deg, after.dec_deg)) < 5
            )
        assert rig.mount.trusted


async def test_a_hand_control_moves_it_without_losing_trust() -> None:
    async with rigged() as rig:
        mechanics = rig.language.mechanics
        rig.language.mechanics.move("s", 2.0)
        for _ in range(5):
            place = (await rig.mount.reading()).place
            assert isinstance(place, Apparent)
            assert separation_arcsec(place, replace(mechanics.reported(), utc=place.utc)) < 7200.0
        mechanics.stop()
        assert rig.mount.trusted


# -- slews -----------------------------------------------------------------------------------------


async def test_a_slew_tells_what_it_has_come_to() -> None:
    async with rigged(plain(slew_rate_deg_s=5.0)) as rig:
        assert rig.mount.slew_state is SlewState.NONE
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(4.0, -4.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        with pytest.raises(Busy):
            await rig.mount.slew(await rig.beside(1.0, -1.0))
        with pytest.raises(Busy):
            await rig.mount.sync(await rig.beside(0.0, 0.0))
        assert await slew is SlewOutcome.ARRIVED
        assert rig.mount.slew_state is SlewState.ARRIVED
        assert rig.language.orders.count("slew") == 1


async def test_a_refused_slew_keeps_its_reason() -> None:
    async with rigged() as rig:
        place = (await rig.mount.reading()).place
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.slew(Apparent(place.ra_deg, -80.0, utc_now()))
        assert refusal.value.reason is Refusal.BELOW_HORIZON
        assert rig.mount.slew_state is SlewState.REFUSED


async def test_a_parked_mount_is_not_sent_anywhere() -> None:
    async with rigged() as rig:
        rig.language.parked = True
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.slew(await rig.beside(1.0, -1.0))
        assert refusal.value.reason is Refusal.PARKED
        assert "slew" not in rig.language.orders


@pytest.mark.parametrize("ignored", [False, True])
async def test_a_lost_answer_is_seen_in_the_sky(ignored: bool) -> None:
    async with rigged() as rig:
        rig.language.slew_answer_lost, rig.language.slew_ignored = True, ignored
        slew = rig.mount.slew(await rig.beside(3.0, -3.0))
        if ignored:
            with pytest.raises(DeviceSilent):
                await slew
        else:
            assert await slew is SlewOutcome.ARRIVED
        assert rig.language.orders.count("slew") == 1


@pytest.mark.parametrize("silently", [False, True])
async def test_a_slew_that_never_begins(silently: bool) -> None:
    async with rigged() as rig:
        rig.language.slew_ignored, rig.language.refuses_silently = True, silently
        slew = rig.mount.slew(await rig.beside(3.0, -3.0))
        if silently:
            with pytest.raises(DeviceRefused, match="didn't move"):
                await slew
        else:
            assert await slew is SlewOutcome.STALLED


async def test_a_slew_that_takes_too_long_is_stopped() -> None:
    async with rigged(plain(slew_rate_deg_s=0.5), replace(QUICK, slew_timeout_s=0.5)) as rig:
        assert await rig.mount.slew(await rig.beside(5.0, -5.0)) is SlewOutcome.STALLED
        assert not rig.language.mechanics.slewing()


async def test_a_cancelled_slew_is_stopped_and_its_state_is_found_out() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0)) as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(5.0, -5.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        slew.cancel()
        with pytest.raises(asyncio.CancelledError):
            await slew
        assert rig.mount.slew_state is SlewState.LOST
        await rig.until(lambda: rig.mount.slew_state is SlewState.STOPPED)
        assert not rig.language.mechanics.slewing()


# -- stop ------------------------------------------------------------------------------------------


async def test_stop_is_repeated_until_the_mount_rests() -> None:
    async with rigged(plain(slew_rate_deg_s=2.0)) as rig:
        rig.language.stops_needed = 3
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        await rig.mount.stop()
        assert not rig.language.mechanics.slewing()
        assert "stop 3" in rig.language.orders
        assert await slew is SlewOutcome.STOPPED


async def test_an_order_that_comes_during_a_stop_waits_for_its_end() -> None:
    """A stop is repeated: what went out in between was stopped with the rest, and told as "didn't move"."""
    async with rigged(plain(slew_rate_deg_s=20.0)) as rig:
        rig.language.stops_needed = 3
        first = asyncio.create_task(rig.mount.slew(await rig.beside(60.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        stopping = asyncio.create_task(rig.mount.stop())
        await rig.until(lambda: "stop 1" in rig.language.orders)
        assert await first is SlewOutcome.STOPPED
        second = asyncio.create_task(rig.mount.slew(await rig.beside(-10.0, 3.0)))
        await stopping
        assert await second is SlewOutcome.ARRIVED
        stops = [order for order in rig.language.orders if order.startswith("stop")]
        assert rig.language.orders.index(stops[-1]) < len(rig.language.orders) - 1


async def test_a_stop_ends_an_order_that_waits_for_another_one() -> None:
    async with rigged() as rig:
        # as while another stop is carried out
        rig.mount._session.no_stop.clear()
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(-10.0, 3.0)))
        await rig.until(lambda: rig.mount._session.job is not None)
        await rig.mount.stop()
        assert await slew is SlewOutcome.STOPPED
        assert not any(order.startswith("slew") for order in rig.language.orders)


@pytest.mark.parametrize(
    ("ra_deg", "dec_deg"), [(10.0, 98.6), (10.0, -90.1), (10.0, math.nan), (math.inf, 0.0)]
)
async def test_what_is_no_place_never_goes_out(ra_deg: float, dec_deg: float) -> None:
    """An INDI driver took a declination of 98.6 degrees, and said nothing."""
    async with rigged() as rig:
        nowhere = Apparent(ra_deg, dec_deg, utc_now())
        for order in (rig.mount.slew, rig.mount.sync):
            with pytest.raises(BadRequest, match="no place"):
                await order(nowhere)
        assert rig.language.orders == ["open"]


async def test_stop_goes_on_through_a_silence() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0), replace(QUICK, lost_after_s=60.0)) as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        rig.language.silent, rig.language.stops_needed = True, 4
        stop = asyncio.create_task(rig.mount.stop())
        await rig.until(lambda: "stop 4" in rig.language.orders)
        rig.language.silent = False
        await stop
        assert not rig.language.mechanics.slewing()
        # its follower has seen it stop, or heard nothing for too long: never that it arrived
        (end,) = await asyncio.gather(slew, return_exceptions=True)
        assert end is SlewOutcome.STOPPED or isinstance(end, DeviceSilent)


async def test_one_reading_after_the_time_for_a_stop_claims_no_motion() -> None:
    async with rigged(timing=replace(QUICK, stop_timeout_s=0.0, heartbeat_s=0.0)) as rig:
        await rig.mount.stop()


async def test_a_stop_has_its_time_after_a_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was told into the silence nobody may have heard."""
    timing = replace(QUICK, stop_timeout_s=1.0, heartbeat_s=0.0)
    async with rigged(timing=timing) as rig:
        readout = rig.language.readout
        looks = iter(("silent", "late"))
        rig.language.stops_needed = 10_000
        rig.language.mechanics.move("n", 1.0)

        async def slow() -> Readout:
            match next(looks, None):
                case "silent":
                    raise DeviceSilent("no answer", device="plain")
                case "late":
                    # its answer comes when the stop's time is over, and only then it listens to stops
                    await asyncio.sleep(2.0 * timing.stop_timeout_s)
                    rig.language.stops_needed = 0
            return await readout()

        monkeypatch.setattr(rig.language, "readout", slow)
        await rig.mount.stop()
        assert next(looks, None) is None
        assert not rig.language.mechanics.slewing()


async def test_a_mount_that_can_not_be_stopped_is_told() -> None:
    async with rigged(plain(slew_rate_deg_s=0.5), replace(QUICK, stop_timeout_s=0.3)) as rig:
        rig.language.stops_needed = 10_000
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        with pytest.raises(DeviceRefused, match="cut its power"):
            await rig.mount.stop()
        rig.language.stops_needed = 0
        await rig.mount.stop()
        assert await slew is SlewOutcome.STOPPED


# -- sync ------------------------------------------------------------------------------------------


async def test_syncs_are_classified_by_their_read_back() -> None:
    async with rigged(timing=replace(QUICK, sync_wait_s=1.5)) as rig:
        seen = await rig.mount.sync(await rig.beside(0.2, 0.1))
        assert seen.outcome is SyncOutcome.SEEN
        assert seen.miss_arcsec < 5.0
        rig.language.sync_late_s = 1.0
        late = await rig.mount.sync(await rig.beside(0.2, 0.1))
        assert late.outcome is SyncOutcome.LATE
        # counted from its answer: the order itself went out before that
        assert QUICK.late_s < late.after_s
        rig.language.sync_late_s, rig.language.sync_ignored = 0.0, True
        ignored = await rig.mount.sync(await rig.beside(0.2, 0.1))
        assert ignored.outcome is SyncOutcome.IGNORED
        assert ignored.miss_arcsec > 300.0
        assert rig.language.orders.count("sync") == 3


async def test_a_sync_that_shows_when_it_was_given_up_is_recognized() -> None:
    async with rigged() as rig:
        rig.language.sync_late_s = 1.2
        result = await rig.mount.sync(await rig.beside(30.0, -20.0))
        assert result.outcome is SyncOutcome.IGNORED
        await rig.until(lambda: rig.heard("sync-late"))
        assert rig.mount.trusted


async def test_the_other_kind_of_place_is_refused() -> None:
    async with rigged() as rig:
        for order in (rig.mount.slew, rig.mount.sync, rig.mount.destination_side):
            with pytest.raises(BadRequest):
                await order(Icrs(1.0, 2.0))


# -- link ------------------------------------------------------------------------------------------


async def test_a_lost_link_is_told_found_again_and_takes_the_trust() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0)) as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        rig.language.absent = True
        rig.language.lose()
        with pytest.raises(DeviceMissing):
            await slew
        assert rig.mount.slew_state is SlewState.LOST
        await rig.until(lambda: rig.heard("link-lost"))
        assert rig.mount.link is LinkState.LOST
        with pytest.raises(DeviceMissing):
            await rig.mount.reading()
        tries = rig.language.orders.count("open")
        await rig.until(lambda: rig.language.orders.count("open") > tries + 2)
        rig.language.absent = False
        await rig.until(lambda: rig.heard("link-back"))
        # it went on moving all the while: the first thing said is stop
        back = len(rig.language.orders) - 1 - rig.language.orders[::-1].index("open")
        assert rig.language.orders[back + 1] == "stop 0"
        await rig.until(lambda: rig.mount.slew_state is SlewState.STOPPED)
        assert not rig.mount.trusted
        assert rig.mount.link is LinkState.UP
        with pytest.raises(DeviceRefused):
            await rig.mount.slew(await rig.beside(1.0, -1.0))


async def test_a_silent_mount_is_told_and_then_counts_as_lost() -> None:
    async with rigged() as rig:
        trusted: list[bool] = []
        rig.mount.listen(lambda what, _: trusted.append(rig.mount.trusted) if what == "link-silent" else None)
        rig.language.silent = True
        await rig.until(lambda: rig.heard("link-silent"))
        assert trusted == [True]
        await rig.until(lambda: rig.heard("link-lost"))
        assert not rig.mount.trusted
        rig.language.silent = False
        await rig.until(lambda: rig.heard("link-back"))
        assert (await rig.mount.reading()).slewing is False


async def test_a_short_silence_is_told_and_forgiven() -> None:
    async with rigged(timing=replace(QUICK, lost_after_s=60.0)) as rig:
        rig.language.silent = True
        await rig.until(lambda: rig.heard("link-silent"))
        rig.language.silent = False
        await rig.until(lambda: rig.heard("link-back"))
        assert rig.mount.trusted
        assert not rig.heard("link-lost")


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


async def test_a_slew_does_not_go_on_over_a_new_link() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0), replace(QUICK, poll_s=0.6, backoff_s=0.01)) as rig:
        slew = asyncio.create_task(rig.mount.slew(await rig.beside(20.0, -20.0)))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        # lost and made again between two looks of whoever follows
        rig.language.lose()
        await rig.until(lambda: rig.heard("link-back"))
        with pytest.raises(DeviceMissing, match="lost on the way: unplugged"):
            await slew
        await rig.until(lambda: rig.mount.slew_state is SlewState.STOPPED)
        assert not rig.mount.trusted


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


async def test_a_mount_that_runs_on_is_not_called_refused() -> None:
    timing = replace(QUICK, slew_timeout_s=0.5, stop_timeout_s=0.3)
    async with rigged(plain(slew_rate_deg_s=1.0), timing) as rig:
        rig.language.stops_needed = 10_000
        with pytest.raises(DeviceRefused, match="still moves"):
            await rig.mount.slew(await rig.beside(20.0, -20.0))
        assert rig.mount.slew_state is SlewState.LOST
        rig.language.stops_needed = 0
        await rig.until(lambda: rig.mount.slew_state is SlewState.STOPPED)


async def test_a_small_sync_that_shows_late_is_recognized() -> None:
    async with rigged() as rig:
        rig.language.sync_late_s = 1.2
        result = await rig.mount.sync(await rig.beside(0.2, -0.1))
        assert result.outcome is SyncOutcome.IGNORED
        await rig.until(lambda: rig.heard("sync-late"))
        assert rig.mount.trusted


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


# -- the rest --------------------------------------------------------------------------------------


async def test_park_and_unpark() -> None:
    async with rigged() as rig:
        assert await rig.mount.park() is SlewOutcome.ARRIVED
        assert (await rig.mount.reading()).parked is True
        assert await rig.mount.park() is SlewOutcome.ARRIVED
        assert rig.language.orders.count("park") == 1
        await rig.mount.unpark()
        assert (await rig.mount.reading()).parked is False


async def test_no_other_order_runs_into_a_slew_nor_a_slew_into_a_pulse() -> None:
    async with rigged(plain(slew_rate_deg_s=1.0)) as rig:
        place = await rig.beside(10.0, -10.0)
        pulse = asyncio.create_task(rig.mount.guide(Direction.NORTH, 0.3))
        other = asyncio.create_task(rig.mount.guide(Direction.WEST, 0.2))
        await asyncio.sleep(0.05)
        with pytest.raises(Busy, match="guide pulse"):
            await rig.mount.slew(place)
        await asyncio.gather(pulse, other)
        slew = asyncio.create_task(rig.mount.slew(place))
        await rig.until(lambda: rig.mount.slew_state is SlewState.UNDER_WAY)
        for order in (
            rig.mount.guide(Direction.NORTH, 0.1),
            rig.mount.set_tracking(False),
            rig.mount.unpark(),
            rig.mount.park(),
        ):
            with pytest.raises(Busy):
                await order
        await rig.mount.stop()
        assert await slew is SlewOutcome.STOPPED


async def test_tracking_and_guiding() -> None:
    async with rigged() as rig:
        await rig.mount.set_tracking(False)
        assert (await rig.mount.reading()).tracking is False
        await rig.mount.set_tracking(True)
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.set_tracking(True, TrackingRate.LUNAR)
        assert refusal.value.reason is Refusal.UNSUPPORTED
        rig.language.skills = rig.language.skills - {Skill.TRACK} | {Skill.TRACKING_RATES}
        await rig.mount.set_tracking(True, TrackingRate.LUNAR)
        with pytest.raises(DeviceRefused):
            await rig.mount.set_tracking(False)
        await rig.mount.guide(Direction.NORTH, 0.05)
        assert "guide n 0.05" in rig.language.orders
        for duration_s in (0.0, -1.0, 61.0, float("nan")):
            with pytest.raises(BadRequest):
                await rig.mount.guide(Direction.NORTH, duration_s)
