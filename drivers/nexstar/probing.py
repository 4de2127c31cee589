"""Whether a hand control answers on a line: its echo and its version, nothing that moves, syncs or sets."""

from __future__ import annotations

from drivers.nexstar import codec
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import ByteLine
from mountnav.errors import DeviceGarbled, DeviceSilent

BAUDS = (9600,)

_PATIENCE = Patience(deadline_s=2.5, try_s=1.2, quiet_s=0.1)
_LETTER = b"x"


async def probe(line: ByteLine) -> str | None:
    """Ask an opened line for an echo and a version; what answers in words, or None.

    Raises
    ------
    DeviceMissing
        If the line is lost.
    """
    exchange = Exchange(line, _PATIENCE)
    try:
        await exchange.ask(codec.echo(_LETTER))
        version = await exchange.ask(codec.VERSION)
    except (DeviceSilent, DeviceGarbled):
        return None
    maker = "SynScan" if version.synscan else "NexStar"
    return f"{maker} hand control {version}"
