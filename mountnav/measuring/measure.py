"""A frame goes in, Measurements come out: background, detection, profile fit, flags, in that order [S23]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.errors import BadFrame
from mountnav.frames import Frame
from mountnav.measuring.artifacts import Artifacts, find_artifacts
from mountnav.measuring.background import Background, Image, estimate_background, fine_structure
from mountnav.measuring.bad_lines import bad_lines, heal_lines
from mountnav.measuring.cosmics import find_cosmics
from mountnav.measuring.detection import Peaks, Smoothed, find_peaks, first_of_twins, smooth, typical_fwhm
from mountnav.measuring.epsf import Epsf, find_epsf, fit_epsf, smooth_with_epsf, without_sidelobes
from mountnav.measuring.flags import FlagContext, flag_sources
from mountnav.measuring.frame_quality import ellipse_of, limiting_flux, matched_limit, psf_image, sky_quality
from mountnav.measuring.measurements import LEAST_FLUX_SIGMA, RESTLESS, Flag, Measurements, SkyQuality
from mountnav.measuring.psf import FWHM_PER_SIGMA, ShapePrior, without_pixel_width
from mountnav.measuring.psf_photometry import Fitted, fit_peaks, half_px, known_gain, nearest_other
from mountnav.measuring.saturation import SaturatedPatch, saturation_level
from mountnav.measuring.settings import MeasuringSettings

Array = NDArray[np.float64]

_SMALLEST_SIDE_PX = 16
"""Shorter frames can't be measured, px: no mesh, no cutouts. Doubled or halved, nothing changed on the frames
that were tried."""
_LEAST_FINITE = 0.05
"""Share of the pixels that must have a value. Doubled or halved, nothing changed on the frames that were
tried."""
_MOST_SATURATED = 0.5
"""Share of saturated pixels above which a frame is refused. Doubled or halved, nothing changed on the frames
that were tried."""
_WIDE_FWHM_PX = 4.5
"""FWHM from which the frame is searched again at the stars' own width, px: the first smoothing has 2.8.
Doubled, the limiting flux of painted stars of 8 px is 2.2 times brighter; halved, 20 of 136 faint painted
stars of 3 px are lost."""
_STRUCTURE_SIGMA = 0.6
"""Level of a cell of the fine structure, in units of the noise per pixel, beside which sources are judged as
on a nebula. Chosen by hand; at 0.8 nothing changed on the frames that were tried."""
_LEAST_FLUX_SIGMA_WIDE = 3.5
"""The same as `LEAST_FLUX_SIGMA` for wide stars, whose search finds more of the noise's own hills."""
_DEFAULTS = MeasuringSettings()


def measure(frame: Frame, *, settings: MeasuringSettings = _DEFAULTS) -> Measurements:
    """Find and measure the sources of a frame.

    Returns
    -------
    Measurements
        Brightest first; possibly none: few stars are no error.

    Raises
    ------
    BadFrame
        The frame is too small, without finite pixels, constant, or saturated all over.
    """
    # absurd pixels (1e30 ADU, only two values) make infinities on the way; fits that hold any are dropped
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return _measure(frame, settings)


def _measure(frame: Frame, settings: MeasuringSettings) -> Measurements:
    image, good = _checked(frame)
    background = estimate_background(
        image, box_px=settings.box_px, step_adu=1.0 if frame.pixels.dtype.kind in "ui" else 0.0
    )
    background = _with_least_noise(background, frame.pixels)
    sky, noise = float(np.median(background.level)), float(np.median(background.noise))
    level = saturation_level(frame.pixels, image, sky, noise, frame.saturation_adu)
    saturated = image >= level
    if np.count_nonzero(saturated) > _MOST_SATURATED * image.size:
        raise BadFrame(
            "more than half of the pixels are saturated",
            device=frame.source,
            advice="expose shorter, or wait until it is darker; is the cover open to daylight?",
        )
    image -= background.level_image()
    if not good.all():
        image[~good] = 0.0
    for axis in (0, 1):
        lines = bad_lines(image, noise, axis)
        if lines.size:
            heal_lines(image, good, lines, axis)
    search = _search(image, saturated, background, settings)
    good &= ~saturated
    gain = known_gain(frame, settings.gain_e_adu, sky, noise)
    return _measured(frame, image, good, saturated, background, search, gain, settings)


