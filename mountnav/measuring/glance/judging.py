"""What the moments of a glance's sources tell: which are stars, hot pixels, streaks; and their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mountnav.measuring.glance.patches import Moments
from mountnav.measuring.measurements import Flag
from mountnav.measuring.star_shape import FWHM_PER_SIGMA

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# as in `flags`
_TOO_NARROW = 0.62
_TOO_WIDE = 2.0
_TOO_LONG = 0.25
_LEAST_ELLIPTICITY = 0.4
_CLEAR_SNR = 15.0
_TYPICAL_STARS = 120


@dataclass(frozen=True, slots=True)
class Shapes:
    """Sizes by moments, each array of shape (n,): full widths with the pixels' own, angles from +x to +y."""

    minor_fwhm_px: Array
    major_fwhm_px: Array
    angle_deg: Array

    @classmethod
    def of(cls, moments: Moments) -> Shapes:
        """Turn second moments into widths of a Gaussian."""
        mean, swing = 0.5 * (moments.xx + moments.yy), 0.5 * (moments.xx - moments.yy)
        radius = np.hypot(swing, moments.xy)
        angle = 0.5 * np.degrees(np.arctan2(moments.xy, swing))
        minor, major = np.sqrt(np.maximum(mean - radius, 1e-6)), np.sqrt(np.maximum(mean + radius, 1e-6))
        return cls(FWHM_PER_SIGMA * minor, FWHM_PER_SIGMA * major, np.where(angle >= 90.0, -90.0, angle))

    @property
    def fwhm_px(self) -> Array:
        """Geometric mean of both."""
        return np.asarray(np.sqrt(self.minor_fwhm_px * self.major_fwhm_px))

    @property
    def ellipticity(self) -> Array:
        """One minus minor over major."""
        return np.asarray(1.0 - self.minor_fwhm_px / self.major_fwhm_px)


@dataclass(frozen=True, slots=True)
class Typical:
    """The typical star's width and ellipticity, and of how many stars they are the medians."""

    fwhm_px: float
    ellipticity: float
    stars: int


def typical_of(shapes: Shapes, clean: Mask, snr: Array) -> Typical:
    """Medians over clean sources."""
    some = np.flatnonzero(clean & (snr > _CLEAR_SNR))
    if some.size > _TYPICAL_STARS:  # not the brightest alone: stretched pictures swell those
        some = some[np.linspace(0, some.size - 1, _TYPICAL_STARS).astype(np.intp)]
    if some.size == 0:
        return Typical(float("nan"), 0.0, 0)
    fwhm, ellipticity = shapes.fwhm_px[some], shapes.ellipticity[some]
    return Typical(float(np.median(fwhm)), float(np.median(ellipticity)), int(some.size))


def flags_of(
    shapes: Shapes, typical: Typical, snr: Array, *, full: Mask, edge: Mask, odd: Mask, neighbor_px: Array
) -> NDArray[np.int64]:
    """Flag sources by the same bounds as `flags.judge`, as far as moments can tell.

    Parameters
    ----------
    shapes : Shapes
    typical : Typical
    snr : ndarray, shape (n,)
        Flux over its error.
    full, edge, odd : ndarray of bool, shape (n,)
        Saturated; near the rim; no star for other reasons.
    neighbor_px : ndarray, shape (n,)
        Distance to the nearest other source.

    Returns
    -------
    ndarray of int64, shape (n,)
    """
    slack = 2.0 / np.maximum(snr, 1.0)
    flags = np.zeros(snr.size, dtype=np.int64)
    flags[full] |= Flag.SATURATED
    flags[edge] |= Flag.EDGE
    narrow = (
        shapes.minor_fwhm_px * (1.0 + slack)
        < _TOO_NARROW * typical.fwhm_px * (1.0 - typical.ellipticity) ** 0.5
    )
    wide = shapes.fwhm_px * (1.0 - slack) > _TOO_WIDE * typical.fwhm_px
    flags[(narrow | wide | odd) & ~full] |= Flag.NO_PEAK
    long = shapes.ellipticity > max(_LEAST_ELLIPTICITY, typical.ellipticity + _TOO_LONG) + slack
    flags[long] |= Flag.ELONGATED
    flags[neighbor_px < 1.5 * typical.fwhm_px + 1.0] |= Flag.BLENDED
    return flags


def place_errors(
    moments: Moments, flux: Array, noise: Array, gain_e_adu: float, floor_px: Array
) -> tuple[Array, Array, Array]:
    """Errors of centroids and fluxes as a Gaussian's fit would have them, and no less than a floor.

    Parameters
    ----------
    moments : Moments
    flux, noise : ndarray, shape (n,)
        In ADU; the noise per pixel.
    gain_e_adu : float
    floor_px : ndarray, shape (n,)

    Returns
    -------
    x_sigma_px, y_sigma_px, flux_sigma : ndarray, shape (n,)
    """
    light = np.maximum(flux, 1e-9)
    area = np.sqrt(np.maximum(moments.xx * moments.yy - moments.xy**2, 1e-6))
    sky = 8.0 * np.pi * area * (noise / light) ** 2 + 1.0 / (light * gain_e_adu)
    x = np.sqrt(moments.xx * sky + floor_px**2)
    y = np.sqrt(moments.yy * sky + floor_px**2)
    return x, y, np.sqrt(4.0 * np.pi * area * noise**2 + light / gain_e_adu)


def nearest_px(x_px: Array, y_px: Array) -> Array:
    """Distance of each place to the nearest other one, shape (n,)."""
    if x_px.size < 2:
        return np.full(x_px.size, np.inf)
    places = np.column_stack([x_px, y_px])
    distance, _ = KDTree(places).query(places, k=2)
    return np.asarray(distance, dtype=np.float64)[:, 1]


def first_of_twins(x_px: Array, y_px: Array, reach_px: float) -> Mask:
    """Tell which of several sources at the same place comes first, shape (n,)."""
    keep = np.ones(x_px.size, dtype=bool)
    if x_px.size > 1:
        pairs = KDTree(np.column_stack([x_px, y_px])).query_pairs(reach_px, output_type="ndarray")
        keep[pairs.max(axis=1)] = False
    return keep


def edge_of(x_px: Array, y_px: Array, width_px: int, height_px: int, fwhm_px: float) -> Mask:
    """Tell which places are within a star's width of the rim, shape (n,)."""
    margin = max(2.0, fwhm_px)
    edge = (x_px < margin) | (y_px < margin)
    edge |= (x_px > width_px - 1 - margin) | (y_px > height_px - 1 - margin)
    return np.asarray(edge)
