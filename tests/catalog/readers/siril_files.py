"""Siril's catalog files, written record by record from the specification."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from astropy import units
from astropy_healpix import lonlat_to_healpix

TITLE = "Siril Gaia DR3 astrometric extract"
SCALE = (2**31 - 1) / 360.0


@dataclass(frozen=True)
class Star:
    """One star as it goes in: degrees, mas/yr, kelvin, mag; all are cut off to whole steps."""

    ra_deg: float
    dec_deg: float
    pm_ra: int = 0
    pm_dec: int = 0
    teff: int = 0
    mag: float = 15.0

    def raw(self) -> tuple[int, int, int, int, int, int]:
        """The six numbers of its record."""
        place = int(self.ra_deg * SCALE), int(self.dec_deg * SCALE)
        return (*place, self.pm_ra, self.pm_dec, self.teff, int(round(self.mag * 1000, 6)))


def pixel_of(star: Star, level: int) -> int:
    """NESTED pixel."""
    return int(lonlat_to_healpix(star.ra_deg * units.deg, star.dec_deg * units.deg, 2**level, order="nested"))


def head(
    level: int, *, release: int = 3, kind: int = 1, chunk: tuple[int, int] | None = None, title: str = TITLE
) -> bytes:
    """128 bytes."""
    fields = [0, 0, 0, 0, 0]
    if chunk is not None:
        pixels = 4 ** (level - chunk[0])
        fields = [1, chunk[0], chunk[1], chunk[1] * pixels, (chunk[1] + 1) * pixels - 1]
    return struct.pack("<48sBBBBBIII63x", title.encode("ascii"), release, level, kind, *fields)


def whole(stars: Iterable[Star], level: int, *, chunk: tuple[int, int] | None = None) -> bytes:
    """Head, index and records."""
    by_pixel: dict[int, list[Star]] = {}
    for star in stars:
        by_pixel.setdefault(pixel_of(star, level), []).append(star)
    pixels = range(12 * 4**level)
    if chunk is not None:
        size = 4 ** (level - chunk[0])
        pixels = range(chunk[1] * size, (chunk[1] + 1) * size)
    index, records, count = bytearray(), bytearray(), 0
    for pixel in pixels:
        for star in by_pixel.get(pixel, ()):
            records += struct.pack("<iihhHh", *star.raw())
            count += 1
        index += struct.pack("<I", count)
    return head(level, chunk=chunk) + bytes(index) + bytes(records)


def write_whole(path: Path, stars: Iterable[Star], level: int) -> Path:
    """Write the one file of a catalog."""
    path.write_bytes(whole(stars, level))
    return path
