"""Fake Sky-Watcher controllers by the name of their mount."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import datetime

from drivers.fakes.faults import Fault
from drivers.skywatcher.fake import FakeSkywatcher
from drivers.skywatcher.fake_board import BOARDS
from mountnav.errors import BadRequest
from mountnav.simulation.mechanics import Machine, Mechanics

MACHINE = Machine(mounting="german", starts_at="home", tracks_at_start=False)
"""How the mechanics behind such a fake are built at the least."""
DIALECTS: tuple[str, ...] = tuple(BOARDS)
MOVES: tuple[bytes, ...] = (b":J",)
"""Beginnings of commands that start a motion; syncs never reach the wire."""
STOPS: tuple[bytes, ...] = (b":K", b":L")
"""Beginnings of commands that stop one."""


def fake_from(
    dialect: str | None,
    mechanics: Mechanics,
    faults: Iterable[Fault],
    clock: Callable[[], datetime],
    monotonic: Callable[[], float],
) -> FakeSkywatcher:
    """Make a fake; `mechanics` should be built like `MACHINE`.

    Raises
    ------
    BadRequest
        If there is no such dialect.
    """
    board = BOARDS.get(dialect or DIALECTS[0])
    if board is None:
        raise BadRequest(f"no Sky-Watcher mount {dialect!r}", advice=f"one of {', '.join(DIALECTS)}")
    return FakeSkywatcher(mechanics, board=board, faults=faults, clock=clock, monotonic=monotonic)
