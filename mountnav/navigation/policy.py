"""What an operator allows navigation to do: tolerances, tries, caps."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from mountnav.errors import BadSettings
from mountnav.navigation.tactics import Persistence


class CorrectBy(StrEnum):
    """How a telescope that looks beside its target is brought there."""

    SYNC = "sync"
    """The mount is told where it points, and sent again; by offset where a sync is not allowed or no use."""
    OFFSET = "offset"
    """The mount is sent beside the target by the error that was seen; its belief stays as it is."""
    MODEL = "model"
    """As offset, and the pointing model with its zero points aims first; nothing is synced."""


class Approach(StrEnum):
    """Whether the last leg of a slew always comes from the same side, so that backlash lies on one side."""

    NEVER = "never"
    WHEN_NEEDED = "when-needed"
    """From the first correction on that the tube did not follow."""
    ALWAYS = "always"


@dataclass(frozen=True, slots=True)
class CenteringPolicy:
    """Bounds of looking, syncing and centering.

    Attributes
    ----------
    exposure_s
        Exposure of a look.
    tolerance_arcsec
        A target this near counts as centered; never taken for less than what the mount's steps allow.
    max_tries
        Looks per centering.
    timeout_s
        Time per centering, all waiting included.
    max_sync_arcsec
        A solved place further than this from the mount's belief is never synced on, nor moved by.
    settle_s
        Wait between the end of a slew and the next exposure.
    max_motion_arcsec
        How far the mount's reading may wander during an exposure before the look is refused
        (its resolution is added).
    max_clock_error_s
        How far the exposure may lie outside the two readings round it, for the camera's clock.
    sync_read_back_arcsec, sync_read_back_s
        Kept for callers that set them; they go before those of the sync policy when no other is given.
    solve_retries
        Frames taken in a row before a plain look gives up because they don't solve.
    search_radius_deg
        How far from the mount's belief the solver searches.
    scale_arcsec_px
        The optics' scale; None leaves it to the frame's header.
    scale_tolerance
        How wrong that may be, as a fraction.
    min_altitude_deg
        Nothing is slewed to below this altitude, where no limits are given.
    correct_by
        How a target is brought to the frame's center.
    approach
        Whether the last leg comes from the same side.
    approach_arcsec
        Length of that leg, along both axes.
    pole_deg
        Nearer to the pole than this nothing is synced in a centering: a polar axis that is wrong by some
        arcminutes would put the hour angle of the whole sky wrong by degrees.
    moved_retries
        Frames taken anew because the mount moved during one, or it was of another time, before the look is
        given up.
    persistence
        What is tried when frames don't solve, and for how long.
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
    correct_by: CorrectBy = CorrectBy.SYNC
    approach: Approach = Approach.WHEN_NEEDED
    approach_arcsec: float = 300.0
    pole_deg: float = 4.0
    moved_retries: int = 2
    persistence: Persistence = field(default_factory=Persistence)

    def __post_init__(self) -> None:
        for name in ("exposure_s", "tolerance_arcsec", "timeout_s", "max_sync_arcsec", "approach_arcsec"):
            value = getattr(self, name)
            if not value > 0.0:
                raise BadSettings(f"centering: {name} = {value} is not positive", advice=f"set {name} > 0")
        if self.max_tries < 1:
            raise BadSettings(
                f"centering: max_tries = {self.max_tries} allows no look", advice="set max_tries >= 1"
            )


__all__ = ["Approach", "CenteringPolicy", "CorrectBy", "Persistence"]
