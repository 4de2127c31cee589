"""Whether an iOptron mount answers on a line: its harmless greeting, nothing that moves, syncs or sets."""

from __future__ import annotations

from drivers.ioptron import codec
from drivers.ioptron.greeting import GREETING
from drivers.ioptron.models import model
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import ByteLine
from mountnav.errors import DeviceGarbled, DeviceSilent

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
        number = await exchange.ask(codec.MODEL)
        words = await exchange.ask(GREETING)
    except (DeviceSilent, DeviceGarbled):
        return None
    name = model(number, words.name).name or "mount"
    return f"iOptron {name} ({number}), command set {words.name}"
