"""What a star looks like: the PSF that all stars of a frame share, and the ellipse of one [S23 §0.2]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Reals = NDArray[np.floating[Any]]

#: Full width at half maximum over sigma of a Gaussian.
FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
#: Squared FWHM that a pixel's own width adds to an image's: 8 ln 2 / 12.
PIXEL_FWHM2 = 8.0 * np.log(2.0) / 12.0
LEAST_VARIANCE_PX2 = 0.03
"""Least variance of a star's image along an axis once the pixels' own (1/12) is taken off, px²: a FWHM of
0.41 px. Noise makes some narrow stars narrower than a pixel; zero would divide by it."""
MOST_WING = 0.5
"""Fattest wings that are fitted: a Moffat exponent of 2. At 1 the PSF would hold infinite light. Halved,
fluxes of painted Moffat stars scatter by 21 % more; doubled, nothing changed on the frames that were
tried."""
NODES = (np.sqrt(0.6) / 2.0 * np.array([-1.0, 0.0, 1.0])).astype(np.float32)
"""Offsets of the three-point Gauss-Legendre rule over a pixel, px: ± √0.6 / 2 and 0 (Abramowitz and Stegun,
table 25.4)."""
NODE_WEIGHTS = (np.array([5.0, 8.0, 5.0]) / 18.0).astype(np.float32)
"""And its weights: 5, 8 and 5 eighteenths."""


def without_pixel_width(fwhm2: Array) -> Array:
    """FWHM of the image itself, px, from the squared FWHM measured: without the pixels' own width."""
    return np.asarray(np.sqrt(np.maximum(fwhm2 - PIXEL_FWHM2, 0.04 * fwhm2)))


@dataclass(frozen=True, slots=True)
class Psf:
    """What all stars of a frame share: the fall of the wings, and how the pixels' noise grows with light.

    The PSF is (1 + wing Q / 2)^(-1 / wing), a Moffat function of exponent 1 / wing, and exp(-Q / 2) at
    wing = 0, where Q is the squared distance in widths.

    Attributes
    ----------
    wing : float
        0 for a Gaussian, 0.3 for typical seeing.
    gain_e_adu : float
        Electrons per ADU.
    misfit : float
        Rms of what the model doesn't explain, as a share of the light in the pixel.
    integrated : bool
        Integrate over the pixels; for stars so narrow that their value at the pixel's center won't do.
    """

    wing: float = 0.0
    gain_e_adu: float = 1.0
    misfit: float = 0.0
    integrated: bool = False

    def of(self, q: Array) -> tuple[Array, Array]:
        """Return the PSF and -2 times its derivative at squared distances ``q``."""
        if self.wing < 1e-3:
            psf = np.exp(-0.5 * q)
            return psf, psf
        inner = 1.0 + (0.5 * self.wing) * q
        psf = np.exp(np.log(inner) * (-1.0 / self.wing))
        return psf, psf / inner

    @property
    def fwhm_per_width(self) -> float:
        """Full width at half maximum over the width in Q."""
        if self.wing < 1e-3:
            return float(FWHM_PER_SIGMA)
        return float(2.0 * np.sqrt(2.0 * (2.0**self.wing - 1.0) / self.wing))

    @property
    def volume(self) -> float:
        """Integral of the PSF of unit width."""
        return float(2.0 * np.pi / (1.0 - self.wing))

    def variance(self, sky_variance: Reals, light: Reals) -> Array:
        """Return the variance of pixels that hold sky and some light of a star."""
        light = np.maximum(light, 0.0)  # a fit may dip below the sky
        return np.asarray(sky_variance + light / self.gain_e_adu + (self.misfit * light) ** 2)


@dataclass(frozen=True, slots=True)
class ShapePrior:
    """The typical star's p, q, r, and how far a fit may stray from them: for those whose own is unknown.

    ``slack`` is the one-sigma share of p and r, and of their mean for q: one for all, or one each.
    """

    p: float
    q: float
    r: float
    slack: float | Array

    @classmethod
    def round(cls, fwhm_px: float, psf: Psf) -> ShapePrior:
        """A round star that looks so wide."""
        inverse = (psf.fwhm_per_width / fwhm_px) ** 2
        return cls(inverse, 0.0, inverse, 1.0)

    def precision(self) -> Array:
        """Inverse variances of p, q, r, shape (3,) or (n, 3)."""
        scale = np.array([self.p, 0.5 * (self.p + self.r), self.r])
        slack = np.asarray(self.slack, dtype=np.float64)
        return np.asarray(1.0 / (slack[..., None] * scale) ** 2)
