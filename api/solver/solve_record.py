"""The record of a solve, which `mountnav solve --json` prints and POST /v1/solve answers.

`solve_answer` makes it as plain values; `SolveRecord` describes it as a model.
"""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import BaseModel, Field

from mountnav.measuring.measurements import SkyQuality
from mountnav.solution import ErrorBudget, Reason, Times, Verdict

Answer = dict[str, Any]

_NOTHING: Answer = dict.fromkeys(
    (
        *("file", "solved", "ra_deg", "dec_deg", "scale_arcsec_px", "rotation_deg", "parity", "rms_arcsec"),
        *("pairs", "false_probability", "mode", "time_s", "wcs", "reason", "center_sigma_arcsec"),
        *("rejected_by", "reason_code", "numbers", "contradictions", "notes", "quality"),
        *("catalog", "catalog_steps", "errors_arcsec"),
    )
)


def solve_answer(file: str, verdict: Verdict) -> Answer:
    """Make the answer of a verdict.

    Parameters
    ----------
    file : str
        What to call the frame.

    Returns
    -------
    dict
        The fields of `api.solver.solve_record.SolveRecord`, in their order; NaN and infinities become None.
    """
    answer = _NOTHING | {
        "file": file,
        "solved": verdict.solution is not None,
        "time_s": _times(verdict.times),
        "contradictions": [str(contradiction) for contradiction in verdict.contradictions],
        "notes": list(verdict.notes),
        "quality": None if verdict.quality is None else _quality(verdict.quality),
    }
    solution = verdict.solution
    if solution is None:
        reason = str(verdict.reason) if verdict.reason else "not solved"
        return answer | {
            "reason": f"{reason}: {verdict.detail}" if verdict.detail else reason,
            "reason_code": verdict.reason.name if verdict.reason else None,
            "numbers": {
                name: float(value) for name, value in verdict.numbers.items() if math.isfinite(value)
            },
        }
    return answer | {
        "ra_deg": _finite(solution.center.ra_deg),
        "dec_deg": _finite(solution.center.dec_deg),
        "scale_arcsec_px": _finite(solution.scale_arcsec_px),
        "rotation_deg": _finite(solution.rotation_deg),
        "parity": 1 if solution.parity > 0 else -1,
        "center_sigma_arcsec": _finite(solution.center_sigma_arcsec),
        "rms_arcsec": _finite(solution.rms_arcsec),
        "pairs": int(solution.pairs),
        "false_probability": _finite(solution.false_probability),
        "mode": solution.mode,
        "wcs": dict(solution.wcs),
        "rejected_by": {rule: int(count) for rule, count in solution.rejected_by.items()},
        "catalog": solution.catalog,
        "catalog_steps": list(solution.catalog_steps),
        "errors_arcsec": None if solution.errors is None else _errors(solution.errors),
    }


def _errors(errors: ErrorBudget) -> Answer:
    return {
        "centroid": _finite(errors.centroid_arcsec),
        "catalog": _finite(errors.catalog_arcsec),
        "other": _finite(errors.other_arcsec),
        "expected": _finite(errors.expected_arcsec),
    }


def unread_answer(file: str, why: str) -> Answer:
    """Make the answer for a file that is no image; as for `solve_answer`."""
    return _NOTHING | {
        "file": file,
        "solved": False,
        "time_s": _times(Times()),
        "reason": why,
        "reason_code": Reason.BAD_FRAME.name,
        "contradictions": [],
        "notes": [],
    }


def _quality(quality: SkyQuality) -> Answer:
    return {
        "stars": int(quality.stars),
        "images": str(quality.images),
        "fwhm_px": _finite(quality.fwhm_px),
        "fwhm_arcsec": _finite(quality.fwhm_arcsec),
        "ellipticity": _finite(quality.ellipticity),
        "elongation_deg": _finite(quality.elongation_deg),
        "sky_adu": _finite(quality.sky_adu),
        "noise_adu": _finite(quality.noise_adu),
        "sky_gradient": _finite(quality.sky_gradient),
        "saturated_share": _finite(quality.saturated_share),
        "zero_point_mag": _finite(quality.zero_point_mag),
        "limiting_mag": _finite(quality.limiting_mag),
        "sky_mag_arcsec2": _finite(quality.sky_mag_arcsec2),
    }


def _times(times: Times) -> Answer:
    return {
        "read": round(times.read_s, 4),
        "measure": round(times.measure_s, 4),
        "identify": round(times.identify_s, 4),
        "total": round(times.total_s, 4),
    }


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


class SolveTimes(BaseModel):
    """Wall seconds spent."""

    read: float
    measure: float
    identify: float
    total: float


class QualityRecord(BaseModel):
    """What the frame tells about the night; null where it can't be told."""

    stars: int = Field(description="Star-like sources measured; at a glance at most 200")
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


class ErrorsRecord(BaseModel):
    """Where the residuals come from: arcsec per coordinate, root mean square over the pairs."""

    centroid: float | None = Field(description="Noise of the measured places")
    catalog: float | None = Field(description="The catalog's own errors at the frame's epoch")
    other: float | None = Field(description="What neither knows of: seeing, finer distortions")
    expected: float | None = Field(description="All of it together")


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
    catalog: str | None = Field(default=None, description="Whose stars the plate rests on")
    catalog_steps: list[str] | None = Field(
        default=None, description="Why that catalog, and how its stars were come by"
    )
    errors_arcsec: ErrorsRecord | None = Field(default=None, description="Where the residuals come from")


def solve_record(file: str, verdict: Verdict) -> SolveRecord:
    """Make the record of a verdict; NaN and infinities become null."""
    return SolveRecord.model_validate(solve_answer(file, verdict))
