"""Saturated stars: the common star fitted to their wings alone, overflow left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.descent import covariances
from mountnav.measuring.glance.candidates import FullPatches
from mountnav.measuring.glance.placing import Placed, solved_for
from mountnav.measuring.glance.scene import Scene
from mountnav.measuring.glance.star_image import StarShape, drawn

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_REACH_FWHM = 2.5
_WIDEST_PX = 30
_ROUNDS = 12
_JUDGED_AFTER = 2
_MOST_STEP_PX = 0.7
_STILL_PX = 2e-3
_OVERFLOW_SHARE = 0.4
_OVERFLOW_SIGMA = 6.0
_FEWEST_PIXELS = 12
_CROSS = np.zeros((3, 3, 3), dtype=bool)
_CROSS[1] = ndimage.generate_binary_structure(2, 1)


def refit_full(scene: Scene, shape: StarShape, fits: Placed, full: FullPatches) -> None:
    """Fit saturated stars again, and put the outcome into the fits.

    Parameters
    ----------
    scene : Scene
    shape : StarShape
    fits : Placed
        Changed at ``full.which``.
    full : FullPatches
    """
    half = np.clip(np.ceil(full.radius_px + _REACH_FWHM * scene.fwhm_px), 6, _WIDEST_PX)
    half = (4 * np.ceil(half / 4)).astype(np.intp)
    for size in np.unique(half):
        _refit(scene, shape, fits, full.part(half == size), int(size))


def _refit(scene: Scene, shape: StarShape, fits: Placed, full: FullPatches, half: int) -> None:
    which, radius = full.which, full.radius_px
    patches = scene.cut(full.x_px, full.y_px, half)
    steps = np.arange(patches.side_px)
    dy, dx = (grid.ravel().astype(np.float32) for grid in np.meshgrid(steps, steps, indexing="ij"))
    values = (patches.values - patches.ground()[:, None, None]).reshape(which.size, -1)
    good = ~overflown(patches.values >= scene.full_adu).reshape(which.size, -1)
    x, y = full.x_px - patches.left, full.y_px - patches.top
    start_x, start_y = x, y
    bell, sky2 = shape.bell, (scene.noise_at(full.x_px, full.y_px) ** 2)[:, None]
    p, q, r = shape.seen()
    # a star that just fills its patch
    top = (scene.full_adu - scene.sky_adu) / bell.of(np.sqrt(p * r - q * q) * radius**2)[0]
    for turn in range(_ROUNDS):
        drawing = drawn(shape, dx - x[:, None].astype(np.float32), dy - y[:, None].astype(np.float32))
        light = np.maximum(top, 0.0)[:, None] * drawing[:, 0]
        variance = bell.variance(sky2, light)
        if turn >= _JUDGED_AFTER:
            good &= values - light < _OVERFLOW_SHARE * light + _OVERFLOW_SIGMA * np.sqrt(variance)
        own, solved, _ = solved_for(drawing, values, (good / variance).astype(np.float32))
        top = np.clip(solved[:, 0], 0.3 * top, 3.0 * top)
        step_x = np.clip(solved[:, 1] / top, -_MOST_STEP_PX, _MOST_STEP_PX)
        step_y = np.clip(solved[:, 2] / top, -_MOST_STEP_PX, _MOST_STEP_PX)
        x, y = x + step_x, y + step_y
        if turn > _JUDGED_AFTER and max(np.abs(step_x).max(), np.abs(step_y).max()) < _STILL_PX:
            break
    covariance = covariances(own)
    sound = np.hypot(x - start_x, y - start_y) < radius + 0.5 * scene.fwhm_px
    sound &= (good.sum(axis=1) >= _FEWEST_PIXELS) & (np.einsum("nii->ni", covariance) > 0.0).all(axis=1)
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
