"""WCS cards put into FITS files: a new header before the same data, a picture as FITS, a header alone.

A file's data are copied as they are, bit for bit, and of its header each card that has nothing to do with
the WCS: other programs write cards that break the standard, and a library that reads and writes a whole
header mends them, or stops at them. So headers are taken apart card by card here; only new cards are made by
astropy.
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.files import open_plain, replace_bytes
from mountnav.reading.content import Content, OnDisk
from mountnav.reading.fits_headers import BLOCK_LENGTH, CARD_LENGTH, Hdu, chosen_hdu, walk
from mountnav.reading.unpacking import MOST_BYTES, check_ratio

Value = str | int | float | bool
Pixels = NDArray[np.generic]

_OLD_WCS = re.compile(
    r"(WCSAXES|WCSNAME|LONPOLE|LATPOLE|RADESYS|RADECSYS"
    r"|(CTYPE|CUNIT|CRVAL|CRPIX|CDELT|CROTA|CRDER|CSYER|CNAME|PROJP)\d+"
    r"|(CD|PC|PV|PS)\d+_\d+|(CD|PC)\d{6}"
    r"|[AB]P?_(\d+_\d+|ORDER|DMAX)"
    r"|PLTSOLVD)$"
)
"""Cards of a plate [FITS 4.0, section 8; SIP], and the mark that programs set beside one. Those of a second,
lettered WCS stay: that is whole in itself."""
_OF_NO_IMAGE = ("IMAGEW", "IMAGEH")
"""Cards that say a frame's size where there is no frame; in an image NAXIS1 and NAXIS2 do."""
_OF_DATA = re.compile(
    r"(SIMPLE|XTENSION|BITPIX|NAXIS\d*|EXTEND|PCOUNT|GCOUNT|GROUPS|BSCALE|BZERO|BLANK|INHERIT"
    r"|CHECKSUM|DATASUM|TFIELDS|THEAP|T(TYPE|FORM|UNIT|DIM|NULL|SCAL|ZERO|DISP|BCOL)\d+"
    r"|Z(IMAGE|TENSION|SIMPLE|EXTEND|BITPIX|NAXIS\d*|PCOUNT|GCOUNT|CMPTYPE|TILE\d+|NAME\d+|VAL\d+"
    r"|QUANTIZ|DITHER0|BLANK|SCALE|ZERO|MASKCMP|HECKSUM|DATASUM|BLOCKED))$"
)
"""Cards that say how data are stored; a header alone has its own of these."""
_NAME_LENGTH = 8
"""Letters of a keyword [FITS 4.0, section 4.1.2.1]; longer ones are written by the HIERARCH convention."""
_HISTORY_LENGTH = CARD_LENGTH - _NAME_LENGTH
_COMMENTS = {
    "WCSAXES": "coordinate axes",
    "CTYPE1": "right ascension, gnomonic",
    "CTYPE2": "declination, gnomonic",
    "CUNIT1": "unit of CRVAL1 and CD1_j",
    "CUNIT2": "unit of CRVAL2 and CD2_j",
    "CRPIX1": "reference pixel, the first is 1",
    "CRPIX2": "reference pixel, the first is 1",
    "CRVAL1": "[deg] right ascension there",
    "CRVAL2": "[deg] declination there",
    "IMAGEW": "[pix] width of the frame",
    "IMAGEH": "[pix] height of the frame",
}
_SUM_ZERO = "0000000000000000"
"""What CHECKSUM holds while the sum over it is taken [FITS 4.0, appendix J]."""
_SUM_COLUMN = 11
"""Where a card's sixteen characters of CHECKSUM begin, after name, equals sign, blank and quote."""
_WORDS_AT_ONCE = 1 << 20
"""32-bit words that are summed at a time: 2²⁰ of them fit into 64 bits 4000 times over; for memory alone."""
_STORED = {
    "u1": (8, 0),
    "i2": (16, 0),
    "i4": (32, 0),
    "i8": (64, 0),
    "f4": (-32, 0),
    "f8": (-64, 0),
    "u2": (16, 1 << 15),
    "u4": (32, 1 << 31),
    "i1": (8, -128),
}
"""BITPIX and BZERO of the kinds of numbers [FITS 4.0, section 5.3.1 and table 11]."""


