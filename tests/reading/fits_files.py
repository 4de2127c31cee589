"""Files written for the tests of reading: by astropy and pillow, and by hand what neither writes."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Literal

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray
from PIL import Image


def fits_bytes(*hdus: fits.PrimaryHDU) -> bytes:
    out = io.BytesIO()
    fits.HDUList(list(hdus)).writeto(out, output_verify="ignore")
    return out.getvalue()


def picture_bytes(picture: Image.Image, kind: str, **options: object) -> bytes:
    out = io.BytesIO()
    picture.save(out, kind, **options)
    return out.getvalue()


def deep_png(pixels: NDArray[np.uint16]) -> bytes:
    """A 16-bit PNG with 1 to 4 channels, its rows filtered in turn as none, sub and up [RFC 2083 §6]."""
    height, width = pixels.shape[:2]
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    rows = np.frombuffer(pixels.astype(">u2").tobytes(), np.uint8).reshape(height, -1)
    above, left = np.zeros_like(rows), np.zeros_like(rows)
    above[1:] = rows[:-1]
    left[:, 2 * channels :] = rows[:, : -2 * channels]
    filters = [rows, rows - left, rows - above]
    body = b"".join(bytes([i % 3]) + filters[i % 3][i].tobytes() for i in range(height))
    head = struct.pack(">IIBBBBB", width, height, 16, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(body)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )


def tiff(pixels: NDArray[np.generic], order: Literal["<", ">"], *, deflate: bool = False) -> bytes:
    """A TIFF of one strip, order "<" or ">": gray or color, whole numbers or floats [TIFF 6.0]."""
    height, width = pixels.shape[:2]
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    bits = 8 * pixels.dtype.itemsize
    data = pixels.astype(pixels.dtype.newbyteorder(order)).tobytes()
    data = zlib.compress(data) if deflate else data
    kind = {"u": 1, "i": 2, "f": 3}[pixels.dtype.kind]
    entries = [
        (256, 4, width), (257, 4, height), (258, 3, bits), (259, 3, 8 if deflate else 1),
        (262, 3, 1 if channels < 3 else 2), (273, 4, 0), (277, 3, channels), (278, 4, height),
        (279, 4, len(data)), (284, 3, 1), (339, 3, kind),
    ]  # fmt: skip
    if channels in (2, 4):
        entries.insert(-1, (338, 3, 2))
    tables = 8 + 2 + 12 * len(entries) + 4
    fields = b""
    for tag, size, value in entries:
        per_channel = tag in (258, 339) and channels > 1
        if tag == 273:
            value = tables + 4 * channels
        elif per_channel and channels > 2:
            value = tables + (0 if tag == 258 else 2 * channels)
        count = channels if per_channel else 1
        if per_channel and channels == 2:
            packed = struct.pack(f"{order}HH", value, value)
        elif size == 3 and not per_channel:
            packed = struct.pack(f"{order}HH", value, 0)
        else:
            packed = struct.pack(f"{order}I", value)
        fields += struct.pack(f"{order}HHI", tag, size, count) + packed
    start = {"<": b"II", ">": b"MM"}[order] + struct.pack(f"{order}HI", 42, 8)
    after = struct.pack(f"{order}{channels}H", *[bits] * channels)
    after += struct.pack(f"{order}{channels}H", *[kind] * channels)
    return (
        start + struct.pack(f"{order}H", len(entries)) + fields + struct.pack(f"{order}I", 0) + after + data
    )
