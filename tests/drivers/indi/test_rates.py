"""Offset rates and moved axes behind a real `indiserver`, with real drivers: which of them tell the truth."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from drivers.generic.mount import GenericMount
from drivers.indi.codec import messages
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import STARS_RATES, MountAxis, OffsetRates, Skill, SlewOutcome, TrackingRate
from mountnav.errors import BadRequest, BadSettings, Busy, DeviceRefused, Refusal
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.coordinates import Apparent
from mountnav.sky.sphere import half_turn_deg
from tests.drivers.indi.real_server import TELESCOPE, IndiServer
from tests.drivers.indi.test_language_over_real_drivers import REAL, served
from tests.drivers.lx200.german_fakes import beside

pytestmark = pytest.mark.long

OPTIONS = "poll_s=0.1&heartbeat_s=0.5&set_site=yes&set_clock=yes"


@pytest.fixture
async def server(tmp_path: Path) -> AsyncIterator[IndiServer]:
    one = IndiServer(("indi_simulator_telescope",), tmp_path / "home")
    await one.start()
    await one.set_numbers(TELESCOPE, "POLLING_PERIOD", PERIOD_MS=200.0)
    try:
        yield one
    finally:
        await one.kill()


@pytest.fixture
async def mount(server: IndiServer) -> AsyncIterator[GenericMount]:
    made = open_mount(f"indi://127.0.0.1:{server.port}/Telescope%20Simulator?{OPTIONS}")
    assert isinstance(made, GenericMount)
    await made.open()
    made.trust()
    if (await made.reading()).parked:
        await made.unpark()
    await made.set_tracking(True)
    # off the pole, where it wakes up
    place = (await made.reading()).place
    assert await made.slew(Apparent(place.ra_deg, 40.0, utc_now())) is SlewOutcome.ARRIVED
    try:
        yield made
    finally:
        await made.close()


async def _measured(mount: GenericMount, seconds: float = 2.0) -> tuple[float, float]:
    """Rates by two readings, ″/s; the simulator keeps time by whole looks of its own."""
    before = await mount.reading()
    await asyncio.sleep(seconds)
    after = await mount.reading()
    took_s = (after.utc - before.utc).total_seconds()
    turned_deg = half_turn_deg(after.place.ra_deg - before.place.ra_deg)
    return 3600.0 * turned_deg / took_s, 3600.0 * (after.place.dec_deg - before.place.dec_deg) / took_s


async def _truly(mechanics: Mechanics, seconds: float = 1.0) -> tuple[float, float]:
    """The same of what the fake believes at two instants."""
    began = utc_now()
    await asyncio.sleep(seconds)
    ended = utc_now()
    before, after = mechanics.reported(began), mechanics.reported(ended)
    took_s = (ended - began).total_seconds()
    turned_deg = half_turn_deg(after.ra_deg - before.ra_deg)
    return 3600.0 * turned_deg / took_s, 3600.0 * (after.dec_deg - before.dec_deg) / took_s


async def test_the_simulator_follows(mount: GenericMount) -> None:
    assert Skill.OFFSET_RATES in mount.skills
    await mount.set_offset_rates(OffsetRates(60.0, -40.0))
    assert await _measured(mount) == pytest.approx((60.0, -40.0), abs=12.0)
    # an axis that would turn back: INDI refuses that while it tracks, and reports the new rate all the same
    await mount.set_offset_rates(OffsetRates(-60.0, 40.0))
    assert await _measured(mount) == pytest.approx((-60.0, 40.0), abs=12.0)
    told = await mount.offset_rates()
    assert told is not None
    assert (told.ra_arcsec_s, told.dec_arcsec_s) == pytest.approx((-60.0, 40.0), abs=1e-5)
    await mount.set_offset_rates(STARS_RATES)
    assert await _measured(mount) == pytest.approx((0.0, 0.0), abs=3.0)
    assert mount.rates_known == STARS_RATES
    assert mount.trusted


async def test_what_ends_them_leaves_the_server_with_a_stars_rate(
    server: IndiServer, mount: GenericMount
) -> None:
    await mount.set_offset_rates(OffsetRates(5.0, 1.0))
    await mount.stop()
    panel = server.device(TELESCOPE)
    await panel.bring_up(may_connect=False, needed=("TELESCOPE_TRACK_RATE",))
    rate = await panel.told("TELESCOPE_TRACK_RATE")
    assert rate.number("TRACK_RATE_RA") == pytest.approx(15.041067, abs=1e-6)
    assert (await panel.told("TELESCOPE_TRACK_MODE")).on("TRACK_SIDEREAL")
    await panel.client.close()


async def test_a_rate_beyond_what_indi_takes_is_refused_with_the_numbers(mount: GenericMount) -> None:
    with pytest.raises(DeviceRefused, match=r"at most 16384\.0000″/s") as refusal:
        await mount.set_offset_rates(OffsetRates(0.0, 20_000.0))
    assert refusal.value.reason is Refusal.LIMIT


async def test_rates_that_another_program_set_are_told(server: IndiServer) -> None:
    panel = server.device(TELESCOPE)
    await panel.bring_up(may_connect=True, needed=("TELESCOPE_TRACK_RATE",))
    order = messages.new_numbers(
        TELESCOPE, "TELESCOPE_TRACK_RATE", {"TRACK_RATE_RA": 14.0, "TRACK_RATE_DE": 1.0}
    )
    await panel.ordered(order, asking="TELESCOPE_TRACK_RATE", echo="TELESCOPE_TRACK_RATE")
    modes = panel.get("TELESCOPE_TRACK_MODE")
    assert modes is not None
    await panel.set_switches("TELESCOPE_TRACK_MODE", {key: key == "TRACK_CUSTOM" for key in modes.values})
    await panel.client.close()
    mount = open_mount(f"indi://127.0.0.1:{server.port}/Telescope%20Simulator?{OPTIONS}")
    assert isinstance(mount, GenericMount)
    await mount.open()
    try:
        assert mount.report is not None
        assert any("+1.0411″/s in right ascension" in problem for problem in mount.report.problems)
    finally:
        await mount.close()


async def test_custom_tracking_is_ordered_with_rates_only(mount: GenericMount) -> None:
    with pytest.raises(BadRequest, match="offset rates"):
        await mount.set_tracking(True, TrackingRate.CUSTOM)


@pytest.mark.parametrize(("axis", "rate_deg_s"), [("primary", 0.5), ("secondary", -0.5)])
async def test_the_simulators_axes_move(mount: GenericMount, axis: MountAxis, rate_deg_s: float) -> None:
    assert [span.most_deg_s for span in mount.axis_rates_deg_s[axis]][1:] == [0.5, 2.5, 6.0]
    place = (await mount.reading()).place
    await mount.move_axis(axis, rate_deg_s)
    with pytest.raises(Busy):
        await mount.slew(place)
    along = await _measured(mount, 1.5)
    assert along[0 if axis == "primary" else 1] / 3600.0 == pytest.approx(rate_deg_s, rel=0.4)
    await mount.move_axis(axis, 0.0)
    assert not mount.axes_moved
    rests = await _measured(mount, 0.5)
    assert max(map(abs, rests)) < 30.0


async def test_both_axes_have_one_speed(mount: GenericMount) -> None:
    await mount.move_axis("primary", 0.5)
    with pytest.raises(DeviceRefused, match="two speeds at once"):
        await mount.move_axis("secondary", 2.5)
    await mount.move_axis("secondary", 0.5)
    await mount.stop()
    assert not mount.axes_moved
    with pytest.raises(BadRequest, match=r"0\.5°/s, 2\.5°/s"):
        await mount.move_axis("primary", 1.0)


@pytest.mark.parametrize("text", ["", "a", "0.5,", "0", "-1,2", "100", ",".join(["1"] * 33), "nan"])
def test_speeds_that_make_no_sense_are_refused(text: str) -> None:
    with pytest.raises(BadSettings, match="slew_rates_deg_s"):
        open_mount(f"indi://127.0.0.1:1/Mount?slew_rates_deg_s={text}")


# -- drivers of mounts, on fakes of these ------------------------------------------------------------------


async def _ready(mount: GenericMount) -> None:
    if (await mount.reading()).parked:
        await mount.unpark()
    await mount.set_tracking(True)
    mount.trust()


@pytest.mark.long
async def test_astro_physics_moves_south_for_north_and_so_is_not_asked(tmp_path: Path) -> None:
    async with served(REAL["indi_lx200ap_gtocp2"], tmp_path / "home") as (mechanics, mount):
        await _ready(mount)
        assert mount.report is not None
        assert any("it moves south at a rate to the north" in one for one in mount.report.problems)
        await mount.set_offset_rates(OffsetRates(10.0, 0.0))
        assert await _truly(mechanics) == pytest.approx((10.0, 0.0), abs=0.1)
        with pytest.raises(DeviceRefused, match="declination: it has no rate of its own there"):
            await mount.set_offset_rates(OffsetRates(0.0, 10.0))
        assert await _truly(mechanics) == pytest.approx((10.0, 0.0), abs=0.1)
        await mount.set_offset_rates(STARS_RATES)
        assert await _truly(mechanics) == pytest.approx((0.0, 0.0), abs=0.1)


@pytest.mark.long
async def test_an_ioptron_follows_in_right_ascension_and_its_buttons_are_seen_through(tmp_path: Path) -> None:
    """Its driver takes `:mn#` for north; its maker writes of a falling declination, and so does the fake."""
    async with served(REAL["indi_ioptronv3_telescope"], tmp_path / "home") as (mechanics, mount):
        await _ready(mount)
        await mount.set_offset_rates(OffsetRates(-3.0, 0.0))
        assert await _truly(mechanics) == pytest.approx((-3.0, 0.0), abs=0.1)
        with pytest.raises(DeviceRefused, match="declination"):
            await mount.set_offset_rates(OffsetRates(0.0, 0.5))
        await mount.set_offset_rates(STARS_RATES)
        told: list[str] = []
        mount.listen(lambda what, _: told.append(what))
        speed = mount.axis_rates_deg_s["secondary"][-1].most_deg_s
        await mount.move_axis("secondary", speed)
        async with asyncio.timeout(30.0):
            while "axis-went-wrong" not in told or mount.axes_moved:
                await asyncio.sleep(0.05)
        await mount.move_axis("secondary", speed)
        await asyncio.sleep(1.0)
        assert (await _truly(mechanics, 0.5))[1] > 1000.0
        await mount.move_axis("secondary", 0.0)
        assert told.count("axis-went-wrong") == 1


@pytest.mark.long
async def test_eqmod_follows_in_both_coordinates(tmp_path: Path) -> None:
    async with served(REAL["indi_eqmod_telescope"], tmp_path / "home") as (mechanics, mount):
        await _ready(mount)
        # off the pole, where it wakes up
        assert await mount.slew(beside(mechanics.reported(), -8.0, -45.0)) is SlewOutcome.ARRIVED
        await _ready(mount)
        await mount.set_offset_rates(OffsetRates(6.0, -4.0))
        await asyncio.sleep(1.0)
        # as its gears round them
        assert await _truly(mechanics, 2.0) == pytest.approx((6.0, -4.0), abs=0.3)
        await mount.set_offset_rates(STARS_RATES)
        await asyncio.sleep(1.0)
        assert await _truly(mechanics, 2.0) == pytest.approx((0.0, 0.0), abs=0.1)


@pytest.mark.long
@pytest.mark.parametrize("driver", ["indi_lx200_OnStep", "indi_lx200_10micron"])
async def test_drivers_that_take_rates_and_keep_none_are_not_asked(tmp_path: Path, driver: str) -> None:
    async with served(REAL[driver], tmp_path / "home") as (mechanics, mount):
        assert Skill.OFFSET_RATES not in mount.skills
        with pytest.raises(DeviceRefused) as refusal:
            await mount.set_offset_rates(OffsetRates(1.0, 0.0))
        assert refusal.value.reason is Refusal.UNSUPPORTED
        assert mechanics.beside_arcsec_s == (0.0, 0.0)
