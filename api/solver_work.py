"""What is given to the solver, and how its pixels get to another process with one copy."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from api.solver_messages import SharedFile, SharedPixels
from mountnav.frames import Frame, Hint
from mountnav.solve_settings import SolveSettings


@dataclass(frozen=True, slots=True)
class Upload:
    """A file as it came.

    Attributes
    ----------
    name : str
    file : int
        An open descriptor; whoever made the upload closes it.
    """

    name: str
    file: int


@dataclass(frozen=True, slots=True)
class Work:
    """One frame or upload to solve, with the index for a blind search, if there is one."""

    source: Frame | Upload
    hint: Hint | None
    settings: SolveSettings
    index: Path | None = None


def described(source: Frame | Upload) -> SharedPixels | SharedFile:
    """The source as it is sent: without what lies in the file that goes with it."""
    if isinstance(source, Upload):
        return SharedFile(source.name)
    pixels = source.pixels
    bare = replace(source, pixels=np.empty((0, 0), pixels.dtype))
    return SharedPixels(bare, pixels.dtype.str, pixels.shape)


def in_memory(pixels: NDArray[np.generic]) -> int:
    """Copy pixels into a file without a name, which lives as long as one of the two processes holds it."""
    plain = np.ascontiguousarray(pixels)
    file = os.memfd_create("mountnav-frame")
    try:
        left = plain.reshape(-1).view(np.uint8).data
        while left:
            left = left[os.write(file, left) :]
    except BaseException:
        os.close(file)
        raise
    return file
