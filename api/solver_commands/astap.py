"""The commands `astap` and `astap_cli`: options, result files and exit codes as ASTAP has them.

Differences that can't be seen from a result: stars come from mountnav's own catalogs, so that `-d` and `-D`
say nothing; nothing is searched by quads, so that `-s`, `-t`, `-m`, `-z`, `-check` and `-speed` say nothing.
"""

from __future__ import annotations

import math
import os
import shlex
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from io import FileIO
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

from api.solver_commands.astap_files import as_header, as_text, ini_text, plate_values, wcs_lines
from api.solver_commands.astap_stars import best_focus, median_text, stars_csv
from api.solver_commands.host import Asked, Host, Solver
from api.solver_commands.image_facts import ImageFacts, image_facts, number, one_line
from api.solver_commands.plate_result import (
    FIELD_WARNED,
    WIDEST_RADIUS_DEG,
    Field,
    Plate,
    hint_of,
    judged,
    numbers_of,
    place,
    solved_cards,
)
from mountnav.clock import utc_now
from mountnav.errors import BadCatalog, BadFrame, BadSettings, MountnavError, StarsUnavailable
from mountnav.frames import Frame
from mountnav.reading.content import OnDisk
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.sky.wcs_numbers import Value
from mountnav.solution import Reason, Solution
from mountnav.version import version

if TYPE_CHECKING:
    from mountnav.measuring.hfd import StarDiameters

SOLVED, UNSOLVED, FEW_STARS, NO_IMAGE, NO_CATALOG, BAD_STARS, NOT_UPDATED = 0, 1, 2, 16, 32, 33, 34
"""Exit codes, as ASTAP's graphical edition has them; its command line edition says 1 for 2 to 33."""
DEFAULT_SNR = 30.0
"""Signal-to-noise ratio that `-analyse 0` and its kin mean."""
ENOUGH_STARS = 500
"""Stars from which on `-analyse` and its kin look at no fainter peaks, as ASTAP does."""
_FOCUS_CARDS = ("FOCUSPOS", "FOCPOS")
_IGNORED = ("s", "t", "m", "z", "check", "d", "D", "speed", "progress")
_IMPOSSIBLE = {
    "stack": "live stacking needs the original program",
    "p": "photometry reports need the original program",
    "debug": "there is no window to show the image in",
}
_JPEG_QUALITY = 90
"""Of the annotated picture, as ASTAP has it; 100 is best."""
_USAGE = """\
mountnav {version}: solves like ASTAP
Usage:
-f    filename {{fits, tiff, png, jpg files}}
-r    radius_area_to_search[degrees] {{180: the whole sky}}
-fov  height_field[degrees] {{0: found out}}
-ra   right_ascension[hours]
-spd  south_pole_distance[degrees]
-o    file {{name the output files with this base path and file name}}
-sip  [y/n] {{add SIP coefficients}}
-wcs  {{write the .wcs file as a FITS header, else as text}}
-log  {{write a .log file}}
-update  {{add the solution to the header of the input; jpeg, png, tiff are written as fits}}
-analyse  snr_min {{report median HFD and number of stars}}
-extract  snr_min {{write all stars to a .csv file}}
-extract2 snr_min {{solve, and write all stars with ra, dec to a .csv file}}
-sqm  pedestal {{add the brightness of the sky to the result}}
-annotate {{draw the identified stars into a jpg file}}
-tofits  binning[1,2,3,4] {{make a fits file of a picture}}
-focus1 file1 -focus2 file2 ... {{find the best focus}}
Read and not needed: -s -t -m -z -check -d -D -speed -progress. Not possible: -debug -stack -p.
"""


