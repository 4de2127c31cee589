"""What measuring a frame gives: Measurements, their flags, and SkyQuality of the frame [S23 §0]."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntFlag, StrEnum

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.medians import median

_FEWEST_PAIRS = 3
"""Identified stars below which no zero point is stated: a median of two can't reject an outlier."""
_FAR_MAG = 0.05
"""Least scatter assumed of catalog magnitudes, mag: a handful of stars that agree by chance must not clip the
rest. Doubled or halved, only zero points of fewer than some ten stars move."""


class StarImages(StrEnum):
    """What the stars of a frame look like, by and large."""

    WELL_SAMPLED = "well sampled"
    UNDERSAMPLED = "undersampled"
    DEFOCUSED = "defocused"
    TRAILED = "trailed"
    NONE = "none seen"


_SIGMA_OF_FWHM = 1.0 / 2.3548
"""Of a Gaussian. 2 √(2 ln 2), a constant of mathematics."""


@dataclass(frozen=True, slots=True)
class SkyQuality:
    """What a frame shows of the night. None means: not known.

    Attributes
    ----------
    stars : int
        Star-like sources measured; of a frame solved by its fast measurement alone those that this one found,
        at most 200.
    images : StarImages
        What they look like.
    fwhm_px, ellipticity, elongation_deg : float or None
        Of the typical star; the major axis is counted from +x towards +y, in [-90, 90).
    sky_adu, noise_adu : float
        Median sky level (bias included) and its noise per pixel.
    sky_gradient : float
        Largest difference of the smooth sky level over the frame, in units of the noise.
    limiting_flux_adu : float or None
        Flux of a star of typical width that stands 5 σ above the smoothed sky, where detection sets in.
    saturated_share : float
        Share of saturated pixels.
    fwhm_arcsec, zero_point_mag, limiting_mag, sky_mag_arcsec2 : float or None
        Only of a solved frame: width on the sky, magnitude of a star of 1 ADU, the faintest magnitude,
        surface brightness of the sky (None without a known bias level).
    """

    stars: int
    images: StarImages
    fwhm_px: float | None
    ellipticity: float | None
    elongation_deg: float | None
    sky_adu: float
    noise_adu: float
    sky_gradient: float
    limiting_flux_adu: float | None
    saturated_share: float
    fwhm_arcsec: float | None = None
    zero_point_mag: float | None = None
    limiting_mag: float | None = None
    sky_mag_arcsec2: float | None = None

    @property
    def trail_px(self) -> float | None:
        """Length of the trail that gives the typical star its two widths; None if these aren't known.

        Poor optics draw stars out as well: no trail is longer.
        """
        if self.images in (StarImages.DEFOCUSED, StarImages.NONE):
            return None
        if self.fwhm_px is None or self.ellipticity is None:
            return None
        axes_ratio = max(1.0 - self.ellipticity, 0.01)
        # a trail of length L adds L² / 12 to the variance along it
        return self.fwhm_px * _SIGMA_OF_FWHM * math.sqrt(12.0 * (1.0 / axes_ratio - axes_ratio))


def with_plate(
    quality: SkyQuality,
    *,
    scale_arcsec_px: float,
    mag: NDArray[np.float64],
    flux: NDArray[np.float64],
    bias_adu: float | None = None,
) -> SkyQuality:
    """Fill in what needs a solved frame.

    Parameters
    ----------
    quality : SkyQuality
        From `measure`.
    mag, flux : ndarray, shape (n,)
        Catalog magnitudes and fluxes (ADU) of identified, unsaturated stars; what isn't finite or positive
        is passed over.
    bias_adu : float, optional
        Level of an unlit pixel; the sky's surface brightness isn't known without.

    Returns
    -------
    SkyQuality
        The zero point is that of the whole exposure: the magnitude of a star that gave 1 ADU in it.
    """
    mag, flux = np.asarray(mag, dtype=np.float64), np.asarray(flux, dtype=np.float64)
    usable = np.isfinite(mag) & np.isfinite(flux) & (flux > 0)
    fwhm = None if quality.fwhm_px is None else quality.fwhm_px * scale_arcsec_px
    if usable.sum() < _FEWEST_PAIRS:
        return replace(quality, fwhm_arcsec=fwhm)
    zero_point = _clipped_median(mag[usable] + 2.5 * np.log10(flux[usable]))
    limit = quality.limiting_flux_adu
    sky = None if bias_adu is None else quality.sky_adu - bias_adu
    return replace(
        quality,
        fwhm_arcsec=fwhm,
        zero_point_mag=zero_point,
        limiting_mag=None if limit is None or limit <= 0 else float(zero_point - 2.5 * np.log10(limit)),
        sky_mag_arcsec2=None
        if sky is None or sky <= 0
        else float(zero_point - 2.5 * np.log10(sky / scale_arcsec_px**2)),
    )


