"""Position errors of millions of stars in at most 256 classes: one byte tells sigma at any epoch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import CLASS, MOST_CLASSES

Array = NDArray[np.float64]

REFERENCE_YR = 2000.0
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
