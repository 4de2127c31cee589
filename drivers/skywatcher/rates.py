"""Both motors at any rate: after what moves among the stars, and moved on by hand.

A rate is a step period, a whole number of ticks: a board with a slow timer (an EQ6: 620 ticks for the stars)
has steps of 0.024″/s there, and of more the faster it runs. One with a fast timer can't run slowly: its
longest period is a rate of 0.13″/s (an AZ-EQ6), and below half of that the second motor rests. Which rates
are in force follows from the periods and the directions that the board tells.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.skywatcher import codec
from drivers.skywatcher.axes import Gearing
from drivers.skywatcher.codec import LARGEST, Axis, MotorStatus
from drivers.skywatcher.exchange import Motors
from mountnav.devices import OffsetRates, RateSpan
from mountnav.errors import DeviceError, DeviceRefused
from mountnav.sky.coordinates import SIDEREAL_DEG_S

_FASTEST = 128.0
"""Times sidereal: motors are run no faster in the low speed range [INDI eqmod LOWSPEED_RATE]."""
_SLOWEST = 0.1
"""Times sidereal, of an axis that is moved by hand. Chosen by hand: nobody sees it move more slowly."""
_LEAST_PERIOD = 10
"""Ticks: with a shorter period a rate could be off by more than a twentieth, and boards don't obey the
shortest ones. Chosen by hand; halved, an EQ6 follows twice as fast, and off by a tenth."""


@dataclass(frozen=True, slots=True)
class Ground:
    """Rates of both motors over the ground, °/s; forward counts are positive."""

    first_deg_s: float
    second_deg_s: float


def ground_rates(rates: OffsetRates, base_deg_s: float, sky: int, north: int) -> Ground:
    """The motors' rates for rates beside a tracking rate.

    Parameters
    ----------
    base_deg_s : float
        What is tracked at besides; positive.
    sky : int
        +1 where the first axis runs forward with the sky, else -1.
    north : int
        +1 where the second one raises the declination by running forward, else -1.
    """
    return Ground(sky * (base_deg_s - rates.ra_arcsec_s / 3600.0), north * rates.dec_arcsec_s / 3600.0)


def rates_of(ground: Ground, base_deg_s: float, sky: int, north: int) -> OffsetRates:
    """Inverse of `ground_rates`."""
    return OffsetRates((base_deg_s - sky * ground.first_deg_s) * 3600.0, north * ground.second_deg_s * 3600.0)


def fastest_deg_s(gear: Gearing) -> float:
    """How fast a motor is run at most, °/s over the ground."""
    return min(_FASTEST * SIDEREAL_DEG_S, gear.rate_deg_s(_LEAST_PERIOD))


def spans_of(gear: Gearing) -> tuple[RateSpan, ...]:
    """At which speeds its axis can be moved by hand, on top of tracking."""
    return (RateSpan(_SLOWEST * SIDEREAL_DEG_S, fastest_deg_s(gear) - SIDEREAL_DEG_S),)


def most_beside(gears: dict[Axis, Gearing]) -> OffsetRates:
    """The largest rates beside the sidereal one."""
    return OffsetRates(
        (fastest_deg_s(gears[Axis.HOUR_ANGLE]) - SIDEREAL_DEG_S) * 3600.0,
        fastest_deg_s(gears[Axis.DECLINATION]) * 3600.0,
    )


def step_beside(gears: dict[Axis, Gearing], rates: OffsetRates) -> float:
    """Coarsest step of rates, ″/s, at those given: how far off the next ones are that motors can run at."""
    first = gears[Axis.HOUR_ANGLE].rate_step_deg_s(abs(SIDEREAL_DEG_S - rates.ra_arcsec_s / 3600.0))
    second = gears[Axis.DECLINATION].rate_step_deg_s(abs(rates.dec_arcsec_s / 3600.0))
    return max(first, second) * 3600.0


class Following:
    """Runs both motors at rates over the ground."""

    def __init__(self, motors: Motors) -> None:
        self._motors = motors

    async def run(self, axis: Axis, rate_deg_s: float, wanted: Callable[[], bool]) -> bool:
        """Let one motor run on (signed: forward counts), or rest at 0; False when no longer wanted.

        Raises
        ------
        DeviceRefused
            If the board says no, or it can't run so fast.
        """
        gear = self._motors.gears[axis]
        # a fast timer counts no period that is long enough for the slowest rates: rest may be nearer
        if abs(rate_deg_s) < 0.5 * gear.rate_deg_s(LARGEST):
            return await self._motors.halt(axis, wanted)
        fastest = fastest_deg_s(gear)
        if abs(rate_deg_s) > fastest * (1.0 + 1e-9):
            raise DeviceRefused(
                f"motor {int(axis)} can't be run at {rate_deg_s:+.4f}°/s: at most {fastest:.4f}°/s",
                device=self._motors.link.device,
            )
        return await self._motors.run(axis, rate_deg_s, wanted)

    async def follow(self, ground: Ground, before: Ground, wanted: Callable[[], bool]) -> bool:
        """Let both run; when the second is refused the first runs as before again."""
        if not await self.run(Axis.HOUR_ANGLE, ground.first_deg_s, wanted):
            return False
        try:
            return await self.run(Axis.DECLINATION, ground.second_deg_s, wanted)
        except DeviceRefused:
            with contextlib.suppress(DeviceError):
                await self.run(Axis.HOUR_ANGLE, before.first_deg_s, wanted)
            raise

    async def in_force(self, first: MotorStatus, second: MotorStatus) -> Ground | None:
        """At which rates both run; None where the board doesn't tell, or one runs to a target or fast."""
        rates = []
        for axis, status in ((Axis.HOUR_ANGLE, first), (Axis.DECLINATION, second)):
            rate = await self._rate(axis, status)
            if rate is None:
                return None
            rates.append(rate)
        return Ground(*rates)

    async def _rate(self, axis: Axis, status: MotorStatus) -> float | None:
        if not status.running:
            return 0.0
        if status.goto or status.fast:
            return None
        period = await self._motors.refining.known(codec.step_period(axis))
        if period is None:
            return None
        return math.copysign(self._motors.gears[axis].rate_deg_s(period), -1.0 if status.backward else 1.0)
