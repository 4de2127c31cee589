"""What an operator allows navigation to do: tolerances, tries, caps, tactics for frames that do not solve.

The tactics are a table: by what the verdict says was wrong.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType

from mountnav.errors import BadSettings
from mountnav.measuring.measurements import StarImages
from mountnav.solution import Reason, Verdict

__all__ = [
    "CHEAP",
    "TACTICS",
    "Approach",
    "CenteringPolicy",
    "CorrectBy",
    "Persistence",
    "Tactic",
    "Trouble",
    "next_tactic",
    "trouble_of",
    "wait_s",
]


class Tactic(StrEnum):
    """One thing to try."""

    ANOTHER_FRAME = "another-frame"
    """The same again: a satellite, a gust, a cosmic ray are gone."""
    LONGER = "longer-exposure"
    SHORTER = "shorter-exposure"
    """Trailed stars: less time to trail in."""
    WIDER = "wider-search"
    """The place may be further off than the search reached; the scale may be wrong."""
    BLIND = "blind"
    """The whole sky, whatever the mount believes. What it brings is doubted as ever before it is used."""
    NEIGHBOR = "neighbor-field"
    """A small checked slew to where there may be more stars; and back."""
    WAIT = "wait"
    """For the cloud to pass; each time longer."""


class Trouble(StrEnum):
    """What is wrong with an unsolved frame."""

    CLOUD = "cloud or dew"
    DEFOCUS = "out of focus"
    TRAILED = "trailed"
    FEW_STARS = "too few stars"
    POOR_FIELD = "field too poor for the catalogs"
    WRONG_PLACE = "no match where it was sought"
    CHANCE = "could be chance"
    HINTS = "the hints contradict each other"
    NO_PLACE = "nothing to search by"
    BAD_FRAME = "no usable image"
    TIME = "out of time"


_OF_REASON: Mapping[Reason, Trouble] = MappingProxyType(
    {
        Reason.TOO_FEW_MEASUREMENTS: Trouble.FEW_STARS,
        Reason.NO_MATCH: Trouble.WRONG_PLACE,
        Reason.CHANCE: Trouble.CHANCE,
        Reason.CLOUD_OR_DEFOCUS: Trouble.CLOUD,
        Reason.TRAILED: Trouble.TRAILED,
        Reason.HINT_CONTRADICTS: Trouble.HINTS,
        Reason.CATALOG_TOO_SHALLOW: Trouble.POOR_FIELD,
        Reason.OTHER_CATALOG: Trouble.POOR_FIELD,
        Reason.NO_HINT: Trouble.NO_PLACE,
        Reason.BAD_FRAME: Trouble.BAD_FRAME,
        Reason.TIMED_OUT: Trouble.TIME,
    }
)

_T = Tactic
TACTICS: Mapping[Trouble, tuple[Tactic, ...]] = MappingProxyType(
    {
        Trouble.CLOUD: (_T.ANOTHER_FRAME, _T.LONGER, *(_T.WAIT,) * 20),
        Trouble.DEFOCUS: (_T.ANOTHER_FRAME, _T.LONGER, _T.LONGER),
        Trouble.TRAILED: (_T.ANOTHER_FRAME, _T.SHORTER, _T.SHORTER),
        Trouble.FEW_STARS: (_T.LONGER, _T.LONGER, _T.NEIGHBOR, *(_T.WAIT,) * 20),
        Trouble.POOR_FIELD: (_T.LONGER, _T.LONGER, _T.NEIGHBOR, _T.NEIGHBOR),
        Trouble.WRONG_PLACE: (_T.ANOTHER_FRAME, _T.WIDER, _T.LONGER, _T.BLIND, _T.NEIGHBOR),
        Trouble.CHANCE: (_T.LONGER, _T.ANOTHER_FRAME, _T.WIDER, _T.NEIGHBOR, _T.BLIND),
        Trouble.HINTS: (_T.WIDER, _T.BLIND),
        Trouble.NO_PLACE: (_T.BLIND,),
        Trouble.BAD_FRAME: (_T.ANOTHER_FRAME, _T.ANOTHER_FRAME),
        Trouble.TIME: (_T.ANOTHER_FRAME, _T.LONGER),
    }
)
"""What is tried, in this order, for each trouble; one that stands n times may be used n times in a look."""

CHEAP = frozenset({Tactic.ANOTHER_FRAME, Tactic.LONGER, Tactic.SHORTER})
"""What a plain look may do unasked: nothing moves, and nobody waits long."""


@dataclass(frozen=True, slots=True)
class Persistence:
    """How much is tried when frames don't solve.

    Attributes
    ----------
    tactics : frozenset of Tactic
        Those that are allowed.
    max_frames : int
        Frames per look, the first one included.
    max_s : float
        Time per look, waiting included; a centering's own time bounds it too.
    longest_exposure_s : float
        Exposures are not made longer than this (a longer one that was asked for stays as it is).
    longer_by : float
        Factor of each longer (or shorter) exposure.
    wider_by : float
        Factor of the radius that is searched.
    neighbor_fields : float
        How far away a neighbor field is, in widths of a frame.
    neighbor_deg : float
        The same where the frame's width isn't known.
    first_wait_s, longest_wait_s : float
        The first wait for a cloud; each further one is twice as long, up to the longest.
    """

    tactics: frozenset[Tactic] = frozenset(Tactic)
    max_frames: int = 12
    max_s: float = 600.0
    longest_exposure_s: float = 60.0
    longer_by: float = 3.0
    wider_by: float = 3.0
    neighbor_fields: float = 1.5
    neighbor_deg: float = 1.0
    first_wait_s: float = 20.0
    longest_wait_s: float = 180.0

    def __post_init__(self) -> None:
        if self.max_frames < 1:
            raise BadSettings(f"max_frames = {self.max_frames} allows no look", advice="set max_frames >= 1")
        for name in ("longer_by", "wider_by"):
            value = getattr(self, name)
            if not value > 1.0:
                raise BadSettings(f"{name} = {value} has no effect", advice=f"set {name} > 1")


def trouble_of(verdict: Verdict) -> Trouble:
    """What is wrong, by the verdict's reason and by what the stars look like.

    Raises
    ------
    ValueError
        The verdict is a solved one.
    """
    if verdict.reason is None:
        raise ValueError("a solved frame has no trouble")
    trouble = _OF_REASON[verdict.reason]
    images = None if verdict.quality is None else verdict.quality.images
    if images is StarImages.TRAILED and trouble is not Trouble.NO_PLACE:
        return Trouble.TRAILED
    if images is StarImages.DEFOCUSED and trouble in (Trouble.CLOUD, Trouble.FEW_STARS, Trouble.WRONG_PLACE):
        return Trouble.DEFOCUS
    return trouble


def next_tactic(trouble: Trouble, used: Counter[Tactic], allowed: frozenset[Tactic]) -> Tactic | None:
    """The first of the trouble's tactics that is allowed and not used up.

    Parameters
    ----------
    trouble : Trouble
        Of the latest frame.
    used : Counter of Tactic
        How often each was used in this look, whatever the trouble was then.

    Returns
    -------
    Tactic or None
        None when nothing is left to try.
    """
    row = TACTICS[trouble]
    for tactic in row:
        if tactic in allowed and used[tactic] < row.count(tactic):
            return tactic
    return None


def wait_s(persistence: Persistence, waited: int) -> float:
    """How long the next wait is, after so many."""
    return min(persistence.first_wait_s * 2.0 ** min(waited, 30), persistence.longest_wait_s)


class CorrectBy(StrEnum):
    """How a telescope that looks beside its target is brought there."""

    SYNC = "sync"
    """The mount is synced and slewed again; by offset where a sync is not allowed or no use."""
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
        Frames taken again because the mount moved during one, or it was of another time, before the look is
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
