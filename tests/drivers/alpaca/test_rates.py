"""Offset rates and moved axes of Alpaca telescopes, as real drivers take them, and as they get them wrong."""

from __future__ import annotations

import asyncio

import pytest

from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import (
    STARS_RATES,
    MountAxis,
    OffsetRates,
    PierSide,
    RateSpan,
    Skill,
    SlewOutcome,
    TrackingRate,
)
from mountnav.errors import BadRequest, BadSettings, DeviceRefused, DeviceSilent, Refusal, RefusedButDone
from mountnav.simulation.mechanics import Machine, Mechanics
from mountnav.sky.sphere import half_turn_deg
from tests.drivers.alpaca.alpaca_server import FakeTelescope, quick_mechanics
from tests.drivers.alpaca.test_language import Rig, rigged

pytestmark = pytest.mark.long

COMET = OffsetRates(0.04, -0.03)
FAST = OffsetRates(45.0, -30.0)


async def _measured(rig: Rig, seconds: float = 1.0) -> tuple[float, float]:
    """Rates in right ascension and declination, ″/s, of what the mechanics believe at two instants."""
    mechanics, began = rig.telescope.mechanics, utc_now()
    await asyncio.sleep(seconds)
    ended = utc_now()
    before, after = mechanics.reported(began), mechanics.reported(ended)
    took_s = (ended - began).total_seconds()
    turned_deg = half_turn_deg(after.ra_deg - before.ra_deg)
    return 3600.0 * turned_deg / took_s, 3600.0 * (after.dec_deg - before.dec_deg) / took_s


def _believes(mechanics: Mechanics) -> tuple[float, float]:
    return mechanics.beside_arcsec_s


@pytest.mark.parametrize("version", [3, 4])
async def test_it_takes_both_rates_in_alpacas_units(version: int) -> None:
    async with rigged(FakeTelescope(quick_mechanics(), version)) as rig:
        assert Skill.OFFSET_RATES in rig.mount.skills
        await rig.mount.set_offset_rates(FAST)
        assert rig.telescope.rates[0] == pytest.approx(45.0 / 15.0 * 0.9972695677, rel=1e-8)
        assert rig.telescope.rates[1] == -30.0
        assert await _measured(rig) == pytest.approx((45.0, -30.0), abs=0.1)
        told = await rig.mount.offset_rates()
        assert told is not None
        assert (told.ra_arcsec_s, told.dec_arcsec_s) == pytest.approx((45.0, -30.0), abs=1e-6)
        await rig.mount.set_offset_rates(STARS_RATES)
        assert rig.telescope.rates == [0.0, 0.0]


async def test_slow_rates_keep_their_digits() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(OffsetRates(0.000123, -0.000456))
        assert _believes(rig.telescope.mechanics) == pytest.approx((0.000123, -0.000456), abs=2e-9)


@pytest.mark.parametrize("lacks", ["cansetrightascensionrate", "cansetdeclinationrate"])
async def test_one_that_takes_one_rate_alone_follows_no_comet(lacks: str) -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.can[lacks] = False
    async with rigged(telescope) as rig:
        assert Skill.OFFSET_RATES not in rig.mount.skills
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.set_offset_rates(COMET)
        assert refusal.value.reason is Refusal.UNSUPPORTED


async def test_the_rate_beside_which_they_count_is_made_sidereal() -> None:
    async with rigged() as rig:
        await rig.mount.set_tracking(True, TrackingRate.LUNAR)
        await rig.mount.set_offset_rates(COMET)
        assert _believes(rig.telescope.mechanics) == pytest.approx((0.04, -0.03))
        # and another rate ends them
        await rig.mount.set_tracking(True, TrackingRate.SOLAR)
        assert rig.telescope.mechanics.rate is TrackingRate.SOLAR
        assert rig.mount.rates_known == STARS_RATES


