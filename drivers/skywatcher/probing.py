"""Whether a Sky-Watcher motor controller answers on a line: its board, nothing that moves or sets."""

from __future__ import annotations

from drivers.skywatcher import codec
from drivers.skywatcher.words import Axis
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import ByteLine
from mountnav.errors import DeviceGarbled, DeviceSilent

BAUDS = (9600, 115_200)
"""EQDIR cables; mounts with a USB socket."""

_PATIENCE = Patience(deadline_s=0.6, try_s=0.6, quiet_s=0.1)


async def probe(line: ByteLine) -> str | None:
    """Ask an opened line for its board and its counts per turn; what answers in words, or None.

    Raises
    ------
    DeviceMissing
        If the line is lost.
    """
    exchange = Exchange(line, _PATIENCE)
    try:
        board = await exchange.ask(codec.board())
        await exchange.ask(codec.counts_per_turn(Axis.HOUR_ANGLE))
    except (DeviceSilent, DeviceGarbled):
        return None
    return f"{board.text} (motor controller)"
