"""`image2xy`: the stars of an image as a FITS table, brightest first."""

from __future__ import annotations

import os
from contextlib import closing
from typing import BinaryIO

from api.solver_commands.getopt_long import Option, UnknownOption, parted
from api.solver_commands.host import Host, Solver
from mountnav.errors import MountnavError

__all__ = ["run"]

ERROR_CODE = 255
"""Exit code of the original for all errors."""
_FLAGS = "O8Hvb"
_VALUES = "LwamgGPsSBMUCpedDo"
_OPTIONS = (
    Option("help", "h"),
    *(Option(f"option {letter}", letter) for letter in _FLAGS),
    *(Option(f"option {letter}", letter, "needed") for letter in _VALUES),
)
"""The original's; only -O and -o have an effect."""
_USAGE = """Usage: image2xy [options] image
    [-O]: overwrite an existing output file
    [-o <output-file>]: by default the image's name with .xy.fits in place of its ending
All other options of the original are accepted and ignored.
"""


def run(arguments: list[str], host: Host, solver: Solver) -> int:
    """Measure an image and write the table of its stars: X, Y (from 1 on), FLUX, BACKGROUND.

    Returns
    -------
    int
        0, or 255 where the image can't be read or the table can't be written.
    """
    try:
        asked = parted(arguments, _OPTIONS)
    except UnknownOption as fault:
        host.err(f"image2xy: {fault}\n")
        host.err(_USAGE)
        return 0  # as the original
    if asked.given("help"):
        host.err(_USAGE)
        return 0
    if len(asked.files) != 1:
        host.err(_USAGE)
        return ERROR_CODE
    name = asked.files[0]
    output = asked.last("option o") or f"{os.path.splitext(name)[0]}.xy.fits"
    try:
        if host.exists(output) and not asked.given("option O"):
            host.err(f"image2xy: {output} is there already; -O overwrites it\n")
            return ERROR_CODE
        with closing(host.open(name)) as file:
            content, count = _table_of(solver, file, name)
        host.write(output, content)
    except (MountnavError, OSError) as fault:
        host.err(f"image2xy: {fault}\n")
        return ERROR_CODE
    host.out(f"simplexy: found {count} sources.\n")
    return 0


def _table_of(solver: Solver, file: BinaryIO, name: str) -> tuple[bytes, int]:
    """The table, and how many stars it has."""
    from api.solver_commands.star_tables import sources_table
    from mountnav.measuring.measure import measure

    frame = solver.read(file, name)
    found = measure(frame)
    content = sources_table(
        found.x_px,
        found.y_px,
        found.flux,
        found.background_adu,
        width_px=frame.width_px,
        height_px=frame.height_px,
        primary={"SRCFN": os.path.basename(name).encode("ascii", "replace").decode()[:60]},
    )
    return content, len(found)
