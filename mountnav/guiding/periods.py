"""Which period an axis swings with, from looks over more than a turn of it.

`mountnav.pointing.drift.periodic` tells a report's reader of a period once it is beyond doubt, with three
turns. Guiding can't wait so long, and needn't: a candidate here is only a proposal, and the bank of filters
judges by its evidence whether it explains the looks better than a walk of the axis does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_LOOKS = 10
"""Fewer show no period: a line and four harmonic numbers are fitted."""
LEAST_TURNS = 1.15
"""So much of a turn must have been seen. Less, and a bent drift passes for a swing."""
LOOKS_A_TURN = 3.2
"""Looks in a turn at least; 2 are Nyquist's limit."""
SHORTEST_S, LONGEST_S = 60.0, 1500.0
"""Periods of worms, and of the gears before them."""
_OVERSAMPLING = 5.0
"""Steps of frequency in the width of a peak. Halved, a peak is missed by a fifth of its power."""
_AS_GOOD = 0.92
"""A half or a third of a period that explains this share of what the period does is taken instead."""
_LEAST_FALL = 0.35
"""A swing must explain this share of what a bent line leaves. Chosen low: the filters' evidence decides."""


def propose_period(seconds: Array, angle: Array, sigma: Array) -> float | None:
    """Propose a period, s; None where none stands out.

    Parameters
    ----------
    seconds, angle, sigma : ndarray, shape (n,)
        When; where the axis would have been without corrections, ″; errors.
    """
    n = seconds.size
    if n < LEAST_LOOKS:
        return None
    span = float(np.ptp(seconds))
    step = float(np.median(np.diff(seconds)))
    low = max(LEAST_TURNS / span, 1.0 / LONGEST_S)
    high = min(1.0 / (LOOKS_A_TURN * step), 1.0 / SHORTEST_S)
    if high <= low:
        return None
    time = (seconds - seconds.mean()) / span
    weight = 1.0 / np.maximum(sigma, 1e-3)
    columns = [np.ones(n), time, time**2]
    if n > 40:
        columns += [time**3]
    trend, _ = np.linalg.qr(np.column_stack(columns) * weight[:, None])
    rest = angle * weight
    rest = rest - trend @ (trend.T @ rest)
    total = float(rest @ rest)
    if total <= 0.0:
        return None

    def explained(frequencies: Array) -> Array:
        phase = 2.0 * np.pi * frequencies[:, None] * (seconds - seconds[0])[None, :]
        harmonics = 1 if n < 20 else 2
        parts = np.stack(
            [part for j in range(1, harmonics + 1) for part in (np.cos(j * phase), np.sin(j * phase))], axis=1
        )
        parts = parts * weight
        parts = parts - (parts @ trend) @ trend.T
        gram = parts @ parts.transpose(0, 2, 1) + 1e-9 * n * np.eye(parts.shape[1])
        right = parts @ rest
        fitted = np.linalg.solve(gram, right[:, :, None])[:, :, 0]
        return np.asarray((right * fitted).sum(axis=1), dtype=float)

    count = int(np.ceil((high - low) * span * _OVERSAMPLING)) + 2
    frequencies = np.linspace(low, high, count)
    power = explained(frequencies)
    at = int(np.argmax(power))
    if power[at] < _LEAST_FALL * total:
        return None
    width = (high - low) / (count - 1)
    best = float(frequencies[at])
    for _ in range(2):
        near = np.clip(best + np.linspace(-width, width, 11), low, high)
        best = float(near[int(np.argmax(explained(near)))])
        width /= 4.0
    # two or three turns are a period, too: the shortest one that explains as much is the worm's
    whole = float(explained(np.array([best]))[0])
    for turns in (3, 2):
        shorter = best * turns
        if shorter <= high and float(explained(np.array([shorter]))[0]) >= _AS_GOOD * whole:
            best = shorter
            break
    return 1.0 / best


__all__ = ["propose_period"]
