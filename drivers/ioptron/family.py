"""The iOptron family: how such a mount is opened, probed and faked."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import datetime
from typing import TYPE_CHECKING

from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import read_options
from drivers.ioptron.codec import v3
from drivers.ioptron.codec.greeting import COMMAND_SETS, GREETING, model
from drivers.ioptron.fake import FakeIoptron
from drivers.ioptron.mount import BAUD, ioptron_language
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import ByteLine
from mountnav.errors import BadRequest, DeviceGarbled, DeviceSilent
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.coordinates import Site

if TYPE_CHECKING:
    from drivers.registry import MountUrl


def mount_from(url: MountUrl, name: str | None, site: Site | None = None) -> GenericMount:
    """Make the mount; nothing is opened yet.

    Raises
    ------
    BadSettings
        If an option is unknown or its value makes no sense.
    """
    options = read_options(url.options, "ioptron", baud=BAUD, timeout_s=5.0, dialects=COMMAND_SETS)
    language = ioptron_language(
        url.line,
        baud=options.baud,
        control=options.control,
        epoch=options.epoch,
        dialect=options.dialect,
        patience=options.patience,
    )
    return options.mount(language, name=name, site=site)


BAUDS = (115_200, 9600)
"""v3 mounts; hand controllers 8407, 8408 and v2 mounts."""

_PATIENCE = Patience(deadline_s=0.8, try_s=0.8, quiet_s=0.1)


async def probe(line: ByteLine) -> str | None:
    """Ask an opened line for its model number and command set; what answers in words, or None.

    Raises
    ------
    DeviceMissing
        If the line is lost.
    """
    exchange = Exchange(line, _PATIENCE)
    try:
        number = await exchange.ask(v3.MODEL)
        words = await exchange.ask(GREETING)
    except (DeviceSilent, DeviceGarbled):
        return None
    name = model(number, words.name).name or "mount"
    return f"iOptron {name} ({number}), command set {words.name}"


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
