"""`mountnav solve`: one record a file, in order; a file that is no image never stops the others."""

from __future__ import annotations

import math
import sys
from pathlib import Path

from api.hints import make_hint
from api.solve_record import SolveRecord, solve_record, unread_record
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, BadRequest
from mountnav.frames import Hint
from mountnav.solve import solve_file

SCALE_TOLERANCE = 0.05


def run(
    files: list[Path],
    *,
    ra: float | None,
    dec: float | None,
    radius: float | None,
    scale: float | None,
    low: float | None,
    high: float | None,
    as_json: bool,
) -> int:
    """Solve the files and print; 0 if all were solved, else 1.

    Raises
    ------
    BadRequest
        Options that make no sense, alone or together; nothing was solved.
    """
    hint = _hint(ra, dec, radius, scale, low, high)
    catalog = embedded_catalog()
    all_solved = True
    for path in files:
        record = _solve(path, catalog, hint)
        all_solved = all_solved and record.solved
        if as_json:
            sys.stdout.write(record.model_dump_json() + "\n")
            sys.stdout.flush()
        else:
            _show(record)
    return 0 if all_solved else 1


def _solve(path: Path, catalog: Catalog, hint: Hint | None) -> SolveRecord:
    try:
        return solve_record(str(path), solve_file(path, catalog, hint))
    except BadFrame as error:
        return unread_record(str(path), error.what)
    except OSError as error:
        return unread_record(str(path), f"the file can't be read: {error.strerror or error}")


def _hint(
    ra: float | None,
    dec: float | None,
    radius: float | None,
    scale: float | None,
    low: float | None,
    high: float | None,
) -> Hint | None:
    _require("--ra", ra, 0.0, 360.0)
    _require("--dec", dec, -90.0, 90.0)
    for name, value, greatest in (
        ("--radius", radius, 180.0),
        ("--scale", scale, 3600.0),
        ("--scale-low", low, 3600.0),
        ("--scale-high", high, 3600.0),
    ):
        _require(name, value, 1e-6, greatest)
    if scale is not None:
        if low is not None or high is not None:
            raise BadRequest("--scale and --scale-low/--scale-high together", advice="give one or the other")
        low, high = scale * (1 - SCALE_TOLERANCE), scale * (1 + SCALE_TOLERANCE)
    return make_hint(ra, dec, radius, low, high)


def _require(name: str, value: float | None, least: float, greatest: float) -> None:
    if value is not None and not (math.isfinite(value) and least <= value <= greatest):
        raise BadRequest(f"{name} {value} is out of range", advice=f"{least:g} to {greatest:g}")


def _show(record: SolveRecord) -> None:
    from rich.console import Console
    from rich.markup import escape

    console = Console(highlight=False, soft_wrap=True)
    if not record.solved:
        console.print(f"[red]✗[/red] {escape(record.file)}  not solved: {escape(record.reason or '')}")
        return
    console.print(
        f"[green]✓[/green] {escape(record.file)}  "
        f"ra {record.ra_deg:.5f}°  dec {record.dec_deg:+.5f}°  "
        f"scale {record.scale_arcsec_px:.4f}″/px  rotation {record.rotation_deg:.2f}°  "
        f"parity {record.parity:+d}  rms {record.rms_arcsec:.2f}″  {record.pairs} pairs  "
        f"false {record.false_probability:.1e}  {record.mode}  {record.time_s.total:.2f} s"
    )
