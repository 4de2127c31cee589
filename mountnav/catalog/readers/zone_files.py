"""Zone files: records of one size, sorted by right ascension, a band of declination each."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import COPY_AGAIN, malformed_at
from mountnav.errors import BadCatalog
from mountnav.files import open_buffered

Records = NDArray[np.void]

RECORDS_AT_ONCE = 200_000
"""Records that are read at a time; chosen by hand, below what `Reader.read` promises."""
SWAPPED = (
    "the file's bytes are swapped: get the catalog in its original (little-endian) order, "
    "or swap the bytes of each field"
)


@dataclass(frozen=True, slots=True)
class Zone:
    """Where the records of a zone file may lie, in the units of the file.

    Attributes
    ----------
    turn : int
        A full turn: right ascensions are below it.
    least_spd, most_spd : int
        South polar distances, both included.
    unit : str
        For messages: "mas".
    """

    turn: int
    least_spd: int
    most_spd: int
    unit: str

    def holds(self, ra: NDArray[np.int64], spd: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which positions are of this zone."""
        return np.asarray((ra >= 0) & (ra < self.turn) & (spd >= self.least_spd) & (spd <= self.most_spd))


def record_count(path: Path, record: np.dtype[np.void]) -> int:
    """How many records a file holds.

    Raises
    ------
    BadCatalog
        The file doesn't end where a record ends, or is empty.
    """
    size = path.stat().st_size
    count, rest = divmod(size, record.itemsize)
    if rest:
        whole = count * record.itemsize
        raise malformed_at(
            path.name, whole, f"a record of {record.itemsize} bytes", f"the end of the file after {rest}"
        )
    if count == 0:
        raise malformed_at(path.name, 0, f"records of {record.itemsize} bytes", "an empty file")
    return count


def records_in_order(
    path: Path,
    record: np.dtype[np.void],
    zone: Zone,
    *,
    bound: Callable[[Records], NDArray[np.bool_]] | None = None,
) -> Iterator[tuple[int, Records]]:
    """Read a zone file in chunks, the records in their order.

    Parameters
    ----------
    record : dtype
        With fields ``ra`` and ``spd``.
    bound : callable, optional
        Which records of a chunk must be in the zone and in order; all if left out. The others need only
        have possible coordinates.

    Yields
    ------
    first : int
        Number of the chunk's first record in the file, from 0.
    records : ndarray of `record`, shape (n,)
        One chunk.

    Raises
    ------
    BadCatalog
        Truncated, byte-swapped, out of order, or of another zone: tells the offset.
    """
    count = record_count(path, record)
    everywhere = Zone(zone.turn, 0, zone.turn // 2, zone.unit)
    last_ra = 0
    with open_buffered(path) as file:
        for first in range(0, count, RECORDS_AT_ONCE):
            wanted = min(RECORDS_AT_ONCE, count - first)
            read = file.read(wanted * record.itemsize)
            if len(read) != wanted * record.itemsize:
                raise malformed_at(
                    path.name,
                    first * record.itemsize + len(read),
                    f"{count} records",
                    "the end of the file: it shrank while it was read",
                )
            records = np.frombuffer(read, dtype=record)
            ra, spd = records["ra"].astype(np.int64), records["spd"].astype(np.int64)
            strict = np.ones(wanted, dtype=bool) if bound is None else bound(records)
            fits = np.where(strict, zone.holds(ra, spd), everywhere.holds(ra, spd))
            if not fits.all():
                bad = int(np.argmin(fits))
                raise _misplaced(path.name, first + bad, records[bad : bad + 1], zone)
            order = np.flatnonzero(strict)
            back = np.flatnonzero(np.diff(ra[order], prepend=last_ra) < 0)
            if back.size:
                bad = int(order[back[0]])
                before = int(ra[order[back[0] - 1]]) if back[0] else last_ra
                raise malformed_at(
                    path.name,
                    (first + bad) * record.itemsize + _offset(record, "ra"),
                    f"a right ascension of {before} {zone.unit} or more, for the file is sorted",
                    str(int(ra[bad])),
                )
            if order.size:
                last_ra = int(ra[order[-1]])
            yield first, records


def _misplaced(file: str, number: int, one: Records, zone: Zone) -> Exception:
    record = one.dtype
    ra, spd = one["ra"].astype(np.int64), one["spd"].astype(np.int64)
    ra_fits = 0 <= int(ra[0]) < zone.turn
    field, value = ("spd", int(spd[0])) if ra_fits else ("ra", int(ra[0]))
    expected = (
        f"a south polar distance of {zone.least_spd} to {zone.most_spd} {zone.unit}"
        if ra_fits
        else f"a right ascension of 0 to {zone.turn - 1} {zone.unit}"
    )
    turned = [one[name].byteswap().astype(np.int64) for name in ("ra", "spd")]
    swapped = bool(zone.holds(*turned)[0])
    return malformed_at(
        file,
        number * record.itemsize + _offset(record, field),
        expected,
        f"{value}, whose bytes are swapped" if swapped else str(value),
        advice=SWAPPED if swapped else COPY_AGAIN,
    )


def _offset(record: np.dtype[np.void], field: str) -> int:
    fields = record.fields
    assert fields is not None
    return int(fields[field][1])


LEVELS = 3
"""So deep folders are searched: a disk's root, u4b or 000 to 179 below it, and one more."""


def files_by_zone(path: Path, name: re.Pattern[str], what: str, zones: Container[int]) -> dict[int, Path]:
    """Find the zone files in a folder and those below it.

    Parameters
    ----------
    path : Path
        A folder, or a single file.
    name : pattern
        Matches a file's whole name; its first group is the number of the zone.
    what : str
        For the message: "zone files z001 to z900".
    zones : container of int
        Possible numbers.

    Returns
    -------
    dict
        Number to file; empty if there is none.

    Raises
    ------
    BadCatalog
        A zone is there twice.
    """
    found: dict[int, Path] = {}
    for file in sorted(_files(path, LEVELS)):
        match = name.fullmatch(file.name)
        if match is None or int(match[1]) not in zones:
            continue
        other = found.setdefault(int(match[1]), file)
        if other != file:
            raise BadCatalog(
                f"the same zone is there twice: {other} and {file}",
                device=str(path),
                advice=f"give a folder that holds the {what} once",
            )
    return found


def zone_list(zones: Sequence[int], *, most: int = 12) -> str:
    """Numbers as ranges: "1-3, 7".

    Parameters
    ----------
    zones : sequence of int
        Ascending.
    most : int
        So many ranges are spelled out.
    """
    ranges: list[list[int]] = []
    for zone in zones:
        if ranges and zone == ranges[-1][1] + 1:
            ranges[-1][1] = zone
        else:
            ranges.append([zone, zone])
    told = [str(a) if a == b else f"{a}-{b}" for a, b in ranges[:most]]
    return ", ".join(told) + (", ..." if len(ranges) > most else "")


def _files(path: Path, levels: int) -> list[Path]:
    if path.is_file():
        return [path]
    found: list[Path] = []
    for entry in path.iterdir():
        if entry.is_file():
            found.append(entry)
        elif levels > 1 and entry.is_dir():
            found += _files(entry, levels - 1)
    return found
