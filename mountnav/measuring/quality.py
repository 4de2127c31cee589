"""SkyQuality: what a frame tells about the night: seeing, sky, depth; schedulers want it [S23 §0]."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class StarImages(StrEnum):
    """What the stars of a frame look like, by and large."""

    WELL_SAMPLED = "well sampled"
    UNDERSAMPLED = "undersampled"
    DEFOCUSED = "defocused"
    TRAILED = "trailed"
    NONE = "none seen"


@dataclass(frozen=True, slots=True)
class SkyQuality:
    """What a frame tells about the night. None means: can't be told.

    Attributes
    ----------
    stars : int
        Star-like sources measured.
    images : StarImages
        What they look like.
    fwhm_px, ellipticity, elongation_deg : float or None
        Of the typical star; the major axis is counted from +x towards +y, in [-90, 90).
    sky_adu, noise_adu : float
        Median sky level (bias included) and its noise per pixel.
    sky_gradient : float
        Largest difference of the smooth sky level over the frame, in units of the noise.
    limiting_flux_adu : float or None
        Flux of a star of typical width that stands 5 σ above the sky.
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
