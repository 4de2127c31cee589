"""What goes over the web of nights and their frames."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel, Field, model_validator

from api.orders.job_views import Finite, OffsetView, Place
from api.orders.targets import Body, Target
from mountnav.night.events import Decision, PlateSeen
from mountnav.night.frames_in import FrameAnswer
from mountnav.night.session import DriftSoFar, NightReport
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset


class FramePathBody(Body):
    """A frame by its path on the service's machine, or by its header alone."""

    path: str | None = Field(
        default=None, min_length=1, max_length=4096, description="Within the folders that the settings allow"
    )
    header: dict[str, Any] | None = Field(
        default=None,
        description="FITS cards of a frame too large to send: noted with its time, never corrected by",
    )
    source: str = Field(default="", max_length=4096, description="What to call a header's frame")
    hold: bool = Field(
        default=False, description="Nothing is exposed before the answer: a correction may be made meanwhile"
    )
    target_ra_deg: float | None = Field(
        default=None, ge=0, lt=360, description="Where its center was meant to be"
    )
    target_dec_deg: float | None = Field(default=None, ge=-90, le=90, description="With target_ra_deg")
    target: Target | None = Field(
        default=None,
        description="Instead of those two; of one that moves its place in the middle of the exposure counts",
    )


class WhyBody(Body):
    """Why, in the sayer's words."""

    why: str = Field(default="", max_length=500)


class BusyBody(Body):
    """Whether the scheduler exposes."""

    busy: bool
    for_s: float = Field(
        default=3600.0,
        gt=0,
        le=86400,
        description="A scheduler that is not heard of again is free after that",
    )


class SafetyBody(WhyBody):
    """Whether it is safe to observe."""

    safe: bool
    for_s: float | None = Field(
        default=None,
        gt=0,
        le=86400,
        description='Of "safe": a monitor that is not heard of again for so long means not safe; without it'
        " what was said last holds for ever",
    )

    @model_validator(mode="after")
    def _of_safe_alone(self) -> SafetyBody:
        if self.for_s is not None and not self.safe:
            raise ValueError(
                "for_s goes with safe: true; what is not safe stays so until it is said otherwise"
            )
        return self


class DecisionView(BaseModel):
    """What was decided, and why."""

    act: str
    why: str
    text: str
    frame_id: str | None
    error: OffsetView | None = Field(description="Seen minus wanted")


class FrameView(BaseModel):
    """A frame of a night, and what came of it."""

    frame_id: str
    telescope: str
    source: str
    sha256: str
    duplicate: bool = Field(description="This content was here before; it is not processed again")
    done: bool = Field(description="Whether all that follows is known")
    arrived_utc: datetime
    mid_exposure_utc: datetime | None
    placed: bool
    fully: bool = Field(description="Identified fully, not by its shift alone")
    seen: Place | None
    sigma_arcsec: Finite
    offset: OffsetView | None = Field(description="Seen minus believed")
    field: str
    look_id: str | None
    decision: DecisionView | None
    correction: str | None = Field(description="What came of it, if one was decided")
    detail: str


class NightDriftView(BaseModel):
    """How what the mount is off changes, in the present field."""

    field: str
    since_utc: datetime
    until_utc: datetime
    frames: int
    ra_cosdec_arcsec_min: Finite
    ra_cosdec_sigma_arcsec_min: Finite
    dec_arcsec_min: Finite
    dec_sigma_arcsec_min: Finite
    rms_arcsec: Finite
    jumps_utc: list[datetime]
    last: OffsetView | None


class PlateView(BaseModel):
    """What the frames that opened the session agreed on."""

    scale_arcsec_px: Finite
    rotation_deg: Finite
    parity: int


