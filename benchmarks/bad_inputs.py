"""Send files that hold no sky through the solver's doors: none may be solved, none may break anything.

Run: python -m benchmarks.bad_inputs [--first 0] [--inputs 1000] [--doors astap,solve] [--real] [--told]
     [--into FILE]

Each seed draws one file: a FITS file, picture, XISF file, packed file or list of stars, broken or made to
lie, or a frame or list whose stars never stood so in any sky: at random, on grids, on lines, in combs, or
those of a true field moved about. Whatever is done to such a file, a solution of it is wrong.

In this process the doors are called as their commands call them (`astap`, `solve-field`, `mountnav solve`),
each seed at one of them; with `--real` each file is given to a command of its own process, or to the nova API
of a service that is started for it. What counts: solutions, exceptions and tracebacks, answers against the
contract of the door (no reason, a file that says "solved"), and the most memory that was resident.

With ``--into`` the outcome of each part is a line of that file, and what stands there is not done again: a
run of 10,000 may be ended and begun as often as one likes. A file of another state of the code is refused.
"""

from __future__ import annotations

import argparse
import bz2
import contextlib
import gzip
import hashlib
import io
import json
import lzma
import multiprocessing
import os
import re
import resource
import socket
import struct
import subprocess
import sys
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray
from PIL import Image

from mountnav.catalog.embedded import embedded_catalog
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import project
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Random = np.random.Generator

MOST_MB = 500.0
"""Resident memory that a process of the solver may take with any of these files, MB."""
WAITED_S = 120.0
"""How long a real door may take for one file, s: more counts as broken."""
FIELDS = (Icrs(83.8, -5.4), Icrs(56.75, 24.1), Icrs(201.3, 47.3), Icrs(37.9, 89.2), Icrs(310.0, 45.0))
"""True fields whose stars are moved about: Orion, the Pleiades, far from the plane, the pole, the plane."""
PIXEL_ARCSEC = 18.0
"""Scale of those fields: 640 px are 3.2°."""
DOORS = ("astap", "solve-field", "solve")
EACH_PROCESS = 200
"""Files that one process is given."""


@dataclass(frozen=True, slots=True)
class BadInput:
    """A file that has no right answer.

    Attributes
    ----------
    seed : int
    kind : str
    name : str
        Of the file.
    content : bytes
    """

    seed: int
    kind: str
    name: str
    content: bytes


# -- stars that are no sky -----------------------------------------------------------------------------------


@cache
def _true_stars(number: int) -> tuple[Array, Array, Array]:
    """Pixels and fluxes of a true field's 150 brightest stars."""
    optics = SimulatedOptics(640, 480, PIXEL_ARCSEC, rotation_deg=33.0)
    stars = embedded_catalog().cone(FIELDS[number], 2.2, epoch_yr=2026.0)
    x, y = project(FIELDS[number], optics, stars.ra_deg, stars.dec_deg)
    inside = np.flatnonzero((x > 2) & (x < 637) & (y > 2) & (y < 477))
    inside = inside[np.argsort(stars.mag[inside])][:150]
    return x[inside], y[inside], 10.0 ** (0.4 * (14.0 - stars.mag[inside]))


def _fluxes(rng: Random, count: int) -> Array:
    return np.asarray(10.0 ** rng.uniform(2.3, 4.8, count))


def _even(rng: Random) -> tuple[Array, Array, Array]:
    count = int(rng.integers(0, 250))
    return rng.uniform(0, 639, count), rng.uniform(0, 479, count), _fluxes(rng, count)


def _grid(rng: Random) -> tuple[Array, Array, Array]:
    step, jitter = rng.uniform(20, 90), rng.choice([0.0, 0.3, 5.0])
    x, y = (side.ravel() for side in np.meshgrid(np.arange(5, 635, step), np.arange(5, 475, step)))
    return x + rng.normal(0, jitter, x.size), y + rng.normal(0, jitter, x.size), _fluxes(rng, x.size)


def _line(rng: Random) -> tuple[Array, Array, Array]:
    along, count = rng.uniform(0, np.pi), int(rng.integers(5, 120))
    t = rng.uniform(-230, 230, count)
    return 320 + t * np.cos(along), 240 + t * np.sin(along), _fluxes(rng, count)


def _comb(rng: Random) -> tuple[Array, Array, Array]:
    """Few places, each repeated at the same offsets, as a shaken tube does."""
    x, y, flux = _even(rng)
    x, y, flux = x[:40], y[:40], flux[:40]
    dx, dy = rng.uniform(-40, 40, (2, 4))
    return (x[:, None] + dx).ravel(), (y[:, None] + dy).ravel(), np.repeat(flux, 4)


def _clusters(rng: Random) -> tuple[Array, Array, Array]:
    count = int(rng.integers(0, 500))
    at = rng.integers(0, 5, count)
    center_x, center_y, wide = rng.uniform(80, 560, 5), rng.uniform(80, 400, 5), rng.uniform(5, 60, 5)
    off_x, off_y = wide[at] * rng.standard_normal((2, count))
    return center_x[at] + off_x, center_y[at] + off_y, _fluxes(rng, count)


