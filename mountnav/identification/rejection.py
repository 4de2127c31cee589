"""Candidates that must not hold a plate, by the rule that forbids them [S23 §3.2, eq. 21-23]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.measuring.measurements import Flag

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

BY_FLAG = {"no peak": Flag.NO_PEAK, "trail": Flag.TRAIL, "bleed": Flag.BLEED, "edge": Flag.EDGE}
STAR_GROUP = "star group"
MEASUREMENT_GROUP = "measurement group"
DEVIATION = "deviation"
RULES = (*BY_FLAG, STAR_GROUP, MEASUREMENT_GROUP, DEVIATION)
"""Names of all rules, in the order in which they are asked: a candidate counts for the first that hits."""


def grouped(x_px: Array, y_px: Array, magnitude: Array, radius_px: float, depth_mag: float) -> Mask:
    """Points in a tight group: with a neighbor within the radius that is not fainter by `depth_mag`.

    Parameters
    ----------
    x_px, y_px, magnitude : ndarray, shape (n,)
    radius_px : float
        r_star_group or r_mea_group.
    depth_mag : float

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    if x_px.size < 2:
        return np.zeros(x_px.size, dtype=bool)
    close = cKDTree(np.column_stack((x_px, y_px))).query_pairs(radius_px, output_type="ndarray")
    return in_groups(close, x_px, y_px, magnitude, radius_px, depth_mag)


def in_groups(
    close: Index, x_px: Array, y_px: Array, magnitude: Array, radius_px: float, depth_mag: float
) -> Mask:
    """`grouped`, when it is known which points may be close.

    Parameters
    ----------
    close : ndarray of int, shape (k, 2)
        All couples of points within the radius, and perhaps some others.
    x_px, y_px, magnitude, radius_px, depth_mag
        As of `grouped`.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    inside = np.zeros(x_px.size, dtype=bool)
    a, b = close.T
    near = np.flatnonzero((x_px[a] - x_px[b]) ** 2 + (y_px[a] - y_px[b]) ** 2 <= radius_px**2)
    a, b = a[near], b[near]
    inside[a[magnitude[b] < magnitude[a] + depth_mag]] = True
    inside[b[magnitude[a] < magnitude[b] + depth_mag]] = True
    return inside


def within_k_rej(deviation: Array, k_rej: float) -> Mask:
    """Pairs whose deviation is at most K_rej times the mean deviation modulus [S23 eq. 21-23].

    Parameters
    ----------
    deviation : ndarray, shape (n,)
        Moduli Δ_αδ, any unit.
    k_rej : float

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    kept: Mask = deviation <= k_rej * float(deviation.mean())
    return kept
