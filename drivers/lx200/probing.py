"""Whether an LX200 mount answers on a line: ACK, product and a place, nothing that moves, syncs or sets."""

from __future__ import annotations

import contextlib

from drivers.lx200 import codec
from drivers.wire.exchange import Exchange, Patience
from drivers.wire.line import ByteLine
from mountnav.errors import DeviceGarbled, DeviceSilent

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
        product = await exchange.ask(codec.PRODUCT)
    try:
        await exchange.ask(codec.GET_RA)
        await exchange.ask(codec.GET_DEC)
    except (DeviceSilent, DeviceGarbled):
        return None
    return f"LX200: {product}" if product else "LX200, without a product name"
