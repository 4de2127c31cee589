"""XISF files made by the standard's words, for tests: any kind of samples, packing and storage."""

from __future__ import annotations

import zlib
from xml.sax.saxutils import quoteattr

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

KINDS = {"u1": "UInt8", "u2": "UInt16", "u4": "UInt32", "f4": "Float32", "f8": "Float64"}
DATA_AT = 4096


def xisf(
    pixels: NDArray[np.generic],
    *,
    packing: str = "",
    keywords: dict[str, str] | None = None,
    normal: bool = False,
    parts: int = 1,
    inside: str = "",
    before: str = "",
    **attributes: str,
) -> bytes:
    """A file of one image, shape (height, width) or (channels, height, width)."""
    planes = pixels if pixels.ndim == 3 else pixels[None]
    channels, height, width = planes.shape
    stored = np.moveaxis(planes, 0, 2) if normal else planes
    plain = np.ascontiguousarray(stored).tobytes()
    image = {
        "geometry": f"{width}:{height}:{channels}",
        "sampleFormat": KINDS[pixels.dtype.newbyteorder("=").str[1:]],
        "pixelStorage": "Normal" if normal else "Planar",
    }
    if pixels.dtype.byteorder == ">":
        image["byteOrder"] = "big"
    data = plain
    if packing:
        codec, _, shuffled = packing.partition("+")
        item = pixels.dtype.itemsize
        if shuffled:
            plain = np.frombuffer(plain, np.uint8).reshape(-1, item).T.tobytes()
        step = -(-len(plain) // parts)
        pieces = [plain[at : at + step] for at in range(0, len(plain), step)]
        packed = [_packed(codec, piece) for piece in pieces]
        data = b"".join(packed)
        image["compression"] = f"{packing}:{len(plain)}" + (f":{item}" if shuffled else "")
        if parts > 1:
            sizes = (f"{len(short)},{len(long)}" for short, long in zip(packed, pieces, strict=True))
            image["subblocks"] = ":".join(sizes)
    image["location"] = f"attachment:{DATA_AT}:{len(data)}"
    image |= attributes
    words = " ".join(f"{key}={quoteattr(value)}" for key, value in image.items())
    cards = "".join(
        f"<FITSKeyword name={quoteattr(key)} value={quoteattr(value)} comment=''/>"
        for key, value in (keywords or {}).items()
    )
    xml = (
        f'<?xml version="1.0" encoding="UTF-8"?>{before}<xisf version="1.0" '
        f'xmlns="http://www.pixinsight.com/xisf"><Image {words}>{cards}{inside}</Image></xisf>'
    ).encode()
    head = b"XISF0100" + len(xml).to_bytes(4, "little") + bytes(4) + xml
    assert len(head) <= DATA_AT
    return head.ljust(DATA_AT, b"\0") + data


def _packed(codec: str, plain: bytes) -> bytes:
    if codec == "zlib":
        return zlib.compress(plain)
    return bytes(pa.Codec("zstd" if codec == "zstd" else "lz4_raw").compress(plain, asbytes=True))
