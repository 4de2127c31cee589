"""What navigation answers about a look, a slew, a sync, ...: absolute values, never only "how far off"."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from mountnav.devices import MountReading, PierSide, SlewOutcome, SyncOutcome, from_mount
from mountnav.ephemeris import SkyRates
from mountnav.errors import LimitKind, SyncDoubt
from mountnav.frames import Frame
from mountnav.measuring.measurements import StarImages
from mountnav.navigation.reading_history import Meanwhile
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset, separation_arcsec
from mountnav.solution import Solution, Verdict

__all__ = [
    "OUTSIDE",
    "CameraIdentity",
    "CenterOutcome",
    "CenterReport",
    "CoordinateSyncReport",
    "Corrected",
    "Correction",
    "Crossing",
    "FirstLightReport",
    "FrameLook",
    "Listener",
    "Look",
    "PointSeen",
    "RecoverReport",
    "Rotation",
    "SlewReport",
    "SyncReport",
    "TelescopeState",
    "Try",
    "Turn",
    "angle_words",
    "camera_of",
    "finite_or_none",
]

Listener = Callable[[str, dict[str, object]], None]
"""Called with each step of what navigation does: ``listener(kind, data)``. It never steers."""


OUTSIDE = "a camera from outside"
"""Name of the camera of a frame from outside that names none."""


@dataclass(frozen=True, slots=True)
class CameraIdentity:
    """A camera as its frames show it: by name, size and binning.

    Attributes
    ----------
    name : str
        As the frame's header says, or the camera that was asked for it.
    width_px, height_px : int
        Of its frames; a region read out alone is another camera, since its middle is another place.
    binning : str
        As "2x2"; empty where the header doesn't say.
    """

    name: str
    width_px: int
    height_px: int
    binning: str = ""

    def __str__(self) -> str:
        """For messages and the journal; also its key there."""
        binned = f" binned {self.binning}" if self.binning else ""
        return f"{self.name} {self.width_px}×{self.height_px}{binned}"


def camera_of(frame: Frame, asked: str | None = None) -> CameraIdentity:
    """The camera of a frame.

    Parameters
    ----------
    asked : str, optional
        Name of the camera that was asked for it; None: it came from outside.
    """
    told = frame.header.get("INSTRUME")
    name = str(told).strip() if isinstance(told, str) and told.strip() else asked or OUTSIDE
    across, down = (_count(frame.header.get(key)) for key in ("XBINNING", "YBINNING"))
    across, down = across or down, down or across
    binning = f"{across}x{down}" if across and down else ""
    return CameraIdentity(name, frame.width_px, frame.height_px, binning)


def _count(value: object) -> int:
    return int(value) if isinstance(value, int | float) and 0 < value < 100 else 0


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
    after_arcsec : float or None
        The error that the next look found; None when there was none.
    expected_arcsec : float or None
        How far off the tube was expected to look in this look, one sigma; None if that wasn't known.
    sigma_arcsec : float
        Of `error_arcsec`: the look's (`Look.sigma_arcsec`), and what the mount moved during the exposure.
    why : str
        What was decided, and by what numbers; for the last try, why it stopped.
    followed : str
        Whether the tube did what the try before asked.
    approached : bool
        Whether the slew ended with a leg from the fixed side.
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
    """A limit that a target will reach while it is tracked."""

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
    at : PointSeen or None
        Where the point looked to which the target was brought; None: the frame's middle.
    rotation_deg : float or None
        Of the last frame: position angle of its +y.
    last : Look or None
        The last look.
    rotation : Rotation or None
        What came of the position angle that was asked for.
    target_name : str
        Of a target that moves; empty of a fixed one.
    target_utc : datetime or None
        Of a target that moves: when it was at `target`, the middle of the last exposure.
    target_sigma_arcsec : float
        How uncertain its place is, one sigma.
    target_rates : SkyRates or None
        How fast it moves.
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
    at: PointSeen | None = None
    rotation_deg: float | None = None
    last: Look | None = None
    rotation: Rotation | None = None
    target_name: str = ""
    target_utc: datetime | None = None
    target_sigma_arcsec: float = 0.0
    target_rates: SkyRates | None = None


@dataclass(frozen=True, slots=True)
class Turn:
    """One turn of a rotator that was made.

    Attributes
    ----------
    from_deg, to_deg : float
        Its count before, and where it was sent; between the cable limits.
    came_deg : float
        Its count afterwards.
    """

    from_deg: float
    to_deg: float
    came_deg: float
    elapsed_s: float

    @property
    def by_deg(self) -> float:
        """How far it turned, by its count."""
        return self.came_deg - self.from_deg


@dataclass(frozen=True, slots=True)
class Rotation:
    """A field that was brought to a position angle.

    Attributes
    ----------
    wanted_deg, before_deg, after_deg : float
        Position angles: as ordered, and as solves showed it before and afterwards.
    off_deg : float
        What is left, within the tolerance.
    turns : tuple of Turn
        By the rotator's count.
    sense : int or None
        Whether position angles grow with the rotator's count; None while that isn't known.
    notes : tuple of str
        What an operator should know.
    """

    wanted_deg: float
    before_deg: float
    after_deg: float
    off_deg: float
    tolerance_deg: float
    turns: tuple[Turn, ...] = ()
    sense: int | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PointSeen:
    """Where a point beside the frame's middle looked.

    Attributes
    ----------
    name : str
        Empty for one that was named by its pixel alone.
    x_px, y_px : float or None
        In the frames as they are, from 0; None for another tube.
    position_angle_deg : float
        Of the point's own direction.
    """

    name: str
    place: Icrs
    x_px: float | None
    y_px: float | None
    from_middle_arcsec: float
    position_angle_deg: float


@dataclass(frozen=True, slots=True)
class Look:
    """Exposed and solved: where the telescope points, and where the mount believed it did.

    Attributes
    ----------
    look_id : str
        Identity, so that a correction can name the frame it came from.
    seen : Icrs
        Solved place of the wanted pixel.
    believed : Icrs
        The mount's reading at mid-exposure (mean of before and after), as ICRS.
    offset : Offset
        Seen minus believed; east and north positive.
    before, after : MountReading
        Raw readings round the exposure.
    exposure_s : float or None
        As the frame says.
    width_px, height_px : int
        Of the frame; 0 where not known.
    segment_id : str
        Between two changes of the mount's zero points.
    model_id : str or None
        Pointing model in force.
    camera : CameraIdentity or None
        Whose frame it is.
    at : PointSeen or None
        Where the point looked that was asked for.
    tolerance_arcsec : float
        How far off the work that took it may end; infinite where it has no limit of its own.
    """

    look_id: str
    verdict: Verdict
    solution: Solution
    seen: Icrs
    believed: Icrs
    offset: Offset
    before: MountReading
    after: MountReading
    mid_exposure_utc: datetime
    exposure_s: float | None = None
    width_px: int = 0
    height_px: int = 0
    segment_id: str = ""
    model_id: str | None = None
    camera: CameraIdentity | None = None
    at: PointSeen | None = None
    tolerance_arcsec: float = math.inf

    @property
    def mount_moved_arcsec(self) -> float:
        """How far the mount's reading moved during the exposure."""
        return separation_arcsec(from_mount(self.before.place), from_mount(self.after.place))

    @property
    def sky_moved_arcsec(self) -> float:
        """How far the sky moved in the frame while it was exposed, as far as that is certain.

        By the two images of each star, or the path, to whose middle the plate was moved.
        """
        return self.verdict.apart_px * self.solution.scale_arcsec_px

    @property
    def sigma_arcsec(self) -> float:
        """One-sigma error of `offset` as it is when the exposure has ended.

        The solved place is the middle of what the sky did in the frame, and the tube stands at an end of it
        now: a half of that way comes to the solve's own error. Where the mount's reading went along, the
        offset is the same at the middle and at the end.
        """
        way_arcsec, quality = self.sky_moved_arcsec, self.verdict.quality
        if quality is not None and quality.images is StarImages.TRAILED:
            way_arcsec = max(way_arcsec, (quality.trail_px or 0.0) * self.solution.scale_arcsec_px)
        alone_arcsec = max(0.0, way_arcsec - self.mount_moved_arcsec)
        return math.hypot(self.solution.center_sigma_arcsec, 0.5 * alone_arcsec)

    @property
    def blind(self) -> bool:
        """Whether it was found by searching the whole sky, since the mount's belief led nowhere."""
        return self.solution.mode.startswith("blind/")


