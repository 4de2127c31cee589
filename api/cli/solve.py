"""`mountnav solve`: one record a file, in order; a file that is no image never stops the others."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import (
    Budget,
    Calibration,
    Catalog,
    Config,
    Dec,
    Json,
    Profile,
    Ra,
    Radius,
    Scale,
)
from api.cli.output import print_json, unreadable
from mountnav.errors import BadFrame, BadSettings

if TYPE_CHECKING:
    from rich.console import Console

    from api.solver.solve_record import Answer, SolveRecord
    from mountnav.catalog.catalog_set import CatalogSet
    from mountnav.catalog.packed import PackedStore
    from mountnav.frames import Hint
    from mountnav.identification.blind.index import BlindIndex
    from mountnav.solution import Verdict
    from mountnav.solving.settings import SolveSettings

SHARE_BEFORE_INDEX = 0.5
"""Of the budget, for the first try of a frame while there is no index of the whole sky; the rest stays for
the search with it, once it is built. It happens once in an installation's life. chosen by hand: with a larger
share a frame that needs the index runs out of time more often, with a smaller one a slow but hinted frame
waits for the index in vain."""
LEAST_SHARE_AFTER_INDEX = 0.25
"""Of the budget, for the try after the index was built, even where less is left. chosen by hand: it bounds by
how much a first frame may overrun its budget."""


def solve(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Images (FITS, PNG, JPEG).")],
    ra: Ra = None,
    dec: Dec = None,
    radius: Radius = None,
    scale: Scale = None,
    scale_low: Annotated[float | None, typer.Option(help="Lower bound, arcseconds per pixel.")] = None,
    scale_high: Annotated[float | None, typer.Option(help="Upper bound, arcseconds per pixel.")] = None,
    hdu: Annotated[str | None, typer.Option(help="FITS extension, by number or name.")] = None,
    blind: Annotated[
        bool | None,
        typer.Option(
            "--blind/--no-blind",
            help="Search the whole sky and ask no hint, or never search it; else it is searched after the "
            "hint failed.",
            show_default=False,
        ),
    ] = None,
    calibration: Calibration = None,
    profile: Profile = None,
    budget: Budget = None,
    config: Config = None,
    catalog: Catalog = None,
    as_json: Json = False,
) -> None:
    """Find out where images lie in the sky. Hints not given are taken from the header.

    A frame that no hint helps with is searched for in the whole sky. The index for that is built once, on
    first need (`mountnav catalog index` builds it beforehand).

    Exit code 0 if all were solved, 1 if some were not, 2 on bad usage.
    """
    from api.cli.chosen_catalogs import chosen_shelf
    from api.solver.hints import asked_hint
    from api.solver.solve_settings import chosen_settings

    settings = chosen_settings(
        config=config,
        profile=profile,
        budget_s=budget,
        calibration=calibration,
        blind=None if blind is None else "only" if blind else "never",
    )
    shelf = chosen_shelf(config, catalog)
    hint = asked_hint(ra, dec, radius, scale, scale_low, scale_high)
    extension = int(hdu) if hdu is not None and hdu.isdigit() else hdu
    all_solved = solve_files(files, FileSolver(shelf, hint, extension, settings), as_json=as_json)
    raise typer.Exit(0 if all_solved else 1)


def solve_files(files: list[Path], solver: FileSolver, *, as_json: bool) -> bool:
    """Solve the files and print each answer at once; whether all were solved."""
    all_solved = True
    for path in files:
        answer = solver.answer(path)
        all_solved = all_solved and answer["solved"]
        if as_json:
            print_json(answer, ascii_only=False, compact=True)
            sys.stdout.flush()
        else:
            from api.solver.solve_record import SolveRecord

            _show(SolveRecord.model_validate(answer))
    return all_solved


class FileSolver:
    """Solves one file after the other; the index of the whole sky is got when the first one needs it.

    Raises
    ------
    BadSettings
        Only the whole sky is to be searched, and the index for it can't be built.
    """

    def __init__(
        self, catalog: CatalogSet, hint: Hint | None, hdu: int | str | None, settings: SolveSettings
    ) -> None:
        self._catalog = catalog
        self._hint = hint
        self._hdu = hdu
        self._no_index: str | None = None
        if settings.blind == "only":
            settings = replace(settings, index=open_or_build_index(self._catalog.indexed))
        elif settings.blind == "after":
            settings = replace(settings, index=_index_built_before(self._catalog.indexed))
        self._settings = settings

    def answer(self, path: Path) -> Answer:
        """Solve a file: without an index first, if there is none yet."""
        from api.http.file_names import shown
        from api.solver.solve_record import solve_answer, unread_answer

        try:
            verdict = self._verdict_of(path)
        except BadFrame as error:
            return unread_answer(shown(path), error.what)
        except OSError as error:
            return unread_answer(shown(path), unreadable(error))
        if self._no_index is not None and verdict.solution is None:
            verdict = replace(verdict, notes=(*verdict.notes, self._no_index))
        return solve_answer(shown(path), verdict)

    def _verdict_of(self, path: Path) -> Verdict:
        from mountnav.solution import Reason

        budget_s = self._settings.budget_s
        if not self._index_may_come:
            return self._solve(path, budget_s)
        verdict = self._solve(path, SHARE_BEFORE_INDEX * budget_s)
        reason = verdict.reason
        if reason is None or not reason.whole_sky_may_help:
            return verdict
        left_s = budget_s - verdict.times.identify_s
        try:
            self._settings = replace(self._settings, index=open_or_build_index(self._catalog.indexed))
        except BadSettings as refused:
            self._no_index = f"the whole sky was not searched: {refused}"
            return self._solve(path, budget_s) if reason is Reason.TIMED_OUT else verdict
        return self._solve(path, max(left_s, LEAST_SHARE_AFTER_INDEX * budget_s))

    def _solve(self, path: Path, budget_s: float) -> Verdict:
        from api.http.file_names import shown
        from mountnav.solving.solve import solve_file

        name = shown(Path(path.name))
        settings = replace(self._settings, budget_s=budget_s)
        return solve_file(path, self._catalog, self._hint, name=name, hdu=self._hdu, settings=settings)

    @property
    def _index_may_come(self) -> bool:
        """Whether a frame that isn't solved has the index built."""
        return self._settings.blind == "after" and self._settings.index is None and self._no_index is None


