"""Room on the disk for an import: known beforehand where records have a fixed size, else guessed."""

from __future__ import annotations

import shutil
from pathlib import Path

from mountnav.errors import BadSettings

BYTES_PER_STAR = 20
"""Of the packed file: 18, and its share of the tables."""
SPOOL_BYTES_PER_STAR = 41
"""Of what is kept until the packed file is there (`mountnav.catalog.packed.spool_parts`)."""
SOURCE_BYTES_PER_STAR = {"ucac4": 78, "usno-b1": 80, "siril": 16}
"""Catalogs whose stars can be counted by the size of their files [CATALOGS, Formats §3, §4, §6]."""
ENOUGH_TO_GUESS_BY = 0.02
"""Share of the source that must be in before the rest is guessed from it."""

ADVICE = (
    "free some room, name a folder on another disk with --folder, or import a part: --mag-limit, --cone, "
    "--dec-range"
)


def needed_bytes(stars: float) -> int:
    """How much an import of so many stars takes while it ends: what was kept, and the packed file."""
    return int(stars * (BYTES_PER_STAR + SPOOL_BYTES_PER_STAR))


def stars_in_files(kind: str, size_bytes: int) -> int | None:
    """How many stars the files hold at most; None if their size doesn't tell."""
    record = SOURCE_BYTES_PER_STAR.get(kind)
    return None if record is None else size_bytes // record


def require_room(folder: Path, stars: int, stars_in: int) -> None:
    """Refuse what can't fit.

    Parameters
    ----------
    folder : Path
        Where the import writes.
    stars : int
        How many there will be.
    stars_in : int
        How many of these are there already.

    Raises
    ------
    BadSettings
        Tells how much is needed and how much there is.
    """
    if (told := shortage(folder, stars, stars_in)) is not None:
        raise BadSettings(f"there isn't room enough: {told}", device=str(folder), advice=ADVICE)


def shortage(folder: Path, stars: float, stars_in: int) -> str | None:
    """Compare what an import still needs with what is free.

    Returns
    -------
    str or None
        None if it fits.
    """
    needed = needed_bytes(stars) - stars_in * SPOOL_BYTES_PER_STAR
    free = shutil.disk_usage(folder).free
    if needed <= free:
        return None
    return f"{stars:,.0f} stars still need {needed / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free"
