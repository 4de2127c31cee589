"""A FITS file's image becomes pixels and cards: what the stored numbers mean, and tiles are bounded.

Headers and plain images are read without astropy (`mountnav.reading.fits_headers`), so that reading is safe
in threads, and a large frame is never held in double precision. Tile-compressed images are unpacked by
astropy, from a header cut down to what describes the tiles. Meaning of BZERO, BSCALE and BLANK:
[FITS 4.0 §4.4.2.5, §5.2.5].

The tiles of a compressed FITS image are looked at before they are unpacked: none may outgrow the image.

The header may be honest and a tile still unpack to a thousand times its size, for gzip's streams say nothing
of their length; those of HCOMPRESS say it, and their unpacker believes them. Rice and PLIO stop at the tile's
end. [FITS 4.0 §10.1, §10.4; HCOMPRESS: White 1992]
"""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.reading.content import Content, stored
from mountnav.reading.fits_headers import (
    BLOCK_LENGTH,
    CARD_LENGTH,
    Hdu,
    Value,
    check_size,
    chosen_hdu,
    science_images,
    walk,
)
from mountnav.reading.unpacking import FREE_BYTES, check_ratio

if TYPE_CHECKING:
    from astropy.io.fits import BinTableHDU

__all__ = ["MOST_GZIP", "require_bounded"]


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
    """Size and offset in the heap of each row's entry of a column of variable length, shape (rows, 2)."""
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


Pixels = NDArray[np.generic]

_TYPES = {8: "u1", 16: ">i2", 32: ">i4", 64: ">i8", -32: ">f4", -64: ">f8"}
"""numpy's types of these kinds, as they are stored: big-endian, bytes unsigned [FITS 4.0, section 5]."""
_OWN_OF_PIXELS = re.compile(r"(SIMPLE|XTENSION|BITPIX|NAXIS\d*|EXTEND|PCOUNT|GCOUNT|BZERO|BSCALE|BLANK)$")
_OWN_OF_TILES = re.compile(
    r"(XTENSION|BITPIX|NAXIS\d*|PCOUNT|GCOUNT|TFIELDS|T(TYPE|FORM|UNIT|NULL|ZERO|SCAL|DIM|DISP)\d+|THEAP|"
    r"Z(IMAGE|CMPTYPE|BITPIX|NAXIS\d*|(TILE|NAME|VAL)\d+|MASKCMP|QUANTIZ|DITHER0|BLANK|SCALE|ZERO|"
    r"SIMPLE|EXTEND|TENSION|PCOUNT|GCOUNT|HECKSUM|DATASUM|BLOCKED))$"
)
_EMPTY_PRIMARY = (
    "SIMPLE  =                    T",
    "BITPIX  =                    8",
    "NAXIS   =                    0",
    "EXTEND  =                    T",
)
_OTHER_SHARE = 0.5
"""Of the pixels of the image that is taken: a smaller one is a preview or a guider's, no other detector.
Chosen by hand; doubled, a mosaic's narrower detectors are passed over in silence."""
_OTHERS_NAMED = 4
"""Extensions that a note names; a mosaic may have a hundred."""
_MOST_COLORS = 4
"""An axis of at most so many is colors, not rows: RGB, or RGB with a fourth plane."""
#: Stored numbers that are turned into physical values in one go.
_BYTES_AT_ONCE = 1 << 19


@dataclass(frozen=True, slots=True)
class FitsImage:
    """What a FITS file holds.

    Attributes
    ----------
    pixels : ndarray, shape (height, width)
        Physical values in the machine's byte order; NaN where BLANK says so.
    values : dict
        The primary header's cards, and over them those of the extension.
    comments : dict
        Their comments.
    note : str
        Of other images in the file, where nobody chose this one; else empty.
    """

    pixels: Pixels
    values: dict[str, Value]
    comments: dict[str, str]
    note: str = ""


