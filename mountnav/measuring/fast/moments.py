"""Centroids and second moments of sources, and the flags and errors derived from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mountnav.measuring.measurements import (
    LEAST_ELLIPTICITY,
    TOO_LONG,
    TOO_NARROW,
    TOO_WIDE,
    TYPICAL_SNR,
    Flag,
)
from mountnav.measuring.medians import median
from mountnav.measuring.psf import FWHM_PER_SIGMA

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]

_CENTROID_ROUNDS = 3
"""How often the window follows the centroid."""
_MOST_STEP_PX = 1.0
"""Largest step of the window, px: beyond it the centroid is a neighbor's."""


@dataclass(frozen=True, slots=True)
class Patches:
    """Squares of pixels, all inside the frame: near its rim the position isn't in the middle.

    Attributes
    ----------
    values : ndarray of float32, shape (n, side, side)
        The pixels, as they were cut.
    left, top : ndarray of int, shape (n,)
        Column and row of the first pixel.
    """

    values: Pixels
    left: NDArray[np.intp]
    top: NDArray[np.intp]

    @property
    def side_px(self) -> int:
        """Length of a side."""
        return int(self.values.shape[1])

    def ground(self) -> Pixels:
        """Median of each patch's outermost pixels, shape (n,)."""
        v = self.values
        rim = np.concatenate([v[:, 0, :-1], v[:, -1, 1:], v[:, 1:, 0], v[:, :-1, -1]], axis=1)
        rim.sort(axis=1)
        return np.asarray(rim[:, (rim.shape[1] - 1) // 2])


def cut_patches(pixels: NDArray[np.generic], x_px: Array, y_px: Array, half_px: int) -> Patches:
    """Cut squares of side 2 half_px + 1 round the nearest pixels of positions.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        At least as large as a patch.
    x_px, y_px : ndarray, shape (n,)
        Pixels, 0-based: the middle of the first pixel is (0, 0).
    """
    height, width = pixels.shape
    side = 2 * half_px + 1
    left = np.clip(np.rint(x_px).astype(np.intp) - half_px, 0, width - side)
    top = np.clip(np.rint(y_px).astype(np.intp) - half_px, 0, height - side)
    windows = np.lib.stride_tricks.sliding_window_view(pixels, (side, side))
    return Patches(windows[top, left].astype(np.float32), left, top)


@dataclass(frozen=True, slots=True)
class Moments:
    """Centroids and second moments under a window, each array of shape (n,).

    Attributes
    ----------
    x_px, y_px : ndarray
        Pixels of the frame.
    flux : ndarray
        As if the star were a Gaussian of the moments' size.
    xx, xy, yy : ndarray
        The star's own second moments, the window's share taken out.
    sound : ndarray of bool
        False where there was no light, or the position ran away.
    """

    x_px: Array
    y_px: Array
    flux: Array
    xx: Array
    xy: Array
    yy: Array
    sound: NDArray[np.bool_]

    def put(self, which: NDArray[np.intp], part: Moments) -> None:
        """Overwrite those of the sources ``which``, in place."""
        for name in Moments.__dataclass_fields__:
            getattr(self, name)[which] = getattr(part, name)


def windowed_moments(
    light: Pixels,
    left: NDArray[np.intp],
    top: NDArray[np.intp],
    x_px: Array,
    y_px: Array,
    sigma_px: float | Array,
    *,
    rounds: int = _CENTROID_ROUNDS,
) -> Moments:
    """Centroids under a round Gaussian window that follows them.

    Parameters
    ----------
    light : ndarray of float32, shape (n, side, side)
        Without sky.
    left, top : ndarray of int, shape (n,)
        First column and row of each patch in the frame.
    x_px, y_px : ndarray, shape (n,)
        Where to start.
    sigma_px : float or ndarray, shape (n,)
        The window's; best that of the stars.
    rounds : int, optional
        How often the window follows.
    """
    sigma_px = np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), x_px.shape)
    steps = np.arange(light.shape[1])
    start_x, start_y = x_px, y_px
    u0, v0 = left[:, None] + steps, top[:, None] + steps
    x, y = x_px.copy(), y_px.copy()
    for turn in range(rounds + 1):
        u, v = u0 - x[:, None], v0 - y[:, None]
        moment = _moments(light, u, v, sigma_px)
        total = np.maximum(moment[:, 0, 0], 1e-12)
        if turn == rounds:
            break
        # a window as wide as the star shows half of its offset
        x = x + np.clip(2.0 * moment[:, 0, 1] / total, -_MOST_STEP_PX, _MOST_STEP_PX)
        y = y + np.clip(2.0 * moment[:, 1, 0] / total, -_MOST_STEP_PX, _MOST_STEP_PX)
    dx, dy = moment[:, 0, 1] / total, moment[:, 1, 0] / total
    seen = np.empty((x.size, 2, 2))
    seen[:, 0, 0] = moment[:, 0, 2] / total - dx * dx
    seen[:, 1, 1] = moment[:, 2, 0] / total - dy * dy
    seen[:, 0, 1] = seen[:, 1, 0] = moment[:, 1, 1] / total - dx * dy
    xx, xy, yy = _without_window(seen, sigma_px)
    full = np.sqrt(np.maximum((xx + sigma_px**2) * (yy + sigma_px**2) - xy * xy, 1e-12)) / sigma_px**2
    sound = (moment[:, 0, 0] > 0.0) & (np.hypot(x - start_x, y - start_y) < np.maximum(2.0 * sigma_px, 1.5))
    return Moments(x, y, moment[:, 0, 0] * full, xx, xy, yy, np.asarray(sound))


