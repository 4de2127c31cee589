"""Whether work grows with its input or with its square, told by two sizes; machines differ, ratios don't."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

LINEAR = 9.0
"""For four times the input: linear work takes four times as long, the square of it sixteen."""


def growth(make: Callable[[int], T], do: Callable[[T], object], size: int) -> float:
    """How many times as much CPU time an input of four times the size takes; the least of three runs each."""

    def least_s(given: T) -> float:
        times = []
        for _ in range(3):
            begun_s = time.process_time()
            do(given)
            times.append(time.process_time() - begun_s)
        return min(times)

    return least_s(make(4 * size)) / least_s(make(size))