def _rows_swapped(rng: Random) -> tuple[Array, Array, Array]:
    """A true field whose y are dealt anew among its stars."""
    x, y, flux = _true_stars(int(rng.integers(len(FIELDS))))
    return x, rng.permutation(y), flux


def _tiles_turned(rng: Random) -> tuple[Array, Array, Array]:
    """A true field cut in squares, each mirrored, turned and put elsewhere."""
    x, y, flux = _true_stars(int(rng.integers(len(FIELDS))))
    side = float(rng.choice([40.0, 80.0]))
    column, row = np.floor(x / side).astype(int), np.floor(y / side).astype(int)
    columns, rows = int(640 / side), int(480 / side)
    to = rng.permutation(columns * rows)[row * columns + column]
    turn = rng.integers(0, 4, columns * rows)[row * columns + column]
    u, v = x - side * column - side / 2, y - side * row - side / 2
    z = (u + 1j * v) * 1j**turn
    z = np.where(turn % 2 == 0, z.conj(), z)
    return side * (to % columns) + side / 2 + z.real, side * (to // columns) + side / 2 + z.imag, flux


def _stretched(rng: Random) -> tuple[Array, Array, Array]:
    """A true field as no camera has it: one axis half as long again or twice as long."""
    x, y, flux = _true_stars(int(rng.integers(len(FIELDS))))
    return 320 + (x - 320) / rng.uniform(1.5, 2.0), y, flux


def _folded(rng: Random) -> tuple[Array, Array, Array]:
    """Strips of a true field, every other one mirrored, so narrow that none is a field."""
    x, y, flux = _true_stars(int(rng.integers(len(FIELDS))))
    wide = rng.uniform(25, 60)
    strip = np.floor(x / wide)
    return np.where(strip % 2 == 1, wide * (2 * strip + 1) - x, x), (y + 97 * strip) % 480, flux


def _inverted(rng: Random) -> tuple[Array, Array, Array]:
    """A true field turned inside out."""
    x, y, flux = _true_stars(int(rng.integers(len(FIELDS))))
    z = x - 320 + 1j * (y - 240)
    z = 220.0 * z / np.maximum(np.abs(z), 1e-9) - z
    return 320 + z.real, 240 + z.imag, flux


def _few(rng: Random) -> tuple[Array, Array, Array]:
    count = int(rng.integers(0, 9))
    return rng.uniform(0, 639, count), rng.uniform(0, 479, count), _fluxes(rng, count)


def _equal(rng: Random) -> tuple[Array, Array, Array]:
    x, y, flux = _even(rng)
    return x, y, np.full_like(flux, 5000.0)


FALSE_SKIES: dict[str, Callable[[Random], tuple[Array, Array, Array]]] = {
    "even": _even,
    "grid": _grid,
    "line": _line,
    "comb": _comb,
    "clusters": _clusters,
    "rows swapped": _rows_swapped,
    "tiles turned": _tiles_turned,
    "stretched": _stretched,
    "folded": _folded,
    "inverted": _inverted,
    "few": _few,
    "as bright": _equal,
}


def _drawn(
    rng: Random, x: Array, y: Array, flux: Array, width: int = 640, height: int = 480
) -> NDArray[np.uint16]:
    """A frame of such stars."""
    sigma, reach = float(rng.uniform(0.8, 1.8)), 6
    light = np.zeros((height + 2 * reach, width + 2 * reach), np.float32)
    side = np.arange(-reach, reach + 1)
    for one_x, one_y, one in zip(x, y, flux, strict=True):
        if not (0 <= one_x <= width - 1 and 0 <= one_y <= height - 1):
            continue
        left, low = round(float(one_x)), round(float(one_y))
        across = np.exp(-0.5 * ((side + left - one_x) / sigma) ** 2)
        up = np.exp(-0.5 * ((side + low - one_y) / sigma) ** 2)
        light[low : low + 13, left : left + 13] += one / (2 * np.pi * sigma**2) * np.outer(up, across)
    sky = float(rng.uniform(100, 3000))
    noisy = light[reach:-reach, reach:-reach] + sky
    noisy = noisy + np.sqrt(noisy) * rng.standard_normal(noisy.shape, dtype=np.float32)
    return np.asarray(np.clip(noisy, 0, 65535).astype(np.uint16), dtype=np.uint16)


def _pixels(rng: Random) -> NDArray[np.uint16]:
    """A frame without a sky, small, for files that are broken afterwards."""
    x, y, flux = _even(rng)
    keep = (x < 200) & (y < 150)
    return _drawn(rng, x[keep], y[keep], flux[keep], 200, 150)


# -- files ---------------------------------------------------------------------------------------------------


def _as_fits(pixels: NDArray[np.generic], **cards: object) -> bytes:
    file = io.BytesIO()
    header = fits.Header()
    for name, value in cards.items():
        header[name] = value
    fits.PrimaryHDU(pixels, header).writeto(file)
    return file.getvalue()


def _hints(rng: Random) -> dict[str, object]:
    """What a header may say of the place: of the true field, of another, nonsense, nothing."""
    way = int(rng.integers(4))
    if way == 0:
        return {}
    at = FIELDS[int(rng.integers(len(FIELDS)))]
    if way == 1:
        return {"RA": at.ra_deg, "DEC": at.dec_deg, "FOCALLEN": 103.13, "XPIXSZ": 9.0}
    if way == 2:
        return {"RA": at.ra_deg, "DEC": at.dec_deg}
    return {"RA": 1e9, "DEC": -4000.0, "FOCALLEN": -1.0, "XPIXSZ": 0.0, "EXPTIME": 1e300}


def _picture(rng: Random, pixels: NDArray[np.generic], kind: str) -> bytes:
    file = io.BytesIO()
    light = pixels.astype(np.float64)
    high = float(np.quantile(light, 0.999)) or 1.0
    gray = np.clip(light / high * 255, 0, 255).astype(np.uint8)
    Image.fromarray(gray).save(file, kind)
    return file.getvalue()


def _false_sky(rng: Random) -> tuple[str, bytes]:
    name = str(rng.choice(list(FALSE_SKIES)))
    pixels = _drawn(rng, *FALSE_SKIES[name](rng))
    form = int(rng.integers(4))
    if form == 0:
        return "sky.png", _picture(rng, pixels, "PNG")
    if form == 1:
        return "sky.jpg", _picture(rng, pixels, "JPEG")
    return "sky.fits", _as_fits(pixels, **_hints(rng))


def _noise(rng: Random) -> tuple[str, bytes]:
    shape = (int(rng.integers(1, 700)), int(rng.integers(1, 700)))
    way = int(rng.integers(5))
    if way == 0:
        pixels = rng.normal(1000, 30, shape)
    elif way == 1:
        pixels = rng.poisson(3.0, shape).astype(float)
    elif way == 2:
        pixels = np.where(rng.random(shape) < 0.002, 60000.0, 300.0)  # hot pixels and nothing else
    elif way == 3:
        pixels = np.cumsum(rng.standard_normal(shape), axis=1)  # clouds
    else:
        pixels = np.full(shape, float(rng.integers(65536)))
    return "noise.fits", _as_fits(pixels.astype(np.float32), **_hints(rng))


def _unreal(rng: Random) -> tuple[str, bytes]:
    """Not numbers, infinities, or numbers at the ends of what a float can hold."""
    pixels = _pixels(rng).astype(np.float32)
    bad = rng.choice(np.array([np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-44], np.float32))
    share = rng.choice([0.001, 0.3, 0.98, 1.0])
    pixels[rng.random(pixels.shape) < share] = bad
    return "unreal.fits", _as_fits(pixels, **_hints(rng))


def _truncated(rng: Random) -> tuple[str, bytes]:
    content = _as_fits(_pixels(rng), **_hints(rng))
    return "cut.fits", content[: int(rng.integers(0, len(content)))]


_LIES: dict[str, tuple[str, ...]] = {
    "BITPIX": ("8", "16", "32", "64", "-32", "-64", "0", "7", "-16", "1E3", "T", "'x'"),
    "NAXIS": ("0", "1", "3", "999", "-2", "1000000000000", "'two'", "T"),
    "NAXIS1": ("0", "-1", "1", "100000", "4294967296", "99999999999999999999", "'wide'", "1.5"),
    "NAXIS2": ("0", "-7", "1", "2000000", "2147483648", "9223372036854775807", "F", "1E30"),
    "BZERO": ("1E308", "-1E308", "'NaN'", "32768"),
    "BSCALE": ("0", "1E308", "-1", "1E-300"),
    "SIMPLE": ("F", "'T'", "1"),
    "PCOUNT": ("-1", "9999999999999", "2147483647"),
    "GCOUNT": ("0", "-1", "9999999999"),
    "EXTEND": ("7",),
}


def _lying(rng: Random) -> tuple[str, bytes]:
    """A header that says of the data what isn't so."""
    content = bytearray(_as_fits(_pixels(rng).astype(np.int16), BZERO=0.0, BSCALE=1.0, PCOUNT=0, GCOUNT=1))
    for key in rng.choice(list(_LIES), int(rng.integers(1, 3)), replace=False):
        at = content.find(f"{key:8}=".encode())
        if at >= 0:
            content[at : at + 80] = f"{key:8}= {rng.choice(_LIES[key]):>20}".ljust(80).encode()
    return "lie.fits", bytes(content)


def _flipped(rng: Random) -> tuple[str, bytes]:
    """Bytes of a good file changed here and there, mostly in its head."""
    name, content = _container(rng)
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 40))):
        most = len(data) if rng.random() < 0.3 else min(len(data), 3000)
        data[int(rng.integers(most))] = int(rng.integers(256))
    if rng.random() < 0.3:
        data = data[: int(rng.integers(len(data)))]
    return name, bytes(data)