def _moments(light: Pixels, u: Array, v: Array, sigma_px: Array) -> Array:
    """Sums of light · window · u^j · v^i, shape (n, 3, 3), i first."""
    shape = (u.shape[0], 3, u.shape[1])
    across, down = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    for table, offset in ((across, u), (down, v)):
        table[:, 0] = np.exp(offset * offset * (-0.5 / sigma_px**2)[:, None])
        np.multiply(table[:, 0], offset, out=table[:, 1], casting="unsafe")
        np.multiply(table[:, 1], offset, out=table[:, 2], casting="unsafe")
    return np.asarray(down @ (light @ across.transpose(0, 2, 1)), dtype=np.float64)


def _without_window(seen: Array, sigma_px: Array) -> tuple[Array, Array, Array]:
    """Second moments of a Gaussian from those of its product with the window; bounded where noise rules."""
    least, most = 0.02 * sigma_px**2, 0.95 * sigma_px**2
    mean, swing = 0.5 * (seen[:, 0, 0] + seen[:, 1, 1]), 0.5 * (seen[:, 0, 0] - seen[:, 1, 1])
    radius = np.hypot(swing, seen[:, 0, 1])
    major, minor = (np.clip(axis, least, most) for axis in (mean + radius, mean - radius))
    major, minor = (1.0 / (1.0 / axis - 1.0 / sigma_px**2) for axis in (major, minor))
    cosine = np.divide(swing, radius, out=np.ones_like(radius), where=radius > 0)
    sine = np.divide(seen[:, 0, 1], radius, out=np.zeros_like(radius), where=radius > 0)
    mean, swing = 0.5 * (major + minor), 0.5 * (major - minor)
    return mean + swing * cosine, swing * sine, mean - swing * cosine


Mask = NDArray[np.bool_]

_TYPICAL_STARS = 120
"""Sources at most whose medians are the typical star, spread over all magnitudes: stretched pictures swell
the brightest."""


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
    some = np.flatnonzero(clean & (snr > TYPICAL_SNR))
    if some.size > _TYPICAL_STARS:  # not the brightest alone: stretched pictures swell those
        some = some[np.linspace(0, some.size - 1, _TYPICAL_STARS).astype(np.intp)]
    if some.size == 0:
        return Typical(float("nan"), 0.0, 0)
    fwhm, ellipticity = shapes.fwhm_px[some], shapes.ellipticity[some]
    return Typical(median(fwhm), median(ellipticity), int(some.size))


def flags_of(
    shapes: Shapes, typical: Typical, snr: Array, *, full: Mask, edge: Mask, odd: Mask, neighbor_px: Array
) -> NDArray[np.int64]:
    """Flag sources by the same bounds as `flags.flag_sources`, as far as moments show them.

    Parameters
    ----------
    snr : ndarray, shape (n,)
        Flux over its error.
    full, edge, odd : ndarray of bool, shape (n,)
        Saturated; near the rim; no star for other reasons.
    neighbor_px : ndarray, shape (n,)
        Distance to the nearest other source.

    Returns
    -------
    ndarray of int64, shape (n,)
        Bits of `Flag`; 0: none.
    """
    slack = 2.0 / np.maximum(snr, 1.0)
    flags = np.zeros(snr.size, dtype=np.int64)
    flags[full] |= Flag.SATURATED
    flags[edge] |= Flag.EDGE
    narrow = (
        shapes.minor_fwhm_px * (1.0 + slack)
        < TOO_NARROW * typical.fwhm_px * (1.0 - typical.ellipticity) ** 0.5
    )
    wide = shapes.fwhm_px * (1.0 - slack) > TOO_WIDE * typical.fwhm_px
    flags[(narrow | wide | odd) & ~full] |= Flag.NO_PEAK
    long = shapes.ellipticity > max(LEAST_ELLIPTICITY, typical.ellipticity + TOO_LONG) + slack
    flags[long] |= Flag.ELONGATED
    flags[neighbor_px < 1.5 * typical.fwhm_px + 1.0] |= Flag.BLENDED
    return flags


def position_errors(
    moments: Moments, flux: Array, noise: Array, gain_e_adu: float, floor_px: Array
) -> tuple[Array, Array, Array]:
    """Errors of centroids and fluxes as a Gaussian's fit would have them, and no less than a floor.

    Parameters
    ----------
    flux, noise : ndarray, shape (n,)
        In ADU; the noise per pixel.
    floor_px : ndarray, shape (n,)
        Least error of a position.

    Returns
    -------
    x_sigma_px, y_sigma_px, flux_sigma : ndarray, shape (n,)
        One sigma.
    """
    light = np.maximum(flux, 1e-9)
    area = np.sqrt(np.maximum(moments.xx * moments.yy - moments.xy**2, 1e-6))
    sky = 8.0 * np.pi * area * (noise / light) ** 2 + 1.0 / (light * gain_e_adu)
    x = np.sqrt(moments.xx * sky + floor_px**2)
    y = np.sqrt(moments.yy * sky + floor_px**2)
    return x, y, np.sqrt(4.0 * np.pi * area * noise**2 + light / gain_e_adu)


def nearest_px(x_px: Array, y_px: Array) -> Array:
    """Distance of each position to the nearest other one, shape (n,)."""
    if x_px.size < 2:
        return np.full(x_px.size, np.inf)
    positions = np.column_stack([x_px, y_px])
    distance, _ = KDTree(positions).query(positions, k=2)
    return np.asarray(distance, dtype=np.float64)[:, 1]


def edge_of(x_px: Array, y_px: Array, width_px: int, height_px: int, fwhm_px: float) -> Mask:
    """Which positions are within a star's width of the rim, shape (n,)."""
    margin = max(2.0, fwhm_px)
    edge = (x_px < margin) | (y_px < margin)
    edge |= (x_px > width_px - 1 - margin) | (y_px > height_px - 1 - margin)
    return np.asarray(edge)
