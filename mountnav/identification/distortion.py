"""What cameras do to a frame: distortion terms, how large each may be, and the evidence for that.

Lengths are in units of half the frame's longer side: the same camera with smaller pixels has the same
strengths. The evidence of a linear model with Gaussian priors is known in closed form [MacKay 1992, Bayesian
interpolation].
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.plate import SIMILARITY, powers, products

Array = NDArray[np.float64]

SHEARS = (3e-5, 3e-4, 2e-3)
"""Differential aberration 1e-4, refraction 3e-4 at the zenith and 1.2e-3 at 30° altitude."""
RADIALS = (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 4e-2)
"""Radial distortion at the edge: 0.01 px (none) to 40 px of a frame of 2000 px."""
OTHERS = (3e-6, 3e-5, 1e-4, 3e-4, 1e-3)
"""Tilt, decentering, and whatever else a polynomial can say."""
DECENTERED = 0.06
"""A radial distortion's center is expected this close to the frame's: 3 % of the longer side."""


@dataclass(frozen=True, slots=True)
class Basis:
    """Displacements in x and y as polynomials of (u, v), the pixels about the center.

    Attributes
    ----------
    x, y : ndarray, shape (monomials, parameters)
        Coefficients.
    kind : tuple of str
        What each parameter is: "free" (shift, turn, scale), "other", "shear", "radial", "decentering"; in
        this order.
    bordered : ndarray, shape (sums, (parameters + 1)²)
        Turns weighted sums over pairs into normal equations, flattened: the normal matrix, the right side
        as one more row and column, and in the corner the square of what is to be explained. The sums are
        those of the monomials up to twice the degree; of the monomials times what is to be explained in x,
        and in y; and of its square.
    """

    x: Array
    y: Array
    kind: tuple[str, ...]
    bordered: Array

    def displacements(self, parameters: Array) -> Array:
        """Polynomials of a set of parameters: x and y, shape (2, monomials)."""
        return np.stack((self.x @ parameters, self.y @ parameters))


@dataclass(frozen=True, slots=True)
class Strengths:
    """Expected sizes of a degree's parameters under each strength in question.

    Attributes
    ----------
    head : ndarray, shape (h, a)
        Of the free and the other parameters, for each size of the other ones.
    tail : ndarray, shape (h, s, r, b)
        Of shear, radial and decentering, for each of these and each choice of shear and of radial.
    """

    head: Array
    tail: Array


def _basis(degree: int) -> Basis:
    """Shift, turn and scale; from degree 1 shear, from 2 all of second order, from 3 all of third."""
    index = {power: i for i, power in enumerate(powers(degree))}
    columns: list[tuple[str, dict[tuple[int, int], float], dict[tuple[int, int], float]]] = [
        ("free", {(0, 0): 1}, {}),
        ("free", {}, {(0, 0): 1}),
        ("free", {(1, 0): 1}, {(0, 1): 1}),
        ("free", {(0, 1): -1}, {(1, 0): 1}),
    ]
    for power in powers(degree):
        if 2 <= sum(power) <= degree:
            columns += [("other", {power: 1}, {}), ("other", {}, {power: 1})]
    if degree >= 1:
        columns += [("shear", {(1, 0): 1}, {(0, 1): -1}), ("shear", {(0, 1): 1}, {(1, 0): 1})]
    if degree >= 3:
        columns += [
            ("radial", {(3, 0): 1, (1, 2): 1}, {(2, 1): 1, (0, 3): 1}),
            ("decentering", {(2, 0): 3, (0, 2): 1}, {(1, 1): 2}),
            ("decentering", {(1, 1): 2}, {(2, 0): 1, (0, 2): 3}),
        ]
    x, y = np.zeros((2, len(index), len(columns)))
    for number, (_, in_x, in_y) in enumerate(columns):
        for side, given in ((x, in_x), (y, in_y)):
            for power, factor in given.items():
                side[index[power], number] = factor
    return Basis(x, y, tuple(kind for kind, _, _ in columns), _bordered(degree, x, y))


def _bordered(degree: int, x: Array, y: Array) -> Array:
    single, double = powers(degree), powers(2 * max(degree, 1))
    place = {power: i for i, power in enumerate(double)}
    count, first = x.shape[1], len(double)
    out = np.zeros((first + 2 * len(single) + 1, count + 1, count + 1))
    for a, (i, j) in enumerate(single):
        for b, (k, m) in enumerate(single):
            out[place[i + k, j + m], :count, :count] += np.outer(x[a], x[b]) + np.outer(y[a], y[b])
        for row, side in ((first + a, x), (first + len(single) + a, y)):
            out[row, count, :count] = out[row, :count, count] = side[a]
    out[-1, count, count] = 1.0
    return out.reshape(out.shape[0], -1)


def _strengths(degree: int, basis: Basis) -> Strengths:
    shears = SHEARS if degree >= 1 else SHEARS[:1]
    radials = RADIALS if degree >= 3 else RADIALS[:1]
    others = OTHERS if degree >= 2 else OTHERS[:1]
    in_head = sum(kind in ("free", "other") for kind in basis.kind)

    def widths(shear: float, radial: float, other: float) -> list[float]:
        size = {
            "free": 1.0,
            "other": other,
            "shear": shear,
            "radial": radial,
            "decentering": max(other, DECENTERED * radial),
        }
        return [size[kind] for kind in basis.kind]

    every = np.array(
        [[[widths(shear, radial, other) for radial in radials] for shear in shears] for other in others]
    )
    return Strengths(head=every[:, 0, 0, :in_head], tail=every[..., in_head:])


BASES = {degree: _basis(degree) for degree in range(SIMILARITY, 4)}
STRENGTHS = {degree: _strengths(degree, basis) for degree, basis in BASES.items()}
"""Terms and strengths for each degree of a plate, from a similarity to a cubic."""


EXTRA_PX = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28)
"""Errors in question that neither centroid nor catalog knows of. Each is twice the one before, from what no
centroid reaches to more than a pixel."""
EXTRA_SPREAD = 1.2
"""Before any pair is seen the extra error is believed to be the floor, give or take a factor e^1.2. Chosen by
hand. Doubled or halved, the tests of search, refusal and plate pass all the same."""
SHEARS_FIRST = 2
"""Number of shear parameters among those that are not eliminated at once: a plate has two."""
LEAST_SHARE = 1e-3
"""Strengths less probable than this share of the best are left out of the average. They would change a result
by less than that share."""


@dataclass(frozen=True, slots=True)
class Belief:
    """Posterior of a camera's strengths and of the extra error: which are probable, with their weights.

    Attributes
    ----------
    extra_px : float
        Error per coordinate beyond centroid and catalog.
    head : ndarray, shape (h, a)
        Expected sizes of the free and the other parameters under each strength that remains probable.
    tail : ndarray, shape (h, k, b)
        And of the rest of the parameters, for k choices of shear and radial distortion.
    share : ndarray, shape (h, k)
        How probable each is; adds up to 1.
    """

    extra_px: float
    head: Array
    tail: Array
    share: Array


@dataclass(frozen=True, slots=True)
class Answer:
    """Parameters under a belief.

    Attributes
    ----------
    normal : ndarray, shape (parameters, parameters)
        Normal matrix, the belief included.
    smoother : ndarray, shape (parameters, parameters)
        The parameters are this times the right side of the normal equations.
    covariance : ndarray, shape (parameters, parameters)
        The smoother, and the spread between the strengths.
    """

    normal: Array
    smoother: Array
    covariance: Array


class NormalEquations:
    """Normal equations of one set of pairs, to be solved under changing beliefs.

    All strengths in question share few sizes of the many other terms: these are eliminated once for each
    size, and what remains to be solved for each strength is shear, radial distortion and decentering.

    Parameters
    ----------
    u, v : ndarray, shape (n,)
        Pixels about the center, in units of `unit_px`.
    off : ndarray, shape (2, n)
        What the parameters shall explain, in the same units.
    known2 : ndarray, shape (n,)
        Known squared error of each pair, in the same units.
    """

    def __init__(self, u: Array, v: Array, off: Array, known2: Array, unit_px: float, degree: int) -> None:
        self._basis, self._strengths = BASES[degree], STRENGTHS[degree]
        double, single = products(u, v, 2 * max(degree, 1)), len(powers(degree))
        self._rows, self._off = double[:single], off
        self._summed = np.concatenate(
            (double, self._rows * off[0], self._rows * off[1], (off[0] ** 2 + off[1] ** 2)[None, :])
        )
        self._known2, self._unit_px = known2, unit_px
        self._every: tuple[Array, Array] | None = None

    def those(self, chosen: NDArray[np.bool_]) -> NormalEquations:
        """The equations of some of the pairs."""
        some = copy(self)
        some._rows, some._off = self._rows[:, chosen], self._off[:, chosen]
        some._summed, some._known2 = self._summed[:, chosen], self._known2[chosen]
        some._every = None
        return some

    def left_over(self, parameters: Array) -> Array:
        """What parameters don't explain, shape (2, n)."""
        left: Array = self._off - self._basis.displacements(parameters) @ self._rows
        return left

    def hat(self, smoother: Array) -> tuple[Array, Array, Array]:
        """What a smoother makes of each pair's own displacement: xx, xy, yy; shape (n,) each."""
        rows, (x, y) = self._rows, (self._basis.x, self._basis.y)
        along_x, along_y = x @ smoother, y @ smoother
        xx, xy, yy = along_x @ x.T, along_x @ y.T, along_y @ y.T
        return (
            (rows * (xx @ rows)).sum(axis=0),
            (rows * (xy @ rows)).sum(axis=0),
            (rows * (yy @ rows)).sum(axis=0),
        )

    def sigma2(self, extra_px: float) -> Array:
        """Squared error of each pair, shape (n,)."""
        return np.asarray(self._known2 + (extra_px / self._unit_px) ** 2)

    def parameters(self, trust: Array, belief: Belief) -> Array:
        """Solve.

        Parameters
        ----------
        trust : ndarray, shape (n,)
            Weights against outliers, 1 for pairs in good standing.
        """
        bordered = self._equations(trust / self.sigma2(belief.extra_px))
        solved = _Solved(bordered, belief)
        return solved.mean

    def answer(self, trust: Array, belief: Belief) -> Answer:
        """Parameters with their errors; arguments as of `parameters`."""
        bordered = self._equations(trust / self.sigma2(belief.extra_px))
        solved = _Solved(bordered, belief)
        smoother = solved.smoother()
        return Answer(bordered[:-1, :-1], smoother, smoother + solved.spread())

    def most_probable(self, trust: Array, floor_px: float, near: Belief | None) -> Belief:
        """Weigh the strengths in question by their evidence.

        Parameters
        ----------
        trust : ndarray, shape (n,)
            Weight of each pair.
        floor_px : float
            The extra error that is expected.
        near : Belief or None
            An earlier belief: its extra error changes by one step at most.
        """
        extra_px = np.array(EXTRA_PX)
        if self._every is None:
            sigma2 = self._known2 + (extra_px[:, None] / self._unit_px) ** 2
            self._every = 1.0 / sigma2, -np.log(sigma2).sum(axis=1)
        weight, constant = self._every
        chosen = slice(None)
        if near is not None:
            at = int(np.argmin(np.abs(np.log(extra_px / near.extra_px))))
            chosen = slice(max(at - 1, 0), at + 2)
        extra_px, weight, constant = extra_px[chosen], weight[chosen], constant[chosen]
        evidence = _evidence(self._equations(weight * trust), self._strengths)
        evidence = evidence.reshape(extra_px.size, -1)
        top = evidence.max(axis=1)
        share = np.exp(evidence - top[:, None])
        total = (
            top
            + constant
            + np.log(share.mean(axis=1))
            - 0.5 * (np.log(extra_px / floor_px) / EXTRA_SPREAD) ** 2
        )
        best = int(np.argmax(total))
        return _believed(float(extra_px[best]), self._strengths, share[best])

    def _equations(self, weight: Array) -> Array:
        """Normal matrix bordered with the right side and the square, for weights of shape (..., n)."""
        size = len(self._basis.kind) + 1
        return np.asarray((weight @ self._summed.T) @ self._basis.bordered).reshape(
            *weight.shape[:-1], size, size
        )


