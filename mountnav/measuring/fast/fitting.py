"""Amplitude, position and sky of many stars fitted at once with a known PSF, saturated stars included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from mountnav.measuring.fast.candidates import SaturatedPatches
from mountnav.measuring.fast.psf import EllipticalPsf, Pixels, SampledPsf, drawn
from mountnav.measuring.fast.scene import Scene
from mountnav.measuring.least_squares import covariances
from mountnav.measuring.psf_photometry import OVERFLOW_SHARE, OVERFLOW_SIGMA

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROUNDS = 3
"""Linear fits of all stars, each with the others' light as fitted last. Doubled, 6 % better in a glow, at
twice the time; with one, the pull there grows from 0.7 to 1.7."""
_JUDGED_AFTER = 1
"""Outliers are left out after this round (counted from 0). One later, the rms error of A01's stars grows from
0.11 to 0.19 px."""
_MOST_STEP_PX = 0.7
"""Largest step of a position in a round, px: the slopes lead no farther. At 0.4 or 0.85 no figure changed by
3 %."""
_OUTLIER_SIGMA = 5.0
"""A pixel of a disc's outer part is left out if it differs from the fit by so many sigmas ..."""
_OUTLIER_SHARE = 0.15
"""... and this share of the star's light in it: PSFs misfit real wings. Doubled, two neighbors more pull in
70; halved, no figure changed by 3 %."""
_CORE_FWHM = 0.75
"""Radius in FWHM inside which no pixel is left out: there the star itself would go. At 0.875 the rms error of
A01's stars grows from 0.11 to 0.14 px."""
_REACH = 1.75
"""Neighbors are sought within this many disc radii. Halved, 4 of 234 stars of a crowd are lost; doubled, only
time is spent."""
_FEWEST_PIXELS = 5
"""Usable pixels in the core, or the fit is unsound: four parameters and one to spare. Doubled, all narrow
stars (FWHM 1.5 px) are unsound."""


@dataclass(frozen=True, slots=True)
class FittedStars:
    """Fits of stars, each array of shape (n,).

    Attributes
    ----------
    x_px, y_px, x_sigma_px, y_sigma_px : ndarray
        Centers and their errors; shape (n,).
    flux, flux_sigma : ndarray
        ADU; shape (n,).
    misfit : ndarray
        Rms of the residuals in the core over the amplitude, the noise's share taken off.
    sound : ndarray of bool
        False for what ran away, is dark, or has hardly a usable pixel.
    """

    x_px: Array
    y_px: Array
    x_sigma_px: Array
    y_sigma_px: Array
    flux: Array
    flux_sigma: Array
    misfit: Array
    sound: Mask

    def part(self, some: slice) -> FittedStars:
        """Some of them."""
        return FittedStars(*(getattr(self, name)[some] for name in FittedStars.__dataclass_fields__))


