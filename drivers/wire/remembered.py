"""The last of what came, each thing by its number since the beginning: what runs for days stays small."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import SupportsIndex, TypeVar, overload

T = TypeVar("T")
_MOST = 20_000


class Remembered(Sequence[T]):
    """A sequence that forgets its oldest; what is left keeps its number.

    Parameters
    ----------
    things : iterable
        The first ones.
    most : int
        How many are kept.
    """

    def __init__(self, things: Iterable[T] = (), *, most: int = _MOST) -> None:
        self._kept: deque[T] = deque(maxlen=most)
        self._count = 0
        for thing in things:
            self.append(thing)

    def append(self, thing: T) -> None:
        """Keep one more; the oldest is forgotten where there are too many."""
        self._kept.append(thing)
        self._count += 1

    def clear(self) -> None:
        """Forget all, and number from the beginning again."""
        self._kept.clear()
        self._count = 0

    def __len__(self) -> int:
        """How many came, those that are forgotten too."""
        return self._count

    def __iter__(self) -> Iterator[T]:
        """Those that are kept, oldest first."""
        return iter(tuple(self._kept))

    @overload
    def __getitem__(self, index: SupportsIndex) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> list[T]: ...
    def __getitem__(self, index: SupportsIndex | slice) -> T | list[T]:
        """Things by their numbers.

        Raises
        ------
        IndexError
            If there is no such thing, or it (for a slice: its first) is forgotten.
        """
        forgotten = self._count - len(self._kept)
        if not isinstance(index, slice):
            at = index.__index__()
            at += self._count if at < 0 else 0
            if not forgotten <= at < self._count:
                raise IndexError(f"number {at} of {self._count}: there is none, or it is forgotten")
            return self._kept[at - forgotten]
        start, stop, step = index.indices(self._count)
        if step != 1:
            raise IndexError("only what came one after the other")
        if start < min(stop, forgotten):
            raise IndexError(f"number {start} of {self._count} is forgotten")
        return list(islice(tuple(self._kept), max(0, start - forgotten), max(0, stop - forgotten)))

    def __eq__(self, other: object) -> bool:
        """Equal to the same things in the same order, if none is forgotten."""
        if not isinstance(other, (Remembered, list, tuple)):
            return NotImplemented
        return len(self) == len(other) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """As a list's."""
        return repr(list(self._kept))
