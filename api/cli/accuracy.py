"""`mountnav accuracy`: reduces a set of frames and prints Table 1 of [S23 §4] for it."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli.options import Calibration, Catalog, Config, Dec, Json, Profile, Ra, Radius, Scale
from api.cli.output import refusing_os_errors
from mountnav.errors import BadRequest
from mountnav.extras import extra

if TYPE_CHECKING:
    from api.cli.accuracy_record import AccuracyRecord, FrameAccuracy, IndicatorRecord, RowRecord
    from api.cli.solve import FileSolver
    from mountnav.solution import Solution

COLUMNS = ("frame", "rejected", "deviation", "number", "mean", "st. dev.", "min |Δ|", "max |Δ|")


def accuracy(
    frames: Annotated[list[Path], typer.Argument(metavar="FRAME...", help="Images (FITS, PNG, JPEG).")],
    ra: Ra = None,
    dec: Dec = None,
    radius: Radius = None,
    scale: Scale = None,
    reject: Annotated[str, typer.Option(metavar="P,P,...", help="Reject the worst P %.")] = "0,5,10",
    all_pairs: Annotated[
        bool, typer.Option("--all-pairs", help="Also pairs that their deviation threw out of the fit.")
    ] = False,
    leave_one_out: Annotated[
        bool, typer.Option("--leave-one-out", help="Each pair against a plate fit without it.")
    ] = False,
    catalog_sigma: Annotated[
        float | None,
        typer.Option(
            metavar="ARCSEC", help="Only stars that the catalog states to be placed at least so well."
        ),
    ] = None,
    calibration: Calibration = None,
    profile: Profile = None,
    config: Config = None,
    catalog: Catalog = None,
    as_json: Json = False,
    as_markdown: Annotated[bool, typer.Option("--markdown", help="A Markdown table.")] = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write histograms and residual maps (PNG) here.")
    ] = None,
) -> None:
    """Tell how accurate the measured places of stars are: mean, spread and extremes against the catalog.

    Exit code 0 if all frames were solved, 1 if some were not (they are listed), 2 on bad usage.
    """
    from api.cli.accuracy_record import accuracy_record
    from api.cli.chosen_catalogs import chosen_shelf
    from api.cli.solve import FileSolver
    from api.http.file_names import shown
    from api.solver.hints import asked_hint
    from api.solver.solve_settings import chosen_settings
    from mountnav.solution import Solution

    settings = chosen_settings(config=config, profile=profile, budget_s=None, calibration=calibration)
    shelf = chosen_shelf(config, catalog)
    percents = rejected_percents(reject)
    sigma_arcsec = math.inf if catalog_sigma is None else catalog_sigma
    if not sigma_arcsec > 0.0:
        raise BadRequest(
            f"--catalog-sigma {catalog_sigma}: not above zero",
            advice="arcseconds, such as 0.03 with the catalog gaia-bright",
        )
    if as_json and as_markdown:
        raise BadRequest("--json and --markdown together", advice="give one or the other")
    hint = asked_hint(ra, dec, radius, scale)
    if plot is not None:
        with refusing_os_errors(f"--plot {plot}", advice="name a folder that can be made"):
            plot.mkdir(parents=True, exist_ok=True)
    solver = FileSolver(shelf, hint, None, settings)
    if plot is not None:  # known now, and not after all frames are solved
        with extra("plots", "plots"):
            from api.cli.accuracy_plots import write_plots
    outcomes = [(shown(path), _outcome(path, solver)) for path in frames]
    record = accuracy_record(
        outcomes,
        percents,
        every=all_pairs,
        leave_one_out=leave_one_out,
        catalog_sigma_arcsec=sigma_arcsec,
    )
    if as_json:
        sys.stdout.write(record.model_dump_json() + "\n")
    elif as_markdown:
        sys.stdout.write(markdown(record))
    else:
        _show(record)
    if plot is not None and record.solved:
        solutions = [outcome for _, outcome in outcomes if isinstance(outcome, Solution)]
        for path in write_plots(
            solutions,
            plot,
            every=all_pairs,
            leave_one_out=leave_one_out,
            catalog_sigma_arcsec=sigma_arcsec,
        ):
            sys.stderr.write(f"{path}\n")
    raise typer.Exit(0 if record.solved == len(record.frames) else 1)


def rejected_percents(text: str) -> tuple[float, ...]:
    """Read the percentages of `--reject`, "0,5,10"; each once, in order.

    Raises
    ------
    BadRequest
        One is no number, or not in [0, 100).
    """
    percents: list[float] = []
    for word in text.split(","):
        try:
            percent = float(word)
        except ValueError:
            percent = math.nan
        if not 0.0 <= percent < 100.0:
            raise BadRequest(
                f"--reject {text}: {word.strip() or 'nothing'} is not a percentage to reject",
                advice="numbers from 0 to below 100 with commas between, such as 0,5,10",
            )
        if percent not in percents:
            percents.append(percent)
    return tuple(percents)


def _outcome(path: Path, solver: FileSolver) -> Solution | str:
    """The solution, or why there is none."""
    from api.batch.inputs import FrameFile

    outcome = solver.outcome(FrameFile(path))
    if outcome.solution is not None:
        return outcome.solution
    return str(outcome.answer()["reason"])


def _notes(record: AccuracyRecord) -> Iterator[str]:
    """Say what the table's numbers are, one sentence each."""
    yield f"{record.solved} of {len(record.frames)} frames solved; catalog: {record.catalog or 'none'}."
    pairs = (
        "all pairs, also those rejected by their deviation" if record.every_pair else "the pairs in the fit"
    )
    yield f"Measured minus catalog, {pairs}; Δmag by each frame's own zero point and color term."
    if record.catalog_sigma_arcsec is not None:
        yield (
            f"Only stars that the catalog states to be placed to {record.catalog_sigma_arcsec:g}″ or better; "
            "the plates are fit to all, by their stated errors."
        )
    if record.leave_one_out:
        yield "Each pair against a plate that was fit without it (leave one out)."
    elif record.fit_factor is not None:
        yield (
            f"The fit makes its own pairs' errors look smaller, by a factor of {record.fit_factor:.3f} "
            "(sqrt(1 - p/n)); --leave-one-out gives deviations of pairs that had no part in the fit."
        )
    yield (
        "Rejected are the worst by the modulus of the position's deviation, for Δmag by its own; "
        "saturated stars have no Δmag, nor have those without a magnitude of their own in the catalog's band."
    )


