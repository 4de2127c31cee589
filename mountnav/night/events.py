"""What a night knows, what can happen in it, and what is decided then; values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
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
    forced : bool
        Begun by an operator, whatever the Sun says.
    plates : tuple of PlateSeen
        Of the calibration frames so far; of a finished calibration those that agreed.
    plate : PlateSeen or None
        What they agreed on.
    unsafe : tuple of (str, str)
        Who says that it isn't safe, and why, one entry each, sorted: it is safe when nobody says so.
    safe_for_s : float or None
        How long the last "safe" of a monitor holds that says for how long: one that is not heard of again
        means not safe. None if nobody says so.
    safe_until : datetime or None
        Until when that is.
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


@dataclass(frozen=True, slots=True)
class Tick:
    """Time passes.

    Attributes
    ----------
    night_id : str
        The night that this instant belongs to.
    """

    utc: datetime
    sun_altitude_deg: float
    night_id: str


class Word(StrEnum):
    """What people, schedulers and sensors report to a night, or order."""

    START = "start"
    STOP = "stop"
    PAUSE = "pause"
    RESUME = "resume"
    BUSY = "busy"
    FREE = "free"
    SAFE = "safe"
    UNSAFE = "unsafe"
    MOUNT_LOST = "mount lost"
    MOUNT_BACK = "mount back"
    RESTARTED = "restarted"


@dataclass(frozen=True, slots=True)
class Said:
    """A report or an order that came to the night: from people, the scheduler, sensors.

    Attributes
    ----------
    why : str
        In the sayer's words.
    until : datetime or None
        Of `BUSY`: when the exposure will be over.
    night_id : str
        Of `START`.
    by : str
        Of `SAFE` and `UNSAFE`: who says so; what one says takes back nothing of another.
    """

    utc: datetime
    word: Word
    why: str = ""
    until: datetime | None = None
    night_id: str = ""
    by: str = ""


@dataclass(frozen=True, slots=True)
class FrameSeen:
    """A frame was looked at.

    Attributes
    ----------
    utc : datetime
        Now.
    mid_utc, begun_utc : datetime or None
        Of the exposure; None where the frame doesn't say.
    held : bool
        The sender waits for the answer and exposes nothing meanwhile.
    fully : bool
        Identified fully, not by its shift.
    error : Offset or None
        Seen minus believed, or minus the target where the sender gave one; None if it isn't known.
    of_target : bool
        `error` is against a target that the sender gave.
    sigma_arcsec : float
        One-sigma of it per coordinate.
    doubts : tuple of str
        Why it must not be used for a correction.
    moving : bool
        Whether the mount moves now, or something else holds the telescope.
    detail : str
        Why it wasn't placed.
    """

    utc: datetime
    frame_id: str
    arrived_utc: datetime
    mid_utc: datetime | None = None
    begun_utc: datetime | None = None
    held: bool = False
    placed: bool = False
    fully: bool = False
    plate: PlateSeen | None = None
    error: Offset | None = None
    of_target: bool = False
    sigma_arcsec: float = 0.0
    doubts: tuple[str, ...] = ()
    moving: bool = False
    field: str = ""
    segment: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class CorrectionEnded:
    """What came of a correction.

    Attributes
    ----------
    outcome : str
        "done", "refused", "failed", "cancelled", "unknown".
    meant : Offset or None
        Seen minus believed that is meant to be there from now on, since the tube was moved beside what the
        mount believes; None for a sync.
    doubts : tuple of str
        Of a refused one: what stood against it.
    """

    utc: datetime
    frame_id: str
    outcome: str
    meant: Offset | None = None
    doubts: tuple[str, ...] = ()


Event = Tick | Said | FrameSeen | CorrectionEnded


class Act(StrEnum):
    """What a night does."""

    BEGIN = "begin"
    END = "end"
    PARK = "park"
    HALT = "halt"
    """Corrections under way are ended, and what they move is stopped."""
    PAUSE = "pause"
    GO_ON = "go on"
    CALIBRATED = "calibrated"
    CORRECT = "correct"
    LEAVE = "leave"
    """Nothing is corrected by this frame."""


class Why(StrEnum):
    """For what reason; of `LEAVE` each says what stands against a correction."""

    DARK = "it is dark"
    DAYLIGHT = "daylight"
    ORDERED = "ordered"
    RESTARTED = "the service was restarted"
    UNSAFE = "not safe"
    SAFE = "safe again"
    CLOUD = "cloud"
    CLEAR = "clear again"
    MOUNT_LOST = "the mount can't be reached"
    MOUNT_BACK = "the mount is back"
    PLATES_AGREE = "the first frames agree"
    NOT_RUNNING = "no night is running"
    PAUSED = "paused"
    NOT_PLACED = "not identified"
    NO_READING = "what the mount believed is not known"
    CALIBRATING = "the first frames are still compared"
    PLATE_DIFFERS = "scale, rotation or parity are not those of this session"
    DOUBTED = "the frame must not be used"
    ONLY_MEASURED = "nothing is to be corrected"
    NOT_OFF_ENOUGH = "not off enough"
    TOO_FAR_OFF = "too far off to be believed"
    ALONE = "one frame alone"
    USED = "a correction was decided on by this frame before"
    OLDER_THAN_CORRECTION = "begun before the last correction had settled"
    UNDER_WAY = "a correction is under way"
    MOVING = "the mount moves"
    EXPOSING = "the scheduler exposes"
    NOT_QUIET = "the next exposure may have begun"
    ENOUGH_THIS_HOUR = "enough corrections in this hour"
    ENOUGH_TONIGHT = "enough corrections tonight"
    OFF = "off, and frames agree"


@dataclass(frozen=True, slots=True)
class Decision:
    """What was decided.

    Attributes
    ----------
    text : str
        With the numbers.
    error : Offset or None
        Of `CORRECT`: what the telescope is off.
    facts : mapping
        JSON values.
    """

    act: Act
    why: Why
    text: str = ""
    frame_id: str = ""
    error: Offset | None = None
    facts: Mapping[str, object] = field(default_factory=dict)
