"""What goes over the web, in and out: strict numbers in, finite numbers out, unit and frame in every name."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from api.faults import Problem
from api.jobs import Job, JobState
from mountnav.navigation.reports import (
    CenterReport,
    Look,
    RecoverReport,
    SlewReport,
    SyncReport,
    TelescopeState,
    Try,
)
from mountnav.sky.coordinates import Apparent, Icrs


def _finite_or_none(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


Finite = Annotated[float | None, BeforeValidator(_finite_or_none)]


class Body(BaseModel):
    """A request's body: nothing unknown, no text or truth values for numbers, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class SlewBody(Body):
    """Where to go."""

    ra_deg: float = Field(ge=0, lt=360)
    dec_deg: float = Field(ge=-90, le=90)
    frame: Literal["icrs", "jnow-apparent"] = Field(
        default="icrs",
        description="jnow-apparent: true equator and equinox of now, geocentric, no refraction",
    )


class CenterBody(SlewBody):
    """What to center; bounds not given are the telescope's settings."""

    tolerance_arcsec: float | None = Field(default=None, gt=0, le=3600)
    max_tries: int | None = Field(default=None, ge=1, le=50)
    timeout_s: float | None = Field(default=None, gt=0, le=7200)


class LookBody(Body):
    """How to look."""

    exposure_s: float | None = Field(default=None, gt=0, le=600)


class Place(BaseModel):
    """A place in the sky; `utc` is the date of an apparent one."""

    ra_deg: Finite
    dec_deg: Finite
    frame: Literal["icrs", "jnow-apparent"]
    utc: datetime | None = None


class OffsetView(BaseModel):
    """Seen minus believed, on the sphere."""

    east_arcsec: Finite
    north_arcsec: Finite
    total_arcsec: Finite


class LookView(BaseModel):
    """A solved look: absolute values at one instant."""

    kind: Literal["look"] = "look"
    look_id: str
    mid_exposure_utc: datetime
    seen: Place
    believed: Place
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


class SlewView(BaseModel):
    """How a slew ended."""

    kind: Literal["slew"] = "slew"
    outcome: str
    target: Place
    reported: Place
    miss_arcsec: Finite
    elapsed_s: Finite


class SyncView(BaseModel):
    """How a sync ended, with the look it came from."""

    kind: Literal["sync"] = "sync"
    outcome: str
    look: LookView
    read_back: Place
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
    read_back_miss_arcsec: Finite
    elapsed_s: Finite


class AttemptView(BaseModel):
    """One look of a centering, and what was done about it."""

    number: int
    ra_deg: Finite
    dec_deg: Finite
    error_arcsec: Finite
    east_arcsec: Finite
    north_arcsec: Finite
    pairs: int
    rms_arcsec: Finite
    false_probability: Finite
    synced: bool
    sync_outcome: str | None
    slewed: bool
    elapsed_s: Finite


class CenterView(BaseModel):
    """How a centering ended: the target's error before and after."""

    kind: Literal["center"] = "center"
    outcome: str
    target: Place
    attempts: list[AttemptView]
    error_before_arcsec: Finite
    error_after_arcsec: Finite
    error_sigma_arcsec: Finite
    tolerance_arcsec: Finite
    elapsed_s: Finite


Result = Annotated[LookView | SlewView | SyncView | RecoverView | CenterView, Field(discriminator="kind")]


class JobView(BaseModel):
    """A job resource."""

    id: str
    kind: Literal["center", "slew", "sync", "look", "recover"]
    telescope: str
    state: JobState
    phase: str = Field(description="starting, slewing, exposing, solving, syncing, ..., cancelling, ended")
    request: dict[str, str | int | float | None]
    attempts: list[AttemptView]
    result: Result | None
    problem: Problem | None
    created_utc: datetime
    started_utc: datetime | None
    finished_utc: datetime | None


class TelescopeView(BaseModel):
    """What is known of a telescope now; null where unknown."""

    id: str
    connected: bool
    activity: str
    mount: str = Field(description="Address of the mount")
    reading: Place | None = Field(description="What the mount reports, in its own frame")
    icrs: Place | None = Field(description="The same, as ICRS")
    altitude_deg: Finite
    azimuth_deg: Finite
    slewing: bool | None
    job_id: str | None = Field(description="The job that holds it")
    problem: str | None = Field(description="What is wrong, in words")


