"""What is known of an exposure besides its pixels: settings, mid-exposure time, pixel scale; no I/O."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from mountnav.frames import Frame


@dataclass(frozen=True, slots=True, kw_only=True)
class GenericCameraHabits:
    """What the configuration says of a camera.

    Attributes
    ----------
    may_connect : bool
        Whether a device that is not connected may be told to connect.
    binning : int or None
        None leaves it.
    focal_length_mm : float or None
        Of the telescope, where the camera's driver doesn't know it.
    download_s : float
        How long after its exposure an image may take to come.
    clock_tolerance_s : float
        The camera's time counts when it lies this near to what our clock allows.
    """

    may_connect: bool = True
    binning: int | None = None
    focal_length_mm: float | None = None
    download_s: float = 60.0
    clock_tolerance_s: float = 1.0


_SAME = 0.02
_SAME_S = 0.05
_STALE_WITHIN_S = 600.0
"""A time further back is a clock that is off: by a zone, by a day."""


@dataclass(frozen=True, slots=True)
class TimeSource:
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
class ExposureTimes:
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

    def middle(self, told: datetime | None, tolerance_s: float, by: TimeSource) -> tuple[datetime, str]:
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


_ARCSEC_PER_RADIAN = 206264.806
_MARGIN = 0.1


def optics_scale_arcsec_px(
    pixel_um: float | None, binning: float, focal_length_mm: float | None
) -> float | None:
    """Scale of a binned pixel, or None where pixel size or focal length isn't known."""
    if not pixel_um or not focal_length_mm:
        return None
    return _ARCSEC_PER_RADIAN * pixel_um * binning / 1000.0 / focal_length_mm


def with_scale(frame: Frame, scale: float | None, source: str) -> Frame:
    """Add a scale to a frame's hints, with a margin, where its header doesn't tell one.

    Parameters
    ----------
    frame : Frame
    scale : float or None
        In arcseconds per pixel.
    source : str
        Where it is from, in words.
    """
    if scale is None or frame.hint.scale_low_arcsec_px is not None:
        return frame
    hint = replace(
        frame.hint,
        scale_low_arcsec_px=scale * (1.0 - _MARGIN),
        scale_high_arcsec_px=scale * (1.0 + _MARGIN),
        scale_source=source,
    )
    return replace(frame, hint=hint)
