"""The empirical PSF (ePSF) for frames whose stars are trailed or rings: found, and fitted [S23 §0.2]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.spatial import KDTree

from mountnav.measuring.background import Background, Image, estimate_background
from mountnav.measuring.cutouts import Cutouts, make_cutouts
from mountnav.measuring.detection import Peaks, Smoothed
from mountnav.measuring.least_squares import Fit, covariances
from mountnav.measuring.psf import FWHM_PER_SIGMA, Psf
from mountnav.measuring.psf_fitting import Profiles, with_noise_law

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_REACH_PX = 30
"""Half side of the squares in which the objects are looked at, px: 24 px of light and a rim for the sky's
level. Halved, the median error of painted rings of 18 px grows from 0.05 to 0.25 px; doubled, the time is
fourfold."""
_CANDIDATES = 400
"""Highest peaks among which the objects are chosen: a ring has many peaks. Doubled or halved, nothing changed
on the frames that were tried."""
_OBJECTS = 40
"""Objects at most that are stacked. Halved or doubled, the pull of painted trails goes from 0.79 to 0.66 or
0.93."""
_FEWEST_OBJECTS = 4
"""Fewer objects than this don't make a mean from which one of them can be rejected."""
_FIRST_OBJECTS = 12
"""The first objects, by which ordinary frames are recognized at little cost. Doubled or halved, nothing
changed on the frames that were tried."""
_ORDINARY_SHARE = 0.75
"""These count as ordinary if their axis ratio stays below this share of `_TRAIL_RATIO`. At 0.5 or 0.875
nothing changed on the frames that were tried."""
_LEAST_HEIGHT = 20.0
"""Height of an object in the smoothed frame, in units of its noise: fainter ones have no measurable shape.
Doubled or halved, the errors of painted rings move by 6 %."""
_LIGHT_SMOOTHING_PX = 1.2
"""Width σ of the Gaussian that joins an object's pixels to a patch, px: about that of the first detection.
Doubled, fluxes of painted rings scatter by 16 % more."""
_LIGHTER_SMOOTHING_PX = 0.8
"""Width σ of the Gaussian under which a ring's hole is looked at, px: wider would fill the hole."""
_LIGHT_NOISE = 1.0 / (2.0 * np.sqrt(np.pi) * _LIGHT_SMOOTHING_PX)
"""Share of independent pixels' noise that is left after the first smoothing: 1 / (2 √π σ)."""
_PART_OF_TOP = 0.2
"""An object's patch is what lies above this share of its top: a ring's darkest part lies above it, most halos
below. Chosen by hand. Doubled, the pull of painted trails goes from 0.79 to 0.70; halved, no figure changed
by 3 %."""
_LEAST_AREA_PX = 12
"""Patches of fewer pixels are hot pixels and faint stars. Doubled, nothing changed on the frames that were
tried."""
_TRAIL_RATIO = 1.8
"""Major over minor rms width from which objects are trails: below it an ellipse fits as well
(docs/explanation/measuring.md, *Known limits*: trails below 6 px)."""
_ROUND_RATIO = 1.5
"""Major over minor rms width up to which an object may be a ring."""
_ALIGNED = 0.75
"""Length of the mean of the objects' doubled directions, 1 if all agree: below it they aren't trails of one
drift."""
_HOLLOW = 0.75
"""Middle over the brighter half of an object's patch below which it is a ring. A filled disc has 1, a
Gaussian more."""
_MOST_AREA_RATIO = 2.0
"""Upper over lower quartile of the patches' areas above which the objects are no stars: a nebula's knots,
leaves of a tree."""
_HOLLOW_AREA_PX = 40
"""A ring covers at least so many pixels: 7 px across. Smaller holes are lost in the blur."""
_MOST_RADIUS_PX = 24
"""Largest half side of the ePSF, px: longer trails are cut in pieces (docs/explanation/measuring.md, *Known
limits*). Doubled, neighbors get into it and the time is fourfold."""
_MARGIN_PX = 4
"""So many pixels beyond the objects' patches belong to the ePSF: its wings."""
_STACKINGS = 3
"""How often the objects are aligned with the mean and stacked again."""
_SIDELOBE = 1.15
"""A peak counts as a brighter star's side lobe up to this many times what the ePSF leaves there: positions
are good to a pixel only."""