@dataclass(frozen=True, slots=True)
class SlewReport:
    """How a slew ended: asked, reported afterwards (both ICRS), and their distance.

    Attributes
    ----------
    target : Icrs
        Where the mount was sent.
    side_before, side_after : PierSide or None
        As the mount says.
    """

    outcome: SlewOutcome
    target: Icrs
    reported: Icrs
    miss_arcsec: float
    elapsed_s: float
    side_before: PierSide | None = None
    side_after: PierSide | None = None

    @property
    def flipped(self) -> bool:
        """Whether the tube changed sides: a sync made before is worth nothing there [POINTING §5]."""
        known = (PierSide.EAST, PierSide.WEST)
        return (
            self.side_before in known and self.side_after in known and self.side_before is not self.side_after
        )


@dataclass(frozen=True, slots=True)
class SyncReport:
    """A sync with its look and its read-back."""

    outcome: SyncOutcome
    look: Look
    read_back: Icrs
    read_back_miss_arcsec: float


@dataclass(frozen=True, slots=True)
class CoordinateSyncReport:
    """A sync on given coordinates.

    Attributes
    ----------
    outcome : SyncOutcome
        `SEEN` or `LATE`; every other end is an error.
    place : Icrs
        As told.
    offset : Offset
        Told minus believed before.
    read_back : Icrs
        The mount's reading afterwards.
    """

    outcome: SyncOutcome
    place: Icrs
    offset: Offset
    read_back: Icrs
    read_back_miss_arcsec: float


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """A lost mount synced by two frames that agree.

    Attributes
    ----------
    outcome : SyncOutcome
        `SEEN` or `LATE`; `IGNORED` or `ELSEWHERE` of a mount that takes no syncs as sent: its position counts
        all the same, since looks have shown how far it is off. Every other end is an error.
    first, second : Look
        The first look, and the one that confirmed it and was synced on, or by which its position counts.
    apart_arcsec : float
        Between the two solved places, what the mount moved meanwhile taken off.
    altitude_deg : float
        Of the solved place, for the site and this machine's clock.
    believed_altitude_deg : float
        Of the place the mount believed in: below the ground if it was quite lost.
    read_back : Icrs
        The mount's reading afterwards.
    read_back_miss_arcsec : float
        Its distance from the solved place.
    """

    outcome: SyncOutcome
    first: Look
    second: Look
    apart_arcsec: float
    altitude_deg: float
    believed_altitude_deg: float
    read_back: Icrs
    read_back_miss_arcsec: float
    elapsed_s: float


