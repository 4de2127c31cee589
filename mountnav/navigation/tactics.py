"""What is tried next when a frame could not be identified: a table, by what the verdict says was wrong.

Everything in it is bounded in number, and all of it together in frames and time. The sky's troubles are told
apart by the verdict alone; nothing here moves or exposes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from mountnav.errors import BadSettings
from mountnav.measuring.quality import StarImages
from mountnav.solution import Reason, Verdict


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
                raise BadSettings(f"{name} = {value} changes nothing", advice=f"set {name} > 1")


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
    allowed : frozenset of Tactic

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


__all__ = [
    "CHEAP",
    "TACTICS",
    "Persistence",
    "Tactic",
    "Trouble",
    "next_tactic",
    "trouble_of",
    "wait_s",
]
