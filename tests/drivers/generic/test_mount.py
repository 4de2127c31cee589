"""The interface of a generic mount, on a language without a wire over the real mechanics."""

from __future__ import annotations

import math

import pytest

from mountnav.clock import utc_now
from mountnav.devices import (
    Announces,
    Direction,
    Skill,
    Skilled,
    SlewOutcome,
    TrackingRate,
    Trusts,
)
from mountnav.errors import BadRequest, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.testing.check_mount import check_mount
from tests.drivers.generic.plain_rig import rigged


async def test_conforms() -> None:
    async with rigged() as rig:
        await check_mount(rig.mount)
        assert isinstance(rig.mount, Trusts)
        assert isinstance(rig.mount, Announces)
        assert isinstance(rig.mount, Skilled)


async def test_a_parked_mount_is_not_sent_anywhere() -> None:
    async with rigged() as rig:
        rig.language.parked = True
        with pytest.raises(DeviceRefused) as refusal:
            await rig.mount.slew(await rig.beside(1.0, -1.0))
        assert refusal.value.reason is Refusal.PARKED
        assert "slew" not in rig.language.orders


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


async def test_the_other_kind_of_place_is_refused() -> None:
    async with rigged() as rig:
        for order in (rig.mount.slew, rig.mount.sync, rig.mount.destination_side):
            with pytest.raises(BadRequest):
                await order(Icrs(1.0, 2.0))


async def test_park_and_unpark() -> None:
    async with rigged() as rig:
        assert await rig.mount.park() is SlewOutcome.ARRIVED
        assert (await rig.mount.reading()).parked is True
        assert await rig.mount.park() is SlewOutcome.ARRIVED
        assert rig.language.orders.count("park") == 1
        await rig.mount.unpark()
        assert (await rig.mount.reading()).parked is False


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
