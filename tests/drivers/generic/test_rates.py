"""Offset rates: sent once, read back, ended before anything else moves; and what isn't known is said."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace

import pytest

from drivers.generic.language import Readout
from mountnav.clock import utc_now
from mountnav.devices import (
    STARS_RATES,
    OffsetRates,
    Skill,
    SlewOutcome,
    SyncOutcome,
    TakesOffsetRates,
    TrackingRate,
)
from mountnav.errors import (
    BadRequest,
    Busy,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
    Refusal,
    RefusedButDone,
)
from mountnav.sky.coordinates import Apparent
from tests.drivers.generic.plain_rig import Rig, plain, rigged

COMET = OffsetRates(0.05, -0.02)
FAST = OffsetRates(-40.0, 60.0)
PASS = OffsetRates(1500.0, -2500.0)


def _sent(rig: Rig) -> list[str]:
    return [order for order in rig.language.orders if order.startswith("rates")]


def _same(one: OffsetRates | None, other: OffsetRates) -> bool:
    return one is not None and (one.ra_arcsec_s, one.dec_arcsec_s) == pytest.approx(
        (other.ra_arcsec_s, other.dec_arcsec_s)
    )


async def _measured(rig: Rig, seconds: float = 0.6) -> tuple[float, float]:
    """The rates in right ascension and declination by two readings, ″/s."""
    before = await rig.mount.reading()
    await asyncio.sleep(seconds)
    after = await rig.mount.reading()
    took_s = (after.utc - before.utc).total_seconds()
    turned_deg = (after.place.ra_deg - before.place.ra_deg + 180.0) % 360.0 - 180.0
    return 3600.0 * turned_deg / took_s, 3600.0 * (after.place.dec_deg - before.place.dec_deg) / took_s


@pytest.mark.parametrize("rates", [FAST, PASS])
async def test_it_moves_as_ordered_and_ends(rates: OffsetRates) -> None:
    async with rigged() as rig:
        assert isinstance(rig.mount, TakesOffsetRates)
        await rig.mount.set_offset_rates(rates)
        assert _same(rig.mount.rates_known, rates)
        assert _same(await rig.mount.offset_rates(), rates)
        await asyncio.sleep(0.1)
        assert await _measured(rig) == pytest.approx((rates.ra_arcsec_s, rates.dec_arcsec_s), abs=1.0)
        await rig.mount.set_offset_rates(STARS_RATES)
        await asyncio.sleep(0.1)
        assert await _measured(rig) == pytest.approx((0.0, 0.0), abs=0.5)
        assert len(_sent(rig)) == 2
        assert rig.mount.trusted
        assert not rig.heard("untrusted")


@pytest.mark.parametrize("rates", [OffsetRates(math.nan, 0.0), OffsetRates(0.0, math.inf)])
async def test_what_is_no_number_never_goes_out(rates: OffsetRates) -> None:
    async with rigged() as rig:
        with pytest.raises(BadRequest):
            await rig.mount.set_offset_rates(rates)
        assert not _sent(rig)


async def test_a_rate_that_is_too_fast_is_refused_with_the_numbers() -> None:
    async with rigged() as rig:
        rig.language.most_offset_arcsec_s = OffsetRates(30.0, 10.0)
        with pytest.raises(DeviceRefused, match=r"declination: it takes at most 10\.0000″/s") as refusal:
            await rig.mount.set_offset_rates(OffsetRates(29.0, -10.5))
        assert refusal.value.reason is Refusal.LIMIT
        assert not _sent(rig)
        await rig.mount.set_offset_rates(OffsetRates(-30.0, 10.0))


async def test_a_mount_that_lacks_it_is_not_asked() -> None:
    async with rigged() as rig:
        rig.language.skills = rig.language.skills - {Skill.OFFSET_RATES}
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.set_offset_rates(COMET)
        assert refusal.value.reason is Refusal.UNSUPPORTED
        assert await rig.mount.offset_rates() is None
        assert not _sent(rig)


@pytest.mark.parametrize("state", ["parked", "not tracking", "untrusted"])
async def test_it_is_not_begun_in_a_state_that_forbids_it(state: str) -> None:
    async with rigged() as rig:
        if state == "parked":
            rig.language.parked, reason = True, Refusal.PARKED
        elif state == "untrusted":
            rig.mount._session.distrust("for the test")
            reason = Refusal.UNTRUSTED
        else:
            await rig.mount.set_tracking(False)
            reason = Refusal.NOT_TRACKING
        await rig.mount.reading()
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.set_offset_rates(COMET)
        assert refusal.value.reason is reason
        assert not _sent(rig)
        # to end them is always allowed
        await rig.mount.set_offset_rates(STARS_RATES)


async def test_not_while_it_slews() -> None:
    async with rigged(plain(slew_rate_deg_s=4.0)) as rig:
        slew = asyncio.ensure_future(rig.mount.slew(await rig.beside(8.0, -5.0)))
        await rig.until(lambda: "slew" in rig.language.orders)
        with pytest.raises(Busy):
            await rig.mount.set_offset_rates(COMET)
        assert await slew is SlewOutcome.ARRIVED
        assert not _sent(rig)


# -- read back -------------------------------------------------------------------------------------


async def test_one_that_says_nothing_is_taken_at_its_word() -> None:
    async with rigged() as rig:
        rig.language.tells_rates = False
        await rig.mount.set_offset_rates(COMET)
        assert _same(rig.mount.rates_known, COMET)
        assert await rig.mount.offset_rates() is None


async def test_what_shows_late_is_waited_for() -> None:
    async with rigged() as rig:
        rig.language.rates_late_s = 0.2
        await rig.mount.set_offset_rates(COMET)
        assert _same(rig.mount.rates_known, COMET)


async def test_what_the_protocol_rounds_is_what_is_known() -> None:
    async with rigged() as rig:
        rig.language.offset_step_arcsec_s = 0.15
        rig.language.takes_rates = lambda rates: OffsetRates(
            round(rates.ra_arcsec_s / 0.15) * 0.15, round(rates.dec_arcsec_s / 0.15) * 0.15
        )
        await rig.mount.set_offset_rates(OffsetRates(1.0, -1.0))
        known = rig.mount.rates_known
        assert known is not None
        assert (known.ra_arcsec_s, known.dec_arcsec_s) == pytest.approx((1.05, -1.05))


@pytest.mark.parametrize("factor", [15.0, -1.0, 1.0027379, 1 / 220])
async def test_other_rates_than_ordered_are_ended(factor: float) -> None:
    async with rigged() as rig:
        rig.language.takes_rates = lambda rates: OffsetRates(
            factor * rates.ra_arcsec_s, factor * rates.dec_arcsec_s
        )
        with pytest.raises(DeviceRefused, match=r"says that it has .*; they were ended"):
            await rig.mount.set_offset_rates(OffsetRates(3.0, 1.0))
        assert rig.mount.rates_known is not None
        assert rig.mount.rates_known.none
        assert rig.language.mechanics.beside_arcsec_s == (0.0, 0.0)


async def test_rates_that_are_accepted_and_ignored_are_refused() -> None:
    async with rigged() as rig:
        rig.language.takes_rates = lambda _: None
        with pytest.raises(DeviceRefused, match=r"says that it has \+0\.0000"):
            await rig.mount.set_offset_rates(COMET)
        assert len(_sent(rig)) == 1


async def test_an_end_that_is_accepted_and_ignored_is_told() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(COMET)
        rig.language.takes_rates = lambda _: None
        with pytest.raises(DeviceRefused, match="could not be ended"):
            await rig.mount.set_offset_rates(STARS_RATES)
        assert _same(rig.mount.rates_known, COMET)
        with pytest.raises(DeviceRefused):
            await rig.mount.slew(await rig.beside(1.0, 1.0))
        assert "slew" not in rig.language.orders


# -- answers that are lost -------------------------------------------------------------------------


@pytest.mark.parametrize("lost", [DeviceSilent("nothing"), DeviceGarbled("noise")])
async def test_reading_back_decides_when_the_answer_was_lost(lost: DeviceError) -> None:
    async with rigged() as rig:
        rig.language.rates_lost = lost
        await rig.mount.set_offset_rates(COMET)
        assert _same(rig.mount.rates_known, COMET)
        rig.language.takes_rates = lambda _: None
        with pytest.raises(type(lost), match="not what was ordered"):
            await rig.mount.set_offset_rates(FAST)
        assert _same(rig.mount.rates_known, COMET)


@pytest.mark.parametrize("unread", [True, False])
async def test_unknown_is_said_when_nothing_decides(unread: bool) -> None:
    async with rigged() as rig:
        rig.language.rates_lost = DeviceSilent("nothing")
        rig.language.tells_rates = not unread
        rig.language.rates_unread = None if unread else DeviceSilent("still nothing")
        with pytest.raises(DeviceSilent, match="is not known"):
            await rig.mount.set_offset_rates(COMET)
        assert rig.mount.rates_known is None
        rig.language.rates_lost = rig.language.rates_unread = None
        # ours to end, before anything moves
        assert await rig.mount.slew(await rig.beside(1.0, 1.0)) is SlewOutcome.ARRIVED
        assert rig.language.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert rig.mount.rates_known == STARS_RATES


async def test_rates_read_back_as_no_numbers_are_nonsense() -> None:
    async with rigged() as rig:
        rig.language.read_offset_rates = _nonsense  # type: ignore[method-assign]
        with pytest.raises(DeviceGarbled):
            await rig.mount.set_offset_rates(COMET)
        assert rig.mount.rates_known is None


async def _nonsense() -> OffsetRates:
    return OffsetRates(math.nan, 0.0)


# -- refusals --------------------------------------------------------------------------------------


async def test_a_refusal_leaves_it_as_it_was() -> None:
    async with rigged() as rig:
        rig.language.denies.add("rates")
        rig.language.takes_rates = lambda _: None
        with pytest.raises(DeviceRefused, match="below horizon"):
            await rig.mount.set_offset_rates(COMET)
        assert rig.mount.rates_known == STARS_RATES
        assert rig.mount.trusted


async def test_refused_and_taken_shows_in_what_it_says() -> None:
    async with rigged() as rig:
        rig.language.denies.add("rates")
        with pytest.raises(RefusedButDone, match="undone"):
            await rig.mount.set_offset_rates(COMET)
        assert rig.language.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert rig.heard("refused-but-done")


async def test_refused_and_half_taken_shows_too() -> None:
    async with rigged() as rig:
        rig.language.denies.add("rates")
        rig.language.takes_rates = lambda rates: OffsetRates(rates.ra_arcsec_s, 0.0)
        with pytest.raises(RefusedButDone):
            await rig.mount.set_offset_rates(COMET)
        assert rig.language.mechanics.beside_arcsec_s == (0.0, 0.0)


async def test_refused_and_taken_shows_in_its_drift() -> None:
    async with rigged() as rig:
        rig.language.tells_rates = False
        rig.language.denies.add("rates")
        with pytest.raises(RefusedButDone, match=r"moved by .*stopped"):
            await rig.mount.set_offset_rates(FAST)
        assert rig.language.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert not rig.mount.trusted


async def test_a_refusal_that_nothing_can_check_leaves_them_unknown() -> None:
    async with rigged() as rig:
        rig.language.tells_rates = False
        await rig.mount.set_offset_rates(STARS_RATES)
        rig.language.denies.add("rates")
        rig.language.takes_rates = lambda _: None
        with pytest.raises(DeviceRefused):
            await rig.mount.set_offset_rates(COMET)
        assert rig.mount.rates_known is None
        with pytest.raises(DeviceRefused):
            await rig.mount.set_offset_rates(PASS)


# -- what ends them --------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["slew", "stop", "park", "home", "tracking", "lunar", "rest", "close"])
async def test_they_end_with(order: str) -> None:
    async with rigged() as rig:
        rig.language.skills |= {Skill.TRACKING_RATES}
        await rig.mount.set_offset_rates(FAST)
        target = await rig.beside(2.0, -2.0)
        if order == "slew":
            assert await rig.mount.slew(target) is SlewOutcome.ARRIVED
        elif order == "stop":
            await rig.mount.stop()
        elif order == "park":
            await rig.mount.park()
        elif order == "home":
            await rig.mount.home()
        elif order == "close":
            await rig.mount.close()
        else:
            rate = TrackingRate.LUNAR if order == "lunar" else TrackingRate.SIDEREAL
            await rig.mount.set_tracking(order != "rest", rate)
        assert _sent(rig) == ["rates -40 60", "rates 0 0"]
        assert rig.language.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert rig.mount.rates_known == STARS_RATES


async def test_a_stop_goes_out_before_they_are_ended() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(FAST)
        await rig.mount.stop()
        orders = [one for one in rig.language.orders if one.startswith(("stop", "rates"))]
        assert orders[1] == "stop 0"


async def test_a_stop_that_cannot_end_them_says_so() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(FAST)
        rig.language.rates_lost = DeviceSilent("nothing")
        rig.language.takes_rates = lambda _: None
        with pytest.raises(DeviceSilent, match="may track at offset rates"):
            await rig.mount.stop()
        assert rig.mount.rates_known is None
        assert "stop 0" in rig.language.orders


async def test_a_stop_while_they_go_out_comes_last() -> None:
    async with rigged() as rig:
        rig.language.rates_go_out.clear()
        order = asyncio.ensure_future(rig.mount.set_offset_rates(FAST))
        await rig.until(lambda: _sent(rig))
        stop = asyncio.ensure_future(rig.mount.stop())
        await rig.until(lambda: "stop 0" in rig.language.orders)
        rig.language.rates_go_out.set()
        await stop
        with pytest.raises(DeviceRefused, match="a stop came"):
            await order
        assert rig.language.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert rig.mount.rates_known == STARS_RATES


async def test_a_stop_that_comes_first_keeps_them_from_going_out() -> None:
    async with rigged() as rig:
        async with rig.mount._session.ordering:
            order = asyncio.ensure_future(rig.mount.set_offset_rates(FAST))
            await asyncio.sleep(0.05)
            await rig.mount.stop()
        with pytest.raises(DeviceRefused, match="was not sent"):
            await order
        assert not _sent(rig)


async def test_those_of_a_broken_link_are_unknown_and_ended_by_the_next() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(FAST)
        rig.language.absent = True
        rig.language.lose()
        await rig.until(lambda: rig.heard("link-lost"))
        assert rig.mount.rates_known is None
        rig.language.absent = False
        await rig.until(lambda: rig.heard("link-back"))
        assert rig.language.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert rig.mount.rates_known == STARS_RATES
        assert _sent(rig) == ["rates -40 60", "rates 0 0"]


async def test_a_restart_leaves_them_unknown() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(FAST)
        rig.language.fresh = True
        await rig.mount.reading()
        assert rig.mount.rates_known is None


async def test_those_of_others_are_found_told_and_left_alone() -> None:
    language = plain()
    language.mechanics.track_beside(1.5, 0.0)
    async with rigged(language) as rig:
        assert rig.mount.report is not None
        assert any("+1.5000″/s" in problem for problem in rig.mount.report.problems)
        assert rig.mount.rates_known == OffsetRates(pytest.approx(1.5), 0.0)  # type: ignore[arg-type]
        await rig.mount.close()
        assert not _sent(rig)


async def test_those_of_others_end_before_a_slew_of_ours() -> None:
    language = plain()
    language.mechanics.track_beside(1.5, 0.0)
    async with rigged(language) as rig:
        assert await rig.mount.slew(await rig.beside(1.0, 1.0)) is SlewOutcome.ARRIVED
        assert _sent(rig) == ["rates 0 0"]


async def test_a_park_is_not_held_up_by_rates_that_do_not_end() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(COMET)
        rig.language.takes_rates = lambda _: None
        assert await rig.mount.park() is SlewOutcome.ARRIVED


# -- readings --------------------------------------------------------------------------------------


@pytest.mark.parametrize("rates", [COMET, FAST, PASS])
@pytest.mark.parametrize("tells_motion", [True, False])
async def test_a_drift_is_no_motion_and_a_stop_ends_soon(rates: OffsetRates, tells_motion: bool) -> None:
    async with rigged() as rig:
        rig.language.tells_motion = tells_motion
        await rig.mount.set_offset_rates(rates)
        asked = 0
        readout = rig.language.readout

        async def counted() -> object:
            nonlocal asked
            asked += 1
            return await readout()

        rig.language.readout = counted  # type: ignore[method-assign, assignment]
        for _ in range(10):
            await asyncio.sleep(0.05)
            before = asked
            await rig.mount.reading()
            assert asked - before <= 2, "a drift at known rates is believed at once"
            assert not rig.mount._session.in_motion
        assert rig.mount.trusted


async def test_a_jump_at_rates_is_a_jump() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(PASS)
        await rig.mount.reading()
        place = rig.language.mechanics.reported()
        rig.language.mechanics.sync(Apparent(place.ra_deg, place.dec_deg - 20.0, utc_now()))
        await rig.mount.reading()
        assert not rig.mount.trusted


async def test_one_odd_reading_is_not_excused_by_rates() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(FAST)
        place = (await rig.mount.reading()).place
        rig.language.odd.append(Apparent(place.ra_deg, place.dec_deg - 0.1, utc_now()))
        assert (await rig.mount.reading()).place.dec_deg == pytest.approx(place.dec_deg, abs=0.03)


@pytest.mark.parametrize("rates", [FAST, OffsetRates(0.0, -60.0)])
@pytest.mark.parametrize("ignored", [True, False])
async def test_a_sync_at_rates_is_judged_by_where_they_lead(rates: OffsetRates, ignored: bool) -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(rates)
        rig.language.sync_ignored = ignored
        result = await rig.mount.sync(await rig.beside(0.0, 0.1))
        assert result.outcome is (SyncOutcome.IGNORED if ignored else SyncOutcome.SEEN)
        assert rig.mount.trusted


async def test_a_cancelled_order_leaves_them_unknown_and_ours_to_end() -> None:
    async with rigged() as rig:
        rig.language.rates_go_out.clear()
        order = asyncio.ensure_future(rig.mount.set_offset_rates(FAST))
        await rig.until(lambda: _sent(rig))
        order.cancel()
        with pytest.raises(asyncio.CancelledError):
            await order
        assert rig.mount.rates_known is None
        rig.language.rates_go_out.set()
        await rig.mount.slew(await rig.beside(1.0, 1.0))
        assert _sent(rig)[-1] == "rates 0 0"


async def test_a_link_that_breaks_on_the_way_is_told() -> None:
    async with rigged() as rig:
        rig.language.rates_lost = DeviceMissing("the line was lost")
        with pytest.raises(DeviceMissing):
            await rig.mount.set_offset_rates(COMET)
        assert rig.mount.rates_known is None


@pytest.mark.parametrize("how", ["close", "lost", "park", "rest"])
async def test_one_that_has_come_to_rest_is_not_told_to_track_as_for_a_star(how: str) -> None:
    """Some mounts begin to track when they are told a star's rates: not one that was left at rest."""
    async with rigged() as rig:
        await rig.mount.set_offset_rates(FAST)
        # by its own key, say
        rig.language.mechanics.tracking = False
        await rig.mount.reading()
        if how == "close":
            await rig.mount.close()
        elif how == "park":
            await rig.mount.park()
        elif how == "rest":
            await rig.mount.set_tracking(False)
        else:
            rig.language.lose()
            await rig.until(lambda: rig.heard("link-back"))
        assert len(_sent(rig)) == 1
        if how == "lost":
            # before it moves again it is told
            rig.mount.trust()
            assert await rig.mount.slew(await rig.beside(1.0, 1.0)) is SlewOutcome.ARRIVED
            assert _sent(rig)[-1] == "rates 0 0"


async def test_one_that_says_it_slews_while_it_follows_takes_new_rates() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(FAST)
        readout = rig.language.readout

        async def slewing() -> Readout:
            return replace(await readout(), slewing=True)

        rig.language.readout = slewing  # type: ignore[method-assign]
        await rig.mount.reading()
        await rig.mount.set_offset_rates(COMET)
        assert _same(rig.mount.rates_known, COMET)
        rig.language.readout = readout  # type: ignore[method-assign]
