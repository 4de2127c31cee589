"""How far the degree of the plate may rise: while pairs that had no part in it come out better [S23 §3.3]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.camera import CameraFit
from mountnav.identification.plate import SIMILARITY

Array = NDArray[np.float64]

FEWEST_PAIRS = {SIMILARITY: 2, 1: 5, 2: 7, 3: 7}
"""Fewest pairs for each degree. Low, because terms that the pairs don't support stay near zero anyway."""
QUADRATIC = 2
OUTLYING = 5.0


def cross_validated(fit: CameraFit, sigma_arcsec: Array) -> float:
    """RMS of the pairs' distances from plates fit without them, in units of their errors, outliers capped.

    Parameters
    ----------
    fit : CameraFit
    sigma_arcsec : ndarray, shape (n,)
        The same for all fits that are to be compared.

    Returns
    -------
    float
    """
    apart = fit.influence.apart_arcsec / sigma_arcsec
    return float(np.sqrt(np.mean(np.minimum(apart, OUTLYING * np.median(apart)) ** 2)))


def gains(lower: CameraFit, higher: CameraFit, share: float) -> bool:
    """Whether the higher degree's cross-validated residual is below a share of the lower one's.

    Parameters
    ----------
    lower, higher : CameraFit
        Of the same pairs.
    share : float

    Returns
    -------
    bool
    """
    sigma = higher.sigma_arcsec
    return cross_validated(higher, sigma) <= share * cross_validated(lower, sigma)


def required_share(lower: CameraFit, gain: float) -> float:
    """How far the cross-validated residual must fall for a degree to rise.

    Parameters
    ----------
    lower : CameraFit
    gain : float
        The share asked for in general.

    Returns
    -------
    float
        `gain`; 1.02 for the step from quadratic to cubic. In a corner of the frame a radial distortion looks
        quadratic, and a quadratic is wild elsewhere: the cubic, which knows of radial distortions, need not
        be better there, only no worse.
    """
    return 1.02 if lower.plate.degree == QUADRATIC else gain
