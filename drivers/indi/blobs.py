"""Unwraps BLOBs: base64, then what their format says was done to the file; no I/O.

".z" is zlib's own format [INDI white paper, appendix]; ".fz" is a tile-compressed FITS file, which is read as
such and stays as it is. Drivers send such a file in a buffer that is longer than it: `length` tells.
"""

from __future__ import annotations

import binascii
import zlib
from collections.abc import Iterable

from drivers.indi.codec import Blob
from mountnav.reading.unpacking import most_unpacked

_WHITE = b" \t\r\n"


class BrokenBlob(ValueError):
    """A BLOB that can't be unwrapped."""


def content(blob: Blob) -> bytes | bytearray:
    """Return the file in a BLOB.

    Raises
    ------
    BrokenBlob
        If it is empty, cut short, or not what it says.
    """
    packed: bytes | bytearray
    packed = decoded = _decoded(blob.encoded)
    if blob.length is not None:
        if blob.length > len(packed):
            raise BrokenBlob(f"{len(packed)} of {blob.length} bytes are there")
        del decoded[blob.length :]
    if blob.format.lower().endswith(".z"):
        packed = _inflated(packed, blob.size)
    elif not blob.format.lower().endswith(".fz") and blob.size > len(packed):
        raise BrokenBlob(f"{len(packed)} of {blob.size} bytes are there")
    if not packed:
        raise BrokenBlob("it is empty")
    return packed


def _decoded(pieces: Iterable[bytes]) -> bytearray:
    """Decode piece by piece: no step is long, so that other threads, a stop's among them, get their turn."""
    plain, carried = bytearray(), b""
    try:
        for piece in pieces:
            dense = carried + piece.translate(None, _WHITE)
            whole = len(dense) & ~3
            plain += binascii.a2b_base64(dense[:whole])
            carried = dense[whole:]
        if carried:
            plain += binascii.a2b_base64(carried)
    except binascii.Error as fault:
        raise BrokenBlob(f"that is no base64: {fault}") from fault
    return plain


def _inflated(packed: bytes | bytearray, size: int) -> bytes:
    if not 0 < size <= most_unpacked(len(packed)):
        raise BrokenBlob(
            f"{len(packed)} bytes unpack to {size}, it says: no picture of the sky packs so well"
        )
    machine = zlib.decompressobj()
    try:
        plain = machine.decompress(packed, size + 1)
    except zlib.error as fault:
        raise BrokenBlob(f"it can't be unpacked: {fault}") from fault
    if len(plain) != size or not machine.eof:
        raise BrokenBlob(f"it unpacks to {len(plain)} bytes or more, {size} were promised")
    return plain
