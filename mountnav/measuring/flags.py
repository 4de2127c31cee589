"""Which measurements deserve less trust, judged by the frame's own typical star [S23 §0.3]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.artifacts import Artifacts
from mountnav.measuring.measurements import (
    LEAST_ELLIPTICITY,
    POOR_FIT,
    TOO_LONG,
    TOO_NARROW,
    TOO_WIDE,
    TRAILED,
    TYPICAL_SNR,
    Flag,
)
from mountnav.measuring.psf_fitting import Profiles

Array = NDArray[np.float64]

_CLEAR_OF_KNOTS = 5.0
"""On nebulae and galaxies a source below this flux over error is taken for a knot: without noise most knots
rise by 1 to 6 σ (docs/figures/artifacts.md). Doubled or halved, nothing changed on the frames that were
tried."""
_KNOT_WIDE = 1.5
"""On nebulae and galaxies a source wider than this many typical widths is taken for a knot; off them the
bound is `TOO_WIDE`. Chosen by hand on the painted skies of tests/measuring; doubled or halved, nothing
changed on the frames that were tried."""
_SWOLLEN_MISFIT = 0.1
"""Pictures whose contrast was stretched swell their brightest stars: a bright source is spared the width test
while its residuals stay below this share of the amplitude. Chosen by hand; doubled or halved, nothing changed
on the frames that were tried."""
_SWOLLEN_ELLIPTICITY = 0.2
"""And while it is rounder than this. Chosen by hand; doubled or halved, nothing changed on the frames that
were tried."""
_POOR_FIT_RATIO = 3.0
"""Residuals over the typical star's above which a fit is no star's, where the optics themselves leave more
than `POOR_FIT`. Doubled, 3 of 4 non-stars of a tetra3 frame pass; halved, one more source is flagged."""
_HOT_FWHM_PX = 0.95
"""A source narrower than this FWHM, px, is a hot pixel and says nothing of the typical star: a lit pixel
alone has 0.68 by moments. Chosen by hand."""
_ENOUGH_LIKE_STARS = 8
"""So many sources as wide as the first guess define the typical star, however many hot pixels there are
besides. Chosen by hand; doubled or halved, nothing changed on the frames that were tried."""
_LIKE_A_STAR = 0.85
"""A struck source that is between this and its inverse times the typical width still looks like a star.
Chosen by hand; at 0.7 or 0.925 nothing changed on the frames that were tried."""
_CLEAR_SNR = 15.0
"""Flux over its error below which a struck source can't prove that it is a star. Chosen by hand; doubled or
halved, nothing changed on the frames that were tried."""
_WIDE_FWHM_PX = 6.0
"""Only stars wider than this outlive a cosmic ray, px: of narrower ones a ray spoils the core. Chosen by
hand; doubled or halved, nothing changed on the frames that were tried."""


@dataclass(frozen=True, slots=True)
class FlagContext:
    """What the judgement looks at besides the fits: noise, masks, the typical width and what isn't sky.

    ``noise`` and ``restless`` have shape (n,): the noise per pixel, and whether it is so far above that of
    the frame's quiet parts that the position is likely a tree, a roof or the heart of a nebula; ``knotty``,
    of shape (n,), tells the positions on nebulae, galaxies and the like; ``struck``, likewise, the cosmic
    rays.
    """

    noise: Array
    restless: NDArray[np.bool_]
    knotty: NDArray[np.bool_]
    good: NDArray[np.bool_]
    saturated: NDArray[np.bool_]
    fwhm_px: float
    artifacts: Artifacts
    struck: NDArray[np.bool_]


def flag_sources(
    fits: Profiles, x_px: Array, y_px: Array, neighbor_px: Array, setting: FlagContext
) -> tuple[NDArray[np.int64], Array, Array]:
    """Flag each fit, and put those that ran away back to their peaks.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        The peaks they started from.
    neighbor_px : ndarray, shape (n,)
        Distance to the nearest other peak.

    Returns
    -------
    flags : ndarray of int64, shape (n,)
        Bits of `Flag`; 0: none.
    x_px, y_px : ndarray, shape (n,)
        Final positions.
    """
    height, width = setting.good.shape
    x, y = np.where(fits.converged, fits.x_px, x_px), np.where(fits.converged, fits.y_px, y_px)
    flags = np.zeros(x.size, dtype=np.int64)
    if x.size == 0:
        return flags, x, y
    reach = max(1, round(0.5 * setting.fwhm_px))
    full = _any_near(setting.saturated, x, y, reach)
    flags[full] |= Flag.SATURATED
    margin = max(2.0, setting.fwhm_px)
    edge = (x < margin) | (y < margin) | (x > width - 1 - margin) | (y > height - 1 - margin)
    edge |= _any_near(~setting.good & ~setting.saturated, x, y, 1)
    flags[edge] |= Flag.EDGE
    snr = fits.flux / np.maximum(fits.flux_sigma, 1e-12)
    slack = 2.0 / np.maximum(snr, 1.0)
    fwhm = np.sqrt(fits.minor_fwhm_px * fits.major_fwhm_px)
    typical, typical_ellipticity, typical_misfit = _typical(fits, fwhm, snr, full | edge, setting.fwhm_px)
    narrow = fits.minor_fwhm_px * (1.0 + slack) < TOO_NARROW * typical * (1.0 - typical_ellipticity) ** 0.5
    ellipticity = 1.0 - fits.minor_fwhm_px / fits.major_fwhm_px
    # stretched pictures swell their brightest stars, round and well fitted as they are
    top = np.percentile(fits.amplitude, 99.0)
    swollen = (
        (fits.amplitude > 0.5 * top) & (fits.misfit < _SWOLLEN_MISFIT) & (ellipticity < _SWOLLEN_ELLIPTICITY)
    )
    wide = (fwhm * (1.0 - slack) > TOO_WIDE * typical) & ~swollen
    # a nebula has knots of its own: on it a star must be clear, or at least not too wide
    knot = (
        setting.knotty & ((snr < _CLEAR_OF_KNOTS) | (fwhm * (1.0 - slack) > _KNOT_WIDE * typical)) & ~swollen
    )
    # the noise's own share of the residuals is taken off before the profile is blamed
    rest = fits.misfit - 1.5 * setting.noise / np.maximum(fits.amplitude, 1e-12)
    poor = (rest > max(POOR_FIT, _POOR_FIT_RATIO * typical_misfit)) | ~fits.converged
    flags[(narrow | wide | poor | knot | setting.restless) & ~full] |= Flag.NO_PEAK
    # where all stars are drawn out alike, all are elongated; else it takes more than the frame's own share
    odd = 0.0 if typical_ellipticity > TRAILED else typical_ellipticity + TOO_LONG
    long = ellipticity > max(LEAST_ELLIPTICITY, odd) + slack
    flags[long] |= Flag.ELONGATED
    flags[neighbor_px < 1.5 * typical + 1.0] |= Flag.BLENDED
    # a ray is masked in the fit: a wide star that it hit still looks like one, and hardly moves
    alike = (fwhm > _LIKE_A_STAR * typical) & (fwhm < typical / _LIKE_A_STAR) & (snr > _CLEAR_SNR) & ~poor
    alike &= typical > _WIDE_FWHM_PX
    flags[setting.struck & ~full & ~alike] |= Flag.NO_PEAK
    flags |= setting.artifacts.flags_at(x, y, max(2.0, setting.fwhm_px))
    return flags, x, y


def _typical(
    fits: Profiles, fwhm: Array, snr: Array, spoilt: NDArray[np.bool_], guess_px: float
) -> tuple[float, float, float]:
    """Median width, ellipticity and misfit of the clean bright fits; the guess where there are too few."""
    clean = fits.converged & ~spoilt & (snr > TYPICAL_SNR) & (fits.misfit < 0.2)
    stars = clean & (fwhm > max(_HOT_FWHM_PX, 0.6 * guess_px))
    alike = stars & (fwhm < guess_px / 0.6)
    if alike.sum() >= _ENOUGH_LIKE_STARS:  # however many hot pixels there are besides
        clean = alike
    elif stars.sum() >= max(3.0, 0.2 * clean.sum()):
        clean = stars
    if clean.sum() < 3:
        return guess_px, 0.0, 0.0
    ellipticity = 1.0 - fits.minor_fwhm_px[clean] / fits.major_fwhm_px[clean]
    return float(np.median(fwhm[clean])), float(np.median(ellipticity)), float(np.median(fits.misfit[clean]))


def _any_near(mask: NDArray[np.bool_], x: Array, y: Array, reach_px: int) -> NDArray[np.bool_]:
    """Whether a mask is set anywhere in the square round each position."""
    offset = np.arange(-reach_px, reach_px + 1)
    rows = np.clip(np.rint(y).astype(int)[:, None, None] + offset[None, :, None], 0, mask.shape[0] - 1)
    columns = np.clip(np.rint(x).astype(int)[:, None, None] + offset[None, None, :], 0, mask.shape[1] - 1)
    return np.asarray(mask[rows, columns].any(axis=(1, 2)))
