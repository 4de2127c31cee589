"""A frame goes in, Measurements come out: background, detection, profile fit, flags, in that order [S23]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mountnav.errors import BadFrame
from mountnav.frames import Frame
from mountnav.measuring.artifacts import Blob, Streak, bad_lines, find_blobs, find_streaks, heal_lines
from mountnav.measuring.background import Background, Image, estimate_background
from mountnav.measuring.detection import Peaks, Smoothed, find_peaks, smooth
from mountnav.measuring.flags import Setting, judge
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.measuring.profile import FWHM_PER_SIGMA, Profiles, cut_stamps, fit_profiles
from mountnav.measuring.saturation import saturation_level
from mountnav.measuring.settings import MeasuringSettings
from mountnav.measuring.width import typical_fwhm

Array = NDArray[np.float64]

_SMALLEST_SIDE_PX = 16
_LEAST_FINITE = 0.05
_MOST_SATURATED = 0.5
_WIDE_FWHM_PX = 4.5
_PIXELS_AT_ONCE = 60_000
_RESTLESS = 4.0
_DEFAULTS = MeasuringSettings()


def measure(frame: Frame, *, settings: MeasuringSettings = _DEFAULTS) -> Measurements:
    """Find and measure the sources of a frame.

    Parameters
    ----------
    frame : Frame
    settings : MeasuringSettings, optional

    Returns
    -------
    Measurements
        Brightest first; possibly none: few stars are no error.

    Raises
    ------
    BadFrame
        The frame is too small, without finite pixels, constant, or saturated all over.
    """
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
    gain = settings.gain_e_adu or _gain(frame, sky, noise)
    good &= ~saturated
    return _measured(frame, image, good, saturated, background, search, gain, settings)


@dataclass(frozen=True, slots=True)
class _Search:
    """What was found before any profile was fitted."""

    peaks: Peaks
    fwhm_px: float
    blobs: list[Blob]
    streaks: list[Streak]
    noise_ratio: float
    radius_px: Array


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
    return Background(level, np.maximum(background.noise, least), background.height_px, background.width_px)


def _gain(frame: Frame, sky: float, noise: float) -> float:
    """Electrons per ADU from the header, else as the sky's own noise suggests."""
    card = frame.header.get("EGAIN")
    if isinstance(card, (int, float)) and not isinstance(card, bool) and 0.005 < card < 1000.0:
        return float(card)
    return float(np.clip(sky / noise**2 if sky > 0 else 1.0, 0.02, 100.0))


def _search(
    image: Image, saturated: NDArray[np.bool_], background: Background, settings: MeasuringSettings
) -> _Search:
    bin_px = 2 if image.size > settings.bin_above_px else 1
    smoothed: Smoothed = smooth(image, background, settings.detection_sigma_px, bin_px)
    peaks = find_peaks(smoothed, settings.threshold_sigma, 8.0)
    fwhm = typical_fwhm(image, saturated, peaks, float(np.median(background.noise)))
    if fwhm > _WIDE_FWHM_PX:
        wide = min(fwhm, 14.0) / FWHM_PER_SIGMA
        smoothed = smooth(image, background, wide, bin_px)
        peaks = find_peaks(smoothed, settings.threshold_sigma, 3.0 * fwhm)
    blobs = find_blobs(saturated, fwhm) if saturated.any() else []
    peaks, radius = _one_peak_each(peaks, blobs, fwhm)
    streaks = find_streaks(smoothed, fwhm)
    return _Search(peaks, fwhm, blobs, streaks, smoothed.noise_ratio, radius)


def _one_peak_each(peaks: Peaks, blobs: list[Blob], fwhm_px: float) -> tuple[Peaks, Array]:
    """Let each saturated patch have one peak, at its place; return also the patch's radius at each peak."""
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


