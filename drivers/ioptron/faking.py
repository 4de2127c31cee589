"""Fake iOptron mounts by the name of their command set, for `mountnav fake-mount`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import datetime

from drivers.fakes.faults import Fault
from drivers.ioptron.fake import FakeIoptron
from mountnav.errors import BadRequest
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics

DIALECTS = ("v3", "v2")
MOVES = (b":MS", b":CM", b":MP1", b":MH", b":MSH")
"""What moves or syncs: sent once for each order."""
STOPS = (b":Q#",)

MACHINE = Machine(
    mounting="german",
    slew_rate_deg_s=4.0,
    acceleration_deg_s2=2.0,
    meridian_limits_deg=(10.0, 10.0),
    lowest_altitude_deg=0.0,
    home_sensor=True,
    starts_at="home",
    tracks_at_start=False,
)
"""A GEM45: after power-up it takes the place where it stands for its home, and doesn't track."""


def fake_from(
    dialect: str | None,
    mechanics: Mechanics,
    faults: Iterable[Fault],
    clock: Callable[[], datetime],
    monotonic: Callable[[], float],
) -> FakeIoptron:
    """Make a fake of a command set, v3 if none is named.

    Raises
    ------
    BadRequest
        If there is no such set.
    """
    name = dialect or DIALECTS[0]
    if name not in DIALECTS:
        raise BadRequest(f"no iOptron mount speaks {name}", advice=f"known: {', '.join(DIALECTS)}")
    return FakeIoptron(mechanics, dialect=name, faults=faults, clock=clock, monotonic=monotonic)
