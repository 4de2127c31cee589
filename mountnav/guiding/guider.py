"""Both axes of a mount that is held: gates looks, tells jumps and faults, and gives corrections.

Coordinates are offsets on the sky of where the telescope looks from where it should, ″, along the two axes:
for an equatorial mount east and north; for an alt-azimuth mount along azimuth (times cos alt) and altitude,
which turn against east and north by the parallactic angle. The caller turns them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from mountnav.errors import BadRequest
from mountnav.guiding.actuator import Actuator
from mountnav.guiding.axis import HeldAxis
from mountnav.guiding.axis_filter import AxisState
from mountnav.guiding.law import NO_CORRECTION, AxisCorrection

GATE_SIGMAS = 5.5
"""A look farther from what is expected is not believed by itself: once in ten million by noise alone. Halved,
one look of 150 is left aside."""
GATE_LEAST_ARCSEC = 2.0
"""Nothing nearer is gated: tails of seeing are not normal."""
AGREE_ARCSEC = 3.0
"""So near (and by three sigma) two looks that were gated one after the other must be to be believed: then the
telescope has moved, and the looks are right."""
_AGREE_SIGMAS = 3.0
"""And by so many sigma of both. Doubled, a bad pair of looks is followed more often."""
FAR_ARCSEC = 3600.0
"""A look farther off than this is not of this field, or the mount is lost: it is never followed."""


class LookFate(StrEnum):
    """What became of a look."""

    TAKEN = "taken"
    GATED = "gated"
    """Far from what is expected; the next one decides."""
    JUMP = "jump"
    """The second one in a row that says so: the telescope was moved by something."""
    STALE = "stale"
    """Not later than the last one, or from before the last correction was over."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What a look came to.

    Attributes
    ----------
    primary_arcsec, secondary_arcsec : float
        Seen minus wanted.
    expected_primary_arcsec, expected_secondary_arcsec : float
        What was expected of it.
    sigma_arcsec : float
        Of that expectation, the look's noise included, the larger of both axes.
    """

    fate: LookFate
    primary_arcsec: float
    secondary_arcsec: float
    expected_primary_arcsec: float
    expected_secondary_arcsec: float
    sigma_arcsec: float


@dataclass(frozen=True, slots=True)
class Correction:
    """What to do with both axes."""

    primary: AxisCorrection = NO_CORRECTION
    secondary: AxisCorrection = NO_CORRECTION

    @property
    def none(self) -> bool:
        """Whether it is no correction at all."""
        return self.primary.none and self.secondary.none


class Guider:
    """Holds a telescope by looks: a pure value in, value out controller; times are s from any instant.

    Parameters
    ----------
    primary, secondary : Actuator
        How each axis is corrected.
    start_sigma_arcsec : float
        How far from its target it may be when it begins.
    period_s : float, optional
        Of the worm, where it is known.
    both_swing : bool
        Whether the secondary axis follows the sky, too: an alt-azimuth mount.

    Attributes
    ----------
    rates_known : bool
        It is known how much corrections do on both axes; else drift and amplitudes are known up to a common
        factor only: they look twice as large where corrections are believed to do twice as much.
    """

    def __init__(
        self,
        primary: Actuator,
        secondary: Actuator,
        *,
        start_sigma_arcsec: float = 2.0,
        period_s: float | None = None,
        both_swing: bool = False,
    ) -> None:
        if not 0.0 < start_sigma_arcsec < FAR_ARCSEC:
            raise BadRequest("the start's sigma must lie between 0 and 3600″", advice="give 2")
        if period_s is not None and not 10.0 <= period_s <= 7200.0:
            raise BadRequest(
                "a worm's period lies between 10 s and 2 h", advice="leave it out to have it found"
            )
        self.rates_known = primary.rate_known and secondary.rate_known
        self.primary = HeldAxis(primary, start_sigma_arcsec=start_sigma_arcsec, period_s=period_s)
        self.secondary = HeldAxis(
            secondary,
            start_sigma_arcsec=start_sigma_arcsec,
            swings=both_swing,
            period_s=period_s if both_swing else None,
        )
        self._pending: tuple[float, float, float, float, float] | None = None
        self._last_s = -math.inf
        self._fresh = False

    def look(self, utc_s: float, primary_arcsec: float, secondary_arcsec: float, sigma_arcsec: float) -> Seen:
        """Take in a look.

        Parameters
        ----------
        utc_s : float
            Of the middle of its exposure.
        primary_arcsec, secondary_arcsec : float
            Seen minus wanted.
        sigma_arcsec : float
            Of the solved center, per axis.

        Raises
        ------
        BadRequest
            A number that is none.
        """
        numbers = (utc_s, primary_arcsec, secondary_arcsec, sigma_arcsec)
        if not all(map(math.isfinite, numbers)) or sigma_arcsec < 0.0:
            raise BadRequest(
                "a look's numbers must be finite, its sigma not negative", advice=f"got {numbers}"
            )
        if utc_s <= self._last_s:
            return Seen(LookFate.STALE, primary_arcsec, secondary_arcsec, 0.0, 0.0, math.inf)
        east, east_sigma = self.primary.expected(utc_s, sigma_arcsec)
        north, north_sigma = self.secondary.expected(utc_s, sigma_arcsec)
        self._last_s = utc_s
        off_east, off_north = primary_arcsec - east, secondary_arcsec - north
        fate = self._judged(utc_s, off_east, off_north, east_sigma, north_sigma, sigma_arcsec)
        if fate is LookFate.JUMP:
            for axis, off, sigma in (
                (self.primary, off_east, east_sigma),
                (self.secondary, off_north, north_sigma),
            ):
                if abs(off) > 0.5 * GATE_SIGMAS * sigma:
                    axis.jumped(off)
        if fate is not LookFate.GATED:
            self.primary.seen(utc_s, primary_arcsec, sigma_arcsec)
            self.secondary.seen(utc_s, secondary_arcsec, sigma_arcsec)
            self._fresh = True
        return Seen(fate, primary_arcsec, secondary_arcsec, east, north, max(east_sigma, north_sigma))

    def _judged(
        self, utc_s: float, east: float, north: float, east_sigma: float, north_sigma: float, sigma: float
    ) -> LookFate:
        outside = max(
            abs(east) / max(GATE_SIGMAS * east_sigma, GATE_LEAST_ARCSEC),
            abs(north) / max(GATE_SIGMAS * north_sigma, GATE_LEAST_ARCSEC),
        )
        if outside <= 1.0:
            self._pending = None
            return LookFate.TAKEN
        last, self._pending = self._pending, (utc_s, east, north, east_sigma, north_sigma)
        if last is None or math.hypot(east, north) > FAR_ARCSEC:
            return LookFate.GATED
        bound_east = AGREE_ARCSEC + _AGREE_SIGMAS * math.hypot(east_sigma, last[3])
        bound_north = AGREE_ARCSEC + _AGREE_SIGMAS * math.hypot(north_sigma, last[4])
        if abs(east - last[1]) <= bound_east and abs(north - last[2]) <= bound_north:
            self._pending = None
            return LookFate.JUMP
        return LookFate.GATED

    def correction(self, utc_s: float, interval_s: float) -> Correction:
        """The best corrections at an instant, to hold until the next ones.

        Parameters
        ----------
        interval_s : float
            Until the next corrections can be made.

        Raises
        ------
        BadRequest
        """
        if not 0.0 < interval_s < math.inf:
            raise BadRequest("the time to the next correction must be positive", advice=f"got {interval_s}")
        if self._pending is not None:
            # something has moved it, or a look is wrong: the next one tells
            return Correction()
        fresh, self._fresh = self._fresh, False
        return Correction(
            self.primary.correction(utc_s, interval_s, fresh=fresh),
            self.secondary.correction(utc_s, interval_s, fresh=fresh),
        )

    def corrected(self, correction: Correction, utc_s: float) -> None:
        """It was made, at that instant."""
        self.primary.corrected(correction.primary, utc_s)
        self.secondary.corrected(correction.secondary, utc_s)

    def another_field(self, start_sigma_arcsec: float = 2.0) -> None:
        """After a slew, a flip or another target: looks so far say nothing of where it is now."""
        self._pending = None
        self.primary.another_field(start_sigma_arcsec)
        self.secondary.another_field(start_sigma_arcsec)

    def wanted_elsewhere(self, primary_arcsec: float, secondary_arcsec: float) -> None:
        """The place where it should look has moved by so much: a dither. Looks count from there on."""
        self._pending = None
        self.primary.wanted_elsewhere(primary_arcsec)
        self.secondary.wanted_elsewhere(secondary_arcsec)
        self._fresh = True

    @property
    def backed_off(self) -> tuple[bool, bool]:
        """Of each axis whether corrections were seen to do harm, so that none are made."""
        return self.primary.backed_off, self.secondary.backed_off

    def state(self, sigma_arcsec: float) -> tuple[AxisState, AxisState]:
        """What is known of both axes."""
        return self.primary.state(sigma_arcsec), self.secondary.state(sigma_arcsec)

    def fault(self) -> tuple[Literal["primary", "secondary"], str] | None:
        """Which axis doesn't do what it is told: ("primary", "reversed") and the like."""
        for name, axis in (("primary", self.primary), ("secondary", self.secondary)):
            fault = axis.fault()
            if fault is not None:
                return name, fault  # type: ignore[return-value]
        return None


__all__ = ["Correction", "Guider", "LookFate", "Seen"]
