"""What navigation answers about a look, a slew, a sync, ...: absolute values, never only "how far off"."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from mountnav.devices import MountReading, PierSide, SlewOutcome, SyncOutcome
from mountnav.errors import SyncDoubt
from mountnav.navigation.camera_identity import CameraIdentity
from mountnav.navigation.center_reports import CenterOutcome, CenterReport, Correction, Crossing, Try
from mountnav.navigation.readings_kept import Meanwhile
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset
from mountnav.solution import Solution, Verdict


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
    mid_exposure_utc : datetime
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

    @property
    def blind(self) -> bool:
        """Whether it was found by searching the whole sky, since the mount's belief led nowhere."""
        return self.solution.mode.startswith("blind/")


@dataclass(frozen=True, slots=True)
class SlewReport:
    """How a slew ended: asked, reported afterwards (both ICRS), and their distance.

    Attributes
    ----------
    outcome : SlewOutcome
    target : Icrs
        Where the mount was sent.
    reported : Icrs
    miss_arcsec : float
    elapsed_s : float
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
class ToldReport:
    """A sync on told coordinates.

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
    read_back_miss_arcsec : float
    """

    outcome: SyncOutcome
    place: Icrs
    offset: Offset
    read_back: Icrs
    read_back_miss_arcsec: float


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """A lost mount told where it points, by two frames that agree.

    Attributes
    ----------
    outcome : SyncOutcome
        `SEEN` or `LATE`; `IGNORED` or `ELSEWHERE` of a mount that takes no syncs as told: its position counts
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
    elapsed_s : float
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
    """A telescope that was set up by eye, told where it points, and its camera learned.

    Attributes
    ----------
    outcome : SyncOutcome
        As of a recovery.
    first, synced, last : Look
        The first look that counted, the one after a small move that was synced on, and the last one after it.
    altitude_deg : float
        Of the last one.
    looks : int
    learned : str
        What is known of the camera now, in words.
    read_back : Icrs
        The mount's reading after the sync.
    read_back_miss_arcsec : float
    elapsed_s : float
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
    outcome : str
    moved_arcsec : float
        How far the mount was sent from where it was; 0 when it was only told where it points.
    moved : Offset or None
        How far the tube was to move by that; None when nothing was slewed.
    report : SyncReport or SlewReport or None
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


__all__ = [
    "CenterOutcome",
    "CenterReport",
    "Corrected",
    "Correction",
    "Crossing",
    "FirstLightReport",
    "FrameLook",
    "Look",
    "RecoverReport",
    "SlewReport",
    "SyncReport",
    "TelescopeState",
    "ToldReport",
    "Try",
]