class Options:
    """Options as ASTAP takes them: `-x value`, `--x value`, `-x=value`; a value has no leading dash."""

    def __init__(self, arguments: Iterable[str]) -> None:
        self._values: dict[str, str | None] = {}
        given = list(arguments)
        for at, argument in enumerate(given):
            if not argument.startswith("-") or argument in ("-", "--"):
                continue
            name, equals, value = argument.lstrip("-").partition("=")
            following = given[at + 1] if at + 1 < len(given) else "-"
            taken = value if equals else None if following.startswith("-") else following
            self._values.setdefault(name, taken)

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def text(self, name: str) -> str | None:
        """The option's value; None if it has none, or wasn't given."""
        return self._values.get(name)

    def number(self, name: str) -> float | None:
        """The option's value as a number; None if it is none."""
        return number(self._values.get(name))

    def without(self, name: str) -> bool:
        """Whether a switch is off: not given, or given with n."""
        return name not in self._values or (self._values[name] or "y").lower() == "n"


@dataclass(slots=True)
class _Run:
    """One call: its options, what it says, and what comes of it."""

    options: Options
    host: Host
    solver: Solver
    command: str
    image: str
    base: str
    lines: list[str] = field(default_factory=list)

    def say(self, text: str) -> None:
        """Print a line, and keep it for the log."""
        text = one_line(text)
        self.host.out(text + "\n")
        self.lines.append(f"{utc_now().astimezone():%H:%M:%S}  {text}")

    def write(self, extension: str, content: bytes, *, base: str | None = None) -> bool:
        """Write a result file beside the base; never over the image itself."""
        path = (self.base if base is None else base) + extension
        if os.path.normpath(path) == os.path.normpath(self.image):
            self.say(f"Error: {path} is the image itself, it is left as it is")
            return False
        try:
            self.host.write(path, content)
        except OSError as fault:
            self.say(f"Error writing {path}: {fault.strerror or fault}")
            return False
        return True


def run(arguments: list[str], host: Host, solver: Solver) -> int:
    """Carry out `astap` or `astap_cli`.

    Parameters
    ----------
    arguments : list of str
        Without the command's name.

    Returns
    -------
    int
        0 solved, 1 no solution, 2 not enough stars, 16 no image, 32 no catalog, 33 catalog damaged,
        34 the image could not be updated.
    """
    options = Options(arguments)
    command = "astap " + shlex.join(arguments)
    for name, why in _IMPOSSIBLE.items():
        if name in options:
            host.err(f"-{name} is not possible here: {why}\n")
            return UNSOLVED
    if "focus1" in options and "f" not in options:
        return _focus(options, host, solver)
    if "f" not in options or "h" in options or "help" in options:
        host.out(_USAGE.format(version=version()))
        return SOLVED
    image = options.text("f") or ""
    base = os.path.splitext(options.text("o") or image)[0]
    call = _Run(options, host, solver, command, image, base)
    call.say(command)
    code = _carried_out(call)
    if "log" in options and base:
        call.write(".log", "".join(line + "\n" for line in call.lines).encode("ascii"))
    return code


def _carried_out(call: _Run) -> int:
    if not call.image:
        return _failed(call, NO_IMAGE, "-f names no file")
    try:
        file = call.host.open(call.image)
    except (OSError, ValueError) as fault:  # a name with a zero byte is a ValueError
        return _failed(call, NO_IMAGE, f"{call.image}: {getattr(fault, 'strerror', None) or fault}")
    with file:
        name = os.path.basename(call.image)
        try:
            facts = image_facts(file, name, call.solver)
            if "analyse" in call.options or "extract" in call.options:
                return _analyse(call, file, name, facts)
            return _solve(call, file, name, facts)
        except BadFrame as fault:
            return _failed(call, NO_IMAGE, str(fault))
        except BadCatalog as fault:
            return _failed(call, BAD_STARS, str(fault))
        except (BadSettings, StarsUnavailable) as fault:
            return _failed(call, NO_CATALOG, str(fault))
        except MountnavError as fault:
            return _failed(call, UNSOLVED, str(fault))


def _failed(
    call: _Run, code: int, why: str, facts: ImageFacts | None = None, warnings: tuple[str, ...] = ()
) -> int:
    """Say that there is no solution, in the `.ini` and aloud."""
    call.say("No solution found!  :(")
    call.say(why)
    size = None if facts is None else (facts.width_px, facts.height_px)
    warning = " ".join([why, *(f"({one})" for one in warnings)])
    if call.base:
        text = ini_text(None, command=call.command, size=size, code=code, warning=warning)
        call.write(".ini", text.encode("ascii"))
    return code


