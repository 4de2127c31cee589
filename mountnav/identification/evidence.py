"""How strong a camera's distortions are, and how large the unknown errors: what makes the pairs probable.

The evidence of a linear model with Gaussian priors is known in closed form [MacKay 1992, Bayesian
Interpolation]. The unknown error is set to its most probable value; over the distortions' strengths the
answer is averaged by their evidence, so that no single guess speaks where there are no stars.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EXTRA_PX = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28)
"""Errors in question that neither centroid nor catalog knows of."""
EXTRA_SPREAD = 1.2
"""Before any pair is seen the extra error is believed to be the floor, give or take a factor e^1.2."""
STEP = 2.5
LEAST_SHARE = 1e-3
"""Strengths less probable than this share of the best are left out of the average."""


@dataclass(frozen=True, slots=True)
class Belief:
    """What is believed of a camera and its errors.

    Attributes
    ----------
    extra_px : float
        Error per coordinate beyond centroid and catalog.
    widths : ndarray, shape (k, parameters)
        Expected sizes of the parameters under each strength that remains probable.
    share : ndarray, shape (k,)
        How probable each is; adds up to 1.
    """

    extra_px: float
    widths: Array
    share: Array


@dataclass(frozen=True, slots=True)
class Answer:
    """Parameters under a belief.

    Attributes
    ----------
    parameters : ndarray, shape (parameters,)
    smoother : ndarray, shape (parameters, parameters)
        The parameters are this times the right side of the normal equations.
    covariance : ndarray, shape (parameters, parameters)
        The smoother, and the spread between the strengths.
    """

    parameters: Array
    smoother: Array
    covariance: Array


class NormalEquations:
    """Normal equations of one set of pairs, to be solved under changing beliefs.

    Parameters
    ----------
    design : ndarray, shape (2, n, parameters)
    off : ndarray, shape (2, n)
        What the parameters shall explain, in units of `unit_px`.
    known2 : ndarray, shape (n,)
        Squared known error per coordinate, in the same unit.
    unit_px : float
    """

    def __init__(self, design: Array, off: Array, known2: Array, unit_px: float) -> None:
        self._rows = np.concatenate((design[0], design[1]))
        self._off = off.ravel()
        self._known2 = known2
        self._unit_px = unit_px

    def _sides(self, trust: Array, extra_px: float) -> tuple[Array, Array, float, float]:
        sigma2 = self._known2 + (extra_px / self._unit_px) ** 2
        weight = np.concatenate((trust / sigma2, trust / sigma2))
        weighted = self._rows * weight[:, None]
        constant = -float(np.log(sigma2).sum())
        return weighted.T @ self._rows, weighted.T @ self._off, float(weight @ self._off**2), constant

    def answer(self, trust: Array, belief: Belief) -> Answer:
        """Solve.

        Parameters
        ----------
        trust : ndarray, shape (n,)
            Weights against outliers, 1 for pairs in good standing.
        belief : Belief

        Returns
        -------
        Answer
        """
        normal, right, _, _ = self._sides(trust, belief.extra_px)
        widths, share = belief.widths, belief.share
        scaled = widths[:, :, None] * normal * widths[:, None, :] + np.eye(widths.shape[1])
        each = widths[:, :, None] * np.linalg.inv(scaled) * widths[:, None, :]
        smoother = np.tensordot(share, each, 1)
        parameters = smoother @ right
        apart = each @ right - parameters
        covariance: Array = smoother + (apart.T * share) @ apart
        return Answer(parameters, smoother, covariance)

    def most_probable(self, trust: Array, widths: Array, floor_px: float, near: Belief | None) -> Belief:
        """Weigh the strengths in question by their evidence.

        Parameters
        ----------
        trust : ndarray, shape (n,)
        widths : ndarray, shape (k, parameters)
            Of all strengths in question.
        floor_px : float
            The extra error that is expected.
        near : Belief or None
            An earlier belief: its extra error changes by one step at most.

        Returns
        -------
        Belief
        """
        best, held = -np.inf, None
        for extra_px in EXTRA_PX:
            if near is not None and not 1 / STEP < extra_px / near.extra_px < STEP:
                continue
            evidence = self._evidence(trust, extra_px, widths)
            top = float(evidence.max())
            share = np.exp(evidence - top)
            total = (
                top + float(np.log(share.mean())) - 0.5 * (np.log(extra_px / floor_px) / EXTRA_SPREAD) ** 2
            )
            if total > best:
                likely = share > LEAST_SHARE
                best, held = total, Belief(extra_px, widths[likely], share[likely] / share[likely].sum())
        assert held is not None
        return held

    def _evidence(self, trust: Array, extra_px: float, widths: Array) -> Array:
        """Log evidence of each strength, up to a constant; shape (k,)."""
        normal, right, square, constant = self._sides(trust, extra_px)
        count = widths.shape[1]
        # one more row and column: the square of the last pivot is what remains unexplained
        bordered = np.empty((widths.shape[0], count + 1, count + 1))
        bordered[:, :count, :count] = widths[:, :, None] * normal * widths[:, None, :] + np.eye(count)
        bordered[:, count, :count] = bordered[:, :count, count] = widths * right
        bordered[:, count, count] = square * (1.0 + 1e-9) + 1e-9
        pivots = np.linalg.cholesky(bordered)[:, np.arange(count + 1), np.arange(count + 1)]
        evidence: Array = -0.5 * pivots[:, count] ** 2 - np.log(pivots[:, :count]).sum(axis=1) + constant
        return evidence