def _container(rng: Random) -> tuple[str, bytes]:
    """A well-formed file of any kind, of a frame without a sky."""
    pixels = _pixels(rng)
    way = int(rng.integers(7))
    if way == 0:
        return "a.png", _picture(rng, pixels, "PNG")
    if way == 1:
        return "a.jpg", _picture(rng, pixels, "JPEG")
    if way == 2:
        return "a.tif", _picture(rng, pixels, "TIFF")
    if way == 3:
        return "a.xisf", _xisf(rng, pixels)
    if way == 4:
        return "a.bmp", _picture(rng, pixels, "BMP")
    if way == 5:
        file = io.BytesIO()
        kind = str(rng.choice(["RICE_1", "GZIP_1", "GZIP_2"]))
        packed = fits.CompImageHDU(pixels.astype(np.int16), compression_type=kind)
        fits.HDUList([fits.PrimaryHDU(), packed]).writeto(file)
        # each packed tile says when it was packed: a seed draws the same file at any time
        return "a.fits.fz", _GZIP_TIME.sub(rb"\1\0\0\0\0", file.getvalue())
    return "a.fits.gz", gzip.compress(_as_fits(pixels, **_hints(rng)), 1, mtime=0)


_GZIP_TIME = re.compile(rb"(\x1f\x8b\x08\x00)....", re.DOTALL)
"""Head of gzip without a file's name, and the time behind it."""


