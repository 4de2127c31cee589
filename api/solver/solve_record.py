"""The record of a solve, which `mountnav solve --json` prints and POST /v1/solve answers.

`api.solver.solve_answer` makes it as plain values; `SolveRecord` describes it as a model.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from api.solver.solve_answer import solve_answer
from mountnav.solution import Verdict


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
    wcs: dict[str, str | int | float] | None = Field(
        default=None, description="FITS cards: TAN, TAN-SIP, or ZPN of a lens too wide for these"
    )
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