def _lines(name: str, rows: list[RowRecord]) -> Iterator[tuple[str, ...]]:
    for row in rows:
        for label, indicators in (
            ("ΔRA cos δ ″", row.ra_arcsec),
            ("ΔDec ″", row.dec_arcsec),
            ("Δmag", row.mag),
        ):
            yield (name, f"{row.rejected_percent:g} %", label, *_numbers(indicators))


def _numbers(found: IndicatorRecord) -> tuple[str, ...]:
    """Number of deviations, then mean, standard deviation and extremes to a thousandth."""
    values = (found.mean, found.standard_deviation, found.least_modulus, found.most_modulus)
    signs = ("+", "", "", "")
    cells = (
        "–" if value is None else f"{value:{sign}.3f}" for value, sign in zip(values, signs, strict=True)
    )
    return (str(found.number), *cells)


def brightness_scale(frame: FrameAccuracy) -> str:
    """Zero point and color term of a frame, in one line."""
    found = frame.photometry
    if found is None:
        return "no zero point: fewer than three stars fit for it"
    parts = [
        f"zero point {found.zero_point_mag:.3f} ± {found.zero_point_sigma_mag:.3f} {found.band or 'mag'}",
        f"scatter {found.scatter_mag:.3f}",
        f"{found.stars} stars",
    ]
    if found.color_term_sigma is not None and found.pivot_mag is not None:
        color = found.color_name or "color"
        parts.insert(
            1,
            f"color term {found.color_term:+.3f} ± {found.color_term_sigma:.3f} "
            f"per mag of {color}, from {color} = {found.pivot_mag:.2f}",
        )
    else:
        parts.insert(1, "no color term")
    return ", ".join(parts)


def _blocks(record: AccuracyRecord) -> Iterator[tuple[str, list[RowRecord]]]:
    for frame in record.frames:
        if frame.solved:
            yield Path(frame.file).name, frame.rows
    if record.solved:
        yield f"all {record.solved}", record.overall


def markdown(record: AccuracyRecord) -> str:
    """Write the record as a Markdown table, with what it means below."""
    out = ["| " + " | ".join(COLUMNS) + " |", "|---|---|---" + "|---:" * 5 + "|"]
    for name, rows in _blocks(record):
        out += ["| " + " | ".join(line).replace("|Δ|", "Δ") + " |" for line in _lines(name, rows)]
    out[0] = out[0].replace("|Δ|", "Δ modulus")
    out.append("")
    out += [f"Not solved: {frame.file}: {frame.reason}  " for frame in record.frames if not frame.solved]
    out += [
        f"{Path(frame.file).name}: {brightness_scale(frame)}.  " for frame in record.frames if frame.solved
    ]
    out += list(_notes(record))
    return "\n".join(out) + "\n"


def _show(record: AccuracyRecord) -> None:
    from rich.console import Console
    from rich.markup import escape

    console = Console(highlight=False, soft_wrap=True)
    for frame in record.frames:
        if not frame.solved:
            console.print(f"[red]✗[/red] {escape(frame.file)}  not solved: {escape(frame.reason or '')}")
    if record.solved:
        console.print(f"[dim]{_aligned(COLUMNS[1:])}[/dim]")
        scales = [brightness_scale(frame) for frame in record.frames if frame.solved]
        for number, (name, rows) in enumerate(_blocks(record)):
            console.print(f"[bold]{escape(name)}[/bold]")
            if number < len(scales):
                console.print(f"  [dim]{escape(scales[number])}[/dim]")
            for line in _lines(name, rows):
                console.print(_aligned(line[1:]))
        console.print()
    for note in _notes(record):
        console.print(note)


def _aligned(cells: tuple[str, ...]) -> str:
    """Columns of fixed width, 68 characters in all, so that they stay in line from frame to frame."""
    left = f"{cells[0]:>8}  {cells[1]:<11}{cells[2]:>7}"
    return left + "".join(f"{cell:>10}" for cell in cells[3:])
