"""A source that failed is left alone for a while: the next cones, of this solve or another, don't wait."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

FIRST_REST_S = 120.0
LONGEST_REST_S = 900.0


@dataclass(frozen=True, slots=True)
class Failure:
    """A source's last failure.

    Attributes
    ----------
    why : str
    until : float
        By `time.monotonic`: when it may be asked again.
    rest_s : float
        How long it rests; the next failure in a row doubles it.
    """

    why: str
    until: float
    rest_s: float

    @property
    def left_s(self) -> float:
        """How long it still rests."""
        return max(self.until - time.monotonic(), 0.0)


_failures: dict[str, Failure] = {}
_lock = threading.Lock()


def resting(key: str) -> Failure | None:
    """The failure for which a source still rests; None if it may be asked.

    Parameters
    ----------
    key : str
        Which source; known in the whole process.
    """
    with _lock:
        failure = _failures.get(key)
    return failure if failure is not None and failure.left_s > 0.0 else None


def failed(key: str, why: str) -> Failure:
    """Let a source rest: two minutes, after each further failure twice as long, at most 15 minutes."""
    with _lock:
        before = _failures.get(key)
        rest_s = FIRST_REST_S if before is None else min(2.0 * before.rest_s, LONGEST_REST_S)
        failure = _failures[key] = Failure(why, time.monotonic() + rest_s, rest_s)
    return failure


def answered(key: str) -> None:
    """The source works: forget its failures."""
    with _lock:
        _failures.pop(key, None)
