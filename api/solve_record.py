"""The record of a solve: the one shape that `mountnav solve --json` prints and POST /v1/solve answers."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, Field

from mountnav.solution import Times, Verdict


class SolveTimes(BaseModel):
    """Wall seconds spent."""

    read: float
    measure: float
    identify: float
    total: float


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
    reason: str | None = Field(default=None, description="Why it was not solved")


def solve_record(file: str, verdict: Verdict) -> SolveRecord:
    """Make the record of a verdict; NaN and infinities become null."""
    times = _times(verdict.times)
    solution = verdict.solution
    if solution is None:
        reason = str(verdict.reason) if verdict.reason else "not solved"
        told = f"{reason}: {verdict.detail}" if verdict.detail else reason
        return SolveRecord(file=file, solved=False, time_s=times, reason=told)
    return SolveRecord(
        file=file,
        solved=True,
        ra_deg=_finite(solution.center.ra_deg),
        dec_deg=_finite(solution.center.dec_deg),
        scale_arcsec_px=_finite(solution.scale_arcsec_px),
        rotation_deg=_finite(solution.rotation_deg),
        parity=1 if solution.parity > 0 else -1,
        rms_arcsec=_finite(solution.rms_arcsec),
        pairs=solution.pairs,
        false_probability=_finite(solution.false_probability),
        mode=solution.mode,
        time_s=times,
        wcs=dict(solution.wcs),
    )


def unread_record(file: str, why: str) -> SolveRecord:
    """Make the record of a file that is no image."""
    return SolveRecord(file=file, solved=False, time_s=_times(Times()), reason=why)


def _times(times: Times) -> SolveTimes:
    return SolveTimes(
        read=round(times.read_s, 4),
        measure=round(times.measure_s, 4),
        identify=round(times.identify_s, 4),
        total=round(times.total_s, 4),
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
