"""An iOptron mount at its custom rate and by its arrow keys: bytes, and what the tube does then."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fakes.faults import Fault
from drivers.ioptron import rates
from drivers.ioptron.codec import v3
from drivers.ioptron.codec.values import custom_rate_from_text
from drivers.wire.command import Unreadable
from mountnav.devices import STARS_RATES, OffsetRates, Skill, TrackingRate
from mountnav.errors import BadRequest, DeviceRefused, Refusal
from mountnav.sky.coordinates import SIDEREAL_DEG_S
from tests.drivers.ioptron.german_fakes import beside, fake_of, opened
from tests.drivers.rates_kept import kept_rates


def test_the_words() -> None:
    assert v3.set_custom_rate(0.9).sent == b":RR09000#"
    assert v3.set_custom_rate(1.00005).sent in (b":RR10000#", b":RR10001#")
    assert v3.CUSTOM_RATE.sent == b":GTR#"
    assert (v3.move_ra(up=True).sent, v3.move_ra(up=False).sent) == (b":mw#", b":me#")
    for wrong in (0.0999, 1.9001, float("nan")):
        with pytest.raises(ValueError, match="custom rate"):
            v3.set_custom_rate(wrong)
    for number in (0, 10):
        with pytest.raises(ValueError, match="speed"):
            v3.set_arrow_speed(number)


@given(st.integers(1_000, 19_000))
def test_custom_rates_are_read_as_they_are_written(rate: int) -> None:
    wire = v3.set_custom_rate(rate / 10_000.0).sent
    assert custom_rate_from_text(wire[3:8]) == rate / 10_000.0


@pytest.mark.parametrize("wrong", [b"00999", b"19001", b"1000", b"100000", b"1.000", b"-1000"])
def test_what_is_no_custom_rate_is_not_believed(wrong: bytes) -> None:
    with pytest.raises(Unreadable):
        custom_rate_from_text(wrong)


async def test_it_follows_in_right_ascension() -> None:
    fake = fake_of()
    async with opened(fake) as mount:
        assert Skill.OFFSET_RATES in mount.skills
        assert mount.most_offset_arcsec_s == OffsetRates(pytest.approx(13.537, abs=1e-3), 0.0)  # type: ignore[arg-type]
        for ra in (0.5, -2.25, 13.5, -13.5):
            await mount.set_offset_rates(OffsetRates(ra, 0.0))
            assert kept_rates(fake.mechanics) == pytest.approx((ra, 0.0), abs=1e-3)
            told = await mount.offset_rates()
            assert told is not None
            assert told.ra_arcsec_s == pytest.approx(ra, abs=0.5001 * mount.offset_step_arcsec_s)
            assert (await mount.reading()).tracking is True
        await mount.set_offset_rates(STARS_RATES)
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-4)
        assert await mount.offset_rates() == STARS_RATES
        assert fake.mechanics.rate is TrackingRate.SIDEREAL
    assert fake.unknown == []


async def test_it_says_that_its_declination_takes_no_rate() -> None:
    fake = fake_of()
    async with opened(fake) as mount:
        with pytest.raises(DeviceRefused, match=r"\+0\.1000″/s in declination") as refused:
            await mount.set_offset_rates(OffsetRates(0.5, 0.1))
        assert refused.value.reason is Refusal.UNSUPPORTED
        with pytest.raises(DeviceRefused, match="right ascension alone"):
            await rates.order_rates(mount.language._exchange, OffsetRates(0.5, 0.1))  # type: ignore
        assert not any(command.startswith((b":RR", b":RT")) for command in fake.heard)
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-4)


async def test_a_rate_left_from_before_is_told_and_a_slew_ends_ours() -> None:
    fake = fake_of()
    fake.carry_out(b":RR09500#")
    fake.carry_out(b":RT4#")
    async with opened(fake) as mount:
        told = await mount.offset_rates()
        assert told is not None
        assert told.ra_arcsec_s == pytest.approx(0.05 * 15.041, abs=1e-3)
        await mount.set_offset_rates(OffsetRates(1.0, 0.0))
        await mount.slew(beside(fake.mechanics.reported(), 1.0, 1.0))
        assert await mount.offset_rates() == STARS_RATES
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-4)


@pytest.mark.parametrize(("dialect", "model"), [("v2", None), ("v3", "5035")])
async def test_the_older_set_and_altazimuth_models_have_none(dialect: str, model: str | None) -> None:
    async with opened(fake_of(dialect=dialect, model=model)) as mount:
        assert not {Skill.OFFSET_RATES, Skill.MOVE_AXIS} & mount.skills
        assert mount.most_offset_arcsec_s is None
        with pytest.raises(DeviceRefused) as refused:
            await mount.set_offset_rates(OffsetRates(0.5, 0.0))
        assert refused.value.reason is Refusal.UNSUPPORTED


async def test_its_arrow_keys_move_right_ascension() -> None:
    fake = fake_of()
    async with opened(fake) as mount:
        for times in (64.0, -64.0):
            rate = times * SIDEREAL_DEG_S
            await mount.move_axis("primary", rate)
            await mount.reading()
            ra, dec = kept_rates(fake.mechanics, planned=True)
            assert (ra / 3600.0, dec) == pytest.approx((rate, 0.0), rel=1e-3, abs=1e-3)
            await mount.move_axis("primary", 0.0)
            assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
        with pytest.raises(BadRequest):
            await mount.move_axis("primary", 3.0 * SIDEREAL_DEG_S)
        with pytest.raises(DeviceRefused):
            await mount.move_axis("secondary", 64.0 * SIDEREAL_DEG_S)


async def test_dropped_rates_are_found_out() -> None:
    fake = fake_of(faults=[Fault("rate-dropped")])
    async with opened(fake) as mount:
        with pytest.raises(DeviceRefused, match="says that it has"):
            await mount.set_offset_rates(OffsetRates(1.0, 0.0))
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-4)
