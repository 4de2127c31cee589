"""Error classes for catalogs larger than memory: stars are counted in cells, and the cells are classified.

A cell holds the stars whose sigma is the same, to 3 %, at three epochs. Every star of the catalog is counted,
none is sampled: so no monstrous error is overlooked, and the order in which stars come doesn't matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.error_classes import CLASSES_BY_WIDTH, REFERENCE_YR, class_parameters
from mountnav.catalog.packed.format import CLASS, MOST_CLASSES

Array = NDArray[np.float64]
Curves = NDArray[np.float32]
Indices = NDArray[np.int64]

CELL_EPOCHS_YR = (2020.0, 1995.0, 2045.0)
"""The first tells how large an error is, the others how it grows before and after."""
SMALLEST_MAS, LARGEST_MAS = 0.005, 1e5
_STEPS_PER_OCTAVE_BITS = 3
_MANTISSA_SHIFT = 23 - _STEPS_PER_OCTAVE_BITS
_GROWTH_RANGE = 128
"""Steps of variance, 8 per factor of 2: growth by up to 2**16 is told apart."""
CELLS = 1 << 25


def cells(curve: Curves) -> Indices:
    """Cell of each star. Comparisons of bits, no logarithms: the same on every machine.

    Parameters
    ----------
    curve : ndarray, shape (n, 3)
        Error curves, from `mountnav.catalog.packed.error_classes.error_curve`.

    Returns
    -------
    ndarray of int, shape (n,)
        Below `CELLS`.
    """
    today, before, after = (_steps(curve, year) for year in CELL_EPOCHS_YR)
    growth = np.stack([before - today, after - today])
    growth = np.clip(growth + _GROWTH_RANGE, 0, 2 * _GROWTH_RANGE - 1)
    result: Indices = (today << 16) | (growth[0] << 8) | growth[1]
    return result


@dataclass(frozen=True, slots=True)
class ErrorCells:
    """How many stars each cell holds.

    Attributes
    ----------
    counts
        Shape (CELLS,).
    """

    counts: NDArray[np.uint32]

    @classmethod
    def empty(cls) -> ErrorCells:
        """No stars yet."""
        return cls(np.zeros(CELLS, dtype=np.uint32))

    def add(self, curve: Curves) -> None:
        """Count some stars.

        Parameters
        ----------
        curve : ndarray, shape (n, 3)
        """
        found, counts = np.unique(cells(curve), return_counts=True)
        self.counts[found] += counts.astype(np.uint32)

    def classified(self) -> CellClasses:
        """Share the cells out among at most 256 classes.

        As `mountnav.catalog.packed.error_classes.classify` does with stars: split the widest group at its
        middle, later the one with the largest scatter at its mean.
        """
        occupied = np.flatnonzero(self.counts)
        weight = self.counts[occupied].astype(np.int64)
        today = occupied >> 16
        before = today + ((occupied >> 8) & 255) - _GROWTH_RANGE
        after = today + (occupied & 255) - _GROWTH_RANGE
        features = np.stack([today, before, after], axis=1)
        groups = [_Group.of(np.arange(occupied.size), features, weight)]
        while len(groups) < MOST_CLASSES:
            by_width = len(groups) < CLASSES_BY_WIDTH
            worst = max(groups, key=_Group.widest if by_width else _Group.most_scattered)
            if worst.widest() == 0:
                break
            values = features[worst.members]
            if by_width:
                axis = int(np.argmax(worst.width))
                middle = (int(values[:, axis].min()) + int(values[:, axis].max())) // 2
            else:
                axis = int(np.argmax(worst.scatter))
                own = weight[worst.members]
                middle = int((own * values[:, axis]).sum()) // int(own.sum())
            lower = values[:, axis] <= middle
            groups.remove(worst)
            groups += [_Group.of(worst.members[half], features, weight) for half in (lower, ~lower)]
        code = np.zeros(CELLS, dtype=np.uint8)
        for number, group in enumerate(groups):
            code[occupied[group.members]] = number
        return CellClasses(code, np.zeros((len(groups), 4)))


@dataclass(frozen=True, slots=True)
class CellClasses:
    """The class of each cell, and the sums that make the classes' parameters.

    Attributes
    ----------
    code
        Shape (CELLS,).
    sums
        Shape (k, 4): of the curves' coefficients, and the number of stars.
    """

    code: NDArray[np.uint8]
    sums: Array

    @property
    def count(self) -> int:
        """How many classes there are."""
        return int(self.sums.shape[0])

    def assign(self, curve: Curves) -> NDArray[np.uint8]:
        """Class of each star; it is counted in.

        Sums run on from star to star, so that it doesn't matter how the stars are cut into blocks.

        Parameters
        ----------
        curve : ndarray, shape (n, 3)

        Returns
        -------
        ndarray of uint8, shape (n,)
        """
        code: NDArray[np.uint8] = self.code[cells(curve)]
        numbers = np.concatenate((np.arange(self.count), code))
        for column in range(3):
            weights = np.concatenate((self.sums[:, column], curve[:, column]))
            self.sums[:, column] = np.bincount(numbers, weights=weights, minlength=self.count)
        self.sums[:, 3] += np.bincount(code, minlength=self.count)
        return code

    def parameters(self) -> NDArray[np.float32]:
        """Mean curve of each class as sigma [mas], mean epoch [yr], sigma of the proper motion [mas/yr].

        Returns
        -------
        ndarray of float32, shape (k, 3)
        """
        means = self.sums[:, :3] / np.maximum(self.sums[:, 3:], 1.0)
        return np.array([class_parameters(mean) for mean in means], dtype=CLASS).reshape(-1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Cells of one class in the making; width and weighted squared scatter of each feature, in steps."""

    members: Indices
    width: tuple[int, ...]
    scatter: tuple[int, ...]

    @classmethod
    def of(cls, members: Indices, features: Indices, weight: Indices) -> _Group:
        own, heavy = features[members], weight[members][:, np.newaxis]
        width = own.max(axis=0) - own.min(axis=0)
        mean = (own * heavy).sum(axis=0) // heavy.sum()
        scatter = ((own - mean) ** 2 * heavy).sum(axis=0)
        return cls(members, tuple(int(v) for v in width), tuple(int(v) for v in scatter))

    def widest(self) -> int:
        return max(self.width)

    def most_scattered(self) -> int:
        return max(self.scatter)


def _steps(curve: Curves, year: float) -> Indices:
    """Variance at a year in steps, eight per factor of 2: the upper bits of a floating point number."""
    t = year - REFERENCE_YR
    wide = curve.astype(np.float64)
    variance = wide[:, 0] + wide[:, 1] * t + wide[:, 2] * (t * t)
    bits = np.clip(variance, SMALLEST_MAS**2, LARGEST_MAS**2).astype(np.float32).view(np.uint32)
    lowest = np.float32(SMALLEST_MAS**2).view(np.uint32) >> _MANTISSA_SHIFT
    return (bits >> _MANTISSA_SHIFT).astype(np.int64) - int(lowest)
