"""Random numbers that belong to things: the same for a star whenever and in whatever company it is met."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Array = NDArray[np.float64]
Bits = NDArray[np.uint64]


def mixed(bits: Bits) -> Bits:
    """Splitmix64's step: neighboring numbers in, unrelated numbers out."""
    bits = bits + np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(bits ^ (bits >> np.uint64(31)))


def salted(bits: Bits, salt: int) -> Bits:
    """Numbers that have nothing to do with those of another salt.

    Parameters
    ----------
    salt : int
        Any; negative ones too.
    """
    return mixed(bits ^ mixed(np.array([salt % 2**64], dtype=np.uint64)))


def uniform(bits: Bits, salt: int) -> Array:
    """Evenly in (0, 1), one for each number.

    Parameters
    ----------
    bits : ndarray of uint64
        Who it is for.
    salt : int
        What it is for.
    """
    return np.asarray(((salted(bits, salt) >> np.uint64(12)).astype(np.float64) + 0.5) / 2.0**52)


def normal(bits: Bits, salt: int) -> Array:
    """Standard normal deviates; parameters as for `uniform`."""
    return np.asarray(ndtri(uniform(bits, salt)))
