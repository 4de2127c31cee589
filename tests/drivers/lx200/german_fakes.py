"""German mounts behind the fakes of OnStep, 10micron and AM5, and our mount on their wire."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.lx200.fake.base import FakeLx200
from drivers.lx200.fake.dialects import make_fake
from drivers.wire.exchange import Patience
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent, Site
from tests.drivers.mounts import lx200_mount

SITE = Site(49.6, 36.9)
PATIENCE = Patience(deadline_s=3.0, try_s=0.5, quiet_s=0.05)
# no heartbeat: these tests count what was said; and these mounts are faster than real ones
QUICK = Timing(
    poll_s=0.05,
    start_grace_s=1.0,
    rest_s=0.2,
    sync_wait_s=1.0,
    late_s=0.8,
    heartbeat_s=0.0,
    fastest_deg_s=120.0,
)
MACHINE = Machine(mounting="german", slew_rate_deg_s=60.0, acceleration_deg_s2=200.0, lowest_altitude_deg=0.0)


def german(dialect: str, *, faults: Sequence[Fault] = (), site: Site = SITE, **machine: Any) -> FakeLx200:
    """A fake over a German mount; fields of its `Machine` may be given."""
    mechanics = Mechanics(site, Air(), PointingErrors(), machine=replace(MACHINE, **machine))
    return make_fake(dialect, mechanics, faults=faults)


def switched_on(dialect: str, **machine: Any) -> FakeLx200:
    """One that has just been switched on: at home, at rest, its clock not set."""
    asleep: dict[str, Any] = {"starts_at": "home", "tracks_at_start": False, "remembers_clock": False}
    return german(dialect, **asleep, clock_offset_s=-8e8, **machine)


@asynccontextmanager
async def opened(
    fake: FakeLx200, *, tcp: bool = False, timing: Timing = QUICK, **options: Any
) -> AsyncIterator[GenericMount]:
    """Our mount, connected to a fake."""
    with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
        mount = lx200_mount(bench.address, timing=timing, patience=PATIENCE, **options)
        await mount.open()
        try:
            yield mount
        finally:
            await mount.close()


def beside(place: Apparent, ra_deg: float, dec_deg: float) -> Apparent:
    """A place so far away."""
    return Apparent((place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg, utc_now())
