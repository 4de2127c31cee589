"""Which of many positions lies nearest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree


def nearest(
    among: NDArray[np.float64 | np.int64], to: NDArray[np.float64 | np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """How far from each position (rows of x, y) the nearest of others lies, and its index."""
    distance, index = KDTree(among).query(to)
    return np.asarray(distance, dtype=np.float64), np.asarray(index, dtype=np.int64)
