"""A packed file, opened: header and sections mapped into memory, the small ones checked."""

from __future__ import annotations

import hashlib
import mmap
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import (
    CLASS,
    COARSE_NSIDE,
    COLOR,
    FLAG,
    LONGEST_HEADER_BYTES,
    OFFSET,
    PREAMBLE_BYTES,
    STAR,
    TOP,
    Header,
    decode_header,
    malformed,
)
from mountnav.catalog.packed.pixels import Runs
from mountnav.errors import BadSettings
from mountnav.files import open_buffered

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LARGE_BYTES = 1 << 28
"""From this size on a file is mapped twice: without reading ahead for narrow cones, which need a few pages
here and there, and with it for wide ones. On 113 million stars a cold cone of 0.3° takes 3 ms instead of 50,
one of 20° to magnitude 12 takes 0.2 s instead of 0.9."""
_BLOCK_BYTES = 1 << 20
"""Read at a time for the check of a whole file; chosen by hand, for speed alone."""


@dataclass(frozen=True, slots=True)
class PackedFile:
    """Sections of a packed file, mapped, not read.

    Attributes
    ----------
    start
        Where the sections begin, bytes.
    offsets
        First star of each pixel, and the count.
    coarse
        The same for pixels of at most nside 64.
    tops
        Raw magnitude of the brightest star of each pixel; None in version 1.
    classes
        Shape (k, 3), float64: sigma [mas], its mean epoch [yr], sigma of the proper motion [mas/yr].
    fast, stars
        Records.
    color, flags
        None if the file has none.
    """

    path: Path
    header: Header
    start: int
    offsets: NDArray[np.uint32]
    coarse: NDArray[np.uint32]
    tops: NDArray[np.uint16] | None
    classes: Array
    fast: NDArray[np.void]
    stars: NDArray[np.void]
    color: NDArray[np.int16] | None
    flags: NDArray[np.uint8] | None

    @classmethod
    def open(cls, path: Path) -> tuple[PackedFile, PackedFile]:
        """Map a file.

        Returns
        -------
        (PackedFile, PackedFile)
            For narrow looks and for wide ones: the same, unless the file is large.

        Raises
        ------
        BadSettings
            It can't be opened; `BadCatalog`: it is truncated or malformed; tells the offset.
        """
        try:
            with open_buffered(path) as file:
                header, start = decode_header(
                    file.read(PREAMBLE_BYTES + LONGEST_HEADER_BYTES), file=str(path)
                )
                size = os.fstat(file.fileno()).st_size
                expected = start + header.layout()["end"][0]
                if size != expected:
                    raise malformed(str(path), min(size, expected), f"{expected} bytes in all", f"{size}")
                narrow = cls._view(path, header, start, _mapped(file, read_ahead=size < LARGE_BYTES))
                narrow._require_sound()
                if size < LARGE_BYTES:
                    return narrow, narrow
                return narrow, cls._view(path, header, start, _mapped(file, read_ahead=True))
        except OSError as refused:
            raise BadSettings(
                f"can't be opened: {refused.strerror}",
                device=str(path),
                advice="check the catalog's path and rights",
            ) from refused

    @classmethod
    def _view(cls, path: Path, header: Header, start: int, mapped: mmap.mmap) -> PackedFile:
        layout = header.layout()

        def section(name: str, dtype: np.dtype[Any]) -> NDArray[Any]:
            at, length = layout[name]
            return np.frombuffer(mapped, dtype=dtype, count=length // dtype.itemsize, offset=start + at)

        offsets = section("offsets", OFFSET)
        return cls(
            path=path,
            header=header,
            start=start,
            offsets=offsets,
            coarse=section("coarse", OFFSET) if "coarse" in layout else _coarse(offsets, header.nside),
            tops=section("tops", TOP) if "tops" in layout else None,
            classes=section("classes", CLASS).astype(np.float64).reshape(-1, 3),
            fast=section("fast", header.fast_dtype),
            stars=section("stars", STAR),
            color=section("color", COLOR) if "color" in layout else None,
            flags=section("flags", FLAG) if "flags" in layout else None,
        )

    def stars_of(self, pixels: Runs) -> Runs:
        """Rows of the stars of some pixels, a run for each run of pixels.

        Raises
        ------
        BadCatalog
            The table of pixels is damaged there.
        """
        first = self.offsets[pixels.first].astype(np.int64)
        end = self.offsets[pixels.end].astype(np.int64)
        rising = np.stack([first, end], axis=1).ravel()
        if rising.size and (bool(np.any(np.diff(rising) < 0)) or rising[-1] > self.header.count):
            raise self.malformed_section("offsets", "an offset table that rises", "one that falls")
        return Runs(first, end)

    def malformed_section(self, section: str, expected: str, found: str) -> BadSettings:
        """Make the error that a section is not as it must be."""
        return malformed(str(self.path), self.start + self.header.layout()[section][0], expected, found)

    def verify(self, sha256: str | None, tell: Callable[[float], None]) -> None:
        """Read the whole file and compare its hashes; then the tables as a whole.

        Parameters
        ----------
        sha256 : str or None
            What the whole file's hash must be.
        tell : callable
            Told the share that is read.

        Raises
        ------
        BadCatalog
            A hash differs; tells the section (version 2), its offset, what was expected and found.
        """
        whole = hashlib.sha256()
        sections = self._hashed_pieces()
        digests = {name: hashlib.sha256() for name, _ in sections if name}
        total, done = sum(length for _, length in sections), 0
        with open_buffered(self.path) as file:
            for name, length in sections:
                left = length
                while left and (block := file.read(min(left, _BLOCK_BYTES))):
                    if sha256 is not None:
                        whole.update(block)
                    if name:
                        digests[name].update(block)
                    elif name is None and any(block):
                        at = file.tell() - len(block)
                        raise malformed(str(self.path), at, "zeros between two sections", "other bytes")
                    left -= len(block)
                    done += len(block)
                    tell(done / total)
        expected = self.header.section_sha256 or {"all": self.header.sections_sha256}
        for name, digest in digests.items():
            if digest.hexdigest() != expected[name]:
                at = 0 if name == "all" else self.header.layout()[name][0]
                raise malformed(
                    str(self.path),
                    self.start + at,
                    f"section {name} of sha256 {expected[name]}",
                    digest.hexdigest(),
                )
        if sha256 is not None and whole.hexdigest() != sha256:
            raise malformed(str(self.path), 0, f"a file of sha256 {sha256}", whole.hexdigest())
        self._require_rising()

    def _hashed_pieces(self) -> list[tuple[str | None, int]]:
        """What the file consists of: "" for the header, None for the gaps, names for the sections."""
        layout = self.header.layout()
        end = layout.pop("end")[0]
        if self.header.version == 1:
            return [("", self.start), ("all", end)]
        pieces: list[tuple[str | None, int]] = [("", self.start)]
        at = 0
        for name, (begin, length) in layout.items():
            pieces += [(None, begin - at), (name, length)]
            at = begin + length
        return pieces

    def _require_sound(self) -> None:
        """Check the small sections; the stars themselves are checked by `verify` on demand."""
        header = self.header
        ends = self.coarse[[0, -1]].tolist() + self.offsets[[0, -1]].tolist()
        if ends != [0, header.count] * 2 or bool(np.any(self.coarse[1:] < self.coarse[:-1])):
            raise self.malformed_section(
                "offsets", f"an offset table rising from 0 to {header.count}", f"{ends[2]} to {ends[3]}"
            )
        if header.nside <= COARSE_NSIDE or header.version == 1:
            self._require_rising()
        if not np.all(np.isfinite(self.classes)) or bool(np.any(self.classes < 0.0)):
            raise self.malformed_section("classes", "finite error classes, none negative", "others")
        fast = self.fast["star"]
        if bool(np.any(fast[1:] <= fast[:-1])) or bool(np.any(fast >= header.count)):
            raise self.malformed_section("fast", "rising star numbers below the count", "others")

    def _require_rising(self) -> None:
        if bool(np.any(self.offsets[1:] < self.offsets[:-1])):
            raise self.malformed_section(
                "offsets", f"an offset table rising from 0 to {self.header.count}", "one that falls"
            )


def _coarse(offsets: NDArray[np.uint32], nside: int) -> NDArray[np.uint32]:
    return offsets[:: (nside // COARSE_NSIDE) ** 2] if nside > COARSE_NSIDE else offsets


def _mapped(file: BinaryIO, *, read_ahead: bool) -> mmap.mmap:
    whole = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    if not read_ahead and hasattr(mmap, "MADV_RANDOM"):  # not known everywhere
        with suppress(OSError):
            whole.madvise(mmap.MADV_RANDOM)
    return whole