@dataclass(frozen=True, slots=True)
class Epsf:
    """The mean of a frame's bright stars.

    Attributes
    ----------
    pixels : ndarray, shape (2 r + 1, 2 r + 1)
        Of unit flux, its centroid in the middle.
    minor_fwhm_px, major_fwhm_px, angle_deg : float
        By second moments; the major axis' direction from +x towards +y.
    hollow : bool
        A ring, not a line.
    """

    pixels: Array
    minor_fwhm_px: float
    major_fwhm_px: float
    angle_deg: float
    hollow: bool

    @property
    def half_px(self) -> int:
        """Half side."""
        return int(self.pixels.shape[0] // 2)

    @property
    def fwhm_px(self) -> float:
        """Width of a round image of as large an area."""
        return float(np.sqrt(self.minor_fwhm_px * self.major_fwhm_px))


def find_epsf(sky_free: Image, saturated: Mask, peaks: Peaks, noise: float) -> Epsf | None:
    """Look whether the bright stars are all drawn out one way, or all rings; if so, return their mean.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    saturated : ndarray of bool, shape (height, width)
        Pixels at or above the saturation level.
    peaks : Peaks
        Of the lightly smoothed frame; a ring may have several.
    noise : float
        Per pixel.

    Returns
    -------
    Epsf or None
        None for frames of ordinary stars, and where there are too few bright ones.
    """
    x, y = _apart(peaks, sky_free.shape, saturated)
    if x.size < _FEWEST_OBJECTS:
        return None
    cutouts = _cut(sky_free, x, y)
    if _ordinary(cutouts[:_FIRST_OBJECTS], noise):
        return None
    patches, areas = _patches(cutouts, noise)
    fine = areas >= _LEAST_AREA_PX
    if fine.sum() < max(_FEWEST_OBJECTS, 0.4 * x.size):
        return None
    low, high = np.percentile(areas[fine], [25.0, 75.0])
    if high > _MOST_AREA_RATIO * low:
        return None  # no ePSF: a nebula's knots, leaves of a tree
    cutouts, patches = cutouts[fine], patches[fine]
    moments = [_moments(np.where(patch, cutout, 0.0)) for cutout, patch in zip(cutouts, patches, strict=True)]
    ratio, angle = np.array([m[2] / m[1] for m in moments]), np.radians([m[3] for m in moments])
    one_way = abs(np.exp(2j * angle).mean()) > _ALIGNED
    trailed = bool(np.median(ratio) > _TRAIL_RATIO and one_way)
    # two stars side by side are dark between them as well, but not round
    hollow = bool(np.median(ratio) < _ROUND_RATIO) and _hollow(cutouts, patches, moments)
    if not trailed and not hollow:
        return None
    centers = np.array([m[0] for m in moments])
    mean = _stacked(cutouts, patches, centers, noise)
    return None if mean is None else _described(mean, hollow=hollow)


def _ordinary(cutouts: Array, noise: float) -> bool:
    """Whether a few objects show already that these are ordinary stars: small and round."""
    patches, areas = _patches(cutouts, noise)
    fine = areas > 0
    if fine.sum() < 0.5 * _FIRST_OBJECTS or np.median(areas[fine]) >= _HOLLOW_AREA_PX:
        return False
    moments = [
        _moments(np.where(patch, cutout, 0.0))
        for cutout, patch in zip(cutouts[fine], patches[fine], strict=True)
    ]
    return bool(np.median([m[2] / m[1] for m in moments]) < _ORDINARY_SHARE * _TRAIL_RATIO)


def _apart(
    peaks: Peaks, shape: tuple[int, int], saturated: Mask
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Choose the highest peaks that lie a cutout's reach apart, whole cutouts inside the frame."""
    x, y = (np.rint(c[:_CANDIDATES]).astype(np.intp) for c in (peaks.x_px, peaks.y_px))
    inside = (x >= _REACH_PX) & (y >= _REACH_PX) & (x < shape[1] - _REACH_PX) & (y < shape[0] - _REACH_PX)
    inside &= peaks.height[: x.size] > _LEAST_HEIGHT
    chosen: list[int] = []
    for k in np.flatnonzero(inside).tolist():
        if len(chosen) == _OBJECTS:
            break
        apart = np.hypot(x[chosen] - x[k], y[chosen] - y[k]) > _REACH_PX
        if apart.all() and not saturated[y[k] - 12 : y[k] + 13, x[k] - 12 : x[k] + 13].any():
            chosen.append(k)
    return x[chosen], y[chosen]


def _cut(sky_free: Image, x: NDArray[np.intp], y: NDArray[np.intp]) -> Array:
    offset = np.arange(-_REACH_PX, _REACH_PX + 1)
    cutouts = sky_free[y[:, None, None] + offset[:, None], x[:, None, None] + offset[None, :]]
    radius = np.hypot(offset[:, None], offset[None, :])
    ground = np.median(cutouts[:, (radius > _REACH_PX - 4) & (radius <= _REACH_PX)], axis=1)
    return np.asarray(cutouts - ground[:, None, None], dtype=np.float64)


def _patches(cutouts: Array, noise: float) -> tuple[Mask, NDArray[np.intp]]:
    """What belongs to the object in the middle, its holes filled; area 0 where it runs out of the cutout."""
    smooth = ndimage.gaussian_filter(cutouts, _LIGHT_SMOOTHING_PX, axes=(1, 2), mode="nearest")
    middle = slice(_REACH_PX - 2, _REACH_PX + 3)
    top = smooth[:, middle, middle].max(axis=(1, 2))
    above = smooth > np.maximum(_PART_OF_TOP * top, 4.0 * _LIGHT_NOISE * noise)[:, None, None]
    patches = np.zeros_like(above)
    areas = np.zeros(cutouts.shape[0], dtype=np.intp)
    for k, one in enumerate(above):
        closed = ndimage.binary_closing(one, iterations=1)
        labels, _ = ndimage.label(closed, structure=np.ones((3, 3)))
        own = labels[_REACH_PX, _REACH_PX]
        if own == 0:
            continue
        patch = ndimage.binary_fill_holes(labels == own)
        if patch[0].any() or patch[-1].any() or patch[:, 0].any() or patch[:, -1].any():
            continue
        patches[k], areas[k] = patch, np.count_nonzero(patch)
    return patches, areas


def _moments(light: Array) -> tuple[tuple[float, float], float, float, float]:
    """Centroid (x, y) from the middle, rms widths along minor and major axis, its direction in degrees."""
    half = light.shape[0] // 2
    light = np.maximum(light, 0.0)
    total = max(float(light.sum()), 1e-12)
    offset = np.arange(-half, half + 1, dtype=np.float64)
    in_x, in_y = light.sum(axis=0) / total, light.sum(axis=1) / total
    x, y = float(in_x @ offset), float(in_y @ offset)
    xx, yy = float(in_x @ (offset - x) ** 2), float(in_y @ (offset - y) ** 2)
    xy = float((offset - y) @ light @ (offset - x)) / total
    values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    minor, major = np.sqrt(np.maximum(values, 0.05))
    return (x, y), float(minor), float(major), float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))


