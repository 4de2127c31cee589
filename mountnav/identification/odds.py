"""How probable it is that a match is chance. A solution is refused unless this says it can't be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

Array = NDArray[np.float64]


def at_least(hits: Array, trials: Array, chance: Array | float) -> Array:
    """Binomial tail: the probability of `hits` or more of `trials` when each succeeds with `chance`.

    Parameters
    ----------
    hits, trials : ndarray of numbers, shape (n,)
    chance : float or ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
        1 where no hit is asked for, 0 where more hits than trials are.
    """
    k = np.asarray(hits, dtype=float)
    n = np.asarray(trials, dtype=float)
    safe_k = np.clip(k, 1.0, np.maximum(n, 1.0))
    tail = betainc(safe_k, np.maximum(n - safe_k + 1.0, 1.0), chance)
    return np.asarray(np.where(k <= 0, 1.0, np.where(k > n, 0.0, tail)), dtype=float)


def area_share(
    x_px: Array, y_px: Array, radius_px: float, *, width_px: int, height_px: int, cells: int = 4
) -> Array:
    """Chance that a point falls within a radius of a measurement, for each of cells × cells parts.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        The measurements.
    radius_px : float
    width_px, height_px : int
        Size of the frame.
    cells : int

    Returns
    -------
    ndarray, shape (cells, cells)
        1 − exp(−density·π·radius²) with the density of the part or of the frame, whichever is more: stars
        of the catalog crowd where measurements crowd, and chance matches with them.
    """
    counts, _, _ = np.histogram2d(
        y_px, x_px, bins=cells, range=((-0.5, height_px - 0.5), (-0.5, width_px - 0.5))
    )
    per_part = width_px * height_px / cells**2
    density = np.maximum(counts, x_px.size / cells**2) / per_part
    share: Array = 1.0 - np.exp(-density * np.pi * radius_px**2)
    return share


def chance_at(share: Array, x_px: Array, y_px: Array, *, width_px: int, height_px: int) -> float:
    """Mean chance over predicted places.

    Parameters
    ----------
    share : ndarray, shape (cells, cells)
        From `area_share`.
    x_px, y_px : ndarray, shape (n,)
        Predicted places inside the frame.
    width_px, height_px : int

    Returns
    -------
    float
    """
    if x_px.size == 0:
        return 1.0
    cells = share.shape[0]
    column = np.clip(((x_px + 0.5) / width_px * cells).astype(int), 0, cells - 1)
    row = np.clip(((y_px + 0.5) / height_px * cells).astype(int), 0, cells - 1)
    return float(share[row, column].mean())
