"""When an exposure was, by the camera's time where our clock allows that; whose an image is; no I/O."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

_SAME = 0.02
_SAME_S = 0.05
_STALE_WITHIN_S = 600.0
"""A time further back is a clock that is off: by a zone, by a day."""


@dataclass(frozen=True, slots=True)
class Teller:
    """How to speak of what tells a camera's time.

    Attributes
    ----------
    name : str
        By what a frame was timed: "its header".
    silent : str
        That it tells none: "its header tells no time".
    off : str
        What is before how far it is off: "its header is".
    """

    name: str
    silent: str
    off: str


@dataclass(frozen=True, slots=True)
class Moments:
    """What our clock knows of an exposure.

    Attributes
    ----------
    exposure_s : float
    ordered : datetime
        When the order went out: not before that it began.
    begun : datetime
        When it began most likely.
    came : datetime
        When its image was seen to be there: not after that it ended.
    """

    exposure_s: float
    ordered: datetime
    begun: datetime
    came: datetime

    @property
    def _half(self) -> timedelta:
        return timedelta(seconds=self.exposure_s / 2.0)

    @property
    def _earliest(self) -> datetime:
        return self.ordered + self._half

    @property
    def _latest(self) -> datetime:
        return max(self._earliest, self.came - self._half)

    def allow(self, middle: datetime, tolerance_s: float) -> bool:
        """Whether an exposure of this middle could have been this one, clocks that far apart allowed."""
        slack = timedelta(seconds=tolerance_s)
        return self._earliest - slack <= middle <= self._latest + slack

    def are_after(self, middle: datetime, tolerance_s: float) -> bool:
        """Whether an exposure of this middle was one shortly before the order, if the clocks agree."""
        before_s = (self._earliest - middle).total_seconds()
        return tolerance_s < before_s < _STALE_WITHIN_S

    def middle(self, told: datetime | None, tolerance_s: float, by: Teller) -> tuple[datetime, str]:
        """Mid-exposure, and whose clock says so.

        Parameters
        ----------
        told : datetime or None
            Mid-exposure by the camera.
        tolerance_s : float
            How far that may lie outside what our clock allows.
        by : Teller
        """
        ours = min(max(self.begun + self._half, self._earliest), self._latest)
        if told is None:
            return ours, f"our clock ({by.silent})"
        if self.allow(told, tolerance_s):
            return told, by.name
        return ours, f"our clock ({by.off} {(told - ours).total_seconds():+.1f} s off)"


def lasted_otherwise(told_s: float | None, exposure_s: float) -> bool:
    """Whether the exposure that a camera tells is not the one that was ordered; told none, it may be."""
    return told_s is not None and abs(told_s - exposure_s) > _SAME_S + _SAME * exposure_s
