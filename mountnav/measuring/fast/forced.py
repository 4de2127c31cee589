"""Forced measurement at given positions: the nearest source found, fitted and flagged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.background import Background
from mountnav.measuring.detection import first_of_twins
from mountnav.measuring.fast.candidates import saturated_patches, single_pixels, smoothed
from mountnav.measuring.fast.coarse import SMOOTHED_NOISE
from mountnav.measuring.fast.fitting import fit_stars, refit_saturated
from mountnav.measuring.fast.moments import (
    Shapes,
    Typical,
    edge_of,
    flags_of,
    nearest_px,
    windowed_moments,
)
from mountnav.measuring.fast.psf import EllipticalPsf, SampledPsf
from mountnav.measuring.fast.scene import Scene
from mountnav.measuring.frame_quality import ellipse_of, limiting_flux, psf_image, sky_quality
from mountnav.measuring.measurements import LEAST_FLUX_SIGMA, POOR_FIT, Flag, Measurements, SkyQuality
from mountnav.measuring.medians import median
from mountnav.measuring.psf import FWHM_PER_SIGMA, without_pixel_width
from mountnav.measuring.settings import MeasuringSettings

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_POSITION_ERROR_PX = 0.5
"""Error of the given positions, px, added in square to a source's distance, so that of two near ones the
brighter wins. Doubled or halved, one source in 230 changes."""
_LEAST_SHARE = 0.03
"""Share of a source's height from which a further maximum close to it is fitted along. Doubled or halved, no
figure changed by 3 %."""


@dataclass(frozen=True, slots=True)
class NearSources:
    """Sources near positions.

    Attributes
    ----------
    x_px, y_px : ndarray, shape (n,)
        The highest pixel's position, refined by a parabola.
    top : ndarray, shape (n,)
        The highest pixel.
    lone : ndarray of bool, shape (n,)
        Single bright pixels.
    other_x_px, other_y_px : ndarray, shape (m,)
        Further maxima close to them, the highest, no more than there are positions.
    """

    x_px: Array
    y_px: Array
    top: Array
    lone: Mask
    other_x_px: Array
    other_y_px: Array


def sources_near(
    scene: Scene, x_px: Array, y_px: Array, reach_px: float, around_px: int, threshold_sigma: float
) -> NearSources:
    """Find the most likely source within reach of each position.

    Of several it is the one that has the fewest rivals: sources grow in number as they get fainter, and with
    the area, so that the square of the distance over the height tells how many would lie there by chance.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        Positions inside the frame.
    around_px : int
        How far from the position further maxima are looked for.
    threshold_sigma : float
        Height of a source in the smoothed patch, in units of its noise.

    Returns
    -------
    Near
        Of the positions that have one; not in their order.
    """
    patches = scene.cut(x_px, y_px, max(int(np.ceil(reach_px)), around_px) + 2)
    ground = patches.ground()
    smooth = smoothed(patches.values)
    inner = smooth[:, 1:-1, 1:-1]
    peak = inner > (ground + threshold_sigma * SMOOTHED_NOISE * scene.noise_at(x_px, y_px))[:, None, None]
    side = smooth.shape[1]
    for dy, dx in ((0, 1), (1, -1), (1, 0), (1, 1)):
        peak &= inner >= smooth[:, 1 + dy : side - 1 + dy, 1 + dx : side - 1 + dx]
        peak &= inner > smooth[:, 1 - dy : side - 1 - dy, 1 - dx : side - 1 - dx]
    which, row, column = np.nonzero(peak)
    height = inner[which, row, column] - ground[which]
    # two pixels were lost: one by smoothing, one as neighbors
    x = (patches.left[which] + column + 2).astype(np.float64)
    y = (patches.top[which] + row + 2).astype(np.float64)
    shift_x, shift_y = _parabola(smooth, which, row + 1, column + 1)
    x, y = x + shift_x, y + shift_y
    away = np.hypot(x - x_px[which], y - y_px[which])
    within = away <= reach_px
    rivals = np.where(within, (away**2 + _POSITION_ERROR_PX**2) / np.maximum(height, 1e-12), np.inf)
    order = np.lexsort((rivals, which))
    first = order[np.r_[True, which[order][1:] != which[order][:-1]]] if order.size else order
    first = first[within[first]]
    chosen = np.full(x_px.size, -1)
    chosen[which[first]] = first
    mine = chosen[which]
    other = (mine >= 0) & (mine != np.arange(which.size))
    other &= height > _LEAST_SHARE * height[mine]
    others = np.flatnonzero(other)
    others = others[np.argsort(-height[others], kind="stable")][: first.size]
    top, lone = single_pixels(
        patches.values[which[first]],
        row[first] + 2,
        column[first] + 2,
        ground[which[first]],
        scene.noise_adu,
    )
    return NearSources(x[first], y[first], top.astype(np.float64), lone, x[others], y[others])


def _parabola(
    smooth: NDArray[np.float32], which: NDArray[np.intp], row: NDArray[np.intp], column: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Offset of the top of parabolas through the maxima and their neighbors, within half a pixel."""
    here = smooth[which, row, column].astype(np.float64)
    shifts = []
    for dy, dx in ((0, 1), (1, 0)):
        after, before = smooth[which, row + dy, column + dx], smooth[which, row - dy, column - dx]
        bend = np.maximum(2.0 * here - after - before, 1e-9)
        shifts.append(np.clip(0.5 * (after - before) / bend, -0.5, 0.5))
    return shifts[0], shifts[1]


