"""Which zone files lie below a folder, and how to tell a list of zones in a few words."""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from pathlib import Path

from mountnav.errors import BadCatalog

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
