"""Fake Celestron hand controls by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import datetime

from drivers.fakes.faults import Fault
from drivers.nexstar.fake import AVX, FakeNexstar
from drivers.nexstar.handsets import STARSENSE, Handset, Version
from mountnav.errors import BadRequest
from mountnav.simulation.mechanics import Machine, Mechanics

_HANDSETS = {
    "nexstar": AVX,
    # a CGEM before version 5: whole-hour zones, sync and pier side
    "nexstar-4": Handset(Version(4, 21), None, 14, Version(6, 17)),
    # the first hand controls: four digits, no sync, no clock, no pulses
    "nexstar-old": Handset(Version(1, 2)),
    "starsense": Handset(Version(1, 20), STARSENSE, 23, Version(7, 13)),
}
DIALECTS: tuple[str, ...] = tuple(_HANDSETS)
MOVES: tuple[bytes, ...] = (b"r", b"R", b"b", b"B", b"s", b"S", b"P\x03\x10\x26", b"P\x03\x11\x26")
"""Beginnings of commands that are sent once for each order: goto, sync, guide pulse."""
STOPS: tuple[bytes, ...] = (b"M",)
MACHINE = Machine(mounting="german")


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
        raise BadRequest(f"there is no NexStar dialect {dialect}", advice=f"known: {', '.join(DIALECTS)}")
    return FakeNexstar(mechanics, handset=handset, faults=faults, clock=clock, monotonic=monotonic)