# -- solving -------------------------------------------------------------------------------------------------


def _solve(call: _Run, file: BinaryIO, name: str, facts: ImageFacts) -> int:
    began_s = time.monotonic()
    center, radius_deg, stated = _hint(call, facts)
    call.say(f"mountnav {version()}, search radius {radius_deg:g} degrees, image {_size(facts)}")
    asked = Asked(file, name, hint_of(center, radius_deg, stated, "-ra and -spd"))
    plate = judged(call.solver.solve(asked), stated)
    call.say(f"{plate.verdict.measured} stars measured")
    if plate.solution is None:
        code = _failed(call, _code_of(plate.verdict.reason), plate.why, facts, plate.warnings)
        if "extract2" in call.options:
            _extract(call, call.solver.read(file, name), facts, "extract2", {})
        return code
    spent_s = time.monotonic() - began_s
    sip = "extract2" in call.options or not call.options.without("sip")
    cards = solved_cards(plate.solution, facts, sip=sip)
    off = "" if center is None else f" Offset was {_apart_deg(center, plate.solution):.4f} degrees."
    note = f"Solved in {spent_s:.1f} sec.{off}"
    found = plate.solution.center
    call.say(f"Solution found: {found.ra_deg / 15:.6f} h {found.dec_deg:+.5f} deg. {note}")
    call.say(f"Chance of being wrong: {plate.solution.false_probability:.1e}")
    code = _written(call, file, facts, plate, plate.solution, cards, stated, note)
    if "extract2" in call.options:
        _extract(call, call.solver.read(file, name), facts, "extract2", cards)
    return code


def _hint(call: _Run, facts: ImageFacts) -> tuple[Icrs | None, float, Field | None]:
    """Where to look, how far about, and the size of the field: what the options say."""
    options = call.options
    radius_deg = options.number("r")
    if radius_deg is None or radius_deg < 0.0:
        radius_deg = WIDEST_RADIUS_DEG
    center = None
    if "ra" in options or "spd" in options:
        ra_h, spd_deg = options.number("ra"), options.number("spd")
        if ra_h is not None and spd_deg is not None:
            center = place(15.0 * ra_h, spd_deg - 90.0)
        if center is None:
            call.say("-ra (hours) and -spd (degrees) name no place, they are skipped")
    stated = None
    fov_deg = options.number("fov")
    if fov_deg is not None and 0.0 < fov_deg < 180.0:
        stated = Field(fov_deg, facts.height_px, "-fov")
    elif "fov" in options and fov_deg != 0.0:
        call.say("-fov names no height in degrees, it is skipped")
    ignored = [f"-{name}" for name in _IGNORED if name in options]
    if ignored:
        call.say(f"not needed: {' '.join(ignored)}")
    return center, radius_deg, stated


def _size(facts: ImageFacts) -> str:
    return f"{facts.width_px} x {facts.height_px}"


def _apart_deg(center: Icrs, solution: Solution) -> float:
    return separation_arcsec(center, solution.center) / 3600.0


def _code_of(reason: Reason | None) -> int:
    codes = {Reason.TOO_FEW_MEASUREMENTS: FEW_STARS, Reason.BAD_FRAME: NO_IMAGE}
    return UNSOLVED if reason is None else codes.get(reason, UNSOLVED)


