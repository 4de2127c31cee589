"""Precise measurements at wanted places: found, fitted, flagged, summed up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.background import Background
from mountnav.measuring.glance.candidates import full_patches
from mountnav.measuring.glance.full_stars import refit_full
from mountnav.measuring.glance.judging import (
    Shapes,
    Typical,
    edge_of,
    first_of_twins,
    flags_of,
    nearest_px,
)
from mountnav.measuring.glance.near import sources_near
from mountnav.measuring.glance.patches import windowed_moments
from mountnav.measuring.glance.placing import place
from mountnav.measuring.glance.scene import Scene
from mountnav.measuring.glance.star_image import StarImage, StarShape
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.measuring.quality import SkyQuality
from mountnav.measuring.settings import MeasuringSettings
from mountnav.measuring.star_shape import FWHM_PER_SIGMA, PIXEL_FWHM2
from mountnav.measuring.summary import bell_image, ellipse_of, limiting_flux, summed_up

Array = NDArray[np.float64]

_POOR_FIT = 0.15
_LEAST_FLUX_SIGMA = 2.5
_SAME_PX = 0.75
_AROUND_FWHM = 1.75
_ALIKE = 1.15
"""Up to this ratio neighboring pixels count as independent: a small sample tells it no better."""


def measured_near(
    scene: Scene,
    image: StarImage,
    quality: SkyQuality,
    x_px: Array,
    y_px: Array,
    reach_px: float,
    sigma: float,
) -> Measurements:
    """Do the work of `Glance.measured_at`.

    Parameters
    ----------
    scene : Scene
    image : StarImage
    quality : SkyQuality
        To hand out.
    x_px, y_px : ndarray, shape (n,)
    reach_px : float
    sigma : float
        Least height of a source in units of the noise.

    Returns
    -------
    Measurements
    """
    height, width = scene.frame.pixels.shape
    inside = (x_px > -0.5) & (y_px > -0.5) & (x_px < width - 0.5) & (y_px < height - 0.5)
    half = int(image.dx.max())
    around = int(np.ceil(_AROUND_FWHM * scene.fwhm_px))
    near = sources_near(scene, x_px[inside], y_px[inside], reach_px, around, sigma)
    first = first_of_twins(near.x_px, near.y_px, _SAME_PX)
    x, y, top, lone = near.x_px[first], near.y_px[first], near.top[first], near.lone[first]
    n = x.size
    full = full_patches(scene, x, y, top)
    # what shines close by is fitted along, and not handed out
    x, y = np.concatenate([x, near.other_x_px]), np.concatenate([y, near.other_y_px])
    apart = first_of_twins(x, y, _SAME_PX)
    apart[:n] = True
    fits = place(scene, image, x[apart], y[apart])
    refit_full(scene, image.shape, fits, full)
    neighbor = nearest_px(fits.x_px, fits.y_px)[:n]
    fits = fits.part(slice(0, n))
    x, y = fits.x_px, fits.y_px
    cut = scene.cut(x, y, half)
    light = cut.values - cut.ground()[:, None, None]
    window = scene.fwhm_px / FWHM_PER_SIGMA
    shapes = Shapes.of(windowed_moments(light, cut.left, cut.top, x, y, window, rounds=0))
    snr = fits.flux / np.maximum(fits.flux_sigma * scene.noise_ratio, 1e-12)
    odd = lone | ~fits.sound | scene.sky.restless(*scene.bins(x, y)) | (fits.misfit > _POOR_FIT)
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
    order = order[(fits.flux[order] > 0.0) & (snr[order] > _LEAST_FLUX_SIGMA)]
    order = order[first_of_twins(x[order], y[order], 0.4 * scene.fwhm_px)]
    bare = np.sqrt(np.maximum(shapes.fwhm_px**2 - PIXEL_FWHM2, 0.04 * shapes.fwhm_px**2))
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
    scene: Scene, shape: StarShape, known: Measurements, settings: MeasuringSettings, half_px: int
) -> SkyQuality:
    """Sum a frame up as `measure` does.

    Parameters
    ----------
    scene : Scene
    shape : StarShape
        The common one.
    known : Measurements
        The glance's own: its star-like sources are the ones that are counted.
    settings : MeasuringSettings
    half_px : int

    Returns
    -------
    SkyQuality
        The limiting flux is that of `measure` at the same settings.
    """
    height, width = scene.frame.pixels.shape
    share = float(np.median(scene.sky.noise)) / scene.noise_adu
    background = Background(scene.sky.level / scene.bin_px**2, scene.sky.noise / share, height, width)
    p, q, r = shape.seen()
    bin_px = 2 if scene.frame.pixels.size > settings.bin_above_px else 1
    star = bell_image(p, q, r, shape.bell, 2 * half_px)
    ratio = scene.noise_ratio if scene.noise_ratio > _ALIKE else 1.0
    limit = limiting_flux(star, scene.noise_adu, ratio, settings.detection_sigma_px, bin_px)
    full = full_patches(scene, known.x_px, known.y_px, np.where(known.flags & Flag.SATURATED, np.inf, 0.0))
    return summed_up(
        background,
        known.flags,
        float((np.pi * full.radius_px**2).sum()) / (height * width),
        ellipse_of(p, q, r, shape.bell.fwhm_per_width),
        hollow=False,
        limit=limit,
    )
