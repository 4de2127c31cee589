"""What an import was begun with: decides whether what it left behind fits, or a new start is needed."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mountnav.catalog.readers import Part
from mountnav.files import read_text
from mountnav.parsing import json_of

RECORD = "record.json"

Stamp = tuple[str, int, int]
"""A file as it is: path, size in bytes, time of the last change in ns."""


def stamp(part: Part) -> Stamp:
    """The file of a part as it is now.

    Raises
    ------
    OSError
        It isn't there, or can't be looked at.
    """
    there = part.path.stat()
    return str(part.path.absolute()), there.st_size, there.st_mtime_ns


@dataclass(frozen=True, slots=True)
class ImportRecord:
    """What is read, and how.

    Attributes
    ----------
    program : str
        Version of mountnav: another may read the same file otherwise.
    kind, selection, made_from : str
        Of the catalog, what of it is taken, and what the reader says it is made from.
    parts : mapping
        Name of each part to the `Stamp` of its file.
    """

    program: str
    kind: str
    selection: str
    made_from: str
    parts: Mapping[str, Stamp]

    @classmethod
    def of(
        cls, program: str, kind: str, selection: str, made_from: str, parts: Sequence[Part]
    ) -> ImportRecord:
        """The record of an import that begins now. Raises OSError if a file isn't there."""
        return cls(program, kind, selection, made_from, {part.name: stamp(part) for part in parts})

    def contradicts(self, earlier: ImportRecord, done: Collection[str]) -> str | None:
        """Why the parts that an earlier run brought in are of no use now.

        Parts that aren't in yet may have changed: a file that was found damaged is copied again, and then the
        import goes on.

        Parameters
        ----------
        earlier : ImportRecord
        done : collection of str
            Names of the parts that are in.

        Returns
        -------
        str or None
            None if they can stay.
        """
        if self.program != earlier.program:
            return f"the earlier run was made by mountnav {earlier.program}"
        if (self.kind, self.selection) != (earlier.kind, earlier.selection):
            return "the earlier run had other options"
        if self.made_from != earlier.made_from:
            return f"the earlier run read another catalog: {earlier.made_from}"
        for name in sorted(done):
            if name not in self.parts:
                return f"{name}, which is in, is no longer there"
            if self.parts[name] != tuple(earlier.parts.get(name, ())):
                return f"the file of {name}, which is in, is another now"
        return None

    def write(self, folder: Path) -> None:
        """Write it into the import's folder, whole or not at all."""
        new = folder / f"{RECORD}.new"
        with new.open("w", encoding="utf-8") as file:
            json.dump(asdict(self), file)
            file.flush()
            os.fsync(file.fileno())
        new.replace(folder / RECORD)

    @classmethod
    def read(cls, folder: Path) -> ImportRecord | None:
        """What lies in an import's folder; None if there is nothing, or nothing sound."""
        try:
            found = json_of(read_text(folder / RECORD))
            parts = {
                str(name): (str(path), int(size), int(changed))
                for name, (path, size, changed) in found["parts"].items()
            }
            program, kind, selection, made_from = (
                str(found[key]) for key in ("program", "kind", "selection", "made_from")
            )
            return cls(program, kind, selection, made_from, parts)
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            return None
