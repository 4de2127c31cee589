"""What is known of an exposure besides its pixels: settings, mid-exposure time, pixel scale; no I/O."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from mountnav.frames import Frame
from mountnav.units import pixel_scale_arcsec


@dataclass(frozen=True, slots=True, kw_only=True)
class GenericCameraHabits:
    """What the settings say about a camera of any protocol.

    Attributes
    ----------
    may_connect : bool
        Whether a device that is not connected may be connected by us.
    binning : int or None
        None leaves it as it is.
    focal_length_mm : float or None
        Of the telescope, where the camera's driver doesn't know it.
    download_s : float
        How long after its exposure an image may take to come.
    clock_tolerance_s : float
        The camera's time of mid-exposure is used if it is no further than this outside what our clock allows.
    """

    may_connect: bool = True
    binning: int | None = None
    focal_length_mm: float | None = None
    download_s: float = 60.0
    clock_tolerance_s: float = 1.0


_SAME, _SAME_S = 0.02, 0.05
"""Two exposure times are the same within this share and this many seconds. Chosen by hand: drivers round to
their timer's steps (1/50 s and the like). Doubled, an image of 9.5 s passes for one of 10 s; halved, a
rounded one is refused."""
_STALE_WITHIN_S = 600.0
"""A time of mid-exposure up to this many seconds before the order is that of an earlier image; one further
back is a clock that is off by a zone or a day. Doubled or halved, only images of the last minutes are told
apart differently."""


@dataclass(frozen=True, slots=True)
class TimeSource:
    """Words for the source of a camera's time, used in `Frame.source` and messages.

    Attributes
    ----------
    name : str
        "its header".
    silent : str
        That there is no time: "its header tells no time".
    off : str
        Begins a phrase that ends with the error: "its header is".
    """

    name: str
    silent: str
    off: str


@dataclass(frozen=True, slots=True)
class ExposureTimes:
    """The times of an exposure by our own clock, which bound its mid-exposure.

    Attributes
    ----------
    ordered : datetime
        When the order went out: the exposure began no earlier.
    begun : datetime
        When it most likely began.
    came : datetime
        When its image was there: the exposure ended no later.
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
        """Whether this exposure can have had that mid-exposure, given how far clocks may differ."""
        slack = timedelta(seconds=tolerance_s)
        return self._earliest - slack <= middle <= self._latest + slack

    def are_after(self, middle: datetime, tolerance_s: float) -> bool:
        """Whether an image with that mid-exposure is an earlier one, taken shortly before the order."""
        before_s = (self._earliest - middle).total_seconds()
        return tolerance_s < before_s < _STALE_WITHIN_S

    def middle(self, reported: datetime | None, tolerance_s: float, by: TimeSource) -> tuple[datetime, str]:
        """Mid-exposure, and by whose clock.

        Parameters
        ----------
        reported : datetime or None
            Mid-exposure by the camera.
        tolerance_s : float
            How far that may lie outside what our clock allows.
        """
        ours = min(max(self.begun + self._half, self._earliest), self._latest)
        if reported is None:
            return ours, f"our clock ({by.silent})"
        if self.allow(reported, tolerance_s):
            return reported, by.name
        return ours, f"our clock ({by.off} {(reported - ours).total_seconds():+.1f} s off)"


def lasted_otherwise(reported_s: float | None, exposure_s: float) -> bool:
    """Whether a reported exposure time differs from the one ordered; False if none is reported."""
    return reported_s is not None and abs(reported_s - exposure_s) > _SAME_S + _SAME * exposure_s


_MARGIN = 0.1
"""Share by which a scale from focal length and pixel size may be wrong: reducers and flatteners change a
focal length by some percent. Doubled, a hint is worth less to the solver; halved, a frame behind such a lens
gets a wrong hint."""


def optics_scale_arcsec_px(
    pixel_um: float | None, binning: float, focal_length_mm: float | None
) -> float | None:
    """Scale of a binned pixel in arcseconds, or None where pixel size or focal length isn't known."""
    if not pixel_um or not focal_length_mm:
        return None
    return pixel_scale_arcsec(pixel_um * binning, focal_length_mm)


def with_scale(frame: Frame, scale: float | None, source: str) -> Frame:
    """Add a scale to a frame's hints, with a margin, where its header has none.

    Parameters
    ----------
    scale : float or None
        In arcseconds per pixel.
    source : str
        Its origin, in words.
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
