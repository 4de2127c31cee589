"""File names as they can be shown: any bytes are allowed on a disk, not so in JSON or on a terminal."""

from __future__ import annotations

import os
from pathlib import Path


def shown(path: Path) -> str:
    """Return a path as text without undecodable bytes and control characters.

    Returns
    -------
    str
        Printable; equal to ``str(path)`` for ordinary names.
    """
    text = os.fsencode(path).decode("utf-8", "replace")
    return "".join(
        character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text
    )
