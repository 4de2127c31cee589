"""One pointing observation: where the tube truly looked and what the mount believed, at one instant."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime

from mountnav.devices import PierSide
from mountnav.sky.coordinates import Air, Apparent, Icrs


@dataclass(frozen=True, slots=True)
class PointingObservation:
    """A solved frame against the mount's reading, as models, doctor and drift report take it.

    Attributes
    ----------
    utc : datetime
        Mid-exposure.
    seen : Icrs
        Solved place.
    sigma_arcsec : float
        Its one-sigma error per coordinate, the mount's resolution and repeatability not included.
    reading : Apparent or Icrs
        What the mount said, moved to mid-exposure, in its own kind of coordinates.
    side : PierSide
        As the mount says, `UNKNOWN` if it doesn't.
    segment_id : str
        Readings of one segment share their zero points.
    air : Air
    rotation_deg, scale_arcsec_px : float or None
        Of the frame.
    parity : int or None
        +1 as the sky is seen, -1 mirrored.
    model_id : str or None
        Pointing model that was in force (applied before the slew; the reading is raw all the same).
    look_id : str
    from_side : (int, int)
        Sense (+1, -1, 0 unknown) of the last motion of the hour angle and the declination axis: backlash.
    """

    utc: datetime
    seen: Icrs
    sigma_arcsec: float
    reading: Apparent | Icrs
    side: PierSide = PierSide.UNKNOWN
    segment_id: str = ""
    air: Air = field(default_factory=Air)
    rotation_deg: float | None = None
    scale_arcsec_px: float | None = None
    parity: int | None = None
    model_id: str | None = None
    look_id: str = ""
    from_side: tuple[int, int] = (0, 0)
