"""What is given to the solver, and how its pixels get to another process with one copy."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from io import FileIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from api.solver.solver_answers import Done
from api.solver.solver_link import ProcessEnded
from api.solver.solver_messages import SharedFile, SharedPixels
from mountnav.frames import Frame, Hint
from mountnav.reading.content import OnDisk, stored
from mountnav.reading.fits_extensions import MOST_PIXELS
from mountnav.solving.settings import SolveSettings

_BRIGHTNESS = re.compile(r"[<>|][iu][1248]|[<>][f][48]")
"""Kinds of numbers that a frame's pixels are (`mountnav.frames.Frame`)."""


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


@dataclass(frozen=True, slots=True)
class Reading:
    """An upload to read, not to solve."""

    source: Upload


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


def empty_file() -> int:
    """A file without a name, for the other process to fill."""
    return os.memfd_create("mountnav-pixels")


def pixels_in(file: int, told: Done) -> NDArray[np.generic]:
    """The pixels that the other process wrote; copied, for it still holds the file.

    Raises
    ------
    ProcessEnded
        They are none, or not as many as it told.
    """
    if not _BRIGHTNESS.fullmatch(told.dtype) or len(told.shape) != 2 or min(told.shape) < 1:
        raise ProcessEnded(f"the solver read pixels of the kind {told.dtype[:20]} and shape {told.shape}")
    count = told.shape[0] * told.shape[1]
    kind = np.dtype(told.dtype)
    with FileIO(file, closefd=False) as opened:
        content = OnDisk(opened)
        if count > MOST_PIXELS or len(content) != count * kind.itemsize:
            raise ProcessEnded(f"the solver told of {count} pixels and left {len(content)} bytes")
        try:
            return stored(content, kind, count, 0).reshape(told.shape)
        except EOFError as fault:
            raise ProcessEnded("the solver took pixels back") from fault
