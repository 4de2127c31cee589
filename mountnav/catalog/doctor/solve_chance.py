"""How likely a frame is solved, by how many catalog stars it holds; and how many frames that fails."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SOLVED_SHARE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.82, 0.95, 0.985, 0.995, 0.999)
"""Share of frames solved with a good hint that hold 0, 1, 2, ... catalog stars within reach of the camera.

A tenth of the stars is taken not to be seen: blended, on a bad column, in a trail. With 5, 6, 7 stars seen
85, 98 and 100 % were solved of 1,180 drawn star lists of 1024 × 1024 pixels, with ten artifacts as bright as
the stars and five times as many fainter sources that are in no catalog (docs/catalog-doctor.md;
tests/catalog/test_doctor_solves.py draws some anew). Of 375 richer fields 374 were solved (docs/figures.md).
"""
SURE_STARS = len(SOLVED_SHARE)
"""With so many stars and more a frame counts as solved."""
WANTED_STARS = 8
"""So many are called enough in advice: 98 % of such frames are solved."""

_LOG_FACTORIALS = np.array([math.lgamma(n + 1.0) for n in range(SURE_STARS)])


def failing(counts: ArrayLike) -> Array:
    """Probability that a frame with so many catalog stars is not solved.

    Parameters
    ----------
    counts : array_like of int
        Stars in the frame that both catalog and camera reach.

    Returns
    -------
    ndarray
        0 to 1, of the same shape.
    """
    table = 1.0 - np.array((*SOLVED_SHARE, 1.0))
    return np.asarray(table[np.minimum(np.asarray(counts, dtype=np.int64), SURE_STARS)], dtype=np.float64)


def failing_on_mean(means: ArrayLike) -> Array:
    """Probability that a frame is not solved when only the expected number of its stars is known.

    Parameters
    ----------
    means : array_like
        Stars that are expected; the number itself is taken as Poisson's.

    Returns
    -------
    ndarray
        0 to 1, of the same shape.
    """
    mean = np.maximum(np.asarray(means, dtype=np.float64), 1e-12)[..., np.newaxis]
    few = np.arange(SURE_STARS)
    chances = np.exp(few * np.log(mean) - mean - _LOG_FACTORIALS)
    return np.asarray(chances @ (1.0 - np.array(SOLVED_SHARE)))
