"""The commands `PlateSolve2` and `PlateSolve3`: angles in radians, results beside the image.

How their numbers are read [N.I.N.A., CCDciel], ρ being CROTA2 and the sky as seen having a negative
determinant: PlateSolve2 states the angle ρ and a positive ratio for the sky as seen, ρ + 180° and a negative
one for a mirrored frame; PlateSolve3 states 180° - ρ, and a matrix with the opposite signs of CD.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

from api.solver_commands.host import Asked, Host, Solver
from api.solver_commands.image_facts import ImageFacts, image_facts, number, one_line
from api.solver_commands.plate_result import (
    WIDEST_RADIUS_DEG,
    Field,
    Plate,
    hint_of,
    judged,
    numbers_of,
    opened,
    place,
    solved_cards,
)
from mountnav.errors import MountnavError
from mountnav.sky.coordinates import Icrs
from mountnav.sky.wcs_numbers import Value, WcsNumbers
from mountnav.units import ARCSEC_PER_RAD

SOLVED, UNSOLVED = 0, 1
"""Exit codes; the originals' aren't documented, readers look at the result file."""
VALID = "Valid plate solution"
"""The third line of PlateSolve2's result; CCDciel takes a result for valid by its twenty letters."""
_LEAST_RADIUS_FIELDS = 1.5
"""Radius about the hint that is searched at least, in fields; PlateSolve2 searches the neighbors of the field
first. Doubled, hopeless frames take longer."""
_USAGE_2 = "usage: PlateSolve2 ra_rad,dec_rad,width_rad,height_rad,regions,FILE,wait\n"
_USAGE_3 = "usage: PlateSolve3 FILE [ra_rad dec_rad width_rad height_rad]\n"


@dataclass(frozen=True, slots=True)
class _Order:
    """What either command is asked for; sizes and places in radians, 0 where unknown."""

    path: str
    ra: float = 0.0
    dec: float = 0.0
    width: float = 0.0
    height: float = 0.0
    regions: float = 0.0


@dataclass(frozen=True, slots=True)
class _Result:
    """What came of it."""

    plate: Plate | None
    why: str
    cards: dict[str, Value]
    facts: ImageFacts | None


def run_platesolve2(arguments: list[str], host: Host, solver: Solver) -> int:
    """Carry out `PlateSolve2`; its result is BASE.apm.

    Parameters
    ----------
    arguments : list of str
        One, with commas; a file's name alone is solved blind.

    Returns
    -------
    int
        0 solved, 1 not.
    """
    order = _order_2(" ".join(arguments).strip())
    if not order.path:
        host.err(_USAGE_2)
        return UNSOLVED
    result = _solved(order, host, solver)
    return _written(os.path.splitext(order.path)[0] + ".apm", _apm(result), order, result, host)


def run_platesolve3(arguments: list[str], host: Host, solver: Solver) -> int:
    """Carry out `PlateSolve3`; its result is BASE_PS3.txt.

    Parameters
    ----------
    arguments : list of str
        The file; place and field in radians, zeros or nothing where unknown.

    Returns
    -------
    int
        0 solved, 1 not.
    """
    if not arguments or not arguments[0]:
        host.err(_USAGE_3)
        return UNSOLVED
    values = [number(word) or 0.0 for word in arguments[1:5]]
    order = _Order(arguments[0], *values)
    result = _solved(order, host, solver)
    return _written(os.path.splitext(order.path)[0] + "_PS3.txt", _ps3(result), order, result, host)


def _order_2(text: str) -> _Order:
    """Take PlateSolve2's argument apart; the file's name may hold commas itself."""
    parts = text.split(",")
    values = [number(part) for part in parts[:5]]
    if len(parts) < 6 or any(value is None for value in values):
        return _Order(text.strip('"'))
    name = parts[5:-1] if len(parts) > 6 and number(parts[-1]) is not None else parts[5:]
    return _Order(",".join(name).strip().strip('"'), *(value or 0.0 for value in values))