def _believed(extra_px: float, strengths: Strengths, share: Array) -> Belief:
    """Only the strengths that remain probable."""
    h, s, r, b = strengths.tail.shape
    share = np.where(share > LEAST_SHARE, share, 0.0).reshape(h, s * r)
    heads, tails = np.flatnonzero(share.any(axis=1)), np.flatnonzero(share.any(axis=0))
    tail = strengths.tail.reshape(h, s * r, b)[heads[:, None], tails]
    share = share[heads[:, None], tails]
    return Belief(extra_px, strengths.head[heads], tail, share / share.sum())


class _Solved:
    """Parameters under every strength of a belief: first the head's as they follow from the tail's."""

    def __init__(self, bordered: Array, belief: Belief) -> None:
        head, self._tail, self._share = belief.head, belief.tail, belief.share
        a = head.shape[1]
        b = bordered.shape[0] - 1 - a
        self._scale = head[:, :, None]
        self._heads = self._scale * bordered[:a, :a] * head[:, None, :]
        self._heads[:, np.arange(a), np.arange(a)] += 1.0
        follows = self._scale * np.linalg.solve(self._heads, self._scale * bordered[:a, a:])
        self._follows, self._alone = follows[:, :, :b], follows[:, :, b]
        self._heads_mean = self._share.sum(axis=1) @ self._alone
        if b == 0:
            self._tails = np.zeros((*self._share.shape, 0, 0))
            self._x = np.zeros((*self._share.shape, 0))
            self.mean: Array = self._heads_mean
            return
        rest = bordered[a:, a:] - bordered[a:, :a] @ follows
        tail = self._tail
        self._tails = tail[..., :, None] * rest[:, None, :b, :b] * tail[..., None, :]
        self._tails[..., np.arange(b), np.arange(b)] += 1.0
        self._x = tail * np.linalg.solve(self._tails, (tail * rest[:, None, :b, b])[..., None])[..., 0]
        mean = self._share[:, None, :] @ self._x
        followed = (self._follows @ mean.swapaxes(1, 2))[:, :, 0].sum(axis=0)
        self.mean = np.concatenate((self._heads_mean - followed, mean[:, 0].sum(axis=0)))

    def smoother(self) -> Array:
        """The inverse of the normal matrix with its priors, averaged over the strengths."""
        alone = self._scale * np.linalg.inv(self._heads) * self._scale[:, None, :, 0]
        head = np.tensordot(self._share.sum(axis=1), alone, 1)
        tail = self._tail
        each = tail[..., :, None] * np.linalg.inv(self._tails) * tail[..., None, :]
        mean = np.einsum("hk,hkbc->hbc", self._share, each)
        across = self._follows @ mean
        corner = (across @ self._follows.transpose(0, 2, 1)).sum(axis=0)
        aside = -across.sum(axis=0)
        return np.block([[head + corner, aside], [aside.T, mean.sum(axis=0)]])

    def spread(self) -> Array:
        """Covariance between the strengths."""
        heads = self._alone[:, None, :] - self._x @ self._follows.transpose(0, 2, 1)
        apart = np.concatenate((heads, self._x), axis=2).reshape(self._share.size, -1) - self.mean
        return np.asarray((apart.T * self._share.ravel()) @ apart)


