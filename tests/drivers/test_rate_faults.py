"""Faults of rates on the fakes of every family that takes rates: what is kept, and what is read back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivers.fakes.bench import FakeOnPty
from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.registry import make_fake
from mountnav.devices import OffsetRates, PierSide, Skill
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Site
from tests.drivers.mounts import ioptron_mount, lx200_mount, nexstar_mount, skywatcher_mount
from tests.drivers.rates_kept import beside_the_meridian, kept_rates

pytestmark = [pytest.mark.long, pytest.mark.first]  # they wait for mounts: not at the end

HERE = Site(49.6, 36.9)
TIMING = Timing(
    poll_s=0.05,
    start_grace_s=0.5,
    rest_s=0.3,
    heartbeat_s=0.0,
    stop_timeout_s=30.0,
    fastest_deg_s=400.0,
    acceleration_deg_s2=900.0,
)
FAMILIES = {
    "onstep": ("lx200", "onstep", lambda url, **more: lx200_mount(url, site=HERE, **more), (2.0, -0.5)),
    "ap": ("lx200", "ap", lambda url, **more: lx200_mount(url, site=HERE, dialect="ap", **more), (2.0, 0.0)),
    "ioptron": ("ioptron", "v3", lambda url, **more: ioptron_mount(url, site=HERE, **more), (2.0, 0.0)),
    # what its quarters can say exactly
    "nexstar": ("nexstar", "nexstar", lambda url, **more: nexstar_mount(url, **more), (2.041067, -0.5)),
    "skywatcher": (
        "skywatcher",
        "az-eq6",
        lambda url, **more: skywatcher_mount(url, HERE, **more),
        (2.0, -0.5),
    ),
}
FAULTS = [
    (Fault("rate-reversed"), lambda ra, dec: (-ra, -dec)),
    (Fault("rate-reversed", rates="ra"), lambda ra, dec: (-ra, dec)),
    (Fault("rate-factor", factor=15.041, rates="ra"), lambda ra, dec: (15.041 * ra, dec)),
    (Fault("rate-factor", factor=1.0027379), lambda ra, dec: (1.0027379 * ra, 1.0027379 * dec)),
    (Fault("rate-factor", factor=0.0665), lambda ra, dec: (0.0665 * ra, 0.0665 * dec)),
    (Fault("rate-swapped"), lambda ra, dec: (dec, ra)),
    (Fault("rate-ignored"), lambda ra, dec: (0.0, 0.0)),
]


IN_EVERY_RUN = {("onstep", 0), ("skywatcher", 5)}
"""One of words, one of an axis controller's numbers."""


@pytest.mark.parametrize(
    ("name", "fault", "becomes"),
    [
        pytest.param(
            name,
            *one,
            marks=() if (name, number) in IN_EVERY_RUN else pytest.mark.long,
            id=f"{name}-{one[0].kind}-{number}",
        )
        for name in FAMILIES
        for number, one in enumerate(FAULTS)
    ],
)
async def test_each_fault_shows_in_the_sky_and_not_on_the_wire(name: str, fault: Fault, becomes: Any) -> None:
    protocol, dialect, make, rates = FAMILIES[name]
    machine = Machine(
        mounting="german",
        slew_rate_deg_s=180.0,
        acceleration_deg_s2=900.0,
        meridian_limits_deg=(20.0, 20.0),
        starts_at="home" if name == "skywatcher" else "zenith",
        tracks_at_start=name != "skywatcher",
    )
    mechanics = Mechanics(HERE, Air(), PointingErrors(), machine=machine)
    fake = make_fake(protocol, dialect, mechanics, faults=[replace(fault)])
    with FakeOnPty(fake) as bench:
        mount: GenericMount = make(bench.address, timing=TIMING)
        await mount.open()
        try:
            mount.trust()
            await mount.slew(beside_the_meridian(mechanics, PierSide.WEST))
            assert Skill.OFFSET_RATES in mount.skills
            # a star is followed all the same
            assert kept_rates(mechanics, for_s=20.0) == pytest.approx((0.0, 0.0), abs=1e-2)
            await mount.set_offset_rates(OffsetRates(*rates))
            assert kept_rates(mechanics, for_s=20.0) == pytest.approx(becomes(*rates), abs=1e-2)
            told = await mount.offset_rates()
            if told is not None:
                assert (told.ra_arcsec_s, told.dec_arcsec_s) == pytest.approx(rates, abs=5e-3)
        finally:
            await mount.close()
