"""A look as the journal keeps it and as models take it: absolute values at one instant [POINTING §6]."""

from __future__ import annotations

import math
from datetime import datetime

from mountnav.devices import Epoch, MountReading, PierSide
from mountnav.frames import Frame
from mountnav.journal.records import LookRecord, cause
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.kinds import for_mount
from mountnav.navigation.reports import Look
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Air
from mountnav.sky.iers import earth_orientation
from mountnav.solution import Solution, Verdict


def record_of(
    equipment: Equipment,
    *,
    look_id: str,
    utc: datetime,
    before: MountReading,
    after: MountReading,
    frame: Frame,
    exposure_s: float,
    used: str,
    segment_id: str,
    model_id: str | None,
    verdict: Verdict | None = None,
    look: Look | None = None,
    refused: tuple[str, str] | None = None,
) -> LookRecord:
    """The row of a look, solved or not.

    Parameters
    ----------
    equipment : Equipment
    look_id : str
    utc : datetime
        Mid-exposure; of the second reading where the frame tells none.
    before, after : MountReading
    frame : Frame
    exposure_s : float
    used : str
    segment_id, model_id : str, str or None
        As they were when the frame was exposed.
    verdict : Verdict, optional
        None when the frame was not even solved, since it can't be used.
    look : Look, optional
        When it was solved.
    refused : (reason, detail), optional
        Why it can't be used.
    """
    solution = None if look is None else look.solution
    quality = None if verdict is None else verdict.quality
    reason, detail = refused or ("", "")
    if verdict is not None and solution is None and refused is None:
        reason, detail = str(verdict.reason), verdict.detail
    return LookRecord(
        look_id=look_id,
        telescope=equipment.name,
        utc=utc,
        solved=solution is not None,
        before=before,
        after=after,
        segment_id=segment_id,
        air=equipment.air,
        reason=reason,
        detail=detail,
        seen=None if look is None else look.seen,
        covariance_arcsec2=None if solution is None else covariance_of(solution),
        model_id=model_id,
        dut1_s=earth_orientation(utc).dut1_s,
        camera=equipment.camera.name,
        source=frame.source,
        exposure_s=frame.exposure_s if frame.exposure_s is not None else exposure_s,
        mode="" if solution is None else solution.mode,
        catalog="" if solution is None else solution.catalog,
        pairs=0 if solution is None else solution.pairs,
        rms_arcsec=None if solution is None else _finite(solution.rms_arcsec),
        false_probability=None if solution is None else _finite(solution.false_probability),
        scale_arcsec_px=None if solution is None else solution.scale_arcsec_px,
        rotation_deg=None if solution is None else solution.rotation_deg,
        parity=None if solution is None else solution.parity,
        fwhm_px=None if quality is None else quality.fwhm_px,
        limiting_mag=None if quality is None else quality.limiting_mag,
        sky_adu=None if quality is None else quality.sky_adu,
        measured=0 if verdict is None else verdict.measured,
        used=used,
        cause=cause(),
    )


def observation_of(
    look: Look, *, epoch: Epoch, air: Air, segment_id: str, model_id: str | None = None
) -> PointingObservation:
    """A look as models, the doctor and the drift report take it."""
    solution = look.solution
    sides = {look.before.pier_side, look.after.pier_side}
    side = sides.pop() if len(sides) == 1 else None
    return PointingObservation(
        utc=look.mid_exposure_utc,
        seen=look.seen,
        sigma_arcsec=solution.center_sigma_arcsec,
        reading=for_mount(look.believed, epoch, look.mid_exposure_utc),
        side=side or PierSide.UNKNOWN,
        segment_id=segment_id,
        air=air,
        rotation_deg=solution.rotation_deg,
        scale_arcsec_px=solution.scale_arcsec_px,
        parity=solution.parity,
        model_id=model_id,
        look_id=look.look_id,
    )


def covariance_of(solution: Solution) -> tuple[float, float, float] | None:
    """East-east, east-north and north-north; None where they are no numbers."""
    matrix = solution.center_covariance_arcsec2
    if matrix.shape != (2, 2):
        return None
    values = (float(matrix[0, 0]), float(matrix[0, 1]), float(matrix[1, 1]))
    return values if all(map(math.isfinite, values)) else None


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


__all__ = ["covariance_of", "observation_of", "record_of"]
