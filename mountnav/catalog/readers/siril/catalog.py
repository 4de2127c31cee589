"""Siril's astrometric catalog as parts: runs of pixels of its file or files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers import Part
from mountnav.catalog.readers.siril.layout import (
    HEAD,
    RELEASE_EPOCHS_YR,
    RELEASES,
    STAR,
    Head,
    checked_counts,
    parse_head,
)
from mountnav.catalog.readers.siril.stars import columns_of, pixels_dec_range_deg, require_sound
from mountnav.errors import BadCatalog
from mountnav.files import open_buffered

_LARGEST_PART = 500_000
_BZIP2_SUFFIX = ".bz2"


@dataclass(frozen=True, slots=True)
class _Run:
    """Neighboring pixels of one file: their numbers within the file, from `first` to before `end`."""

    first: int
    end: int


class SirilReader:
    """Reader of one catalog.

    The brightest 127 stars or fewer of each pixel of level 8 (0.05 square degrees), to G 20, with proper
    motions. The places went through 32-bit floats on their way into the file, which makes 32 mas of RA beyond
    256 degrees, 16 mas beyond 128, less elsewhere; sigma tells. Both proper motions 0 may mean "unknown": the
    star counts as one without.

    Parameters
    ----------
    files : dict
        The file, or all chunks, with their heads.
    """

    def __init__(self, files: dict[Path, Head]) -> None:
        self._files = dict(sorted(files.items(), key=lambda item: item[1].first_pixel))
        self._counts = {path: _counts(path, head) for path, head in self._files.items()}
        head = next(iter(self._files.values()))
        release = RELEASES[head.release]
        self.name = f"Siril Gaia {release}"
        self.band = "G"
        self.color_name = ""
        self.epoch_yr = RELEASE_EPOCHS_YR[head.release]
        stars = sum(int(counts[-1]) for counts in self._counts.values())
        self.made_from = f"{head.title} (Gaia {release}), {stars} stars"
        if head.chunk is not None:
            chunks = 12 * 4 ** head.chunk[0]
            self.made_from += f" in {len(self._files)} of {chunks} chunks of the sky"
        self._runs = dict(self._parts())

    def parts(self) -> Sequence[Part]:
        """Runs of pixels with at most some 500,000 stars, in the order of the files' pixels."""
        return [
            Part(name, path, int(self._counts[path][run.end] - self._counts[path][run.first]) * STAR.itemsize)
            for name, (path, run) in self._runs.items()
        ]

    def dec_range_deg(self, part: Part) -> tuple[float, float]:
        """Lowest and highest declination of the part's stars."""
        path, run = self._runs[part.name]
        head = self._files[path]
        return pixels_dec_range_deg(head.first_pixel + run.first, head.first_pixel + run.end, head.level)

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of a run of pixels.

        Raises
        ------
        BadCatalog
            A star doesn't lie in its pixel, or a number is out of its range.
        """
        path, run = self._runs[part.name]
        head, counts = self._files[path], self._counts[path]
        first, count = int(counts[run.first]), int(counts[run.end] - counts[run.first])
        offset = head.stars_at + first * STAR.itemsize
        with open_buffered(path) as file:
            file.seek(offset)
            content = file.read(count * STAR.itemsize)
        if len(content) != count * STAR.itemsize:
            raise BadCatalog(
                "it changed while it was read", device=path.name, advice="start the import again"
            )
        stars = np.frombuffer(content, dtype=STAR)
        pixel = np.repeat(
            np.arange(run.first, run.end) + head.first_pixel, np.diff(counts[run.first : run.end + 1])
        )
        for start in range(0, count, _LARGEST_PART):
            chosen = slice(start, start + _LARGEST_PART)
            at = offset + start * STAR.itemsize
            require_sound(stars[chosen], pixel[chosen], head.level, path.name, at)
            yield columns_of(stars[chosen], self.epoch_yr)

    def _parts(self) -> Iterator[tuple[str, tuple[Path, _Run]]]:
        for path, counts in self._counts.items():
            for run in _runs(counts):
                yield f"{path.name}/{run.first}", (path, run)


def open_catalog(path: Path) -> SirilReader:
    """Open a catalog of Siril's.

    Parameters
    ----------
    path : Path
        siril_cat_healpix8_astro.dat, or the folder that holds it or chunks of such a catalog.

    Returns
    -------
    SirilReader

    Raises
    ------
    BadCatalog
        No such file, a packed one, one of spectra, or chunks that don't belong together.
    """
    if not path.is_dir():
        return SirilReader({path: _head(path)})
    heads: dict[Path, Head] = {}
    refused: list[BadCatalog] = []
    for each in sorted(path.glob("*.dat")):
        try:
            heads[each] = _head(each)
        except BadCatalog as error:
            refused.append(error)
    if not heads:
        packed = sorted(each for each in path.glob("*.dat*") if each.suffix == _BZIP2_SUFFIX)
        if packed:
            raise BadCatalog(
                f"{packed[0].name} is still packed",
                device=str(path),
                advice=f"unpack it first: bunzip2 --keep {packed[0].name}",
            )
        if refused:
            raise refused[0]
        raise BadCatalog(
            "no file of Siril's Gaia catalog, such as siril_cat_healpix8_astro.dat",
            device=str(path),
            advice="name the file, or the folder it is in (Siril's preferences tell it)",
        )
    _require_one_catalog(heads)
    return SirilReader(heads)


def _require_one_catalog(heads: dict[Path, Head]) -> None:
    by_kind: dict[object, Path] = {}
    seen: dict[int, Path] = {}
    for path, head in heads.items():
        kind = (head.release, head.level, head.chunk[0] if head.chunk else None)
        by_kind.setdefault(kind, path)
        if head.first_pixel in seen or len(by_kind) > 1:
            other = seen.get(head.first_pixel, next(iter(by_kind.values())))
            raise BadCatalog(
                f"{other.name} and {path.name} don't belong to one catalog",
                device=str(path.parent),
                advice="name the file that is to be imported, or leave only its chunks in the folder",
            )
        seen[head.first_pixel] = path


def _head(path: Path) -> Head:
    with open_buffered(path) as file:
        return parse_head(file.read(HEAD.itemsize), path.name)


def _counts(path: Path, head: Head) -> NDArray[np.int64]:
    return checked_counts(np.memmap(path, dtype=np.uint8, mode="r"), head, path.name)


def _runs(counts: NDArray[np.int64]) -> Iterator[_Run]:
    """Runs of whole pixels with at most `_LARGEST_PART` stars; a pixel with more is a run of its own."""
    pixels = counts.size - 1
    first = 0
    while first < pixels:
        end = int(np.searchsorted(counts, counts[first] + _LARGEST_PART, side="right")) - 1
        end = min(max(end, first + 1), pixels)
        if counts[end] > counts[first]:
            yield _Run(first, end)
        first = end
