"""Position errors of millions of stars in at most 256 classes: one byte gives sigma at any epoch.

Error classes for catalogs larger than memory: stars are counted in cells, and the cells are classified.

A cell holds the stars whose sigma is the same, to 3 %, at three epochs. Every star of the catalog is counted,
none is sampled: so no monstrous error is overlooked, and the order in which stars come doesn't matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import CLASS, MOST_CLASSES

Array = NDArray[np.float64]

REFERENCE_YR = 2000.0
"""Julian year from which the polynomials of variance over time count. Another gives the same curves, rounded
differently: other bytes in a packed file, the same sigmas."""
FEATURE_EPOCHS_YR = (1992.0, 2015.0, 2030.0, 2050.0)
"""Where two stars must have like sigmas to share a class: the catalog's own epoch, and the years of use."""
CLASSES_BY_WIDTH = 96
"""Of 256; measured on Tycho-2: with none the worst star's sigma is 13 times too small, with 96 it is 0.64."""
FEATURE_STEP = 1e-4
"""Features are whole steps of ln(sigma): sums are exact, so the classes don't depend on the machine."""


def error_curve(
    sigma_mas: tuple[Array, Array], sigma_pm_mas_yr: tuple[Array, Array], mean_epoch_yr: tuple[Array, Array]
) -> Array:
    """Variance per coordinate as a parabola of time, mean of the RA* and Dec coordinates.

    Each coordinate has ``sigma²(T) = e² + ((T - Ep) e_pm)²`` [CATALOGS, Formats §1]; the mean of two
    parabolas is a parabola, so nothing is lost here.

    Parameters
    ----------
    sigma_mas, sigma_pm_mas_yr, mean_epoch_yr : pair of arrays, shape (n,)
        e, e_pm and Ep in RA* and in Dec.

    Returns
    -------
    ndarray, shape (n, 3)
        Coefficients c0, c1, c2 of ``c0 + c1 t + c2 t²`` [mas²], t = T - 2000.
    """
    curve = np.zeros((sigma_mas[0].size, 3))
    for sigma, sigma_pm, epoch in zip(sigma_mas, sigma_pm_mas_yr, mean_epoch_yr, strict=True):
        t = epoch - REFERENCE_YR
        curve[:, 0] += 0.5 * (sigma**2 + (sigma_pm * t) ** 2)
        curve[:, 1] += -1.0 * sigma_pm**2 * t
        curve[:, 2] += 0.5 * sigma_pm**2
    return curve


