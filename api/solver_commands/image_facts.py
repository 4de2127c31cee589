"""What a command must know of an image before it is solved, and the rows of pictures counted from below."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BufferedReader, FileIO
from typing import BinaryIO

from api.solver_commands.host import Solver
from mountnav.reading.content import OnDisk
from mountnav.reading.fits_headers import chosen_hdu, walk
from mountnav.sky.wcs_numbers import Value

_FITS = b"SIMPLE"
_PACKED = (b"\x1f\x8b", b"BZh")
"""How files begin that gzip and bzip2 have packed: what is inside is FITS, nobody packs pictures."""
_MOST_PLANES = 4
"""Planes of a color picture; an axis of so few pixels is one of colors."""
_SIP_TERM = re.compile(r"([AB])P?_\d+_(\d+)$")


@dataclass(frozen=True, slots=True)
class ImageFacts:
    """What is known without looking at the pixels.

    Attributes
    ----------
    rows_down : bool
        The file's first row is the top one, as in pictures; FITS files begin at the bottom.
    header : dict
        FITS cards; empty for pictures.
    """

    width_px: int
    height_px: int
    rows_down: bool
    header: dict[str, str | int | float | bool] = field(default_factory=dict)


def image_facts(file: BinaryIO, name: str, solver: Solver) -> ImageFacts:
    """Look at the head of an image; only what tells nothing there is read whole.

    Parameters
    ----------
    file : BinaryIO
        With a descriptor.
    name : str
        What to call it.
    solver : Solver
        Reads what tells nothing in its head.

    Raises
    ------
    BadFrame
        No image.
    """
    try:
        return _looked_at(file, name, solver)
    finally:
        os.lseek(file.fileno(), 0, os.SEEK_SET)  # what reads on begins at the beginning


def _looked_at(file: BinaryIO, name: str, solver: Solver) -> ImageFacts:
    content = OnDisk(FileIO(file.fileno(), closefd=False))
    head = content[: len(_FITS)]
    if head == _FITS:
        hdus = walk(content, name)
        unit = chosen_hdu(hdus, None, name)
        height, width = _sides(unit.shape)
        return ImageFacts(width, height, False, {**hdus[0].cards.values, **unit.cards.values})
    seen = None if head.startswith(_PACKED) else _picture_facts(file)
    if seen is not None:
        return seen
    frame = solver.read(file, name)
    return ImageFacts(frame.width_px, frame.height_px, not head.startswith(_PACKED), dict(frame.header))


def _sides(shape: tuple[int, ...]) -> tuple[int, int]:
    """Height and width of the plane that mountnav makes of an image of this shape."""
    axes = [side for side in shape if side != 1] or [1, 1]
    if len(axes) == 3 and axes[2] <= _MOST_PLANES < axes[0]:
        return axes[0], axes[1]
    return (axes[-2], axes[-1]) if len(axes) > 1 else (1, axes[0])


def _picture_facts(file: BinaryIO) -> ImageFacts | None:
    """What the head of a picture says; None for what is none of the usual kinds."""
    from PIL import Image

    from mountnav.reading.pictures import FORMATS

    try:
        with Image.open(BufferedReader(FileIO(file.fileno(), closefd=False)), formats=FORMATS) as picture:
            # TIFF also holds raw files of cameras, and its first image may be a small one
            if picture.format == "TIFF":
                return None
            # ASTAP takes the first row of PGM and its kin for the lowest
            return ImageFacts(picture.width, picture.height, picture.format != "PPM")
    except (
        OSError,
        ValueError,
        SyntaxError,
        TypeError,
        OverflowError,
        Warning,
        Image.DecompressionBombError,
    ):
        return None  # who reads it whole says what is wrong


def rows_up(cards: Mapping[str, Value], height_px: int) -> dict[str, Value]:
    """The cards of a picture with its rows counted from the bottom, as FITS and ASTAP count.

    Parameters
    ----------
    cards : mapping
        TAN or TAN-SIP of rows that are counted from the top.

    Returns
    -------
    dict
        With the mirrored parity.
    """
    turned: dict[str, Value] = {}
    for name, value in cards.items():
        term = _SIP_TERM.match(name)
        if name == "CRPIX2":
            value = height_px + 1.0 - float(value)
        elif name in ("CD1_2", "CD2_2"):
            value = -float(value)
        elif term is not None:
            # v becomes -v: odd powers change their sign, and so does what is added to v itself
            odd = int(term[2]) % 2 == 1
            value = -float(value) if odd != (term[1] == "B") else float(value)
        turned[name] = value
    return turned


def one_line(text: str) -> str:
    """A text as one line of printable ASCII: file names and reasons must not break the lines of a result."""
    for sign, word in (
        ("″", '"'),
        ("′", "'"),
        ("°", " deg"),
        ("×", "x"),
        ("–", "-"),
        ("−", "-"),
        ("±", "+-"),
    ):
        text = text.replace(sign, word)
    words = " ".join(text.split())
    return "".join(letter if " " <= letter <= "~" else "?" for letter in words)


def number(text: str | None) -> float | None:
    """A number with a point or a comma; None for all else."""
    try:
        value = float((text or "").strip().replace(",", "."))
    except ValueError:
        return None
    return value if math.isfinite(value) else None