@dataclass(frozen=True, slots=True)
class _Search:
    """What was found before any profile was fitted."""

    peaks: Peaks
    fwhm_px: float
    artifacts: Artifacts
    noise_ratio: float
    radius_px: Array
    smoothing_px: float
    bin_px: int
    common: Epsf | None
    structure: Background | None


def _checked(frame: Frame) -> tuple[Image, NDArray[np.bool_]]:
    pixels = frame.pixels
    if pixels.ndim != 2 or min(pixels.shape) < _SMALLEST_SIDE_PX:
        raise BadFrame(
            f"a frame of shape {pixels.shape} is too small to measure",
            device=frame.source,
            advice=f"at least {_SMALLEST_SIDE_PX} × {_SMALLEST_SIDE_PX} pixels are needed",
        )
    image = np.array(pixels, dtype=np.float32)
    good = np.isfinite(image) if pixels.dtype.kind == "f" else np.ones(image.shape, dtype=bool)
    if np.count_nonzero(good) < _LEAST_FINITE * image.size:
        raise BadFrame(
            "hardly any pixel has a value", device=frame.source, advice="look at how the frame was processed"
        )
    if not good.all():
        image[~good] = np.nan
    low, high = float(np.nanmin(image)), float(np.nanmax(image))
    if low == high:
        advice = (
            "is the cap on, or did the camera deliver an empty buffer?"
            if low == 0.0
            else "all saturated, or an empty buffer: expose shorter and look at the camera"
        )
        raise BadFrame(f"every pixel has the same value, {low:g}", device=frame.source, advice=advice)
    return image, good


def _with_least_noise(background: Background, pixels: NDArray[np.generic]) -> Background:
    """Whole numbers hide noise below one step: never believe less than their rounding noise."""
    level = background.level
    if pixels.dtype.kind in "ui":
        least = 0.3
    else:
        typical = float(np.median(background.noise))
        least = max(0.02 * typical, 1e-6 * float(np.abs(level).max()), 1e-12)
    return replace(background, noise=np.maximum(background.noise, least))


def _search(
    image: Image, saturated: NDArray[np.bool_], background: Background, settings: MeasuringSettings
) -> _Search:
    bin_px = 2 if image.size > settings.bin_above_px else 1
    smoothed: Smoothed = smooth(image, background, settings.detection_sigma_px, bin_px)
    peaks = find_peaks(smoothed, settings.threshold_sigma, 8.0)
    sigma = settings.detection_sigma_px
    noise = float(np.median(background.noise))
    fwhm = typical_fwhm(image, saturated, peaks, noise)
    common = find_epsf(image, saturated, peaks, noise)
    structure = None
    plain = smoothed if common is not None else None  # smeared along their streaks, stars would join to lines
    if common is not None:
        fwhm = common.fwhm_px
        smoothed = smooth_with_epsf(image, background, common, bin_px)
        peaks = find_peaks(smoothed, settings.threshold_sigma, 2.0 * common.half_px)
        peaks = without_sidelobes(peaks, common)
    elif fwhm > _WIDE_FWHM_PX:
        sigma = min(fwhm, 14.0) / FWHM_PER_SIGMA
        smoothed = smooth(image, background, sigma, bin_px)
        peaks = find_peaks(smoothed, settings.threshold_sigma, 3.0 * fwhm)
    elif (structure := fine_structure(image, background, fwhm)) is not None:
        image -= structure.level_image()
        smoothed = smooth(image, background, sigma, bin_px)
        peaks = find_peaks(smoothed, settings.threshold_sigma, 8.0)
    artifacts = find_artifacts(image, saturated, plain or smoothed, noise, fwhm)
    peaks, radius = _one_peak_each(artifacts.without_grain(peaks), artifacts.blobs, fwhm)
    return _Search(peaks, fwhm, artifacts, smoothed.noise_ratio, radius, sigma, bin_px, common, structure)


