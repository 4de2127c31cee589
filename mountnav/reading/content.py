"""What a file holds, asked for piece by piece: bytes in memory, or a file on disk.

A file is read, never mapped: the camera may still be writing it, and a file that shrinks while it is mapped
kills the whole process (SIGBUS). Reading 18.7 MB costs 2 ms where the memory for it is in use already.
"""

from __future__ import annotations

import os
from io import FileIO

import numpy as np
from numpy.typing import NDArray


class OnDisk:
    """A regular file, open for reading; its length is what it was when it was opened.

    Parameters
    ----------
    file : FileIO
        Unbuffered; belongs to the caller.
    """

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self._length = os.fstat(file.fileno()).st_size

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, piece: slice) -> bytes:
        """Read a piece; like that of bytes, it is shorter where the file ends before."""
        start, end, step = piece.indices(self._length)
        if step != 1:
            raise ValueError("pieces are read as they lie")
        self._file.seek(start)
        parts, left = [], max(0, end - start)
        while left and (part := self._file.read(left)):
            parts.append(part)
            left -= len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def fill(self, wanted: NDArray[np.generic], start: int) -> None:
        """Read numbers straight into an array.

        Raises
        ------
        EOFError
            The file has become shorter meanwhile.
        """
        left = wanted.reshape(-1).view(np.uint8).data
        self._file.seek(start)
        while left:
            count = self._file.readinto(left)
            if not count:
                raise EOFError(f"{len(left)} bytes are missing")
            left = left[count:]


Content = bytes | bytearray | OnDisk


def stored(content: Content, kind: np.dtype[np.generic], count: int, start: int) -> NDArray[np.generic]:
    """Numbers as a file holds them.

    Parameters
    ----------
    content : bytes, bytearray or OnDisk
        The file, in memory or where it lies on disk.
    kind : dtype
        With its byte order.
    count, start : int
        How many, and from which byte on.

    Returns
    -------
    ndarray, shape (count,)
        A view of what is in memory, or freshly read.

    Raises
    ------
    EOFError
        The file has become shorter meanwhile.
    """
    if not isinstance(content, OnDisk):
        return np.frombuffer(content, kind, count=count, offset=start)
    numbers = np.empty(count, kind)
    content.fill(numbers, start)
    return numbers
