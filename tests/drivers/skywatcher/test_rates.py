"""A motor controller after what moves among the stars, and moved by hand: judged by where its axes go."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fakes.faults import Fault
from drivers.skywatcher.axes import Gearing, raises_dec, turns_at
from drivers.skywatcher.fake import BOARDS
from drivers.skywatcher.rates import (
    Ground,
    fastest_deg_s,
    ground_rates,
    most_beside,
    rates_of,
    step_beside,
)
from mountnav.devices import STARS_RATES, Direction, OffsetRates, PierSide, Skill
from mountnav.errors import DeviceRefused
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Site
from tests.drivers.rates_kept import beside_the_meridian, kept_rates
from tests.drivers.skywatcher.quick_fakes import NORTH, SOUTH, commands, mounted, quick

pytestmark = pytest.mark.long

EAST, WEST = PierSide.EAST, PierSide.WEST
SIDES = [(site, side) for site in (NORTH, SOUTH) for side in (EAST, WEST)]


@given(
    st.floats(-1e3, 1e3),
    st.floats(-1e3, 1e3),
    st.sampled_from([1, -1]),
    st.sampled_from([1, -1]),
)
def test_motors_rates_and_back(ra: float, dec: float, sky: int, north: int) -> None:
    rates = OffsetRates(ra, dec)
    ground = ground_rates(rates, SIDEREAL_DEG_S, sky, north)
    again = rates_of(ground, SIDEREAL_DEG_S, sky, north)
    assert (again.ra_arcsec_s, again.dec_arcsec_s) == pytest.approx((ra, dec), abs=1e-9)
    assert ground_rates(STARS_RATES, SIDEREAL_DEG_S, sky, north) == Ground(sky * SIDEREAL_DEG_S, 0.0)


@pytest.mark.parametrize("latitude_deg", [49.6, -33.3])
def test_which_way_north_is(latitude_deg: float) -> None:
    near = turns_at(20.0, 10.0, WEST if latitude_deg > 0.0 else EAST, latitude_deg)
    far = turns_at(20.0, 10.0, EAST if latitude_deg > 0.0 else WEST, latitude_deg)
    sign = 1 if latitude_deg > 0.0 else -1
    assert (raises_dec(near, latitude_deg), raises_dec(far, latitude_deg)) == (sign, -sign)


def test_the_steps_and_bounds_of_an_eq6_and_of_a_finer_board() -> None:
    coarse, fine = BOARDS["eq6"].gears, BOARDS["az-eq6"].gears
    assert step_beside(coarse, STARS_RATES) == pytest.approx(15.041 / 620, rel=0.01)
    # near the stars it is fine, but the second motor has no rate below this
    assert step_beside(fine, STARS_RATES) == pytest.approx(0.134, abs=0.001)
    assert step_beside(fine, OffsetRates(0.3, 0.3)) < 0.0002
    assert step_beside(coarse, OffsetRates(-100.0, 0.0)) > 1.0
    most = most_beside(coarse)
    assert most.dec_arcsec_s == pytest.approx(64935 * 1296000 / 9024000 / 10, rel=1e-6)
    assert most_beside(fine).dec_arcsec_s == pytest.approx(128 * 15.041, rel=1e-4)
    gear = Gearing(9_024_000, 64_935, 16)
    assert gear.rate_deg_s(gear.period(fastest_deg_s(gear))) == pytest.approx(fastest_deg_s(gear))


@pytest.mark.parametrize(("site", "side"), SIDES)
@pytest.mark.parametrize("board", ["eq6", "az-eq6"])
async def test_it_follows_at_the_rates_that_are_ordered(site: Site, side: PierSide, board: str) -> None:
    fake = quick(board, site)
    async with mounted(fake) as mount:
        assert Skill.OFFSET_RATES in mount.skills
        await mount.slew(beside_the_meridian(fake.mechanics, side))
        assert fake.mechanics.pier_side() is side
        step = mount.offset_step_arcsec_s
        for rates in (OffsetRates(1.5, -0.4), OffsetRates(-3.25, 12.5), OffsetRates(0.5, -0.02)):
            await mount.set_offset_rates(rates)
            expected = pytest.approx((rates.ra_arcsec_s, rates.dec_arcsec_s), abs=0.6 * step + 1e-3)
            told = await mount.offset_rates()
            assert told is not None
            assert (told.ra_arcsec_s, told.dec_arcsec_s) == expected
            assert kept_rates(fake.mechanics) == expected
            # what it says is what the axes do, rounding included
            assert kept_rates(fake.mechanics) == pytest.approx(
                (told.ra_arcsec_s, told.dec_arcsec_s), abs=2e-3
            )
            reading = await mount.reading()
            assert (reading.tracking, reading.slewing) == (True, False)
        await mount.set_offset_rates(STARS_RATES)
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=0.6 * step)
        assert await mount.offset_rates() == STARS_RATES


async def test_rates_that_turn_the_first_motor_round_or_let_it_rest() -> None:
    fake = quick("az-eq6")
    async with mounted(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, EAST))
        for ra in (400.0, 15.041067):
            await mount.set_offset_rates(OffsetRates(ra, -300.0))
            # the way up is too short for all of the usual time
            kept = kept_rates(fake.mechanics, for_s=10.0)
            assert kept == pytest.approx((ra, -300.0), rel=2e-3, abs=0.01)
            reading = await mount.reading()
            assert (reading.tracking, reading.slewing) == (True, False)
        await mount.stop()
        assert await mount.offset_rates() == STARS_RATES
        assert kept_rates(fake.mechanics)[1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("ra", [0.0, 6.0, 400.0, 15.041067])
async def test_a_driver_that_comes_anew_ends_what_the_one_before_has_left(ra: float) -> None:
    fake = quick("az-eq6")
    async with mounted(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, EAST))
        await mount.set_offset_rates(OffsetRates(ra, -30.0))
        # as one that was killed: a driver that is closed ends its rates
        mount._session.drift.ours = False
    assert abs(fake.mechanics.axis_velocity("dec")) > 0.005
    async with mounted(fake) as mount:
        await mount.set_offset_rates(STARS_RATES)
        assert await mount.offset_rates() == STARS_RATES
        assert fake.mechanics.axis_velocity("dec") == pytest.approx(0.0, abs=1e-6)
        # one that rested to follow its target rests: whether it should track nobody knows
        along_deg_s = 0.0 if ra > 15.0 and ra < 16.0 else SIDEREAL_DEG_S
        assert fake.mechanics.axis_velocity("ha") == pytest.approx(along_deg_s, abs=1e-5)


async def test_what_it_cannot_run_at_is_refused_and_changes_nothing() -> None:
    fake = quick("eq6")
    async with mounted(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, EAST))
        told = len(commands(fake, "GIJK"))
        most = mount.most_offset_arcsec_s
        assert most is not None
        with pytest.raises(DeviceRefused, match="declination"):
            await mount.set_offset_rates(OffsetRates(0.0, 1.01 * most.dec_arcsec_s))
        assert len(commands(fake, "GIJK")) == told
        await mount.set_tracking(False)
        with pytest.raises(DeviceRefused, match="doesn't track"):
            await mount.set_offset_rates(OffsetRates(1.0, 0.0))


async def test_a_pulse_leaves_the_rates_as_they_were() -> None:
    fake = quick("az-eq6")
    async with mounted(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, WEST))
        await mount.set_offset_rates(OffsetRates(1.5, -0.4))
        for direction in Direction:
            await mount.guide(direction, 0.2)
            assert kept_rates(fake.mechanics) == pytest.approx((1.5, -0.4), abs=1e-3)


async def test_a_slew_ends_the_rates() -> None:
    fake = quick("az-eq6")
    async with mounted(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, WEST))
        await mount.set_offset_rates(OffsetRates(1.5, -0.4))
        await mount.slew(beside_the_meridian(fake.mechanics, EAST))
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)


@pytest.mark.parametrize(("site", "side"), SIDES)
async def test_moved_axes_go_east_and_north_and_track_again(site: Site, side: PierSide) -> None:
    fake = quick("az-eq6", site)
    async with mounted(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, side))
        for rate in (0.05, -0.05):
            await mount.move_axis("primary", rate)
            assert kept_rates(fake.mechanics, planned=True)[0] / 3600.0 == pytest.approx(rate, rel=1e-3)
            await mount.move_axis("secondary", rate)
            assert kept_rates(fake.mechanics, planned=True) == pytest.approx(
                (rate * 3600.0, rate * 3600.0), rel=1e-3
            )
            await mount.move_axis("primary", 0.0)
            await mount.move_axis("secondary", 0.0)
            assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
        reading = await mount.reading()
        assert (reading.tracking, reading.slewing) == (True, False)


async def test_a_moved_axis_is_stopped_by_the_drivers_own_limit_on_either_side() -> None:
    fake = quick("az-eq6")
    async with mounted(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, EAST))
        language = mount.language
        for along in (1.0, -1.0):
            left = await language._until_limit_deg(along)  # type: ignore[attr-defined]
            # from the east side, 4.5° west of the meridian: the counterweight hangs nearly level
            assert left == pytest.approx(100.0 - along * -85.5, abs=0.5)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (Fault("rate-reversed", rates="ra"), (-1.5, -0.4)),
        (Fault("rate-swapped"), (-0.4, 1.5)),
        (Fault("rate-ignored", rates="dec"), (1.5, 0.0)),
        (Fault("rate-factor", factor=2.0), (3.0, -0.8)),
    ],
)
async def test_faults_of_rates_spoil_what_it_keeps_and_not_its_slews(
    fault: Fault, expected: tuple[float, float]
) -> None:
    fake = quick("az-eq6", faults=[fault])
    async with mounted(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, WEST))
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
        await mount.set_offset_rates(OffsetRates(1.5, -0.4))
        assert kept_rates(fake.mechanics) == pytest.approx(expected, abs=2e-3)
        told = await mount.offset_rates()
        assert told is not None
        assert (told.ra_arcsec_s, told.dec_arcsec_s) == pytest.approx((1.5, -0.4), abs=2e-3)
        await mount.slew(beside_the_meridian(fake.mechanics, EAST))
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
