"""Which correction is best by what is known: the one with the least expected square of what is left.

A correction stays in force until the next one. Its cost is the mean square distance from the target over that
time, expected over all that the axis may be doing, and what the correction disturbs by itself. Doing nothing
is always among the choices, so that nothing is corrected that isn't known better than it would be disturbed;
and a motor that would have to turn round goes through its play knowingly, or waits until drift does the work.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.guiding.actuator import Actuator, Play

Array = NDArray[np.float64]

NODES = np.array([0.0469100770, 0.2307653449, 0.5, 0.7692346551, 0.9530899230, 1.0])
"""Where in the time to the next correction the distance is looked at: Gauss-Legendre's five nodes, and its
end."""
NODE_WEIGHTS = np.array([0.1184634425, 0.2393143352, 0.2844444444, 0.2393143352, 0.1184634425, 0.0])
"""Theirs; the end has none by itself."""
END_WEIGHT = 0.288675134595
"""What the distance at the end costs later, where only rates correct: with x(t) piecewise linear the least
sum of squares has x' = (√3 - 2) x from one correction to the next, and costs x² √3/6 times the interval."""


_NO_TAKES = np.zeros(1)
"""No play to take up."""
_SHARES = np.array([0.75, 1.0, 1.3])
"""Shares of the best correction that are tried, too, where gain or play is in doubt."""
_LEAST_WEIGHT = 3e-3
"""Hypotheses less probable than this, beside the best, don't decide. Tenfold, a play that is possible is
forgotten."""


@dataclass(frozen=True, slots=True)
class AxisCorrection:
    """What to do with an axis: a step now, and a rate from now on, on the sky.

    Attributes
    ----------
    gain_arcsec2 : float
        By how much the mean square distance is expected to fall by it.
    """

    step_arcsec: float
    rate_arcsec_s: float
    gain_arcsec2: float

    @property
    def none(self) -> bool:
        """Whether it is no correction at all."""
        return self.step_arcsec == 0.0 and self.rate_arcsec_s == 0.0


NO_CORRECTION = AxisCorrection(0.0, 0.0, 0.0)
"""Leave it alone."""


def node_times(interval_s: float) -> Array:
    """When the forecast that `choose` takes is wanted, s ahead."""
    return NODES * interval_s


def line_through(path: Array, interval_s: float) -> tuple[float, float]:
    """Level and rate of the straight line nearest to a path at the nodes."""
    tau = NODES * interval_s
    mean = float(NODE_WEIGHTS @ path)
    middle = 0.5 * interval_s
    rate = float(NODE_WEIGHTS @ ((tau - middle) * path)) / (interval_s**2 / 12.0)
    return mean - rate * middle, rate


def rate_alone(path: Array, interval_s: float) -> float:
    """The rate that undoes a path best where no step can be made, ″/s."""
    tau = NODES * interval_s
    above = float(NODE_WEIGHTS @ (tau * path)) + END_WEIGHT * float(path[-1]) * interval_s
    return -above / (interval_s**2 * (1.0 / 3.0 + END_WEIGHT))


