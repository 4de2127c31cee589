"""What other programs take: headers of solved frames as files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from api.archive.fetching import is_remote
from api.batch.inputs import stem
from mountnav.archive.columns import Cell
from mountnav.archive.folder import RunFolder
from mountnav.archive.tables import read_rows
from mountnav.errors import BadFrame, BadRequest
from mountnav.files import open_plain, replace_bytes
from mountnav.identification.gwcs import asdf_bytes, require_gwcs
from mountnav.identification.tpv import tpv_cards
from mountnav.reading.content import OnDisk
from mountnav.reading.fits_update import wcs_header

FOLDER_FRAMES = 10_000
"""Files of a folder: more make many file systems slow."""


Kind = Literal["sip", "tpv", "gwcs"]
"""How distortion is written: as the solution has it (SIP, or ZPN), as SCAMP does, or as an ASDF file."""


@dataclass(frozen=True, slots=True)
class Written:
    """How many headers were written, and of how many frames none could be.

    Attributes
    ----------
    why : str
        Of the first one that was left out.
    """

    count: int
    left: int = 0
    why: str = ""


def write_headers(run: RunFolder, out: Path, kind: Kind) -> Written:
    """Write a ``.wcs`` or ``.asdf`` file for each frame that is solved.

    A frame whose lens this kind has no words for is left out, and counted.

    Parameters
    ----------
    out : Path
        Gets a folder for each `FOLDER_FRAMES` numbers of the list, and files ``NUMBER-NAME.wcs`` in it;
        ``NUMBER-NAME-exposure2.wcs`` of a plate's second exposure.

    Raises
    ------
    OSError
        They can't be written.
    BadRequest
        A chunk is damaged, or a package is missing.
    """
    if kind == "gwcs":
        require_gwcs()
    count, left, why = 0, 0, ""
    for number in sorted(run.done()):
        path = run.chunk(number)
        cards = _cards(path)
        for row in read_rows(path / "frames.parquet", ["number", "file", "extension"]):
            place = row["number"]
            if place not in cards:
                continue
            file, extension = str(row["file"]), row["extension"]
            folder = out / f"{int(place or 0) // FOLDER_FRAMES:05d}"
            name = stem(file.rpartition("/")[2])[:100]
            for exposure, text in enumerate(cards[place], 1):
                try:
                    content = _content(json.loads(text), kind, run.name, file, extension)
                except BadRequest as fault:
                    left, why = left + 1, why or f"{file}: {fault}"
                    continue
                folder.mkdir(parents=True, exist_ok=True)
                which = "" if exposure == 1 else f"-exposure{exposure}"
                ending = "asdf" if kind == "gwcs" else "wcs"
                replace_bytes(folder / f"{place:09d}-{name}{which}.{ending}", content)
                count += 1
    return Written(count, left, why)


def _cards(chunk: Path) -> dict[Cell, list[str]]:
    """The cards of each solved frame of a chunk: one text, or of a plate one for each exposure, in order."""
    found: dict[Cell, list[str]] = {}
    exposures = chunk / "exposures.parquet"
    table = exposures if exposures.exists() else chunk / "solutions.parquet"
    for row in read_rows(table, ["number", "wcs"]):
        found.setdefault(row["number"], []).append(str(row["wcs"]))
    return found


def _content(wcs: dict[str, str | int | float], kind: Kind, run: str, file: str, extension: Cell) -> bytes:
    """A file of this kind. Raises `BadRequest` where it has no words for the lens."""
    if kind == "gwcs":
        return asdf_bytes(wcs, {"run": run, "file": file, "extension": extension})
    hdu = None if extension is None else str(extension)
    written = wcs if kind == "sip" else tpv_cards(wcs)
    return _header(written, file, int(hdu) if hdu is not None and hdu.isdecimal() else hdu, run)


def _header(cards: dict[str, str | int | float], file: str, hdu: int | str | None, run: str) -> bytes:
    """The header, with the frame's other cards where it is a FITS file here that can still be read."""
    history = [f"WCS by mountnav, run {run} of its archive"]
    if not is_remote(file):
        try:
            with open_plain(Path(file)) as opened:
                return wcs_header(cards, frame=OnDisk(opened), hdu=hdu, history=history, name=file)
        except (OSError, BadFrame):
            pass  # moved away since, or no image any more: its place in the sky is known all the same
    return wcs_header(cards, history=history, name=file)
