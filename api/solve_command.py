"""`mountnav solve`: one record a file, in order; a file that is no image never stops the others."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from api.file_names import shown
from api.hints import asked_hint
from api.solve_record import SolveRecord, solve_record, unread_record
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame
from mountnav.frames import Hint
from mountnav.solve import SolveSettings, solve_file

if TYPE_CHECKING:
    from rich.console import Console


def run(
    files: list[Path],
    *,
    ra: float | None,
    dec: float | None,
    radius: float | None,
    scale: float | None,
    low: float | None,
    high: float | None,
    hdu: str | None,
    settings: SolveSettings,
    as_json: bool,
) -> int:
    """Solve the files and print; 0 if all were solved, else 1.

    Raises
    ------
    BadRequest
        Options that make no sense, alone or together; nothing was solved.
    """
    hint = asked_hint(ra, dec, radius, scale, low, high)
    catalog = embedded_catalog()
    all_solved = True
    for path in files:
        record = _solve(path, catalog, hint, int(hdu) if hdu is not None and hdu.isdigit() else hdu, settings)
        all_solved = all_solved and record.solved
        if as_json:
            sys.stdout.write(record.model_dump_json() + "\n")
            sys.stdout.flush()
        else:
            _show(record)
    return 0 if all_solved else 1


def _solve(
    path: Path, catalog: Catalog, hint: Hint | None, hdu: int | str | None, settings: SolveSettings
) -> SolveRecord:
    try:
        return solve_record(
            shown(path),
            solve_file(path, catalog, hint, name=shown(Path(path.name)), hdu=hdu, settings=settings),
        )
    except BadFrame as error:
        return unread_record(shown(path), error.what)
    except OSError as error:
        return unread_record(shown(path), f"the file can't be read: {error.strerror or error}")


def _show(record: SolveRecord) -> None:
    from rich.console import Console
    from rich.markup import escape

    console = Console(highlight=False, soft_wrap=True)
    if not record.solved:
        console.print(f"[red]✗[/red] {escape(record.file)}  not solved: {escape(record.reason or '')}")
        _show_more(console, record)
        return
    console.print(
        f"[green]✓[/green] {escape(record.file)}  "
        f"ra {record.ra_deg:.5f}°  dec {record.dec_deg:+.5f}°  "
        f"scale {record.scale_arcsec_px:.4f}″/px  rotation {record.rotation_deg:.2f}°  "
        f"parity {record.parity:+d}  rms {record.rms_arcsec:.2f}″  {record.pairs} pairs  "
        f"false {record.false_probability:.1e}  {record.mode}  {record.time_s.total:.2f} s"
    )
    _show_more(console, record)


def _show_more(console: Console, record: SolveRecord) -> None:
    """What the frame tells about the night, and which hints were wrong; indented under the file's line."""
    from rich.markup import escape

    quality = record.quality
    if quality is not None:
        told = [f"{quality.stars} stars", quality.images]
        if quality.fwhm_px is not None:
            wide = f" = {quality.fwhm_arcsec:.2f}″" if quality.fwhm_arcsec is not None else ""
            told.append(f"FWHM {quality.fwhm_px:.2f} px{wide}")
        if quality.ellipticity is not None:
            told.append(f"ellipticity {quality.ellipticity:.2f}")
        if quality.sky_adu is not None and quality.noise_adu is not None:
            told.append(f"sky {quality.sky_adu:.5g} ± {quality.noise_adu:.3g} ADU")
        if quality.sky_mag_arcsec2 is not None:
            told.append(f"{quality.sky_mag_arcsec2:.2f} mag/arcsec²")
        if quality.limiting_mag is not None:
            told.append(f"limiting magnitude {quality.limiting_mag:.1f}")
        console.print(f"    [dim]{escape(', '.join(told))}[/dim]")
    for one in record.notes:
        console.print(f"    [yellow]note:[/yellow] {escape(one)}")
    for one in record.contradictions:
        console.print(f"    [yellow]hint wrong:[/yellow] {escape(one)}")
