"""`mountnav series`: a table of frames, the drift below it; or one JSON object for programs."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

from api.solver.hints import asked_hint
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, BadRequest
from mountnav.identification.settings import PreliminarySettings
from mountnav.reading import read_frame
from mountnav.series.drift import Drift
from mountnav.series.follow import SeriesFollower
from mountnav.series.results import FrameResult, Mode, SeriesReport, SeriesSettings
from mountnav.solving.solve import SolveSettings

HEAD = "  #  mode          shift x ± se        shift y ± se      of       RA °      Dec °  acks  pers  frame"


def run(
    files: list[Path],
    *,
    ra: float | None,
    dec: float | None,
    radius: float | None,
    scale: float | None,
    audit: int,
    preliminary: PreliminarySettings,
    solving: SolveSettings,
    catalog: Catalog,
    as_json: bool,
) -> int:
    """Follow the series and print; 0 if every frame was placed in the sky, else 1.

    Raises
    ------
    BadRequest
        Options that make no sense, alone or together; nothing was done.
    """
    if audit < 0:
        raise BadRequest(f"--audit {audit} is out of range", advice="0 (never) or more")
    hint = asked_hint(ra, dec, radius, scale)
    settings = SeriesSettings(solving=solving, audit_every=audit, preliminary=preliminary)
    follower = SeriesFollower(catalog, hint=hint, settings=settings)
    for number, path in enumerate(files):
        try:
            frame = read_frame(path, raw=True)
        except BadFrame as fault:
            follower.add_unread(path.name, fault.what)
        except OSError as fault:
            follower.add_unread(path.name, f"the file can't be read: {fault.strerror or fault}")
        else:
            follower.add(frame)
        if sys.stderr.isatty():
            sys.stderr.write(f"\r\x1b[K{number + 1} of {len(files)}")
            sys.stderr.flush()
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")
    report = follower.report()
    if as_json:
        sys.stdout.write(
            json.dumps(series_record(report, [str(one) for one in files]), allow_nan=False) + "\n"
        )
    else:
        _show(report)
    return 0 if all(one.solution is not None for one in report.frames) else 1


def series_record(report: SeriesReport, files: list[str]) -> dict[str, Any]:
    """Make the JSON object of a series; docs/series.md describes it.

    Parameters
    ----------
    report : SeriesReport
    files : list of str
        The frames' paths, in order.

    Returns
    -------
    dict
        Plain values only; NaN and infinities become null.
    """
    return {
        "frames": [_frame_record(one, file) for one, file in zip(report.frames, files, strict=True)],
        "segments": [
            {
                "frames": list(one.frames),
                "jump_arcsec": {"east": one.jump.east_arcsec, "north": one.jump.north_arcsec}
                if one.jump
                else None,
                "drift": _drift_record(one.drift),
                "reason": one.reason or None,
            }
            for one in report.segments
        ],
        "drift": _drift_record(report.drift),
        "reason": report.reason or None,
        "persistent_sources": len(report.persistent) if report.persistent is not None else 0,
    }


def _frame_record(one: FrameResult, file: str) -> dict[str, Any]:
    shift, solution = one.shift, one.solution
    return {
        "file": file,
        "mid_exposure_utc": one.mid_exposure_utc.isoformat() if one.mid_exposure_utc else None,
        "mode": str(one.mode),
        "solved": solution is not None,
        "ra_deg": _finite(solution.center.ra_deg) if solution else None,
        "dec_deg": _finite(solution.center.dec_deg) if solution else None,
        "center_sigma_arcsec": _finite(solution.center_sigma_arcsec) if solution else None,
        "rotation_deg": _finite(solution.rotation_deg) if solution else None,
        "scale_arcsec_px": _finite(solution.scale_arcsec_px) if solution else None,
        "false_probability": _finite(solution.false_probability) if solution else None,
        "shift": None
        if shift is None
        else {
            "anchor": shift.anchor,
            "dx_px": _finite(shift.dx_px),
            "dy_px": _finite(shift.dy_px),
            "dx_sigma_px": _finite(shift.dx_sigma_px),
            "dy_sigma_px": _finite(shift.dy_sigma_px),
            "mean_dx_px": _finite(shift.mean_dx_px),
            "mean_dy_px": _finite(shift.mean_dy_px),
            "pairs": shift.pairs,
            "strobes": shift.strobes,
            "acknowledged": shift.acknowledged,
            "false_probability": _finite(shift.false_probability),
        },
        "audit_arcsec": None
        if one.audit is None
        else {"east": _finite(one.audit.east_arcsec), "north": _finite(one.audit.north_arcsec)},
        "measured": one.measured,
        "persistent": one.persistent,
        "notes": list(one.notes),
        "time_s": {
            "measure": round(one.times.measure_s, 4),
            "preliminary": round(one.times.preliminary_s, 5),
            "full": round(one.times.full_s, 4),
        },
    }


def _drift_record(drift: Drift | None) -> dict[str, Any] | None:
    if drift is None:
        return None
    return {
        "ra_cosdec_arcsec_min": _finite(drift.ra_arcsec_min),
        "ra_cosdec_sigma_arcsec_min": _finite(drift.ra_sigma_arcsec_min),
        "dec_arcsec_min": _finite(drift.dec_arcsec_min),
        "dec_sigma_arcsec_min": _finite(drift.dec_sigma_arcsec_min),
        "rms_arcsec": _finite(drift.rms_arcsec),
        "frames": drift.frames,
        "outliers": drift.outliers,
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _show(report: SeriesReport) -> None:
    lines = [HEAD]
    for one in report.frames:
        lines.append(_row(one))
        for note in one.notes:
            lines.append(f"       {note}")
            if note == "audit" and one.audit is not None:
                lines[-1] += (
                    f": full solution minus shift {one.audit.east_arcsec:+.2f}″ east, "
                    f"{one.audit.north_arcsec:+.2f}″ north"
                )
    lines.append("")
    many = len(report.segments) > 1
    for number, segment in enumerate(report.segments if many else ()):
        if segment.jump is not None:
            lines.append(
                f"jump before frame {segment.frames[0]}: {segment.jump.east_arcsec:+.1f}″ east, "
                f"{segment.jump.north_arcsec:+.1f}″ north"
            )
        told = _drift_line(segment.drift) if segment.drift else f"no drift: {segment.reason}"
        lines.append(f"segment {number + 1}, {len(segment.frames)} frames: {told}")
    if report.drift is not None:
        lines.append(("all segments: " if many else "drift: ") + _drift_line(report.drift))
    else:
        lines.append(f"no drift: {report.reason}")
    if report.persistent is not None:
        lines.append(f"{len(report.persistent)} persistent sources")
    sys.stdout.write("\n".join(lines) + "\n")


def _row(one: FrameResult) -> str:
    mode = "-" if one.mode is Mode.NONE else str(one.mode)
    row = f"{one.number:3d}  {mode:11s}"
    shift = one.shift
    if shift is not None:
        row += (
            f"{shift.dx_px:+11.3f} ± {shift.dx_sigma_px:5.3f}{shift.dy_px:+12.3f} ± {shift.dy_sigma_px:5.3f}"
            f"{'#' + str(shift.anchor):>8s}"
        )
    else:
        row += " " * 47
    center = one.center
    row += f"{center.ra_deg:11.5f}{center.dec_deg:+11.5f}" if center is not None else " " * 22
    acknowledged = f"{shift.acknowledged}/{shift.strobes}" if shift is not None else ""
    return f"{row} {acknowledged:>5s} {one.persistent:5d}  {one.source}"


def _drift_line(drift: Drift) -> str:
    line = (
        f"RA {drift.ra_arcsec_min:+.3f} ± {drift.ra_sigma_arcsec_min:.3f} ″/min (times cos δ), "
        f"Dec {drift.dec_arcsec_min:+.3f} ± {drift.dec_sigma_arcsec_min:.3f} ″/min; "
        f"{drift.frames} frames, scatter {drift.rms_arcsec:.2f}″"
    )
    return line + (f", {drift.outliers} outliers" if drift.outliers else "")