async def test_a_second_rate_that_is_refused_takes_the_first_one_back() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(OffsetRates(0.5, 0.25))
        rig.fault("declinationrate", "error", verb="put", number=0x401, body="Declination rate out of range")
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.set_offset_rates(OffsetRates(1.0, 9000.0))
        assert refusal.value.reason is Refusal.LIMIT
        assert _believes(rig.telescope.mechanics) == pytest.approx((0.5, 0.25), abs=1e-6)
        assert rig.mount.rates_known is not None
        assert rig.mount.rates_known.ra_arcsec_s == pytest.approx(0.5)


@pytest.mark.parametrize("member", ["rightascensionrate", "declinationrate"])
async def test_refused_and_done_is_ended(member: str) -> None:
    async with rigged() as rig:
        rig.fault(member, "denied", verb="put", number=0x500)
        rates = OffsetRates(45.0, 0.0) if member == "rightascensionrate" else OffsetRates(0.0, 45.0)
        with pytest.raises(RefusedButDone, match="undone"):
            await rig.mount.set_offset_rates(rates)
        assert _believes(rig.telescope.mechanics) == (0.0, 0.0)


@pytest.mark.parametrize("what", ["drop", "deaf"])
async def test_an_answer_that_is_lost_is_made_good_by_asking(what: str) -> None:
    async with rigged(more="&timeout_s=1") as rig:
        rig.fault("declinationrate", what, verb="put", seconds=3.0)
        await rig.mount.set_offset_rates(COMET)
        assert _believes(rig.telescope.mechanics) == pytest.approx((0.04, -0.03))
        assert rig.server.orders().count("declinationrate") == 1


async def test_a_unit_that_was_misread_shows_in_no_answer() -> None:
    """The driver says what it was told, and moves 220 times as fast: only the sky shows that."""
    telescope = FakeTelescope(quick_mechanics())
    telescope.ra_unit_arcsec_s *= 220.0
    async with rigged(telescope) as rig:
        await rig.mount.set_offset_rates(OffsetRates(0.1, 0.0))
        assert (await _measured(rig))[0] == pytest.approx(22.0, abs=1.5)


async def test_what_abortslew_ends_and_goes_on_being_said_is_ended() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.says_rates_after_abort = True
    async with rigged(telescope) as rig:
        await rig.mount.set_offset_rates(FAST)
        await rig.mount.stop()
        assert rig.telescope.rates == [0.0, 0.0]
        assert rig.mount.rates_known == STARS_RATES


async def test_rates_end_before_a_slew_begins() -> None:
    async with rigged() as rig:
        await rig.mount.set_offset_rates(FAST)
        assert await rig.mount.slew(await rig.beside(-5.0)) is SlewOutcome.ARRIVED
        orders = rig.server.orders()
        assert orders.index("slewtocoordinatesasync") > len(orders) - 1 - orders[::-1].index(
            "declinationrate"
        )
        assert rig.telescope.rates == [0.0, 0.0]


async def test_rates_that_others_set_are_told() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope._set_rates(0, 0.1)
    async with rigged(telescope) as rig:
        assert rig.mount.report is not None
        assert any("offset rates" in problem for problem in rig.mount.report.problems)
        assert rig.server.orders() == ["connect"]


async def test_rates_that_make_no_sense_are_no_reason_not_to_connect() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.rates = ["fast", 0.0]  # type: ignore[list-item]
    async with rigged(telescope) as rig:
        assert rig.mount.rates_known is None
        assert rig.mount.report is not None
        assert any("is not known" in problem for problem in rig.mount.report.problems)