def _xisf(rng: Random, pixels: NDArray[np.uint16], lie: str = "") -> bytes:
    rows, columns = pixels.shape
    raw = pixels.tobytes()
    packed = zlib.compress(raw, 1)
    claimed = {"": len(raw), "size": len(raw) * 1000, "less": 10, "huge": 2**62}[lie]
    text = (
        '<?xml version="1.0" encoding="UTF-8"?><xisf version="1.0" xmlns="http://www.pixinsight.com/xisf">'
        f'<Image geometry="{columns}:{rows}:1" sampleFormat="UInt16" colorSpace="Gray" '
        f'compression="zlib:{claimed}" location="attachment:4096:{len(packed)}"/></xisf>'
    ).encode()
    return (b"XISF0100" + struct.pack("<II", len(text), 0) + text).ljust(4096, b"\0") + packed


def _xisf_lies(rng: Random) -> tuple[str, bytes]:
    content = _xisf(rng, _pixels(rng), str(rng.choice(["size", "less", "huge"])))
    swaps = [
        (b'geometry="200:150:1"', b'geometry="200000:150000:1"'),
        (b'geometry="200:150:1"', b'geometry="0:0:0"'),
        (b'geometry="200:150:1"', b'geometry="-1:4294967296:3"'),
        (b"attachment:4096", b"attachment:99999999999"),
        (b'"UInt16"', b'"Complex64"'),
        (b"<xisf ", b"<!DOCTYPE a [<!ENTITY b 'c'>]><xisf "),
        (b"</xisf>", b"<a>" * 60),
    ]
    old, new = swaps[int(rng.integers(len(swaps)))]
    return "lie.xisf", content.replace(old, new)


def _bomb(rng: Random) -> tuple[str, bytes]:
    """Little that says it is, or unpacks to, very much."""
    way = int(rng.integers(8))
    side = int(rng.choice([8000, 17000, 60000]))
    head = fits.Header([("SIMPLE", True), ("BITPIX", 16), ("NAXIS", 2), ("NAXIS1", side), ("NAXIS2", side)])
    start = head.tostring().encode()
    if way == 0:
        return "bomb.fits.gz", gzip.compress(start + bytes(30_000_000), 1, mtime=0)
    if way == 1:
        return "bomb.fits.bz2", bz2.compress(start + bytes(60_000_000), 1)
    if way == 2:
        return "bomb.fits.xz", lzma.compress(start + bytes(20_000_000), preset=0)
    if way == 3:
        return "bomb.gz", gzip.compress(gzip.compress(bytes(40_000_000), 1, mtime=0), 1, mtime=0)
    if way == 4:
        return "bomb.png", _png(side, side, bytes(20_000_000))
    if way == 5:
        return "bomb.png", _png(2**31 - 1, int(rng.integers(1, 2**31)), b"")
    if way == 6:
        table = fits.Header.fromstring("".join(f"{one:80}" for one in _bomb_table(side)))
        return "bomb.fz", fits.PrimaryHDU().header.tostring().encode() + table.tostring().encode() + bytes(
            5760
        )
    return "bomb.fits", start + bytes(int(rng.integers(0, 100_000)))


