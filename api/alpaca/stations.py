"""Where parking and homing ended: for mounts that don't tell by themselves that they are there."""

from __future__ import annotations

from api.orders.watching import Snapshot
from mountnav.sky.sphere import half_turn_deg

_NEAR_DEG = 0.1
_ZENITH_DEG = 89.0


class Stations:
    """Altitude and azimuth of each station, as last reached; a telescope that is there stands still."""

    def __init__(self) -> None:
        self._places: dict[str, tuple[float, float]] = {}

    def remember(self, station: str, snapshot: Snapshot) -> None:
        """It stands at its station now."""
        state = snapshot.state
        if state.altitude_deg is not None and state.azimuth_deg is not None:
            self._places[station] = state.altitude_deg, state.azimuth_deg

    def forget(self, station: str) -> None:
        """It does no more."""
        self._places.pop(station, None)

    def is_at(self, station: str, snapshot: Snapshot) -> bool:
        """Whether it stands there still."""
        at, state = self._places.get(station), snapshot.state
        if at is None or state.altitude_deg is None or state.azimuth_deg is None:
            return False
        if snapshot.slewing or (state.reading is not None and state.reading.tracking):
            return False
        turn_deg = abs(half_turn_deg(state.azimuth_deg - at[1])) if abs(at[0]) < _ZENITH_DEG else 0.0
        return abs(state.altitude_deg - at[0]) < _NEAR_DEG and turn_deg < _NEAR_DEG


__all__ = ["Stations"]
