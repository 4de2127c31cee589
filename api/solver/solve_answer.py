"""A solve's answer as plain values, as `mountnav solve --json` prints it; `solve_record` describes it.

Apart from the model: a command has no use for it, and pydantic takes an eighth of a lone command's start.
"""

from __future__ import annotations

import math
from typing import Any

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
