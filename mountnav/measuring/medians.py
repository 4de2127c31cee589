"""Medians without what numpy's do besides: a solve takes some 90 of them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FEW = 1500
"""Up to so many values numpy selects three of them in one go as fast as one after another. Doubled or halved,
a median takes some microseconds more or less."""


def median(values: NDArray[np.floating] | NDArray[np.integer]) -> float:
    """As `numpy.median` of all values: a fifth of its time for some hundred numbers, the same result.

    Returns
    -------
    float
        NaN where any is NaN, and of no values.
    """
    ordered = np.array(values).ravel()
    if ordered.size == 0:
        return math.nan
    middle = ordered.size // 2
    if ordered.size > FEW:
        return _of_many(ordered, middle)
    below = middle - 1 if ordered.size % 2 == 0 else middle
    # NaN comes last
    ordered.partition((below, middle, ordered.size - 1))
    low, high, last = ordered[below], ordered[middle], ordered[-1]
    if last != last:
        return math.nan
    if below == middle:
        return float(high)
    if ordered.dtype.kind == "f":
        return float((low + high) * ordered.dtype.type(0.5))
    return 0.5 * (float(low) + float(high))


def medians_of_rows(rows: NDArray[np.floating]) -> NDArray[np.floating]:
    """As `numpy.median` along the last axis, in a tenth of its time for rows of some dozen numbers.

    Parameters
    ----------
    rows : ndarray, shape (n, m)
        m at least 1.

    Returns
    -------
    ndarray, shape (n,)
        NaN where any of a row is NaN.
    """
    ordered = np.sort(rows, axis=1)  # NaN comes last
    middle, odd = divmod(rows.shape[1], 2)
    half = ordered.dtype.type(0.5)
    found = ordered[:, middle] if odd else (ordered[:, middle - 1] + ordered[:, middle]) * half
    return np.asarray(np.where(np.isnan(ordered[:, -1]), ordered[:, -1], found))


def _of_many(values: NDArray[np.floating] | NDArray[np.integer], middle: int) -> float:
    """The same for many, which it puts in another order.

    numpy selects a single value by vector instructions where the processor has them, and several in one go
    without: this takes a tenth of the time.
    """
    values.partition(middle)
    last = values[middle:].max()
    if last != last:
        return math.nan
    high = values[middle]
    if values.size % 2:
        return float(high)
    low = values[:middle].max()
    if values.dtype.kind == "f":
        return float((low + high) * values.dtype.type(0.5))
    return 0.5 * (float(low) + float(high))
