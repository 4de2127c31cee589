"""Rates of a mount that speaks LX200: tracking beside the sidereal rate, and axes moved by the keys.

The words are the dialect's (`drivers.lx200.codec.rates`).
"""

from __future__ import annotations

from drivers.generic.language import Sent, Wanted
from drivers.generic.one_axis import refuse_lame_axis
from drivers.lx200.codec.rates import MotionKeys, OffsetWords
from drivers.lx200.exchange import Lx200Exchange
from mountnav.devices import STARS_RATES, MountAxis, OffsetRates
from mountnav.errors import DeviceRefused, Refusal


async def order_rates(exchange: Lx200Exchange, words: OffsetWords, rates: OffsetRates) -> None:
    """Order rates beside the sidereal one; when the second of two orders is refused, neither counts.

    Raises
    ------
    DeviceRefused
        If it takes none in that axis, or says no.
    """
    refuse_lame_axis(rates, words.most_arcsec_s, words.why_one, device=exchange.device)
    sent = False
    try:
        for order in words.set(rates):
            await exchange.order(order, "the offset rates")
            sent = True
    except DeviceRefused:
        if sent and not rates.none:
            for order in words.set(STARS_RATES):
                await exchange.order(order, "the end of the offset rates")
        raise


async def move_axis(
    exchange: Lx200Exchange, keys: MotionKeys, axis: MountAxis, rate_deg_s: float, wanted: Wanted
) -> Sent:
    """Choose the speed and press a key, or let go of it.

    Raises
    ------
    DeviceRefused
        If this mount can't be moved so.
    """
    if rate_deg_s == 0.0:
        return await exchange.once(keys.let_go_of(axis), "the end of the motion", wanted)
    why = "" if keys.never is None else await keys.never(exchange)
    if why:
        raise DeviceRefused(
            f"can't move its axes by hand: {why}", device=exchange.device, reason=Refusal.UNSUPPORTED
        )
    return await exchange.once(keys.pressed(axis, rate_deg_s), "the motion", wanted)
