"""The index on disk: header, sections, and how a quad is packed. Builder and reader agree here alone.

::

    offset  what
    0       magic "MNAVQUAD" (8 bytes)
    8       u32 version
    12      u32 length of the header text
    16      header text: JSON, padded with spaces so that the sections start at a multiple of 4096
    ...     sections, each at a multiple of 4096:
            codes    u8 (n, 4)    place of each quad within its cell of the code raster
            cells    u32 (c + 1)  first quad of each cell of the raster
            quads    u64 (n)      star number of A (22 bits), and of B, C, D less that of A (14 bits each)
            rows     u32 (s)      catalog row of each star number: all levels, one after the other
            grid     u32          for each level, first star of each cell of its grid, and the end

All numbers are little-endian. Quads are sorted by their cell. A code's four numbers run over 0..0.5,
0..0.875, 0..1 and -0.875..0.875; a cell is 1/48 wide, the position within it in steps of a 256th of that.
"""

from __future__ import annotations

import json
import mmap
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadSettings
from mountnav.files import open_buffered
from mountnav.parsing import json_of

Index = NDArray[np.int64]

MAGIC = b"MNAVQUAD"
VERSION = 1
"""Raised when the form changes, and when other quads are built: a cache holds one file for each version."""
PREAMBLE_BYTES = 16
"""Magic, version and length of the header text. Part of the format."""
ALIGNMENT_BYTES = 4096
"""Sections start at multiples of a memory page, so that they can be mapped. Part of the format."""
LONGEST_HEADER_BYTES = 65536
"""A longer header text is refused as damage: real ones have less than 4 kB, whatever the catalog."""
_EARLIEST_YR, _LATEST_YR = 1800.0, 2300.0
"""Julian years that stars may be of: beyond, no catalog's proper motions hold; doubled, nonsense passes."""
_MOST_ROWS = 1 << 40
"""A header with more quads, stars or cells than this is refused as damage: a thousand times those of the
deepest index."""

CELLS_PER_UNIT = 48
"""Cells of the code raster per unit of a code: it divides the widths of the four numbers (0.5, 0.875, 1,
1.75) into whole cells. Part of the format."""
STEPS_PER_CELL = 256
"""Steps within a cell: what one byte holds. Part of the format."""
STEP = 1.0 / (CELLS_PER_UNIT * STEPS_PER_CELL)
"""Resolution of a stored code: 8.1e-5 of the widest pair's distance. Part of the format."""
LOW = np.array([0.0, 0.0, 0.0, -0.875])
"""Least value of Re c, Im c, Re d and Im d (`quads.codes`)."""
RASTER = (24, 42, 48, 84)
"""Cells along each number of the code."""
STRIDES = np.array([RASTER[1] * RASTER[2] * RASTER[3], RASTER[2] * RASTER[3], RASTER[3], 1])
"""A cell's number is the dot product of its four coordinates with these."""
CELLS = RASTER[0] * RASTER[1] * RASTER[2] * RASTER[3]
"""Number of cells."""

STAR_BITS, DELTA_BITS = 22, 14
"""Bits of a packed quad: number of star A, and distances in the list of B, C and D from it, 64 in all. Part
of the format."""
MOST_STARS = 1 << STAR_BITS
"""Stars that 22 bits can number: 4.19 million. The embedded catalog's levels have 3.46 million."""
DELTA_ZERO = 1 << (DELTA_BITS - 1)
"""A packed distance of 0 is stored as this, so that distances of both signs fit."""