@dataclass(frozen=True, slots=True)
class FirstLightReport:
    """A telescope that was set up by eye, synced, and its camera learned.

    Attributes
    ----------
    outcome : SyncOutcome
        As of a recovery.
    first, synced, last : Look
        The first look that counted, the one after a small move that was synced on, and the last one after it.
    altitude_deg : float
        Of the last one.
    learned : str
        What is known of the camera now, in words.
    read_back : Icrs
        The mount's reading after the sync.
    """

    outcome: SyncOutcome
    first: Look
    synced: Look
    last: Look
    altitude_deg: float
    looks: int
    learned: str
    read_back: Icrs
    read_back_miss_arcsec: float
    elapsed_s: float


@dataclass(frozen=True, slots=True)
class FrameLook:
    """A frame that somebody else exposed, against the mount's readings round it.

    Attributes
    ----------
    look : Look or None
        None when it was not solved, or the mount was not read round its exposure.
    doubts : tuple of SyncDoubt
        Why no correction may be made by it.
    why : str
        In words.
    meanwhile : Meanwhile or None
        What it was compared by.
    """

    look: Look | None
    doubts: tuple[SyncDoubt, ...] = ()
    why: str = ""
    meanwhile: Meanwhile | None = None


@dataclass(frozen=True, slots=True)
class Corrected:
    """A correction between frames.

    Attributes
    ----------
    by : Correction
        What was done in the end.
    moved_arcsec : float
        How far the mount was sent from where it was; 0 when it was only synced.
    moved : Offset or None
        How far the tube was to move by that; None when nothing was slewed.
    """

    by: Correction
    outcome: str
    moved_arcsec: float
    report: SyncReport | SlewReport | None = None
    moved: Offset | None = None


@dataclass(frozen=True, slots=True)
class TelescopeState:
    """What is known of a telescope now; None where unknown."""

    name: str
    connected: bool
    activity: str
    reading: MountReading | None
    icrs: Icrs | None
    altitude_deg: float | None
    azimuth_deg: float | None
    problem: str | None
    trusted: bool | None = None
    link: str | None = None
    slew_state: str | None = None


def finite_or_none(value: float) -> float | None:
    """A number as JSON takes it, which knows no infinity."""
    return value if math.isfinite(value) else None


def angle_words(arcsec: float) -> str:
    """An angle for a message: seconds of arc, or degrees from 1° on."""
    return f"{arcsec / 3600.0:.1f}°" if arcsec >= 3600.0 else f"{arcsec:.0f}″"
