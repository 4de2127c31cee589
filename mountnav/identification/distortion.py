"""What cameras do to a frame: distortion terms, and how large each may be expected.

Lengths are in units of half the frame's longer side: the same camera with smaller pixels has the same
distortion.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.plate import SIMILARITY, powers, terms

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
        What each parameter is: "free" (shift, turn, scale), "shear", "radial", "decentering", "other".
    """

    x: Array
    y: Array
    kind: tuple[str, ...]

    def design(self, u: Array, v: Array, degree: int) -> Array:
        """Displacements by each parameter, shape (2, n, parameters)."""
        rows = terms(u, v, degree)
        return np.stack((rows @ self.x, rows @ self.y))

    def widths(self, shear: float, radial: float, other: float) -> Array:
        """Expected size of each parameter, shape (parameters,)."""
        size = {
            "free": 1.0,
            "shear": shear,
            "radial": radial,
            "decentering": max(other, DECENTERED * radial),
            "other": other,
        }
        return np.array([size[kind] for kind in self.kind])


def _basis(degree: int) -> Basis:
    """Shift, turn and scale; from degree 1 shear, from 2 all of second order, from 3 all of third."""
    index = {power: i for i, power in enumerate(powers(degree))}
    columns: list[tuple[str, dict[tuple[int, int], float], dict[tuple[int, int], float]]] = [
        ("free", {(0, 0): 1}, {}),
        ("free", {}, {(0, 0): 1}),
        ("free", {(1, 0): 1}, {(0, 1): 1}),
        ("free", {(0, 1): -1}, {(1, 0): 1}),
    ]
    if degree >= 1:
        columns += [("shear", {(1, 0): 1}, {(0, 1): -1}), ("shear", {(0, 1): 1}, {(1, 0): 1})]
    if degree >= 3:
        columns += [
            ("radial", {(3, 0): 1, (1, 2): 1}, {(2, 1): 1, (0, 3): 1}),
            ("decentering", {(2, 0): 3, (0, 2): 1}, {(1, 1): 2}),
            ("decentering", {(1, 1): 2}, {(2, 0): 1, (0, 2): 3}),
        ]
    for power in powers(degree):
        if 2 <= sum(power) <= degree:
            columns += [("other", {power: 1}, {}), ("other", {}, {power: 1})]
    x, y = np.zeros((2, len(index), len(columns)))
    for number, (_, in_x, in_y) in enumerate(columns):
        for side, given in ((x, in_x), (y, in_y)):
            for power, factor in given.items():
                side[index[power], number] = factor
    return Basis(x, y, tuple(kind for kind, _, _ in columns))


def _strengths(degree: int) -> list[tuple[float, float, float]]:
    """Strengths in question at a degree: shear, radial, other."""
    shears = SHEARS if degree >= 1 else SHEARS[:1]
    radials = RADIALS if degree >= 3 else RADIALS[:1]
    others = OTHERS if degree >= 2 else OTHERS[:1]
    return list(product(shears, radials, others))


BASES = {degree: _basis(degree) for degree in range(SIMILARITY, 4)}
WIDTHS = {
    degree: np.array([basis.widths(*one) for one in _strengths(degree)]) for degree, basis in BASES.items()
}
"""Expected sizes of the parameters under each strength in question; shape (strengths, parameters)."""