def _bomb_table(side: int) -> list[str]:
    cards = {
        "BITPIX": 8, "NAXIS": 2, "NAXIS1": 8, "NAXIS2": side, "PCOUNT": 10, "GCOUNT": 1, "TFIELDS": 1,
        "ZBITPIX": 16, "ZNAXIS": 2, "ZNAXIS1": side, "ZNAXIS2": side, "ZTILE1": side, "ZTILE2": 1,
    }  # fmt: skip
    texts = {"TTYPE1": "COMPRESSED_DATA", "TFORM1": "1PB(10)", "ZCMPTYPE": "RICE_1"}
    return [
        f"{'XTENSION':8}= 'BINTABLE'",
        *(f"{name:8}= {value:>20}" for name, value in cards.items()),
        *(f"{name:8}= '{value}'" for name, value in texts.items()),
        f"{'ZIMAGE':8}= {'T':>20}",
    ]


def _png(width: int, height: int, rows: bytes) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    packed = zlib.compress(rows, 1)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


_MAGIC = (
    b"SIMPLE  =                    T", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0\0\x10JFIF\0", b"II*\0",
    b"MM\0*", b"XISF0100", b"BM", b"GIF89a", b"\x1f\x8b\x08", b"BZh9", b"\xfd7zXZ\0", b"PK\x03\x04",
    b"%!PS-Adobe-3.0 EPSF", b"%PDF-1.4\n", b"II\x1a\0\0\0HEAPCCDR", b"RIFF", b"\0\0\0\x18ftypcrx ",
    b"P5\n999999 999999\n65535\n", b"<html>", b"x,y,flux\n", b"",
)  # fmt: skip


def _garbage(rng: Random) -> tuple[str, bytes]:
    """The first bytes of a known kind, then anything."""
    start = _MAGIC[int(rng.integers(len(_MAGIC)))]
    ending = str(rng.choice(["fits", "png", "jpg", "tif", "xisf", "xyls", "csv", "txt", "fits.gz", "cr2"]))
    return f"garbage.{ending}", start + rng.bytes(int(rng.integers(0, 20_000)))


def _listed(rng: Random) -> tuple[str, bytes]:
    """A list of stars that are no sky, with junk among them, as text or as a FITS table."""
    name = str(rng.choice(list(FALSE_SKIES)))
    x, y, flux = FALSE_SKIES[name](rng)
    way = int(rng.integers(5))
    if way == 0 and x.size:  # the same stars many times
        again = rng.integers(0, x.size, 3 * x.size)
        x, y, flux = x[again], y[again], flux[again]
    elif way == 1 and x.size:
        x = np.where(rng.random(x.size) < 0.2, rng.choice([np.nan, np.inf, 1e308, -1e9]), x)
        flux = np.where(rng.random(x.size) < 0.2, rng.choice([np.nan, -np.inf, -5.0]), flux)
    elif way == 2:
        x, y = np.rint(x / 8) * 8, np.rint(y / 8) * 8
    elif way == 3:
        x = np.full(x.size, 100.0)
    if rng.random() < 0.5:
        rows = [f"{a},{b},{c}" for a, b, c in zip(x, y, flux, strict=True)]
        if rng.random() < 0.3 and rows:
            rows[int(rng.integers(len(rows)))] = str(rng.choice(["", ",,,", "nan,inf", "1,2,3,4", "é,ü,ß"]))
        return "list.csv", ("x,y,flux\n" + "\n".join(rows) + "\n").encode()
    columns = [
        fits.Column("X", "E", array=x.astype(np.float32)),
        fits.Column("Y", "E", array=y.astype(np.float32)),
        fits.Column("FLUX", "E", array=np.nan_to_num(flux).astype(np.float32)),
    ]
    table = fits.BinTableHDU.from_columns(columns)
    size = (640, 480) if rng.random() < 0.8 else (int(rng.choice([0, -5, 10**9])), 480)
    table.header["IMAGEW"], table.header["IMAGEH"] = size
    file = io.BytesIO()
    with np.errstate(all="ignore"):
        fits.HDUList([fits.PrimaryHDU(), table]).writeto(file)
    return "list.xyls", file.getvalue()


KINDS: dict[str, tuple[Callable[[Random], tuple[str, bytes]], int]] = {
    "false sky": (_false_sky, 6),
    "list": (_listed, 5),
    "noise": (_noise, 2),
    "unreal numbers": (_unreal, 2),
    "truncated": (_truncated, 2),
    "lying header": (_lying, 4),
    "flipped bytes": (_flipped, 6),
    "bomb": (_bomb, 1),
    "xisf lies": (_xisf_lies, 1),
    "garbage": (_garbage, 4),
}
"""What is drawn, and how often."""


def bad_input(seed: int) -> BadInput:
    """The file of a seed: always the same."""
    rng = np.random.default_rng((20261126, seed))
    names = [name for name, (_, often) in KINDS.items() for _ in range(often)]
    kind = names[int(rng.integers(len(names)))]
    with np.errstate(all="ignore"):
        name, content = KINDS[kind][0](rng)
    return BadInput(seed, kind, name, content)


