"""The command `watney-solve`: `blind` and `nearby`, answers as JSON or tab-separated lines, a `.wcs`."""

from __future__ import annotations

import json
import math
import os
import re
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import BinaryIO

from api.solver_commands.host import Asked, Host, Solver
from api.solver_commands.image_facts import ImageFacts, image_facts, number, one_line
from api.solver_commands.plate_result import Field, hint_of, judged, numbers_of, opened, place
from mountnav.errors import MountnavError
from mountnav.reading.fits_update import wcs_header
from mountnav.reading.star_lists import ListFormat
from mountnav.sky.coordinates import Icrs
from mountnav.sky.wcs_numbers import linear_cards
from mountnav.solution import Solution
from mountnav.version import version

DONE, FAILED = 0, 1
"""Exit codes, as Watney has them: a frame that isn't solved is no failure."""
DEFAULT_SEARCH_DEG = 10.0
"""Radius about the hint where none is given, as in Watney; the whole sky follows anyway. Doubled, hopeless
frames take longer."""
_LEAST_FIELD_DEG, _MOST_FIELD_DEG = 0.1, 16.0
"""Field radii that Watney takes, degrees; others are an error there."""
_VALUES = {
    "use-config": "", "image": "i", "xyls": "", "xyls-imagesize": "", "max-stars": "", "sampling": "",
    "out-format": "", "out": "o", "wcs": "w", "lower-density-offset": "x", "higher-density-offset": "z",
    "log-file": "", "limit-threads": "", "ra": "r", "dec": "d", "field-radius": "f",
    "field-radius-range": "g", "field-radius-steps": "n", "search-radius": "s", "use-parallelism": "p",
    "min-radius": "", "max-radius": "",
}  # fmt: skip
"""Options with a value, and their letters."""
_FLAGS = {
    "image-stdin": "", "xyls-stdin": "", "extended": "", "log-stdout": "", "benchmark": "", "manual": "m",
    "use-fits-headers": "h", "east-first": "", "west-first": "", "north-first": "", "south-first": "",
    "version": "", "help": "",
}  # fmt: skip
_USAGE = """\
Watney's command line, answered by mountnav
usage: watney-solve blind  -i FILE [--min-radius DEG --max-radius DEG]
       watney-solve nearby -i FILE -m -r RA -d DEC -f FIELD_RADIUS | -h   [-s SEARCH_RADIUS]
input: -i FILE | --image-stdin | --xyls FILE --xyls-imagesize WxH | --xyls-stdin --xyls-imagesize WxH
output: [-o OUT] [--out-format json|tsv] [--extended] [-w WCS] [--log-file FILE] [--log-stdout]
Read and not needed: --use-config --max-stars --sampling --lower-density-offset --higher-density-offset
--use-parallelism --limit-threads --benchmark --field-radius-steps --east-first --west-first ...
"""


class _Wrong(Exception):
    """Arguments that make no sense; the text says which."""


@dataclass(slots=True)
class _Call:
    """One call, as its arguments say."""

    verb: str
    values: dict[str, str]
    flags: set[str]
    log: list[str] = field(default_factory=list)

    def number(self, name: str) -> float | None:
        """An option's number; None if not given."""
        if name not in self.values:
            return None
        value = number(self.values[name])
        if value is None:
            raise _Wrong(f"--{name}: invalid number format.")
        return value


def run(arguments: list[str], host: Host, solver: Solver) -> int:
    """Carry out `watney-solve`.

    Parameters
    ----------
    arguments : list of str
        The verb first.

    Returns
    -------
    int
        0 also when not solved, 1 on errors.
    """
    if not arguments or arguments[0] in ("help", "--help"):
        host.out(_USAGE)
        return DONE if arguments else FAILED
    if arguments[0] in ("version", "--version"):
        host.out(f"Watney Astrometric Solver, answered by mountnav {version()}\n")
        return DONE
    try:
        call = _parsed(arguments)
    except _Wrong as wrong:
        host.out(f"{_USAGE}\nERROR(S):\n  {one_line(str(wrong))}\n")
        return FAILED
    call.log.append("watney-solve " + " ".join(arguments))
    try:
        code = _carried_out(call, host, solver)
    except _Wrong as wrong:
        call.log.append(f"error: {wrong}")
        host.out(f"{_USAGE}\nERROR(S):\n  {one_line(str(wrong))}\n")
        code = FAILED
    except (MountnavError, OSError, ValueError) as fault:
        call.log.append(f"error: {fault}")
        host.out(f"WATNEY ERROR: Problem with solver input. {one_line(str(fault))}\n")
        code = FAILED
    return _logged(call, code, host)


