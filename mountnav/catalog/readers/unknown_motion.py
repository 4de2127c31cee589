"""How far a star without a known proper motion may have moved: its sigma grows by the motion of its like."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MAG = (4.5, 5.5, 6.5, 7.5, 8.5, 9.5, 10.5, 11.5, 12.5)
_MAS_YR = (47.0, 38.0, 29.0, 22.5, 17.4, 13.9, 11.6, 10.8, 10.5)
"""68.3 % of the Tycho-2 stars of that magnitude move less, per coordinate (tools/build_tycho2.py). Fainter
stars move less than the last ones, so theirs is a cautious figure."""


def unknown_motion_mas_yr(mag: Array) -> Array:
    """Typical proper motion per coordinate, to stand in for the error of an unknown one.

    Parameters
    ----------
    mag : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
        mas/yr.
    """
    return np.interp(mag, _MAG, _MAS_YR)