def _hollow(
    cutouts: Array, patches: Mask, moments: list[tuple[tuple[float, float], float, float, float]]
) -> bool:
    """Whether the typical object is clearly darker in its middle than on the ring round it."""
    depth = []
    for cutout, patch, moment in zip(cutouts, patches, moments, strict=True):
        if np.count_nonzero(patch) < _HOLLOW_AREA_PX:
            depth.append(1.0)
            continue
        smooth = ndimage.gaussian_filter(cutout, _LIGHTER_SMOOTHING_PX, mode="nearest")
        row, column = round(moment[0][1]) + _REACH_PX, round(moment[0][0]) + _REACH_PX
        # the brighter half of the patch stands for the ring, not its noisiest pixel
        depth.append(float(smooth[row, column] / np.percentile(smooth[patch], 75.0)))
    return bool(np.median(depth) < _HOLLOW)


def _stacked(cutouts: Array, patches: Mask, centers: Array, noise: float) -> Array | None:
    """Mean of the objects, each moved to the middle and scaled to unit flux, without what only some show."""
    reach = np.array([np.hypot(*(np.argwhere(p) - _REACH_PX).T).max() for p in patches])
    radius = int(np.clip(np.ceil(np.median(reach - np.hypot(*centers.T))) + _MARGIN_PX, 6, _MOST_RADIUS_PX))
    weight = (cutouts * patches).sum(axis=(1, 2))
    mean = None
    for _ in range(_STACKINGS):
        moved = np.stack(
            [
                _middle(cutout, c, radius) / max(w, 1e-9)
                for cutout, c, w in zip(cutouts, centers, weight, strict=True)
            ]
        )
        sure = np.clip(weight / noise, 1e-3, None)
        mean = np.median(moved, axis=0) if mean is None else _clipped_mean(moved, mean, sure)
        mean = mean - _rim_level(mean)
        total = float(mean.sum())
        if total <= 0:
            return None
        mean /= total
        shift, scale = _refined(moved, mean)
        centers = centers + np.clip(shift, -1.0, 1.0)
        weight = weight * np.clip(scale, 0.5, 2.0)
    if mean is None:
        return None
    (x, y), *_ = _moments(mean)
    return _middle(np.pad(mean, 3), np.array([x, y]), radius)


