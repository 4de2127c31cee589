"""Rates beside the sidereal one and motion keys of the LX200 dialects: bytes, and what the tube does then."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.lx200.codec import astro_physics, onstep
from drivers.lx200.codec.greeting import dialect_named
from drivers.lx200.codec.rates import direction_of
from drivers.lx200.fake.onstep import OnStepSpeaker
from drivers.wire.command import Unreadable
from mountnav.devices import STARS_RATES, Direction, OffsetRates, PierSide, Skill
from mountnav.errors import DeviceRefused, Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import SIDEREAL_DEG_S, SOLAR_TO_SIDEREAL, Air, Site
from tests.drivers.lx200.german_fakes import german, opened
from tests.drivers.rates_kept import beside_the_meridian, kept_rates

pytestmark = pytest.mark.long

RATES = OffsetRates(2.5, -1.25)


# -- OnStep ----------------------------------------------------------------------------------------


def test_onstep_counts_arcseconds_per_sidereal_second() -> None:
    """ASCOM's rate in seconds per sidereal second times 15, and its declination rate by 1.0027379."""
    orders = onstep.OFFSETS.set(OffsetRates(15.0 * 1.00273790935, -1.00273790935))
    assert [order.sent for order in orders] == [b":SXTR,15.000000#", b":SXTD,-1.000000#"]
    assert [order.sent for order in onstep.OFFSETS.set(STARS_RATES)] == [
        b":SXTR,0.000000#",
        b":SXTD,0.000000#",
    ]
    assert [order.sent for order in onstep.OFFSETS.set(OffsetRates(-1e-9, -0.0))] == [
        b":SXTR,0.000000#",
        b":SXTD,0.000000#",
    ]
    with pytest.raises(ValueError, match="can't be told"):
        onstep.set_offset("R", 1805.0)
    for nonsense in (float("nan"), float("inf")):
        with pytest.raises(ValueError, match="can't be told"):
            onstep.set_offset("D", nonsense)


@given(st.floats(-1804.0, 1804.0))
def test_onstep_rates_come_back_as_they_were_set(rate: float) -> None:
    speaker = OnStepSpeaker(Mechanics(Site(49.0, 22.0), Air(), PointingErrors(), clock=FastClock(0.0)))
    for axis, ask in (("R", onstep.RA_OFFSET), ("D", onstep.DEC_OFFSET)):
        assert speaker.say(onstep.set_offset(axis, rate).sent[1:-1].decode()) == b"1"
        answer = speaker.say(ask.sent[1:-1].decode())
        assert answer is not None
        read = ask.read(answer, True)
        assert read is not None
        assert read.value * SOLAR_TO_SIDEREAL == pytest.approx(rate, abs=1e-6)


@pytest.mark.parametrize("wrong", [b"1801.00000000#", b"nan#", b"1e3#", b"+1.0#", b"12:30:00#", b"1.0 #"])
def test_what_is_no_rate_of_onstep_is_not_believed(wrong: bytes) -> None:
    with pytest.raises(Unreadable):
        onstep.RA_OFFSET.read(wrong, True)


def test_the_fake_onstep_keeps_a_rate_beside_the_moons() -> None:
    clock = FastClock(0.0)
    mechanics = Mechanics(Site(49.0, 22.0), Air(), PointingErrors(), machine=Machine(), clock=clock)
    speaker = OnStepSpeaker(mechanics)
    speaker.say("TL")
    speaker.say("SXTR,1.0")
    clock.on(2.0)
    expected = 14.511415 - SOLAR_TO_SIDEREAL
    assert mechanics.axis_velocity("ha") * 3600.0 == pytest.approx(expected, abs=1e-9)
    status = speaker.say("GU")
    assert b"(" in (status or b"")
    assert speaker.say("SXTD,9999") == b"1"
    assert speaker.say("GXTD") == b"1800.00000000#"
    assert speaker.say("SXTX,1") is None
    speaker.say("SXTR,0")
    speaker.say("SXTD,0")
    clock.on(2.0)
    assert mechanics.axis_velocity("ha") * 3600.0 == pytest.approx(14.511415, abs=1e-9)


