"""What a night knows between two events; values only."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from mountnav.sky.sphere import Offset

NO_OFFSET = Offset(0.0, 0.0)


class Phase(StrEnum):
    """Where a night stands."""

    WAITING = "waiting"
    """For darkness, or for an order to start."""
    CALIBRATING = "calibrating"
    """The frames that open the session are identified fully and compared."""
    FOLLOWING = "following"
    STOPPED = "stopped"
    """By an operator, until he starts it again or the next night begins."""


class Hold(StrEnum):
    """Why nothing is corrected, though the night goes on; frames are still measured."""

    OPERATOR = "paused by an operator"
    UNSAFE = "not safe"
    MOUNT = "the mount can't be reached"
    CLOUD = "cloud"


@dataclass(frozen=True, slots=True)
class PlateSeen:
    """What a fully identified frame shows of telescope and camera.

    Attributes
    ----------
    scale_arcsec_px, rotation_deg : float
    parity : int
    size : (int, int)
        Width and height, pixels: another binning is another plate.
    """

    scale_arcsec_px: float
    rotation_deg: float
    parity: int
    size: tuple[int, int] = (0, 0)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Frames in a row that say the same about what the mount is off.

    Attributes
    ----------
    frame_ids : tuple of str
        Oldest first.
    utc : datetime
        Mid-exposure of the last.
    error : Offset
        What it said: seen minus wanted.
    segment, field : str
    """

    frame_ids: tuple[str, ...]
    utc: datetime
    error: Offset
    segment: str
    field: str


@dataclass(frozen=True, slots=True)
class NightState:
    """A night between two events.

    Attributes
    ----------
    phase : Phase
    night_id : str
    forced : bool
        Begun by an operator, whatever the Sun says.
    was_dark : bool
    plates : tuple of PlateSeen
        Of the calibration frames so far; of a finished calibration those that agreed.
    plate : PlateSeen or None
        What they agreed on.
    holds : frozenset of Hold
    unsafe : tuple of (str, str)
        Who says that it isn't safe, and why, one entry each, sorted: it is safe when nobody says so.
    safe_for_s : float or None
        How long the last "safe" of a monitor holds that says for how long: one that is not heard of again
        means not safe. None if nobody says so.
    safe_until : datetime or None
        Until when that is.
    evidence : Evidence or None
    field, segment : str
        Of the last frame that was placed.
    applied : Offset
        What offsets have put between seen and believed in this field and segment; it is meant to be there.
    under_way : str or None
        Frame whose correction has been decided on and whose outcome isn't known.
    used : tuple of str
        Frames that a correction was decided on by, newest last.
    corrections : tuple of datetime
        When they were decided on, within the last hour.
    corrected : int
        Tonight, whatever came of them.
    not_before : datetime or None
        Frames must have begun after this to count for a correction.
    busy_until : datetime or None
        The scheduler exposes until then, it says.
    free : bool
        The scheduler says it doesn't expose, until it says otherwise.
    frames, placed, unsolved : int
        Tonight; unsolved: in a row.
    """

    phase: Phase = Phase.WAITING
    night_id: str = ""
    forced: bool = False
    was_dark: bool = False
    plates: tuple[PlateSeen, ...] = ()
    plate: PlateSeen | None = None
    holds: frozenset[Hold] = frozenset()
    unsafe: tuple[tuple[str, str], ...] = ()
    safe_for_s: float | None = None
    safe_until: datetime | None = None
    evidence: Evidence | None = None
    field: str = ""
    segment: str = ""
    applied: Offset = NO_OFFSET
    under_way: str | None = None
    used: tuple[str, ...] = ()
    corrections: tuple[datetime, ...] = ()
    corrected: int = 0
    not_before: datetime | None = None
    busy_until: datetime | None = None
    free: bool = False
    frames: int = 0
    placed: int = 0
    unsolved: int = 0

    @property
    def unsafe_why(self) -> str:
        """Why it isn't safe, in the words of all who say so."""
        return "; ".join(dict.fromkeys(why for _, why in self.unsafe if why))

    @property
    def running(self) -> bool:
        """Whether frames are taken."""
        return self.phase in (Phase.CALIBRATING, Phase.FOLLOWING)