def _parsed(arguments: list[str]) -> _Call:
    """Take the arguments apart: `--name value`, `--name=value`, `-x value`, `-xvalue`."""
    verb = arguments[0]
    if verb not in ("blind", "nearby"):
        raise _Wrong(f"Verb '{verb}' is not recognized.")
    letters = {letter: name for name, letter in (*_VALUES.items(), *_FLAGS.items()) if letter}
    values: dict[str, str] = {}
    flags: set[str] = set()
    rest = list(arguments[1:])
    while rest:
        word = rest.pop(0)
        if word.startswith("--"):
            name, equals, value = word[2:].partition("=")
        elif word.startswith("-") and len(word) > 1 and word[1] in letters:
            name, value = letters[word[1]], word[2:].removeprefix("=")
            equals = value
        elif word.startswith("-"):
            raise _Wrong(f"Option '{word.lstrip('-')}' is unknown.")
        else:
            continue  # a word that belongs to no option
        if name in _FLAGS:
            said = value if equals else ""
            if not said and rest and rest[0].lower() in ("true", "false"):
                said = rest.pop(0)
            if said.lower() != "false":
                flags.add(name)
        elif name in _VALUES:
            if not equals:
                if not rest:
                    raise _Wrong(f"Option '{name}' has no value.")
                value = rest.pop(0)
            values[name] = value
        else:
            raise _Wrong(f"Option '{name}' is unknown.")
    return _Call(verb, values, flags)


def _carried_out(call: _Call, host: Host, solver: Solver) -> int:
    """Solve, and write what comes of it."""
    began_s = time.monotonic()
    tabs = call.values.get("out-format", "json")
    if tabs not in ("json", "tsv"):
        raise _Wrong("--out-format: must be either json or tsv")
    size = _list_size(call)
    file, name = _input(call, host)
    with file:
        if size is None:
            facts, stars = image_facts(file, name, solver), None
        else:
            facts = ImageFacts(size[0], size[1], False)
            stars = ListFormat(width_px=size[0], height_px=size[1])
        center, stated = _hint(call, facts)
        radius_deg = call.number("search-radius")
        hint = hint_of(
            center, DEFAULT_SEARCH_DEG if radius_deg is None else radius_deg, stated, "--ra and --dec"
        )
        verdict = solver.solve(Asked(file, name, hint, stars=stars))
    plate = judged(verdict, stated)
    call.log += [plate.why] if plate.why else []
    call.log += list(plate.warnings)
    spent_s = time.monotonic() - began_s
    answer = _answer(plate.solution, call, facts, center, radius_deg)
    if "extended" in call.flags:
        measured = {
            "starsDetected": verdict.measured,
            "starsUsed": plate.solution.pairs if plate.solution is not None else 0,
            "timeSpent": _clock(spent_s),
            "searchIterations": int(verdict.numbers.get("hypotheses", 0.0)),
        }
        at = 9 if plate.solution is not None else 1
        items = list(answer.items())
        answer = dict([*items[:at], *measured.items(), *items[at:]])
    text = _as_json(answer) if tabs == "json" else _as_tabs(answer)
    if "out" in call.values:
        host.write(call.values["out"], text.encode("ascii"))
    else:
        host.out(text + "\n")
    if plate.solution is not None and "wcs" in call.values:
        host.write(call.values["wcs"], wcs_header(linear_cards(plate.solution.wcs)))
    call.log += _as_tabs(answer).splitlines()
    return DONE


