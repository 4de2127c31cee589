"""Which dialects the LX200 fakes speak, by name."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterable
from datetime import datetime

from drivers.fakes.faults import Fault
from drivers.family import Fakes
from drivers.lx200.fake.base import FakeLx200
from drivers.lx200.fake.dialect import FakeDialect
from drivers.lx200.fake.rainbow import FakeRainbow
from mountnav.clock import utc_now
from mountnav.simulation.mechanics import Mechanics

_WHERE = {
    "generic": "drivers.lx200.fake.meade:GENERIC_FAKE",
    "autostar": "drivers.lx200.fake.meade:AUTOSTAR_FAKE",
    "classic": "drivers.lx200.fake.meade:CLASSIC_FAKE",
    "lx200gps": "drivers.lx200.fake.meade:LX200GPS_FAKE",
    "lx200-16": "drivers.lx200.fake.meade:LX200_16_FAKE",
    "basic": "drivers.lx200.fake.meade:BASIC_FAKE",
    "onstep": "drivers.lx200.fake.onstep:ONSTEP_FAKE",
    "10micron": "drivers.lx200.fake.tenmicron:TENMICRON_FAKE",
    "am5": "drivers.lx200.fake.am5:AM5_FAKE",
    "gemini": "drivers.lx200.fake.gemini:GEMINI_FAKE",
    "ap": "drivers.lx200.fake.astro_physics:ASTRO_PHYSICS_FAKE",
    "ap-gtocp2": "drivers.lx200.fake.astro_physics:GTOCP2_FAKE",
    "fs2": "drivers.lx200.fake.others:FS2_FAKE",
    "ss2000pc": "drivers.lx200.fake.others:SKY_SENSOR_FAKE",
    "hc8406": "drivers.lx200.fake.ioptron_old:HC8406_FAKE",
    "zeq25": "drivers.lx200.fake.ioptron_old:ZEQ25_FAKE",
    "gotonova": "drivers.lx200.fake.ioptron_old:GOTONOVA_FAKE",
    "openastrotech": "drivers.lx200.fake.others:OPEN_ASTRO_TECH_FAKE",
    "teenastro": "drivers.lx200.fake.teenastro:TEENASTRO_FAKE",
    "pulsar2": "drivers.lx200.fake.pulsar:PULSAR_FAKE",
    "rainbow": "drivers.lx200.fake.rainbow:RAINBOW_FAKE",
}


def fake_dialect(name: str) -> FakeDialect:
    """Return the other side of a dialect of `FAKES`."""
    module, _, value = _WHERE[name].partition(":")
    dialect: FakeDialect = getattr(importlib.import_module(module), value)
    return dialect


def make_fake(
    dialect: str,
    mechanics: Mechanics,
    *,
    faults: Iterable[Fault] = (),
    clock: Callable[[], datetime] = utc_now,
    monotonic: Callable[[], float] = time.monotonic,
) -> FakeLx200:
    """Make a fake of a dialect of `FAKES`."""
    made: type[FakeLx200] = FakeRainbow if dialect == "rainbow" else FakeLx200
    return made(mechanics, dialect=fake_dialect(dialect), faults=faults, clock=clock, monotonic=monotonic)


FAKES = Fakes(
    dialects=tuple(_WHERE),
    make=make_fake,
    moves=(b":MS", b":MN", b":MM", b":CM", b":hP", b":hC", b":hF", b":hZ", b":KA"),
    stops=(b":Q",),
)
