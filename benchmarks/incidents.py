"""The incidents of a sky script, carried out on a simulated mount at their times."""

from __future__ import annotations

import asyncio

from drivers.simulated.mount import SimulatedMount
from mountnav.clock import Clock
from mountnav.simulation.sky_script import Incident, SkyScript
from mountnav.tasks import waited_for


async def run_incidents(script: SkyScript, mount: SimulatedMount, clock: Clock) -> None:
    """Carry out the script's incidents, until the last is over; its minutes count from the call."""
    began_s = clock.monotonic_s()
    over: list[asyncio.Task[None]] = []
    try:
        for incident in sorted(script.incidents, key=lambda incident: incident.at_min):
            await clock.sleep(max(0.0, began_s + 60.0 * incident.at_min - clock.monotonic_s()))
            over.append(waited_for(_happen(incident, mount, clock)))
        await asyncio.gather(*over)
    finally:
        for task in over:
            task.cancel()


async def _happen(incident: Incident, mount: SimulatedMount, clock: Clock) -> None:
    mechanics = mount.mechanics
    match incident.what:
        case "unplug":
            mount.cut(incident.for_s, "missing")
        case "silence":
            mount.cut(incident.for_s, "silent")
        case "reboot":
            mount.reboot(incident.for_s)
        case "block-ha" | "block-dec":
            axis = "ha" if incident.what == "block-ha" else "dec"
            mechanics.stick(axis)  # type: ignore[arg-type]
            await clock.sleep(incident.for_s)
            mechanics.unstick(axis)  # type: ignore[arg-type]
        case "sync-deaf":
            before = mechanics.sync_behavior
            mechanics.sync_behavior = "ignore"
            await clock.sleep(incident.for_s)
            mechanics.sync_behavior = before
