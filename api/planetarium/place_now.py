"""Where a mount says it points, of date: what these programs show, from what was last read."""

from __future__ import annotations

from api.orders.watching import Snapshot
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import Apparent


def apparent_place(snapshot: Snapshot) -> Apparent | None:
    """Where the mount says it points, of date; None where it was not read."""
    state = snapshot.state
    if state.reading is None or not state.connected:
        return None
    if isinstance(state.reading.place, Apparent):
        return state.reading.place
    return None if state.icrs is None else icrs_to_apparent(state.icrs, state.reading.utc)


__all__ = ["apparent_place"]
