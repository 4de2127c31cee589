"""`mountnav solve`: one record a frame, in order; a file that is no image never stops the others.

How many frames are gone through is in `api.cli.solve_run`, what is read and written in `api.batch`.
"""

from __future__ import annotations

import os
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
from mountnav.errors import BadFrame, BadRequest, BadSettings

if TYPE_CHECKING:
    from rich.console import Console

    from api.batch.inputs import FrameFile
    from api.batch.outcomes import Outcome
    from api.solver.solve_record import SolveRecord
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


MOST_JOBS = 256
"""Processes that may be asked for. Each takes some 150 MB: more is a typing error."""


def solve(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[FILE...]",
            help="Images (FITS, XISF, PNG, JPEG, TIFF, raw), folders of them, or patterns.",
            show_default=False,
        ),
    ] = None,
    ra: Ra = None,
    dec: Dec = None,
    radius: Radius = None,
    scale: Scale = None,
    scale_low: Annotated[float | None, typer.Option(help="Lower bound, arcseconds per pixel.")] = None,
    scale_high: Annotated[float | None, typer.Option(help="Upper bound, arcseconds per pixel.")] = None,
    hdu: Annotated[
        str | None, typer.Option("--hdu", "--extension", help="FITS extension, by number or name, or all.")
    ] = None,
    blind: Annotated[
        bool | None,
        typer.Option(
            "--blind/--no-blind",
            help="Search the whole sky and ask no hint but --scale, or never search it; else it is searched "
            "after the hint failed.",
            show_default=False,
        ),
    ] = None,
    calibration: Calibration = None,
    profile: Profile = None,
    budget: Budget = None,
    config: Config = None,
    catalog: Catalog = None,
    listed: Annotated[
        str | None,
        typer.Option("--list", metavar="FILE", help="Names of more frames, one a line; - reads them here."),
    ] = None,
    jobs: Annotated[
        int, typer.Option(min=0, max=MOST_JOBS, help="Processes that solve side by side; 0: one a core.")
    ] = 1,
    as_json: Json = False,
    csv: Annotated[
        str | None, typer.Option(metavar="FILE", help="Add a row a frame to this CSV file; - prints it.")
    ] = None,
    ecsv: Annotated[
        str | None, typer.Option(metavar="FILE", help="The same as ECSV, with units; - prints it.")
    ] = None,
    parquet: Annotated[str | None, typer.Option(metavar="FILE", help="The same as Parquet.")] = None,
    resume: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Pass over frames whose content this result file holds (.jsonl, .csv, .ecsv, .parquet). If "
            "no other result file is named, what is new is added to it.",
        ),
    ] = None,
    retry: Annotated[
        bool, typer.Option("--retry", help="With --resume: try again what is held as not solved.")
    ] = False,
    wcs: Annotated[bool, typer.Option("--wcs", help="Write a .wcs file beside each frame.")] = False,
    update: Annotated[
        bool, typer.Option("--update", help="Write the solution into the header of each FITS file.")
    ] = False,
    pairs: Annotated[
        str | None, typer.Option(metavar="FILE", help="Add the identified stars to this ECSV file.")
    ] = None,
    annotate: Annotated[
        str | None,
        typer.Option(metavar="PNG|FOLDER", help="Draw the frame with its stars; a folder for several."),
    ] = None,
) -> None:
    """Find out where images lie in the sky. Hints not given are taken from the header.

    A frame that no hint helps with is searched for in the whole sky. The index for that is built once, on
    first need (`mountnav catalog index` builds it beforehand).

    Exit code 0 if all were solved, 1 if some were not or something couldn't be written, 2 on bad usage, 130
    when interrupted.
    """
    from mountnav.start_up import keep_memory, no_garbage_sought, put_off_unused

    put_off_unused()
    with no_garbage_sought():
        import mountnav.solving.solve  # noqa: F401 - for what it imports
        from api.batch.inputs import found_files
        from api.batch.result_files import Held
        from api.batch.writing import Wanted, Writing
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
    extension = int(hdu) if hdu is not None and hdu.isdecimal() else hdu
    paths = found_files(files or [], listed)
    if annotate is not None:  # pictures of a former run are no frames of this one
        paths = [path for path in paths if Path(annotate) not in path.parents]
    if retry and resume is None:
        raise BadRequest("--retry without --resume", advice="name the result file to resume from")
    held = None if resume is None else Held(resume, retry=retry)
    apart = any(path is not None for path in (csv, ecsv, parquet))
    wanted = Wanted(
        csv=csv,
        ecsv=ecsv,
        parquet=parquet,
        pairs=pairs,
        results=None if apart else resume,
        wcs=wcs,
        update=update,
        annotate=annotate,
    )
    _require_one_on_standard_output(as_json, csv, ecsv, pairs)
    silent = "-" in (csv, ecsv, pairs)
    writing = Writing(wanted, paths, _print_nothing if silent else _print_json if as_json else _print)
    if held is not None and held.without_hash:
        sys.stderr.write(
            f"{held.without_hash} rows of {resume} don't say which content they are of: solved again\n"
        )
    if wanted.hashes and held is None:
        held = Held(None, retry=False)  # nothing is held, but rows say which content they are of
    from api.cli.solve_run import Run

    run = Run(writing, paths, extension)
    jobs = min(jobs or len(os.sched_getaffinity(0)), len(paths) if extension != "all" else MOST_JOBS)
    if jobs > 1:
        code = run.side_by_side(shelf, hint, settings, jobs, held)
    else:
        if len(paths) > 1:
            keep_memory()
        code = run.one_by_one(FileSolver(shelf, hint, extension, settings), held)
    raise typer.Exit(code)