def _solved(order: _Order, host: Host, solver: Solver) -> _Result:
    name = os.path.basename(order.path)
    try:
        with opened(host, order.path) as file:
            facts = image_facts(file, name, solver)
            field = _field(order, facts)
            center = None
            if order.ra or order.dec:  # zeros mean: unknown
                center = place(math.degrees(order.ra), math.degrees(order.dec))
            radius_deg = _radius_deg(order, field, facts)
            hint = hint_of(center, radius_deg, field, "the order")
            plate = judged(solver.solve(Asked(file, name, hint)), field)
    except MountnavError as fault:
        return _Result(None, str(fault), {}, None)
    if plate.solution is None:
        return _Result(plate, plate.why, {}, facts)
    return _Result(plate, "", solved_cards(plate.solution, facts, sip=False), facts)


def _field(order: _Order, facts: ImageFacts) -> Field | None:
    width_deg, height_deg = math.degrees(order.width), math.degrees(order.height)
    if 0.0 < width_deg < 180.0:
        return Field(width_deg, facts.width_px, "the order")
    if 0.0 < height_deg < 180.0:
        return Field(height_deg, facts.height_px, "the order")
    return None


def _radius_deg(order: _Order, field: Field | None, facts: ImageFacts) -> float:
    """So many fields, in a spiral about the place, reach so far."""
    if field is None:
        return WIDEST_RADIUS_DEG
    longer_deg = field.scale_arcsec_px * max(facts.width_px, facts.height_px) / 3600.0
    return longer_deg * max(_LEAST_RADIUS_FIELDS, 0.5 * math.sqrt(max(0.0, order.regions)))


def _written(path: str, content: str, order: _Order, result: _Result, host: Host) -> int:
    solved = result.plate is not None and result.plate.solution is not None
    if not solved:
        host.err(f"{one_line(result.why)}\n")
    if os.path.normpath(path) == os.path.normpath(order.path):
        host.err(f"{one_line(path)} is the image itself, it is left as it is\n")
        return UNSOLVED
    try:
        host.write(path, content.encode("ascii"))
    except (OSError, ValueError) as fault:
        host.err(f"{one_line(path)} can't be written: {one_line(str(fault))}\n")
        return UNSOLVED
    return SOLVED if solved else UNSOLVED


def _center(numbers: WcsNumbers) -> Icrs:
    return Icrs(numbers.ra_deg, numbers.dec_deg)


def _joined(*values: float) -> str:
    """Numbers with a decimal point, whatever the locale, between commas."""
    return ",".join(f"{value:.12g}" for value in values)


def _lines(lines: Sequence[str]) -> str:
    return "".join(line + "\n" for line in lines)


def _apm(result: _Result) -> str:
    """PlateSolve2's three lines."""
    if result.plate is None or result.plate.solution is None:
        why = f"No valid plate solution: {one_line(result.why)}"
        return _lines([_joined(0, 0, -1), _joined(0, 0, 0, 0, 0), why])
    numbers = numbers_of(result.cards)
    center = _center(numbers)
    seen = numbers.determinant_sign < 0
    angle_deg = numbers.crota2_deg + (0.0 if seen else 180.0)
    ratio = numbers.cdelt2_deg / abs(numbers.cdelt1_deg) * (1.0 if seen else -1.0)
    pairs = result.plate.solution.pairs
    return _lines(
        [
            _joined(math.radians(center.ra_deg), math.radians(center.dec_deg), 1),
            _joined(numbers.pixscale_arcsec, angle_deg % 360.0, ratio, 0, pairs),
            VALID,
        ]
    )


def _ps3(result: _Result) -> str:
    """PlateSolve3's seven lines."""
    if result.plate is None or result.plate.solution is None:
        why = one_line(result.why) or "not solved"
        zeros = [_joined(*[0] * count) for count in (8, 2, 5)]
        return _lines(["False", _joined(0, 0), _joined(0, 0), why, *zeros])
    numbers, solution = numbers_of(result.cards), result.plate.solution
    center = _center(numbers)
    matrix = [-math.radians(float(result.cards[name])) for name in ("CD1_1", "CD1_2", "CD2_1", "CD2_2")]
    return _lines(
        [
            "True",
            _joined(math.radians(center.ra_deg), math.radians(center.dec_deg)),
            _joined(ARCSEC_PER_RAD / numbers.pixscale_arcsec, (180.0 - numbers.crota2_deg) % 360.0),
            "mountnav",
            _joined(*matrix, 0, 0, 0, 0),
            _joined(float(result.cards["CRPIX1"]), float(result.cards["CRPIX2"])),
            _joined(0, solution.rms_arcsec, 0, result.plate.verdict.measured, solution.pairs),
        ]
    )
