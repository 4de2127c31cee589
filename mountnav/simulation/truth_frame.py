"""Frames without pixels: a real `Frame` whose header carries the truth of mid-exposure, to be fast."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.frames import Frame
from mountnav.sky.coordinates import Icrs

_KEYS = ("SIMRA", "SIMDEC", "SIMROT", "SIMTRAIL", "SIMNUM")


@dataclass(frozen=True, slots=True)
class FrameTruth:
    """What a frame without pixels stands for.

    Attributes
    ----------
    center : Icrs
        Where the optical axis truly looked at mid-exposure.
    rotation_deg : float
        Position angle of the image's +y axis.
    trail_arcsec : float
        How far the tube moved over the sky during the exposure.
    number : int
        Of the frame, by its camera.
    trail_angle_deg : float
        Position angle of that way.
    """

    center: Icrs
    rotation_deg: float
    trail_arcsec: float
    number: int
    trail_angle_deg: float = 0.0

    def frame(
        self, width_px: int, height_px: int, exposure_s: float, mid_exposure_utc: datetime, source: str
    ) -> Frame:
        """A frame that carries this truth and holds no memory."""
        return Frame(
            _nothing(width_px, height_px, self.number),
            mid_exposure_utc=mid_exposure_utc,
            exposure_s=exposure_s,
            source=source,
            header={
                "SIMRA": self.center.ra_deg,
                "SIMDEC": self.center.dec_deg,
                "SIMROT": self.rotation_deg,
                "SIMTRAIL": self.trail_arcsec,
                "SIMNUM": self.number,
                "SIMTRPA": self.trail_angle_deg,
            },
        )


def truth_of(frame: Frame) -> FrameTruth:
    """Read the truth that a frame carries.

    Raises
    ------
    BadFrame
        When it carries none: it has pixels, to be solved by looking at them.
    """
    try:
        ra_deg, dec_deg, rotation_deg, trail_arcsec, number = (float(frame.header[key]) for key in _KEYS)
    except KeyError as cause:
        raise BadFrame(f"{frame.source}: carries no truth ({cause})") from cause
    angle = frame.header.get("SIMTRPA", 0.0)
    angle_deg = float(angle) if isinstance(angle, int | float) else 0.0
    return FrameTruth(Icrs(ra_deg, dec_deg), rotation_deg, trail_arcsec, int(number), angle_deg)


def _nothing(width_px: int, height_px: int, number: int) -> NDArray[np.uint16]:
    """Pixels without stars in the memory of one row; like noise, they are others for each exposure."""
    row = np.zeros((1, width_px), dtype=np.uint16)
    row[0, :4] = (1, number & 0xFFFF, (number >> 16) & 0xFFFF, (number >> 32) & 0xFFFF)
    return np.broadcast_to(row, (height_px, width_px))
