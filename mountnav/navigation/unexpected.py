"""Looks that nobody expected: one is a false solution, three that agree are a clutch that slipped."""

from __future__ import annotations

import math

from mountnav.navigation.reports import Look
from mountnav.sky.sphere import Offset

_IN_A_ROW = 3
_SHARE = 0.25
"""A slip of one axis shows differently at different declinations: so much of it may the looks differ."""


class Unexpected:
    """Remembers by how much the last looks were not what was expected."""

    def __init__(self) -> None:
        self._surprises: list[tuple[str, float, float]] = []

    def forget(self) -> None:
        """Begin anew: a look was as expected, or the zero points are others."""
        self._surprises = []

    def agree(self, found: Look, expected: Offset, floor_arcsec: float) -> bool:
        """Add a look; whether it and those just before it agree on where the tube is instead."""
        east = found.offset.east_arcsec - expected.east_arcsec
        north = found.offset.north_arcsec - expected.north_arcsec
        others = [one for one in self._surprises if one[0] != found.look_id]
        self._surprises = [*others, (found.look_id, east, north)][-_IN_A_ROW:]
        if len(self._surprises) < _IN_A_ROW:
            return False
        allowed = max(floor_arcsec, _SHARE * math.hypot(east, north))
        return all(math.hypot(one[1] - east, one[2] - north) <= allowed for one in self._surprises)


__all__ = ["Unexpected"]