def _clipped_median(values: NDArray[np.float64]) -> float:
    """Median of what lies within three sigma of the median, sigma from the quartiles."""
    low, middle, high = np.percentile(values, [25.0, 50.0, 75.0])
    near = np.abs(values - middle) <= 3.0 * max(0.7413 * (high - low), _FAR_MAG)
    return median(values[near])


Array = NDArray[np.float64]


class Flag(IntFlag):
    """Why a measurement deserves less trust; later steps reject by these."""

    SATURATED = 1
    EDGE = 2
    ELONGATED = 4
    NO_PEAK = 8  # hot pixel, cosmic ray, flat top: no stellar profile
    BLENDED = 16
    TRAIL = 32
    BLEED = 64


NO_STAR = int(Flag.NO_PEAK | Flag.TRAIL | Flag.BLEED)
"""The flags of what is no star: such sources are neither counted as stars nor summed up in `SkyQuality`."""
TYPICAL_SNR = 15.0
"""Flux over its error above which a clean source counts for the frame's typical star; chosen by hand.
Doubled or halved, no figure of the crowded frames changed by 3 %."""
TOO_NARROW = 0.62
"""Minor axis over the typical star's below which a source is no star but a hot pixel or a ray; chosen by
hand. At 0.81, 4 of 136 faint painted stars and 11 of 339 sources of a tetra3 frame are flagged in addition;
at 0.24, three sources of noise pass."""
TOO_WIDE = 2.0
"""Width over the typical star's above which a source is no star but a knot, a galaxy or a blend; chosen by
hand. Doubled, nothing changed on the frames that were tried; halved, one star in 28 of C00 is lost."""
TOO_LONG = 0.25
"""Ellipticity beyond the typical star's that makes a source elongated, where the frame itself is not trailed;
chosen by hand. Doubled, 2 of 4 elongated sources of C00 pass."""
LEAST_ELLIPTICITY = 0.4
"""Ellipticity below which no source is called elongated (major over minor axis 1.7): tails of noise reach it;
chosen by hand. Doubled, none of C00's sources is elongated; halved, five are instead of four."""
TRAILED = 0.4
"""Ellipticity of the typical star (major over minor axis 1.7) from which all stars of the frame count as
trailed; chosen by hand. Doubled, nothing changed on the frames that were tried; halved, 4 of 26 knots of a
painted nebula become elongated."""
POOR_FIT = 0.15
"""Residuals' rms in the core, as a share of the amplitude, above which a fit is no star's; chosen by hand.
Doubled, 3 of 4 non-stars of a tetra3 frame pass; halved, the fast fits lose 2 of 126 and 4 of 122 painted
stars."""
RESTLESS = 4.0
"""Local noise over that of the frame's quiet quarter above which a position is likely a tree, a roof or the
heart of a nebula; chosen by hand. Halved, stars in an amplifier's glow are lost (3 of 22 painted ones)."""
LEAST_FLUX_SIGMA = 2.5
"""Flux over its error that a fit must keep to be listed: the search asks for 5 in the smoothed frame, and the
fit of a faint star may end lower. Doubled, 16 of 126 painted faint stars are lost; halved, one false source
came in the frames that were tried."""


@dataclass(frozen=True, slots=True)
class Measurements:
    """Detected sources, brightest first; each array has shape (n,).

    Attributes
    ----------
    x_px, y_px
        Centroid, 0-based; the center of the file's first pixel is (0, 0).
    x_sigma_px, y_sigma_px
        One-sigma centroid errors.
    flux
        Background-subtracted flux, ADU.
    flux_sigma
        Its error.
    fwhm_px, ellipticity
        Shape of the fitted profile.
    flags
        `Flag` bits (int64).
    width_px, height_px
        Size of the frame.
    background_adu, noise_adu
        Median sky level and its noise per pixel.
    elongation_deg
        Direction of the major axis, from +x towards +y, in [-90, 90); shape (n,), or None if not measured.
    quality
        What the frame shows of the night; None for lists that no frame was measured for.
    """

    x_px: Array
    y_px: Array
    x_sigma_px: Array
    y_sigma_px: Array
    flux: Array
    flux_sigma: Array
    fwhm_px: Array
    ellipticity: Array
    flags: NDArray[np.int64]
    width_px: int
    height_px: int
    background_adu: float
    noise_adu: float
    elongation_deg: Array | None = None
    quality: SkyQuality | None = None

    def __len__(self) -> int:
        return int(self.x_px.size)
