"""`solve-field`: astrometry.net's command, its files and what it prints, with mountnav's solver behind it.

Callers read what it prints line by line, and some stop reading at the line that they want: so files are
written first, and nobody listening any more is no error.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from io import FileIO
from typing import TYPE_CHECKING, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from api.solver_commands.getopt_long import Parted, UnknownOption
from api.solver_commands.host import Asked, Host, Solver
from api.solver_commands.solve_field_options import SLACK, USAGE, Wanted, options_wanted
from mountnav.errors import BadRequest, Cancelled, MountnavError
from mountnav.frames import StarList
from mountnav.reading.content import OnDisk

if TYPE_CHECKING:
    from api.solver_commands.wcsinfo import FieldWcs
    from mountnav.sky.wcs import is_zpn
from mountnav.sky.wcs import is_zpn
from mountnav.sky.wcs_numbers import TOUCHES_ALONE, linear_cards, touching_cards
from mountnav.solution import Solution, Verdict

__all__ = ["VERSION", "run"]

VERSION = "0.97"
"""The version of astrometry.net whose behavior this is; callers switch off what older ones lack."""
ERROR_CODE = 255
"""Exit code of the original for all errors; not to solve a frame is none."""
_ENDING = re.compile(r"\.[^/.]{2,4}$")
"""What is cut off an input's name for the names of the outputs."""
_SOLVED_MARK = b"\x01"
"""What a `.solved` file holds: field 1 is solved."""

_Found = tuple[NDArray[np.generic], NDArray[np.generic], NDArray[np.generic]]

_DEFAULT_NAMES = {
    "axy": "%s.axy", "match": "%s.match", "rdls": "%s.rdls", "solved": "%s.solved", "wcs": "%s.wcs",
    "corr": "%s.corr", "new-fits": "%s.new", "index-xyls": "%s-indx.xyls",
}  # fmt: skip
_ON_DEMAND = ("cancel", "keep-xylist")
"""Files that have a name only if one is given."""


@dataclass(frozen=True, slots=True)
class _Call:
    """One call of the command."""

    asked: Parted
    wanted: Wanted
    host: Host
    solver: Solver

    def out(self, text: str) -> None:
        """Print a line; who has gone away needs none."""
        try:
            self.host.out(text + "\n")
        except OSError:
            return

    def err(self, text: str) -> None:
        """Print a line of trouble."""
        try:
            self.host.err(f"solve-field: {text}\n")
        except OSError:
            return


@dataclass(frozen=True, slots=True)
class _Outputs:
    """Names of the files of one input, by the options that name them; what is left out isn't written."""

    base: str
    names: dict[str, str]


@dataclass(frozen=True, slots=True)
class _Input:
    """One file: its size, and the list of stars if it is one."""

    name: str
    width_px: int
    height_px: int
    stars: StarList | None


def run(arguments: list[str], host: Host, solver: Solver) -> int:
    """Solve the files of a command line.

    Returns
    -------
    int
        0, whether files were solved or not; 255 if an option is unknown, a file can't be read or written.
    """
    try:
        asked, wanted = options_wanted(arguments)
    except (UnknownOption, BadRequest) as fault:
        host.err(f"solve-field: {fault}\n")
        host.out(USAGE)
        return ERROR_CODE
    if asked.given("version"):
        host.out(VERSION + "\n")
        return 0
    files = asked.files
    if asked.given("files-on-stdin"):
        lines = host.read_input().decode("utf-8", "surrogateescape").splitlines()
        files = [line for line in lines if line.strip()]
    if asked.given("help") or (not files and not asked.given("files-on-stdin")):
        if not asked.given("help"):
            host.out("ERROR: You didn't specify any files to process.\n")
        host.out(USAGE)
        return 0
    call = _Call(asked, wanted, host, solver)
    if not asked.given("no-plots"):
        call.out("Plots are not made.")
    folder = asked.last("dir")
    if folder is not None:
        try:
            host.make_folder(folder)
        except OSError as fault:
            call.err(f"failed to create output directory {folder}: {fault.strerror or fault}")
            return ERROR_CODE
    code = 0
    for number, name in enumerate(files, start=1):
        call.out(f'Reading input file {number} of {len(files)}: "{name}"...')
        try:
            _one_file(call, name, number)
        except Cancelled:
            call.out("The cancel file is there: given up.")
            _tell_unsolved(call, name)
        except (MountnavError, OSError) as fault:
            call.err(str(fault))
            code = ERROR_CODE
    return code


# -- one file ------------------------------------------------------------------------------------------------


