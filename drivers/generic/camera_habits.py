"""What the configuration says of a camera of any protocol."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposingHabits:
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