def classify(curve: Array) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Group stars whose sigma runs alike over the years.

    One group is split again and again until there are 256: at first the widest, at the middle of its width
    (so that the few stars with monstrous errors get classes of their own), then the one with the largest
    scatter, at its mean. Both are those of ln(sigma) at `FEATURE_EPOCHS_YR`. A class has the mean
    parabola of its members.

    Parameters
    ----------
    curve : ndarray, shape (n, 3)
        From `error_curve`; n >= 1.

    Returns
    -------
    code : ndarray of uint8, shape (n,)
        Class of each star.
    classes : ndarray of float32, shape (k, 3)
        Sigma at the mean epoch [mas], mean epoch [yr], sigma of the proper motion [mas/yr]; k <= 256.
    """
    t = np.array(FEATURE_EPOCHS_YR) - REFERENCE_YR
    variance = curve[:, :1] + curve[:, 1:2] * t + curve[:, 2:] * t**2
    features = np.rint(0.5 * np.log(variance) / FEATURE_STEP).astype(np.int64)
    groups = [_Group.of(np.arange(curve.shape[0]), features)]
    while len(groups) < MOST_CLASSES:
        by_width = len(groups) < CLASSES_BY_WIDTH
        worst = max(groups, key=_Group.widest if by_width else _Group.most_scattered)
        if worst.widest() == 0:
            break
        axis = int(np.argmax(worst.width if by_width else worst.scatter))
        values = features[worst.members, axis]
        middle = (
            (int(values.min()) + int(values.max())) // 2 if by_width else int(values.sum()) // values.size
        )
        groups.remove(worst)
        groups += [_Group.of(worst.members[half], features) for half in (values <= middle, values > middle)]
    code = np.zeros(curve.shape[0], dtype=np.uint8)
    classes = np.zeros((len(groups), 3), dtype=CLASS)
    for number, group in enumerate(groups):
        code[group.members] = number
        classes[number] = class_parameters(curve[group.members].mean(axis=0))
    return code, classes


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Stars of one class in the making; width and squared scatter of each feature, in whole steps."""

    members: NDArray[np.int64]
    width: tuple[int, ...]
    scatter: tuple[int, ...]

    @classmethod
    def of(cls, members: NDArray[np.int64], features: NDArray[np.int64]) -> _Group:
        own = features[members]
        width = own.max(axis=0) - own.min(axis=0)
        scatter = ((own - own.sum(axis=0) // members.size) ** 2).sum(axis=0)
        return cls(members, tuple(int(v) for v in width), tuple(int(v) for v in scatter))

    def widest(self) -> int:
        return max(self.width)

    def most_scattered(self) -> int:
        return max(self.scatter)


def class_parameters(curve: Array) -> tuple[float, float, float]:
    """What a class says of its members' mean curve.

    Parameters
    ----------
    curve : ndarray, shape (3,)
        From `error_curve`.

    Returns
    -------
    (float, float, float)
        Sigma at the mean epoch [mas], mean epoch [yr], sigma of the proper motion [mas/yr].
    """
    c0, c1, c2 = (float(c) for c in curve)
    if c2 <= 0.0:
        return float(np.sqrt(c0)), REFERENCE_YR, 0.0
    t = -0.5 * c1 / c2
    return float(np.sqrt(max(c0 - c2 * t * t, 0.0))), REFERENCE_YR + t, float(np.sqrt(c2))


_MAG = (4.5, 5.5, 6.5, 7.5, 8.5, 9.5, 10.5, 11.5, 12.5)
"""Magnitudes of the table below."""
_MAS_YR = (47.0, 38.0, 29.0, 22.5, 17.4, 13.9, 11.6, 10.8, 10.5)
"""68.3 % of the Tycho-2 stars of that magnitude move less, per coordinate (tools/build_tycho2.py). Fainter
stars move less than the last ones, so theirs is a cautious figure."""


def unknown_motion_mas_yr(mag: Array) -> Array:
    """Typical proper motion per coordinate, to stand in for the error of an unknown one.

    Parameters
    ----------
    mag : ndarray, shape (n,)
        V magnitudes.

    Returns
    -------
    ndarray, shape (n,)
        mas/yr.
    """
    return np.interp(mag, _MAG, _MAS_YR)


Curves = NDArray[np.float32]
Indices = NDArray[np.int64]

CELL_EPOCHS_YR = (2020.0, 1995.0, 2045.0)
"""The first tells how large an error is, the others how it grows before and after."""
SMALLEST_MAS, LARGEST_MAS = 0.005, 1e5
"""Sigmas that cells tell apart, mas: from below Gaia's best to 100″; what lies beyond counts as the limit."""
_STEPS_PER_OCTAVE_BITS = 3
"""Eight steps for each factor of 2 in the variance, so that cells are 3 to 6 % wide in sigma: more of them
would no longer fit `CELLS`."""
_MANTISSA_SHIFT = 23 - _STEPS_PER_OCTAVE_BITS
"""A 32-bit float's bits, shifted by so much, count those steps: 23 bits of mantissa less 3."""
_GROWTH_RANGE = 128
"""Steps of variance, 8 per factor of 2: growth by up to 2**16 is told apart."""
CELLS = 1 << 25
"""Number of cells, 512 sizes times 256 by 256 growths; their counters take 128 MiB."""


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
            Sigma against time of each star, from `error_curve`.
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
        groups = [_CellGroup.of(np.arange(occupied.size), features, weight)]
        while len(groups) < MOST_CLASSES:
            by_width = len(groups) < CLASSES_BY_WIDTH
            worst = max(groups, key=_CellGroup.widest if by_width else _CellGroup.most_scattered)
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
            groups += [_CellGroup.of(worst.members[half], features, weight) for half in (lower, ~lower)]
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
            Sigma against time of each star, from `error_curve`.

        Returns
        -------
        ndarray of uint8, shape (n,)
            Number of the class.
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
            A row a class.
        """
        means = self.sums[:, :3] / np.maximum(self.sums[:, 3:], 1.0)
        return np.array([class_parameters(mean) for mean in means], dtype=CLASS).reshape(-1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class _CellGroup:
    """Cells of one class in the making; width and weighted squared scatter of each feature, in steps."""

    members: Indices
    width: tuple[int, ...]
    scatter: tuple[int, ...]

    @classmethod
    def of(cls, members: Indices, features: Indices, weight: Indices) -> _CellGroup:
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
