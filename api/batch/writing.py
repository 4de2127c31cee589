"""All that is written of a frame: result files, a header beside it, its own header, stars, a picture."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from api.batch.inputs import stems
from api.batch.outcomes import Outcome, Summary
from api.batch.result_files import JsonLines, ParquetTable, ResultFile, TextTable, kind_of
from api.batch.rows import FRAME_COLUMNS, PAIR_COLUMNS, frame_row, pair_rows
from api.http.file_names import shown
from mountnav import __version__
from mountnav.clock import utc_now
from mountnav.errors import BadRequest, MountnavError
from mountnav.solution import Solution, Verdict

Print = Callable[[Outcome], None]


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is to be written.

    Attributes
    ----------
    csv, ecsv, parquet, pairs : str or None
        Files; "-" is the standard output, but not for Parquet.
    results : str or None
        A result file of the kind that its name says.
    wcs : bool
        A ``.wcs`` beside each frame.
    update : bool
        The header of each FITS file itself.
    annotate : str or None
        A PNG for one frame, else a folder.
    """

    csv: str | None = None
    ecsv: str | None = None
    parquet: str | None = None
    pairs: str | None = None
    results: str | None = None
    wcs: bool = False
    update: bool = False
    annotate: str | None = None

    @property
    def hashes(self) -> bool:
        """Whether rows are kept that another run may look for."""
        return any(path is not None for path in (self.csv, self.ecsv, self.parquet, self.results))


class Writing:
    """Writes what is wanted of each frame, in order, and counts.

    Parameters
    ----------
    files : sequence of Path
        All that were named: names of files beside them must not clash.
    show : callable
        Prints an answer.

    Raises
    ------
    BadRequest
        A file can't be written, or holds something else.
    """

    def __init__(self, wanted: Wanted, files: Sequence[Path], show: Print) -> None:
        self._wanted, self._show = wanted, show
        self.summary = Summary()
        self._stems = stems(files) if wanted.wcs or wanted.annotate else {}
        self._waiting: list[Outcome] = []
        self._tables: list[ResultFile] = []
        self._records: JsonLines | None = None
        for path, kind in _tables(wanted):
            if kind == "json":
                self._records = JsonLines(path)
            elif kind == "parquet":
                if path == "-":
                    raise BadRequest("Parquet can't go to the standard output", advice="name a file")
                self._tables.append(ParquetTable(path, FRAME_COLUMNS))
            else:
                self._tables.append(TextTable(path, FRAME_COLUMNS, ecsv=kind == "ecsv"))
        self._pairs = None if wanted.pairs is None else TextTable(wanted.pairs, PAIR_COLUMNS, ecsv=True)
        self._picture: Path | None = None
        if wanted.annotate is not None:
            self._picture = _picture_or_folder(Path(wanted.annotate), len(files))

    def add(self, outcome: Outcome) -> None:
        """Take a frame; those of one file are written together, for each changes its header."""
        if self._waiting and self._waiting[0].frame.path != outcome.frame.path:
            self._write_waiting()
        self._waiting.append(outcome)
        if not (self._wanted.update and outcome.frame.one_of_many):
            self._write_waiting()

    def close(self) -> None:
        """Write what is left."""
        self._write_waiting()
        for table in (*self._tables, self._records, self._pairs):
            if table is not None:
                table.close()

    def _write_waiting(self) -> None:
        outcomes, self._waiting = self._waiting, []
        for outcome in self._updated(outcomes) if self._wanted.update else outcomes:
            self._write(outcome)

    def _write(self, outcome: Outcome) -> None:
        self.summary.add(outcome)
        if outcome.held is not None:
            return
        verdict, solution = outcome.verdict, outcome.solution
        if verdict is not None and solution is not None:
            self._beside(outcome, verdict, solution)
        if self._tables:
            row = frame_row(outcome)
            for table in self._tables:
                table.add(row)
        if self._records is not None:
            self._records.add_record(outcome.answer())
        if self._pairs is not None:
            for row in pair_rows(outcome):
                self._pairs.add(row)
        self._show(outcome)

    def _beside(self, outcome: Outcome, verdict: Verdict, solution: Solution) -> None:
        from mountnav.files import replace_bytes

        frame = outcome.frame
        if self._wanted.wcs:
            with self._told(outcome, "the .wcs file"):
                replace_bytes(self._name(outcome, ".wcs", frame.path.parent), _wcs_of(outcome, solution))
        if self._picture is not None:
            with self._told(outcome, "the picture"):
                from api.annotated_picture import annotated_png
                from mountnav.reading import read_frame

                again = read_frame(frame.path, name=shown(Path(frame.path.name)), hdu=frame.hdu)
                png = annotated_png(again, verdict, solution)
                single = self._picture.suffix.lower() == ".png" and not frame.one_of_many
                replace_bytes(self._picture if single else self._name(outcome, ".png", self._picture), png)

    def _name(self, outcome: Outcome, suffix: str, folder: Path) -> Path:
        extension = f".{outcome.frame.hdu}" if outcome.frame.one_of_many else ""
        return folder / f"{self._stems[outcome.frame.path]}{extension}{suffix}"

    def _updated(self, outcomes: list[Outcome]) -> list[Outcome]:
        """The outcomes of one file, whose headers hold the solutions now; with the file's new hash."""
        from mountnav.reading.fits_update import update_file

        content: bytes | None = None
        for outcome in outcomes:
            if (solution := outcome.solution) is not None:
                with self._told(outcome, "the header"):
                    content = update_file(
                        outcome.frame.path,
                        solution.wcs,
                        hdu=outcome.frame.hdu,
                        history=_history(solution),
                        checksum=True,
                    )
        if content is None or not outcomes[0].sha256:
            return outcomes
        sha256 = hashlib.sha256(content).hexdigest()
        return [replace(outcome, sha256=sha256) for outcome in outcomes]

    def _told(self, outcome: Outcome, what: str) -> _Told:
        return _Told(self.summary, f"{what} of {shown(outcome.frame.path)}")


