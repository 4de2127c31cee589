"""A plate fit that knows what cameras do: distortions are small, smooth and mostly radial.

A free polynomial through few stars, or through stars in one corner, is wild elsewhere. Here each distortion
term has an expected size, found by evidence. Where pairs are many and everywhere this is the plain
least-squares polynomial; where they say nothing a term stays near zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.distortion import BASES, Belief, NormalEquations
from mountnav.identification.plate import Plate, products
from mountnav.measuring.medians import median

Array = NDArray[np.float64]


TAIL_Z2 = 8.0
"""Pairs with a squared deviation (both coordinates, in sigma²) beyond this lose weight: 2 % of the honest.
Doubled or halved, the tests of search, refusal and plate pass all the same."""
ROUNDS = 4
"""Reweighted fits at most; it ends earlier where no weight changes by more than `SETTLED`. Chosen by hand."""
SETTLED = 1e-3
"""Largest change of a weight that ends the rounds."""


@dataclass(frozen=True)
class CameraFit:
    """A plate fitted to pairs.

    Attributes
    ----------
    trust : ndarray, shape (n,)
        Weight of each pair against long tails, 1 for those in the bell.
    """

    plate: Plate
    belief: Belief
    trust: Array
    _like: Plate
    _equations: NormalEquations
    _frame: Array
    _left_over: Array
    _sigma2: Array

    @property
    def sigma_arcsec(self) -> Array:
        """Error per coordinate of each pair: known, extra, and more for pairs in the tails; shape (n,)."""
        return np.asarray(np.sqrt(self._sigma2) * _scale(self._frame))

    @property
    def off_arcsec(self) -> Array:
        """Distance of each pair from the plate, shape (n,)."""
        return np.asarray(np.hypot(*self._left_over) * _scale(self._frame))

    def of(self, chosen: NDArray[np.bool_]) -> CameraFit:
        """Fit some of the pairs, with the same belief."""
        equations = self._equations.those(chosen)
        degree = self.plate.degree
        return _converged(
            self._like, self._frame, equations, self.trust[chosen], degree, lambda *_: self.belief, None
        )

    @cached_property
    def influence(self) -> Influence:
        """Leverage of the pairs and covariance of the plate; computed on demand, since few fits need it."""
        answer = self._equations.answer(self.trust, self.belief)
        used = float((answer.smoother * answer.normal).sum())
        left_over, sigma2 = self._left_over, self._sigma2
        at_center = answer.covariance[:2, :2] * _excess((left_over**2).sum(axis=0) / sigma2, used)
        xx, xy, yy = (part / sigma2 for part in self._equations.hat(answer.smoother))
        return Influence(
            apart_arcsec=_apart(xx, xy, yy, left_over) * _scale(self._frame),
            leverage=0.5 * (xx + yy),
            center_covariance_arcsec2=self._frame @ at_center @ self._frame.T,
        )


@dataclass(frozen=True, slots=True)
class Influence:
    """How the pairs of a fit hold it: leverage, leave-one-out distances, covariance of the center.

    Attributes
    ----------
    apart_arcsec : ndarray, shape (n,)
        Distance of each pair from a plate that was fit without it (leave-one-out); exact for one strength of
        distortion, to a few percent for the average over several.
    leverage : ndarray, shape (n,)
        How much each pair holds the plate at its own position, mean of both coordinates.
    center_covariance_arcsec2 : ndarray, shape (2, 2)
        East and north, scaled up by the residuals.
    """

    apart_arcsec: Array
    leverage: Array
    center_covariance_arcsec2: Array


def similarity_part(plate: Plate) -> Array:
    """The plate's matrix without its shear, arcsec per half frame; shape (2, 2)."""
    matrix = plate.matrix() * plate.unit_px
    s = float(-plate.parity)
    p, q = 0.5 * (matrix[0, 0] + s * matrix[1, 1]), 0.5 * (matrix[1, 0] - s * matrix[0, 1])
    return np.array([[p, -s * q], [q, s * p]])


def _scale(frame: Array) -> float:
    return float(np.sqrt(abs(frame[0, 0] * frame[1, 1] - frame[0, 1] * frame[1, 0])))


