"""What a centering answers: each try with its numbers, the error before and after, expected and achieved."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from mountnav.devices import PierSide, SyncOutcome
from mountnav.errors import LimitKind
from mountnav.sky.coordinates import Icrs


class CenterOutcome(StrEnum):
    """How a centering ended."""

    CENTERED = "centered"


class Correction(StrEnum):
    """What was done about a look of a centering."""

    NONE = "none"
    SYNC = "sync"
    OFFSET = "offset"
    MODEL = "model"


@dataclass(frozen=True, slots=True)
class Try:
    """One look of a centering and what was done about it.

    Attributes
    ----------
    number : int
    seen : Icrs
        Where the tube looked.
    error_arcsec, east_arcsec, north_arcsec : float
        Of the seen place from the target: before this try's correction.
    pairs, rms_arcsec, false_probability : int, float, float
        Of the solution.
    synced : bool
        Whether a sync was seen.
    sync_outcome : SyncOutcome or None
        None when no sync was sent.
    slewed : bool
    elapsed_s : float
    after_arcsec : float or None
        The error that the next look found; None when there was none.
    expected_arcsec : float or None
        How far off the tube was expected to look in this look, one sigma; None if nobody could tell.
    sigma_arcsec : float
        Of `error_arcsec`: the solve's, and what the mount moved during the exposure.
    correction : Correction
    why : str
        What was decided, and by what numbers; for the last try, why it stopped.
    followed : str
        Whether the tube did what the try before asked.
    approached : bool
        Whether the slew ended with a leg from the fixed side.
    look_id : str
    """

    number: int
    seen: Icrs
    error_arcsec: float
    east_arcsec: float
    north_arcsec: float
    pairs: int
    rms_arcsec: float
    false_probability: float
    synced: bool
    sync_outcome: SyncOutcome | None
    slewed: bool
    elapsed_s: float
    after_arcsec: float | None = None
    expected_arcsec: float | None = None
    sigma_arcsec: float = 0.0
    correction: Correction = Correction.NONE
    why: str = ""
    followed: str = ""
    approached: bool = False
    look_id: str = ""


@dataclass(frozen=True, slots=True)
class Crossing:
    """A limit that a target will reach while it is tracked.

    Attributes
    ----------
    utc : datetime
    limit : LimitKind
    words : str
    """

    utc: datetime
    limit: LimitKind
    words: str


@dataclass(frozen=True, slots=True)
class CenterReport:
    """A centering: the target, each try, error before and after.

    `error_before_arcsec` is the distance of target and solved place after the first slew,
    `error_after_arcsec` after the last one, `error_sigma_arcsec` its one-sigma.

    Attributes
    ----------
    tolerance_arcsec : float
        The one that was kept.
    tolerance_asked_arcsec : float
        The one that was asked for; smaller where the mount's steps don't allow it.
    expected_error_arcsec : float or None
        Before anything moved: how far off the tube was expected to look after the first slew, one sigma, from
        the pointing model (or what a sync is worth at that distance) and the mount's steps.
    side : PierSide
        As the mount says, at the end.
    side_seen : PierSide
        By the solved rotation; unknown until enough was learned of the camera.
    flipped : bool
        Whether a slew of this centering changed sides.
    crossing : Crossing or None
        The first limit that tracking reaches within the planned time.
    model_id : str or None
        The pointing model that aimed.
    notes : tuple of str
        What an operator should know, in words with numbers.
    """

    outcome: CenterOutcome
    target: Icrs
    tries: tuple[Try, ...]
    error_before_arcsec: float
    error_after_arcsec: float
    error_sigma_arcsec: float
    tolerance_arcsec: float
    elapsed_s: float
    tolerance_asked_arcsec: float = 0.0
    expected_error_arcsec: float | None = None
    side: PierSide = PierSide.UNKNOWN
    side_seen: PierSide = PierSide.UNKNOWN
    flipped: bool = False
    crossing: Crossing | None = None
    model_id: str | None = None
    notes: tuple[str, ...] = ()


__all__ = ["CenterOutcome", "CenterReport", "Correction", "Crossing", "Try"]