def _index_built_before(catalog: PackedStore) -> BlindIndex | None:
    """Open the index if it was built before; a damaged one is built again when it is needed."""
    from mountnav.identification.blind.cache import installed_index

    return installed_index(catalog)


def open_or_build_index(catalog: PackedStore) -> BlindIndex:
    """Open the index of the whole sky, or build it under a progress bar. Raises `BadSettings`."""
    from api.cli.catalog_import import built_with_progress

    return built_with_progress(catalog)


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
        parts = [f"{quality.stars} stars", quality.images]
        if quality.fwhm_px is not None:
            wide = f" = {quality.fwhm_arcsec:.2f}″" if quality.fwhm_arcsec is not None else ""
            parts.append(f"FWHM {quality.fwhm_px:.2f} px{wide}")
        if quality.ellipticity is not None:
            parts.append(f"ellipticity {quality.ellipticity:.2f}")
        if quality.sky_adu is not None and quality.noise_adu is not None:
            parts.append(f"sky {quality.sky_adu:.5g} ± {quality.noise_adu:.3g} ADU")
        if quality.sky_mag_arcsec2 is not None:
            parts.append(f"{quality.sky_mag_arcsec2:.2f} mag/arcsec²")
        if quality.limiting_mag is not None:
            parts.append(f"limiting magnitude {quality.limiting_mag:.1f}")
        console.print(f"    [dim]{escape(', '.join(parts))}[/dim]")
    if record.catalog_steps:
        errors = record.errors_arcsec
        words = "; ".join(record.catalog_steps)
        if errors is not None:
            words += f"; errors: centroid {errors.centroid:.2g}″, catalog {errors.catalog:.2g}″"
            words += f", other {errors.other:.2g}″"
        console.print(f"    [dim]catalog: {escape(words)}[/dim]")
    for note in record.notes:
        console.print(f"    [yellow]note:[/yellow] {escape(note)}")
    for contradiction in record.contradictions:
        console.print(f"    [yellow]hint wrong:[/yellow] {escape(contradiction)}")
