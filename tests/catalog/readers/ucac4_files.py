"""Zone files of UCAC4 written for tests from the table of the format alone; CDS's sample read."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# [CATALOGS, Formats §3]: name, offset, type, how many
TABLE = (
    ("ra", 0, "i", 1),
    ("spd", 4, "i", 1),
    ("fit_mag", 8, "h", 1),
    ("aperture_mag", 10, "h", 1),
    ("mag_sigma", 12, "B", 1),
    ("object_type", 13, "B", 1),
    ("double", 14, "B", 1),
    ("sigma_ra", 15, "b", 1),
    ("sigma_dec", 16, "b", 1),
    ("images", 17, "B", 1),
    ("images_used", 18, "B", 1),
    ("catalogs", 19, "B", 1),
    ("epoch_ra", 20, "H", 1),
    ("epoch_dec", 22, "H", 1),
    ("pm_ra", 24, "h", 1),
    ("pm_dec", 26, "h", 1),
    ("sigma_pm_ra", 28, "b", 1),
    ("sigma_pm_dec", 29, "b", 1),
    ("twomass_key", 30, "I", 1),
    ("jhk_mag", 34, "h", 3),
    ("jhk_flags", 40, "B", 3),
    ("jhk_sigma", 43, "B", 3),
    ("apass_mag", 46, "h", 5),
    ("apass_sigma", 56, "b", 5),
    ("yale", 61, "B", 1),
    ("matches", 62, "I", 1),
    ("leda", 66, "B", 1),
    ("twomass_extended", 67, "B", 1),
    ("star_id", 68, "I", 1),
    ("ucac2_zone", 72, "H", 1),
    ("ucac2_number", 74, "I", 1),
)
BIASED = ("sigma_ra", "sigma_dec", "sigma_pm_ra", "sigma_pm_dec")
SIGMA_PM_CODES = {275: 251, 325: 252, 375: 253, 450: 254, 500: 255}
PLAIN: dict[str, int | tuple[int, ...]] = {
    "ra": 1000,
    "spd": 359_000,
    "fit_mag": 12100,
    "aperture_mag": 12000,
    "mag_sigma": 2,
    "object_type": 0,
    "double": 0,
    "sigma_ra": 20,
    "sigma_dec": 25,
    "images": 4,
    "images_used": 4,
    "catalogs": 3,
    "epoch_ra": 9500,
    "epoch_dec": 9600,
    "pm_ra": 100,
    "pm_dec": -50,
    "sigma_pm_ra": 15,
    "sigma_pm_dec": 17,
    "twomass_key": 7,
    "jhk_mag": (10500, 10200, 10100),
    "jhk_flags": (5, 5, 5),
    "jhk_sigma": (2, 2, 2),
    "apass_mag": (12900, 12200, 12500, 12000, 11900),
    "apass_sigma": (3, 4, 2, 3, 5),
    "yale": 0,
    "matches": 10,
    "leda": 0,
    "twomass_extended": 0,
    "star_id": 1_000_001,
    "ucac2_zone": 0,
    "ucac2_number": 0,
}
"""A star that nothing is wrong with; errors as plain numbers, not less 128."""


def record(order: str = "<", **changed: int | tuple[int, ...]) -> bytes:
    """Bytes of one star: `PLAIN` with changes, in file units."""
    out = bytearray(78)
    for name, offset, kind, count in TABLE:
        value = (PLAIN | changed)[name]
        values = value if isinstance(value, tuple) else (value,)
        if name in BIASED:
            values = tuple(v - 128 for v in values)
        struct.pack_into(f"{order}{count}{kind}", out, offset, *values)
    return bytes(out)


def write_zone(folder: Path, zone: int, stars: Iterable[Mapping[str, Any]]) -> Path:
    """Write a zone file, sorted by right ascension."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"z{zone:03d}"
    path.write_bytes(b"".join(record(**star) for star in sorted(stars, key=lambda star: star["ra"])))
    return path


