"""From what navigation answers to what the API shows."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import TypeAdapter

from api.http.attempt_views import AttemptView
from api.http.longer_views import ModelRunView, SeriesView, SolvedView
from api.http.models import (
    CenterView,
    CrossingView,
    FirstLightView,
    JobView,
    LookView,
    MovedView,
    RecoverView,
    Result,
    SlewView,
    SyncView,
    ToldView,
)
from api.http.places import OffsetView, Place, mount_place
from api.http.places import place as place
from api.orders.jobs import Job
from mountnav.devices import Epoch, SlewOutcome
from mountnav.navigation.reports import (
    CenterReport,
    FirstLightReport,
    Look,
    RecoverReport,
    SlewReport,
    SyncReport,
    ToldReport,
    Try,
)
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset

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
        case ToldReport():
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
        case SlewOutcome():
            return MovedView(outcome=str(report))
        case None:
            return None
        case SolvedView() | SeriesView() | ModelRunView():
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
        attempts=[_attempt(one) for one in report.tries],
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
    )


def job_view(job: Job) -> JobView:
    """View of a job. A centering's report knows more of its tries than was told while it ran."""
    result = result_view(job.result, epoch=job.epoch, utc=job.finished_utc)
    attempts: list[Any] = [{"kind": "look", **one} for one in job.attempts]
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