def updated_fits(
    content: Content,
    cards: Mapping[str, Value],
    *,
    hdu: int | str | None = None,
    history: Sequence[str] = (),
    checksum: bool = False,
    name: str = "frame",
) -> bytes:
    """Put the WCS cards of a solution into a FITS file.

    The cards go into the header of the image that mountnav reads; those of an older plate there are taken
    out. A file packed by gzip or bzip2 as a whole is packed the same way again. In a tile-compressed file
    (``.fz``) the header of the table that holds the image is changed.

    Parameters
    ----------
    content : bytes, bytearray or OnDisk
        The whole file.
    cards : mapping
        Cards of `mountnav.solution.Solution.wcs`, and any other; a card that is there already is replaced.
        IMAGEW and IMAGEH are left out.
    hdu : int or str, optional
        Which extension, as for `mountnav.reading.read_frame`.
    history : sequence of str
        For HISTORY cards; long lines are parted. Characters that FITS doesn't know become ``?``.
    checksum : bool
        Write CHECKSUM and DATASUM; where the header has them already, they are brought up to date anyway.
    name : str
        What to call the file in messages.

    Returns
    -------
    bytes
        The file. Its data are the same bytes.

    Raises
    ------
    BadFrame
        No FITS file, damaged, or no such extension; or a value that no card can hold.
    """
    plain, packed_by = _whole(content, name)
    if plain[:6] != b"SIMPLE":
        raise BadFrame(
            "this is not a FITS file, so there is no header to write into",
            device=name,
            advice="write a .wcs file or a new FITS file instead",
        )
    unit = chosen_hdu(walk(plain, name), hdu, name)
    kept = [
        card for key, card in _raw_cards(plain, unit) if not (unit.tiled and key == "ZHECKSUM")
    ]  # ZHECKSUM counts the header of before; ZDATASUM stays right
    lines = _with_wcs(kept, {key: value for key, value in cards.items() if key not in _OF_NO_IMAGE}, name)
    lines = _appended(lines, _history(history))
    end = unit.data_start + -(-unit.data_length // BLOCK_LENGTH) * BLOCK_LENGTH
    data = memoryview(plain)[unit.data_start : end]
    keys = {_key(line) for line in lines}
    if checksum or "CHECKSUM" in keys or "DATASUM" in keys:
        header = _with_checksums(lines, data, anew=checksum or "CHECKSUM" in keys)
    else:
        header = _blocks(lines)
    updated = b"".join((plain[: unit.start], header, data, plain[end:]))
    return _packed(updated, packed_by)


def update_file(
    path: Path,
    cards: Mapping[str, Value],
    *,
    hdu: int | str | None = None,
    history: Sequence[str] = (),
    checksum: bool = False,
) -> bytes:
    """Put the WCS cards of a solution into a FITS file on disk, at once or not at all; its mode stays.

    Returns
    -------
    bytes
        What the file holds now.

    Raises
    ------
    BadFrame
        As `updated_fits`; the file is as it was.
    OSError
        It can't be read or written; the file is as it was.
    """
    with open_plain(path) as file:
        content = updated_fits(
            OnDisk(file), cards, hdu=hdu, history=history, checksum=checksum, name=path.name
        )
    replace_bytes(path, content)
    return content


def fits_of_frame(
    pixels: Pixels,
    cards: Mapping[str, Value],
    *,
    header: Mapping[str, Value] | None = None,
    history: Sequence[str] = (),
    checksum: bool = True,
) -> bytes:
    """Make a FITS file of a picture, with its WCS.

    Parameters
    ----------
    pixels : ndarray, shape (height, width), (planes, height, width) or (height, width, 3 or 4)
        Row 0 becomes FITS row 1, as `mountnav.reading.read_frame` counts; whole numbers up to 64 bits, or
        floats. A fourth plane of a color picture, how opaque it is, is left out.
    cards : mapping
        WCS cards.
    header : mapping, optional
        Other cards that are to be kept (DATE-OBS, EXPTIME, ...); what tells how data are stored is left out.
    checksum : bool
        Write CHECKSUM and DATASUM.

    Raises
    ------
    BadFrame
        Pixels of no such shape or type, or a value that no card can hold.
    """
    planes = np.asarray(pixels)
    if planes.ndim == 3 and planes.shape[2] in (3, 4) and planes.shape[0] > 4:
        planes = np.moveaxis(planes[..., :3], 2, 0)
    kind = planes.dtype.kind + str(planes.dtype.itemsize)
    if planes.ndim not in (2, 3) or not planes.size or kind not in _STORED:
        raise BadFrame(
            f"pixels of the shape {planes.shape} and the type {planes.dtype} make no FITS image",
            advice="give one image of whole numbers or floats",
        )
    bitpix, zero = _STORED[kind]
    if zero:
        wide = np.int64 if planes.dtype.itemsize == 4 else np.int32
        planes = planes.astype(wide) - zero
    letter = "u" if bitpix == 8 else "f" if bitpix < 0 else "i"
    data = planes.astype(f">{letter}{abs(bitpix) // 8}").tobytes()
    data += bytes(-len(data) % BLOCK_LENGTH)
    sizes = {f"NAXIS{axis}": side for axis, side in enumerate(planes.shape[::-1], start=1)}
    first: dict[str, Value] = {"SIMPLE": True, "BITPIX": bitpix, "NAXIS": planes.ndim, **sizes}
    if zero:
        first |= {"BSCALE": 1, "BZERO": zero}
    lines = [_line(key, value, "frame") for key, value in first.items()]
    for key, value in (header or {}).items():
        if not _OF_DATA.match(key) and not _OLD_WCS.match(key) and key not in cards:
            lines.append(_line(key, value, "frame"))
    lines = _with_wcs(lines, {key: value for key, value in cards.items() if key not in _OF_NO_IMAGE}, "frame")
    lines = _appended(lines, _history(history))
    header_bytes = _with_checksums(lines, memoryview(data), anew=True) if checksum else _blocks(lines)
    return header_bytes + data


def wcs_header(
    cards: Mapping[str, Value],
    *,
    frame: Content | None = None,
    hdu: int | str | None = None,
    history: Sequence[str] = (),
    name: str = "frame",
) -> bytes:
    """Make a ``.wcs`` file: a FITS header without data.

    Parameters
    ----------
    cards : mapping
        WCS cards; IMAGEW and IMAGEH say the frame's size.
    frame : bytes, bytearray or OnDisk, optional
        A FITS file whose other cards are kept, as programs expect it that look for the date there; of any
        other file nothing is.
    hdu : int or str, optional
        Of that file.
    name : str
        What to call that file in messages.

    Returns
    -------
    bytes
        Whole blocks of 2880.

    Raises
    ------
    BadFrame
        The FITS file has no such header, or a value that no card can hold.
    """
    first: dict[str, Value] = {"SIMPLE": True, "BITPIX": 8, "NAXIS": 0}
    lines = [_line(key, value, name) for key, value in first.items()]
    if frame is not None:
        packed = frame[:3][:2] == b"\x1f\x8b" or frame[:3] == b"BZh"
        plain = _whole(frame, name)[0] if packed else frame
        if plain[:6] == b"SIMPLE":
            unit = chosen_hdu(walk(plain, name), hdu, name)
            lines += [card for key, card in _raw_cards(plain, unit) if not _OF_DATA.match(key)]
    return _blocks(_appended(_with_wcs(lines, cards, name), _history(history)))


def _whole(content: Content, name: str) -> tuple[bytes, str]:
    """The file without its wrapping, to its last byte, and the wrapping's kind: "gzip", "bzip2" or none."""
    packed = bytes(content[:])
    kind = "gzip" if packed[:2] == b"\x1f\x8b" else "bzip2" if packed[:3] == b"BZh" else ""
    if not kind:
        return packed, kind
    import bz2
    import io
    import zlib

    try:
        opened = (
            gzip.GzipFile(fileobj=io.BytesIO(packed)) if kind == "gzip" else bz2.BZ2File(io.BytesIO(packed))
        )
        plain = bytearray()
        with opened as inside:
            while part := inside.read(_WORDS_AT_ONCE):
                plain += part
                check_ratio(len(plain), len(packed), name)
                if len(plain) > MOST_BYTES:
                    break
    except (OSError, EOFError, ValueError, zlib.error) as fault:
        raise BadFrame(
            f"the compressed file is damaged or cut short: {fault}",
            device=name,
            advice="copy it again, or wait until it is written completely",
        ) from fault
    return bytes(plain), kind


def _packed(plain: bytes, kind: str) -> bytes:
    if kind == "gzip":
        return gzip.compress(plain, mtime=0)
    if kind == "bzip2":
        import bz2

        return bz2.compress(plain)
    return plain


def _raw_cards(content: Content, unit: Hdu) -> Iterator[tuple[str, bytes]]:
    """A header's cards up to END, with their keywords; those that go on with one are part of it."""
    header = bytes(content[unit.start : unit.data_start])
    key, whole = "", b""
    for at in range(0, len(header), CARD_LENGTH):
        card = header[at : at + CARD_LENGTH]
        own = _key(card)
        if own == "CONTINUE" and whole:
            whole += card
            continue
        if whole:
            yield key, whole
        if own == "END" and not card[3:].strip(b" \0"):
            return
        key, whole = own, card
    if whole:
        yield key, whole


def _key(card: bytes) -> str:
    return card[:8].decode("latin-1").strip()


def _with_wcs(lines: Sequence[bytes], cards: Mapping[str, Value], name: str) -> list[bytes]:
    """Cards without their plate, and with the new ones where the old began, else at the end."""
    kept: list[bytes] = []
    place: int | None = None
    for line in lines:
        key = _key(line)
        if key in cards or _OLD_WCS.match(key):
            place = len(kept) if place is None else place
        else:
            kept.append(line)
    fresh = [_line(key, value, name) for key, value in cards.items()]
    if place is None:
        return _appended(kept, fresh)
    return [*kept[:place], *fresh, *kept[place:]]


def _appended(lines: Sequence[bytes], more: Sequence[bytes]) -> list[bytes]:
    """Cards with more of them at the end, but before the blank ones that some programs leave as room."""
    end = len(lines)
    while end and not lines[end - 1].strip(b" \0"):
        end -= 1
    return [*lines[:end], *more, *lines[end:]]


def _line(key: str, value: Value, name: str) -> bytes:
    """One card, or several for a long string. Raises `BadFrame`."""
    from astropy.io.fits import Card
    from astropy.io.fits.verify import VerifyError

    long_name = f"HIERARCH {key}" if len(key) > _NAME_LENGTH else key  # else astropy warns, for all threads
    try:
        card = Card(long_name, value, _COMMENTS.get(key, ""))
        card.verify("exception")
        return str(card).encode("ascii")
    except (ValueError, VerifyError) as fault:
        raise BadFrame(
            f"no FITS card can hold {key} = {value!r}: {fault}", device=name, advice="leave this card out"
        ) from fault


def _history(lines: Sequence[str]) -> list[bytes]:
    cards = []
    for line in lines:
        text = re.sub(r"[^\x20-\x7e]", "?", line)
        for at in range(0, max(1, len(text)), _HISTORY_LENGTH):
            cards.append(b"HISTORY " + text[at : at + _HISTORY_LENGTH].encode("ascii").ljust(_HISTORY_LENGTH))
    return cards


def _blocks(lines: Sequence[bytes]) -> bytes:
    """A header of cards, with END and its padding."""
    header = b"".join(lines) + b"END".ljust(CARD_LENGTH)
    return header + b" " * (-len(header) % BLOCK_LENGTH)


def _with_checksums(lines: Sequence[bytes], data: memoryview, *, anew: bool) -> bytes:
    """A header whose sums are those of itself and its data [FITS 4.0, section 4.4.2.7].

    Parameters
    ----------
    anew : bool
        Write CHECKSUM also if only DATASUM was there.
    """
    data_sum = _ones_sum(data, 0)
    fresh = {"DATASUM": _sum_line("DATASUM", str(data_sum))}
    if anew:
        fresh["CHECKSUM"] = _sum_line("CHECKSUM", _SUM_ZERO)
    replaced = [fresh.pop(_key(line), line) if _key(line) in fresh else line for line in lines]
    header = _blocks(_appended(replaced, list(fresh.values())[::-1]))
    if not anew:
        return header
    at = header.index(_sum_line("CHECKSUM", _SUM_ZERO)) + _SUM_COLUMN
    total = _ones_sum(memoryview(header), data_sum)
    return header[:at] + _encoded(total ^ 0xFFFFFFFF) + header[at + len(_SUM_ZERO) :]


def _sum_line(key: str, text: str) -> bytes:
    what = "sum of the whole HDU" if key == "CHECKSUM" else "sum of the data"
    return f"{key:<8}= '{text:<16}'   / {what}".ljust(CARD_LENGTH).encode("ascii")


def _ones_sum(data: memoryview, start: int) -> int:
    """The sum of 32-bit words with end-around carry."""
    total = start
    for at in range(0, len(data), 4 * _WORDS_AT_ONCE):
        part = bytes(data[at : at + 4 * _WORDS_AT_ONCE])
        part += bytes(-len(part) % 4)
        total += int(np.frombuffer(part, ">u4").sum(dtype=np.uint64))
    while total >> 32:
        total = (total & 0xFFFFFFFF) + (total >> 32)
    return total


def _encoded(value: int) -> bytes:
    """Sixteen letters and digits that add up to a word [FITS 4.0, appendix J]."""
    places = bytearray(16)
    for byte in range(4):
        number = (value >> (24 - 8 * byte)) & 0xFF
        parts = [number // 4 + 48] * 4
        parts[0] += number % 4
        while any(not chr(part).isalnum() for part in parts):
            for one, other in ((0, 1), (2, 3)):
                if not (chr(parts[one]).isalnum() and chr(parts[other]).isalnum()):
                    parts[one] += 1
                    parts[other] -= 1
        for row, part in enumerate(parts):
            places[4 * row + byte] = part
    return bytes(places[-1:] + places[:-1])