def _written(
    call: _Run,
    file: BinaryIO,
    facts: ImageFacts,
    plate: Plate,
    solution: Solution,
    cards: dict[str, Value],
    stated: Field | None,
    note: str,
) -> int:
    """Write what a solved frame gives."""
    numbers = numbers_of(cards)
    values = plate_values(cards, numbers)
    warnings = [*_scale_warning(solution, facts, stated), *plate.warnings]
    if "sqm" in call.options:
        sqm, doubt = _sky_brightness(call, plate, solution)
        values |= sqm
        warnings += doubt
    warning = "; ".join(warnings)
    for one in warnings:
        call.say(f"WARNING {one}")
    code = SOLVED
    if not call.options.without("update"):
        code = _update(call, file, facts, {**cards, **_older(values)}, note)
    lines = wcs_lines(cards, values, header=facts.header, command=call.command, note=note, warning=warning)
    written = call.write(".wcs", as_text(lines) if call.options.without("wcs") else as_header(lines))
    text = ini_text(
        values,
        command=call.command,
        size=(facts.width_px, facts.height_px),
        code=code,
        warning=warning,
    )
    written = call.write(".ini", text.encode("ascii")) and written
    if "annotate" in call.options:
        _annotate(call, file, plate, solution)
    if "tofits" in call.options and facts.rows_down:
        _to_fits(call, file)
    return code if written or code else UNSOLVED


def _scale_warning(solution: Solution, facts: ImageFacts, stated: Field | None) -> list[str]:
    """What ASTAP says of a stated field that is off."""
    if stated is None or stated.off(solution.scale_arcsec_px) <= 1.0 + FIELD_WARNED:
        return []
    height_deg = solution.scale_arcsec_px * facts.height_px / 3600.0
    found = f'Set FOV={height_deg:.2f}d, scale={solution.scale_arcsec_px:.1f}"'
    pixel_um = facts.header.get("XPIXSZ")
    if isinstance(pixel_um, int | float) and pixel_um > 0:
        found += f", FL={math.degrees(3.6 * float(pixel_um) / solution.scale_arcsec_px):.0f}mm"
    return [f"Warning scale was inaccurate! {found}"]


def _older(values: dict[str, float]) -> dict[str, Value]:
    """Cards that ASTAP writes beside the matrix."""
    kept = ("CDELT1", "CDELT2", "CROTA1", "CROTA2", "SQM")
    return {"EQUINOX": 2000.0, **{name: values[name] for name in kept if name in values}, "PLTSOLVD": True}


def _sky_brightness(call: _Run, plate: Plate, solution: Solution) -> tuple[dict[str, float], list[str]]:
    """Magnitudes per square arcsecond, by the zero point of the identified stars; no air is reckoned with."""
    pedestal = call.options.number("sqm") or 0.0
    quality = plate.verdict.quality
    if quality is None or quality.zero_point_mag is None:
        return {}, ["-sqm: the stars give no zero point"]
    light = (quality.sky_adu - pedestal) / solution.scale_arcsec_px**2
    if light <= 0.0:
        return {}, ["-sqm: the sky is no brighter than the pedestal"]
    return {"SQM": quality.zero_point_mag - 2.5 * math.log10(light)}, []


def _update(call: _Run, file: BinaryIO, facts: ImageFacts, cards: dict[str, Value], note: str) -> int:
    """Write the plate into the image, or make a FITS file of a picture."""
    from mountnav.reading.fits_update import fits_of_frame, updated_fits

    history = [f"plate by mountnav {version()}", one_line(note)]
    try:
        if facts.rows_down:
            frame = call.solver.read(file, os.path.basename(call.image))
            content = fits_of_frame(_whole_numbers(frame)[::-1], cards, history=history)
            path = os.path.splitext(call.image)[0] + ".fits"
        else:
            whole = OnDisk(FileIO(file.fileno(), closefd=False))
            content = updated_fits(whole, cards, history=history, name=os.path.basename(call.image))
            path = call.image
        call.host.write(path, content)
    except (BadFrame, OSError) as fault:
        call.say(f"Error updating input file: {fault}")
        return NOT_UPDATED
    call.say(f"Updated {path}")
    return SOLVED


def _annotate(call: _Run, file: BinaryIO, plate: Plate, solution: Solution) -> None:
    """`-annotate`: a picture with the identified stars, north and east; no catalog of names is at hand."""
    import io

    from PIL import Image

    from api.annotated_picture import annotated_png

    frame = call.solver.read(file, os.path.basename(call.image))
    content = io.BytesIO()
    with Image.open(io.BytesIO(annotated_png(frame, plate.verdict, solution))) as picture:
        picture.save(content, "JPEG", quality=_JPEG_QUALITY)
    if call.write("_annotated.jpg", content.getvalue()):
        call.say("annotated with the identified stars; there are no names of objects")