@dataclass(frozen=True, slots=True)
class Header:
    """What an index says about itself.

    Attributes
    ----------
    catalog, catalog_sha256 : str
        Which catalog the rows are of: its name and the hash of its sections.
    epoch_yr : float
        Julian year for which shapes were computed.
    level_stars : list of int
        Stars of each level, the finest first.
    """

    catalog: str
    catalog_sha256: str
    epoch_yr: float
    quads: int
    level_stars: list[int]
    grid_lengths: list[int]

    def layout(self) -> dict[str, tuple[int, int]]:
        """Section name to (offset, length) in bytes from the end of the header; ``end`` holds the total."""
        stars = sum(self.level_stars)
        lengths = {
            "codes": 4 * self.quads,
            "cells": 4 * (CELLS + 1),
            "quads": 8 * self.quads,
            "rows": 4 * stars,
            "grid": 4 * sum(self.grid_lengths),
        }
        places: dict[str, tuple[int, int]] = {}
        at = 0
        for section, length in lengths.items():
            places[section] = (at, length)
            at += -(-length // ALIGNMENT_BYTES) * ALIGNMENT_BYTES
        places["end"] = (at, 0)
        return places


def encode_header(header: Header, *, least_bytes: int = 0) -> bytes:
    """Preamble and header text, padded to the alignment; the same bytes for the same header.

    Parameters
    ----------
    least_bytes : int
        It is padded to so many, a multiple of the alignment: the room that was left for it.
    """
    text = json.dumps(asdict(header), sort_keys=True).encode("ascii").ljust(least_bytes - PREAMBLE_BYTES)
    text += b" " * (-(PREAMBLE_BYTES + len(text)) % ALIGNMENT_BYTES)
    return MAGIC + VERSION.to_bytes(4, "little") + len(text).to_bytes(4, "little") + text


def decode_header(start: bytes, *, file: str) -> tuple[Header, int]:
    """Read the header from the first bytes of a file.

    Returns
    -------
    (Header, int)
        The header, and the offset at which the sections start.

    Raises
    ------
    BadSettings
        The bytes are no index of this version.
    """
    if len(start) < PREAMBLE_BYTES or start[:8] != MAGIC:
        raise damaged(file, f"no index: it starts with {start[:8]!r}, not {MAGIC!r}")
    version = int.from_bytes(start[8:12], "little")
    if version != VERSION:
        raise damaged(file, f"an index of version {version}, not {VERSION}")
    length = int.from_bytes(start[12:16], "little")
    text = start[PREAMBLE_BYTES : PREAMBLE_BYTES + length]
    if not 0 < length <= LONGEST_HEADER_BYTES or len(text) < length:
        raise damaged(file, f"cut short: {len(text)} of {length} bytes of header")
    try:
        header = Header(**json_of(text))
        sizes = [header.quads, *header.level_stars, *header.grid_lengths]
        sound = all(type(size) is int and 0 <= size < _MOST_ROWS for size in sizes) and (
            len(header.level_stars) == len(header.grid_lengths) > 0
            and 0 < sum(header.level_stars) <= MOST_STARS
        )
        epoch_yr = float(header.epoch_yr)
    except (ValueError, TypeError, OverflowError) as broken:
        raise damaged(file, f"damaged: {broken}") from broken
    if not sound:
        raise damaged(file, "damaged: its header tells impossible sizes")
    if not _EARLIEST_YR <= epoch_yr <= _LATEST_YR:
        raise damaged(file, f"damaged: its stars are of the year {epoch_yr:g}")
    return header, PREAMBLE_BYTES + length


def damaged(file: str, what: str) -> BadSettings:
    """The error that says what is wrong with an index file, to be raised by the caller."""
    return BadSettings(what, device=file, advice="build it again: mountnav catalog index --force")


def stepped(code: NDArray[np.float64]) -> NDArray[np.float64]:
    """Codes in steps from the raster's corner; shape as given, not rounded."""
    steps: NDArray[np.float64] = (code - LOW) / STEP
    return steps


def pack(stars: Index) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    """Pack star numbers of quads.

    Parameters
    ----------
    stars : ndarray of int, shape (n, 4)
        In the order A, B, C, D.

    Returns
    -------
    packed : ndarray of uint64, shape (k,)
        One number a quad.
    fits : ndarray of bool, shape (n,)
        Which of them are packed: those whose numbers lie near enough to each other.
    """
    delta = stars[:, 1:] - stars[:, :1] + DELTA_ZERO
    fits: NDArray[np.bool_] = np.all((delta >= 0) & (delta < 2 * DELTA_ZERO), axis=1)
    packed = stars[fits, 0].astype(np.uint64)
    for column in delta[fits].T:
        packed = (packed << np.uint64(DELTA_BITS)) | column.astype(np.uint64)
    return packed, fits


def unpack(packed: NDArray[np.uint64]) -> Index:
    """Star numbers of quads in the order A, B, C, D; shape (n, 4)."""
    whole = packed.astype(np.int64, copy=False)
    first = (whole >> (3 * DELTA_BITS)) & (MOST_STARS - 1)
    mask = 2 * DELTA_ZERO - 1
    deltas = [((whole >> (shift * DELTA_BITS)) & mask) - DELTA_ZERO for shift in (2, 1, 0)]
    return np.stack([first, *(first + delta for delta in deltas)], axis=1)


def mapped(path: Path) -> mmap.mmap:
    """Map a file for reading, without reading ahead.

    Parameters
    ----------
    path : Path
        Not empty.

    Raises
    ------
    OSError
        It can't be opened.
    """
    with open_buffered(path) as file:
        whole = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    if hasattr(mmap, "MADV_RANDOM"):  # not known everywhere
        with suppress(OSError):
            whole.madvise(mmap.MADV_RANDOM)
    return whole


def unmap(whole: mmap.mmap) -> None:
    """Release the pages that were read; the system keeps what it has room for, for the next search.

    The system maps a file in pieces much larger than what is read of it: without this, the whole file would
    count as this process' memory after a few searches.
    """
    if hasattr(mmap, "MADV_DONTNEED"):
        with suppress(OSError):
            whole.madvise(mmap.MADV_DONTNEED)
