"""Which frames are meant: files, folders, patterns, lists; and the extensions of a file."""

from __future__ import annotations

import codecs
import glob
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mountnav.errors import BadFrame, BadRequest

FRAME_SUFFIXES = (
    *(".fits", ".fit", ".fts", ".fits.fz", ".fit.fz", ".fz"),
    *(".fits.gz", ".fit.gz", ".fts.gz", ".fits.bz2", ".fit.bz2"),
    *(".xisf", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"),
    *(".cr2", ".cr3", ".nef", ".arw", ".dng"),
)
"""What is taken for a frame where only its folder is named, whatever the letters' case."""

MOST_LIST_BYTES = 500_000_000
"""Longest list of names that is read: five million of them. Doubled, a wrong file named as a list costs twice
as much memory."""

ALL_EXTENSIONS = "all"
"""The word for each image of a file, where an extension is asked for."""


@dataclass(frozen=True, slots=True)
class FrameFile:
    """One image to solve.

    Attributes
    ----------
    hdu : int or str or None
        Which extension; None: chosen by the reader.
    one_of_many : bool
        Other extensions of the same file are solved too.
    """

    path: Path
    hdu: int | str | None = None
    one_of_many: bool = False


def found_files(words: Sequence[Path], listed: str | None) -> list[Path]:
    """List the files that were named, in order.

    Parameters
    ----------
    words : sequence of Path
        Files, folders (all frames in them and below, by name), and patterns that no shell has spread.
    listed : str or None
        A file that names more of the same, one a line, or parted by zero bytes; "-" is the standard input.

    Returns
    -------
    list of Path
        A file that isn't there is listed too, so that it is missed when its turn comes.

    Raises
    ------
    BadRequest
        Nothing was named, a folder holds no frame, a pattern fits none, or the list can't be read.
    """
    every = [*words, *(_listed(listed) if listed is not None else ())]
    if not every:
        raise BadRequest("no frame was named", advice="name files, folders, patterns, or --list FILE")
    files: list[Path] = []
    for word in every:
        files += _spread(word)
    return files


def frames_of(path: Path, hdu: int | str | None) -> Iterator[FrameFile]:
    """The images of a file that are meant: one, or with "all" each of a FITS file's."""
    if hdu != ALL_EXTENSIONS:
        yield FrameFile(path, hdu)
        return
    numbers = _image_extensions(path)
    for number in numbers:
        yield FrameFile(path, number, one_of_many=len(numbers) > 1)


def stems(files: Sequence[Path]) -> dict[Path, str]:
    """How a file beside each frame begins: without its ending, where no other frame there has that name."""
    short = {path: path.with_name(stem(path.name)) for path in files}
    counts = Counter(short[path] for path in short)
    return {path: short[path].name if counts[short[path]] == 1 else path.name for path in short}


def stem(name: str) -> str:
    """A frame's name without its ending."""
    fitting = [
        suffix for suffix in FRAME_SUFFIXES if name.lower().endswith(suffix) and len(name) > len(suffix)
    ]
    return name[: -max(map(len, fitting))] if fitting else (name.rpartition(".")[0] or name)


def _listed(name: str) -> list[Path]:
    from mountnav.files import read_bytes

    try:
        if name == "-":
            content = sys.stdin.buffer.read(MOST_LIST_BYTES + 1)
            if len(content) > MOST_LIST_BYTES:
                raise BadRequest("the list on the standard input is too long", advice="part it")
        else:
            content = read_bytes(Path(name), MOST_LIST_BYTES)
    except OSError as error:
        raise BadRequest(
            f"--list {name}: {error.strerror or error}", advice="name a text file, or -"
        ) from error
    content = content.removeprefix(codecs.BOM_UTF8)
    parts = content.split(b"\0") if b"\0" in content else content.split(b"\n")
    return [Path(os.fsdecode(part.rstrip(b"\r"))) for part in parts if part.strip()]


def _spread(word: Path) -> list[Path]:
    """What a word means: itself, the frames of a folder, or what fits a pattern."""
    text = str(word)
    if word.is_dir():
        found = sorted(_frames_below(word))
        if not found:
            raise BadRequest(
                f"the folder {text} holds no frame", advice=f"looked for {', '.join(FRAME_SUFFIXES)}"
            )
        return found
    if os.path.lexists(word) or not glob.has_magic(text):
        return [word]
    found = []
    for name in sorted(glob.glob(text, recursive=True)):
        path = Path(name)
        found += sorted(_frames_below(path)) if path.is_dir() and not text.endswith("**") else []
        found += [] if path.is_dir() else [path]
    if not found:
        raise BadRequest(f"nothing fits the pattern {text}", advice="is it written right?")
    return found


def _frames_below(folder: Path) -> Iterator[Path]:
    for here, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in names:
            if name.lower().endswith(FRAME_SUFFIXES) and not name.startswith("."):
                yield Path(here) / name


def _image_extensions(path: Path) -> list[int | None]:
    """Numbers of the images in a FITS file; None alone for any other, and for what can't be read."""
    from mountnav.files import open_plain
    from mountnav.reading.content import OnDisk
    from mountnav.reading.fits_headers import science_images, walk
    from mountnav.reading.unpacking import unpacked

    try:
        with open_plain(path) as file:
            content = unpacked(OnDisk(file), path.name)
            if content[:6] != b"SIMPLE":
                return [None]
            return [unit.number for unit in science_images(walk(content, path.name))] or [None]
    except (OSError, BadFrame):
        return [None]  # its turn comes, and then it is told what is wrong with it
