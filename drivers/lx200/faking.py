"""Fakes of LX200 mounts by their dialect's name, for the command line and the tests of all families."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterable
from datetime import datetime

from drivers.fakes.faults import Fault
from drivers.lx200.fake import FakeLx200
from drivers.lx200.fake_dialect import FakeDialect
from drivers.lx200.fake_rainbow import FakeRainbow
from mountnav.errors import BadRequest
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.coordinates import utc_now

_WHERE = {
    "generic": "drivers.lx200.fake_meade:GENERIC_FAKE",
    "autostar": "drivers.lx200.fake_meade:AUTOSTAR_FAKE",
    "classic": "drivers.lx200.fake_meade:CLASSIC_FAKE",
    "lx200gps": "drivers.lx200.fake_meade:LX200GPS_FAKE",
    "lx200-16": "drivers.lx200.fake_meade:LX200_16_FAKE",
    "basic": "drivers.lx200.fake_meade:BASIC_FAKE",
    "onstep": "drivers.lx200.fake_onstep:ONSTEP_FAKE",
    "10micron": "drivers.lx200.fake_tenmicron:TENMICRON_FAKE",
    "am5": "drivers.lx200.fake_am5:AM5_FAKE",
    "gemini": "drivers.lx200.fake_gemini:GEMINI_FAKE",
    "ap": "drivers.lx200.fake_astro_physics:ASTRO_PHYSICS_FAKE",
    "ap-gtocp2": "drivers.lx200.fake_astro_physics:GTOCP2_FAKE",
    "fs2": "drivers.lx200.fake_others:FS2_FAKE",
    "ss2000pc": "drivers.lx200.fake_others:SKY_SENSOR_FAKE",
    "hc8406": "drivers.lx200.fake_ioptron_old:HC8406_FAKE",
    "zeq25": "drivers.lx200.fake_ioptron_old:ZEQ25_FAKE",
    "gotonova": "drivers.lx200.fake_ioptron_old:GOTONOVA_FAKE",
    "openastrotech": "drivers.lx200.fake_others:OPEN_ASTRO_TECH_FAKE",
    "teenastro": "drivers.lx200.fake_teenastro:TEENASTRO_FAKE",
    "pulsar2": "drivers.lx200.fake_pulsar:PULSAR_FAKE",
    "rainbow": "drivers.lx200.fake_rainbow:RAINBOW_FAKE",
}

DIALECTS: tuple[str, ...] = tuple(_WHERE)
"""What ``--dialect`` may be; the first is the default."""

MOVES: tuple[bytes, ...] = (b":MS", b":MN", b":MM", b":CM", b":hP", b":hC", b":hF", b":hZ", b":KA")
"""Beginnings of commands that move or sync: sent once per order."""

STOPS: tuple[bytes, ...] = (b":Q",)
"""Beginnings of commands that stop."""


def fake_dialect(name: str) -> FakeDialect:
    """Return a dialect's other side.

    Raises
    ------
    BadRequest
        If there is none of that name.
    """
    if name not in DIALECTS:
        raise BadRequest(f"LX200 has no dialect {name}", advice=f"known: {', '.join(DIALECTS)}")
    module, _, value = _WHERE[name].partition(":")
    dialect: FakeDialect = getattr(importlib.import_module(module), value)
    return dialect


def fake_from(
    dialect: str | None,
    mechanics: Mechanics,
    faults: Iterable[Fault] = (),
    clock: Callable[[], datetime] = utc_now,
    monotonic: Callable[[], float] = time.monotonic,
) -> FakeLx200:
    """Make a fake mount of a dialect, the first one if None.

    Raises
    ------
    BadRequest
        If there is no such dialect.
    """
    chosen = fake_dialect(dialect or DIALECTS[0])
    made: type[FakeLx200] = FakeRainbow if chosen.name == "rainbow" else FakeLx200
    return made(mechanics, dialect=chosen, faults=faults, clock=clock, monotonic=monotonic)
