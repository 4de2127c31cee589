"""Hours on the wire in minutes, the same each time: published pieces, under the names that tests know."""

from __future__ import annotations

import sys

import pytest

from drivers.fakes.bench.memory import MemoryLine
from mountnav.clock import utc_now as real_utc_now
from mountnav.simulation.virtual_time import VirtualClock as HandClock
from mountnav.simulation.virtual_time import VirtualLoop

__all__ = ["HandClock", "MemoryLine", "VirtualLoop", "in_virtual_time"]


def in_virtual_time(monkeypatch: pytest.MonkeyPatch, clock: HandClock) -> None:
    """Let all that is imported take the clock's UTC for the present."""
    for name, module in list(sys.modules.items()):
        if not name.startswith(("drivers", "mountnav")):
            continue
        present = getattr(module, "utc_now", None)
        # a module that was first imported during an earlier life has that life's clock
        if present is real_utc_now or isinstance(present, HandClock):
            monkeypatch.setattr(module, "utc_now", clock)
