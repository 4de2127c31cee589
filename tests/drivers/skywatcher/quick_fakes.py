"""Fake Sky-Watcher mounts, quicker than real ones, for the tests of their driver and of the fake itself."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import datetime
from typing import Any

from drivers.fakes.bench import FakeOnPty, FakeOnTcp, FakeOnUdp
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.skywatcher.axes import SkywatcherSettings, place_of
from drivers.skywatcher.fake import BOARDS, FakeSkywatcher
from drivers.wire.exchange import Patience
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.mounts import skywatcher_mount

NORTH, SOUTH = Site(49.6, 36.9, 150.0), Site(-33.3, 149.1, 600.0)
RATE_DEG_S, ACCELERATION_DEG_S2 = 180.0, 900.0
TIMING = Timing(
    poll_s=0.05,
    heartbeat_s=0.0,
    rest_s=0.5,
    stop_timeout_s=30.0,
    fastest_deg_s=400.0,
    acceleration_deg_s2=ACCELERATION_DEG_S2,
)
PATIENCE = Patience(deadline_s=3.0, try_s=0.3, quiet_s=0.03)
SETTINGS = SkywatcherSettings(goto_deg_s=RATE_DEG_S, goto_deg_s2=ACCELERATION_DEG_S2, settle_s=0.3)
WIRES = {"pty": FakeOnPty, "tcp": FakeOnTcp, "udp": FakeOnUdp}


def german(site: Site = NORTH, clock: Callable[[], datetime] = utc_now, **machine: Any) -> Mechanics:
    """Mechanics of a mount that stands at home and doesn't track."""
    build: dict[str, Any] = {
        "mounting": "german",
        "starts_at": "home",
        "tracks_at_start": False,
        "slew_rate_deg_s": RATE_DEG_S,
    }
    return Mechanics(site, Air(), PointingErrors(), machine=Machine(**build | machine), clock=clock)


def quick(dialect: str = "eq6", site: Site = NORTH, **more: Any) -> FakeSkywatcher:
    """Make a fake whose gotos are quick."""
    board = replace(
        BOARDS[dialect],
        goto_deg_s=RATE_DEG_S,
        acceleration_deg_s2=ACCELERATION_DEG_S2,
    )
    return FakeSkywatcher(german(site), board=board, **more)


@asynccontextmanager
async def mounted(
    fake: FakeSkywatcher,
    wire: str = "pty",
    *,
    trusted: bool = True,
    timing: Timing = TIMING,
    settings: SkywatcherSettings = SETTINGS,
) -> AsyncIterator[GenericMount]:
    """Put a fake on a wire and open the mount on it; by the word of an operator its position counts."""
    with WIRES[wire](fake) as bench:
        mount = skywatcher_mount(
            bench.address, fake.mechanics.site, patience=PATIENCE, timing=timing, settings=settings
        )
        await mount.open()
        if trusted:
            mount.trust()
        try:
            yield mount
        finally:
            await mount.close()


def at(site: Site, ha_deg: float, dec_deg: float) -> Apparent:
    """Apparent place that is now at an hour angle and declination."""
    return place_of(ha_deg, dec_deg, utc_now(), site)


def apart_arcsec(a: Apparent, b: Apparent) -> float:
    """Distance of two places whose numbers are taken as they are."""
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))


def commands(fake: FakeSkywatcher, letters: str) -> list[bytes]:
    """Commands that a fake heard, of some letters."""
    return [command for command in fake.heard if command[1:2].decode() in letters]
