"""Both motors behind a hand control at rates of their own: after what moves among the stars, and by hand.

The hand control passes on a rate in quarters of an arcsecond a second [NexStar P 0x06]. It is one over the
ground, and takes the place of tracking; while the hand control tracks it puts its own rate back after some
time, or with its next word to the motors, so tracking is switched off before, and on again to end it. Then
its tracking mode says "off" while the mount follows: that it follows only we know, and how fast it goes is
read nowhere.

Quarters are coarse: the rate of the stars itself can't be said. Rates that would be kept worse so than by
tracking the stars are refused. Where the mount is not known to be equatorial, or its side of the pier isn't
known, and for a SynScan, whose signs nobody has told, there is no such skill.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from drivers.generic.refusal_words import rates_text
from drivers.nexstar.codec import base
from drivers.nexstar.codec.dialect import Tracking
from drivers.nexstar.codec.passthrough import Axis, motor_for
from drivers.wire.command import Command
from mountnav.devices import Direction, MountAxis, OffsetRates, PierSide, RateSpan
from mountnav.errors import DeviceError, DeviceRefused, Refusal
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S

STEP_ARCSEC_S = 0.25
"""Rates are told in quarters of an arcsecond a second [NexStar P 0x06]."""
MOST_ARCSEC_S = 3600.0
"""A degree a second: slower than any of these mounts slews. Chosen by hand, far below what the wire could
say; doubled, some mounts don't keep up."""
SPANS = (RateSpan(0.002, MOST_ARCSEC_S / 3600.0),)
"""At which speeds an axis can be moved by hand, °/s: from half of what tracking is."""
_WORSE = 0.5
"""Rates are refused when rounding would leave more of them out than this share. Chosen by hand: at 1 tracking
the stars would be as good."""


@dataclass(frozen=True, slots=True)
class Turning:
    """How the motors lie on the sky: what is known of that when rates are ordered."""

    side: PierSide | None
    mode: Tracking

    @property
    def sky(self) -> int:
        """+1 where the first motor's plus is the way it tracks."""
        return motor_for(Direction.WEST, self.side, self.mode)[1]

    @property
    def north(self) -> int:
        """+1 where the second motor's plus raises the declination."""
        return motor_for(Direction.NORTH, self.side, self.mode)[1]


def rounded(rates: OffsetRates) -> OffsetRates:
    """What is left of rates beside the sidereal one when both motors' are told in quarters."""
    along = _quarters(SIDEREAL_ARCSEC_S - rates.ra_arcsec_s)
    return OffsetRates(SIDEREAL_ARCSEC_S - along, _quarters(rates.dec_arcsec_s))


def _quarters(rate_arcsec_s: float) -> float:
    return round(rate_arcsec_s / STEP_ARCSEC_S) * STEP_ARCSEC_S


def too_coarse(rates: OffsetRates) -> bool:
    """Whether rounding would leave too much of them out."""
    told = rounded(rates)
    off = math.hypot(told.ra_arcsec_s - rates.ra_arcsec_s, told.dec_arcsec_s - rates.dec_arcsec_s)
    return off > _WORSE * math.hypot(rates.ra_arcsec_s, rates.dec_arcsec_s)


class Following:
    """Which rates were ordered, and the words for others.

    Parameters
    ----------
    ask : callable
        Puts one question, in step.
    device : str
        For messages.
    """

    def __init__(self, ask: Callable[[Command[None]], Awaitable[None]], device: str) -> None:
        self._ask = ask
        self._device = device
        self.offsets: OffsetRates | None = None
        self._moved: dict[MountAxis, float] = {}

    @property
    def under_way(self) -> bool:
        """Whether the motors run at rates of ours."""
        return self.offsets is not None or bool(self._moved)

    def forget(self) -> None:
        """The hand control has taken the motors back."""
        self.offsets = None
        self._moved.clear()

    async def offset(self, rates: OffsetRates, turning: Turning, modes: tuple[int, int]) -> None:
        """Run at rates beside the sidereal one, or as for a star.

        Parameters
        ----------
        modes : (int, int)
            Numbers of the tracking modes off and on.

        Raises
        ------
        DeviceRefused
            If these motors can't be told such rates.
        """
        if not rates.none and too_coarse(rates):
            raise DeviceRefused(
                f"can't track at {rates_text(rates)}: "
                f"its hand control knows steps of {STEP_ARCSEC_S}″/s alone",
                device=self._device,
                advice="follow by pulses or small slews",
                reason=Refusal.UNSUPPORTED,
            )
        began, self.offsets = self.under_way, None if rates.none else rates
        await self._apply(turning, modes, began=began)

    async def move(
        self, axis: MountAxis, rate_deg_s: float, turning: Turning, modes: tuple[int, int]
    ) -> None:
        """Move an axis on, on top of what the motors do, or no more."""
        began = self.under_way
        if rate_deg_s:
            self._moved[axis] = rate_deg_s * 3600.0
        else:
            self._moved.pop(axis, None)
        await self._apply(turning, modes, began=began)

    async def take_back(self, modes: tuple[int, int]) -> None:
        """Let both motors rest, whatever they do, and the hand control track by itself."""
        self.forget()
        try:
            await self._ask(base.move_at(Axis.DEC, 0.0))
            await self._ask(base.move_at(Axis.RA, 0.0))
        finally:
            await self._ask(base.set_tracking(modes[1]))

    async def _apply(self, turning: Turning, modes: tuple[int, int], *, began: bool) -> None:
        off, on = modes
        if not self.under_way:
            if began:
                await self._ask(base.set_tracking(on))
            return
        offsets = self.offsets or OffsetRates(0.0, 0.0)
        ra = offsets.ra_arcsec_s + self._moved.get("primary", 0.0)
        dec = offsets.dec_arcsec_s + self._moved.get("secondary", 0.0)
        try:
            if not began:
                await self._ask(base.set_tracking(off))
            await self._ask(base.move_at(Axis.RA, turning.sky * (SIDEREAL_ARCSEC_S - ra)))
            await self._ask(base.move_at(Axis.DEC, turning.north * dec))
        except DeviceError:
            # what it does now isn't known: better that it tracks
            self.forget()
            with contextlib.suppress(DeviceError):
                await self._ask(base.set_tracking(on))
            raise
