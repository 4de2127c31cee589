"""`mountnav series`: a table of frames, the drift below it; or one JSON object for programs."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.cli.options import Budget, Calibration, Catalog, Config, Dec, Json, Profile, Ra, Radius, Scale
from api.cli.output import finite_or_none, print_json, unreadable
from mountnav.errors import BadFrame, BadRequest

if TYPE_CHECKING:
    from mountnav.catalog.catalog_set import CatalogSet
    from mountnav.frames import Hint
    from mountnav.identification.blind.index import BlindIndex
    from mountnav.series.drift import Drift
    from mountnav.series.follow import SeriesFollower
    from mountnav.series.results import FrameResult, SeriesReport
    from mountnav.solving.settings import SolveSettings

HEAD = "  #  mode          shift x ± se        shift y ± se      of       RA °      Dec °  acks  pers  frame"


def series(
    frames: Annotated[list[Path], typer.Argument(metavar="FRAME...", help="Images, in order of time.")],
    ra: Ra = None,
    dec: Dec = None,
    radius: Radius = None,
    scale: Scale = None,
    audit: Annotated[
        int, typer.Option(metavar="N", help="Check every Nth frame by a full solution; 0: never.")
    ] = 10,
    calibration: Calibration = None,
    profile: Profile = None,
    budget: Budget = None,
    config: Config = None,
    catalog: Catalog = None,
    as_json: Json = False,
) -> None:
    """Follow a series of frames: one is solved, the rest placed by their shift; tells the mount's drift.

    Exit code 0 if all frames were placed, 1 if some were not, 2 on bad usage.
    """
    from api.cli.chosen_catalogs import chosen_shelf
    from api.solver.hints import asked_hint
    from api.solver.solve_settings import chosen_section, solve_settings
    from mountnav.series.follow import SeriesFollower
    from mountnav.series.results import SeriesSettings

    section = chosen_section(config, profile, budget)
    solving = solve_settings(section, calibration=calibration)
    shelf = chosen_shelf(config, catalog)
    if audit < 0:
        raise BadRequest(f"--audit {audit} is out of range", advice="0 (never) or more")
    hint = asked_hint(ra, dec, radius, scale)
    solving = replace(solving, index=_index_of_the_sky(solving, shelf, hint, frames))
    settings = SeriesSettings(solving=solving, audit_every=audit, preliminary=section.preliminary_settings)
    follower = SeriesFollower(shelf, hint=hint, settings=settings)
    _follow(follower, frames)
    report = follower.report()
    if as_json:
        print_json(series_record(report, [str(path) for path in frames]))
    else:
        _show(report)
    raise typer.Exit(0 if all(frame.solution is not None for frame in report.frames) else 1)


def _index_of_the_sky(
    solving: SolveSettings, shelf: CatalogSet, hint: Hint | None, frames: list[Path]
) -> BlindIndex | None:
    """The index for a blind search, where it may be needed: built only if no hint tells where to look."""
    from api.cli.solve import open_or_build_index
    from mountnav.identification.blind.cache import installed_index
    from mountnav.reading import read_frame

    if solving.blind == "never":
        return None
    index = installed_index(shelf.indexed)
    if index is not None or (hint is not None and hint.center is not None):
        return index
    for path in frames:
        try:
            frame = read_frame(path, raw=True)
        except BadFrame:
            continue
        if solving.blind == "after" and frame.hint.center is not None:
            return None
        return open_or_build_index(shelf.indexed)
    return None


def _follow(follower: SeriesFollower, files: list[Path]) -> None:
    """Add the frames one after the other; a person at a terminal sees how many are done."""
    from mountnav.reading import read_frame

    for number, path in enumerate(files, 1):
        try:
            frame = read_frame(path, raw=True)
        except BadFrame as fault:
            follower.add_unread(path.name, fault.what)
        except OSError as fault:
            follower.add_unread(path.name, unreadable(fault))
        else:
            follower.add(frame)
        if sys.stderr.isatty():
            sys.stderr.write(f"\r\x1b[K{number} of {len(files)}")
            sys.stderr.flush()
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")


def series_record(report: SeriesReport, files: list[str]) -> dict[str, Any]:
    """The JSON object of a series, as docs/how-to/series.md has it; `files` are the paths of its frames."""
    return {
        "frames": [_frame_record(frame, file) for frame, file in zip(report.frames, files, strict=True)],
        "segments": [
            {
                "frames": list(segment.frames),
                "jump_arcsec": {"east": segment.jump.east_arcsec, "north": segment.jump.north_arcsec}
                if segment.jump
                else None,
                "drift": _drift_record(segment.drift),
                "reason": segment.reason or None,
            }
            for segment in report.segments
        ],
        "drift": _drift_record(report.drift),
        "reason": report.reason or None,
        "persistent_sources": len(report.persistent) if report.persistent is not None else 0,
    }


def _frame_record(frame: FrameResult, file: str) -> dict[str, Any]:
    shift, solution = frame.shift, frame.solution
    return {
        "file": file,
        "mid_exposure_utc": frame.mid_exposure_utc.isoformat() if frame.mid_exposure_utc else None,
        "mode": str(frame.mode),
        "solved": solution is not None,
        "ra_deg": finite_or_none(solution.center.ra_deg) if solution else None,
        "dec_deg": finite_or_none(solution.center.dec_deg) if solution else None,
        "center_sigma_arcsec": finite_or_none(solution.center_sigma_arcsec) if solution else None,
        "rotation_deg": finite_or_none(solution.rotation_deg) if solution else None,
        "scale_arcsec_px": finite_or_none(solution.scale_arcsec_px) if solution else None,
        "false_probability": finite_or_none(solution.false_probability) if solution else None,
        "shift": None
        if shift is None
        else {
            "anchor": shift.anchor,
            "dx_px": finite_or_none(shift.dx_px),
            "dy_px": finite_or_none(shift.dy_px),
            "dx_sigma_px": finite_or_none(shift.dx_sigma_px),
            "dy_sigma_px": finite_or_none(shift.dy_sigma_px),
            "mean_dx_px": finite_or_none(shift.mean_dx_px),
            "mean_dy_px": finite_or_none(shift.mean_dy_px),
            "pairs": shift.pairs,
            "strobes": shift.strobes,
            "acknowledged": shift.acknowledged,
            "false_probability": finite_or_none(shift.false_probability),
        },
        "audit_arcsec": None
        if frame.audit is None
        else {
            "east": finite_or_none(frame.audit.east_arcsec),
            "north": finite_or_none(frame.audit.north_arcsec),
        },
        "measured": frame.measured,
        "persistent": frame.persistent,
        "notes": list(frame.notes),
        "time_s": {
            "measure": round(frame.times.measure_s, 4),
            "preliminary": round(frame.times.preliminary_s, 5),
            "full": round(frame.times.full_s, 4),
        },
    }


def _drift_record(drift: Drift | None) -> dict[str, Any] | None:
    if drift is None:
        return None
    return {
        "ra_cosdec_arcsec_min": finite_or_none(drift.ra_arcsec_min),
        "ra_cosdec_sigma_arcsec_min": finite_or_none(drift.ra_sigma_arcsec_min),
        "dec_arcsec_min": finite_or_none(drift.dec_arcsec_min),
        "dec_sigma_arcsec_min": finite_or_none(drift.dec_sigma_arcsec_min),
        "rms_arcsec": finite_or_none(drift.rms_arcsec),
        "frames": drift.frames,
        "outliers": drift.outliers,
    }


def _show(report: SeriesReport) -> None:
    lines = [HEAD]
    for frame in report.frames:
        lines.append(_row(frame))
        for note in frame.notes:
            lines.append(f"       {note}")
            if note == "audit" and frame.audit is not None:
                lines[-1] += (
                    f": full solution minus shift {frame.audit.east_arcsec:+.2f}″ east, "
                    f"{frame.audit.north_arcsec:+.2f}″ north"
                )
    lines.append("")
    many = len(report.segments) > 1
    for number, segment in enumerate(report.segments if many else ()):
        if segment.jump is not None:
            lines.append(
                f"jump before frame {segment.frames[0]}: {segment.jump.east_arcsec:+.1f}″ east, "
                f"{segment.jump.north_arcsec:+.1f}″ north"
            )
        line = _drift_line(segment.drift) if segment.drift else f"no drift: {segment.reason}"
        lines.append(f"segment {number + 1}, {len(segment.frames)} frames: {line}")
    if report.drift is not None:
        lines.append(("all segments: " if many else "drift: ") + _drift_line(report.drift))
    else:
        lines.append(f"no drift: {report.reason}")
    if report.persistent is not None:
        lines.append(f"{len(report.persistent)} persistent sources")
    sys.stdout.write("\n".join(lines) + "\n")


def _row(frame: FrameResult) -> str:
    from mountnav.series.results import Mode

    mode = "-" if frame.mode is Mode.NONE else str(frame.mode)
    row = f"{frame.number:3d}  {mode:11s}"
    shift = frame.shift
    if shift is not None:
        row += (
            f"{shift.dx_px:+11.3f} ± {shift.dx_sigma_px:5.3f}{shift.dy_px:+12.3f} ± {shift.dy_sigma_px:5.3f}"
            f"{'#' + str(shift.anchor):>8s}"
        )
    else:
        row += " " * 47
    center = frame.center
    row += f"{center.ra_deg:11.5f}{center.dec_deg:+11.5f}" if center is not None else " " * 22
    acknowledged = f"{shift.acknowledged}/{shift.strobes}" if shift is not None else ""
    return f"{row} {acknowledged:>5s} {frame.persistent:5d}  {frame.source}"


def _drift_line(drift: Drift) -> str:
    line = (
        f"RA {drift.ra_arcsec_min:+.3f} ± {drift.ra_sigma_arcsec_min:.3f} ″/min (times cos δ), "
        f"Dec {drift.dec_arcsec_min:+.3f} ± {drift.dec_sigma_arcsec_min:.3f} ″/min; "
        f"{drift.frames} frames, scatter {drift.rms_arcsec:.2f}″"
    )
    return line + (f", {drift.outliers} outliers" if drift.outliers else "")
