"""The LX200 family: how such a mount is opened, probed and faked."""

from __future__ import annotations

import contextlib
import importlib
import time
from collections.abc import Callable, Iterable
from datetime import datetime
from typing import TYPE_CHECKING

from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import read_options
from drivers.lx200.codec import base
from drivers.lx200.dialects import names
from drivers.lx200.fake.base import FakeLx200
from drivers.lx200.fake.dialect import FakeDialect
from drivers.lx200.fake.rainbow import FakeRainbow
from drivers.lx200.mount import lx200_language
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import ByteLine
from mountnav.clock import utc_now
from mountnav.errors import BadRequest, DeviceGarbled, DeviceSilent
from mountnav.simulation.mechanics import Mechanics

if TYPE_CHECKING:
    from drivers.registry import MountUrl
    from mountnav.sky.coordinates import Site


def mount_from(url: MountUrl, name: str | None, site: Site | None = None) -> GenericMount:
    """Make the mount; nothing is opened yet.

    Raises
    ------
    BadSettings
        If an option is unknown or its value makes no sense.
    """
    options = read_options(url.options, "lx200", baud=9600, timeout_s=5.0, dialects=names())
    language = lx200_language(
        url.line,
        baud=options.baud,
        control=options.control,
        patience=options.patience,
        dialect=options.dialect,
        epoch=options.epoch if "epoch" in url.options else None,
    )
    return options.mount(language, name=name, site=site)


BAUDS = (9600,)
"""Usual; mounts on USB mostly don't care."""

_PATIENCE = Patience(deadline_s=0.8, try_s=0.8, quiet_s=0.1)


async def probe(line: ByteLine) -> str | None:
    """Ask an opened line for a product and a right ascension; what answers in words, or None.

    Raises
    ------
    DeviceMissing
        If the line is lost.
    """
    exchange = Exchange(line, _PATIENCE)
    product = ""
    # a true classic keeps silent: a readable place tells it as well
    with contextlib.suppress(DeviceSilent, DeviceGarbled):
        product = await exchange.ask(base.PRODUCT)
    try:
        await exchange.ask(base.GET_RA)
        await exchange.ask(base.GET_DEC)
    except (DeviceSilent, DeviceGarbled):
        return None
    return f"LX200: {product}" if product else "LX200, without a product name"


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
