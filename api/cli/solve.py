"""`mountnav solve`: one record a file, in order; a file that is no image never stops the others."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from api.http.file_names import shown
from api.solver.hints import asked_hint
from api.solver.solve_record import Answer, solve_answer, unread_answer
from mountnav.catalog.catalog_set import CatalogSet
from mountnav.catalog.packed import PackedStore
from mountnav.errors import BadFrame, BadSettings
from mountnav.frames import Hint
from mountnav.solution import Reason, Verdict
from mountnav.solving.solve import SolveSettings, solve_file

if TYPE_CHECKING:
    from rich.console import Console

    from api.solver.solve_record import SolveRecord
    from mountnav.identification.blind.index import BlindIndex


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
    catalog: CatalogSet,
    as_json: bool,
) -> int:
    """Solve the files and print; 0 if all were solved, else 1.

    Raises
    ------
    BadRequest
        Options that make no sense, alone or together; nothing was solved.
    BadSettings
        The whole sky is to be searched, and the index for it can't be built; nothing was solved.
    """
    hint = asked_hint(ra, dec, radius, scale, low, high)
    solver = _Solver(catalog, hint, int(hdu) if hdu is not None and hdu.isdigit() else hdu, settings)
    all_solved = True
    for path in files:
        answer = solver.answer(path)
        all_solved = all_solved and answer["solved"]
        if as_json:
            sys.stdout.write(json.dumps(answer, ensure_ascii=False, separators=(",", ":"), allow_nan=False))
            sys.stdout.write("\n")
            sys.stdout.flush()
        else:
            from api.solver.solve_record import SolveRecord

            _show(SolveRecord.model_validate(answer))
    return 0 if all_solved else 1


class _Solver:
    """Solves one file after the other; the index of the whole sky is got when the first one needs it.

    Parameters
    ----------
    catalog : CatalogSet
    hint : Hint or None
    hdu : int, str or None
    settings : SolveSettings

    Raises
    ------
    BadSettings
        The index is needed at once and can't be built.
    """

    def __init__(
        self, catalog: CatalogSet, hint: Hint | None, hdu: int | str | None, settings: SolveSettings
    ) -> None:
        self._catalog = catalog
        self._hint = hint
        self._hdu = hdu
        self._no_index: str | None = None
        if settings.blind == "only":
            settings = replace(settings, index=_index(self._catalog.indexed))
        elif settings.blind == "after":
            settings = replace(settings, index=_index_at_hand(self._catalog.indexed))
        self._settings = settings

    def answer(self, path: Path) -> Answer:
        """Solve a file: without an index first, if there is none yet."""
        try:
            budget_s = self._settings.budget_s
            # once in an installation's life: half of the time stays for what the index finds
            verdict = self._verdict(path, 0.5 * budget_s if self._index_may_come else budget_s)
            reason = verdict.reason
            if self._index_may_come and reason is not None and reason.whole_sky_may_help:
                left_s = budget_s - verdict.times.identify_s
                try:
                    self._settings = replace(self._settings, index=_index(self._catalog.indexed))
                except BadSettings as refused:
                    self._no_index = f"the whole sky was not searched: {refused}"
                    if reason is Reason.TIMED_OUT:
                        verdict = self._verdict(path, budget_s)
                else:
                    verdict = self._verdict(path, max(left_s, 0.25 * budget_s))
        except BadFrame as error:
            return unread_answer(shown(path), error.what)
        except OSError as error:
            return unread_answer(shown(path), f"the file can't be read: {error.strerror or error}")
        if self._no_index is not None and verdict.solution is None:
            verdict = replace(verdict, notes=(*verdict.notes, self._no_index))
        return solve_answer(shown(path), verdict)

    def _verdict(self, path: Path, budget_s: float) -> Verdict:
        name = shown(Path(path.name))
        settings = replace(self._settings, budget_s=budget_s)
        return solve_file(path, self._catalog, self._hint, name=name, hdu=self._hdu, settings=settings)

    @property
    def _index_may_come(self) -> bool:
        """Whether a frame that isn't solved has the index built."""
        return self._settings.blind == "after" and self._settings.index is None and self._no_index is None


def _index_at_hand(catalog: PackedStore) -> BlindIndex | None:
    """Open the index if it was built before; a damaged one is built anew when it is needed."""
    from mountnav.identification.blind.cache import installed_index

    return installed_index(catalog)


def _index(catalog: PackedStore) -> BlindIndex:
    """Open the index, or build it under a progress bar."""
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
    if record.catalog_steps:
        errors = record.errors_arcsec
        words = "; ".join(record.catalog_steps)
        if errors is not None:
            words += f"; errors: centroid {errors.centroid:.2g}″, catalog {errors.catalog:.2g}″"
            words += f", other {errors.other:.2g}″"
        console.print(f"    [dim]catalog: {escape(words)}[/dim]")
    for one in record.notes:
        console.print(f"    [yellow]note:[/yellow] {escape(one)}")
    for one in record.contradictions:
        console.print(f"    [yellow]hint wrong:[/yellow] {escape(one)}")