def _evidence(bordered: Array, strengths: Strengths) -> Array:
    """Log evidence of each strength, up to a constant.

    Parameters
    ----------
    bordered : ndarray, shape (n, parameters + 1, parameters + 1)
        Normal equations; the square of the border's pivot is what remains unexplained.

    Returns
    -------
    ndarray, shape (n, h, s, r)
        One value for each combination of strengths.
    """
    head, tail = strengths.head, strengths.tail
    a, b = head.shape[1], tail.shape[3]
    size = a + b + 1
    scale = np.ones((head.shape[0], size))
    scale[:, :a] = head
    # the weakest belief in the tail is in all strengths: with it the tail can be eliminated at once
    weakest = 1.0 / tail.reshape(-1, b).max(axis=0) ** 2 if b else np.zeros(0)
    matrix = bordered[:, None] * (scale[:, :, None] * scale[:, None, :])
    diagonal = np.arange(size)
    matrix[..., diagonal, diagonal] += np.concatenate((np.ones(a), weakest, [1e-9]))
    matrix[..., -1, -1] += 1e-9 * bordered[:, None, -1, -1]
    lower = np.linalg.cholesky(matrix)
    logs = np.log(lower[..., diagonal[:a], diagonal[:a]]).sum(axis=-1)
    lower = lower[..., a:, a:]
    # the strengths come last, where a step of the elimination runs over all of them at once; the steps for
    # shear come before there is a radial distortion to choose
    rest = (lower @ lower.swapaxes(-1, -2)).transpose(2, 3, 0, 1)[..., None, None]
    priors = (1.0 / tail**2 - weakest).transpose(3, 0, 1, 2)
    evidence = -logs[..., None, None] - np.log(tail).sum(axis=-1)
    for number in range(b):
        pivot = rest[0, 0] + (priors[number] if number >= SHEARS_FIRST else priors[number, ..., :1])
        evidence -= 0.5 * np.log(pivot)
        column = rest[1:, 0]
        rest = rest[1:, 1:] - column[:, None] * (column / pivot)
    return np.asarray(evidence - 0.5 * rest[0, 0])
