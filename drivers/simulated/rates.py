"""What a mount without a wire does until it is told otherwise: offset rates, moved axes; and the stop."""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.generic.options import Timing
from drivers.generic.rates import same_rates
from drivers.generic.refusal_words import parked, rates_text
from drivers.simulated.state import SimulatedState
from mountnav.devices import MountAxis, OffsetRates, RateSpan, Skill
from mountnav.errors import BadRequest, DeviceError, DeviceRefused, Refusal
from mountnav.simulation.mechanics import Direction
from mountnav.sky.coordinates import SIDEREAL_DEG_S

REAL = Timing()
"""The times by which real mounts are treated: a simulated one is stopped and watched for as long."""
_STOP_POLL_S = 0.1
"""Longest time (s) between two stops: a stop returns no more than this after the mount rests."""


class SimulatedRates(SimulatedState):
    """Offset rates, axes moved by hand, and the stop of a `SimulatedMount`."""

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """The largest rates beside the sidereal one: what its motors do, or less."""
        machine = self.mechanics.machine
        motors_deg_s = machine.slew_rate_deg_s, machine.dec_slew_rate_deg_s or machine.slew_rate_deg_s
        # the hour angle axis turns with the sky besides
        free_deg_s = motors_deg_s[0] - SIDEREAL_DEG_S, motors_deg_s[1]
        ra, dec = (min(self.behavior.most_rate_arcsec_s, 3600.0 * free) for free in free_deg_s)
        return OffsetRates(ra, dec)

    @property
    def offset_step_arcsec_s(self) -> float:
        """It rounds none."""
        return 0.0

    @property
    def rates_known(self) -> OffsetRates | None:
        """At which offset rates it tracks as far as its driver knows; None where that is not known."""
        self._see_reboots()
        return self._rates

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """Up to the speed of a slew; none where it can't."""
        if not self.behavior.moves_axes:
            return {}
        machine = self.mechanics.machine
        dec_deg_s = machine.dec_slew_rate_deg_s or machine.slew_rate_deg_s
        return {
            "primary": (RateSpan(0.0, machine.slew_rate_deg_s),),
            "secondary": (RateSpan(0.0, dec_deg_s),),
        }

    @property
    def axes_moved(self) -> Mapping[MountAxis, float]:
        """Which axes are moved by hand at present, and how fast, °/s."""
        return dict(self._axes)

    async def stop(self) -> None:
        """Stop all motion now; return when it rests.

        Raises
        ------
        DeviceSilent, DeviceMissing
            If the stop can't be sent.
        DeviceRefused
            If it still moves after 20 s.
        """
        self._stops += 1
        self._stop_owed = True
        await self.cable.ask()
        self._stop_now()
        self._end_rates()
        began_s = self._clock.monotonic_s()
        while self.mechanics.slewing():
            if self._clock.monotonic_s() - began_s > REAL.stop_timeout_s:
                raise DeviceRefused(
                    "was told to stop and still moves", device=self._name, advice="cut its power"
                )
            await self._clock.sleep(min(_STOP_POLL_S, self.behavior.poll_s))
            await self.cable.ask()
            self._stop_now()
        self._stop_owed = False
        self._axes.clear()

    async def set_offset_rates(self, rates: OffsetRates) -> None:
        """Track at rates beside the sidereal one; see `GenericMount.set_offset_rates`.

        Raises
        ------
        BadRequest, Busy
        DeviceRefused
            If it can't, they are too fast, it is parked, doesn't track or isn't trusted; or if it says
            afterwards that it has other rates: those were ended.
        RefusedButDone
        DeviceSilent, DeviceMissing
            If at which rates it tracks isn't known.
        """
        self._require_skill(Skill.OFFSET_RATES)
        self._check_rates(rates)
        self._require_no_job()
        stops, links = self._stops, self.cable.links
        await self.cable.ask()
        self._see_reboots()
        self._require_no_job()
        if not rates.none:
            self._require_trust("tracking at offset rates")
            if self.mechanics.parked:
                raise parked("tracking at offset rates", device=self._name)
            if not self.mechanics.tracking:
                raise DeviceRefused(
                    "can't track at offset rates: it doesn't track",
                    device=self._name,
                    advice="switch tracking on first",
                    reason=Refusal.NOT_TRACKING,
                )
        if stops != self._stops:
            raise DeviceRefused(
                "the order to track at offset rates was not sent: a stop came", device=self._name
            )
        self.received.append("rates")
        self.mechanics.track_beside(rates.ra_arcsec_s, rates.dec_arcsec_s)
        self._rates, self._rates_ours = None, self._rates_ours or not rates.none
        if "rates" in self.denies:
            self._end_rates()
            self._distrust("it said no to the offset rates, and did it")
            raise self._denied("the offset rates", "did it; undone")
        await self.cable.ask()
        self.cable.require(links)
        told = OffsetRates(*self.mechanics.beside_arcsec_s) if self.behavior.tells_rates else rates
        if stops == self._stops and not same_rates(told, rates, 0.0):
            self._rates_ours = True
            self._end_rates()
            raise DeviceRefused(
                f"accepted offset rates of {rates_text(rates)}, and says that it has {rates_text(told)}; "
                "they were ended",
                device=self._name,
            )
        if stops == self._stops:
            self._rates, self._rates_ours = rates, not rates.none

    def _check_rates(self, rates: OffsetRates) -> None:
        most = self.most_offset_arcsec_s
        assert most is not None
        for axis, rate, most_arcsec_s in (
            ("right ascension", rates.ra_arcsec_s, most.ra_arcsec_s),
            ("declination", rates.dec_arcsec_s, most.dec_arcsec_s),
        ):
            if not math.isfinite(rate):
                raise BadRequest(
                    f"an offset rate of {rate}″/s in {axis}", device=self._name, advice="a finite number"
                )
            if abs(rate) > most_arcsec_s:
                raise DeviceRefused(
                    f"can't track at {rate:+.4f}″/s in {axis}: it takes at most {most_arcsec_s:.4f}″/s",
                    device=self._name,
                    reason=Refusal.LIMIT,
                )

    async def offset_rates(self) -> OffsetRates | None:
        """At which rates it says to track beside the sidereal one; None where it doesn't say."""
        if not (self.behavior.takes_rates and self.behavior.tells_rates):
            return None
        await self.cable.ask()
        return OffsetRates(*self.mechanics.beside_arcsec_s)

    async def move_axis(self, axis: MountAxis, rate_deg_s: float) -> None:
        """Move an axis on at a speed until told otherwise, on top of tracking; 0 ends it.

        Raises
        ------
        BadRequest, Busy
        DeviceRefused
            If it can't, is parked or slews.
        RefusedButDone
        DeviceSilent, DeviceMissing
            If it can't be told; a motion that may have begun is stopped as soon as it can be.
        """
        self._require_skill(Skill.MOVE_AXIS)
        spans = self.axis_rates_deg_s.get(axis, ())
        if not (spans and math.isfinite(rate_deg_s) and abs(rate_deg_s) <= spans[0].most_deg_s):
            raise BadRequest(
                f"can't move its {axis} axis at {rate_deg_s}°/s",
                device=self._name,
                advice=f"at most {spans[0].most_deg_s:g}°/s" if spans else "primary or secondary",
            )
        self._require_no_job(by_hand=True)
        ways: tuple[Direction, Direction] = ("e", "w") if axis == "primary" else ("n", "s")
        stops = self._stops
        try:
            await self.cable.ask()
        except DeviceError:
            if rate_deg_s == 0.0 and self._axes:
                await self.stop()
                return
            raise
        self._see_reboots()
        self._require_no_job(by_hand=True)
        self.received.append("axis")
        if rate_deg_s == 0.0:
            self._axes.pop(axis, None)
            self.mechanics.stop_move(ways[0])
            while not self._axes and self.mechanics.slewing() and self._job is None:
                await self._clock.sleep(min(_STOP_POLL_S, self.behavior.poll_s))
                await self.cable.ask()
            return
        if self.mechanics.parked:
            raise parked("moving an axis", device=self._name)
        if stops != self._stops:
            raise DeviceRefused(
                "the order to move the axis was not sent: a stop came before it", device=self._name
            )
        self.mechanics.move(ways[rate_deg_s < 0.0], abs(rate_deg_s))
        if "axis" in self.denies:
            await self.stop()
            self._distrust("it said no to moving the axis, and moved")
            raise self._denied("moving the axis", "moved; stopped")
        self._axes[axis] = rate_deg_s
