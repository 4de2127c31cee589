"""The tiles of a compressed FITS image are looked at before they are unpacked: none may outgrow the image.

The header may be honest and a tile still unpack to a thousand times its size, for gzip's streams say nothing
of their length; those of HCOMPRESS say it, and their unpacker believes them. Rice and PLIO stop at the tile's
end. [FITS 4.0 §10.1, §10.4; HCOMPRESS: White 1992]
"""

from __future__ import annotations

import math
import zlib
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.reading.fits_extensions import Hdu
from mountnav.reading.unpacking import FREE_BYTES

if TYPE_CHECKING:
    from astropy.io.fits import BinTableHDU

MOST_GZIP = 1032
"""No gzip packs better than this [zlib's technical details]: smaller tiles need no look."""
_WIDEST_BYTES = 8
"""Of a pixel: an image of floats keeps them whole where rounding would lose them."""
_HCOMPRESS = b"\xdd\x99"
_AT_ONCE = 1 << 20
"""Unpacked at a time, bytes, and counted only."""

Descriptors = NDArray[np.int64]


def require_bounded(table: BinTableHDU, data: bytes | bytearray, hdu: Hdu, label: str) -> None:
    """Refuse tiles that would unpack to more than the image has.

    Parameters
    ----------
    table : BinTableHDU
        The table of tiles, taken for a table.
    data : bytes or bytearray
        Its rows and heap.
    hdu : Hdu
        What its header says of the image.
    label : str

    Raises
    ------
    BadFrame
    """
    cards = hdu.cards
    tile = [cards.integer(f"ZTILE{axis}", 1 if axis > 1 else hdu.shape[-1]) for axis in _axes(hdu)]
    pixels = min(math.prod(max(1, one) for one in tile), math.prod(hdu.shape))
    kind = str(cards.values.get("ZCMPTYPE", "")).strip()
    gzipped = ["GZIP_COMPRESSED_DATA", *(["COMPRESSED_DATA"] if kind.startswith("GZIP") else [])]
    heap = memoryview(data)[cards.integer("THEAP", cards.integer("NAXIS1") * cards.integer("NAXIS2")) :]
    for name in gzipped:
        for size, start in _descriptors(table, data, name):
            if size * MOST_GZIP > FREE_BYTES and _longer(heap[start : start + size], pixels * _WIDEST_BYTES):
                raise _too_much(label)
    if kind == "HCOMPRESS_1":
        for _, start in _descriptors(table, data, "COMPRESSED_DATA"):
            head = bytes(heap[start : start + 10])
            if head[:2] == _HCOMPRESS and _sides(head) > pixels:
                raise _too_much(label)


def _axes(hdu: Hdu) -> range:
    return range(1, len(hdu.shape) + 1)


def _descriptors(table: BinTableHDU, data: bytes | bytearray, name: str) -> Descriptors:
    """Size and place in the heap of each row's entry of a column of variable length, shape (rows, 2)."""
    kinds = table.columns.dtype
    rows = int(table.header["NAXIS2"])
    if name not in kinds.names or kinds[name].shape != (2,) or rows * kinds.itemsize > len(data):
        return np.zeros((0, 2), dtype=np.int64)
    found = np.frombuffer(data, dtype=kinds.newbyteorder(">"), count=rows)[name].astype(np.int64)
    return np.maximum(found, 0)


def _longer(packed: memoryview, most: int) -> bool:
    """Whether gzip's members unpack to more than so much; what is damaged is for the unpacker to tell."""
    rest, length = bytes(packed), 0
    while rest:
        member = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
        while not member.eof:
            try:
                part = member.decompress(rest, _AT_ONCE)
            except zlib.error:
                return False
            length += len(part)
            if length > most:
                return True
            rest = member.unconsumed_tail
            if not part and not rest and not member.eof:
                return False
        rest = member.unused_data
    return False


def _sides(head: bytes) -> int:
    """How many pixels a stream of HCOMPRESS says that it has."""
    return int.from_bytes(head[2:6], "big") * int.from_bytes(head[6:10], "big")


def _too_much(label: str) -> BadFrame:
    return BadFrame(
        "a tile of this compressed FITS image unpacks to more than the whole image has",
        device=label,
        advice="no camera's software writes such files; send a single image",
    )


__all__ = ["MOST_GZIP", "require_bounded"]
