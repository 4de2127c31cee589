"""What can be set about measuring; the defaults serve every frame we have tried."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MeasuringSettings:
    """How a frame is measured.

    Attributes
    ----------
    threshold_sigma : float
        Height of a source in the smoothed frame, in units of its local noise.
    max_sources : int
        No more than so many sources, the brightest, are returned.
    box_px : int or None
        Side of the background's mesh cells; None: by the frame's size.
    detection_sigma_px : float
        Width of the first smoothing; a second one follows the stars' own width if that is much larger.
    bin_above_px : int
        Frames of more pixels are searched in 2 × 2 bins; the profile fit always sees the full frame.
    gain_e_adu : float or None
        Electrons per ADU, for the weights and errors; None: the header's EGAIN, or guessed from the noise.
    """

    threshold_sigma: float = 5.0
    max_sources: int = 1500
    box_px: int | None = None
    detection_sigma_px: float = 1.2
    bin_above_px: int = 3_000_000
    gain_e_adu: float | None = None