class NightView(BaseModel):
    """A telescope's night."""

    telescope: str
    night_id: str | None
    phase: str
    holds: list[str] = Field(description="Why nothing is corrected, though frames are measured")
    unsafe_why: str | None
    safe_until: datetime | None = Field(
        description="A monitor said that it is safe until then; not heard of again, it means not safe"
    )
    correct_by: str
    sun_altitude_deg: Finite
    calibration: PlateView | None
    frames: int
    placed: int
    waiting: int
    corrections: int
    corrections_this_hour: int
    correcting: bool
    busy_until: datetime | None
    last: DecisionView | None
    drift: NightDriftView | None
    folder: str | None
    folder_problem: str | None
    recording_problem: str | None


def frame_view(answer: FrameAnswer, telescope_id: str, *, duplicate: bool = False) -> FrameView:
    """Show a frame."""
    return FrameView(
        frame_id=answer.frame_id,
        telescope=telescope_id,
        source=answer.source,
        sha256=answer.digest,
        duplicate=duplicate,
        done=answer.done,
        arrived_utc=answer.arrived_utc,
        mid_exposure_utc=answer.mid_utc,
        placed=answer.placed,
        fully=answer.fully,
        seen=_place(answer.seen),
        sigma_arcsec=answer.sigma_arcsec,
        offset=_offset(answer.offset),
        field=answer.field,
        look_id=answer.look_id or None,
        decision=_decision(answer.decision),
        correction=answer.outcome or None,
        detail=answer.detail,
    )


def night_view(
    report: NightReport,
    telescope_id: str,
    *,
    correct_by: str,
    folder: str | None,
    folder_problem: str,
    recording_problem: str,
) -> NightView:
    """Show a night."""
    state = report.state
    return NightView(
        telescope=telescope_id,
        night_id=state.night_id or None,
        phase=str(state.phase),
        holds=sorted(str(hold) for hold in state.holds),
        unsafe_why=state.unsafe_why or None,
        safe_until=state.safe_until,
        correct_by=correct_by,
        sun_altitude_deg=report.sun_altitude_deg,
        calibration=_plate(state.plate),
        frames=state.frames,
        placed=state.placed,
        waiting=report.waiting,
        corrections=state.corrected,
        corrections_this_hour=len(state.corrections),
        correcting=state.under_way is not None,
        busy_until=state.busy_until,
        last=_decision(report.last),
        drift=_drift(report.drift),
        folder=folder,
        folder_problem=folder_problem or None,
        recording_problem=recording_problem or None,
    )


def _place(place: Icrs | None) -> Place | None:
    return None if place is None else Place(ra_deg=place.ra_deg, dec_deg=place.dec_deg, frame="icrs")


def _offset(offset: Offset | None) -> OffsetView | None:
    if offset is None:
        return None
    return OffsetView(
        east_arcsec=offset.east_arcsec, north_arcsec=offset.north_arcsec, total_arcsec=offset.total_arcsec
    )


def _decision(decision: Decision | None) -> DecisionView | None:
    if decision is None:
        return None
    return DecisionView(
        act=str(decision.act),
        why=str(decision.why),
        text=decision.text,
        frame_id=decision.frame_id or None,
        error=_offset(decision.error),
    )


def _plate(plate: PlateSeen | None) -> PlateView | None:
    if plate is None:
        return None
    return PlateView(
        scale_arcsec_px=plate.scale_arcsec_px, rotation_deg=plate.rotation_deg, parity=plate.parity
    )


def _drift(so_far: DriftSoFar | None) -> NightDriftView | None:
    if so_far is None:
        return None
    drift = so_far.drift
    return NightDriftView(
        field=so_far.field,
        since_utc=so_far.since_utc,
        until_utc=so_far.until_utc,
        frames=so_far.frames,
        ra_cosdec_arcsec_min=None if drift is None else drift.ra_arcsec_min,
        ra_cosdec_sigma_arcsec_min=None if drift is None else drift.ra_sigma_arcsec_min,
        dec_arcsec_min=None if drift is None else drift.dec_arcsec_min,
        dec_sigma_arcsec_min=None if drift is None else drift.dec_sigma_arcsec_min,
        rms_arcsec=None if drift is None else drift.rms_arcsec,
        jumps_utc=list(so_far.jumps_utc),
        last=_offset(so_far.last),
    )
