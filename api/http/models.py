"""What goes over the web of jobs and telescopes: finite numbers, unit and frame in every name."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, Field, JsonValue

from api.http.attempt_views import Attempt, AttemptView
from api.http.faults import Problem
from api.http.longer_views import ModelRunView, SeriesView, SolvedView
from api.http.places import Finite as Finite
from api.http.places import OffsetView as OffsetView
from api.http.places import Place as Place
from api.orders.bodies import Body as Body
from api.orders.jobs import JobState

_MOUNT = "The same in the mount's own frame, at that instant; null where that is not known any more"


class LookView(BaseModel):
    """A solved look: absolute values at one instant."""

    kind: Literal["look"] = "look"
    look_id: str
    mid_exposure_utc: datetime
    seen: Place
    seen_mount: Place | None = Field(default=None, description=_MOUNT)
    believed: Place
    believed_mount: Place | None = Field(default=None, description=_MOUNT)
    offset: OffsetView
    mount_before: Place
    mount_after: Place
    sigma_arcsec: Finite
    scale_arcsec_px: Finite
    rotation_deg: Finite
    parity: int
    rms_arcsec: Finite
    pairs: int
    false_probability: Finite
    mode: str = Field(description="blind/... if found by searching the whole sky, else full/...")
    wcs: dict[str, str | int | float]
    solve_s: Finite
    segment_id: str | None = Field(
        default=None, description="Looks of one segment share the mount's zero points"
    )
    pier_side: str | None = None


class SlewView(BaseModel):
    """How a slew ended."""

    kind: Literal["slew"] = "slew"
    outcome: str
    target: Place
    target_mount: Place | None = Field(default=None, description=_MOUNT)
    reported: Place
    reported_mount: Place | None = Field(default=None, description=_MOUNT)
    miss_arcsec: Finite
    elapsed_s: Finite


class SyncView(BaseModel):
    """How a sync ended, with the look it came from."""

    kind: Literal["sync"] = "sync"
    outcome: str
    look: LookView
    read_back: Place
    read_back_mount: Place | None = Field(default=None, description=_MOUNT)
    read_back_miss_arcsec: Finite


class ToldView(BaseModel):
    """How a sync on told coordinates ended."""

    kind: Literal["sync-to"] = "sync-to"
    outcome: str
    told: Place
    told_mount: Place | None = Field(default=None, description=_MOUNT)
    offset: OffsetView = Field(description="Told minus believed before")
    read_back: Place
    read_back_mount: Place | None = Field(default=None, description=_MOUNT)
    read_back_miss_arcsec: Finite


class RecoverView(BaseModel):
    """How a recovery ended: two looks that agree, and the mount's reading after the sync on the second."""

    kind: Literal["recover"] = "recover"
    outcome: str
    first: LookView
    second: LookView
    apart_arcsec: Finite
    altitude_deg: Finite
    believed_altitude_deg: Finite
    read_back: Place
    read_back_mount: Place | None = Field(default=None, description=_MOUNT)
    read_back_miss_arcsec: Finite
    elapsed_s: Finite


class FirstLightView(BaseModel):
    """How a first light ended: the first look, the one that was synced on, and the last one after it."""

    kind: Literal["first-light"] = "first-light"
    outcome: str
    first: LookView
    synced: LookView
    last: LookView
    altitude_deg: Finite
    looks: int
    learned: str = Field(description="What is known of the camera now")
    read_back: Place
    read_back_mount: Place | None = Field(default=None, description=_MOUNT)
    read_back_miss_arcsec: Finite
    elapsed_s: Finite


class CrossingView(BaseModel):
    """A limit that tracking will reach."""

    utc: datetime
    limit: str
    words: str


