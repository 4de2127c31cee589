"""What cameras do to a frame: distortion terms, and how large each may be expected.

Lengths are in units of half the frame's longer side: the same camera with smaller pixels has the same
distortion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.plate import SIMILARITY, powers

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