def test_the_fake_onstep_forgets_rates_at_home() -> None:
    clock = FastClock(0.0)
    mechanics = Mechanics(Site(49.0, 22.0), Air(), PointingErrors(), machine=Machine(), clock=clock)
    speaker = OnStepSpeaker(mechanics)
    speaker.say("SXTR,1.0")
    speaker.say("hC")
    for _ in range(100):
        clock.on(1.0)
        speaker.say("GU")
    assert speaker.say("GXTR") == b"0.00000000#"


@pytest.mark.parametrize("side", [PierSide.EAST, PierSide.WEST])
@pytest.mark.parametrize("latitude_deg", [49.6, -30.0])
async def test_onstep_keeps_the_rates_on_both_sides(side: PierSide, latitude_deg: float) -> None:
    fake = german("onstep", site=Site(latitude_deg, 36.9))
    async with opened(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, side))
        assert fake.mechanics.pier_side() is side
        assert Skill.OFFSET_RATES in mount.skills
        await mount.set_offset_rates(RATES)
        told = await mount.offset_rates()
        assert told is not None
        assert (told.ra_arcsec_s, told.dec_arcsec_s) == pytest.approx((2.5, -1.25), abs=1e-5)
        assert kept_rates(fake.mechanics) == pytest.approx((2.5, -1.25), abs=1e-3)
        await mount.set_offset_rates(STARS_RATES)
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert fake.unknown == []


async def test_an_onstep_without_the_words_has_no_rates_of_its_own() -> None:
    fake = german("onstep")
    said = fake._speaker.say  # type: ignore[union-attr]
    fake._speaker.say = lambda text: None if text.startswith("GXT") else said(text)  # type: ignore
    async with opened(fake) as mount:
        assert Skill.OFFSET_RATES not in mount.skills
        assert Skill.MOVE_AXIS in mount.skills
        with pytest.raises(DeviceRefused) as refused:
            await mount.set_offset_rates(RATES)
        assert refused.value.reason is Refusal.UNSUPPORTED


@pytest.mark.parametrize("side", [PierSide.EAST, PierSide.WEST])
async def test_onsteps_axes_move_to_the_east_and_to_the_north(side: PierSide) -> None:
    fake = german("onstep")
    async with opened(fake) as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, side))
        assert fake.mechanics.pier_side() is side
        speed = 8.0 * SIDEREAL_DEG_S
        for rate in (speed, -speed):
            await mount.move_axis("primary", rate)
            await mount.reading()  # an order without an answer has been heard when the next one is answered
            ra, _ = kept_rates(fake.mechanics, planned=True)
            assert ra / 3600.0 == pytest.approx(rate, rel=1e-3)
            await mount.move_axis("primary", 0.0)
            await mount.move_axis("secondary", rate)
            await mount.reading()
            _, dec = kept_rates(fake.mechanics, planned=True)
            assert dec / 3600.0 == pytest.approx(rate, rel=1e-3)
            await mount.move_axis("secondary", 0.0)
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-2)
    assert b":RA" not in b"".join(fake.heard)


def test_the_signs_of_moved_axes() -> None:
    assert direction_of("primary", 0.1) is Direction.EAST
    assert direction_of("primary", -0.1) is Direction.WEST
    assert direction_of("secondary", 0.1) is Direction.NORTH
    assert direction_of("secondary", -0.1) is Direction.SOUTH
    keys = dialect_named("onstep").keys
    assert keys is not None
    assert [order.sent for order in keys.pressed("primary", 20.0 * SIDEREAL_DEG_S)] == [b":R6#", b":Me#"]
    assert [order.sent for order in keys.pressed("secondary", -SIDEREAL_DEG_S)] == [b":R2#", b":Ms#"]
    assert [order.sent for order in keys.let_go_of("primary")] == [b":Qe#"]
    with pytest.raises(ValueError, match="can't be moved"):
        keys.pressed("primary", 3.0 * SIDEREAL_DEG_S)


# -- Astro-Physics, AM5 ----------------------------------------------------------------------------