def fit_camera(
    like: Plate,
    x_px: Array,
    y_px: Array,
    xi: Array,
    eta: Array,
    known_arcsec: Array,
    degree: int,
    *,
    floor_px: float,
    belief: Belief | None = None,
    near: Belief | None = None,
) -> CameraFit:
    """Fit a plate of a degree.

    Parameters
    ----------
    like : Plate
        Gives tangent point, center, parity, and where to start.
    x_px, y_px : ndarray, shape (n,)
        Measured pixels.
    xi, eta : ndarray, shape (n,)
        Tangential coordinates of the stars about `like.tangent`, arcsec.
    known_arcsec : ndarray, shape (n,)
        Error per coordinate of each pair, as far as centroid and catalog state it.
    degree : int
        0 (similarity) to 3.
    floor_px : float
        What the error beyond the known is expected to be.
    belief : Belief, optional
        Of an earlier fit, to be kept.
    near : Belief, optional
        Of an earlier fit, to start from.
    """
    unit = like.unit_px
    u, v = (x_px - like.center_x_px) / unit, (y_px - like.center_y_px) / unit
    frame = similarity_part(like)
    scale = _scale(frame)
    known2 = (known_arcsec / scale) ** 2
    off = np.linalg.inv(frame) @ np.stack((xi - like.xi[0], eta - like.eta[0]))
    off[0] -= u
    off[1] -= v
    equations = NormalEquations(u, v, off, known2, unit, degree)
    seen = products(u, v, like.degree)
    distance2 = ((like.xi @ seen - xi) ** 2 + (like.eta @ seen - eta) ** 2) / scale**2
    spread2 = 0.5 * median(distance2) / np.log(2.0)
    trust = _trust(distance2, known2 + spread2)

    def believed(trust: Array, near: Belief | None) -> Belief:
        return equations.most_probable(trust, floor_px, near) if belief is None else belief

    return _converged(like, frame, equations, trust, degree, believed, near)


def _converged(
    like: Plate,
    frame: Array,
    equations: NormalEquations,
    trust: Array,
    degree: int,
    belief: Callable[[Array, Belief | None], Belief],
    near: Belief | None,
) -> CameraFit:
    """Parameters, trust and belief in turns until they agree."""
    held = belief(trust, near)
    for turn in range(ROUNDS + 1):
        if 0 < turn < ROUNDS:
            held = belief(trust, held)
        parameters = equations.parameters(trust, held)
        left_over = equations.left_over(parameters)
        again = _trust((left_over**2).sum(axis=0), equations.sigma2(held.extra_px))
        if turn == ROUNDS or np.abs(again - trust).max() < SETTLED:
            break
        trust = again
    x, y = BASES[degree].displacements(parameters)
    x[1] += 1.0
    y[2] += 1.0
    xi, eta = frame[0, 0] * x + frame[0, 1] * y, frame[1, 0] * x + frame[1, 1] * y
    mirrored = xi[1] * eta[2] - xi[2] * eta[1] > 0
    xi[0] += like.xi[0]
    eta[0] += like.eta[0]
    return CameraFit(
        plate=replace(like, degree=degree, parity=-1 if mirrored else 1, xi=xi, eta=eta),
        belief=held,
        trust=trust,
        _like=like,
        _equations=equations,
        _frame=frame,
        _left_over=left_over,
        _sigma2=equations.sigma2(held.extra_px) / trust,
    )


def _trust(distance2: Array, sigma2: Array) -> Array:
    """Weights against long tails (blends, neighbors), shape (n,): 1 in the bell, beyond it as z⁻²."""
    return np.asarray(np.minimum(1.0, TAIL_Z2 * sigma2 / np.maximum(distance2, 1e-300)))


def _excess(z2: Array, used: float) -> float:
    """How much larger the residuals are than the errors say; never below 1, and more careful with few pairs.

    With f degrees of freedom left the true variance is uncertain by a factor; its mean is f/(f − 2).
    """
    free = max(2.0 * z2.size - used, 1.0)
    return max(1.0, float(z2.sum()) / free) * (free + 2.0) / free


def _apart(xx: Array, xy: Array, yy: Array, left_over: Array) -> Array:
    """Leave-one-out distances: (1 − H)⁻¹ left over, with the hat matrix' 2 × 2 blocks H; shape (n,)."""
    a, d = 1.0 + 1e-9 - xx, 1.0 + 1e-9 - yy
    determinant = a * d - xy**2
    x, y = left_over
    return np.asarray(np.hypot(d * x + xy * y, xy * x + a * y) / np.abs(determinant))
