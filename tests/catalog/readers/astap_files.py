"""Area files of ASTAP's star databases, written star by star from the description of the format.

Written apart from the reader: places in radians and loops as in the author's programs, no arrays.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

D50_TEXT = (
    "GAIA DR3, density<=5000 stars/sqr(degree), Epoch=2025. Including 82 bright Tycho2 stars. "
    "Magnitude is Gaia BP."
)
V50_TEXT = (
    "GAIA DR3, density<=5000 stars/sqr(degree), Epoch=2025. 82 Tycho2 stars. "
    "Magnitude is V, Bp-Rp info included."
)
# the borders of the rings as printed in ASTAP's source, in degrees
EDGES_1476 = (
    *(-90.0, -87.42857143, -82.28571429, -77.14285714, -72.0, -66.85714286, -61.71428571, -56.57142857),
    *(-51.42857143, -46.28571429, -41.14285714, -36.0, -30.85714286, -25.71428571, -20.57142857),
    *(-15.42857143, -10.28571429, -5.142857143, 0.0, 5.142857143, 10.28571429, 15.42857143, 20.57142857),
    *(25.71428571, 30.85714286, 36.0, 41.14285714, 46.28571429, 51.42857143, 56.57142857, 61.71428571),
    *(66.85714286, 72.0, 77.14285714, 82.28571429, 87.42857143, 90.0),
)
EDGES_290 = (
    *(-90.0, -85.23224404, -75.66348756, -65.99286637, -56.14497387, -46.03163067, -35.54307745),
    *(-24.53348115, -12.79440589, 0.0, 12.79440589, 24.53348115, 35.54307745, 46.03163067, 56.14497387),
    *(65.99286637, 75.66348756, 85.23224404, 90.0),
)
CELLS_1476 = (
    *(1, 3, 9, 15, 21, 27, 33, 38, 43, 48, 52, 56, 60, 63, 65, 67, 68, 69),
    *(69, 68, 67, 65, 63, 60, 56, 52, 48, 43, 38, 33, 27, 21, 15, 9, 3, 1),
)
CELLS_290 = (1, 4, 8, 12, 16, 20, 24, 28, 32, 32, 28, 24, 20, 16, 12, 8, 4, 1)


@dataclass(frozen=True)
class Star:
    """One star as it goes in: degrees, ten times the magnitude, color byte."""

    ra_deg: float
    dec_deg: float
    tenths: int
    color: int = -128


def label(ra_deg: float, dec_deg: float, areas: int) -> str:
    """The area of a place, as in the file's name."""
    edges, cells = (EDGES_1476, CELLS_1476) if areas == 1476 else (EDGES_290, CELLS_290)
    ring = 1
    while ring < len(cells) and dec_deg >= edges[ring]:
        ring += 1
    return f"{ring:02d}{1 + int(cells[ring - 1] * (ra_deg % 360.0) / 360.0):02d}"


def head(text: str, size: int, version: int | None = None) -> bytes:
    """110 bytes; a version takes the place of the text's last byte."""
    padded = text.encode("ascii").ljust(109)[:109]
    return (padded if version is None else padded[:108] + bytes([version])) + bytes([size])


def raw_place(star: Star) -> tuple[int, int]:
    """The three bytes of each coordinate as whole numbers."""
    ra = round((256**3 - 1) * math.radians(star.ra_deg % 360.0) / (2 * math.pi))
    dec = round((256 * 256 * 128 - 1) * math.radians(star.dec_deg) / (0.5 * math.pi))
    return (0 if ra >= 0xFFFFFF else ra), dec


def body(stars: Iterable[Star], size: int) -> bytes:
    """Records, with marks where the layout has them; brightest first, then by upper byte of declination."""
    packed = sorted((star.tenths, raw_place(star)[1] >> 16, *raw_place(star), star.color) for star in stars)
    out = bytearray()
    told: tuple[int, int] | None = None
    name = (4711).to_bytes(4, "little") if size >= 9 else b""
    for tenths, upper, ra, dec, color in packed:
        mag = (tenths % 256).to_bytes(1, "little")
        low = (dec & 0xFFFF).to_bytes(2, "little")
        if size in (5, 6, 9) and told != (tenths, upper):
            told = (tenths, upper)
            out += name + b"\xff\xff\xff" + bytes([upper + 128, tenths + 16]) + bytes(size == 6)
        if size == 10 and (told is None or told[0] != tenths):
            told = (tenths, upper)
            out += name + b"\xff\xff\xff\0\0" + mag
        out += name + ra.to_bytes(3, "little") + low
        if size in (7, 10, 11):
            out += (upper % 256).to_bytes(1, "little")
        if size in (7, 11):
            out += mag
        if size == 6:
            out += (color % 256).to_bytes(1, "little")
    return bytes(out)


def write_areas(
    folder: Path,
    stars: Iterable[Star],
    *,
    database: str = "d50",
    areas: int = 1476,
    text: str = D50_TEXT,
    size: int = 5,
    version: int | None = None,
) -> list[Path]:
    """Write the area files that the stars need."""
    by_area: dict[str, list[Star]] = {}
    for star in stars:
        by_area.setdefault(label(star.ra_deg, star.dec_deg, areas), []).append(star)
    paths = []
    for name, here in sorted(by_area.items()):
        path = folder / f"{database}_{name}.{areas}"
        path.write_bytes(head(text, size, version) + body(here, size))
        paths.append(path)
    return paths