def fit_stars(scene: Scene, image: SampledPsf, x_px: Array, y_px: Array) -> FittedStars:
    """Fit stars at positions.

    The ePSF at the nearest of its drawn positions, its slopes and a level are fitted linearly, with the
    noise law's weights; the position moves, the light of others that reaches into the disc is taken off, and
    that is repeated. What still stands out at a disc's rim is left out.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        Within a pixel of the stars.
    """
    height, width = scene.frame.pixels.shape
    x0 = np.clip(np.rint(x_px).astype(np.intp), 0, width - 1)
    y0 = np.clip(np.rint(y_px).astype(np.intp), 0, height - 1)
    seen, good = _discs(scene, image, x0, y0)
    values = seen
    sky2 = (scene.noise_at(x_px, y_px) ** 2).astype(np.float32)[:, None]
    psf = image.shape.psf
    x, y = x_px - x0, y_px - y0
    weights = np.asarray(good / sky2, dtype=np.float32)
    for turn in range(_ROUNDS):
        drawing, at_x, at_y = image.near(x, y)
        own, solved, basis = solved_for(image.drawings[drawing], values, weights)
        amplitude = solved[:, 0]
        bright = np.maximum(amplitude, 1e-9)
        x = x + np.clip(at_x + solved[:, 1] / bright - x, -_MOST_STEP_PX, _MOST_STEP_PX)
        y = y + np.clip(at_y + solved[:, 2] / bright - y, -_MOST_STEP_PX, _MOST_STEP_PX)
        if turn == _ROUNDS - 1:
            break
        light = bright.astype(np.float32)[:, None] * basis[:, 0]
        around = _neighbors(image, x0, y0, x, y, amplitude)
        if around is not None:
            values = seen - around
            light += np.maximum(around, 0.0)
        if turn == _JUDGED_AFTER:
            far = _distance2(image, x, y) > (_CORE_FWHM * scene.fwhm_px) ** 2
            limit = _OUTLIER_SIGMA * np.sqrt(psf.variance(sky2, light)) + _OUTLIER_SHARE * light
            good &= ~(far & (np.abs(_rest(values, solved, basis)) > limit))
        weights = np.asarray(good / psf.variance(sky2, light), dtype=np.float32)
    covariance = covariances(own)
    core = good & (_distance2(image, x, y) < scene.fwhm_px**2)
    count = core.sum(axis=1)
    rest2 = (_rest(values, solved, basis) ** 2 * core).sum(axis=1) / np.maximum(count, 1)
    area = image.shape.area_px2
    sound = (amplitude > 0.0) & (np.hypot(x0 + x - x_px, y0 + y - y_px) < max(0.75 * scene.fwhm_px, 1.5))
    return FittedStars(
        x0 + x,
        y0 + y,
        np.sqrt(np.maximum(covariance[:, 1, 1], 0.0)) / bright,
        np.sqrt(np.maximum(covariance[:, 2, 2], 0.0)) / bright,
        amplitude * area,
        np.sqrt(np.maximum(covariance[:, 0, 0], 0.0)) * area,
        np.sqrt(np.maximum(rest2 - 1.5 * sky2[:, 0], 0.0)) / bright,
        np.asarray(sound & (count >= _FEWEST_PIXELS)),
    )


def _distance2(image: SampledPsf, x: Array, y: Array) -> Pixels:
    """Squared distance of the discs' pixels to positions in the middle pixel, shape (n, pixels)."""
    u = image.dx.astype(np.float32) - x[:, None].astype(np.float32)
    v = image.dy.astype(np.float32) - y[:, None].astype(np.float32)
    return np.asarray(u * u + v * v)


def _rest(values: Pixels, solved: Array, basis: Pixels) -> Pixels:
    """What a solution leaves over, shape (n, pixels)."""
    model = np.einsum("nkp,nk->np", basis[:, :4], solved.astype(np.float32))
    return np.asarray(values - model)


def _discs(
    scene: Scene, image: SampledPsf, x0: NDArray[np.intp], y0: NDArray[np.intp]
) -> tuple[Pixels, Mask]:
    """Pixels of the discs without the sky's level, shape (n, pixels), and which of them can be used."""
    pixels = scene.frame.pixels
    height, width = pixels.shape
    rows, columns = y0[:, None] + image.dy, x0[:, None] + image.dx
    half = int(image.dx.max())
    rim = ((x0 < half) | (y0 < half) | (x0 >= width - half) | (y0 >= height - half)).any()
    if rim:
        good = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        rows, columns = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
    values = pixels.ravel()[rows * width + columns].astype(np.float32)
    usable = values < scene.full_adu if np.isfinite(scene.full_adu) else np.isfinite(values)
    if rim:
        usable &= good
    values -= np.float32(scene.sky_adu)
    if pixels.dtype.kind == "f":
        values[~np.isfinite(values)] = 0.0
    return values, usable