def test_astro_physics_counts_times_sidereal_on_top_of_tracking() -> None:
    """`:RR+1.0000#` is twice sidereal, `:RR-1.0000#` rest [AP protocol, as INDI notes it]."""
    sidereal = SIDEREAL_DEG_S * 3600.0
    words = astro_physics.OFFSETS
    assert [order.sent for order in words.set(OffsetRates(-sidereal, 0.0))] == [b":RR+1.0000#"]
    assert [order.sent for order in words.set(OffsetRates(sidereal, 0.0))] == [b":RR-1.0000#"]
    assert [order.sent for order in words.set(STARS_RATES)] == [b":RR+0.0000#"]
    assert [order.sent for order in words.set(OffsetRates(1e-5, 0.0))] == [b":RR+0.0000#"]
    with pytest.raises(ValueError, match="can't be told"):
        words.set(OffsetRates(-11.0 * sidereal, 0.0))


@pytest.mark.parametrize("side", [PierSide.EAST, PierSide.WEST])
async def test_astro_physics_follows_in_right_ascension_alone(side: PierSide) -> None:
    fake = german("ap")
    async with opened(fake, dialect="ap") as mount:
        await mount.slew(beside_the_meridian(fake.mechanics, side))
        for ra in (2.5, -100.0):
            await mount.set_offset_rates(OffsetRates(ra, 0.0))
            assert kept_rates(fake.mechanics, for_s=20.0) == pytest.approx((ra, 0.0), abs=1e-3)
        # it can't say which it has: it is taken at its word
        assert await mount.offset_rates() is None
        with pytest.raises(DeviceRefused, match="declination") as refused:
            await mount.set_offset_rates(RATES)
        assert refused.value.reason is Refusal.UNSUPPORTED
        with pytest.raises(DeviceRefused, match="each side of the pier"):
            await mount.language.send_offset_rates(RATES)
        await mount.stop()
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert fake.unknown == []


@pytest.mark.parametrize("side", [PierSide.EAST, PierSide.WEST])
async def test_am5s_axes_move_to_the_east_and_to_the_north(side: PierSide) -> None:
    fake = german("am5")
    async with opened(fake) as mount:
        assert Skill.OFFSET_RATES not in mount.skills
        await mount.slew(beside_the_meridian(fake.mechanics, side))
        speed = 60.0 * SIDEREAL_DEG_S
        for axis, number in (("primary", 0), ("secondary", 1)):
            for rate in (speed, -speed):
                await mount.move_axis(axis, rate)  # type: ignore[arg-type]
                await mount.reading()
                kept = kept_rates(fake.mechanics, planned=True)
                assert kept[number] / 3600.0 == pytest.approx(rate, rel=1e-3)
                await mount.move_axis(axis, 0.0)  # type: ignore[arg-type]
        assert kept_rates(fake.mechanics) == pytest.approx((0.0, 0.0), abs=1e-2)


@pytest.mark.parametrize("dialect", ["onstep", "am5"])
async def test_an_altazimuth_one_is_not_moved_by_its_keys(dialect: str) -> None:
    fake = german(dialect)
    said = fake._speaker.say  # type: ignore[union-attr]

    def altaz(text: str) -> bytes | None:
        answer = said(text)
        if text == "GU" and answer is not None:
            return answer.replace(b"E", b"A") if dialect == "onstep" else answer.replace(b"G", b"Z")
        return answer

    fake._speaker.say = altaz  # type: ignore[union-attr,method-assign]
    async with opened(fake) as mount:
        with pytest.raises(DeviceRefused, match="azimuth") as refused:
            await mount.move_axis("primary", 8.0 * SIDEREAL_DEG_S)
        assert refused.value.reason is Refusal.UNSUPPORTED
        assert not any(command.startswith((b":Me", b":Mw", b":R")) for command in fake.heard)


@pytest.mark.parametrize(
    "name", ["10micron", "gemini", "autostar", "lx200gps", "classic", "generic", "basic"]
)
def test_the_others_have_neither_for_what_their_words_mean_is_not_certain(name: str) -> None:
    dialect = dialect_named(name)
    assert not {Skill.OFFSET_RATES, Skill.MOVE_AXIS} & dialect.skills