_SAME_PX = 0.75
"""Sources nearer than this, px, are one. At 0.5 or 0.875 nothing changed on the frames that were tried."""
_AROUND_FWHM = 1.75
"""Radius in FWHM within which further maxima are fitted along. Halved, 3 of 126 painted faint stars are lost
to neighbors; doubled, 2, to maxima of the noise."""
_INDEPENDENT_BELOW = 1.15
"""Up to this ratio neighboring pixels count as independent: a small sample gives it no better. Doubled, the
limiting flux of correlated frames is stated a third to a half too low."""


def forced_measurements(
    scene: Scene,
    image: SampledPsf,
    quality: SkyQuality,
    x_px: Array,
    y_px: Array,
    reach_px: float,
    sigma: float,
) -> Measurements:
    """Do the work of `FastMeasurement.measured_at`.

    Parameters
    ----------
    quality : SkyQuality
        To hand out.
    x_px, y_px : ndarray, shape (n,)
        Pixels, 0-based: the middle of the first pixel is (0, 0).
    sigma : float
        Least height of a source in units of the noise.
    """
    height, width = scene.frame.pixels.shape
    inside = (x_px > -0.5) & (y_px > -0.5) & (x_px < width - 0.5) & (y_px < height - 0.5)
    half = int(image.dx.max())
    around = int(np.ceil(_AROUND_FWHM * scene.fwhm_px))
    near = sources_near(scene, x_px[inside], y_px[inside], reach_px, around, sigma)
    first = first_of_twins(near.x_px, near.y_px, _SAME_PX)
    x, y, top, lone = near.x_px[first], near.y_px[first], near.top[first], near.lone[first]
    n = x.size
    full = saturated_patches(scene, x, y, top)
    # what shines close by is fitted along, and not handed out
    x, y = np.concatenate([x, near.other_x_px]), np.concatenate([y, near.other_y_px])
    apart = first_of_twins(x, y, _SAME_PX)
    apart[:n] = True
    fits = fit_stars(scene, image, x[apart], y[apart])
    refit_saturated(scene, image.shape, fits, full)
    neighbor = nearest_px(fits.x_px, fits.y_px)[:n]
    fits = fits.part(slice(0, n))
    x, y = fits.x_px, fits.y_px
    cut = scene.cut(x, y, half)
    light = cut.values - cut.ground()[:, None, None]
    window = scene.fwhm_px / FWHM_PER_SIGMA
    shapes = Shapes.of(windowed_moments(light, cut.left, cut.top, x, y, window, rounds=0))
    snr = fits.flux / np.maximum(fits.flux_sigma * scene.noise_ratio, 1e-12)
    odd = lone | ~fits.sound | scene.sky.restless(*scene.bins(x, y)) | (fits.misfit > POOR_FIT)
    flags = flags_of(
        shapes,
        Typical(scene.fwhm_px, quality.ellipticity or 0.0, 1),
        snr,
        full=top >= scene.full_adu,
        edge=edge_of(x, y, width, height, scene.fwhm_px),
        odd=odd,
        neighbor_px=neighbor,
    )
    order = np.argsort(-fits.flux, kind="stable")
    order = order[(fits.flux[order] > 0.0) & (snr[order] > LEAST_FLUX_SIGMA)]
    order = order[first_of_twins(x[order], y[order], 0.4 * scene.fwhm_px)]
    bare = without_pixel_width(shapes.fwhm_px**2)
    return Measurements(
        x_px=x[order],
        y_px=y[order],
        x_sigma_px=fits.x_sigma_px[order] * scene.noise_ratio,
        y_sigma_px=fits.y_sigma_px[order] * scene.noise_ratio,
        flux=fits.flux[order],
        flux_sigma=fits.flux_sigma[order] * scene.noise_ratio,
        fwhm_px=bare[order],
        ellipticity=shapes.ellipticity[order],
        flags=flags[order],
        width_px=width,
        height_px=height,
        background_adu=scene.sky_adu,
        noise_adu=scene.noise_adu,
        elongation_deg=shapes.angle_deg[order],
        quality=quality,
    )


def quality_of(
    scene: Scene, shape: EllipticalPsf, known: Measurements, settings: MeasuringSettings, half_px: int
) -> SkyQuality:
    """Sum a frame up as `measure` does.

    Parameters
    ----------
    shape : EllipticalPsf
        The common one.
    known : Measurements
        The fast measurement's own: its star-like sources are the ones that are counted.

    Returns
    -------
    SkyQuality
        The limiting flux is that of `measure` at the same settings.
    """
    height, width = scene.frame.pixels.shape
    share = median(scene.sky.noise) / scene.noise_adu
    background = Background(scene.sky.level / scene.bin_px**2, scene.sky.noise / share, height, width)
    p, q, r = shape.seen()
    bin_px = 2 if scene.frame.pixels.size > settings.bin_above_px else 1
    star = psf_image(p, q, r, shape.psf, 2 * half_px)
    ratio = scene.noise_ratio if scene.noise_ratio > _INDEPENDENT_BELOW else 1.0
    limit = limiting_flux(star, scene.noise_adu, ratio, settings.detection_sigma_px, bin_px)
    full = saturated_patches(
        scene, known.x_px, known.y_px, np.where(known.flags & Flag.SATURATED, np.inf, 0.0)
    )
    return sky_quality(
        background,
        known.flags,
        float((np.pi * full.radius_px**2).sum()) / (height * width),
        ellipse_of(p, q, r, shape.psf.fwhm_per_width),
        hollow=False,
        limit=limit,
    )
