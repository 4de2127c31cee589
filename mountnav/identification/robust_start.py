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
ROUGH_PAIRS = 100
LIKELY = 40
"""So many draws that do best with `ROUGH_PAIRS` of the pairs are tried with all."""
STEPS = 8
GAIN = 1e-3
"""A step that gains less ends the refitting: it is a start, and a fit follows."""
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
    if count > ROUGH_PAIRS:
        # most draws are far off: a few evenly spread pairs tell which aren't
        some = np.linspace(0, count - 1, ROUGH_PAIRS).astype(np.int64)
        likely = np.argsort(_cost(z[some], w[some], turn, shift, ROUGH_PAIRS // 2 + 1), kind="stable")[
            :LIKELY
        ]
        turn, shift = turn[likely], shift[likely]
    cost = _cost(z, w, turn, shift, half)
    best: tuple[float, complex, complex] | None = None
    for start in np.argsort(cost, kind="stable")[:5]:
        cost_now, turn_now, shift_now = _concentrated(z, w, complex(turn[start]), complex(shift[start]), half)
        if best is None or cost_now < best[0]:
            best = (cost_now, turn_now, shift_now)
    assert best is not None
    return best[1], best[2]


def _squares(z: Complex, w: Complex, turn: Complex | complex, shift: Complex | complex) -> Array:
    off = turn * z + (shift - w)
    return np.asarray(off.real**2 + off.imag**2)


def _cost(z: Complex, w: Complex, turn: Complex, shift: Complex, half: int) -> Array:
    """Sum of the least `half` squares under each draw, shape (len(turn),)."""
    squares = _squares(z, w, turn[:, None], shift[:, None])
    squares.partition(half - 1, axis=1)
    return np.asarray(squares[:, :half].sum(axis=1))


def _concentrated(
    z: Complex, w: Complex, turn: complex, shift: complex, half: int
) -> tuple[float, complex, complex]:
    """Refit to the best half until it stays the same."""
    cost = np.inf
    for _ in range(STEPS):
        squares = _squares(z, w, turn, shift)
        chosen = np.argpartition(squares, half - 1)[:half]
        now = float(squares[chosen].sum())
        if now >= cost * (1 - GAIN):
            break
        cost = now
        middle_z, middle_w = z[chosen].mean(), w[chosen].mean()
        dz, dw = z[chosen] - middle_z, w[chosen] - middle_w
        power = float(np.vdot(dz, dz).real)
        if power == 0.0:
            break
        turn = complex(np.vdot(dz, dw) / power)
        shift = complex(middle_w - turn * middle_z)
    return cost, turn, shift
