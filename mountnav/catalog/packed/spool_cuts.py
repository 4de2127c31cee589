"""The sphere cut into pieces that fit into memory, and the stars of each in the order of the packed form."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.raw_stars import RAW, Raw, key_shift, sorted_order
from mountnav.catalog.packed.spool_parts import SpooledPart

Indices = NDArray[np.int64]

FIRST_CUT_NSIDE = 16
STARS_PER_PIXEL = 64
PIXELS_PER_STAR = 0.6
"""At most: so the tables of the pixels, 6 bytes each, stay well below the 15 bytes of each star."""
LARGEST_PACKED_NSIDE = 2048


def nside_for(count: int, sky_share: float = 1.0) -> int:
    """HEALPix resolution that suits a catalog: some dozen stars in a pixel.

    Measured in docs/packed-store.md: with fewer, wide cones spend their time on pixels; with more, narrow
    ones on stars outside.

    Parameters
    ----------
    count : int
        Stars.
    sky_share : float
        Which part of the sky they lie in.

    Returns
    -------
    int
        A power of two, 1 to 2048.
    """
    nside = 1
    while nside < LARGEST_PACKED_NSIDE:
        pixels = 12 * (2 * nside) ** 2
        if count < 0.5 * STARS_PER_PIXEL * pixels * sky_share or pixels > PIXELS_PER_STAR * count:
            break
        nside *= 2
    return nside


@dataclass(frozen=True, slots=True)
class Cut:
    """The sphere cut into pieces: keys at the cuts, and how many stars of each run lie before each.

    Attributes
    ----------
    keys
        Shape (m,), from 0 to one past the largest.
    before
        For each part, shape (runs, m).
    """

    keys: Indices
    before: list[Indices]

    @classmethod
    def of(cls, parts: list[SpooledPart], nside: int) -> Cut:
        """At all pixels of a resolution."""
        return cls.at(parts, np.arange(12 * nside**2 + 1) << key_shift(nside))

    @classmethod
    def at(cls, parts: list[SpooledPart], keys: Indices) -> Cut:
        """At some keys."""
        return cls(keys, [part.boundaries(keys) for part in parts])

    @property
    def counts(self) -> Indices:
        """Stars in each piece, shape (m - 1,)."""
        counts: Indices = np.diff(np.sum([own.sum(axis=0) for own in self.before], axis=0))
        return counts

    def only(self, chosen: Indices) -> Cut:
        """Fewer cuts."""
        return Cut(self.keys[chosen], [own[:, chosen] for own in self.before])


def sorted_pieces(
    parts: list[SpooledPart], coarse: Cut, nside: int, stars_at_once: int
) -> Iterator[tuple[int, Raw]]:
    """Collect, sort and give the stars piece by piece.

    Parameters
    ----------
    parts : list of SpooledPart
    coarse : Cut
        At the pixels of `FIRST_CUT_NSIDE`.
    nside : int
        Of the packed file; no pixel of it is cut.
    stars_at_once : int
        How many a piece may hold, unless one pixel holds more.

    Yields
    ------
    (int, ndarray of RAW)
        One past the last pixel of the piece, and its stars in the order of the packed form.

    Raises
    ------
    OSError
        A part can't be read.
    """
    shift = key_shift(nside)
    cut = coarse if nside >= FIRST_CUT_NSIDE else Cut.of(parts, nside)
    # pieces with too many stars are cut into four, until they are single pixels
    while True:
        size, counts = np.diff(cut.keys), cut.counts
        crowded = np.flatnonzero((counts > stars_at_once) & (size > 1 << shift))
        if not crowded.size:
            break
        quarters = (cut.keys[crowded, np.newaxis] + size[crowded, np.newaxis] // 4 * np.arange(1, 4)).ravel()
        cut = Cut.at(parts, np.union1d(cut.keys, quarters))
    cut = cut.only(_full_cuts(counts, stars_at_once))
    for at in range(cut.keys.size - 1):
        found = [
            raw
            for part, before in zip(parts, cut.before, strict=True)
            for raw in part.stars(before[:, at], before[:, at + 1])
        ]
        raw = np.concatenate(found) if found else np.zeros(0, dtype=RAW)
        found.clear()
        yield int(cut.keys[at + 1] >> shift), raw[sorted_order(raw, nside)]


def _full_cuts(counts: Indices, most: int) -> Indices:
    """Which cuts to keep so that the pieces are as large as may be."""
    kept, held = [0], 0
    for at, count in enumerate(counts.tolist()):
        if held and held + count > most:
            kept.append(at)
            held = 0
        held += count
    return np.array([*kept, counts.size])