class CenterView(BaseModel):
    """How a centering ended: the target's error before and after."""

    kind: Literal["center"] = "center"
    outcome: str
    target: Place
    target_mount: Place | None = Field(default=None, description=_MOUNT)
    attempts: list[AttemptView]
    error_before_arcsec: Finite
    error_after_arcsec: Finite
    error_sigma_arcsec: Finite
    tolerance_arcsec: Finite = Field(description="The one that was kept")
    tolerance_asked_arcsec: Finite | None = Field(
        default=None, description="The one that was asked for; smaller where the mount's steps don't allow it"
    )
    expected_error_arcsec: Finite | None = Field(
        default=None, description="Before anything moved: how far off it was expected, one sigma"
    )
    elapsed_s: Finite
    pier_side: str | None = Field(default=None, description="As the mount says, at the end")
    pier_side_seen: str | None = Field(default=None, description="By the solved rotation")
    flipped: bool = False
    crossing: CrossingView | None = Field(
        default=None, description="The first limit that tracking reaches within `planned_s`"
    )
    model_id: str | None = Field(default=None, description="The pointing model that aimed")
    notes: list[str] = Field(default_factory=list, description="What an operator should know")


class MovedView(BaseModel):
    """How an order ended that has no target: park, unpark, home, tracking, trust."""

    kind: Literal["moved"] = "moved"
    outcome: str


Result = Annotated[
    LookView
    | SlewView
    | SyncView
    | ToldView
    | RecoverView
    | FirstLightView
    | CenterView
    | MovedView
    | SolvedView
    | SeriesView
    | ModelRunView,
    Field(discriminator="kind"),
]

JobKind = Literal[
    "slew",
    "center",
    "look",
    "sync",
    "sync-to",
    "offset",
    "flip",
    "park",
    "unpark",
    "set-park",
    "home",
    "tracking",
    "guide",
    "trust",
    "set-site-time",
    "accept-site-time",
    "recover",
    "first-light",
    "solve",
    "series",
    "model-run",
]


class JobView(BaseModel):
    """A job resource."""

    id: str
    kind: JobKind
    telescope: str
    state: JobState
    phase: str = Field(description="starting, slewing, exposing, solving, syncing, ..., cancelling, ended")
    request: dict[str, JsonValue] = Field(description="The order's body")
    attempts: list[Attempt] = Field(
        description="Looks of a centering or a series, points of a model run, as they are done"
    )
    result: Result | None
    problem: Problem | None
    created_utc: datetime
    started_utc: datetime | None
    finished_utc: datetime | None


class NextLimitView(BaseModel):
    """The limit that tracking on leads to."""

    limit: str
    after_s: Finite = Field(description="From `read_utc` on; 0 if it is passed already")
    utc: datetime
    altitude_deg: Finite = Field(description="Where")
    azimuth_deg: Finite


class TelescopeView(BaseModel):
    """What is known of a telescope now; null where unknown. Places hold for `read_utc`."""

    id: str
    connected: bool
    activity: str
    mount: str = Field(description="Address of the mount")
    reading: Place | None = Field(description="What the mount reports, in its own frame")
    icrs: Place | None = Field(description="The same, as ICRS")
    read_utc: datetime | None = Field(default=None, description="When the mount was read")
    altitude_deg: Finite
    azimuth_deg: Finite
    hour_angle_deg: Finite = Field(default=None, description="Observed, west positive, -180 to 180")
    local_sidereal_time_deg: Finite = Field(default=None, description="Apparent, 0 to 360")
    slewing: bool | None = Field(description="As the mount says, or because a slew was ordered")
    job_id: str | None = Field(description="The job that holds it")
    problem: str | None = Field(description="What is wrong, in words")
    trusted: bool | None = Field(
        default=None, description="Whether the mount's position counts; if not, it refuses to slew"
    )
    contradiction: str | None = Field(
        default=None,
        description="In what mount and settings contradict each other on site and time: nothing is slewed "
        "until that is resolved or accepted",
    )
    link: str | None = Field(default=None, description="The line to the mount: up, silent, lost, closed")
    slew_state: str | None = Field(default=None, description="What the last slew has come to")
    tracking: bool | None = Field(default=None, description="Whether the mount says it follows the sky")
    parked: bool | None = Field(default=None, description="Whether the mount says it is parked")
    pier_side: str | None = Field(
        default=None, description="Side of the pier, as ASCOM counts: east is normal"
    )
    time_to_limit_s: Finite = Field(
        default=None,
        description="How long it can track until a limit is reached; null if it doesn't track, or reaches "
        "none within 12 hours",
    )
    next_limit: NextLimitView | None = None
    learned: str | None = Field(default=None, description="What solves have taught of the camera")
    warnings: list[str] = Field(
        default_factory=list, description="What an operator should look into: a wrong scale, a full disk"
    )