def read_fits(content: Content, label: str, wanted: int | str | None = None) -> FitsImage:
    """Read the image of a FITS file.

    Parameters
    ----------
    content : bytes, bytearray or OnDisk
        The file, not wrapped in gzip or bzip2.
    label : str
        What to call it in messages.
    wanted : int or str, optional
        Number (0 is the primary) or EXTNAME of the extension. Without it the largest image is taken, science
        planes before masks and weights, the first among equals.

    Returns
    -------
    FitsImage
        Color becomes the mean of the first three planes; of a cube of more than four the first one is taken.

    Raises
    ------
    BadFrame
        Damaged, cut short, without an image, of an absurd size, or without the wanted extension.
    """
    hdus = walk(content, label)
    chosen = chosen_hdu(hdus, wanted, label)
    check_size(chosen, label)
    end = chosen.data_start + chosen.data_length
    if end > len(content):
        raise _cut_short(f"{len(content)} of {end} bytes are there", label)
    try:
        pixels = _pixels(content, chosen, label)
    except EOFError as fault:
        raise _cut_short(f"it became shorter while it was read, {fault}", label) from fault
    values, comments = _exposure_cards(hdus[0], chosen)
    return FitsImage(pixels, values, comments, "" if wanted is not None else _others(hdus, chosen))


def _others(hdus: list[Hdu], chosen: Hdu) -> str:
    """What is said of a file's other detectors: its images that are no masks and not much smaller."""
    least = _OTHER_SHARE * math.prod(chosen.shape)
    others = [unit for unit in science_images(hdus) if unit is not chosen and math.prod(unit.shape) >= least]
    if not others:
        return ""
    names = ", ".join(f"{unit.number} {unit.name}".strip() for unit in others[:_OTHERS_NAMED])
    more = ", ..." if len(others) > _OTHERS_NAMED else ""
    return (
        f"extension {chosen.number} was taken; other images in the file: {len(others)} ({names}{more}); "
        "--extension all solves each"
    )


def _cut_short(how: str, label: str) -> BadFrame:
    return BadFrame(
        f"the FITS file is cut short: {how}",
        device=label,
        advice="copy it again, or wait until the camera has written it completely",
    )


def _pixels(content: Content, hdu: Hdu, label: str) -> Pixels:
    """Read the chosen image as one plane of physical values."""
    if hdu.tiled:
        flat = unpacked_tiles(content, hdu, label).reshape(-1)
        return _one_plane(hdu, flat.dtype, lambda first, count: flat[first : first + count])
    kind = np.dtype(_TYPES[hdu.bitpix])
    return _one_plane(
        hdu,
        kind,
        lambda first, count: stored(content, kind, count, hdu.data_start + first * kind.itemsize),
    )