def _one_peak_each(peaks: Peaks, blobs: list[SaturatedPatch], fwhm_px: float) -> tuple[Peaks, Array]:
    """Keep one peak per saturated patch, at its center; return also the patch's radius at each peak."""
    x, y, height = peaks.x_px.copy(), peaks.y_px.copy(), peaks.height
    keep = np.ones(x.size, dtype=bool)
    radius = np.zeros(x.size)
    reach = 0.7 * fwhm_px + 1.0
    for blob in blobs:
        near = np.flatnonzero(
            (x > blob.left - reach)
            & (x < blob.right + reach)
            & (y > blob.top - reach)
            & (y < blob.bottom + reach)
            & keep
        )
        if near.size == 0:
            continue
        first = near[0]
        keep[near[1:]] = False
        x[first], y[first], radius[first] = blob.x_px, blob.y_px, blob.radius_px
    return Peaks(x[keep], y[keep], height[keep]), radius[keep]


def _stars_first(
    search: _Search, image: Image, good: NDArray[np.bool_], background: Background, gain: float, most: int
) -> tuple[_Search, NDArray[np.bool_], tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Put cosmic rays behind the stars, so that they don't fill the list; return the spoilt pixels too."""
    peaks, some = search.peaks, slice(0, most)
    x, y = peaks.x_px[some], peaks.y_px[some]
    narrow = search.fwhm_px
    if search.common is not None:
        narrow = 0.0 if search.common.hollow else search.common.minor_fwhm_px
    found, *pixels = find_cosmics(image, good, x, y, background.noise_at(x, y), narrow, gain)
    struck = np.zeros(peaks.x_px.size, dtype=bool)
    struck[some] = found & (search.radius_px[some] == 0.0)  # the edges of a full well are sharp too
    order = np.argsort(struck, kind="stable")
    ordered = Peaks(peaks.x_px[order], peaks.y_px[order], peaks.height[order])
    search = replace(search, peaks=ordered, radius_px=search.radius_px[order])
    return search, struck[order], (pixels[0], pixels[1])


def _measured(
    frame: Frame,
    image: Image,
    good: NDArray[np.bool_],
    saturated: NDArray[np.bool_],
    background: Background,
    search: _Search,
    gain: tuple[float, bool],
    settings: MeasuringSettings,
) -> Measurements:
    most = settings.max_sources + settings.max_sources // 8
    # where few peaks are rays, as many as are needed and some more are looked at
    for looked_at in (most + most // 5, 4 * most):
        stars = _stars_first(search, image, good, background, gain[0], looked_at)
        if looked_at >= search.peaks.x_px.size or not stars[1][:most].any():
            break
    search, struck, (rows, columns) = stars
    struck = struck[:most]
    x, y = search.peaks.x_px[:most], search.peaks.y_px[:most]
    noise = background.noise_at(x, y)
    neighbors = nearest_other(search.peaks, x, y, 10.0 * search.fwhm_px)
    clean = search.artifacts.spoil(good, search.peaks, search.fwhm_px)
    clean[rows, columns] = False
    if search.common is None:
        fitted = fit_peaks(
            image, clean, saturated, background, search.peaks, search.radius_px, search.fwhm_px, gain, most
        )
    else:
        profiles, psf = fit_epsf(image, clean & ~saturated, x, y, noise, search.common, gain)
        fitted = Fitted(profiles, psf, None, np.arange(x.size), np.full(x.size, np.inf))
    fits, origin = fitted.profiles, fitted.origin
    x, y, noise, struck = x[origin], y[origin], noise[origin], struck[origin]
    neighbors = np.minimum(neighbors[origin], fitted.apart_px)
    setting = FlagContext(
        noise=noise,
        restless=noise > RESTLESS * np.percentile(background.noise, 25.0),
        knotty=_knotty(search.structure, float(np.median(background.noise)), x, y),
        good=good,
        saturated=saturated,
        fwhm_px=search.fwhm_px,
        artifacts=search.artifacts,
        struck=struck,
    )
    flags, places_x, places_y = flag_sources(fits, x, y, neighbors, setting)
    error = search.noise_ratio
    flux_sigma = fits.flux_sigma * error
    least = LEAST_FLUX_SIGMA if search.fwhm_px <= _WIDE_FWHM_PX else _LEAST_FLUX_SIGMA_WIDE
    real = (fits.flux > least * flux_sigma) | ((flags & Flag.SATURATED) > 0)
    real &= fits.amplitude > 0
    flux = np.where(np.isfinite(fits.flux), fits.flux, 0.0)
    order = np.argsort(-flux, kind="stable")
    order = order[real[order]]
    order = order[first_of_twins(places_x[order], places_y[order], 0.4 * search.fwhm_px)]
    order = order[: settings.max_sources]
    return Measurements(
        x_px=places_x[order],
        y_px=places_y[order],
        x_sigma_px=fits.x_sigma_px[order] * error,
        y_sigma_px=fits.y_sigma_px[order] * error,
        flux=flux[order],
        flux_sigma=flux_sigma[order],
        fwhm_px=without_pixel_width(fits.minor_fwhm_px * fits.major_fwhm_px)[order],
        ellipticity=(1.0 - fits.minor_fwhm_px / fits.major_fwhm_px)[order],
        flags=flags[order],
        width_px=frame.width_px,
        height_px=frame.height_px,
        background_adu=float(np.median(background.level)),
        noise_adu=float(np.median(background.noise)),
        elongation_deg=(np.where(fits.angle_deg >= 90.0, fits.angle_deg - 180.0, fits.angle_deg))[order],
        quality=_quality(background, flags[order], float(saturated.mean()), search, fitted),
    )


def _quality(
    background: Background, flags: NDArray[np.int64], saturated_share: float, search: _Search, fitted: Fitted
) -> SkyQuality:
    noise = float(np.median(background.noise))
    common = search.common
    if common is not None:
        ellipse = common.minor_fwhm_px, common.major_fwhm_px, common.angle_deg
        limit = matched_limit(common.pixels, noise, search.noise_ratio)
        hollow = common.hollow
    else:
        shape, hollow = fitted.shape or ShapePrior.round(search.fwhm_px, fitted.psf), False
        ellipse = ellipse_of(shape.p, shape.q, shape.r, fitted.psf.fwhm_per_width)
        star = psf_image(shape.p, shape.q, shape.r, fitted.psf, 2 * half_px(search.fwhm_px))
        limit = limiting_flux(star, noise, search.noise_ratio, search.smoothing_px, search.bin_px)
    return sky_quality(background, flags, saturated_share, ellipse, hollow=hollow, limit=limit)


def _knotty(structure: Background | None, noise: float, x: Array, y: Array) -> NDArray[np.bool_]:
    """Which positions, shape (n,), lie on or beside what is no plain sky."""
    if structure is None:
        return np.zeros(x.size, dtype=bool)
    knots = np.abs(structure.level) > _STRUCTURE_SIGMA * noise
    near = ndimage.binary_dilation(knots, structure=np.ones((3, 3), dtype=bool))
    rows = (y * near.shape[0] / structure.height_px).astype(np.intp)
    columns = (x * near.shape[1] / structure.width_px).astype(np.intp)
    return np.asarray(near[np.clip(rows, 0, near.shape[0] - 1), np.clip(columns, 0, near.shape[1] - 1)])
