"""Jobs, their results and telescopes as JSON models: finite numbers, unit and frame in every name."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, JsonValue, TypeAdapter

from api.orders.jobs import Job, JobState
from api.orders.results import (
    Attempt,
    AttemptView,
    AxesMovedView,
    DitherView,
    FollowView,
    HoldView,
    ModelRunView,
    MosaicView,
    RatesView,
    SeriesView,
    SkyEventView,
    SolvedView,
    mount_place,
)
from api.orders.results import Finite as Finite
from api.orders.results import OffsetView as OffsetView
from api.orders.results import Place as Place
from api.orders.results import place as place
from api.orders.targets import Body as Body
from api.orders.vocabulary import OrderKind
from api.problems import Problem
from mountnav.devices import Epoch, SlewOutcome
from mountnav.navigation.follow_report import FollowReport
from mountnav.navigation.reports import (
    CenterReport,
    CoordinateSyncReport,
    FirstLightReport,
    Look,
    PointSeen,
    RecoverReport,
    Rotation,
    SlewReport,
    SyncReport,
    Try,
)
from mountnav.navigation.searching import SearchReport
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset

_MOUNT = "The same in the mount's own frame, at that instant; null where that is not known any more"


class PointSeenView(BaseModel):
    """Where a point beside the frame's middle looked."""

    name: str = Field(description="Empty for one that was named by its pixel")
    place: Place
    x_px: Finite = Field(default=None, description="From 0; null for another tube")
    y_px: Finite = None
    from_middle_arcsec: Finite
    position_angle_deg: Finite = Field(description="Of its own direction")


class TurnView(BaseModel):
    """One turn of a rotator, by its own count."""

    from_deg: Finite
    to_deg: Finite
    came_deg: Finite
    elapsed_s: Finite


class RotationView(BaseModel):
    """A field that was brought to a position angle."""

    kind: Literal["rotate"] = "rotate"
    wanted_deg: Finite
    before_deg: Finite = Field(description="As a solve showed it")
    after_deg: Finite
    off_deg: Finite = Field(description="What is left")
    tolerance_deg: Finite
    turns: list[TurnView]
    sense: int | None = Field(description="Whether position angles grow (1) with the rotator's count")
    notes: list[str]


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
    at: PointSeenView | None = Field(default=None, description="Where the point looked that was asked for")


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
    at: PointSeenView | None = Field(default=None, description="The point that the target was brought to")
    rotation_deg: Finite = Field(default=None, description="Of the last frame")
    rotation: RotationView | None = Field(
        default=None, description="What came of the position angle that was asked for"
    )
    target_name: str = Field(default="", description="Of a target that moves among the stars")
    target_utc: datetime | None = Field(default=None, description="When it was at `target`, if it moves")
    target_sigma_arcsec: Finite = Field(default=None, description="How uncertain its place is, one sigma")
    target_rates_arcsec_s: Finite = Field(default=None, description="How fast it moves, over the sky")


class SearchView(BaseModel):
    """A spiral search that found something, and the centering after it."""

    kind: Literal["spiral-search"] = "spiral-search"
    looks: int
    passed_over: int = Field(description="Steps that the limits don't allow")
    found_arcsec: Finite = Field(description="How far from the target the solved frame was")
    found: LookView
    centered: CenterView
    elapsed_s: Finite


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
    | FollowView
    | MosaicView
    | RotationView
    | SearchView
    | MovedView
    | AxesMovedView
    | RatesView
    | SolvedView
    | SeriesView
    | HoldView
    | DitherView
    | ModelRunView,
    Field(discriminator="kind"),
]