def choose(
    paths: Array,
    weights: Array,
    play: Play,
    interval_s: float,
    *,
    uncertain_arcsec2: float = 0.0,
    turn_arcsec2: float = 0.0,
    direction: float = 0.0,
) -> AxisCorrection:
    """Choose the best correction.

    Parameters
    ----------
    paths : ndarray, shape (m, 6)
        Where the axis will be at `node_times` if nothing more is done, for each hypothesis of `play`.
    weights : ndarray, shape (m,)
        Their probabilities.
    interval_s : float
        Until the next correction.
    uncertain_arcsec2 : float
        So much must a correction gain besides; 0 where the forecast's own error is the same either way.
    turn_arcsec2 : float
        What it costs to turn the motor round.
    direction : float
        Of its last motion, by the sign; 0: not known.
    """
    actuator = play.actuator
    # an axis that doesn't follow at all is no reason to try less: that is told as a fault instead
    weights = np.where(play.gain > 0.0, weights, 0.0)
    kept = weights > _LEAST_WEIGHT * float(weights.max())
    paths, weights = paths[kept], weights[kept] / float(weights[kept].sum())
    steps, rates = _candidates(paths, weights, play.gain[kept], play.width[kept], actuator, interval_s)
    left = _left(paths, weights, play, kept, steps, rates, interval_s)
    moved = np.abs(steps) + np.abs(rates) * interval_s
    left = left + np.where(
        moved > 0.0,
        actuator.error_arcsec**2 + (actuator.error_share * moved) ** 2 + actuator.step_arcsec**2 / 12.0,
        0.0,
    )
    turns = (steps + rates * interval_s) * direction < 0.0
    left = left + np.where(turns, turn_arcsec2, 0.0)
    best = int(np.argmin(left))
    gain = float(left[0] - left[best])
    if gain <= uncertain_arcsec2:
        return NO_CORRECTION
    return AxisCorrection(float(steps[best]), float(rates[best]), gain)


def _candidates(
    paths: Array, weights: Array, gains: Array, widths: Array, actuator: Actuator, interval_s: float
) -> tuple[Array, Array]:
    """Corrections to choose from; the first is none."""
    mean = weights @ paths
    most = actuator.most_arcsec_s
    if gains.size == 1 and widths[0] == 0.0:
        # nothing is in doubt: the best is known at once
        takes, shares = _NO_TAKES, 1.0 / gains
    else:
        takes = np.unique(np.concatenate((widths, -widths, _NO_TAKES)))
        usual = float(weights @ gains)
        shares = np.unique(np.round(np.concatenate((1.0 / gains, _SHARES / usual)), 3))
    if actuator.kind == "rates":
        best = rate_alone(mean, interval_s)
        options = (shares[:, None] * best + takes / interval_s).ravel()
        rates = np.clip(np.concatenate(([0.0], options)), -most, most)
        return np.zeros_like(rates), rates
    whole = -float(NODE_WEIGHTS @ mean)
    steps = np.concatenate(([0.0], (shares[:, None] * whole + takes).ravel()))
    if actuator.kind == "pulses":
        steps = actuator.rounded(steps)
        return steps, np.zeros_like(steps)
    level, rate = line_through(mean, interval_s)
    both = (-shares[:, None] * level + takes).ravel()
    alone = shares * rate_alone(mean, interval_s)
    rates = np.concatenate((np.zeros_like(steps), np.repeat(-shares * rate, takes.size), alone))
    steps = np.concatenate((steps, both, np.zeros_like(alone)))
    return actuator.rounded(steps), np.clip(rates, -most, most)


def _left(
    paths: Array,
    weights: Array,
    play: Play,
    kept: NDArray[np.bool_],
    steps: Array,
    rates: Array,
    interval_s: float,
) -> Array:
    """Expected mean square distance after each of several corrections; shape (k,)."""
    place, width, gain = play.place[kept], play.width[kept], play.gain[kept]
    reached = place[:, None] + steps[None, :]
    inside = np.minimum(np.maximum(reached, 0.0), width[:, None])
    made = reached - inside
    # (m, k, nodes)
    on = inside[:, :, None] + rates[None, :, None] * (NODES * interval_s)
    made = made[:, :, None] + on - np.minimum(np.maximum(on, 0.0), width[:, None, None])
    square = (paths[:, None, :] + gain[:, None, None] * made) ** 2
    node_weights = NODE_WEIGHTS
    if play.actuator.kind == "rates":
        node_weights = NODE_WEIGHTS.copy()
        node_weights[-1] = END_WEIGHT
    return np.asarray(weights @ (square @ node_weights))


__all__ = ["NO_CORRECTION", "AxisCorrection", "choose", "line_through", "node_times", "rate_alone"]