def _middle(cutout: Array, center: Array, radius: int) -> Array:
    """Cut the surroundings of a position (x, y from the middle) by cubic interpolation."""
    offset = np.arange(-radius, radius + 1) + cutout.shape[0] // 2
    rows, columns = np.meshgrid(offset + center[1], offset + center[0], indexing="ij")
    return np.asarray(ndimage.map_coordinates(cutout, [rows, columns], order=3, mode="nearest"))


def _rim_level(image: Array) -> float:
    side = image.shape[0]
    rows, columns = np.indices(image.shape) - side // 2
    return float(np.median(image[np.hypot(rows, columns) > side // 2 - 1.5]))


def _clipped_mean(moved: Array, middle: Array, sure: Array) -> Array:
    """Weighted mean of what lies near the last one: neighbors in single cutouts drop out."""
    off = np.abs(moved - middle)
    scatter = np.median(off, axis=0) * 1.4826 + 1e-12
    weights = (off < 3.0 * scatter) * (np.minimum(sure, 3.0 * np.median(sure)))[:, None, None]
    return np.asarray((weights * moved).sum(axis=0) / np.maximum(weights.sum(axis=0), 1e-12))


def _refined(moved: Array, mean: Array) -> tuple[Array, Array]:
    """Shift (n, 2) and scale (n,) of each cutout against the mean, by one linear step."""
    slope_y, slope_x = np.gradient(mean)
    table = np.stack([mean.ravel(), -slope_x.ravel(), -slope_y.ravel(), np.ones(mean.size)], axis=1)
    answer, *_ = np.linalg.lstsq(table, moved.reshape(moved.shape[0], -1).T, rcond=None)
    scale = answer[0]
    return (answer[1:3] / np.where(np.abs(scale) > 0.1, scale, 1.0)).T, scale


def _described(mean: Array, *, hollow: bool) -> Epsf:
    mean = mean / mean.sum()
    body = np.where(mean > 0.02 * mean.max(), mean, 0.0)
    _, minor, major, angle = _moments(body)
    turn = (angle + 90.0) % 180.0 - 90.0
    return Epsf(mean, FWHM_PER_SIGMA * minor, FWHM_PER_SIGMA * major, turn, hollow)


def smooth_with_epsf(sky_free: Image, background: Background, image: Epsf, bin_px: int) -> Smoothed:
    """Smooth a frame with its stars' ePSF, and divide by the local noise: the matched filter.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    bin_px : int
        1, or 2 to search in 2 × 2 bins.
    """
    height, width = sky_free.shape
    kernel = image.pixels
    if bin_px == 2:
        even = sky_free[: height - height % 2, : width - width % 2]
        lines = even[0::2] + even[1::2]
        sky_free = (lines[:, 0::2] + lines[:, 1::2]) * np.float32(0.25)
        half = image.half_px // 2 + 1
        offset = 2.0 * np.arange(-half, half + 1) + image.half_px
        blurred = ndimage.uniform_filter(np.pad(kernel, 2), 2, mode="constant", origin=-1)
        blurred = 0.5 * (blurred + ndimage.uniform_filter(np.pad(kernel, 2), 2, mode="constant"))
        rows, columns = np.meshgrid(offset + 2, offset + 2, indexing="ij")
        kernel = ndimage.map_coordinates(blurred, [rows, columns], order=1, mode="constant")
        kernel /= kernel.sum()
    noise = np.maximum(background.noise_image(*sky_free.shape), np.float32(1e-20))
    smoothed = _correlated(np.asarray(sky_free / noise, dtype=np.float32), kernel)
    expected = float(np.sqrt((kernel**2).sum())) / bin_px
    box = max(32, 3 * kernel.shape[0])
    scatter = estimate_background(smoothed, box_px=box)
    # a wide kernel leaves few independent samples in a cell: never believe less than theory
    scale = np.maximum(scatter.noise, expected)
    smoothed -= scatter.level_image()
    smoothed /= Background(scatter.level, scale, *smoothed.shape).noise_image(*smoothed.shape)
    return Smoothed(smoothed, bin_px, max(1.0, float(np.median(scatter.noise)) / expected))


def _correlated(image: Image, kernel: Array) -> Image:
    """Correlate with a kernel, by Fourier transforms; the frame is mirrored at its edges."""
    half = kernel.shape[0] // 2
    wide = np.pad(image, half, mode="reflect")
    shape = [fft.next_fast_len(side, real=True) for side in wide.shape]
    there = fft.rfft2(wide, s=shape)
    there *= fft.rfft2(np.ascontiguousarray(kernel[::-1, ::-1]).astype(np.float32), s=shape)
    back = fft.irfft2(there, s=shape)
    return np.asarray(
        back[2 * half : 2 * half + image.shape[0], 2 * half : 2 * half + image.shape[1]], dtype=np.float32
    )


def without_sidelobes(peaks: Peaks, image: Epsf) -> Peaks:
    """Drop peaks no higher than what a brighter star's own image leaves there in the smoothed frame.

    Parameters
    ----------
    peaks : Peaks
        Of `smooth_with_epsf`.
    """
    if peaks.x_px.size < 2:
        return peaks
    kernel = image.pixels
    wide = np.pad(kernel, image.half_px)
    own = _correlated(wide.astype(np.float32), kernel) / float((kernel**2).sum())
    # a margin: positions are only good to a pixel
    own = ndimage.maximum_filter(own, 3)
    middle = own.shape[0] // 2
    keep = np.ones(peaks.x_px.size, dtype=bool)
    positions = np.stack([peaks.x_px, peaks.y_px], axis=1)
    pairs = KDTree(positions).query_pairs(2.0 * image.half_px, output_type="ndarray")
    if pairs.size == 0:
        return peaks
    bright, faint = pairs.min(axis=1), pairs.max(axis=1)
    d = np.rint(positions[faint] - positions[bright]).astype(int)
    d = np.clip(d, -middle, middle)
    left = np.maximum(own[middle + d[:, 1], middle + d[:, 0]], 0.0)
    mere = peaks.height[faint] < _SIDELOBE * left * peaks.height[bright] + 3.0
    order = np.argsort(bright, kind="stable")
    for b, f, bad in zip(bright[order].tolist(), faint[order].tolist(), mere[order].tolist(), strict=True):
        if bad and keep[b]:
            keep[f] = False
    return replace(peaks, x_px=peaks.x_px[keep], y_px=peaks.y_px[keep], height=peaks.height[keep])


_STEP_PX = 0.2
"""Step of the table of sub-pixel shifts, px: between its nodes the slopes lead on linearly."""
_STEPS = 8
"""Steps to each side: 8 of 0.2 px are 1.6 px, more than a cutout's center may be off."""
_ROUNDS = 4
"""Gauss-Newton steps before the cutouts follow the positions."""
_PASSES = 3
"""How often the cutouts follow the positions."""
_PIXELS_AT_ONCE = 60_000
"""Pixels of all cutouts that are fitted together, so that they stay in the processor's cache. It changes
nothing but time."""
_NOISE_STARS = 60
"""Brightest stars from whose residuals the noise law is learned."""
_NOISE_STAR_SNR = 60.0
"""And no fainter than this flux over its error: fainter ones show only the sky's noise."""
_CORE = 0.3
"""The misfit is that of the pixels above this share of the ePSF's top."""
_FAR_PX = 4.0
"""A fit that ended farther from its peak, px, has run away to another star."""


@dataclass(frozen=True, slots=True)
class _Table:
    """The ePSF and its slopes on a cutout's pixels at a grid of shifts, each (k, k, pixels)."""

    image: Array
    slope_x: Array
    slope_y: Array

    def at(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Image and its derivatives by x and y for shifts, each (n, pixels)."""
        gx, gy = np.clip(x / _STEP_PX + _STEPS, 0, 2 * _STEPS), np.clip(y / _STEP_PX + _STEPS, 0, 2 * _STEPS)
        i, j = np.rint(gx).astype(int), np.rint(gy).astype(int)
        ex, ey = (x - (i - _STEPS) * _STEP_PX)[:, None], (y - (j - _STEPS) * _STEP_PX)[:, None]
        image, slope_x, slope_y = self.image[j, i], self.slope_x[j, i], self.slope_y[j, i]
        return image + ex * slope_x + ey * slope_y, slope_x, slope_y


def _table(image: Epsf, dx: Array, dy: Array) -> _Table:
    wide = np.pad(image.pixels, 4)
    middle = wide.shape[0] // 2
    smooth = ndimage.spline_filter(wide, order=3)
    shifts = (np.arange(2 * _STEPS + 1) - _STEPS) * _STEP_PX

    def shifted(extra_x: float, extra_y: float) -> Array:
        rows = dy - (shifts + extra_y)[:, None, None] + middle
        columns = dx - (shifts + extra_x)[None, :, None] + middle
        rows, columns = np.broadcast_arrays(rows, columns)
        return np.asarray(ndimage.map_coordinates(smooth, [rows, columns], order=3, prefilter=False))

    half = 0.5 * _STEP_PX
    return _Table(
        image=shifted(0.0, 0.0),
        slope_x=(shifted(half, 0.0) - shifted(-half, 0.0)) / (2.0 * half),
        slope_y=(shifted(0.0, half) - shifted(0.0, -half)) / (2.0 * half),
    )


def fit_epsf(
    sky_free: Image,
    good: Mask,
    x_px: Array,
    y_px: Array,
    noise: Array,
    image: Epsf,
    gain: tuple[float, bool],
) -> tuple[Profiles, Psf]:
    """Fit flux, position and a local sky with a known image.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    good : ndarray of bool, shape (height, width)
        Pixels that may be used.
    x_px, y_px, noise : ndarray, shape (n,)
        Peaks, brightest first, and the noise per pixel at them.
    gain : tuple
        Electrons per ADU, and whether that is known.

    Returns
    -------
    profiles : Profiles
        All of the image's own width.
    psf : Psf
        Holds the law of the noise; its form has no meaning here.
    """
    half = image.half_px
    form = make_cutouts(sky_free, good, np.zeros(0), np.zeros(0), np.zeros(0), half)
    table = _table(image, form.dx, form.dy)
    psf = Psf(0.0, gain[0], 0.0)
    few = slice(0, min(_NOISE_STARS, x_px.size))
    for _ in range(2):
        fit, cutouts, x, y = _fitted(sky_free, good, x_px[few], y_px[few], noise[few], half, table, psf)
        strong = fit.params[:, 0] > _NOISE_STAR_SNR * np.sqrt(covariances(fit.normal)[:, 0, 0])
        psf = with_noise_law(psf, fit.part(strong), cutouts.part(strong), gain[0], card=gain[1])
    share = max(1, _PIXELS_AT_ONCE // form.dx.size)
    parts = []
    for start in range(0, max(1, x_px.size), share):
        some = slice(start, start + share)
        fit, cutouts, x, y = _fitted(sky_free, good, x_px[some], y_px[some], noise[some], half, table, psf)
        parts.append(_profiles(fit, x, y, np.hypot(x - x_px[some], y - y_px[some]), image, cutouts))
    return Profiles.joined(parts), psf


def _fitted(
    sky_free: Image, good: Mask, x: Array, y: Array, noise: Array, half: int, table: _Table, psf: Psf
) -> tuple[Fit, Cutouts, Array, Array]:
    """Gauss-Newton over amplitude, position and sky; the cutouts follow the positions."""
    params = np.zeros((x.size, 4))
    for _ in range(_PASSES):
        cutouts = make_cutouts(sky_free, good, x, y, noise, half)
        values = np.where(cutouts.good, cutouts.values, 0.0)
        params[:, 1], params[:, 2] = x - cutouts.x0, y - cutouts.y0
        for _ in range(_ROUNDS):
            jacobian, residual, weights = _linear(params, values, cutouts, table, psf)
            weighted = jacobian * weights[:, None, :]
            normal = weighted @ jacobian.transpose(0, 2, 1)
            step = np.einsum("nij,nj->ni", covariances(normal), (weighted @ residual[:, :, None])[:, :, 0])
            step[:, 1:3] = np.clip(step[:, 1:3], -0.7, 0.7)
            params += step
            params[:, 1:3] = np.clip(params[:, 1:3], -_STEPS * _STEP_PX, _STEPS * _STEP_PX)
        x, y = cutouts.x0 + params[:, 1], cutouts.y0 + params[:, 2]
    jacobian, residual, weights = _linear(params, values, cutouts, table, psf)
    normal = (jacobian * weights[:, None, :]) @ jacobian.transpose(0, 2, 1)
    return Fit(params, normal, residual, jacobian, weights), cutouts, x, y


def _linear(
    params: Array, values: Array, cutouts: Cutouts, table: _Table, psf: Psf
) -> tuple[Array, Array, Array]:
    image, slope_x, slope_y = table.at(params[:, 1], params[:, 2])
    amplitude = params[:, 0, None]
    light = amplitude * image
    # before there is an amplitude, the slopes of a star that just shows keep the equations solvable
    least = np.sqrt(cutouts.variance[:, :1]) / np.maximum(image.max(axis=1, keepdims=True), 1e-9)
    steep = np.maximum(amplitude, 0.1 * least)
    jacobian = np.stack([image, steep * slope_x, steep * slope_y, np.ones_like(image)], axis=1)
    weights = cutouts.good / psf.variance(cutouts.variance, np.maximum(light, 0.0))
    return jacobian, values - light - params[:, 3, None], weights


def _profiles(fit: Fit, x: Array, y: Array, drift: Array, image: Epsf, cutouts: Cutouts) -> Profiles:
    sigmas = np.sqrt(np.maximum(np.einsum("nii->ni", covariances(fit.normal)), 0.0))
    flux = fit.params[:, 0]
    top = float(image.pixels.max())
    core = cutouts.good & (fit.jacobian[:, 0] > _CORE * top)
    pixels = np.maximum(core.sum(axis=1), 1)
    amplitude = flux * top
    misfit = np.sqrt((fit.residual**2 * core).sum(axis=1) / pixels) / np.maximum(amplitude, 1e-12)
    ones = np.ones(x.size)
    return Profiles(
        x_px=x,
        y_px=y,
        x_sigma_px=sigmas[:, 1],
        y_sigma_px=sigmas[:, 2],
        amplitude=amplitude,
        flux=flux.copy(),
        flux_sigma=sigmas[:, 0],
        minor_fwhm_px=image.minor_fwhm_px * ones,
        major_fwhm_px=image.major_fwhm_px * ones,
        angle_deg=image.angle_deg * ones,
        misfit=misfit,
        chi2=(fit.weights * fit.residual**2).sum(axis=1) / np.maximum(cutouts.good.sum(axis=1) - 4.0, 1.0),
        converged=(drift < _FAR_PX) & (flux > 0) & np.isfinite(sigmas).all(axis=1),
    )