def _list_size(call: _Call) -> tuple[int, int] | None:
    """The size that goes with a list of stars; None for an image."""
    if "xyls" not in call.values and "xyls-stdin" not in call.flags:
        return None
    found = re.fullmatch(r"(\d{1,6})x(\d{1,6})", call.values.get("xyls-imagesize", ""))
    if found is None or 0 in (width := int(found[1]), height := int(found[2])):
        raise _Wrong("a valid size in --xyls-imagesize must be provided")
    return width, height


def _input(call: _Call, host: Host) -> tuple[BinaryIO, str]:
    """Open what is to be solved."""
    if call.flags & {"image-stdin", "xyls-stdin"}:
        content = host.read_input()
        if not content:
            raise _Wrong("image expected from stdin but not received")
        kept = tempfile.TemporaryFile()  # noqa: SIM115 - the solver wants a descriptor
        kept.write(content)
        kept.flush()
        kept.seek(0)
        return kept, "stdin"
    path = call.values.get("xyls") or call.values.get("image")
    if not path:
        raise _Wrong("image or xyls filename was not supplied")
    return opened(host, path), os.path.basename(path)


def _hint(call: _Call, facts: ImageFacts) -> tuple[Icrs | None, Field | None]:
    """Where to look, and the field's size."""
    if call.verb == "blind":
        return None, _field_of(_blind_radii(call), facts, "--min-radius and --max-radius")
    if "manual" not in call.flags:
        if "use-fits-headers" not in call.flags:
            raise _Wrong("either --use-fits-headers or --manual flag should be selected.")
        if not facts.header:
            raise _Wrong("--use-fits-headers: the input has no FITS header, --manual is needed.")
        return None, None  # the solver reads the header
    for name in ("ra", "dec"):
        if not call.values.get(name, "").strip():
            raise _Wrong(f"--{name}: parameter was not provided.")
    ra_deg = _angle(call.values["ra"], 15.0)
    dec_deg = _angle(call.values["dec"], 1.0)
    center = None if ra_deg is None or dec_deg is None else place(ra_deg, dec_deg)
    if center is None:
        raise _Wrong("--ra, --dec: invalid number format.")
    return center, _field_of(_near_radii(call), facts, "--field-radius")


def _angle(text: str, per_unit: float) -> float | None:
    """Degrees of a number in degrees, or of three numbers in hours or degrees; None if neither."""
    words = text.split()
    values = [number(word) for word in words]
    if len(words) == 1:
        return values[0]
    if len(words) != 3 or any(value is None for value in values):
        return None
    whole, minutes, seconds = (abs(value or 0.0) for value in values)
    sign = -1.0 if words[0].startswith("-") else 1.0
    return sign * per_unit * (whole + minutes / 60.0 + seconds / 3600.0)


def _blind_radii(call: _Call) -> tuple[float, float] | None:
    least, most = call.number("min-radius"), call.number("max-radius")
    if least is None and most is None:
        return None
    low, high = least if least is not None else 0.5, most if most is not None else 8.0
    if low < _LEAST_FIELD_DEG:
        raise _Wrong(f"--min-radius: value must be >= {_LEAST_FIELD_DEG}")
    if high > _MOST_FIELD_DEG:
        raise _Wrong(f"--max-radius: value must be <= {_MOST_FIELD_DEG}")
    if low > high:
        raise _Wrong("--max-radius: value must be larger >= --min-radius")
    return low, high


def _near_radii(call: _Call) -> tuple[float, float]:
    found = re.fullmatch(r"(\d+\.?\d*)-(\d+\.?\d*)", call.values.get("field-radius-range", ""))
    if found is not None:
        low, high = sorted((float(found[1]), float(found[2])))
    else:
        given = call.number("field-radius")
        if given is None or given <= 0.0:
            raise _Wrong("--field-radius or --field-radius-range: was not provided.")
        low = high = given
    if not _LEAST_FIELD_DEG <= low <= high <= _MOST_FIELD_DEG:
        raise _Wrong(f"--field-radius: must lie between {_LEAST_FIELD_DEG} and {_MOST_FIELD_DEG}")
    return low, high


