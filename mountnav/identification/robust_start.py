"""First plate from pairs of which many may be wrong: the similarity that the better half agrees on best.

Least squares over all pairs fails here: at the first, wide strobe a third of the pairs may be chance. The
least trimmed squares estimate [Rousseeuw & Van Driessen 2006, FAST-LTS] stands as long as more than half are
right.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

DRAWS = 150
MOST_PAIRS = 300
"""More pairs than this tell nothing more about the start."""
STEPS = 8
TURN_MOST = 0.1
"""A draw that changes scale or rotation by more than this share is a slip: the triangle's plate is better."""
SEED = 20230511


def trimmed_similarity(z: Complex, w: Complex) -> tuple[complex, complex]:
    """Fit w = turn·z + shift to the better half of points.

    Parameters
    ----------
    z, w : ndarray of complex, shape (n,)
        Places that the two should map on each other: nearly the same, but for the wrong pairs.

    Returns
    -------
    turn, shift : complex
        Independent of the order of the points; 1 and 0 when there are fewer than three.
    """
    count = z.size
    if count < 3:
        return 1.0 + 0.0j, 0.0j
    # by distance from the middle: the same draws however the points are listed, turned or mirrored
    order = np.argsort(np.abs(z - z.mean()), kind="stable")
    z, w = z[order], w[order]
    rng = np.random.default_rng(SEED)
    if count > MOST_PAIRS:
        some = np.sort(rng.choice(count, MOST_PAIRS, replace=False))
        z, w = z[some], w[some]
        count = MOST_PAIRS
    half = count // 2 + 1
    if count * (count - 1) // 2 <= DRAWS:
        first, second = np.array(list(combinations(range(count), 2))).T
    else:
        first = rng.integers(0, count, DRAWS)
        second = (first + rng.integers(1, count, DRAWS)) % count
    base = z[second] - z[first]
    good = np.abs(base) > 0
    first, second, base = first[good], second[good], base[good]
    turn = (w[second] - w[first]) / base
    shift = w[first] - turn * z[first]
    near = np.abs(turn - 1.0) <= TURN_MOST
    # the start itself, and each pair's mere shift, are candidates too
    turn = np.concatenate((turn[near], np.ones(count + 1, dtype=complex)))
    shift = np.concatenate((shift[near], w - z, [0.0j]))
    squares = np.abs(turn[:, None] * z[None, :] + shift[:, None] - w[None, :]) ** 2
    cost = np.partition(squares, half - 1, axis=1)[:, :half].sum(axis=1)
    best: tuple[float, complex, complex] | None = None
    for start in np.argsort(cost, kind="stable")[:5]:
        cost_now, turn_now, shift_now = _concentrated(z, w, complex(turn[start]), complex(shift[start]), half)
        if best is None or cost_now < best[0]:
            best = (cost_now, turn_now, shift_now)
    assert best is not None
    return best[1], best[2]


def _concentrated(
    z: Complex, w: Complex, turn: complex, shift: complex, half: int
) -> tuple[float, complex, complex]:
    """Refit to the best half until it stays the same."""
    cost = np.inf
    for _ in range(STEPS):
        squares = np.abs(turn * z + shift - w) ** 2
        chosen = np.argsort(squares, kind="stable")[:half]
        now = float(squares[chosen].sum())
        if now >= cost * (1 - 1e-9):
            break
        cost = now
        middle_z, middle_w = z[chosen].mean(), w[chosen].mean()
        dz, dw = z[chosen] - middle_z, w[chosen] - middle_w
        power = float((np.abs(dz) ** 2).sum())
        if power == 0.0:
            break
        turn = complex((dz.conj() * dw).sum() / power)
        shift = complex(middle_w - turn * middle_z)
    return cost, turn, shift
