"""What the sky's turning doesn't hurry: the Earth's way round the Sun, precession and nutation, hour by hour.

To sum up the series of IAU 2000A and of the Earth's ephemeris takes four fifths of the time of a conversion
at a new instant, and their fastest term takes five days. They are summed up at full hours of terrestrial time
and drawn straight between two of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import floor
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_NODES_PER_DAY = 24
"""Full hours. Straight lines between them miss the nutation by 1.3e-5″ at most (its term of 13.7 days: 0.23″
times its rate squared times an hour squared by eight); twice as many, a quarter of that."""
_MJD_ZERO_JD = 2400000.5


@dataclass(frozen=True, slots=True)
class SlowParts:
    """The Earth's place and posture at an instant, as ERFA wants them.

    Attributes
    ----------
    barycentric : ndarray of erfa's dtype pv
        Place and velocity, au and au a day.
    heliocentric : ndarray, shape (3,)
        Place, au.
    matrix : ndarray, shape (3, 3)
        Bias, precession and nutation: from the ICRS to the true equator and equinox.
    s_rad : float
        The CIO locator.
    """

    barycentric: Any
    heliocentric: Array
    matrix: Array
    s_rad: float


@lru_cache(maxsize=64)
def _at_node(node: int) -> Array:
    """All of it at a full hour, in one row."""
    tt1, tt2 = _MJD_ZERO_JD + node // _NODES_PER_DAY, (node % _NODES_PER_DAY) / _NODES_PER_DAY
    heliocentric, barycentric = erfa.epv00(tt1, tt2)
    matrix = erfa.pnm06a(tt1, tt2)
    x, y = erfa.bpn2xy(matrix)
    s_rad = erfa.s06(tt1, tt2, x, y)
    return np.concatenate(
        (barycentric["p"], barycentric["v"], heliocentric["p"], matrix.ravel(), [float(s_rad)])
    )


def slow_parts(tt1: float, tt2: float) -> SlowParts:
    """The slow parts at an instant.

    Parameters
    ----------
    tt1, tt2 : float
        Terrestrial time as a two-part Julian date.

    Returns
    -------
    SlowParts
        Within 2e-5″ of what the series give.
    """
    at = ((tt1 - _MJD_ZERO_JD) + tt2) * _NODES_PER_DAY
    node = floor(at)
    before = _at_node(node)
    row = before + (at - node) * (_at_node(node + 1) - before)
    barycentric = np.empty((), dtype=erfa.dt_pv)
    barycentric["p"], barycentric["v"] = row[0:3], row[3:6]
    return SlowParts(barycentric, row[6:9], row[9:18].reshape(3, 3), float(row[18]))