def _field_of(radii: tuple[float, float] | None, facts: ImageFacts, source: str) -> Field | None:
    """The field whose half diagonal lies between two radii."""
    if radii is None:
        return None
    middle_deg = math.sqrt(radii[0] * radii[1])
    diagonal_px = math.hypot(facts.width_px, facts.height_px)
    return Field(2.0 * middle_deg, diagonal_px, source, span=math.sqrt(radii[1] / radii[0]))


def _answer(
    solution: Solution | None,
    call: _Call,
    facts: ImageFacts,
    center: Icrs | None,
    radius_deg: float | None,
) -> dict[str, object]:
    """What is told, in Watney's order. Rows count as in the file: Watney doesn't turn pictures."""
    if solution is None:
        return {"success": False}
    cards = linear_cards(solution.wcs)
    numbers = numbers_of(cards)
    sign = numbers.determinant_sign
    cd = {name: float(cards[name]) for name in ("CD1_1", "CD1_2", "CD2_1", "CD2_2")}
    crota1_deg = math.degrees(math.atan2(sign * cd["CD1_2"], cd["CD2_2"]))
    crota2_deg = -math.degrees(math.atan2(cd["CD2_1"], sign * cd["CD1_1"]))
    told: dict[str, object] = {
        "success": True,
        "ra": numbers.ra_deg,
        "dec": numbers.dec_deg,
        "ra_hms": _sexagesimal(numbers.ra_deg / 15.0),
        "dec_dms": _sexagesimal(numbers.dec_deg),
        "fieldRadius": numbers.radius_deg,
        "orientation": crota1_deg,
        "pixScale": numbers.pixscale_arcsec,
        "parity": "normal" if sign < 0 else "flipped",
    }
    if "extended" not in call.flags:
        return told
    about = center if center is not None else solution.center
    fits_cards: Iterable[tuple[str, float]] = (
        *cd.items(),
        ("CDELT1", numbers.cdelt1_deg),
        ("CDELT2", numbers.cdelt2_deg),
        ("CROTA1", crota1_deg),
        ("CROTA2", crota2_deg),
        *((name, float(cards[name])) for name in ("CRPIX1", "CRPIX2", "CRVAL1", "CRVAL2")),
    )
    return told | {
        "imageWidth": facts.width_px,
        "imageHeight": facts.height_px,
        "searchRunCenter": f"[{_sexagesimal(about.ra_deg / 15.0)}, {_sexagesimal(about.dec_deg)}]",
        "searchRunRadius": DEFAULT_SEARCH_DEG if radius_deg is None else radius_deg,
        "quadMatches": solution.pairs,
        "fieldWidth": numbers.width_deg,
        "fieldHeight": numbers.height_deg,
        **{f"fits_{name.lower()}": value for name, value in fits_cards},
    }


def _sexagesimal(value: float) -> str:
    """Whole units, minutes and seconds with blanks between, as Watney writes them."""
    hundredths = round(abs(value) * 360_000)
    whole, rest = divmod(hundredths, 360_000)
    minutes, seconds = divmod(rest, 6_000)
    text = f"{seconds / 100:.2f}".rstrip("0").rstrip(".")
    return f"{'-' if value < 0 else ''}{whole} {minutes} {text}"


def _clock(spent_s: float) -> str:
    minutes, seconds = divmod(spent_s, 60.0)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours:02d}:{minutes:02d}:{seconds:010.7f}"


def _as_json(answer: dict[str, object]) -> str:
    return json.dumps(answer, indent=2)


def _as_tabs(answer: dict[str, object]) -> str:
    def text(value: object) -> str:
        return str(value).lower() if isinstance(value, bool) else str(value)

    return "\n".join(f"{name}\t{text(value)}" for name, value in answer.items())


def _logged(call: _Call, code: int, host: Host) -> int:
    """Write the log where one is wanted."""
    text = "".join(one_line(line) + "\n" for line in call.log)
    if "log-stdout" in call.flags:
        host.out(text)
    path = call.values.get("log-file", "")
    if path:
        try:
            host.write(path, text.encode("ascii"))
        except (OSError, ValueError) as fault:
            host.err(f"{one_line(path)} can't be written: {one_line(str(fault))}\n")
            return FAILED
    return code
