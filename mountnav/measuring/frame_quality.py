"""The frame's stars summed up as SkyQuality: width, elongation, depth, what they look like [S23 §0]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Background
from mountnav.measuring.detection import SURROUND_SIGMAS
from mountnav.measuring.measurements import NO_STAR, TRAILED, SkyQuality, StarImages
from mountnav.measuring.medians import median
from mountnav.measuring.psf import LEAST_VARIANCE_PX2, Psf

Array = NDArray[np.float64]

_UNDERSAMPLED_PX = 2.0
"""FWHM below which images count as undersampled, px: Nyquist's two pixels."""
_DEFOCUSED_PX = 8.0
"""FWHM above which images count as defocused, px. Chosen by hand; a seeing of 4″ at 0.5″/px is as wide."""
_FEWEST_STARS = 3
"""Stars below which nothing is said of the images."""
_LIMIT_SIGMA = 5.0
"""Height of a star of the limiting flux in the smoothed frame: the default of
`MeasuringSettings.threshold_sigma`, also where that is set otherwise."""
_FINE = 5
"""Positions across a bin, in each direction, over which a star's height is averaged."""


def ellipse_of(p: float, q: float, r: float, fwhm_per_width: float) -> tuple[float, float, float]:
    """Return minor and major FWHM and the major axis' direction of a shape, the pixels' own width taken off.

    Parameters
    ----------
    p, q, r : float
        Of Q = p u² + 2 q u v + r v².

    Returns
    -------
    minor_fwhm_px, major_fwhm_px, angle_deg : float
        The angle from +x towards +y, in [-90, 90).
    """
    variance = np.linalg.inv(np.array([[p, q], [q, r]])) - np.eye(2) / 12.0
    values, vectors = np.linalg.eigh(variance)
    minor, major = fwhm_per_width * np.sqrt(np.maximum(values, LEAST_VARIANCE_PX2))
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    return float(minor), float(major), (angle + 90.0) % 180.0 - 90.0


def image_kind(stars: int, minor_px: float | None, major_px: float | None, *, hollow: bool) -> StarImages:
    """Name what images of such a size look like."""
    if minor_px is None or major_px is None or stars < _FEWEST_STARS:
        return StarImages.NONE
    width = float(np.sqrt(minor_px * major_px))
    if hollow:
        return StarImages.DEFOCUSED
    if 1.0 - minor_px / major_px > TRAILED:
        return StarImages.TRAILED
    if width > _DEFOCUSED_PX:
        return StarImages.DEFOCUSED
    return StarImages.UNDERSAMPLED if width < _UNDERSAMPLED_PX else StarImages.WELL_SAMPLED


def psf_image(p: float, q: float, r: float, psf: Psf, half_px: int) -> Array:
    """Return the pixels of a star of unit flux centered on the middle pixel, shape (side, side)."""
    offset = np.arange(-half_px, half_px + 1, dtype=np.float64)
    u, v = offset[None, :], offset[:, None]
    height, _ = psf.of(p * u * u + 2.0 * q * u * v + r * v * v)
    return np.asarray(height * np.sqrt(p * r - q * q) / psf.volume)


def limiting_flux(star: Array, noise: float, noise_ratio: float, sigma_px: float, bin_px: int) -> float:
    """Flux at which a star stands 5 σ above the smoothed sky.

    Parameters
    ----------
    star : ndarray, shape (side, side)
        Of unit flux, in the middle.
    noise : float
        Per pixel.
    noise_ratio : float
        Noise of the smoothed frame over that of independent pixels smoothed alike.
    sigma_px : float
        Width of the smoothing.
    bin_px : int
        The peak is looked for in bins of so many pixels, and is rarely in the middle of one.
    """
    box = 2 * round(SURROUND_SIGMAS * sigma_px / bin_px) + 1
    smoothed = _smoothed(np.pad(star, 2 * box * bin_px), sigma_px, bin_px, box)
    row, column = np.unravel_index(int(smoothed.argmax()), smoothed.shape)
    # the mean over the positions that a star may have within its bin
    steps = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    dy, dx = np.meshgrid(bin_px * steps, bin_px * steps, indexing="ij")
    seen = ndimage.map_coordinates(smoothed, [row + dy, column + dx], order=3)
    if noise_ratio > 1.0:
        spread = noise_ratio / (2.0 * np.sqrt(np.pi) * max(sigma_px / bin_px, 0.3)) / bin_px
    else:
        # what the same steps make of a single bright pixel shows what they leave of independent noise
        point = np.zeros((1, 1))
        point[0, 0] = 1.0
        answer = _smoothed(np.pad(point, 3 * box * bin_px), sigma_px, bin_px, box)
        spread = np.sqrt((answer**2).sum())
    return float(_LIMIT_SIGMA * noise * spread / seen.mean())


def matched_limit(star: Array, noise: float, noise_ratio: float) -> float:
    """Flux at which a star stands 5 σ above a frame smoothed with its own image of unit flux."""
    return float(_LIMIT_SIGMA * noise * noise_ratio / np.sqrt((star**2).sum()))


def _smoothed(image: Array, sigma_px: float, bin_px: int, box: int) -> Array:
    """Do what `detection.smooth` does to something faint: its surroundings go, and a part of it with them."""
    if bin_px == 2:
        image = ndimage.uniform_filter(image, 2, mode="constant")
    smoothed = ndimage.gaussian_filter(image, sigma_px, mode="constant", truncate=2.5)
    surround = ndimage.uniform_filter(smoothed, box * bin_px, mode="constant")
    return np.asarray(smoothed - ndimage.uniform_filter(surround, box * bin_px, mode="constant"))


def sky_quality(
    background: Background,
    flags: NDArray[np.int64],
    saturated_share: float,
    ellipse: tuple[float, float, float] | None,
    *,
    hollow: bool,
    limit: float | None,
) -> SkyQuality:
    """Put a frame's SkyQuality together.

    Parameters
    ----------
    flags : ndarray of int64, shape (n,)
        Of the measurements.
    ellipse : tuple or None
        From `ellipse_of`, of the typical star.
    hollow : bool
        The typical star is a ring.
    limit : float or None
        From `limiting_flux`.
    """
    stars = int(np.count_nonzero((flags & NO_STAR) == 0))
    minor, major, angle = ellipse if ellipse is not None else (None, None, None)
    kind = image_kind(stars, minor, major, hollow=hollow)
    noise = median(background.noise)
    known = minor is not None and major is not None and kind is not StarImages.NONE
    return SkyQuality(
        stars=stars,
        images=kind,
        fwhm_px=float(np.sqrt(minor * major)) if known and minor and major else None,
        ellipticity=1.0 - minor / major if known and minor and major else None,
        elongation_deg=angle if known else None,
        sky_adu=median(background.level),
        noise_adu=noise,
        sky_gradient=float(np.ptp(background.level)) / noise,
        limiting_flux_adu=limit if known else None,
        saturated_share=saturated_share,
    )