def _measured(
    frame: Frame,
    image: Image,
    good: NDArray[np.bool_],
    saturated: NDArray[np.bool_],
    background: Background,
    search: _Search,
    gain: float,
    settings: MeasuringSettings,
) -> Measurements:
    most = settings.max_sources + settings.max_sources // 4
    x, y = search.peaks.x_px[:most], search.peaks.y_px[:most]
    radius = search.radius_px[:most]
    noise = background.noise_at(x, y)
    neighbors = _neighbors(search.peaks, x, y, search.fwhm_px)
    fits = _fit_all(image, good, x, y, radius, noise, search.fwhm_px, gain)
    setting = Setting(
        noise=noise,
        restless=noise > _RESTLESS * np.percentile(background.noise, 25.0),
        good=good,
        saturated=saturated,
        fwhm_px=search.fwhm_px,
        blobs=search.blobs,
        streaks=search.streaks,
    )
    flags, places_x, places_y = judge(fits, x, y, neighbors, setting)
    error = search.noise_ratio
    flux_sigma = fits.flux_sigma * error
    real = (fits.flux > 3.0 * flux_sigma) | ((flags & Flag.SATURATED) > 0)
    real &= fits.amplitude > 0
    flux = np.where(np.isfinite(fits.flux), fits.flux, 0.0)
    order = np.argsort(-flux, kind="stable")
    order = order[real[order]]
    order = order[_first_of_twins(places_x[order], places_y[order], 0.5 * search.fwhm_px)]
    order = order[: settings.max_sources]
    return Measurements(
        x_px=places_x[order],
        y_px=places_y[order],
        x_sigma_px=fits.x_sigma_px[order] * error,
        y_sigma_px=fits.y_sigma_px[order] * error,
        flux=flux[order],
        flux_sigma=flux_sigma[order],
        fwhm_px=np.sqrt(fits.minor_fwhm_px * fits.major_fwhm_px)[order],
        ellipticity=(1.0 - fits.minor_fwhm_px / fits.major_fwhm_px)[order],
        flags=flags[order],
        width_px=frame.width_px,
        height_px=frame.height_px,
        background_adu=float(np.median(background.level)),
        noise_adu=float(np.median(background.noise)),
    )


def _neighbors(peaks: Peaks, x: Array, y: Array, fwhm_px: float) -> Array:
    """Distance of each measured peak to the nearest other peak, pixels."""
    if peaks.x_px.size < 2:
        return np.full(x.size, np.inf)
    tree = KDTree(np.stack([peaks.x_px, peaks.y_px], axis=1))
    distance, _ = tree.query(np.stack([x, y], axis=1), k=2, distance_upper_bound=10.0 * fwhm_px)
    return np.asarray(distance, dtype=np.float64)[:, 1]


def _first_of_twins(x: Array, y: Array, reach_px: float) -> NDArray[np.bool_]:
    """Tell which of several fits that ran to the same place comes first."""
    keep = np.ones(x.size, dtype=bool)
    if x.size > 1:
        pairs = KDTree(np.stack([x, y], axis=1)).query_pairs(reach_px, output_type="ndarray")
        keep[pairs.max(axis=1)] = False
    return keep


def _fit_all(
    image: Image,
    good: NDArray[np.bool_],
    x: Array,
    y: Array,
    radius: Array,
    noise: Array,
    fwhm_px: float,
    gain: float,
) -> Profiles:
    """Fit in handfuls that fit the processor's cache; stamps of saturated stars reach past their cores."""
    parts: list[tuple[NDArray[np.intp], Profiles]] = []
    plain_half = int(np.clip(np.ceil(1.5 * fwhm_px), 4, 20))
    wide_half = np.clip(np.ceil(radius + 1.5 * fwhm_px), plain_half, 30).astype(int)
    wide_half = np.where(wide_half > plain_half, (wide_half + 3) // 4 * 4, plain_half)
    for half in np.unique(wide_half):
        members = np.flatnonzero(wide_half == half)
        share = max(1, _PIXELS_AT_ONCE // (2 * int(half) + 1) ** 2)
        for start in range(0, members.size, share):
            some = members[start : start + share]
            stamps = cut_stamps(image, good, x[some], y[some], noise[some], int(half))
            parts.append((some, fit_profiles(stamps, x[some], y[some], fwhm_px / FWHM_PER_SIGMA, gain)))
    return _joined(parts, x.size)


def _joined(parts: list[tuple[NDArray[np.intp], Profiles]], count: int) -> Profiles:
    columns: dict[str, NDArray[np.generic]] = {}
    for name in Profiles.__dataclass_fields__:
        whole = np.zeros(count, dtype=bool if name == "converged" else np.float64)
        for some, part in parts:
            whole[some] = getattr(part, name)
        columns[name] = whole
    return Profiles(**columns)  # type: ignore[arg-type]  # names and types follow the dataclass itself
