"""Stars that come twice, as overlapping extracts have them: the first one counts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ids = NDArray[np.int64]

MOST_REMEMBERED = 40_000_000
"""16 bytes each. Beyond them no more are remembered: downloads so large come from one query, or in the
archive's own files, which don't overlap."""
_MOST_CHUNKS = 2**12
_MOST_LISTS = 8


class Repeats:
    """Remembers which `source_id` came first in which chunk of which part.

    It can be asked about the chunks in any order, and again: the answer is always the same, as long as the
    parts before have been noted.
    """

    def __init__(self) -> None:
        self._lists: list[tuple[Ids, Ids]] = []
        self._count = 0
        self._noted: set[int] = set()

    def is_noted(self, part: int) -> bool:
        """Whether a part has been noted as a whole."""
        return part in self._noted

    def part_ends(self, part: int) -> None:
        """Take down that a part has been noted as a whole."""
        self._noted.add(part)

    def first_time(self, ids: Ids, part: int, chunk: int) -> NDArray[np.bool_]:
        """Tell which stars of a chunk haven't come in an earlier one, nor earlier in this one; note them.

        Parameters
        ----------
        ids : ndarray of int64, shape (n,)
            0 or less where there is none: such stars always count as new.
        part, chunk : int
            Numbers of the part, and of the chunk in it.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        now = part * _MOST_CHUNKS + min(chunk, _MOST_CHUNKS - 1)
        new = np.zeros(ids.size, dtype=np.bool_)
        new[np.unique(ids, return_index=True)[1]] = True
        new |= ids <= 0
        came = self._came(ids)
        known = came <= now
        new &= ~(came < now)
        if part not in self._noted and self._count < MOST_REMEMBERED:
            fresh = np.sort(ids[new & ~known & (ids > 0)])
            self._lists.append((fresh, np.full(fresh.size, now, dtype=np.int64)))
            self._count += fresh.size
            if len(self._lists) > _MOST_LISTS:
                self._merge()
        return new

    def _came(self, ids: Ids) -> Ids:
        """When each came first; a number beyond all others where it never did."""
        came = np.full(ids.size, np.iinfo(np.int64).max)
        for known, when in self._lists:
            if known.size and ids.size and known[0] <= ids.max() and ids.min() <= known[-1]:
                at = np.minimum(np.searchsorted(known, ids), known.size - 1)
                came = np.where(known[at] == ids, np.minimum(came, when[at]), came)
        return came

    def _merge(self) -> None:
        ids = np.concatenate([known for known, _ in self._lists])
        when = np.concatenate([when for _, when in self._lists])
        # of an id that was noted in two chunks asked for out of order, the earlier one counts
        order = np.lexsort((when, ids))
        ids, when = ids[order], when[order]
        first = np.ones(ids.size, dtype=np.bool_)
        first[1:] = ids[1:] != ids[:-1]
        self._lists = [(ids[first], when[first])]
