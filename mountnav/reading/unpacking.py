"""The gzip or bzip2 wrapping of a file is taken off here, a piece at a time, no further than may be needed.

2 kB of bzip2 unpack to 2.5 GB. How much is unpacked is bounded before it is done: by what the FITS headers
need that have come out so far, and by what a picture of the sky can have been packed to.
"""

from __future__ import annotations

from typing import Protocol

from mountnav.errors import BadFrame
from mountnav.reading.content import Content
from mountnav.reading.fits_headers import MOST_PIXELS, read_cards, walk

MOST_BYTES = 8 * MOST_PIXELS + 100_000_000
"""What a file may unpack to, however large it is packed: as many pixels as are read, in the widest type."""

FREE_BYTES = 64_000_000
"""What may come of any file, however small: a drawn frame without noise packs very well. Doubled, each file
that was made for it costs twice as much memory."""

MOST_RATIO = 100
"""A frame with noise packs 1.5 to 10 times smaller, a drawn one without up to 50 times. Doubled, a small file
may cost twice as much memory; halved, drawn frames of more than 32 megapixels may be refused."""

_SLACK_BYTES = 1 << 20
"""Unpacked beyond what the headers need, for the next header. Doubled, twice as much goes to waste;
halved, those of a file of many extensions are gone through twice as often."""

_MOST_HEADER_BYTES = 1 << 22
"""A header without an end is given up after so much; long ones, of 10,000 cards, have 0.8 MB."""

_PIECE_BYTES = 1 << 20
"""Packed bytes that are unpacked at a time; for speed alone."""
_MOST_AT_ONCE = 1 << 24
"""Unpacked bytes that one such step may give, so that memory grows by no more before the limits are looked
at."""


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
        The file, in memory or where it lies on disk.
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


def most_unpacked(packed_bytes: int) -> int:
    """What a file of this size may unpack to, bytes."""
    return min(MOST_BYTES, FREE_BYTES + MOST_RATIO * packed_bytes)


def check_ratio(unpacked_bytes: int, packed_bytes: int, label: str) -> None:
    """Refuse to unpack more than a picture of the sky can hold.

    Parameters
    ----------
    unpacked_bytes, packed_bytes : int
        What it is said to become, and what there is.

    Raises
    ------
    BadFrame
    """
    if unpacked_bytes > most_unpacked(packed_bytes):
        raise BadFrame(
            f"{packed_bytes} bytes unpack to an absurd size, {unpacked_bytes / 1e6:.0f} MB or more",
            device=label,
            advice="no picture of the sky packs so well; send a single image",
        )


def _joined(content: Content, *, gzipped: bool, label: str) -> bytearray:
    """Unpack all members; zeros between and after them are padding [RFC 1952 §2.2, gzip's manual]."""
    plain = bytearray()
    member: _Member | None = None
    needed = min(_SLACK_BYTES, most_unpacked(len(content)))
    for at in range(0, len(content), _PIECE_BYTES):
        packed = bytes(content[at : at + _PIECE_BYTES])
        while True:
            if member is None:
                packed = packed.lstrip(b"\0") if plain else packed
                if not packed:
                    break
                member = _gzip_member() if gzipped else _bzip2_member()
            at_once = min(_MOST_AT_ONCE, max(1, needed - len(plain) + 1))
            part = member.decompress(packed, at_once)
            plain += part
            if len(plain) > needed:
                check_ratio(len(plain), len(content), label)
                needed = _needed(plain, label)
                if len(plain) > needed:
                    return plain  # what follows the last image is for nobody
                needed = min(needed, most_unpacked(len(content)))
            if member.eof:
                packed, member = member.unused_data, None
            elif len(part) < at_once:
                break
            else:
                packed = getattr(member, "unconsumed_tail", b"")  # bz2 keeps its own
    if member is not None:
        raise EOFError("it ended before the end-of-stream marker was reached")
    return plain


def _needed(plain: bytearray, label: str) -> int:
    """How much of a file may be needed, as far as what is unpacked of it tells: more where that isn't all.

    Raises
    ------
    BadFrame
        Its headers ask for what is never read.
    """
    if plain[:6] != b"SIMPLE":
        return MOST_BYTES
    if len(plain) < _MOST_HEADER_BYTES and read_cards(plain, 0) is None:
        return _MOST_HEADER_BYTES
    last = walk(plain, label)[-1]
    end = last.data_start + last.data_length
    if end > MOST_BYTES:
        raise BadFrame(
            f"its header claims an absurd size, {end / 1e6:.0f} MB",
            device=label,
            advice="send a single image",
        )
    return end + _SLACK_BYTES


def _gzip_member() -> _Member:
    import zlib

    return zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)


def _bzip2_member() -> _Member:
    import bz2

    return bz2.BZ2Decompressor()