def unpacked_tiles(content: Content, hdu: Hdu, label: str) -> Pixels:
    """Unpack a tile-compressed image; whole numbers come as stored, floats as they were before.

    Raises
    ------
    BadFrame
        Damaged, or it would unpack to more than the image has.
    """
    check_ratio(math.prod(hdu.shape) * abs(hdu.bitpix) // 8, hdu.data_length, label)
    cards = [
        bytes(content[at : at + CARD_LENGTH])
        for at in range(hdu.start, hdu.data_start, CARD_LENGTH)
        if _OWN_OF_TILES.match(content[at : at + 8].decode("latin-1").strip())
    ]
    from io import BytesIO

    from astropy.io import fits  # a quarter of a second, and plain images do without

    table = content[hdu.data_start : hdu.data_start + hdu.data_length]
    primary = [card.ljust(CARD_LENGTH).encode() for card in _EMPTY_PRIMARY]
    alone = (
        _header(primary) + _header(cards) + table.ljust(-(-len(table) // BLOCK_LENGTH) * BLOCK_LENGTH, b"\0")
    )
    try:
        with fits.open(
            BytesIO(alone), memmap=False, mode="readonly", disable_image_compression=True
        ) as opened:
            require_bounded(opened[1], table, hdu, label)
        with fits.open(BytesIO(alone), memmap=False, mode="readonly") as opened:
            pixels = np.asarray(opened[1].data)
    except BadFrame:
        raise
    except Exception as fault:  # damaged tiles raise all kinds, some of them private to astropy
        raise BadFrame(
            f"this compressed FITS image can't be unpacked: {fault}",
            device=label,
            advice="it may be damaged or cut short; try it with `funpack`",
        ) from fault
    if pixels.shape != hdu.shape:
        raise BadFrame(
            "the compressed image unpacks to another size than its header tells",
            device=label,
            advice="the file is damaged; copy it again",
        )
    return pixels


def _header(cards: list[bytes]) -> bytes:
    text = b"".join(cards) + b"END".ljust(CARD_LENGTH)
    return text.ljust(-(-len(text) // BLOCK_LENGTH) * BLOCK_LENGTH)


def _one_plane(hdu: Hdu, kind: np.dtype[np.generic], read: Callable[[int, int], Pixels]) -> Pixels:
    """Make physical values of stored numbers, some rows at a time, while these are in cache.

    `read` gives stored numbers, by the first one and how many; a color image becomes the mean of its planes.
    """
    shape = _without_idle_axes(hdu.shape)
    height, width = shape[-2:] if len(shape) == 2 or shape[0] <= _MOST_COLORS else shape[:2]
    at_once = max(1, _BYTES_AT_ONCE // (width * kind.itemsize))
    whole = _as_stored(kind, hdu) if len(shape) == 2 else None
    if whole is not None:
        return _whole_numbers(height, width, at_once, whole, read)
    plane: Pixels | None = None
    for at in range(0, height, at_once):
        rows = min(at_once, height - at)
        colors = [_physical(color, hdu) for color in _colors(shape, at, rows, read)]
        brightness = colors[0] if len(shape) == 2 else _mean(colors)
        if plane is None:
            plane = np.empty((height, width), brightness.dtype)
        plane[at : at + rows] = brightness
    assert plane is not None  # an image has at least one row
    return plane


def _as_stored(kind: np.dtype[np.generic], hdu: Hdu) -> np.dtype[np.generic] | None:
    """Type of whole numbers that are physical values as stored, but for their sign; None for others."""
    if kind.kind not in "ui" or "BLANK" in hdu.cards.values:
        return None
    zero, scale = hdu.cards.real("BZERO", 0.0), hdu.cards.real("BSCALE", 1.0)
    if scale != 1.0:
        return None
    if zero == 0.0:
        return kind.newbyteorder("=")
    return np.dtype(f"{'iu'[kind.kind == 'i']}{kind.itemsize}") if _signs_differ(kind, zero) else None


def _whole_numbers(
    height: int, width: int, at_once: int, kind: np.dtype[np.generic], read: Callable[[int, int], Pixels]
) -> Pixels:
    """Whole numbers in the machine's byte order, written but once each, while they are in cache."""
    plane = np.empty((height, width), kind)
    for at in range(0, height, at_once):
        rows = plane[at : at + at_once]
        stored = read(at * width, rows.size).reshape(rows.shape)
        np.copyto(rows.view(f"{stored.dtype.kind}{stored.dtype.itemsize}"), stored)
        if stored.dtype.kind != kind.kind:
            bits = rows.view(f"u{kind.itemsize}")
            bits ^= np.array(1 << (8 * kind.itemsize - 1), dtype=bits.dtype)
    return plane


def _without_idle_axes(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Two axes, or three where one of them may be color; of a cube's leading axes the first plane is kept."""
    idle = [axis for axis, side in enumerate(shape) if side == 1][: max(0, len(shape) - 2)]
    kept = tuple(side for axis, side in enumerate(shape) if axis not in idle)
    while len(kept) > 3 or (len(kept) == 3 and kept[0] > _MOST_COLORS and kept[2] > _MOST_COLORS):
        kept = kept[1:]
    return kept


def _colors(
    shape: tuple[int, ...], at: int, rows: int, read: Callable[[int, int], Pixels]
) -> Iterator[Pixels]:
    """Some rows of the image, or of its first three color planes."""
    if len(shape) == 2:
        yield read(at * shape[1], rows * shape[1]).reshape(rows, shape[1])
    elif shape[0] <= _MOST_COLORS:
        planes, height, width = shape
        for plane in range(min(3, planes)):
            yield read((plane * height + at) * width, rows * width).reshape(rows, width)
    else:
        _, width, planes = shape
        together = read(at * width * planes, rows * width * planes).reshape(rows, width, planes)
        for plane in range(min(3, planes)):
            yield together[:, :, plane]


def _mean(colors: list[Pixels]) -> NDArray[np.float32]:
    mean = np.zeros(colors[0].shape, np.float32)
    for color in colors:
        np.add(mean, color, out=mean, casting="same_kind")
    mean /= len(colors)
    return mean


def _physical(stored: Pixels, hdu: Hdu) -> Pixels:
    """Turn stored numbers into physical values, in the machine's byte order."""
    zero, scale = hdu.cards.real("BZERO", 0.0), hdu.cards.real("BSCALE", 1.0)
    kind = stored.dtype
    if kind.kind == "f":
        if (scale, zero) == (1.0, 0.0) or hdu.tiled or not math.isfinite(scale * zero) or scale == 0.0:
            return stored.astype(kind.newbyteorder("="))
        floats: NDArray[np.floating] = stored.astype(kind.newbyteorder("="))
        floats *= scale
        floats += zero
        return floats
    blank = hdu.cards.values.get("BLANK")
    blank = None if isinstance(blank, (bool, str, float)) else blank
    if not math.isfinite(scale * zero) or scale == 0.0:
        scale, zero = 1.0, 0.0
    if blank is None and scale == 1.0:
        if zero == 0.0:
            return stored.astype(kind.newbyteorder("="))
        if _signs_differ(kind, zero):
            return _other_sign(stored)
    # single precision holds 24 bits, so it is reckoned in double
    scaled = stored.astype(np.float64) * scale + zero
    if blank is not None:
        scaled[stored == blank] = np.nan
    return scaled.astype(np.float32)


def _signs_differ(kind: np.dtype[np.generic], zero: float) -> bool:
    """Whether BZERO says that whole numbers are unsigned, which FITS stores as signed, or bytes signed."""
    return abs(zero) == 2.0 ** (8 * kind.itemsize - 1) and (zero < 0) == (kind.kind == "u")


def _other_sign(stored: Pixels) -> Pixels:
    """Flip the highest bit: unsigned numbers are stored as signed ones, and signed bytes as unsigned."""
    size = stored.dtype.itemsize
    bits = stored.astype(stored.dtype.newbyteorder("=")).view(f"u{size}")
    bits ^= np.array(1 << (8 * size - 1), dtype=f"u{size}")
    return bits if stored.dtype.kind == "i" else bits.view(f"i{size}")


def _exposure_cards(primary: Hdu, chosen: Hdu) -> tuple[dict[str, Value], dict[str, str]]:
    """Join the cards of the primary and the chosen header, without those that describe other pixels."""
    if chosen is primary:
        return dict(chosen.cards.values), dict(chosen.cards.comments)
    values = {key: value for key, value in primary.cards.values.items() if not _OWN_OF_PIXELS.match(key)}
    comments = {key: text for key, text in primary.cards.comments.items() if not _OWN_OF_PIXELS.match(key)}
    own = chosen.cards.values
    if chosen.tiled:
        own = {key: value for key, value in own.items() if not _OWN_OF_TILES.match(key)}
        own |= {"BITPIX": chosen.bitpix, "NAXIS": len(chosen.shape)}
        own |= {f"NAXIS{i + 1}": side for i, side in enumerate(chosen.shape[::-1])}
    comments = {key: text for key, text in comments.items() if key not in own}
    return values | own, comments | {k: v for k, v in chosen.cards.comments.items() if k in own}
