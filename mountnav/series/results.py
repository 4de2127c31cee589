"""Settings and results of a series: of each frame, of each segment between jumps, and of the whole."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

from mountnav.identification.settings import PreliminarySettings
from mountnav.series.drift import Drift
from mountnav.series.persistence import PersistentSources
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset
from mountnav.solution import Solution
from mountnav.solving.settings import SolveSettings


class Mode(StrEnum):
    """How a frame of a series was placed."""

    FULL = "full"
    PRELIMINARY = "preliminary"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class SeriesSettings:
    """Settings of a series.

    Attributes
    ----------
    solving : SolveSettings
        Calibration and measuring of all frames; identification and budget of the full solutions.
    preliminary : PreliminarySettings
        The measured profile; `PreliminarySettings()` follows as the paper does.
    audit_every : int
        Every so many frames a full solution checks the shift; 0: never.
    ack_fall : float
        When fewer than this share of the most acknowledgements so far are left, the frame is solved fully.
    trend_px : float
        Turn or stretch of the field that amounts to more than this in the frame's corner (and to more than 5
        of its errors) calls for a full solution.
    persistent_frames : int
        Frames that make a source persistent.
    jump_px : float
        No smaller departure from the usual rate is called a jump.
    """

    solving: SolveSettings = field(default_factory=SolveSettings)
    preliminary: PreliminarySettings = field(default_factory=PreliminarySettings.measured)
    audit_every: int = 10
    ack_fall: float = 0.5
    trend_px: float = 0.5
    persistent_frames: int = 3
    jump_px: float = 3.0


@dataclass(frozen=True, slots=True)
class Shift:
    """How far a frame lies from the one it is followed from; x1 = x2 + shift [S23 eq. 1, 2].

    Attributes
    ----------
    anchor : int
        Number of that frame.
    dx_px, dy_px : float
        Place of this frame's center in the anchor, from the anchor's center: through the anchor's plate where
        it is solved, else as the mean over pairs.
    dx_sigma_px, dy_sigma_px : float
        Standard error.
    mean_dx_px, mean_dy_px : float
        The mean over the identified pairs (3, 4), by the profile in force.
    pairs : int
        Pairs in the mean.
    strobes, acknowledged : int
        Strobes that could be acknowledged, and those that were.
    false_probability : float
        That a wrong shift would have looked as good.
    """

    anchor: int
    dx_px: float
    dy_px: float
    dx_sigma_px: float
    dy_sigma_px: float
    mean_dx_px: float
    mean_dy_px: float
    pairs: int
    strobes: int
    acknowledged: int
    false_probability: float


@dataclass(frozen=True, slots=True)
class SeriesTimes:
    """Wall seconds: measuring, preliminary identification with its plate, full solution."""

    measure_s: float = 0.0
    preliminary_s: float = 0.0
    full_s: float = 0.0


@dataclass(frozen=True, slots=True)
class FrameResult:
    """Result of one frame of a series.

    Attributes
    ----------
    number : int
        Position in the series, from 0.
    solution : Solution or None
        Full, or with mode "preliminary": the anchor's plate moved; its pairs' stars are then the anchor's
        measurements (no magnitudes).
    shift : Shift or None
        None for a frame that is an anchor itself, or could not be followed.
    followed : Icrs or None
        The center by the shift; of an audited frame beside the full solution's.
    audit : Offset or None
        Full solution minus shift, of an audited frame.
    measured : int
        Sources measured.
    persistent : int
        Of these, sources seen in three frames or more by then.
    width_px, height_px : int
        0 for a frame that could not be read.
    notes : tuple of str
        What happened: why it was solved fully, why it was not placed.
    """

    number: int
    source: str
    mid_exposure_utc: datetime | None
    mode: Mode
    solution: Solution | None = None
    shift: Shift | None = None
    followed: Icrs | None = None
    audit: Offset | None = None
    measured: int = 0
    persistent: int = 0
    width_px: int = 0
    height_px: int = 0
    notes: tuple[str, ...] = ()
    times: SeriesTimes = field(default_factory=SeriesTimes)

    @property
    def center(self) -> Icrs | None:
        """The frame's center."""
        return self.solution.center if self.solution is not None else None


@dataclass(frozen=True, slots=True)
class Segment:
    """Frames between two jumps.

    Attributes
    ----------
    frames : tuple of int
        Their numbers, in order of time.
    reason : str
        Why there is no drift.
    jump : Offset or None
        How far the series jumped to the segment's first frame, the drift taken off; None for the first.
    """

    frames: tuple[int, ...]
    drift: Drift | None
    reason: str
    jump: Offset | None


@dataclass(frozen=True, slots=True)
class SeriesReport:
    """A whole series.

    Attributes
    ----------
    frames : tuple of FrameResult
        With persistence known from the whole series.
    drift : Drift or None
        Of all segments together, jumps left out.
    reason : str
        Why there is no drift.
    persistent : PersistentSources or None
        Of the frames' most usual size, in the pixels of `anchor`.
    anchor : int or None
        Number of the frame that `persistent` is given in.
    """

    frames: tuple[FrameResult, ...]
    segments: tuple[Segment, ...]
    drift: Drift | None
    reason: str
    persistent: PersistentSources | None
    anchor: int | None
