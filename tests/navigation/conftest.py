"""One whole telescope without hardware: a fake LX200 on a real pty, its driver, a camera on the true sky."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass

import pytest

from drivers.fakes.bench import FakeOnPty
from drivers.lx200.fake.base import FakeLx200
from drivers.registry import open_mount
from drivers.simulated.camera import SimulatedCamera
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Catalog
from mountnav.clock import utc_now
from mountnav.devices import Mount
from mountnav.navigation.equipment import Solve, equip
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.optics import SimulatedOptics
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.solving.solve import SolveSettings

SITE = Site(48.93, 22.27, 700.0)
AIR = Air(pressure_hpa=930.0, temperature_c=5.0, relative_humidity=0.7)
ERRORS = PointingErrors(
    ih_arcsec=700.0,
    id_arcsec=-500.0,
    ch_arcsec=300.0,
    np_arcsec=60.0,
    me_arcsec=400.0,
    ma_arcsec=-300.0,
    tf_arcsec=30.0,
    backlash_arcsec=15.0,
    periodic_amplitude_arcsec=5.0,
    periodic_period_s=480.0,
)
POLICY = CenteringPolicy(
    exposure_s=0.2, settle_s=0.0, scale_arcsec_px=4.0, timeout_s=120.0, max_tries=6, min_altitude_deg=15.0
)


@dataclass
class Rig:
    """A navigator, and the truth that it may not see."""

    navigator: Navigator
    mechanics: Mechanics
    fake: FakeLx200
    events: list[tuple[str, dict[str, object]]]

    def kinds(self) -> list[str]:
        """Kinds of the events so far."""
        return [kind for kind, _ in self.events]


MakeRig = Callable[..., Awaitable[Rig]]
MakeSolve = Callable[[Mechanics, Catalog], Solve]


def up_now(ha_deg: float = -20.0, dec_deg: float = 30.0) -> Icrs:
    """A place that stands at this hour angle now."""
    return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc_now()), SITE, AIR)


@pytest.fixture
async def make_rig() -> AsyncIterator[MakeRig]:
    """Makes rigs; all are closed afterwards."""
    async with AsyncExitStack() as stack:

        async def make(
            *,
            errors: PointingErrors = ERRORS,
            policy: CenteringPolicy = POLICY,
            wrap: Callable[[Mount], Mount] = lambda mount: mount,
            slew_rate_deg_s: float = 15.0,
            solve: MakeSolve | None = None,
            solving: SolveSettings | None = None,
            site: Site = SITE,
        ) -> Rig:
            mechanics = Mechanics(
                SITE, AIR, errors, slew_rate_deg_s=slew_rate_deg_s, acceleration_deg_s2=40.0
            )
            fake = FakeLx200(mechanics)
            bench = stack.enter_context(FakeOnPty(fake))
            optics = SimulatedOptics(
                width_px=1000, height_px=800, scale_arcsec_px=4.0, rotation_deg=33.0, parity=-1
            )
            catalog = embedded_catalog()
            events: list[tuple[str, dict[str, object]]] = []
            navigator = Navigator(
                equip(
                    name="rig",
                    mount=wrap(open_mount(f"lx200+serial://{bench.address}")),
                    camera=SimulatedCamera(mechanics.truth, optics, catalog, seed=7),
                    catalog=catalog,
                    site=site,
                    air=AIR,
                    policy=policy,
                    listen=lambda kind, data: events.append((kind, data)),
                    solving=solving,
                    solve=None if solve is None else solve(mechanics, catalog),
                    mounting="fork",
                )
            )
            await navigator.open()
            stack.push_async_callback(navigator.close)
            return Rig(navigator, mechanics, fake, events)

        yield make