# -- axes ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("axis", "rate_deg_s"), [("primary", 1.0), ("primary", -0.7), ("secondary", 0.8)])
@pytest.mark.parametrize("west", [False, True])
async def test_an_axis_moves_to_greater_coordinates(axis: MountAxis, rate_deg_s: float, west: bool) -> None:
    mechanics = quick_mechanics()
    if west:
        mechanics.slew(mechanics.reported(), PierSide.WEST)
        while mechanics.slewing():
            await asyncio.sleep(0.05)
    async with rigged(FakeTelescope(mechanics)) as rig:
        assert (await rig.mount.reading()).pier_side is (PierSide.WEST if west else PierSide.EAST)
        await rig.mount.move_axis(axis, rate_deg_s)
        await asyncio.sleep(0.3)
        along = await _measured(rig)
        went = along[0] if axis == "primary" else along[1]
        assert went == pytest.approx(3600.0 * rate_deg_s, rel=0.2)
        await rig.mount.move_axis(axis, 0.0)
        assert rig.telescope.moved == [0.0, 0.0]
        assert rig.told.count("axis-went-wrong") == 0
        assert rig.mount.trusted


async def test_tracking_is_put_into_the_speed() -> None:
    async with rigged() as rig:
        await rig.mount.move_axis("primary", 0.01)
        # the hour angle axis would have to turn with the sky, and back by the speed
        assert rig.telescope.moved[0] == pytest.approx(-(0.01 - 15.041067 / 3600.0), abs=1e-8)
        await asyncio.sleep(0.5)
        assert (await _measured(rig))[0] == pytest.approx(36.0, abs=3.0)
        await rig.mount.move_axis("primary", 0.0)


@pytest.mark.parametrize("axis", ["primary", "secondary"])
async def test_an_axis_that_goes_the_other_way_is_stopped_and_known(axis: MountAxis) -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.axis_senses = [-1.0, -1.0]
    async with rigged(telescope) as rig:
        await rig.mount.move_axis(axis, 1.0)
        await rig.until(lambda: "axis-went-wrong" in rig.told)
        await rig.until(lambda: not rig.mount.axes_moved)
        await rig.mount.reading()
        await rig.mount.move_axis(axis, 1.0)
        await asyncio.sleep(0.3)
        along = await _measured(rig)
        assert (along[0] if axis == "primary" else along[1]) == pytest.approx(3600.0, rel=0.2)
        await rig.mount.move_axis(axis, 0.0)
        assert rig.told.count("axis-went-wrong") == 1


async def test_signs_that_the_settings_state_are_believed() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.axis_senses = [-1.0, -1.0]
    async with rigged(telescope, more="&axis_signs=pm") as rig:
        for axis, which in (("primary", 0), ("secondary", 1)):
            await rig.mount.move_axis(axis, 1.0)  # type: ignore[arg-type]
            await asyncio.sleep(0.3)
            assert (await _measured(rig, 0.6))[which] == pytest.approx(3600.0, rel=0.25)
            await rig.mount.move_axis(axis, 0.0)  # type: ignore[arg-type]
        assert "axis-went-wrong" not in rig.told


@pytest.mark.parametrize("signs", ["p", "ppp", "+-", "xx", ""])
def test_signs_that_make_no_sense_are_refused(signs: str) -> None:
    with pytest.raises(BadSettings, match="axis_signs"):
        open_mount(f"alpaca+http://127.0.0.1:1/telescope/0?axis_signs={signs}")


async def test_only_speeds_that_it_has_go_out() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.axis_rates[0] = [{"Minimum": 0.5, "Maximum": 0.5}, {"Minimum": 2.0, "Maximum": 3.0}]
    telescope.axis_rates[1] = []
    async with rigged(telescope) as rig:
        assert rig.mount.axis_rates_deg_s == {"primary": (RateSpan(0.5, 0.5), RateSpan(2.0, 3.0))}
        with pytest.raises(BadRequest, match=r"0\.5°/s, 2 to 3°/s"):
            await rig.mount.move_axis("primary", 1.0)
        with pytest.raises(DeviceRefused):
            await rig.mount.move_axis("secondary", 1.0)
        # a speed of its own that tracking can't be put into goes out as it is
        await rig.mount.move_axis("primary", 0.5)
        assert rig.telescope.moved[0] == -0.5
        await rig.mount.move_axis("primary", 0.0)


