"""What a bug bundle is made of: names in it, and how it is read without trusting it."""

from __future__ import annotations

import json
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mountnav.errors import BadRequest
from mountnav.files import MOST_RECORD_BYTES, MOST_TEXT_BYTES

__all__ = ["FORM", "MANIFEST", "Bundle", "is_bundle", "open_bundle", "recording_name"]

FORM = "mountnav-bundle-1"
MANIFEST = "manifest.json"
_RECORDINGS = "recordings/"
_MOST_MEMBERS = 10_000
"""Files in a bundle at most; ours have some tens. Doubled, a listing of nonsense takes twice as long."""
_PIECE_BYTES = 1 << 20
"""Read at once, bytes."""


def recording_name(file: str) -> str:
    """Where in a bundle a recording is."""
    return _RECORDINGS + file


@dataclass(frozen=True, slots=True)
class Bundle:
    """What a bundle tells of itself.

    Attributes
    ----------
    recordings : dict of str to Path
        Nights that can be played, by their names; unpacked.
    """

    manifest: dict[str, Any]
    recordings: dict[str, Path]


def is_bundle(path: Path) -> bool:
    """Whether a file is a ZIP archive, as bundles are."""
    return path.is_file() and zipfile.is_zipfile(path)


@contextmanager
def open_bundle(path: Path) -> Iterator[Bundle]:
    """Read a bundle that anybody may have made; what is unpacked is gone afterwards.

    Raises
    ------
    BadRequest
        It is none, is damaged, or is larger than any of ours.
    """
    try:
        with (
            zipfile.ZipFile(path) as archive,
            tempfile.TemporaryDirectory(prefix="mountnav-bundle-") as folder,
        ):
            members = archive.infolist()
            if len(members) > _MOST_MEMBERS or MANIFEST not in archive.namelist():
                raise _none(path, "it has no manifest")
            manifest = json.loads(_read(archive, MANIFEST, MOST_TEXT_BYTES, path))
            if not isinstance(manifest, dict) or manifest.get("form") != FORM:
                raise _none(path, f"this version does not know its format ({FORM})")
            recordings: dict[str, Path] = {}
            left = MOST_RECORD_BYTES
            for member in members:
                if not member.filename.startswith(_RECORDINGS) or member.is_dir():
                    continue
                # never by its name: that is a stranger's
                target = Path(folder) / f"{len(recordings)}.jsonl"
                left -= _unpack(archive, member, target, left, path)
                recordings[member.filename[len(_RECORDINGS) :]] = target
            yield Bundle(manifest, recordings)
    except (zipfile.BadZipFile, zipfile.LargeZipFile, EOFError, RuntimeError, NotImplementedError) as damage:
        raise _none(path, f"it is damaged: {damage}") from damage
    except (ValueError, RecursionError) as damage:
        raise _none(path, f"its manifest is invalid: {damage}") from damage
    except OSError as wrong:
        raise BadRequest(f"the bundle can't be read: {wrong.strerror or wrong}", device=str(path)) from wrong


def _read(archive: zipfile.ZipFile, name: str, most_bytes: int, path: Path) -> bytes:
    with archive.open(name) as file:
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise _none(path, f"{name} is larger than any that mountnav writes")
    return data


def _unpack(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, target: Path, most_bytes: int, path: Path
) -> int:
    """Unpack one, counting what really comes; return its bytes."""
    size = 0
    with archive.open(member) as packed, target.open("wb") as file:
        while piece := packed.read(_PIECE_BYTES):
            size += len(piece)
            if size > most_bytes:
                raise _none(path, "its recordings are larger than any that mountnav writes")
            file.write(piece)
    return size


def _none(path: Path, why: str) -> BadRequest:
    return BadRequest(
        f"this is not a bundle of mountnav: {why}",
        device=str(path),
        advice="give a file that `mountnav report --bundle` has written",
    )