def solved_for(drawing: Pixels, values: Pixels, weights: Pixels) -> tuple[Array, Array, Pixels]:
    """Fit drawings and their slopes, and a level, to pixels by least squares.

    Parameters
    ----------
    drawing : ndarray of float32, shape (n, 3, pixels)
        From `drawn`.
    values, weights : ndarray of float32, shape (n, pixels)
        Light on the pixels of each star, and its weights.

    Returns
    -------
    normal : ndarray, shape (n, 4, 4)
        Information matrices.
    solved : ndarray, shape (n, 4)
        Amplitude, amplitude times steps in x and y, level.
    basis : ndarray of float32, shape (n, 5, pixels)
        Value, slopes, ones, and the pixels themselves.
    """
    basis = np.empty((drawing.shape[0], 5, drawing.shape[2]), dtype=np.float32)
    basis[:, :3], basis[:, 3], basis[:, 4] = drawing, 1.0, values
    normal = ((basis[:, :4] * weights[:, None]) @ basis.transpose(0, 2, 1)).astype(np.float64)
    own = normal[:, :, :4]
    # that it can be inverted however few pixels there are
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("nii->ni", own), 1e-30))
    scaled = own * scale[:, :, None] * scale[:, None, :] + 1e-9 * np.eye(4)
    solved = np.linalg.solve(scaled, normal[:, :, 4:] * scale[:, :, None])[:, :, 0] * scale
    return own, solved, basis


def _neighbors(
    image: SampledPsf, x0: NDArray[np.intp], y0: NDArray[np.intp], x: Array, y: Array, amplitude: Array
) -> Pixels | None:
    """Light of the other stars on each one's disc, shape (n, pixels); None if there is none."""
    if x.size < 2:
        return None
    positions = np.column_stack([x0 + x, y0 + y])
    pairs = KDTree(positions).query_pairs(_REACH * float(image.dx.max()), output_type="ndarray")
    if pairs.size == 0:
        return None
    on = np.concatenate([pairs[:, 0], pairs[:, 1]])
    of = np.concatenate([pairs[:, 1], pairs[:, 0]])
    u = image.dx - (positions[of, 0] - x0[on])[:, None]
    v = image.dy - (positions[of, 1] - y0[on])[:, None]
    light = drawn(image.shape, u.astype(np.float32), v.astype(np.float32))[:, 0]
    light *= np.maximum(amplitude[of], 0.0)[:, None].astype(np.float32)
    total = np.zeros((x.size, image.dx.size), dtype=np.float32)
    np.add.at(total, on, light)
    return total


_REACH_FWHM = 2.5
"""Half side of a saturated star's square beyond its patch, in FWHM: its wings."""
_WIDEST_PX = 30
"""And at most so many pixels: bounds the time. Doubled or halved, nothing changed on the frames that were
tried."""
_SATURATED_ROUNDS = 12
"""Fits of a saturated star: far from linear at first. Doubled or halved, no figure changed by 3 %."""
_SATURATED_JUDGED_AFTER = 2
"""Overflow is left out from this round on (counted from 0)."""
_STILL_PX = 2e-3
"""Stars whose positions move by less than this, px, have converged: the error of the best of them. Doubled or
halved, no figure changed by 3 %."""
_FEWEST_WING_PIXELS = 12
"""Usable pixels, or the fit is unsound: three times its parameters. Doubled or halved, nothing changed on the
frames that were tried."""
_CROSS = np.zeros((3, 3, 3), dtype=bool)
_CROSS[1] = ndimage.generate_binary_structure(2, 1)
"""The four neighbors of a pixel within its own cutout, axes (cutout, row, column)."""


def refit_saturated(scene: Scene, shape: EllipticalPsf, fits: FittedStars, full: SaturatedPatches) -> None:
    """Fit saturated stars again, and put the outcome into the fits.

    Parameters
    ----------
    fits : FittedStars
        Changed at ``full.which``.
    """
    half = np.clip(np.ceil(full.radius_px + _REACH_FWHM * scene.fwhm_px), 6, _WIDEST_PX)
    half = (4 * np.ceil(half / 4)).astype(np.intp)
    for size in np.unique(half):
        _refit(scene, shape, fits, full.part(half == size), int(size))