# -- doors in this process -----------------------------------------------------------------------------------


class _Folder:
    """A host whose files lie in one folder, and whose words are kept. Implements `Host`."""

    def __init__(self, folder: Path) -> None:
        from api.solver_commands.host import LocalHost

        self._local, self._folder = LocalHost(), folder
        self.said: list[str] = []

    def _at(self, path: str) -> str:
        return str(self._folder / path)

    def open(self, path: str) -> io.BufferedReader:
        return self._local.open(self._at(path))  # type: ignore[return-value]

    def write(self, path: str, content: bytes) -> None:
        self._local.write(self._at(path), content)

    def exists(self, path: str) -> bool:
        return self._local.exists(self._at(path))

    def remove(self, path: str) -> None:
        self._local.remove(self._at(path))

    def make_folder(self, path: str) -> None:
        self._local.make_folder(self._at(path))

    def read_input(self) -> bytes:
        return b""

    def out(self, text: str) -> None:
        self.said.append(text)

    def err(self, text: str) -> None:
        self.said.append(text)


class Doors:
    """The doors as commands call them, one solver behind them all."""

    def __init__(self) -> None:
        from api.cli.solve import FileSolver
        from api.solver_commands.in_process import SolverInProcess
        from mountnav.catalog.catalog_set import open_catalogs
        from mountnav.solving.settings import SolveSettings

        self._solver = SolverInProcess()
        self._files = FileSolver(open_catalogs(), None, None, SolveSettings())

    def ask(self, door: str, bad: BadInput, folder: Path) -> str:
        """Send a file through a door.

        Returns
        -------
        str
            "refused", or what is wrong: "SOLVED", "CONTRACT ...".
        """
        for old in folder.iterdir():
            old.unlink()
        (folder / bad.name).write_bytes(bad.content)
        host = _Folder(folder)
        if door == "astap":
            from api.solver_commands.astap import run

            arguments = ["-f", bad.name, "-r", "180"] if bad.seed % 2 else ["-f", bad.name]
            code = run(arguments, host, self._solver)
            return _astap_told(code, folder, bad.name)
        if door == "solve-field":
            from api.solver_commands.solve_field import run as run_field

            code = run_field(["--overwrite", bad.name], host, self._solver)
            return _solve_field_told(code, "".join(host.said), folder)
        from api.batch.inputs import frames_of

        for frame in frames_of(folder / bad.name, None):
            found = self._files.outcome(frame)
            if found.verdict is not None and found.verdict.solution is not None:
                return "SOLVED"
            if not (found.unread or (found.verdict is not None and found.verdict.detail)):
                return "CONTRACT: no reason"
        return "refused"


def _astap_told(code: int, folder: Path, name: str) -> str:
    inis = list(folder.glob("*.ini"))
    text = inis[0].read_text() if inis else ""
    if code == 0 or "PLTSOLVD=T" in text or list(folder.glob("*.wcs")):
        return "SOLVED"
    if "PLTSOLVD=F" not in text:
        return f"CONTRACT: exit code {code} and no PLTSOLVD=F"
    return "refused"


def _solve_field_told(code: int, said: str, folder: Path) -> str:
    if list(folder.glob("*.solved")) or list(folder.glob("*.wcs")) or "Field center" in said:
        return "SOLVED"
    if code not in (0, 255) or not said:
        return f"CONTRACT: exit code {code}"
    return "refused"


# -- doors of their own --------------------------------------------------------------------------------------


def _command(arguments: list[str], folder: Path) -> tuple[int, str, float]:
    """Run a command; its exit code, what it said, its most resident memory in MB."""
    log = folder / "said.log"
    with log.open("wb") as said:
        process = subprocess.Popen(arguments, stdout=said, stderr=said, cwd=folder, stdin=subprocess.DEVNULL)
        until_s = time.monotonic() + WAITED_S
        while True:
            pid, status, used = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            if time.monotonic() > until_s:
                process.kill()
                os.wait4(process.pid, 0)
                return -1, "too long", 0.0
            time.sleep(0.01)
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, log.read_text(errors="replace"), used.ru_maxrss / 1000.0


def ask_real(door: str, bad: BadInput, folder: Path) -> tuple[str, float]:
    """Give a file to a command of its own process; what came of it, and its memory in MB."""
    for old in folder.iterdir():
        old.unlink()
    (folder / bad.name).write_bytes(bad.content)
    command = [sys.executable, "-m", "api.main", door]
    rest = {
        "astap": ["-f", bad.name],
        "solve-field": ["--overwrite", bad.name],
        "solve": ["--json", bad.name],
    }
    code, said, most_mb = _command([*command, *rest[door]], folder)
    if code < 0 or "Traceback (most recent call last)" in said:
        return f"BROKEN: exit code {code}: {said[-300:]}", most_mb
    (folder / "said.log").unlink()
    if door == "astap":
        return _astap_told(code, folder, bad.name), most_mb
    if door == "solve-field":
        return _solve_field_told(code, said, folder), most_mb
    return ("SOLVED" if code == 0 else "refused"), most_mb


