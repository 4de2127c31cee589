"""What is killed: a process with the real navigator, driver and journal; it tells its steps to its parent."""

from __future__ import annotations

import asyncio
import os
import signal
from dataclasses import dataclass
from datetime import datetime
from multiprocessing.connection import Connection
from typing import Any, cast

from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.lx200.language import Lx200Language
from drivers.simulated.truth_camera import TruthCamera
from drivers.wire.link import link_to
from mountnav.catalog.stars import Catalog
from mountnav.clock import SystemClock
from mountnav.errors import MountnavError
from mountnav.journal.restart import take_up
from mountnav.journal.sql_journal import open_journal
from mountnav.mount.kill_points import watching_kill_points
from mountnav.navigation.equipment import equip
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.pointing.limits import Limits
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.sky_seen import SeenThrough, SkySeen
from mountnav.sky.coordinates import Air, Icrs, Site

SITE, AIR = Site(48.93, 22.27, 700.0), Air(930.0, 5.0, 0.7)
LONGEST_S = 60.0
TIMING = Timing(
    poll_s=0.1, start_grace_s=1.0, rest_s=0.5, sync_wait_s=1.0, heartbeat_s=0.2, acceleration_deg_s2=80.0
)
QUIET_S = 0.4
_ON_WIRE = {b":MS": "slew", b":CM": "sync"}


@dataclass(frozen=True, slots=True)
class Plan:
    """What a child does.

    Attributes
    ----------
    address : str
        The mount's line.
    database : str
    target : Icrs
    centers : bool
        Whether it centers the target after it has taken the telescope up.
    kill_at : int
        At which step it dies; 0: never.
    kill_named : str
        Or at the first step of this name, ...
    times : int
        ... reached so often.
    """

    address: str
    database: str
    target: Icrs
    centers: bool
    kill_at: int = 0
    kill_named: str = ""
    times: int = 1


class _Truth:
    """The mechanics as the child's camera may ask them: over the pipe."""

    def __init__(self, parent: Connection) -> None:
        self._parent = parent

    def truth(self, utc: datetime) -> Icrs:
        self._parent.send(("truth", utc))
        return cast("Icrs", self._parent.recv())

    def tube_angle_deg(self, utc: datetime) -> float:
        self._parent.send(("angle", utc))
        return cast("float", self._parent.recv())


def child(parent: Connection, plan: Plan) -> None:
    """Take the telescope up, center the target if that is planned, and die on the way if that is."""
    reached: list[str] = []

    def at_step(name: str) -> None:
        reached.append(name)
        parent.send(("step", name))
        named = name == plan.kill_named and reached.count(name) == plan.times
        if named or len(reached) == plan.kill_at:
            os.kill(os.getpid(), signal.SIGKILL)

    with watching_kill_points(at_step):
        asyncio.run(_serve(parent, plan, at_step))


async def _serve(parent: Connection, plan: Plan, at_step: Any) -> None:
    clock = SystemClock()
    journal = await asyncio.to_thread(open_journal, plan.database)
    mount = GenericMount(Lx200Language(link_to(plan.address)), timing=TIMING)

    def on_wire(entry: Any) -> None:
        for order, name in _ON_WIRE.items():
            if entry.way == "driver->mount" and order in entry.data:
                at_step(f"{name} on the wire")

    mount.wire_log.listen(on_wire)
    service = Navigator(
        equip(
            name="rig",
            mount=mount,
            camera=TruthCamera(cast("Any", _Truth(parent)), clock, read_out_s=0.0),
            catalog=cast("Catalog", None),
            site=SITE,
            air=AIR,
            policy=CenteringPolicy(exposure_s=0.1, settle_s=0.0, scale_arcsec_px=2.0, timeout_s=LONGEST_S),
            listen=lambda kind, data: None,
            solve=SkySeen(SkyScript(solve_s=0.02), clock, SeenThrough(usual_exposure_s=0.1)),
            limits=Limits(15.0),
            sync=SyncPolicy(read_back_s=2.0),
            journal=journal,
            clock=clock,
            mounting="fork",
        )
    )
    try:
        await service.open()
        taken = await take_up(journal, journal.reader, "rig", service.mount)
        likely = {one.command.command_id: str(one.likely) for one in taken.commands}
        parent.send(("taken up", taken.notice, likely))
        if plan.centers:
            try:
                report = await service.center(plan.target)
                parent.send(("said", f"centered in {len(report.tries)}"))
            except MountnavError as error:
                parent.send(("said", f"{type(error).__name__}: {error.what}"))
        else:
            await asyncio.sleep(QUIET_S)
    finally:
        await service.close()
        await asyncio.to_thread(journal.close)
