"""A camera's raw file made by the standard's words [DNG 1.4]: a Bayer mosaic of 16 bits, not packed."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

SHORT, LONG, RATIONAL, ASCII, BYTE, SRATIONAL = 3, 4, 5, 2, 1, 10


def dng(mosaic: NDArray[np.uint16], *, pattern: bytes = bytes((0, 1, 1, 2))) -> bytes:
    """A DNG of a mosaic, shape (height, width); the pattern is RGGB by default."""
    height, width = mosaic.shape
    identity = struct.pack("<18i", *(value for cell in (1, 0, 0, 0, 1, 0, 0, 0, 1) for value in (cell, 1)))
    exif = _directory([(0x829A, RATIONAL, 1, struct.pack("<2I", 5, 2))], 0)
    data = mosaic.astype("<u2").tobytes()
    tags: list[tuple[int, int, int, bytes]] = [
        (254, LONG, 1, struct.pack("<I", 0)),
        (256, LONG, 1, struct.pack("<I", width)),
        (257, LONG, 1, struct.pack("<I", height)),
        (258, SHORT, 1, struct.pack("<H", 16)),
        (259, SHORT, 1, struct.pack("<H", 1)),
        (262, SHORT, 1, struct.pack("<H", 32803)),
        (271, ASCII, 9, b"Mountnav\0"),
        (272, ASCII, 6, b"Drawn\0"),
        (273, LONG, 1, b"DATA"),
        (274, SHORT, 1, struct.pack("<H", 1)),
        (277, SHORT, 1, struct.pack("<H", 1)),
        (278, LONG, 1, struct.pack("<I", height)),
        (279, LONG, 1, struct.pack("<I", len(data))),
        (284, SHORT, 1, struct.pack("<H", 1)),
        (33421, SHORT, 2, struct.pack("<2H", 2, 2)),
        (33422, BYTE, 4, pattern),
        (0x8769, LONG, 1, b"EXIF"),
        (50706, BYTE, 4, bytes((1, 4, 0, 0))),
        (50707, BYTE, 4, bytes((1, 1, 0, 0))),
        (50708, ASCII, 15, b"Mountnav Drawn\0"),
        (50714, SHORT, 1, struct.pack("<H", 100)),
        (50717, LONG, 1, struct.pack("<I", 65535)),
        (50721, SRATIONAL, 9, identity),
        (50778, SHORT, 1, struct.pack("<H", 21)),
    ]
    length = len(_directory(tags, 8))
    at = {b"EXIF": 8 + length, b"DATA": 8 + length + len(exif)}
    tags = [
        (tag, kind, count, struct.pack("<I", at[value]) if value in at else value)
        for tag, kind, count, value in tags
    ]
    exif = _directory([(0x829A, RATIONAL, 1, struct.pack("<2I", 5, 2))], at[b"EXIF"])
    return b"II*\0" + struct.pack("<I", 8) + _directory(tags, 8) + exif + data


def _directory(tags: list[tuple[int, int, int, bytes]], start: int) -> bytes:
    """A directory of TIFF with the values that have no room in it behind it."""
    behind = start + 2 + 12 * len(tags) + 4
    entries, values = b"", b""
    for tag, kind, count, value in tags:
        if len(value) > 4:
            place = struct.pack("<I", behind + len(values))
            values += value + bytes(len(value) % 2)
        else:
            place = value.ljust(4, b"\0")
        entries += struct.pack("<HHI", tag, kind, count) + place
    return struct.pack("<H", len(tags)) + entries + bytes(4) + values
