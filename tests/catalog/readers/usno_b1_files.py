"""Zone files of USNO-B1.0 written for tests, from the table of the format alone."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from pathlib import Path

# [CATALOGS, Formats §4]: the letters of each packed word, from the first digit to the last
WORDS = {
    2: (("i", 1), ("P", 1), ("S", 4), ("A", 4)),
    3: (("j", 1), ("M", 1), ("R", 1), ("Q", 1), ("y", 3), ("x", 3)),
    4: (("k", 1), ("e", 3), ("v", 3), ("u", 3)),
}
MAGNITUDE = (("G", 2), ("S", 1), ("F", 3), ("m", 4))
RESIDUAL = (("C", 1), ("r", 4), ("R", 4))
Observation = Mapping[str, int]
NOT_SEEN: Observation = {"G": 0, "S": 0, "F": 0, "m": 0}
SEEN: Observation = {"G": 9, "S": 4, "F": 12, "m": 1500}
PLAIN: dict[str, int] = {
    "ra": 1000,
    "spd": 18000,
    "i": 0,
    "P": 9,
    "S": 5003,
    "A": 4990,
    "j": 0,
    "M": 3,
    "R": 1,
    "Q": 2,
    "y": 7,
    "x": 6,
    "k": 0,
    "e": 369,
    "v": 88,
    "u": 77,
}
"""A star that nothing is wrong with."""


def record(
    star: Mapping[str, int],
    observations: Iterable[Observation] = (NOT_SEEN, SEEN, SEEN, SEEN, NOT_SEEN),
    *,
    order: str = "<",
) -> bytes:
    """Bytes of one star: `PLAIN` with changes, and its five observations, in file units."""
    values = {**PLAIN, **star}
    words = [values["ra"], values["spd"], *(_packed(WORDS[n], values) for n in (2, 3, 4))]
    observations = list(observations)
    words += [_packed(MAGNITUDE, one) for one in observations]
    words += [_packed(RESIDUAL, {"C": 1, "r": 5010, "R": 4990, **one}) for one in observations]
    words += [1234567 if one["F"] else 0 for one in observations]
    return struct.pack(f"{order}20I", *words)


def write_zone(folder: Path, zone: int, records: Iterable[bytes]) -> Path:
    """Write a zone file of records already in order."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"b{zone:04d}.cat"
    path.write_bytes(b"".join(records))
    return path


def accelerator(right_ascensions: Iterable[int]) -> bytes:
    """The .acc file of a zone: 96 lines, one for each quarter of an hour."""
    bins = [ra // (24 * 15 * 3600 * 100 // 96) for ra in right_ascensions]
    lines, first = [], 1
    for number in range(96):
        count = bins.count(number)
        lines.append(f"{number / 4:5.2f}{first:12d}{count:12d}\n")
        first += count
    return "".join(lines).encode("ascii")


def _packed(digits: tuple[tuple[str, int], ...], values: Mapping[str, int]) -> int:
    return int("".join(f"{values[name]:0{count}d}" for name, count in digits))