def _refit(scene: Scene, shape: EllipticalPsf, fits: FittedStars, full: SaturatedPatches, half: int) -> None:
    which, radius = full.which, full.radius_px
    patches = scene.cut(full.x_px, full.y_px, half)
    steps = np.arange(patches.side_px)
    dy, dx = (grid.ravel().astype(np.float32) for grid in np.meshgrid(steps, steps, indexing="ij"))
    values = (patches.values - patches.ground()[:, None, None]).reshape(which.size, -1)
    good = ~overflown(patches.values >= scene.full_adu).reshape(which.size, -1)
    x, y = full.x_px - patches.left, full.y_px - patches.top
    start_x, start_y = x, y
    psf, sky2 = shape.psf, (scene.noise_at(full.x_px, full.y_px) ** 2)[:, None]
    p, q, r = shape.seen()
    # a star that just fills its patch
    top = (scene.full_adu - scene.sky_adu) / psf.of(np.sqrt(p * r - q * q) * radius**2)[0]
    for turn in range(_SATURATED_ROUNDS):
        drawing = drawn(shape, dx - x[:, None].astype(np.float32), dy - y[:, None].astype(np.float32))
        light = np.maximum(top, 0.0)[:, None] * drawing[:, 0]
        variance = psf.variance(sky2, light)
        if turn >= _SATURATED_JUDGED_AFTER:
            good &= values - light < OVERFLOW_SHARE * light + OVERFLOW_SIGMA * np.sqrt(variance)
        own, solved, _ = solved_for(drawing, values, (good / variance).astype(np.float32))
        top = np.clip(solved[:, 0], 0.3 * top, 3.0 * top)
        step_x = np.clip(solved[:, 1] / top, -_MOST_STEP_PX, _MOST_STEP_PX)
        step_y = np.clip(solved[:, 2] / top, -_MOST_STEP_PX, _MOST_STEP_PX)
        x, y = x + step_x, y + step_y
        if turn > _SATURATED_JUDGED_AFTER and max(np.abs(step_x).max(), np.abs(step_y).max()) < _STILL_PX:
            break
    covariance = covariances(own)
    sound = np.hypot(x - start_x, y - start_y) < radius + 0.5 * scene.fwhm_px
    sound &= (good.sum(axis=1) >= _FEWEST_WING_PIXELS) & (np.einsum("nii->ni", covariance) > 0.0).all(axis=1)
    area = shape.area_px2
    for column, value in (
        (fits.x_px, patches.left + x),
        (fits.y_px, patches.top + y),
        (fits.x_sigma_px, np.sqrt(np.abs(covariance[:, 1, 1])) / top),
        (fits.y_sigma_px, np.sqrt(np.abs(covariance[:, 2, 2])) / top),
        (fits.flux, top * area),
        (fits.flux_sigma, np.sqrt(np.abs(covariance[:, 0, 0])) * area),
    ):
        column[which] = np.where(sound, value, column[which])
    fits.sound[which] = True


def overflown(full: Mask) -> Mask:
    """Saturated pixels, those next to them, and three beyond three in a line; (n, side, side)."""
    spoilt = np.asarray(ndimage.binary_dilation(full, structure=_CROSS))
    for axis in (1, 2):
        line, rest = np.moveaxis(full, axis, 1), np.moveaxis(spoilt, axis, 1)
        three = line[:, :-2] & line[:, 1:-1] & line[:, 2:]
        for step in (1, 2, 3):
            rest[:, 2 + step :] |= three[:, : three.shape[1] - step]
            rest[:, : three.shape[1] - step] |= three[:, step:]
    return spoilt