class StopView(BaseModel):
    """A stop that was sent."""

    telescope: str
    stopped: Literal[True] = True
    cancelled_job_id: str | None


class EarthRotationView(BaseModel):
    """What the bundled table of Earth rotation knows, and for how long."""

    dut1_s: Finite
    dut1_overridden: bool
    table_ends_utc: datetime
    table_days_left: Finite
    warning: str | None


class HealthView(BaseModel):
    """That the service lives, whether every telescope is connected, and how long Earth rotation is known."""

    status: Literal["ok", "degraded"]
    version: str
    telescopes: dict[str, bool]
    solver: str = Field(
        description='"starting", "ready", "solving", "failed: ..." (why); "in this process" without a worker'
    )
    blind_index: str = Field(description='"ready", "building 40 %", or "none: ..." (why)')
    earth_rotation: EarthRotationView


class VersionView(BaseModel):
    """What runs here."""

    name: str
    version: str


def place(where: Icrs | Apparent) -> Place:
    """View of a place."""
    if isinstance(where, Apparent):
        return Place(ra_deg=where.ra_deg, dec_deg=where.dec_deg, frame="jnow-apparent", utc=where.utc)
    return Place(ra_deg=where.ra_deg, dec_deg=where.dec_deg, frame="icrs")


def look_view(look: Look) -> LookView:
    """View of a look."""
    solution, offset = look.solution, look.offset
    return LookView(
        look_id=look.look_id,
        mid_exposure_utc=look.mid_exposure_utc,
        seen=place(look.seen),
        believed=place(look.believed),
        offset=OffsetView(
            east_arcsec=offset.east_arcsec, north_arcsec=offset.north_arcsec, total_arcsec=offset.total_arcsec
        ),
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
    )


def result_view(report: object) -> LookView | SlewView | SyncView | RecoverView | CenterView | None:
    """View of what a job brought."""
    match report:
        case Look():
            return look_view(report)
        case SlewReport():
            return SlewView(
                outcome=str(report.outcome),
                target=place(report.target),
                reported=place(report.reported),
                miss_arcsec=report.miss_arcsec,
                elapsed_s=report.elapsed_s,
            )
        case SyncReport():
            return SyncView(
                outcome=str(report.outcome),
                look=look_view(report.look),
                read_back=place(report.read_back),
                read_back_miss_arcsec=report.read_back_miss_arcsec,
            )
        case RecoverReport():
            return RecoverView(
                outcome=str(report.outcome),
                first=look_view(report.first),
                second=look_view(report.second),
                apart_arcsec=report.apart_arcsec,
                altitude_deg=report.altitude_deg,
                believed_altitude_deg=report.believed_altitude_deg,
                read_back=place(report.read_back),
                read_back_miss_arcsec=report.read_back_miss_arcsec,
                elapsed_s=report.elapsed_s,
            )
        case CenterReport():
            return CenterView(
                outcome=str(report.outcome),
                target=place(report.target),
                attempts=[_attempt(one) for one in report.tries],
                error_before_arcsec=report.error_before_arcsec,
                error_after_arcsec=report.error_after_arcsec,
                error_sigma_arcsec=report.error_sigma_arcsec,
                tolerance_arcsec=report.tolerance_arcsec,
                elapsed_s=report.elapsed_s,
            )
        case None:
            return None
    raise TypeError(f"a job brought a {type(report).__name__}")


def job_view(job: Job) -> JobView:
    """View of a job."""
    return JobView.model_validate(
        {
            "id": job.id,
            "kind": job.kind,
            "telescope": job.telescope,
            "state": job.state,
            "phase": job.phase,
            "request": job.request,
            "attempts": job.attempts,
            "result": result_view(job.result),
            "problem": job.problem,
            "created_utc": job.created_utc,
            "started_utc": job.started_utc,
            "finished_utc": job.finished_utc,
        }
    )


def telescope_view(state: TelescopeState, mount: str, job: Job | None) -> TelescopeView:
    """View of a telescope's state."""
    return TelescopeView(
        id=state.name,
        connected=state.connected,
        activity=state.activity,
        mount=mount,
        reading=place(state.reading.place) if state.reading else None,
        icrs=place(state.icrs) if state.icrs else None,
        altitude_deg=state.altitude_deg,
        azimuth_deg=state.azimuth_deg,
        slewing=state.reading.slewing if state.reading else None,
        job_id=job.id if job else None,
        problem=state.problem,
    )
