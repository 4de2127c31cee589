"""Real INDI drivers order custom rates of our fakes: a judge from outside of their units and signs.

INDI's `TRACK_RATE_RA` is the rate of the hour angle axis, ″/s: 15.041 for a star, less for a target that
moves to the east.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from mountnav.sky.coordinates import Site
from tests.drivers.indi_process import Indi, running
from tests.drivers.ioptron.german_fakes import fake_of
from tests.drivers.lx200.german_fakes import german
from tests.drivers.rates_kept import kept_rates
from tests.drivers.skywatcher.quick_fakes import NORTH, SOUTH, quick
from tests.drivers.skywatcher.test_fake_indi import DEVICE, DRIVER, PACKAGE, connect, tell_site_and_time

SIDEREAL_ARCSEC_S = 15.041067


async def track_at(indi: Indi, ra_arcsec_s: float, dec_arcsec_s: float = 0.0) -> None:
    """Have an INDI driver track at rates of the axes, as one of its clients does."""
    await indi.give(
        "Number",
        "TELESCOPE_TRACK_RATE",
        TRACK_RATE_RA=f"{ra_arcsec_s:.6f}",
        TRACK_RATE_DE=f"{dec_arcsec_s:.6f}",
    )
    await indi.give("Switch", "TELESCOPE_TRACK_MODE", TRACK_CUSTOM="On")


@pytest.mark.long
async def test_the_real_ioptron_driver_sets_a_custom_rate(tmp_path: Path) -> None:
    fake = fake_of()
    with FakeOnPty(fake) as bench:
        async with running("indi_ioptronv3_telescope", "iOptronV3", tmp_path) as indi:
            await indi.connect(bench)
            tracking = ("TELESCOPE_TRACK_STATE", "TRACK_ON")
            # before it knows that the mount tracks it keeps a rate to itself
            await indi.until(lambda: indi.values.get(tracking) == "On", "seeing that it tracks")
            for east_arcsec_s in (1.25, -2.5):
                ordered = SIDEREAL_ARCSEC_S - east_arcsec_s
                count = len(fake.obeyed)
                # it sends the rate in custom mode alone
                await indi.give("Switch", "TELESCOPE_TRACK_MODE", TRACK_CUSTOM="On")
                await track_at(indi, ordered)
                await indi.until(
                    lambda count=count: any(one[:3] == b":RR" for one in fake.obeyed[count:]),  # type: ignore[misc]
                    "setting a rate",
                )
                await indi.until(
                    lambda east=east_arcsec_s: (
                        kept_rates(fake.mechanics)  # type: ignore[misc]
                        == pytest.approx((east, 0.0), abs=2e-3)
                    ),
                    f"tracking at {east_arcsec_s}",
                )
    assert fake.unknown == []


@pytest.mark.long
@pytest.mark.parametrize(("site", "east_arcsec_s"), [(NORTH, 1.25), (SOUTH, -2.5)])
async def test_the_real_eqmod_driver_runs_both_motors(
    tmp_path: Path, site: Site, east_arcsec_s: float
) -> None:
    fake = quick("az-eq6", site)
    mechanics = fake.mechanics
    async with running(DRIVER, DEVICE, tmp_path, package=PACKAGE) as indi:
        with FakeOnPty(fake) as bench:
            await connect(indi, "pty", bench.address)
            await tell_site_and_time(indi, site)
            await indi.give("Switch", "TELESCOPE_PARK", UNPARK="On")
            await indi.give("Switch", "TELESCOPE_TRACK_STATE", TRACK_ON="On")
            # where it stands, at home: behind a goto this driver may say that it can't change a rate
            tracking = ("TELESCOPE_TRACK_STATE", "TRACK_ON")
            await indi.until(lambda: indi.values.get(tracking) == "On", "seeing that it tracks")
            # once: the next rates it may refuse, as its declination motor would turn round
            await track_at(indi, SIDEREAL_ARCSEC_S - east_arcsec_s, 1.75)

            def goes() -> bool:
                ha, dec = (3600.0 * mechanics.axis_velocity(axis) for axis in ("ha", "dec"))
                # to the west in both hemispheres; which way is north it doesn't say at the pole
                west = pytest.approx(SIDEREAL_ARCSEC_S - east_arcsec_s, abs=5e-3)
                return ha == west and abs(dec) == pytest.approx(1.75, abs=5e-3)

            await indi.until(goes, f"tracking at {east_arcsec_s}")
            assert fake.unknown == []


@pytest.mark.long
async def test_the_real_astro_physics_driver_adds_times_sidereal(tmp_path: Path) -> None:
    """It counts them to the west, as we do; a declination to the north it sends as one to the south."""
    fake = german("ap")
    with FakeOnTcp(fake) as bench:
        async with running("indi_lx200ap_v2", "AstroPhysics V2", tmp_path) as indi:
            await indi.connect(bench)
            await indi.give("Number", "POLLING_PERIOD", PERIOD_MS="250")
            await indi.give("Switch", "TELESCOPE_PARK", UNPARK="On")
            await indi.give("Switch", "TELESCOPE_TRACK_STATE", TRACK_ON="On")
            tracking = ("TELESCOPE_TRACK_STATE", "TRACK_ON")
            await indi.until(lambda: indi.values.get(tracking) == "On", "seeing that it tracks")
            await indi.give("Switch", "TELESCOPE_TRACK_MODE", TRACK_CUSTOM="On")
            await track_at(indi, 13.0)
            await indi.until(lambda: b":RR-0.1357#" in fake.obeyed, "setting a rate")
            assert kept_rates(fake.mechanics) == pytest.approx((SIDEREAL_ARCSEC_S - 13.0, 0.0), abs=2e-3)
            await track_at(indi, 15.5, 1.5)
            await indi.until(lambda: b":RD+0.0997#" in fake.obeyed, "setting rates")
            expected = (SIDEREAL_ARCSEC_S - 15.5, -1.5)
            assert kept_rates(fake.mechanics) == pytest.approx(expected, abs=2e-3)
    assert fake.unknown == []