def _one_file(call: _Call, name: str, number: int) -> None:
    """Solve one file. Raises `MountnavError`, `OSError`."""
    outputs = _outputs(call.asked, name, number)
    if not _may_begin(call, name, outputs):
        return
    with _opened(call.host, name) as file:
        source = _looked_at(call, file, name)
        if call.asked.given("just-augment") or call.asked.given("dont-augment"):
            _write_sources_alone(call, file, source, outputs)
            return
        call.out("Solving...")
        verdict = _solved(call, file, source, outputs)
        _write_sources(call, verdict, source, outputs)
        refusal = _refusal(call.wanted, verdict)
        if verdict.solution is None or refusal is not None:
            call.out(f"Field 1 did not solve ({refusal}).")
            _tell_unsolved(call, name)
            return
        cards = _cards(verdict.solution, sip=call.wanted.sip)
        new_fits = _write_solution(call, file, verdict, cards, source, outputs)
    _tell_solved(call, name, verdict, cards)
    if new_fits:
        call.out(f'Creating new FITS file "{new_fits}"...')


@contextmanager
def _opened(host: Host, name: str) -> Iterator[BinaryIO]:
    with closing(host.open(name)) as file:
        yield file


def _outputs(asked: Parted, name: str, number: int) -> _Outputs:
    """What the output files of an input are called."""
    folder = asked.last("dir")
    if folder is None:
        folder = os.path.dirname(name)
    stem = os.path.basename(name)
    given = asked.last("out")
    if given is not None:
        stem = given.replace("%i", str(number)).replace("%d", str(number)).replace("%s", stem)
    for ending in (".gz", ".bz2"):
        stem = stem.removesuffix(ending)
    base = _ENDING.sub("", os.path.join(folder or ".", stem))
    if not os.path.basename(base):
        base = os.path.join(folder or ".", stem)  # a name like .fits
    names: dict[str, str] = {}
    for option in (*_DEFAULT_NAMES, *_ON_DEMAND):
        pattern = asked.last(option) or _DEFAULT_NAMES.get(option, "none")
        if pattern != "none":
            names[option] = pattern.replace("%s", base)
    if asked.given("temp-axy"):
        names.pop("axy", None)
    return _Outputs(base, names)


def _may_begin(call: _Call, name: str, outputs: _Outputs) -> bool:
    """Whether nothing is in the way of this file; old outputs are taken away if that is asked."""
    host, asked = call.host, call.asked
    solved_in = asked.last("solved-in")
    marks = [
        outputs.names.get("solved"),
        None if solved_in is None else solved_in.replace("%s", outputs.base),
    ]
    if asked.given("skip-solved"):
        for mark in marks:
            if mark is not None and host.exists(mark):
                call.out(f"Solved file exists: {mark}; skipping this input file.")
                return False
    for output in outputs.names.values():
        if os.path.normpath(output) == os.path.normpath(name):
            call.out(f'Output filename "{output}" is the same as your input file.\nRefusing to continue.')
            return False
    for output in outputs.names.values():
        if asked.given("continue") or not host.exists(output):
            continue
        if not asked.given("overwrite"):
            call.out(
                f'Output file already exists: "{output}".\n'
                "Use the --overwrite flag to overwrite existing files,\n"
                " or the --continue flag to not overwrite existing files but still try solving.\n"
                "Continuing to next input file."
            )
            return False
        host.remove(output)
    return True


def _looked_at(call: _Call, file: BinaryIO, name: str) -> _Input:
    """Tell a list of stars from an image, and how large the frame is. Raises `BadFrame`."""
    from mountnav.reading.star_lists import is_star_list, read_star_list

    content = OnDisk(FileIO(file.fileno(), "rb", closefd=False))
    if not call.asked.given("fits-image") and is_star_list(content):
        stars = read_star_list(content, name, call.wanted.stars)
        os.lseek(file.fileno(), 0, os.SEEK_SET)
        return _Input(name, stars.width_px, stars.height_px, stars)
    width, height = 0, 0
    if call.wanted.asks_width:
        width, height = _image_size(content) or _size_of_frame(call.solver, file, name)
    os.lseek(file.fileno(), 0, os.SEEK_SET)
    return _Input(name, width, height, None)


def _image_size(content: OnDisk) -> tuple[int, int] | None:
    """Width and height of a plain FITS image by its header; None where that isn't to be had so cheaply."""
    from mountnav.reading.fits_headers import chosen_hdu, walk

    if content[:6] != b"SIMPLE":
        return None
    shape = chosen_hdu(walk(content, "image"), None, "image").shape
    return (shape[-1], shape[-2]) if len(shape) == 2 or (len(shape) == 3 and shape[0] <= 4) else None


def _size_of_frame(solver: Solver, file: BinaryIO, name: str) -> tuple[int, int]:
    frame = solver.read(file, name)
    return frame.width_px, frame.height_px


