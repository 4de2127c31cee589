"""The record of a solve: the one shape that `mountnav solve --json` prints and POST /v1/solve answers."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, Field

from mountnav.measuring.quality import SkyQuality
from mountnav.solution import Reason, Times, Verdict


class SolveTimes(BaseModel):
    """Wall seconds spent."""

    read: float
    measure: float
    identify: float
    total: float


class QualityRecord(BaseModel):
    """What the frame tells about the night; null where it can't be told."""

    stars: int = Field(description="Star-like sources measured")
    images: str = Field(description="well sampled, undersampled, defocused, trailed, none seen")
    fwhm_px: float | None
    fwhm_arcsec: float | None
    ellipticity: float | None
    elongation_deg: float | None = Field(description="Major axis, from +x towards +y")
    sky_adu: float | None
    noise_adu: float | None
    sky_gradient: float | None = Field(description="Change of the sky over the frame, in units of the noise")
    saturated_share: float | None
    zero_point_mag: float | None = Field(description="Magnitude of a star of 1 ADU")
    limiting_mag: float | None = Field(description="Faintest star that stands 5 sigma above the sky")
    sky_mag_arcsec2: float | None


class SolveRecord(BaseModel):
    """Where a frame lies, or why that is unknown. Everything but file, solved and time_s may be null."""

    file: str
    solved: bool
    ra_deg: float | None = Field(default=None, description="ICRS place of the frame's geometric center")
    dec_deg: float | None = None
    scale_arcsec_px: float | None = None
    rotation_deg: float | None = Field(
        default=None, description="Position angle of the image's +y axis, east of north"
    )
    parity: Literal[1, -1] | None = Field(default=None, description="+1: east left when north is up")
    rms_arcsec: float | None = None
    pairs: int | None = None
    false_probability: float | None = None
    mode: str | None = None
    time_s: SolveTimes
    wcs: dict[str, str | int | float] | None = Field(default=None, description="FITS cards, TAN or TAN-SIP")
    reason: str | None = Field(default=None, description="Why it was not solved, for people")
    center_sigma_arcsec: float | None = Field(default=None, description="One-sigma error per coordinate")
    rejected_by: dict[str, int] | None = Field(
        default=None, description="Candidate pairs thrown out, by the rule that did it"
    )
    reason_code: str | None = Field(default=None, description="The same for programs: NO_MATCH, ...")
    numbers: dict[str, float] | None = Field(default=None, description="The numbers behind the reason")
    contradictions: list[str] = Field(default=[], description="Hints that turned out wrong")
    notes: list[str] = Field(default=[], description="Masters not applied, a date that is unknown, ...")
    quality: QualityRecord | None = Field(default=None, description="What the frame tells about the night")


def solve_record(file: str, verdict: Verdict) -> SolveRecord:
    """Make the record of a verdict; NaN and infinities become null."""
    times = _times(verdict.times)
    solution = verdict.solution
    if solution is None:
        reason = str(verdict.reason) if verdict.reason else "not solved"
        told = f"{reason}: {verdict.detail}" if verdict.detail else reason
        return SolveRecord(
            file=file,
            solved=False,
            time_s=times,
            reason=told,
            reason_code=verdict.reason.name if verdict.reason else None,
            numbers={name: value for name, value in verdict.numbers.items() if math.isfinite(value)},
            contradictions=[str(one) for one in verdict.contradictions],
            notes=list(verdict.notes),
            quality=_quality(verdict.quality),
        )
    return SolveRecord(
        file=file,
        solved=True,
        ra_deg=_finite(solution.center.ra_deg),
        dec_deg=_finite(solution.center.dec_deg),
        scale_arcsec_px=_finite(solution.scale_arcsec_px),
        rotation_deg=_finite(solution.rotation_deg),
        parity=1 if solution.parity > 0 else -1,
        center_sigma_arcsec=_finite(solution.center_sigma_arcsec),
        rms_arcsec=_finite(solution.rms_arcsec),
        pairs=solution.pairs,
        false_probability=_finite(solution.false_probability),
        mode=solution.mode,
        time_s=times,
        wcs=dict(solution.wcs),
        rejected_by=dict(solution.rejected_by),
        contradictions=[str(one) for one in verdict.contradictions],
        notes=list(verdict.notes),
        quality=_quality(verdict.quality),
    )


def unread_record(file: str, why: str) -> SolveRecord:
    """Make the record of a file that is no image."""
    return SolveRecord(
        file=file, solved=False, time_s=_times(Times()), reason=why, reason_code=Reason.BAD_FRAME.name
    )


def _quality(quality: SkyQuality | None) -> QualityRecord | None:
    if quality is None:
        return None
    return QualityRecord(
        stars=quality.stars,
        images=str(quality.images),
        fwhm_px=_maybe(quality.fwhm_px),
        fwhm_arcsec=_maybe(quality.fwhm_arcsec),
        ellipticity=_maybe(quality.ellipticity),
        elongation_deg=_maybe(quality.elongation_deg),
        sky_adu=_maybe(quality.sky_adu),
        noise_adu=_maybe(quality.noise_adu),
        sky_gradient=_maybe(quality.sky_gradient),
        saturated_share=_maybe(quality.saturated_share),
        zero_point_mag=_maybe(quality.zero_point_mag),
        limiting_mag=_maybe(quality.limiting_mag),
        sky_mag_arcsec2=_maybe(quality.sky_mag_arcsec2),
    )


def _maybe(value: float | None) -> float | None:
    return None if value is None else _finite(value)


def _times(times: Times) -> SolveTimes:
    return SolveTimes(
        read=round(times.read_s, 4),
        measure=round(times.measure_s, 4),
        identify=round(times.identify_s, 4),
        total=round(times.total_s, 4),
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
