"""Faults that happen behind the wire: syncs that don't take, an axis that sticks or runs away."""

from __future__ import annotations

from collections.abc import Callable

from drivers.fakes.faults import Fault
from mountnav.simulation.mechanics import Mechanics, SyncBehavior

_SYNCS: dict[str, SyncBehavior] = {
    "sync-ignored": "ignore",
    "sync-refused": "refuse",
    "sync-late": "late",
    "sync-half": "dec-only",
    "sync-elsewhere": "elsewhere",
}


def strike_mechanics(mechanics: Mechanics, fault: Fault) -> Callable[[], None]:
    """Set a fault of the mount itself going.

    Returns
    -------
    callable
        Ends it.
    """
    if fault.kind == "stick":
        mechanics.stick(fault.axis)
        return lambda: mechanics.unstick(fault.axis)
    if fault.kind == "run-away":
        mechanics.run_away(fault.axis, deaf_stops=fault.stops)
        return lambda: mechanics.run_away(fault.axis, past_target=False)
    mechanics.sync_behavior = _SYNCS[fault.kind]
    if fault.kind == "sync-late":
        mechanics.sync_late_s = fault.delay_s

    def usual() -> None:
        mechanics.sync_behavior = "normal"

    return usual