def _solved(call: _Call, file: BinaryIO, source: _Input, outputs: _Outputs) -> Verdict:
    """Ask the solver. Without a place the whole sky is searched at once, whatever the file's header says."""
    wanted = call.wanted
    blind: Literal["after", "only"] = "after" if wanted.center is not None or wanted.header_hints else "only"
    asked = Asked(
        file=file,
        name=os.path.basename(source.name),
        hint=wanted.hint(source.width_px or 1),
        blind=blind,
        cpu_limit_s=wanted.cpu_limit_s,
        stars=wanted.stars,
    )
    cancel = outputs.names.get("cancel")
    cancelled = None if cancel is None else partial(call.host.exists, cancel)
    return call.solver.solve(asked, cancelled=cancelled)


def _refusal(wanted: Wanted, verdict: Verdict) -> str | None:
    """Why there is no solution for this call: none at all, or not as it must be. None if there is one.

    Scale and parity bind, as in the original. A place doesn't, as behind mountnav's other doors: where it was
    wrong, the true one is found in the whole sky, and that is told.
    """
    solution = verdict.solution
    if solution is None:
        return str(verdict.reason or "no solution") + (f": {verdict.detail}" if verdict.detail else "")
    if wanted.parity and solution.parity != wanted.parity:
        return "it is found, but with the other parity than the one that was asked for"
    width = int(solution.wcs["IMAGEW"])
    low, high = wanted.scale_arcsec_px(width)
    scales = (solution.scale_arcsec_px, _scale_across(solution))
    if (low is not None and max(scales) < low * (1.0 - SLACK)) or (
        high is not None and min(scales) > high * (1.0 + SLACK)
    ):
        return (
            f"it is found at {solution.scale_arcsec_px:.4g} arcsec per pixel, "
            "outside of the scale that was asked for"
        )
    return None


def _scale_across(solution: Solution) -> float:
    """Width of the field along the sky by its pixels: in wide fields less than the scale in the middle."""
    wcs = _field(touching_cards(solution.wcs))
    width, _, unit = wcs.size
    return width * {"degrees": 3600.0, "arcminutes": 60.0}.get(unit, 1.0) / wcs.width_px


def _cards(solution: Solution, *, sip: bool) -> dict[str, str | int | float]:
    """The cards of the WCS that is written; its reference pixel is the frame's center."""
    cards = touching_cards(solution.wcs) if sip else linear_cards(solution.wcs)
    return {**cards, "EQUINOX": 2000.0, "LONPOLE": 180.0, "LATPOLE": 0.0}


def _field(cards: dict[str, str | int | float]) -> FieldWcs:
    from api.solver_commands.wcsinfo import field_wcs

    return field_wcs(cards)


# -- files ---------------------------------------------------------------------------------------------------


def _write_sources(call: _Call, verdict: Verdict, source: _Input, outputs: _Outputs) -> None:
    """The measured stars, or those of the list."""
    wanted = [outputs.names[option] for option in ("axy", "keep-xylist") if option in outputs.names]
    if not wanted:
        return
    found: _Found = (verdict.seen_px[:, 0], verdict.seen_px[:, 1], verdict.seen_flux)
    size = (source.width_px, source.height_px)
    if source.stars is not None:
        found = (source.stars.x_px, source.stars.y_px, source.stars.flux)
    elif verdict.solution is not None:
        size = (int(verdict.solution.wcs["IMAGEW"]), int(verdict.solution.wcs["IMAGEH"]))
    _write_table(call, wanted, found, _background(verdict), size)


def _write_sources_alone(call: _Call, file: BinaryIO, source: _Input, outputs: _Outputs) -> None:
    """Measure without solving."""
    wanted = [outputs.names[option] for option in ("axy", "keep-xylist") if option in outputs.names]
    stars = source.stars
    if stars is not None:
        places = (stars.x_px, stars.y_px, stars.flux)
        _write_table(call, wanted, places, 0.0, (stars.width_px, stars.height_px))
        return
    from mountnav.measuring.measure import measure

    frame = call.solver.read(file, source.name)
    measured = measure(frame)
    places = (measured.x_px, measured.y_px, measured.flux)
    _write_table(call, wanted, places, measured.background_adu, (frame.width_px, frame.height_px))


def _write_table(
    call: _Call,
    names: list[str],
    found: _Found,
    background: float,
    size: tuple[int, int],
) -> None:
    from api.solver_commands.star_tables import sources_table

    x, y, flux = found
    primary: dict[str, str | int | float] = {"ANRUN": True}
    content = sources_table(x, y, flux, background, width_px=size[0], height_px=size[1], primary=primary)
    for name in names:
        call.host.write(name, content)


