"""The command of All Sky Plate Solver: `/solvefile FILE OUT focal_mm pixel_um ra_deg dec_deg radius_deg`."""

from __future__ import annotations

import os

from api.solver_commands.host import Asked, Host, Solver
from api.solver_commands.image_facts import ImageFacts, image_facts, number, one_line
from api.solver_commands.plate_result import (
    WIDEST_RADIUS_DEG,
    Field,
    hint_of,
    judged,
    numbers_of,
    opened,
    place,
    solved_cards,
)
from mountnav.errors import MountnavError
from mountnav.units import pixel_scale_arcsec

SOLVED, UNSOLVED = 0, 1
"""Exit codes; the original's aren't documented, readers look at the result file."""
_USAGE = "usage: /solvefile FILE OUT focal_mm pixel_um ra_deg dec_deg radius_deg\n"


def run(arguments: list[str], host: Host, solver: Solver) -> int:
    """Carry out All Sky Plate Solver's command.

    Parameters
    ----------
    arguments : list of str
        "/solvefile", the image, the result file; focal length in mm, pixels in µm, place and radius in
        degrees: zeros or nothing where unknown.

    Returns
    -------
    int
        0 solved, 1 not.
    """
    if len(arguments) < 3 or arguments[0].lower() != "/solvefile" or not all(arguments[1:3]):
        host.err(_USAGE)
        return UNSOLVED
    path, out = arguments[1:3]
    values = [number(word) or 0.0 for word in arguments[3:8]]
    focal_mm, pixel_um, ra_deg, dec_deg, radius_deg = values + [0.0] * (5 - len(values))
    if os.path.normpath(out) == os.path.normpath(path):
        host.err("the result file is the image itself, it is left as it is\n")
        return UNSOLVED
    name = os.path.basename(path)
    try:
        with opened(host, path) as file:
            facts = image_facts(file, name, solver)
            field = _field(focal_mm, pixel_um, facts)
            center = place(ra_deg, dec_deg) if ra_deg or dec_deg else None  # zeros mean: unknown
            hint = hint_of(center, radius_deg if radius_deg > 0 else WIDEST_RADIUS_DEG, field, "the order")
            plate = judged(solver.solve(Asked(file, name, hint)), field)
    except MountnavError as fault:
        return _refused(str(fault), out, host)
    if plate.solution is None:
        return _refused(plate.why, out, host)
    numbers = numbers_of(solved_cards(plate.solution, facts, sip=False))
    found_mm = pixel_scale_arcsec(pixel_um, numbers.pixscale_arcsec) if pixel_um > 0 else focal_mm
    lines = [
        "OK",
        f"{numbers.ra_deg:.9f}",
        f"{numbers.dec_deg:.9f}",
        f"{60.0 * numbers.width_deg:.6f}",
        f"{60.0 * numbers.height_deg:.6f}",
        f"{numbers.pixscale_arcsec:.9f}",
        f"{-numbers.crota2_deg % 360.0:.9f}",
        f"{found_mm:.3f}",
    ]
    return SOLVED if _written(lines, out, host) else UNSOLVED


def _field(focal_mm: float, pixel_um: float, facts: ImageFacts) -> Field | None:
    if not (focal_mm > 0.0 and pixel_um > 0.0):
        return None
    scale_arcsec_px = pixel_scale_arcsec(pixel_um, focal_mm)
    return Field(scale_arcsec_px * facts.height_px / 3600.0, facts.height_px, "focal length and pixel size")


def _refused(why: str, out: str, host: Host) -> int:
    host.err(f"{one_line(why)}\n")
    _written(["FAILED", one_line(why)], out, host)
    return UNSOLVED


def _written(lines: list[str], out: str, host: Host) -> bool:
    try:
        host.write(out, "".join(line + "\n" for line in lines).encode("ascii"))
    except (OSError, ValueError) as fault:
        host.err(f"{one_line(out)} can't be written: {one_line(str(fault))}\n")
        return False
    return True