async def test_a_telescope_whose_axes_make_no_sense_is_not_moved_by_hand() -> None:
    telescope = FakeTelescope(quick_mechanics())
    telescope.axis_rates[0] = [{"Minimum": -1.0, "Maximum": 1.0}]
    telescope.axis_rates[1] = []
    async with rigged(telescope) as rig:
        assert Skill.MOVE_AXIS not in rig.mount.skills
        assert rig.mount.report is not None
        assert any("primary axis" in problem for problem in rig.mount.report.problems)


async def test_an_old_interface_without_axes() -> None:
    telescope = FakeTelescope(quick_mechanics(), 1)
    telescope.missing |= {"canmoveaxis", "alignmentmode", "axisrates", "trackingrate", "trackingrates"}
    async with rigged(telescope, more="&epoch=apparent") as rig:
        assert Skill.MOVE_AXIS not in rig.mount.skills


async def test_a_stop_ends_a_moved_axis() -> None:
    async with rigged() as rig:
        await rig.mount.move_axis("secondary", -1.0)
        await rig.mount.stop()
        assert rig.telescope.moved == [0.0, 0.0]
        assert not rig.telescope.mechanics.slewing()
        assert await rig.mount.slew(await rig.beside(2.0)) is SlewOutcome.ARRIVED


async def test_an_end_that_is_not_answered_becomes_a_stop() -> None:
    async with rigged(more="&timeout_s=0.6") as rig:
        await rig.mount.move_axis("secondary", -1.0)
        rig.fault("moveaxis", "refuse-connection", times=1)
        await rig.mount.move_axis("secondary", 0.0)
        assert "abortslew" in rig.server.orders()
        assert not rig.mount.axes_moved


async def test_parked_it_is_not_moved() -> None:
    telescope = FakeTelescope(quick_mechanics(Machine(mounting="german")))
    async with rigged(telescope) as rig:
        await rig.mount.park()
        for order in (rig.mount.move_axis("primary", 1.0), rig.mount.set_offset_rates(COMET)):
            with pytest.raises(DeviceRefused) as refusal:
                await order
            assert refusal.value.reason is Refusal.PARKED


async def test_a_silent_server_leaves_rates_unknown() -> None:
    async with rigged(more="&timeout_s=0.5") as rig:
        for member in ("rightascensionrate", "declinationrate"):
            rig.fault(member, "slow", seconds=2.0, times=20)
        with pytest.raises(DeviceSilent):
            await rig.mount.set_offset_rates(COMET)
        assert rig.mount.rates_known is None
        rig.server.faults.clear()


async def test_another_client_sees_the_units_that_we_do() -> None:
    """alpyca, of ASCOM's makers, beside ours: what one sets the other reads, and the axis turns so."""
    alpaca = pytest.importorskip("alpaca.telescope", reason="alpyca is not installed")
    async with rigged() as rig:
        host = f"127.0.0.1:{rig.server.port}"

        def by_alpyca() -> tuple[float, float]:
            other = alpaca.Telescope(host, 0)
            told = other.RightAscensionRate, other.DeclinationRate
            other.RightAscensionRate, other.DeclinationRate = -1.0, 2.5
            return told

        await rig.mount.set_offset_rates(OffsetRates(15.0, -1.0))
        told = await asyncio.to_thread(by_alpyca)
        assert told == pytest.approx((0.9972695677, -1.0), rel=1e-8)
        ours = await rig.mount.offset_rates()
        assert ours is not None
        assert (ours.ra_arcsec_s, ours.dec_arcsec_s) == pytest.approx((-15.041067, 2.5), abs=1e-5)
        # that they were another's is known from now on
        assert rig.mount.rates_known == ours
        spans = await asyncio.to_thread(
            lambda: [
                (one.Minimum, one.Maximum)
                for one in alpaca.Telescope(host, 0).AxisRates(alpaca.TelescopeAxes(0))
            ]
        )
        assert [(one.least_deg_s, one.most_deg_s) for one in rig.mount.axis_rates_deg_s["primary"]] == spans
