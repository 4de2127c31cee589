"""The picture of a solved frame, from its file."""

from __future__ import annotations

from pathlib import Path

from api.annotated_picture import annotated_png
from mountnav.solution import Solution, Verdict


def annotated_file(path: Path, hdu: int | str | None, verdict: Verdict, solution: Solution) -> bytes:
    """Read a frame once more and draw it.

    Raises
    ------
    BadFrame
        It can't be read any more.
    """
    from api.http.file_names import shown
    from mountnav.reading import read_frame

    frame = read_frame(path, name=shown(Path(path.name)), hdu=hdu)
    return annotated_png(frame, verdict, solution)
