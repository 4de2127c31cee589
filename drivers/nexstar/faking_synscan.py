"""Fake SynScan hand controls by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import datetime

from drivers.fakes.faults import Fault
from drivers.nexstar.codec.handsets import Handset, Version
from drivers.nexstar.fake import FakeNexstar
from drivers.nexstar.family import MACHINE, MOVES, STOPS
from mountnav.errors import BadRequest
from mountnav.simulation.mechanics import Mechanics

__all__ = ["DIALECTS", "MACHINE", "MOVES", "STOPS", "SYNC_REACH_DEG", "fake_from"]

_HANDSETS = {
    "synscan": Handset(Version(4, 39, 5, synscan=True), None, 1),
    # before syncs and sides of the pier
    "synscan-old": Handset(Version(3, 36, 0, synscan=True), None, 0),
}
DIALECTS: tuple[str, ...] = tuple(_HANDSETS)
SYNC_REACH_DEG = 6.5
"""Syncs further from its model are not taken: 6 to 7 degrees [Sky-Watcher's engineer, INDI #614]."""


def fake_from(
    dialect: str | None,
    mechanics: Mechanics,
    faults: Iterable[Fault],
    clock: Callable[[], datetime],
    monotonic: Callable[[], float],
) -> FakeNexstar:
    """Make the fake of a dialect; the first of `DIALECTS` if None.

    Raises
    ------
    BadRequest
        If there is no such dialect.
    """
    handset = _HANDSETS.get(dialect or DIALECTS[0])
    if handset is None:
        raise BadRequest(f"there is no SynScan dialect {dialect}", advice=f"known: {', '.join(DIALECTS)}")
    return FakeNexstar(
        mechanics,
        handset=handset,
        sync_reach_deg=SYNC_REACH_DEG,
        faults=faults,
        clock=clock,
        monotonic=monotonic,
    )