class _Told:
    """What goes wrong inside is written down, and stops no other frame."""

    def __init__(self, summary: Summary, what: str) -> None:
        self._summary, self._what = summary, what

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, fault: BaseException | None, trace: object) -> bool:
        if isinstance(fault, OSError):
            self._summary.faults.append(f"{self._what} was not written: {fault.strerror or fault}")
        elif isinstance(fault, MountnavError):
            self._summary.faults.append(f"{self._what} was not written: {fault}")
        else:
            return False
        return True


def _tables(wanted: Wanted) -> list[tuple[str, str]]:
    named = [(wanted.csv, "csv"), (wanted.ecsv, "ecsv"), (wanted.parquet, "parquet")]
    if wanted.results is not None:
        named.append((wanted.results, kind_of(wanted.results)))
    return [(path, kind) for path, kind in named if path is not None]


def _picture_or_folder(path: Path, frames: int) -> Path:
    """A file for one frame; else a folder, which is made. Raises `BadRequest`."""
    if path.suffix.lower() == ".png" and not path.is_dir():
        if frames > 1:
            raise BadRequest(
                f"--annotate {path} is one picture, but there are {frames} frames", advice="name a folder"
            )
        return path
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadRequest(
            f"--annotate {path}: {error.strerror or error}", advice="name a folder that can be made"
        ) from error
    return path


def _history(solution: Solution) -> list[str]:
    chance = f"false with probability {solution.false_probability:.1e}"
    return [
        f"WCS by mountnav {__version__}, {utc_now():%Y-%m-%dT%H:%M:%SZ}: {solution.mode}, {solution.catalog}",
        f"{solution.pairs} stars, rms {solution.rms_arcsec:.3f} arcsec, {chance}",
    ]


def _wcs_of(outcome: Outcome, solution: Solution) -> bytes:
    from mountnav.files import open_plain
    from mountnav.reading.content import OnDisk
    from mountnav.reading.fits_update import wcs_header

    path = outcome.frame.path
    with open_plain(path) as file:
        return wcs_header(
            solution.wcs,
            frame=OnDisk(file),
            hdu=outcome.frame.hdu,
            history=_history(solution),
            name=path.name,
        )
