"""One exposure that is waited for: when its middle was, whether an image is its own; no I/O [Alpaca §7]."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from drivers.generic.exposure import ExposureTimes, TimeSource, lasted_otherwise

_CLOCK = TimeSource("the camera's clock", "the camera tells no time", "the camera's is")
_MOST_SNAPPED = 2.0


@dataclass(frozen=True, slots=True)
class Told:
    """What a camera tells of its last exposure.

    Attributes
    ----------
    start : datetime or None
        By its own clock, aware UTC.
    duration_s : float or None
    """

    start: datetime | None = None
    duration_s: float | None = None


@dataclass(frozen=True, slots=True)
class Exposure:
    """What was ordered, and when, by our clock.

    Attributes
    ----------
    exposure_s : float
    ordered : datetime
        When the order went out.
    accepted : datetime
        When it was answered.
    before : Told
        What the camera told of the exposure before this one.
    """

    exposure_s: float
    ordered: datetime
    accepted: datetime
    before: Told = Told()

    def is_new(self, told: Told) -> bool:
        """Whether the camera tells a beginning that it did not tell before."""
        return told.start is not None and told.start != self.before.start

    def is_of_another(
        self,
        told: Told,
        came: datetime | None = None,
        tolerance_s: float = 1.0,
        *,
        clocks_agree: bool = False,
    ) -> bool:
        """Whether the image that is ready is of an earlier exposure, or of somebody else's.

        Parameters
        ----------
        told : Told
        came : datetime, optional
            When it was seen to be ready, by our clock; without it times are not compared.
        tolerance_s : float
        clocks_agree : bool
            Whether the camera's clock agreed with ours lately.
        """
        if told.start is not None and told.start.microsecond and told.start == self.before.start:
            # whole seconds are no fingerprint
            return True
        middle = self.told_middle(told)
        moments = None if came is None or middle is None else self._moments(came)
        if clocks_agree and moments and middle and moments.are_after(middle, tolerance_s):
            return True
        if not lasted_otherwise(told.duration_s, self.exposure_s):
            return False
        # some cameras know certain exposures only, and take the nearest
        near = told.duration_s is not None and (
            1.0 / _MOST_SNAPPED <= told.duration_s / self.exposure_s <= _MOST_SNAPPED
        )
        fits = moments and middle and moments.allow(middle, tolerance_s)
        return not (near and fits and self.is_new(told))

    def middle(self, told: Told, came: datetime, tolerance_s: float) -> tuple[datetime, str]:
        """Mid-exposure, and whose clock says so; see `Moments.middle`.

        Parameters
        ----------
        told : Told
        came : datetime
            When the image was seen to be ready, by our clock.
        tolerance_s : float
            How far the camera's time may lie outside what our clock allows.
        """
        return self._moments(came).middle(self.told_middle(told), tolerance_s, _CLOCK)

    def told_middle(self, told: Told) -> datetime | None:
        """Mid-exposure by the camera's clock."""
        if told.start is None:
            return None
        return told.start + timedelta(seconds=(told.duration_s or self.exposure_s) / 2.0)

    def _moments(self, came: datetime) -> ExposureTimes:
        begun = self.ordered + (self.accepted - self.ordered) / 2
        return ExposureTimes(self.exposure_s, self.ordered, begun, came)
