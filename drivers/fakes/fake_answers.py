"""Answers of a fake that are on their way: each in its time, none overtaking another, floods in between."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(slots=True)
class _Flood:
    """Bytes that come unasked until an instant."""

    data: bytes
    next_s: float
    end_s: float
    every_s: float


class Answers:
    """A queue of bytes with the instants at which they are said."""

    def __init__(self) -> None:
        self._late: list[tuple[float, bytes]] = []
        self._floods: list[_Flood] = []

    def add(self, answer: bytes, now_s: float, delay_s: float = 0.0, gap_s: float = 0.0) -> None:
        """Put an answer at the end.

        Parameters
        ----------
        answer : bytes
            None of it is fine.
        now_s : float
        delay_s : float
            It comes so much later; later still if one before it does.
        gap_s : float
            Between its bytes; 0 keeps them together.
        """
        due_s = max(now_s + delay_s, self._late[-1][0] if self._late else -math.inf)
        pieces = [answer] if gap_s <= 0.0 else [answer[i : i + 1] for i in range(len(answer))]
        for number, piece in enumerate(pieces):
            if piece:
                self._late.append((due_s + number * gap_s, piece))

    def flood(self, data: bytes, now_s: float, end_s: float, every_s: float) -> None:
        """Say `data` again and again, whatever else is said."""
        self._floods.append(_Flood(data, now_s, end_s, every_s))

    def clear(self) -> None:
        """Forget all of it."""
        self._late.clear()
        self._floods.clear()

    def dues(self) -> list[float]:
        """Instants of the next things to say."""
        return [due_s for due_s, _ in self._late[:1]] + [flood.next_s for flood in self._floods]

    def take(self, now_s: float) -> bytes:
        """Return what is said by now, once."""
        said: list[tuple[float, bytes]] = []
        ready = next((i for i, (due_s, _) in enumerate(self._late) if due_s > now_s), len(self._late))
        said += self._late[:ready]
        del self._late[:ready]
        for flood in self._floods:
            while flood.next_s <= min(now_s, flood.end_s):
                said.append((flood.next_s, flood.data))
                flood.next_s += flood.every_s
        self._floods = [flood for flood in self._floods if flood.next_s <= flood.end_s]
        # floods mix in by their instants; the sort keeps answers of one instant in their order
        return b"".join(piece for _, piece in sorted(said, key=lambda entry: entry[0]))