@dataclass(frozen=True)
class Printed:
    """A star as CDS prints it."""

    zone: int
    number: int
    ra_deg: float
    dec_deg: float
    sigma_ra_mas: float
    sigma_dec_mas: float
    sigma_2000_mas: float
    epoch_ra_yr: float
    epoch_dec_yr: float
    fit_mag: float
    aperture_mag: float
    mag_sigma: float
    object_type: int
    double: int
    images: tuple[int, int, int]
    motion: tuple[float, ...]
    star_id: int
    twomass_key: int
    jhk_mag: tuple[float, ...]
    apass_mag: tuple[float, ...]
    apass_sigma: tuple[float, ...]
    matches: int
    leda: int
    twomass_extended: int

    def in_file_units(self) -> dict[str, int | tuple[int, ...]]:
        """What the zone file must have held."""
        known = not math.isnan(self.motion[2])
        sigmas = [round(s * 10) if known else 500 for s in self.motion[2:]]
        codes = [SIGMA_PM_CODES.get(s, s) for s in sigmas]
        return PLAIN | {
            "ra": round(self.ra_deg * 3.6e6),
            "spd": round((self.dec_deg + 90) * 3.6e6),
            "fit_mag": _mmag(self.fit_mag),
            "aperture_mag": _mmag(self.aperture_mag),
            "mag_sigma": 99 if math.isnan(self.mag_sigma) else round(self.mag_sigma * 100),
            "object_type": self.object_type,
            "double": self.double,
            "sigma_ra": int(self.sigma_ra_mas),
            "sigma_dec": int(self.sigma_dec_mas),
            "images": self.images[0],
            "images_used": self.images[1],
            "catalogs": self.images[2],
            "epoch_ra": round((self.epoch_ra_yr - 1900) * 100),
            "epoch_dec": round((self.epoch_dec_yr - 1900) * 100),
            "pm_ra": round(self.motion[0] * 10) if known else 0,
            "pm_dec": round(self.motion[1] * 10) if known else 0,
            "sigma_pm_ra": codes[0],
            "sigma_pm_dec": codes[1],
            "twomass_key": self.twomass_key,
            "jhk_mag": tuple(_mmag(m) for m in self.jhk_mag),
            "apass_mag": tuple(_mmag(m) for m in self.apass_mag),
            "apass_sigma": tuple(99 if math.isnan(s) else round(s * 100) for s in self.apass_sigma),
            "matches": self.matches,
            "leda": self.leda,
            "twomass_extended": self.twomass_extended,
            "star_id": self.star_id,
        }


def printed_stars(path: Path) -> list[Printed]:
    """Read CDS's sample: columns fixed by its header."""
    return [_printed(line) for line in path.read_text("latin-1").splitlines() if line[:3].isdigit()]


def _printed(line: str) -> Printed:
    star, place, mags, kind, images, motion, names, infrared, apass, flags, sizes = line.split("|")
    return Printed(
        zone=int(star[:3]),
        number=int(star[4:]),
        ra_deg=_number(place[:11]),
        dec_deg=_number(place[11:22]),
        sigma_ra_mas=_number(place[22:26]),
        sigma_dec_mas=_number(place[26:30]),
        sigma_2000_mas=_number(place[30:35]),
        epoch_ra_yr=_number(place[35:43]),
        epoch_dec_yr=_number(place[43:51]),
        fit_mag=_number(mags[:6]),
        aperture_mag=_number(mags[7:13]),
        mag_sigma=_number(mags[14:18]),
        object_type=int(kind[:2]),
        double=int(kind[2:]),
        images=(int(images[:3]), int(images[3:7]), int(images[7:])),
        motion=tuple(_number(motion[a:b]) for a, b in ((0, 8), (8, 17), (17, 22), (22, 27))),
        star_id=int(names[:9]),
        twomass_key=int(infrared[:10].strip() or 0),
        jhk_mag=tuple(_number(infrared[11 + 15 * k : 17 + 15 * k]) for k in range(3)),
        apass_mag=tuple(_number(apass[11 * k : 11 * k + 6]) for k in range(5)),
        apass_sigma=tuple(_apass_sigma(apass[11 * k + 7 : 11 * k + 10]) for k in range(5)),
        matches=int(flags[3:]),
        leda=int(sizes[:3]),
        twomass_extended=int(sizes[3:7]),
    )


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _apass_sigma(text: str) -> float:
    # that of a single observation is printed without a point: -05 is -0.05
    return _number(text) if "." in text else 0.01 * _number(text)


def _mmag(mag: float) -> int:
    return 20000 if math.isnan(mag) else round(mag * 1000)
