"""What an iOptron mount can do after what moves among the stars: its right ascension alone, and arrow keys.

Its custom rate is one of the hour angle axis, in ten-thousandths of the sidereal one, from 0.1 to 1.9; the
declination has none [IOPTRON310 :RR]. Its arrow keys move the declination by `:mn#` and `:ms#`, of which the
document says the contrary of what INDI's driver takes them for: that axis isn't moved.
"""

from __future__ import annotations

from drivers.generic.language import Sent, Wanted
from drivers.generic.one_axis import refuse_lame_axis
from drivers.ioptron.codec import v3
from drivers.ioptron.codec.values import TrackingRate
from drivers.ioptron.exchange import IoptronExchange
from mountnav.devices import STARS_RATES, OffsetRates, RateSpan
from mountnav.errors import Refusal
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S, SIDEREAL_DEG_S

MOST = OffsetRates(0.9 * SIDEREAL_ARCSEC_S, 0.0)
"""The largest rates beside the sidereal one: 0.1 to 1.9 of it, and none in declination [IOPTRON310 :RR]."""
STEP_ARCSEC_S = 1e-4 * SIDEREAL_ARCSEC_S
"""The step of a custom rate, ″/s: four decimals of the sidereal rate."""
_WHY = "iOptron mounts have a custom rate in right ascension alone"
_SLOWEST_NUMBER, _FASTEST_NUMBER = 3, 7
"""Numbers of the arrow keys' speeds that are used: 8 to 256 times sidereal. Below, it matters whether they
come on top of tracking, which the document doesn't say; above, a model's own limit may be lower."""
SPEEDS = {
    v3.ARROW_SPEEDS[number - 1] * SIDEREAL_DEG_S: number
    for number in range(_SLOWEST_NUMBER, _FASTEST_NUMBER + 1)
}
"""Speeds of the right ascension axis, °/s, and their numbers."""
SPANS = tuple(RateSpan(speed, speed) for speed in sorted(SPEEDS))
"""The same as spans."""


async def order_rates(exchange: IoptronExchange, rates: OffsetRates) -> None:
    """Order the custom rate, and to track at it; or to track at the stars' rate again.

    Raises
    ------
    DeviceRefused
        For a part in declination, when it is parked, or says 0.
    """
    refuse_lame_axis(rates, MOST, _WHY, device=exchange.link.device)
    await exchange.settled("tracking at offset rates", moves=not rates.none)
    if rates.none:
        await exchange.obeyed(v3.set_rate(TrackingRate.SIDEREAL), "the sidereal rate")
        return
    await exchange.obeyed(v3.set_custom_rate(1.0 - rates.ra_arcsec_s / SIDEREAL_ARCSEC_S), "the custom rate")
    await exchange.obeyed(v3.set_rate(TrackingRate.CUSTOM), "to track at the custom rate")


async def told_rates(exchange: IoptronExchange) -> OffsetRates | None:
    """What it tracks at beside the sidereal rate, if it is set to its custom one."""
    status = await exchange.ask(exchange.words.status)
    if status.rate is not TrackingRate.CUSTOM:
        return STARS_RATES
    times = await exchange.known(v3.CUSTOM_RATE)
    return None if times is None else OffsetRates((1.0 - times) * SIDEREAL_ARCSEC_S, 0.0)


async def move_ra(exchange: IoptronExchange, rate_deg_s: float, wanted: Wanted) -> Sent:
    """Press an arrow key of right ascension, east positive, or let go of it.

    Raises
    ------
    DeviceRefused
        When it is parked, has no such speed, or says 0.
    """
    await exchange.settled("moving its axis", moves=rate_deg_s != 0.0)
    if not wanted():
        return Sent(wire=False)
    if rate_deg_s == 0.0:
        taken, lost = await exchange.told(v3.END_RA)
        if taken is False:
            raise exchange.no("refused to end the motion: 0", Refusal.OTHER, "stop it")
        return Sent(lost=lost)
    speed = min(SPEEDS, key=lambda one: abs(one - abs(rate_deg_s)))
    await exchange.obeyed(v3.set_arrow_speed(SPEEDS[speed]), "the speed of its keys")
    if not wanted():
        return Sent(wire=False)
    await exchange.ask(v3.move_ra(up=rate_deg_s > 0.0))
    return Sent()
