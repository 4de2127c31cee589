"""Fake iOptron mounts for tests: German ones that track west of the meridian, and quick drivers for them."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from dataclasses import replace

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.ioptron.fake import MACHINE, FakeIoptron
from drivers.wire.exchange import Patience
from mountnav.clock import utc_now
from mountnav.devices import Epoch
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.chain import hour_angle_to_apparent
from mountnav.sky.coordinates import Air, Apparent, GeometricHourAngle, Icrs, Site
from tests.drivers.mounts import ioptron_mount

HERE = Site(49.6, 36.9)
TRACKING = replace(MACHINE, starts_at="zenith", tracks_at_start=True)
QUICK = Timing(
    poll_s=0.05,
    start_grace_s=0.6,
    rest_s=0.2,
    stall_s=3.0,
    sync_wait_s=1.0,
    heartbeat_s=0.1,
    silence_s=0.6,
    lost_after_s=2.5,
    backoff_s=0.05,
    fastest_deg_s=600.0,
)
PATIENCE = Patience(deadline_s=1.2, try_s=0.4, quiet_s=0.02)


def at_hour_angle(ha_deg: float, dec_deg: float) -> Apparent:
    """Where in the sky this is now."""
    return hour_angle_to_apparent(GeometricHourAngle(ha_deg, dec_deg, utc_now()), HERE)


def mechanics_of(
    machine: Machine = TRACKING,
    *,
    ha_deg: float | None = 25.0,
    slew_rate_deg_s: float = 20.0,
    acceleration_deg_s2: float = 1000.0,
) -> Mechanics:
    """Mechanics without errors that believe to look at declination 45° at an hour angle; None: as built."""
    return Mechanics(
        HERE,
        Air(),
        PointingErrors(),
        machine=machine,
        slew_rate_deg_s=slew_rate_deg_s,
        acceleration_deg_s2=acceleration_deg_s2,
        start=None if ha_deg is None else at_hour_angle(ha_deg, 45.0),
    )


def fake_of(
    mechanics: Mechanics | None = None,
    *,
    dialect: str = "v3",
    model: str | None = None,
    faults: Iterable[Fault] = (),
    slew_rate_deg_s: float = 20.0,
) -> FakeIoptron:
    """Make a fake over such mechanics."""
    mechanics = mechanics or mechanics_of(slew_rate_deg_s=slew_rate_deg_s)
    return FakeIoptron(mechanics, dialect=dialect, model=model, faults=faults)


@asynccontextmanager
async def opened(
    fake: FakeIoptron,
    *,
    tcp: bool = False,
    timing: Timing = QUICK,
    epoch: Epoch = "apparent",
    dialect: str | None = None,
    site: Site | None = HERE,
) -> AsyncIterator[GenericMount]:
    """A mount connected to a fake on a real wire."""
    with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
        mount = ioptron_mount(
            bench.address, timing=timing, patience=PATIENCE, epoch=epoch, dialect=dialect, site=site
        )
        await mount.open()
        try:
            yield mount
        finally:
            await mount.close()


def beside(place: Apparent | Icrs, ra_deg: float, dec_deg: float) -> Apparent:
    """A place some degrees away."""
    return Apparent((place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg, utc_now())
