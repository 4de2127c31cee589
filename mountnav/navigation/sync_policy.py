"""When a mount may be synced, and what a look must show for that: an operator's values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from mountnav.errors import BadSettings


class SyncRule(StrEnum):
    """How often a telescope syncs of its own accord; what is ordered by name doesn't ask for it."""

    NEVER = "never"
    """The mount keeps its own alignment; corrections are offsets."""
    FIRST_OF_NIGHT = "first-of-night"
    """Once between noon and noon of the site; from then on offsets or the pointing model."""
    PER_TARGET = "per-target"
    """Once for each target of a night."""
    WHEN_OFF_BY = "when-off-by"
    """Whenever the tube looks further from where the mount believes than `off_by_arcsec`."""
    ALWAYS = "always"
    """On each look that is thought of, however small the offset."""


@dataclass(frozen=True, slots=True)
class SyncPolicy:
    """All knobs of a guarded sync.

    Attributes
    ----------
    off_by_arcsec : float
        Of `WHEN_OFF_BY`; the mount's resolution, if that is more.
    max_arcsec : float
        Cap on the size: a place solved further from the mount's belief is never synced on but in a recovery.
    max_per_night, max_per_target : int or None
        Caps on the number; None sets none. Ordered syncs are counted and not capped.
    same_target_deg : float
        A target without a name is the same one as another that is so near.
    min_meridian_deg : float
        Hour angle from the meridian below which nothing is synced (a German mount may take a sync there for
        the other side of the pier); 0 doesn't ask.
    min_pole_deg : float
        Distance from the pole below which nothing is synced, on no occasion: a frame there doesn't show the
        hour angle axis.
    max_turn_arcsec : float
        How much more than the offset that is seen a sync may turn the hour angle: east / cos δ - east.
    min_altitude_deg : float
        Observed altitude of the solved place below which nothing is synced.
    max_age_s : float
        From the end of the exposure to the sync.
    max_motion_arcsec : float
        How far the reading may wander during the exposure, and from the frame to the sync (the mount's
        resolution is added).
    max_false_probability : float
        Odds: chance that a wrong place would have looked as good.
    min_pairs : int
        Stars.
    scale_tolerance : float
        How far the scale may be from its running median, as a fraction.
    rotation_tolerance_deg : float
        How far the camera's angle to the axes may be from its running median.
    polar_error_deg : float
        How far the mount's pole may be from the sky's. Adds polar_error / cos δ to the rotation's tolerance.
    expected_sigmas : float
        How many sigma an offset may be from the one that is expected.
    expected_floor_arcsec : float
        Added to that, with a pointing model.
    expected_floor_bare_arcsec : float
        Added to that, without one: a portable mount's pole may be a degree off.
    read_back_arcsec : float
        How near the reading must be to the synced place to count as seen.
    read_back_s : float
        How long a sync may take to show before it counts as ignored.
    confirm : bool
        Whether a second look must agree before a sync that nothing known can judge: the first ones of a night
        or a segment.
    confirm_above_arcsec : float
        How far off a look must be for that.
    verify : bool
        Whether a second look must confirm each sync that was sent on the first; else it is undone.
    verify_arcsec : float
        How near solved place and reading must be in that look (the mount's resolution is added).
    told_max_arcsec : float
        Cap on the size of a sync on given coordinates, which nobody has seen; 0 allows none.

    Raises
    ------
    BadSettings
        A value makes no sense.
    """

    rule: SyncRule = SyncRule.WHEN_OFF_BY
    off_by_arcsec: float = 10.0
    max_arcsec: float = 7200.0
    max_per_night: int | None = 500
    max_per_target: int | None = None
    same_target_deg: float = 1.0
    min_meridian_deg: float = 0.0
    min_pole_deg: float = 5.0
    max_turn_arcsec: float = 1800.0
    min_altitude_deg: float = 5.0
    max_age_s: float = 120.0
    max_motion_arcsec: float = 30.0
    max_false_probability: float = 1e-9
    min_pairs: int = 4
    scale_tolerance: float = 0.02
    rotation_tolerance_deg: float = 5.0
    polar_error_deg: float = 1.0
    expected_sigmas: float = 5.0
    expected_floor_arcsec: float = 120.0
    expected_floor_bare_arcsec: float = 600.0
    read_back_arcsec: float = 30.0
    read_back_s: float = 8.0
    confirm: bool = True
    confirm_above_arcsec: float = 120.0
    verify: bool = False
    verify_arcsec: float = 30.0
    told_max_arcsec: float = 7200.0

    def __post_init__(self) -> None:
        for name in ("max_arcsec", "max_age_s", "scale_tolerance", "rotation_tolerance_deg", "verify_arcsec"):
            value = getattr(self, name)
            if not value > 0.0:
                raise BadSettings(f"sync policy: {name} = {value} is not positive", advice=f"set {name} > 0")
        for name in ("max_per_night", "max_per_target"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise BadSettings(
                    f"sync policy: {name} = {value} allows no sync", advice='set rule = "never" for that'
                )


__all__ = ["SyncPolicy", "SyncRule"]