def _require_one_on_standard_output(as_json: bool, *named: str | None) -> None:
    if as_json + sum(name == "-" for name in named) > 1:
        raise BadRequest("two kinds of results on the standard output", advice="name a file for one of them")


def _print_json(outcome: Outcome) -> None:
    print_json(outcome.answer(), ascii_only=False, compact=True)
    sys.stdout.flush()


def _print(outcome: Outcome) -> None:
    from api.solver.solve_record import SolveRecord

    answer = outcome.answer()
    extension = answer.pop("extension", None)
    answer.pop("sha256", None)
    if extension is not None:
        answer["file"] += f"[{extension}]"
    _show(SolveRecord.model_validate(answer))


def _print_nothing(outcome: Outcome) -> None:
    """The standard output is a table's."""


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
        self._hdu = None if hdu == "all" else hdu
        self._no_index: str | None = None
        if settings.blind == "only":
            settings = replace(settings, index=open_or_build_index(self._catalog.indexed))
        elif settings.blind == "after":
            settings = replace(settings, index=_index_built_before(self._catalog.indexed))
        self._settings = settings

    def outcome(self, frame: FrameFile, sha256: str = "") -> Outcome:
        """Solve a file: without an index first, if there is none yet."""
        from api.batch.outcomes import Outcome

        try:
            verdict = self._verdict_of(frame)
        except BadFrame as error:
            return Outcome(frame, unread=error.what, sha256=sha256)
        except OSError as error:
            return Outcome(frame, unread=unreadable(error), sha256=sha256)
        if self._no_index is not None and verdict.solution is None:
            verdict = replace(verdict, notes=(*verdict.notes, self._no_index))
        return Outcome(frame, verdict, sha256=sha256)

    def _verdict_of(self, frame: FrameFile) -> Verdict:
        from mountnav.solution import Reason

        budget_s = self._settings.budget_s
        if not self._index_may_come:
            return self._solve(frame, budget_s)
        verdict = self._solve(frame, SHARE_BEFORE_INDEX * budget_s)
        reason = verdict.reason
        if reason is None or not reason.whole_sky_may_help:
            return verdict
        left_s = budget_s - verdict.times.identify_s
        try:
            self._settings = replace(self._settings, index=open_or_build_index(self._catalog.indexed))
        except BadSettings as refused:
            self._no_index = f"the whole sky was not searched: {refused}"
            return self._solve(frame, budget_s) if reason is Reason.TIMED_OUT else verdict
        return self._solve(frame, max(left_s, LEAST_SHARE_AFTER_INDEX * budget_s))

    def _solve(self, frame: FrameFile, budget_s: float) -> Verdict:
        from api.http.file_names import shown
        from mountnav.solving.solve import solve_file

        name = shown(Path(frame.path.name))
        settings = replace(self._settings, budget_s=budget_s)
        hdu = self._hdu if frame.hdu is None else frame.hdu
        return solve_file(frame.path, self._catalog, self._hint, name=name, hdu=hdu, settings=settings)

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
