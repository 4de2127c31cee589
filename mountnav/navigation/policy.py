"""What an operator allows navigation to do: tolerances, tries, caps."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CenteringPolicy:
    """Bounds of looking, syncing and centering.

    Attributes
    ----------
    exposure_s
        Exposure of a look.
    tolerance_arcsec
        A target this near counts as centered.
    max_tries
        Looks per centering.
    timeout_s
        Wall time per centering.
    max_sync_arcsec
        A solved place further than this from the mount's belief is never synced on.
    settle_s
        Wait between the end of a slew and the next exposure.
    max_motion_arcsec
        How far the mount's reading may wander during an exposure before the look is refused
        (its resolution is added).
    max_clock_error_s
        How far mid-exposure may lie outside the two readings round it, for the camera's clock.
    sync_read_back_arcsec
        How near the reading must be to the synced place to count as seen.
    sync_read_back_s
        How long to wait for the reading to follow a sync.
    solve_retries
        Frames taken in a row before a look gives up because they don't solve.
    search_radius_deg
        How far from the mount's belief the solver searches.
    scale_arcsec_px
        The optics' scale; None leaves it to the frame's header.
    scale_tolerance
        How wrong that may be, as a fraction.
    min_altitude_deg
        Nothing is slewed to below this altitude.
    """

    exposure_s: float = 5.0
    tolerance_arcsec: float = 30.0
    max_tries: int = 5
    timeout_s: float = 300.0
    max_sync_arcsec: float = 7200.0
    settle_s: float = 1.0
    max_motion_arcsec: float = 30.0
    max_clock_error_s: float = 0.5
    sync_read_back_arcsec: float = 30.0
    sync_read_back_s: float = 2.0
    solve_retries: int = 2
    search_radius_deg: float = 2.0
    scale_arcsec_px: float | None = None
    scale_tolerance: float = 0.05
    min_altitude_deg: float = 15.0
