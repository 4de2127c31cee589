"""`mountnav accuracy`: reduces a set of frames and prints Table 1 of [S23 §4] for it."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

from api.cli.accuracy_record import AccuracyRecord, FrameAccuracy, IndicatorRecord, RowRecord, accuracy_record
from api.http.file_names import shown
from api.solver.hints import asked_hint
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, BadRequest
from mountnav.frames import Hint
from mountnav.solution import Solution
from mountnav.solving.solve import SolveSettings, solve_file

COLUMNS = ("frame", "rejected", "deviation", "number", "mean", "st. dev.", "min |Δ|", "max |Δ|")


def run(
    files: list[Path],
    *,
    ra: float | None,
    dec: float | None,
    radius: float | None,
    scale: float | None,
    reject: str,
    every: bool,
    leave_one_out: bool,
    as_json: bool,
    as_markdown: bool,
    plot: Path | None,
    catalog: Catalog,
    settings: SolveSettings | None = None,
) -> int:
    """Reduce the files and print; 0 if all were solved, else 1.

    Raises
    ------
    BadRequest
        Options that make no sense, alone or together; nothing was reduced.
    """
    percents = rejected_percents(reject)
    if as_json and as_markdown:
        raise BadRequest("--json and --markdown together", advice="give one or the other")
    hint = asked_hint(ra, dec, radius, scale)
    if plot is not None:
        _make_folder(plot)
    outcomes = [(shown(path), _outcome(path, catalog, hint, settings)) for path in files]
    record = accuracy_record(outcomes, percents, every=every, leave_one_out=leave_one_out)
    if as_json:
        sys.stdout.write(record.model_dump_json() + "\n")
    elif as_markdown:
        sys.stdout.write(markdown(record))
    else:
        _show(record)
    if plot is not None and record.solved:
        from api.cli.accuracy_plots import write_plots

        solutions = [outcome for _, outcome in outcomes if isinstance(outcome, Solution)]
        for path in write_plots(solutions, plot, every=every, leave_one_out=leave_one_out):
            sys.stderr.write(f"{path}\n")
    return 0 if record.solved == len(record.frames) else 1


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
                f"--reject {text}: {word.strip() or 'nothing'} is no percentage to reject",
                advice="numbers from 0 to below 100 with commas between, such as 0,5,10",
            )
        if percent not in percents:
            percents.append(percent)
    return tuple(percents)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadRequest(
            f"--plot {folder}: {error.strerror or error}", advice="name a folder that can be made"
        ) from error


def _outcome(
    path: Path, catalog: Catalog, hint: Hint | None, settings: SolveSettings | None
) -> Solution | str:
    """Give the solution, or why there is none."""
    try:
        verdict = solve_file(path, catalog, hint, settings=settings)
    except BadFrame as error:
        return error.what
    except OSError as error:
        return f"the file can't be read: {error.strerror or error}"
    if verdict.solution is not None:
        return verdict.solution
    reason = str(verdict.reason) if verdict.reason else "not solved"
    return f"{reason}: {verdict.detail}" if verdict.detail else reason


def _notes(record: AccuracyRecord) -> Iterator[str]:
    """Say what the table's numbers are, one sentence each."""
    yield f"{record.solved} of {len(record.frames)} frames solved; catalog: {record.catalog or 'none'}."
    pairs = (
        "all pairs, also those rejected by their deviation" if record.every_pair else "the pairs in the fit"
    )
    yield f"Measured minus catalog, {pairs}; Δmag by each frame's own zero point and color term."
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
        for label, one, places in (
            ("ΔRA cos δ ″", row.ra_arcsec, 3),
            ("ΔDec ″", row.dec_arcsec, 3),
            ("Δmag", row.mag, 3),
        ):
            yield (name, f"{row.rejected_percent:g} %", label, *_numbers(one, places))


def _numbers(one: IndicatorRecord, places: int) -> tuple[str, ...]:
    values = (one.mean, one.standard_deviation, one.least_modulus, one.most_modulus)
    signs = ("+", "", "", "")
    told = ("–" if v is None else f"{v:{sign}.{places}f}" for v, sign in zip(values, signs, strict=True))
    return (str(one.number), *told)


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