def _to_fits(call: _Run, file: BinaryIO) -> None:
    """`-tofits`: a picture as FITS, binned."""
    from mountnav.reading.fits_update import fits_of_frame

    binning = int(min(max(call.options.number("tofits") or 1.0, 1.0), 4.0))
    frame = call.solver.read(file, os.path.basename(call.image))
    pixels = _whole_numbers(frame)[::-1]
    rows, columns = (side - side % binning for side in pixels.shape)
    shape = (rows // binning, binning, columns // binning, binning)
    binned = pixels[:rows, :columns].reshape(shape).mean(axis=(1, 3))
    call.write(".fit", fits_of_frame(binned.round().astype(pixels.dtype), {}))


def _whole_numbers(frame: Frame) -> NDArray[np.generic]:
    """Pixels as ASTAP stores those of pictures: 16 bits; what has fractions stays as it is."""
    pixels = frame.pixels
    return pixels.astype(np.uint16) if pixels.dtype.kind == "u" and pixels.dtype.itemsize == 1 else pixels


# -- measuring -----------------------------------------------------------------------------------------------


def _snr(call: _Run, option: str) -> float:
    """The option's signal-to-noise ratio; 0 and what is no number mean the default."""
    given = call.options.number(option)
    return given if given is not None and given > 0.0 else DEFAULT_SNR


def _measured(frame: Frame, least_snr: float) -> StarDiameters:
    from mountnav.measuring.hfd import measure_hfd  # slow to import, and solving does without

    return measure_hfd(frame, least_snr=least_snr, enough=ENOUGH_STARS)


def _analyse(call: _Run, file: BinaryIO, name: str, facts: ImageFacts) -> int:
    """`-analyse` and `-extract`: nothing is solved, no `.ini` is written."""
    frame = call.solver.read(file, name)
    if "extract" in call.options:
        # the plate in a header is one of rows from the bottom already
        stars = _extract(call, frame, facts, "extract", facts.header)
    else:
        stars = _measured(frame, _snr(call, "analyse"))
    call.host.out(median_text(stars))
    return SOLVED


def _extract(
    call: _Run, frame: Frame, facts: ImageFacts, option: str, cards: Mapping[str, object]
) -> StarDiameters:
    """Write the list of stars beside the image."""
    stars = _measured(frame, _snr(call, option))
    content = stars_csv(stars, facts, cards).encode("ascii")
    call.write(".csv", content, base=os.path.splitext(call.image)[0])
    return stars


def _focus(options: Options, host: Host, solver: Solver) -> int:
    """`-focus1 FILE -focus2 FILE ...`: the best focus by the diameters of their stars."""
    positions, diameters = [], []
    at = 1
    while f"focus{at}" in options:
        path = options.text(f"focus{at}") or ""
        at += 1
        try:
            with host.open(path) as file:
                frame = solver.read(file, os.path.basename(path))
        except (OSError, ValueError, MountnavError) as fault:
            host.err(f"{one_line(path)}: {one_line(str(fault))}\n")
            return NO_IMAGE
        place_of = next((frame.header[key] for key in _FOCUS_CARDS if key in frame.header), None)
        median = _measured(frame, DEFAULT_SNR).median_px
        if not isinstance(place_of, int | float) or median is None:
            why = "no stars" if median is None else f"no card {' or '.join(_FOCUS_CARDS)}"
            host.err(f"{one_line(path)}: {why}, it is skipped\n")
            continue
        positions.append(float(place_of))
        diameters.append(median)
    focus = best_focus(positions, diameters)
    if focus is None:
        host.err(f"no best focus: {len(positions)} frames show no least diameter between their positions\n")
        return UNSOLVED
    host.out(f"FOCUS={focus.position:.1f}\nERROR_MIN={focus.error:.5f}\n")
    return SOLVED