def _background(verdict: Verdict) -> float:
    sky = verdict.quality.sky_adu if verdict.quality is not None else None
    return 0.0 if sky is None else float(sky)


def _write_solution(
    call: _Call,
    file: BinaryIO,
    verdict: Verdict,
    cards: dict[str, str | int | float],
    source: _Input,
    outputs: _Outputs,
) -> str | None:
    """The files of a solved frame; the name of the new FITS file if one was written. Raises `OSError`.

    The mark that it is solved comes last: who sees it finds the others complete.
    """
    from api.solver_commands import star_tables
    from mountnav.reading.fits_update import wcs_header

    solution = verdict.solution
    assert solution is not None
    names, write = outputs.names, call.host.write
    history = [
        "Created by mountnav, in the manner of astrometry.net's solve-field.",
        f"{solution.pairs} stars of {solution.catalog}, "
        f"probability of being wrong {solution.false_probability:.1e}.",
    ]
    if "wcs" in names:
        write(names["wcs"], wcs_header(cards, history=history))
    if "rdls" in names:
        write(names["rdls"], star_tables.sky_places(solution))
    if "index-xyls" in names:
        write(names["index-xyls"], star_tables.index_stars(solution, cards))
    if "corr" in names:
        seen: NDArray[np.generic] = verdict.seen_px
        if source.stars is not None:
            seen = np.column_stack((source.stars.x_px, source.stars.y_px)).astype(np.float32)
        write(names["corr"], star_tables.correspondences(solution, cards, seen, _background(verdict)))
    if "match" in names:
        sources = source.stars.x_px.size if source.stars is not None else verdict.measured
        write(names["match"], star_tables.match_table(solution, cards, sources, verdict.times.identify_s))
    new_fits = None
    if "new-fits" in names and source.stars is None:
        new_fits = names["new-fits"]
        write(new_fits, _new_fits(call.solver, file, source.name, cards, history))
    if "solved" in names:
        write(names["solved"], _SOLVED_MARK)
    return new_fits


def _new_fits(
    solver: Solver, file: BinaryIO, name: str, cards: dict[str, str | int | float], history: list[str]
) -> bytes:
    """The image as an unpacked FITS file with the WCS."""
    from mountnav.reading.fits_update import fits_of_frame, updated_fits
    from mountnav.reading.unpacking import unpacked

    content = unpacked(OnDisk(FileIO(file.fileno(), "rb", closefd=False)), name)
    if content[:6] == b"SIMPLE":
        return updated_fits(content, cards, history=history)
    os.lseek(file.fileno(), 0, os.SEEK_SET)
    frame = solver.read(file, name)
    return fits_of_frame(frame.pixels, cards, header=frame.header, history=history)


# -- what is told --------------------------------------------------------------------------------------------


def _tell_solved(call: _Call, name: str, verdict: Verdict, cards: dict[str, str | int | float]) -> None:
    """The lines that callers read, in the original's words and order."""
    from api.solver_commands.wcsinfo import dms_text, hms_text

    solution = verdict.solution
    assert solution is not None
    wcs = _field(cards)
    center, (width, height, unit) = wcs.center, wcs.size
    call.out(
        f"  {solution.pairs} stars identified, probability of being wrong {solution.false_probability:.1e}."
    )
    for contradiction in verdict.contradictions:
        call.out(f"  A hint was wrong: {contradiction}.")
    if is_zpn(solution.wcs):
        call.out(f"  WARNING: {TOUCHES_ALONE}.")
    # INDI's driver reads the scale here, and nothing after it knows all that it wants
    call.out(
        f"  RA,Dec = ({center.ra_deg:g},{center.dec_deg:g}), pixel scale {wcs.scale_arcsec_px:g} arcsec/pix."
    )
    call.out(f"Field 1: solved with index {solution.catalog}.")
    call.out(f"Field: {name}")
    call.out(f"Field center: (RA,Dec) = ({center.ra_deg:3.6f}, {center.dec_deg:3.6f}) deg.")
    call.out(
        f"Field center: (RA H:M:S, Dec D:M:S) = ({hms_text(center.ra_deg)}, {dms_text(center.dec_deg)})."
    )
    call.out(f"Field size: {width:g} x {height:g} {unit}")
    call.out(f"Field rotation angle: up is {wcs.orientation_deg:g} degrees E of N")
    call.out(f"Field parity: {'pos' if wcs.determinant < 0.0 else 'neg'}")


def _tell_unsolved(call: _Call, name: str) -> None:
    call.out(f"Field: {name}")
    call.out("Did not solve (or no WCS file was written).")