class JobView(BaseModel):
    """A job resource."""

    id: str
    kind: OrderKind
    telescope: str
    state: JobState
    phase: str = Field(description="starting, slewing, exposing, solving, syncing, ..., cancelling, ended")
    request: dict[str, JsonValue] = Field(description="The order's body")
    attempts: list[Attempt] = Field(
        description="Looks of a centering, a series or a hold (one a minute), points of a model run, as they "
        "are done"
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


class RatesInForceView(BaseModel):
    """Rates beside the sidereal one at which it tracks, in the mount's own coordinates."""

    ra_arcsec_s: Finite = Field(
        description="Of the right ascension, not times cos(dec); positive to the east"
    )
    dec_arcsec_s: Finite
    since_utc: datetime
    ends_utc: datetime = Field(description="They end by themselves then, if nothing ends or prolongs them")


class AxisMovesView(BaseModel):
    """An axis that somebody moves by hand."""

    axis: Literal["primary", "secondary"]
    rate_deg_s: Finite
    left_s: Finite = Field(description="It ends by itself after so many seconds, if no further order comes")


class FollowingView(BaseModel):
    """A target that is followed just now, and what the sky says of it."""

    name: str = Field(description="What it is called")
    until_utc: datetime | None = Field(description="Its end as ordered; a limit may end it earlier")
    by: str | None = Field(default=None, description="rates, guide-pulses or small-slews; null before a look")
    off_arcsec: Finite = Field(default=None, description="From the target, as the last look saw it")
    off_sigma_arcsec: Finite = None
    verdict: str | None = Field(
        default=None, description="Of the rates: right, too-early, fault, ambiguous or unexplained"
    )
    fault: str | None = Field(default=None, description="What is wrong with the mount's rates, by name")
    seen_ra_arcsec_s: Finite = Field(
        default=None, description="Measured by looks, in the mount's coordinates"
    )
    seen_dec_arcsec_s: Finite = None
    seen_ra_sigma_arcsec_s: Finite = None
    seen_dec_sigma_arcsec_s: Finite = None
    ordered_ra_arcsec_s: Finite = Field(default=None, description="What the mount is to keep")
    ordered_dec_arcsec_s: Finite = None
    next_event: str = Field(default="", description="What comes next on its way")
    words: str = Field(default="", description="What the last look said")


class OnTargetView(BaseModel):
    """What a telescope is on, or goes to, by the orders it had."""

    name: str | None = Field(description="Of the target, else its place as people write it")
    job_id: str = Field(description="The job that brought or brings it there")
    arrived: bool = Field(description="Whether it is there; false: it is on its way")
    error_arcsec: Finite = Field(
        description="How far from the target the last look saw it; null once the mount has moved since"
    )
    error_utc: datetime | None = Field(description="Mid-exposure of that look")


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
    job_kind: str | None = Field(default=None, description="What that job does; null: none holds it")
    on: OnTargetView | None = Field(
        default=None, description="What it is on, or goes to; null: on nothing that was ordered"
    )
    problem: str | None = Field(description="What is wrong, in words")
    trusted: bool | None = Field(
        default=None, description="Whether the mount's position is trusted; if not, it refuses to slew"
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
    still_since_utc: datetime | None = Field(
        default=None,
        description="Of the first reading from which on the mount was seen to go nowhere but with the stars "
        "(or, where `tracking` is false, to stand); null while it slews or is not read",
    )
    time_to_meridian_s: Finite = Field(
        default=None,
        description="How long until the place it looks at crosses the meridian above the pole; negative: so "
        "long ago, up to 12 hours of the sky's turning",
    )
    time_to_limit_s: Finite = Field(
        default=None,
        description="How long it can track until a limit is reached; null if it doesn't track, or reaches "
        "none within 12 hours",
    )
    next_limit: NextLimitView | None = None
    rates: RatesInForceView | None = Field(
        default=None, description="Rates of a moving target; null: it tracks the stars, or nothing"
    )
    following: FollowingView | None = Field(default=None, description="What is followed; null: nothing is")
    axes_moved: list[AxisMovesView] = Field(default_factory=list, description="Axes moved by hand just now")
    following_problem: str | None = Field(
        default=None, description="What goes on by itself and could not be ended yet: it is tried on"
    )
    learned: str | None = Field(default=None, description="What solves have taught of the camera")
    rates_kept: str | None = Field(
        default=None, description="What looks have shown of how the mount keeps rates, and what is made good"
    )
    warnings: list[str] = Field(
        default_factory=list, description="What an operator should look into: a wrong scale, a full disk"
    )


_RESULT: TypeAdapter[Result] = TypeAdapter(Result)


def look_view(look: Look, epoch: Epoch | None = None) -> LookView:
    """View of a look; `epoch` is the mount's own frame."""
    solution, offset = look.solution, look.offset
    return LookView(
        look_id=look.look_id,
        mid_exposure_utc=look.mid_exposure_utc,
        seen=place(look.seen),
        seen_mount=mount_place(look.seen, epoch, look.mid_exposure_utc),
        believed=place(look.believed),
        believed_mount=mount_place(look.believed, epoch, look.mid_exposure_utc),
        offset=_offset(offset),
        mount_before=place(look.before.place),
        mount_after=place(look.after.place),
        sigma_arcsec=solution.center_sigma_arcsec,
        scale_arcsec_px=solution.scale_arcsec_px,
        rotation_deg=solution.rotation_deg,
        parity=solution.parity,
        rms_arcsec=solution.rms_arcsec,
        pairs=solution.pairs,
        false_probability=solution.false_probability,
        mode=solution.mode,
        wcs=dict(solution.wcs),
        solve_s=look.verdict.times.total_s,
        segment_id=look.segment_id or None,
        pier_side=None if look.after.pier_side is None else str(look.after.pier_side),
        at=None if look.at is None else _point_seen(look.at),
    )


def _point_seen(seen: PointSeen) -> PointSeenView:
    return PointSeenView(
        name=seen.name,
        place=place(seen.place),
        x_px=seen.x_px,
        y_px=seen.y_px,
        from_middle_arcsec=seen.from_middle_arcsec,
        position_angle_deg=seen.position_angle_deg,
    )


def _rotation(report: Rotation) -> RotationView:
    return RotationView(
        wanted_deg=report.wanted_deg,
        before_deg=report.before_deg,
        after_deg=report.after_deg,
        off_deg=report.off_deg,
        tolerance_deg=report.tolerance_deg,
        turns=[
            TurnView(
                from_deg=turn.from_deg, to_deg=turn.to_deg, came_deg=turn.came_deg, elapsed_s=turn.elapsed_s
            )
            for turn in report.turns
        ],
        sense=report.sense,
        notes=list(report.notes),
    )


def _offset(offset: Offset) -> OffsetView:
    return OffsetView(
        east_arcsec=offset.east_arcsec, north_arcsec=offset.north_arcsec, total_arcsec=offset.total_arcsec
    )


def _attempt(one: Try) -> AttemptView:
    return AttemptView(
        number=one.number,
        ra_deg=one.seen.ra_deg,
        dec_deg=one.seen.dec_deg,
        error_arcsec=one.error_arcsec,
        east_arcsec=one.east_arcsec,
        north_arcsec=one.north_arcsec,
        pairs=one.pairs,
        rms_arcsec=one.rms_arcsec,
        false_probability=one.false_probability,
        synced=one.synced,
        sync_outcome=None if one.sync_outcome is None else str(one.sync_outcome),
        slewed=one.slewed,
        elapsed_s=one.elapsed_s,
        after_arcsec=one.after_arcsec,
        expected_arcsec=one.expected_arcsec,
        sigma_arcsec=one.sigma_arcsec,
        correction=str(one.correction),
        why=one.why,
        followed=one.followed,
        approached=one.approached,
        look_id=one.look_id,
    )


def _crossing(report: CenterReport) -> CrossingView | None:
    crossing = report.crossing
    if crossing is None:
        return None
    return CrossingView(utc=crossing.utc, limit=str(crossing.limit), words=crossing.words)


def result_view(report: object, *, epoch: Epoch | None = None, utc: datetime | None = None) -> Result | None:
    """View of what a job brought.

    Parameters
    ----------
    report : object
        As the job's work returned it, or the mapping that was kept of it.
    epoch : {"apparent", "icrs"}, optional
        The mount's own frame: places are given in it too.
    utc : datetime, optional
        When the job ended: the date of these places.
    """

    def mounts(where: Icrs) -> Place | None:
        return mount_place(where, epoch, utc)

    match report:
        case Look():
            return look_view(report, epoch)
        case SlewReport():
            return SlewView(
                outcome=str(report.outcome),
                target=place(report.target),
                target_mount=mounts(report.target),
                reported=place(report.reported),
                reported_mount=mounts(report.reported),
                miss_arcsec=report.miss_arcsec,
                elapsed_s=report.elapsed_s,
            )
        case SyncReport():
            return SyncView(
                outcome=str(report.outcome),
                look=look_view(report.look, epoch),
                read_back=place(report.read_back),
                read_back_mount=mounts(report.read_back),
                read_back_miss_arcsec=report.read_back_miss_arcsec,
            )
        case CoordinateSyncReport():
            return ToldView(
                outcome=str(report.outcome),
                told=place(report.place),
                told_mount=mounts(report.place),
                offset=_offset(report.offset),
                read_back=place(report.read_back),
                read_back_mount=mounts(report.read_back),
                read_back_miss_arcsec=report.read_back_miss_arcsec,
            )
        case RecoverReport():
            return RecoverView(
                outcome=str(report.outcome),
                first=look_view(report.first, epoch),
                second=look_view(report.second, epoch),
                apart_arcsec=report.apart_arcsec,
                altitude_deg=report.altitude_deg,
                believed_altitude_deg=report.believed_altitude_deg,
                read_back=place(report.read_back),
                read_back_mount=mounts(report.read_back),
                read_back_miss_arcsec=report.read_back_miss_arcsec,
                elapsed_s=report.elapsed_s,
            )
        case FirstLightReport():
            return FirstLightView(
                outcome=str(report.outcome),
                first=look_view(report.first, epoch),
                synced=look_view(report.synced, epoch),
                last=look_view(report.last, epoch),
                altitude_deg=report.altitude_deg,
                looks=report.looks,
                learned=report.learned,
                read_back=place(report.read_back),
                read_back_mount=mounts(report.read_back),
                read_back_miss_arcsec=report.read_back_miss_arcsec,
                elapsed_s=report.elapsed_s,
            )
        case CenterReport():
            return _center(report, mounts(report.target))
        case FollowReport():
            return _follow(report)
        case SlewOutcome():
            return MovedView(outcome=str(report))
        case None:
            return None
        case Rotation():
            return _rotation(report)
        case SearchReport():
            return SearchView(
                looks=report.looks,
                passed_over=report.passed_over,
                found_arcsec=report.found_arcsec,
                found=look_view(report.found, epoch),
                centered=_center(report.centered, mounts(report.centered.target)),
                elapsed_s=report.elapsed_s,
            )
        case SolvedView() | SeriesView() | ModelRunView() | FollowView() | HoldView() | DitherView():
            return report
        case MosaicView() | AxesMovedView() | RatesView():
            return report
        case dict():
            # of a job that ended before the service was started again
            kept: Result = _RESULT.validate_python(report)
            return kept
    raise TypeError(f"a job brought a {type(report).__name__}")


def _center(report: CenterReport, target_mount: Place | None) -> CenterView:
    return CenterView(
        outcome=str(report.outcome),
        target=place(report.target),
        target_mount=target_mount,
        attempts=[_attempt(attempt) for attempt in report.tries],
        error_before_arcsec=report.error_before_arcsec,
        error_after_arcsec=report.error_after_arcsec,
        error_sigma_arcsec=report.error_sigma_arcsec,
        tolerance_arcsec=report.tolerance_arcsec,
        tolerance_asked_arcsec=report.tolerance_asked_arcsec,
        expected_error_arcsec=report.expected_error_arcsec,
        elapsed_s=report.elapsed_s,
        pier_side=str(report.side),
        pier_side_seen=str(report.side_seen),
        flipped=report.flipped,
        crossing=_crossing(report),
        model_id=report.model_id,
        notes=list(report.notes),
        target_name=report.target_name,
        target_utc=report.target_utc,
        target_sigma_arcsec=report.target_sigma_arcsec if report.target_name else None,
        at=None if report.at is None else _point_seen(report.at),
        rotation_deg=report.rotation_deg,
        rotation=None if report.rotation is None else _rotation(report.rotation),
        target_rates_arcsec_s=None if report.target_rates is None else report.target_rates.total_arcsec_s,
    )


def _follow(report: FollowReport) -> FollowView:
    judged = report.judgement
    return FollowView(
        outcome=report.end.value,
        target=report.target_name,
        began_utc=report.began_utc,
        ended_utc=report.ended_utc,
        by=report.by.value,
        plan=report.plan.words,
        fastest_arcsec_s=report.plan.fastest_arcsec_s,
        looks=report.looks,
        unsolved=report.unsolved,
        within=report.within,
        tolerance_arcsec=report.tolerance_arcsec,
        worst_arcsec=report.worst_arcsec,
        rms_arcsec=report.rms_arcsec,
        last_arcsec=report.last_arcsec,
        stated_arcsec=report.stated_arcsec,
        renewed=report.renewed,
        verdict=None if judged is None else judged.words,
        fault=None if report.fault is None else str(report.fault),
        correction=report.correction,
        events=[
            SkyEventView(
                kind=str(event.kind),
                utc=event.utc,
                altitude_deg=event.alt_deg,
                azimuth_deg=event.az_deg,
                limit=None if event.limit is None else str(event.limit),
                words=event.words,
            )
            for event in report.events
        ],
        notes=list(report.notes),
        elapsed_s=report.elapsed_s,
    )


def job_view(job: Job) -> JobView:
    """View of a job. A centering's report knows more of its tries than was told while it ran."""
    result = result_view(job.result, epoch=job.epoch, utc=job.finished_utc)
    attempts: list[Any] = [{"kind": "look", **attempt} for attempt in job.attempts]
    if isinstance(result, CenterView):
        attempts = list(result.attempts)
    return JobView.model_validate(
        {
            "id": job.id,
            "kind": job.kind,
            "telescope": job.telescope,
            "state": job.state,
            "phase": job.phase,
            "request": job.request,
            "attempts": attempts,
            "result": result,
            "problem": job.problem,
            "created_utc": job.created_utc,
            "started_utc": job.started_utc,
            "finished_utc": job.finished_utc if job.is_over else None,
        }
    )
