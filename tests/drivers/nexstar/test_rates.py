"""A mount behind a hand control at rates of its own: bytes, refusals, and what the tube does then."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fakes.bench import FakeOnPty
from drivers.generic.mount import GenericMount
from drivers.nexstar.codec import base
from drivers.nexstar.codec.dialect import Handset, Tracking, Version
from drivers.nexstar.codec.passthrough import Axis
from drivers.nexstar.fake import FakeNexstar
from drivers.nexstar.rates import Turning, rounded, too_coarse
from mountnav.devices import STARS_RATES, OffsetRates, PierSide, Skill
from mountnav.errors import DeviceRefused, Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Site
from tests.drivers.mounts import nexstar_mount
from tests.drivers.nexstar.test_language import HERE, PATIENCE, QUICK, fake_at_zenith
from tests.drivers.rates_kept import beside_the_meridian, kept_rates

pytestmark = pytest.mark.long

SOUTH = Site(-33.3, 149.1)


@asynccontextmanager
async def opened(fake: FakeNexstar) -> AsyncIterator[GenericMount]:
    """Our mount on its wire, which knows that it is faster than real ones."""
    timing = replace(QUICK, fastest_deg_s=200.0)
    with FakeOnPty(fake) as bench:
        mount = nexstar_mount(bench.address, patience=PATIENCE, timing=timing, site=fake.mechanics.site)
        await mount.open()
        try:
            yield mount
        finally:
            await mount.close()


def german(site: Site = HERE) -> FakeNexstar:
    machine = Machine(mounting="german", slew_rate_deg_s=30.0, acceleration_deg_s2=200.0)
    return FakeNexstar(Mechanics(site, Air(), PointingErrors(), machine=machine))


def test_the_words_are_those_of_celestrons_document() -> None:
    """150″/s: high byte 2, low byte 88 [Celestron, communication protocol]."""
    assert base.move_at(Axis.RA, 150.0).sent == bytes([80, 3, 16, 6, 2, 88, 0, 0])
    assert base.move_at(Axis.RA, -150.0).sent == bytes([80, 3, 16, 7, 2, 88, 0, 0])
    assert base.move_at(Axis.DEC, 120.0).sent == bytes([80, 3, 17, 6, 1, 224, 0, 0])
    assert base.move_at(Axis.DEC, -0.25).sent == bytes([80, 3, 17, 7, 0, 1, 0, 0])


def test_which_way_the_motors_turn() -> None:
    assert Turning(PierSide.EAST, Tracking.EQUATORIAL_NORTH).sky == 1
    assert Turning(PierSide.EAST, Tracking.EQUATORIAL_SOUTH).sky == -1
    assert Turning(PierSide.EAST, Tracking.EQUATORIAL_NORTH).north == -1
    assert Turning(PierSide.WEST, Tracking.EQUATORIAL_NORTH).north == 1


@given(st.floats(-3000.0, 3000.0), st.floats(-3000.0, 3000.0))
def test_rounded_rates_are_near_and_told_exactly(ra: float, dec: float) -> None:
    told = rounded(OffsetRates(ra, dec))
    assert abs(told.ra_arcsec_s - ra) <= 0.1250001
    assert abs(told.dec_arcsec_s - dec) <= 0.1250001
    along = (SIDEREAL_DEG_S * 3600.0 - told.ra_arcsec_s) * 4.0
    assert along == pytest.approx(round(along), abs=1e-6)


def test_slow_rates_are_too_coarse() -> None:
    assert too_coarse(OffsetRates(0.02, 0.01))
    assert too_coarse(OffsetRates(0.0, 0.05))
    assert not too_coarse(OffsetRates(0.0, 1.0))
    assert not too_coarse(OffsetRates(-60.0, 20.0))


@pytest.mark.parametrize("side", [PierSide.EAST, PierSide.WEST])
@pytest.mark.parametrize("site", [HERE, SOUTH])
async def test_it_follows_on_both_sides(site: Site, side: PierSide) -> None:
    fake = german(site)
    async with opened(fake) as mount:
        assert Skill.OFFSET_RATES in mount.skills
        await mount.slew(beside_the_meridian(fake.mechanics, side))
        assert fake.mechanics.pier_side() is side
        for rates in (OffsetRates(2.6, -1.3), OffsetRates(-40.0, 25.0), OffsetRates(60.0, 0.0)):
            await mount.set_offset_rates(rates)
            told = rounded(rates)
            assert kept_rates(fake.mechanics, for_s=20.0) == pytest.approx(
                (told.ra_arcsec_s, told.dec_arcsec_s), abs=1e-3
            )
            reading = await mount.reading()
            assert (reading.tracking, reading.slewing) == (True, False)
        assert fake.feed(b"t") == b"\0#"
        await mount.set_offset_rates(STARS_RATES)
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
        assert fake.feed(b"t") == (b"\x02#" if site is HERE else b"\x03#")
    assert fake.unknown == []


async def test_a_driver_that_comes_anew_ends_what_the_one_before_has_left() -> None:
    fake = german()
    async with opened(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, PierSide.EAST))
        await mount.set_offset_rates(OffsetRates(6.0, -4.0))
        # as one that was killed: a driver that is closed ends its rates
        mount._session.drift.ours = False
    assert kept_rates(fake.mechanics, for_s=20.0) == pytest.approx((6.0, -4.0), abs=0.05)
    async with opened(fake) as mount:
        await mount.set_offset_rates(STARS_RATES)
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
        assert (await mount.reading()).tracking is True


async def test_a_parked_mount_is_not_set_going_by_the_end_of_rates() -> None:
    fake = german()
    async with opened(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, PierSide.EAST))
        await mount.set_park()
        await mount.park()
        heard = len(fake.heard)
        await mount.set_offset_rates(STARS_RATES)
        assert not any(command[:1] in (b"T", b"P") for command in fake.heard[heard:])


async def test_slow_rates_are_refused_and_it_goes_on_tracking() -> None:
    fake = german()
    async with opened(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, PierSide.EAST))
        with pytest.raises(DeviceRefused, match=r"steps of 0\.25″/s") as refused:
            await mount.set_offset_rates(OffsetRates(0.03, -0.02))
        assert refused.value.reason is Refusal.UNSUPPORTED
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
        assert not any(command.startswith(b"T") for command in fake.heard)


async def test_a_stop_and_a_slew_end_the_rates() -> None:
    fake = german()
    async with opened(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, PierSide.WEST))
        await mount.set_offset_rates(OffsetRates(5.0, 5.0))
        await mount.stop()
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
        assert (await mount.reading()).tracking is True
        await mount.set_offset_rates(OffsetRates(5.0, 5.0))
        await mount.slew(beside_the_meridian(fake.mechanics, PierSide.EAST))
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
        assert (await mount.reading()).tracking is True


async def test_that_the_hand_control_took_the_motors_back_is_seen() -> None:
    fake = german()
    async with opened(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, PierSide.WEST))
        await mount.set_offset_rates(OffsetRates(5.0, 5.0))
        assert await mount.offset_rates() is None
        fake.feed(b"T\x02")
        assert await mount.offset_rates() == STARS_RATES


@pytest.mark.parametrize("side", [PierSide.EAST, PierSide.WEST])
async def test_its_axes_move_east_and_north_and_it_tracks_again(side: PierSide) -> None:
    fake = german()
    async with opened(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, side))
        for rate in (0.05, -0.05):
            await mount.move_axis("primary", rate)
            assert kept_rates(fake.mechanics, planned=True)[0] / 3600.0 == pytest.approx(rate, abs=4e-5)
            await mount.move_axis("secondary", rate)
            kept = kept_rates(fake.mechanics, planned=True)
            assert (kept[0] / 3600.0, kept[1] / 3600.0) == pytest.approx((rate, rate), abs=4e-5)
            await mount.move_axis("primary", 0.0)
            await mount.move_axis("secondary", 0.0)
            assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
        assert (await mount.reading()).tracking is True


@pytest.mark.parametrize(
    "handset",
    [
        Handset(Version(1, 2)),
        Handset(Version(4, 39, 5, synscan=True), None, 1),
        Handset(Version(5, 31), 0x11, 12, Version(7, 11)),
        Handset(Version(4, 10), None, 14),
    ],
    ids=["old", "synscan", "altazimuth", "no-side"],
)
async def test_where_signs_or_words_are_not_known_there_are_none(handset: Handset) -> None:
    async with opened(fake_at_zenith(handset=handset)) as mount:
        assert not {Skill.OFFSET_RATES, Skill.MOVE_AXIS} & mount.skills
        assert mount.most_offset_arcsec_s is None
        with pytest.raises(DeviceRefused):
            await mount.set_offset_rates(OffsetRates(5.0, 5.0))
