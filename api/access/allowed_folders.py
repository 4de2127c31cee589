"""Files of this machine that callers may name: those in folders that the settings allow, links followed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mountnav.errors import BadRequest, Unknown


def allowed_file(path: Path, folders: Sequence[Path], *, telescope_id: str) -> Path:
    """The file, if it lies in one of the folders.

    Parameters
    ----------
    path : Path
    folders : sequence of Path
    telescope_id : str
        Whose settings they are of, for the message.

    Raises
    ------
    BadRequest
        It doesn't; links out of a folder don't count.
    Unknown
        There is no such file.
    """
    try:
        real = path.resolve()
        inside = any(real.is_relative_to(folder.resolve()) for folder in folders)
        there = inside and real.is_file()
    except (OSError, ValueError) as odd:  # a name with a zero byte, a loop of links
        raise BadRequest("that path is none", device=telescope_id, advice=str(odd)) from odd
    if not inside:
        raise BadRequest(
            f"{path} lies in no folder that frames may be taken from",
            device=telescope_id,
            advice="set night.folder or night.allowed_folders",
        )
    if not there:
        raise Unknown(f"there is no file {path}", device=telescope_id, advice="look at its name")
    return real


__all__ = ["allowed_file"]
