"""A FITS file's image becomes pixels and cards here: what the stored numbers mean.

Headers and plain images are read without astropy (see `fits_cards`), so that reading is safe in threads, and
a large frame is never held in double precision. Tile-compressed images are unpacked by astropy, from a header
cut down to what describes the tiles. Meaning of BZERO, BSCALE and BLANK: [FITS 4.0 §4.4.2.5, §5.2.5].
"""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.reading.fits_cards import BLOCK_LENGTH, CARD_LENGTH, Value
from mountnav.reading.fits_extensions import Hdu, check_size, chosen_hdu, walk

Pixels = NDArray[np.generic]

_TYPES = {8: "u1", 16: ">i2", 32: ">i4", 64: ">i8", -32: ">f4", -64: ">f8"}
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
_ROWS_AT_ONCE = 256


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
    """

    pixels: Pixels
    values: dict[str, Value]
    comments: dict[str, str]


def read_fits(content: bytes, label: str, wanted: int | str | None = None) -> FitsImage:
    """Read the image of a FITS file.

    Parameters
    ----------
    content : bytes
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
        raise BadFrame(
            f"the FITS file is cut short: {len(content)} of {end} bytes are there",
            device=label,
            advice="copy it again, or wait until the camera has written it completely",
        )
    stored = _tiled(content, chosen, label) if chosen.tiled else _plain(content, chosen)
    values, comments = _exposure_cards(hdus[0], chosen)
    return FitsImage(_one_plane(stored, chosen), values, comments)


def _plain(content: bytes, hdu: Hdu) -> Pixels:
    """View the stored numbers; nothing is copied yet."""
    kind = np.dtype(_TYPES[hdu.bitpix])
    stored = np.frombuffer(content, kind, count=math.prod(hdu.shape), offset=hdu.data_start)
    return _planes(stored.reshape(hdu.shape))


def _tiled(content: bytes, hdu: Hdu, label: str) -> Pixels:
    """Unpack the tiles; whole numbers come as stored, floats as they were before."""
    cards = [
        content[at : at + CARD_LENGTH]
        for at in range(hdu.start, hdu.data_start, CARD_LENGTH)
        if _OWN_OF_TILES.match(content[at : at + 8].decode("latin-1").strip())
    ]
    table = content[hdu.data_start : hdu.data_start + hdu.data_length]
    primary = [card.ljust(CARD_LENGTH).encode() for card in _EMPTY_PRIMARY]
    alone = (
        _header(primary) + _header(cards) + table.ljust(-(-len(table) // BLOCK_LENGTH) * BLOCK_LENGTH, b"\0")
    )
    try:
        with fits.open(io.BytesIO(alone), memmap=False, mode="readonly") as opened:
            pixels = np.asarray(opened[1].data)
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
    return _planes(pixels)


def _header(cards: list[bytes]) -> bytes:
    text = b"".join(cards) + b"END".ljust(CARD_LENGTH)
    return text.ljust(-(-len(text) // BLOCK_LENGTH) * BLOCK_LENGTH)


def _planes(stored: Pixels) -> Pixels:
    """Take idle axes off, and of a cube's leading axes the first plane; color planes stay."""
    idle = tuple(axis for axis in range(stored.ndim) if stored.shape[axis] == 1)
    stored = stored.squeeze(axis=idle[: max(0, stored.ndim - 2)])
    while stored.ndim > 3 or (stored.ndim == 3 and stored.shape[0] > 4 and stored.shape[2] > 4):
        stored = stored[0]
    return stored


def _one_plane(stored: Pixels, hdu: Hdu) -> Pixels:
    """Bring color down to one plane, a plane at a time."""
    if stored.ndim < 3:
        return _physical(stored, hdu)
    planes = stored if stored.shape[0] <= 4 else np.moveaxis(stored, 2, 0)
    mean = np.zeros(planes.shape[1:], np.float32)
    for plane in planes[:3]:
        np.add(mean, _physical(plane, hdu), out=mean, casting="same_kind")
    mean /= min(3, planes.shape[0])
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
        if abs(zero) == 2.0 ** (8 * kind.itemsize - 1) and (zero < 0) == (kind.kind == "u"):
            return _other_sign(stored)
    # Single precision holds 24 bits; a block of rows at a time is reckoned in double.
    values = np.empty(stored.shape, np.float32)
    for at in range(0, stored.shape[0], _ROWS_AT_ONCE):
        rows = stored[at : at + _ROWS_AT_ONCE]
        scaled = rows.astype(np.float64) * scale + zero
        if blank is not None:
            scaled[rows == blank] = np.nan
        values[at : at + _ROWS_AT_ONCE] = scaled
    return values


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