_SERVED = """
[service]
port = {http}
[nova]
enabled = true
port = {nova}
[site]
latitude_deg = 47.0
longitude_deg = 11.0
[[telescope]]
id = "east"
mount = {{ url = "fake+lx200://" }}
camera = {{ kind = "simulated", width_px = 800, height_px = 600, scale_arcsec_px = 4.0 }}
"""


class Nova:
    """A service with the nova API, and a client's dialogue with it."""

    def __init__(self, folder: Path) -> None:
        with contextlib.ExitStack() as held:
            made = [held.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(2)]
            http_port, self._port = (one.getsockname()[1] for one in made)
        config, self.log = folder / "observatory.toml", folder / "log"
        config.write_text(_SERVED.format(http=http_port, nova=self._port))
        self._said = self.log.open("w")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "api.main", "serve", "--config", str(config)],
            stdout=self._said,
            stderr=self._said,
            env=os.environ | {"MOUNTNAV_JOURNAL": str(folder / "journal.sqlite")},
        )

    def _post(self, path: str, asked: dict[str, object], bad: BadInput | None = None) -> dict[str, object]:
        import httpx

        answer = httpx.post(
            f"http://127.0.0.1:{self._port}{path}",
            data={"request-json": json.dumps(asked)},
            files=None if bad is None else {"file": (bad.name, bad.content)},
            timeout=WAITED_S,
            trust_env=False,
        )
        found: dict[str, object] = answer.json()
        return found

    def _get(self, path: str) -> dict[str, object]:
        import httpx

        found: dict[str, object] = httpx.get(
            f"http://127.0.0.1:{self._port}{path}", timeout=WAITED_S, trust_env=False
        ).json()
        return found

    def begun(self) -> str:
        """Wait until it answers; a session."""
        until_s = time.monotonic() + WAITED_S
        while True:
            try:
                return str(self._post("/api/login", {"apikey": "any"})["session"])
            except Exception:
                if self.process.poll() is not None or time.monotonic() > until_s:
                    raise RuntimeError(self.log.read_text()[-2000:]) from None
                time.sleep(0.2)

    def ask(self, bad: BadInput) -> str:
        """Upload a file and wait for its end."""
        session = str(self._post("/api/login", {"apikey": "any"})["session"])
        told = self._post("/api/upload", {"session": session}, bad)
        if told.get("status") != "success":
            return "refused" if told.get("errormessage") else "CONTRACT: no reason"
        until_s = time.monotonic() + WAITED_S
        while time.monotonic() < until_s:
            jobs = self._get(f"/api/submissions/{told['subid']}")["jobs"]
            if isinstance(jobs, list) and jobs and jobs[0]:
                status = self._get(f"/api/jobs/{jobs[0]}")["status"]
                if status in ("success", "failure"):
                    return "SOLVED" if status == "success" else "refused"
            time.sleep(0.05)
        return "BROKEN: no end"

    def most_mb(self) -> float:
        """Most resident memory of the service and its processes, the largest of them."""
        pids = [self.process.pid]
        for pid in pids:
            with contextlib.suppress(OSError):
                pids += [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        return max(map(_peak_mb, pids))

    def close(self) -> str:
        """End it; what it said."""
        self.process.terminate()
        self.process.wait(60)
        self._said.close()
        return self.log.read_text()


def _peak_mb(pid: int) -> float:
    with contextlib.suppress(OSError):
        told = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
        return 0.0 if told is None else int(told[1]) / 1000.0
    return 0.0


# -- counting ------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class Tally:
    """What came of the files."""

    asked: Counter[str] = field(default_factory=Counter)
    bad: list[str] = field(default_factory=list)
    most_mb: float = 0.0

    def add(self, other: Tally) -> None:
        """Count what another one counted."""
        self.asked += other.asked
        self.bad += other.bad
        self.most_mb = max(self.most_mb, other.most_mb)

    def take(self, door: str, bad: BadInput, told: str, most_mb: float, allowed_mb: float = MOST_MB) -> None:
        """Count one."""
        self.asked[f"{door}: {bad.kind}"] += 1
        self.most_mb = max(self.most_mb, most_mb)
        if told != "refused":
            self.bad.append(f"seed {bad.seed} ({bad.kind}, {bad.name}) at {door}: {told}")
        if most_mb > allowed_mb:
            self.bad.append(f"seed {bad.seed} ({bad.kind}, {bad.name}) at {door}: {most_mb:.0f} MB")


def run_here(seeds: range, doors: tuple[str, ...], *, most_mb: float = MOST_MB) -> Tally:
    """Each file through one door, in this process, which may be `most_mb` large."""
    tally = Tally()
    opened = Doors()
    with tempfile.TemporaryDirectory() as name:
        for seed in seeds:
            bad, door = bad_input(seed), doors[seed % len(doors)]
            try:
                told = opened.ask(door, bad, Path(name))
            except Exception:
                told = "BROKEN: " + traceback.format_exc()[-600:]
            tally.take(door, bad, told, _peak_mb(os.getpid()), most_mb)
    return tally


def _run_real(seeds: range) -> Tally:
    tally = Tally()
    with tempfile.TemporaryDirectory() as name, tempfile.TemporaryDirectory() as served:
        nova = Nova(Path(served))
        try:
            nova.begun()
            for seed in seeds:
                bad = bad_input(seed)
                door = (*DOORS, "nova")[seed % 4]
                if door == "nova":
                    tally.take(door, bad, nova.ask(bad), nova.most_mb())
                else:
                    tally.take(door, bad, *ask_real(door, bad, Path(name)))
        finally:
            said = nova.close()
        if "Traceback (most recent call last)" in said:
            tally.bad.append(f"the service said: {said[-1500:]}")
    return tally


@dataclass(frozen=True, slots=True)
class Kept:
    """What came of parts of a run, a line of a file each.

    Attributes
    ----------
    path : Path
    how : str
        The doors, and which state of the code asked them.
    """

    path: Path
    how: str

    @classmethod
    def at(cls, path: Path, doors: str) -> Kept:
        """The file of that path, begun or to be begun.

        Raises
        ------
        SystemExit
            Other doors or another state of the code stand in it.
        """
        root, digest = Path(__file__).parents[1], hashlib.sha256()
        for folder in ("mountnav", "drivers", "api"):
            for source in sorted((root / folder).rglob("*.py")):
                digest.update(source.read_bytes())
        digest.update(Path(__file__).read_bytes())
        kept = cls(path, f"{doors} {digest.hexdigest()[:16]}")
        if any(one["how"] != kept.how for one in kept._lines()):
            raise SystemExit(f"{path} is of other doors or another state of the code: give another file")
        return kept

    def _lines(self) -> list[dict[str, Any]]:
        found = []
        for line in self.path.read_text().splitlines() if self.path.exists() else ():
            with contextlib.suppress(ValueError):  # cut short when the run was ended
                found.append(json.loads(line))
        return found

    def tally(self, part: range) -> Tally | None:
        """What came of a part; None if it wasn't done."""
        for one in self._lines():
            if (one["first"], one["stop"]) == (part.start, part.stop):
                return Tally(Counter(one["asked"]), one["bad"], one["most_mb"])
        return None

    def add(self, part: range, tally: Tally) -> None:
        """Keep what came of a part."""
        line = {"how": self.how, "first": part.start, "stop": part.stop, "asked": dict(tally.asked)}
        # a line that was cut short has no end: the new one begins on a line of its own
        with self.path.open("a+b") as file:
            begun = file.seek(0, os.SEEK_END)
            if begun:
                file.seek(begun - 1)
            cut = bool(begun) and file.read(1) != b"\n"
            told = json.dumps(line | {"bad": tally.bad, "most_mb": tally.most_mb})
            file.write(("\n" * cut + told + "\n").encode())


def _parts(first: int, count: int, each: int) -> Iterator[range]:
    for start in range(first, first + count, each):
        yield range(start, min(start + each, first + count))


def main() -> None:
    """Ask, and tell what went wrong; exit code 1 if anything did."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bad_inputs")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--doors", default=",".join(DOORS))
    parser.add_argument("--real", action="store_true", help="commands and a service of their own processes")
    parser.add_argument("--told", action="store_true", help="the counts of each kind and door")
    parser.add_argument("--into", type=Path, help="a file that keeps the outcomes, and goes on from them")
    given = parser.parse_args()
    tally = Tally()
    doors = "real" if given.real else given.doors
    kept = None if given.into is None else Kept.at(given.into, doors)
    for part in _parts(given.first, given.inputs, EACH_PROCESS):
        # a process for each part, as memory that was once taken says nothing of the files after it
        found = None if kept is None else kept.tally(part)
        if found is None:
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
                if given.real:
                    found = pool.submit(_run_real, part).result()
                else:
                    found = pool.submit(run_here, part, tuple(given.doors.split(","))).result()
            if kept is not None:
                kept.add(part, found)
        tally.add(found)
        spent = resource.getrusage(resource.RUSAGE_CHILDREN)
        print(
            f"{sum(tally.asked.values())} files, up to seed {part[-1]}: {len(tally.bad)} wrong, at most "
            f"{tally.most_mb:.0f} MB resident, {spent.ru_utime + spent.ru_stime:.0f} CPU s",
            flush=True,
        )
        for one in found.bad:
            print(one, flush=True)
    if given.told:
        for name, count in sorted(tally.asked.items()):
            print(f"  {name}: {count}")
    sys.exit(1 if tally.bad else 0)


if __name__ == "__main__":
    main()
