"""How probable it is that a match is chance. A solution is refused unless this says it can't be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
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


def _counts_in_parts(x_px: Array, y_px: Array, width_px: int, height_px: int, cells: int) -> Array:
    """How many points lie in each of cells × cells parts of the frame; shape (cells, cells), rows first."""
    column = np.floor((x_px + 0.5) * (cells / width_px)).astype(np.int64)
    row = np.floor((y_px + 0.5) * (cells / height_px)).astype(np.int64)
    inside = (column >= 0) & (column < cells) & (row >= 0) & (row < cells)
    counts = np.bincount((row * cells + column)[inside], minlength=cells**2)
    return counts.reshape(cells, cells).astype(float)


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
    counts = _counts_in_parts(x_px, y_px, width_px, height_px, cells)
    per_part = width_px * height_px / cells**2
    density = np.maximum(counts, x_px.size / cells**2) / per_part
    share: Array = 1.0 - np.exp(-density * np.pi * radius_px**2)
    return share


def density(
    x_px: Array,
    y_px: Array,
    at_x_px: Array,
    at_y_px: Array,
    *,
    width_px: int,
    height_px: int,
    cells: int = 4,
    neighbors: int = 6,
) -> Array:
    """How densely the measurements lie where a star is predicted; never less than in the whole frame.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        The measurements.
    at_x_px, at_y_px : ndarray, shape (k,)
        Predicted places inside the frame.
    width_px, height_px : int
    cells : int
        The frame is cut in cells × cells parts.
    neighbors : int
        The nearest so many measurements tell of a crowd that is smaller than a part: a cluster laid on
        another cluster makes many close pairs by chance.

    Returns
    -------
    ndarray, shape (k,)
        Measurements per square pixel: the most of the frame's mean, the part's, and the crowd's.
    """
    counts = _counts_in_parts(x_px, y_px, width_px, height_px, cells)
    column = np.clip(((at_x_px + 0.5) / width_px * cells).astype(int), 0, cells - 1)
    row = np.clip(((at_y_px + 0.5) / height_px * cells).astype(int), 0, cells - 1)
    per_part = width_px * height_px / cells**2
    dense: Array = np.maximum(counts[row, column], x_px.size / cells**2) / per_part
    if x_px.size >= neighbors and at_x_px.size:
        tree = cKDTree(np.column_stack((x_px, y_px)))
        away = np.asarray(tree.query(np.column_stack((at_x_px, at_y_px)), k=[neighbors])[0])[:, 0]
        # the nearest of all may be the very match that is judged; the others of the crowd tell its density
        dense = np.maximum(dense, (neighbors - 1) / (np.pi * np.maximum(away, 1.0) ** 2))
    return dense


def together(chances: Array) -> float:
    """Probability that chance brings so many so small uniform values [Berk & Jones 1979].

    The k-th smallest of n uniform values falls below p with the binomial probability of k or more successes
    in n trials of chance p. The least of these over all k is multiplied by n, the number of looks: neither a
    strobe nor the number of true pairs has to be known beforehand, and closer pairs count for more.

    Parameters
    ----------
    chances : ndarray, shape (n,)
        Each uniform, or larger, if the plate is wrong.

    Returns
    -------
    float
        At most 1; 1 for an empty array.
    """
    n = int(chances.size)
    if n == 0:
        return 1.0
    ranked = np.sort(np.clip(chances, 0.0, 1.0))
    k = np.arange(1, n + 1)
    tails = betainc(k, n - k + 1.0, ranked)
    return float(min(1.0, n * float(tails.min())))


def looks(hypotheses: int) -> float:
    """By what the chance of one hypothesis is multiplied when so many were tried, one after the other.

    A search that stops at the first hypothesis n with n·chance below a limit is fooled with up to
    limit·(1 + 1/2 + ... + 1/n), which grows with the search. With 2·n·(1 + ln n)² in place of n the sum stays
    below the limit however long the search: Σ 1/(n·(1 + ln n)²) < 2.

    Parameters
    ----------
    hypotheses : int

    Returns
    -------
    float
    """
    tried = max(hypotheses, 1)
    return float(2.0 * tried * (1.0 + np.log(tried)) ** 2)
