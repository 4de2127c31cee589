"""The gzip or bzip2 wrapping of a file is taken off here, a piece at a time."""

from __future__ import annotations

from typing import Protocol

from mountnav.errors import BadFrame
from mountnav.reading.content import Content

#: What a file may unpack to; guards against decompression bombs.
MOST_BYTES = 2_500_000_000
_PIECE_BYTES = 1 << 20
_MOST_AT_ONCE = 1 << 24


class _Member(Protocol):
    """One of the streams that a file may consist of, as zlib and bz2 unpack it."""

    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...
    def decompress(self, data: bytes, max_length: int, /) -> bytes: ...


def unpacked(content: Content, label: str) -> Content:
    """Take the wrapping off, if there is one.

    Parameters
    ----------
    content : bytes, bytearray or OnDisk
    label : str
        What to call it in messages.

    Returns
    -------
    bytes, bytearray or OnDisk
        The same object where nothing is wrapped, else what was inside.

    Raises
    ------
    BadFrame
        Damaged, cut short, empty inside, or of an absurd size.
    """
    first = content[:3]
    if first[:2] != b"\x1f\x8b" and first != b"BZh":
        return content
    import zlib

    try:
        plain = _joined(content, gzipped=first[:1] == b"\x1f", label=label)
    except (OSError, EOFError, ValueError, zlib.error) as fault:
        raise BadFrame(
            f"the compressed file is damaged or cut short: {fault}",
            device=label,
            advice="copy it again, or wait until it is written completely",
        ) from fault
    if not plain:
        raise BadFrame("the compressed file is empty", device=label, advice="copy it again")
    return plain


def _joined(content: Content, *, gzipped: bool, label: str) -> bytearray:
    """Unpack all members; zeros between and after them are padding [RFC 1952 §2.2, gzip's manual]."""
    plain = bytearray()
    member: _Member | None = None
    for at in range(0, len(content), _PIECE_BYTES):
        packed = bytes(content[at : at + _PIECE_BYTES])
        while True:
            if member is None:
                packed = packed.lstrip(b"\0") if plain else packed
                if not packed:
                    break
                member = _gzip_member() if gzipped else _bzip2_member()
            part = member.decompress(packed, _MOST_AT_ONCE)
            plain += part
            if len(plain) > MOST_BYTES:
                raise BadFrame(
                    "the file unpacks to an absurd size", device=label, advice="send a single image"
                )
            if member.eof:
                packed, member = member.unused_data, None
            elif len(part) < _MOST_AT_ONCE:
                break
            else:
                packed = getattr(member, "unconsumed_tail", b"")  # bz2 keeps its own
    if member is not None:
        raise EOFError("it ended before the end-of-stream marker was reached")
    return plain


def _gzip_member() -> _Member:
    import zlib

    return zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)


def _bzip2_member() -> _Member:
    import bz2

    return bz2.BZ2Decompressor()
