"""Place and flux of stars by the image they all share, tabled at sub-pixel shifts [S23 §0.2]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Image
from mountnav.measuring.bell import with_noise_law
from mountnav.measuring.common_image import CommonImage
from mountnav.measuring.descent import Fit, covariances
from mountnav.measuring.profile import Profiles
from mountnav.measuring.stamps import Stamps, cut_stamps
from mountnav.measuring.star_shape import Bell

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_STEP_PX = 0.2
_STEPS = 8
_ROUNDS = 4
_PASSES = 3
_PIXELS_AT_ONCE = 60_000
_TEACHERS = 60
_CLEAR = 60.0
_CORE = 0.3
_FAR_PX = 4.0


@dataclass(frozen=True, slots=True)
class _Table:
    """The common image and its slopes on a stamp's pixels at a grid of shifts, each (k, k, pixels)."""

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


def _table(image: CommonImage, dx: Array, dy: Array) -> _Table:
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


def fit_common(
    sky_free: Image,
    good: Mask,
    x_px: Array,
    y_px: Array,
    noise: Array,
    image: CommonImage,
    gain: tuple[float, bool],
) -> tuple[Profiles, Bell]:
    """Fit flux, place and a local sky with a known image.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
    good : ndarray of bool, shape (height, width)
    x_px, y_px, noise : ndarray, shape (n,)
        Peaks, brightest first, and the noise per pixel at them.
    image : CommonImage
    gain : tuple
        Electrons per ADU, and whether that is known.

    Returns
    -------
    profiles : Profiles
        All of the image's own width.
    bell : Bell
        Holds the law of the noise; its form has no meaning here.
    """
    half = image.half_px
    form = cut_stamps(sky_free, good, np.zeros(0), np.zeros(0), np.zeros(0), half)
    table = _table(image, form.dx, form.dy)
    bell = Bell(0.0, gain[0], 0.0)
    few = slice(0, min(_TEACHERS, x_px.size))
    for _ in range(2):
        fit, stamps, x, y = _fitted(sky_free, good, x_px[few], y_px[few], noise[few], half, table, bell)
        strong = fit.params[:, 0] > _CLEAR * np.sqrt(covariances(fit.normal)[:, 0, 0])
        bell = with_noise_law(bell, _of(fit, strong), _some(stamps, strong), gain[0], card=gain[1])
    share = max(1, _PIXELS_AT_ONCE // form.dx.size)
    parts = []
    for start in range(0, max(1, x_px.size), share):
        some = slice(start, start + share)
        fit, stamps, x, y = _fitted(sky_free, good, x_px[some], y_px[some], noise[some], half, table, bell)
        parts.append(_profiles(fit, x, y, np.hypot(x - x_px[some], y - y_px[some]), image, stamps))
    columns = {
        name: np.concatenate([getattr(p, name) for p in parts]) for name in Profiles.__dataclass_fields__
    }
    return Profiles(**columns), bell


def _fitted(
    sky_free: Image, good: Mask, x: Array, y: Array, noise: Array, half: int, table: _Table, bell: Bell
) -> tuple[Fit, Stamps, Array, Array]:
    """Gauss-Newton over amplitude, place and sky; the stamps follow the places."""
    params = np.zeros((x.size, 4))
    for _ in range(_PASSES):
        stamps = cut_stamps(sky_free, good, x, y, noise, half)
        values = np.where(stamps.good, stamps.values, 0.0)
        params[:, 1], params[:, 2] = x - stamps.x0, y - stamps.y0
        for _ in range(_ROUNDS):
            jacobian, residual, weights = _linear(params, values, stamps, table, bell)
            weighted = jacobian * weights[:, None, :]
            normal = weighted @ jacobian.transpose(0, 2, 1)
            step = np.einsum("nij,nj->ni", covariances(normal), (weighted @ residual[:, :, None])[:, :, 0])
            step[:, 1:3] = np.clip(step[:, 1:3], -0.7, 0.7)
            params += step
            params[:, 1:3] = np.clip(params[:, 1:3], -_STEPS * _STEP_PX, _STEPS * _STEP_PX)
        x, y = stamps.x0 + params[:, 1], stamps.y0 + params[:, 2]
    jacobian, residual, weights = _linear(params, values, stamps, table, bell)
    normal = (jacobian * weights[:, None, :]) @ jacobian.transpose(0, 2, 1)
    return Fit(params, normal, residual, jacobian, weights), stamps, x, y


def _linear(
    params: Array, values: Array, stamps: Stamps, table: _Table, bell: Bell
) -> tuple[Array, Array, Array]:
    image, slope_x, slope_y = table.at(params[:, 1], params[:, 2])
    amplitude = params[:, 0, None]
    light = amplitude * image
    # before there is an amplitude, the slopes of a star that just shows keep the equations solvable
    least = np.sqrt(stamps.variance[:, :1]) / np.maximum(image.max(axis=1, keepdims=True), 1e-9)
    steep = np.maximum(amplitude, 0.1 * least)
    jacobian = np.stack([image, steep * slope_x, steep * slope_y, np.ones_like(image)], axis=1)
    weights = stamps.good / bell.variance(stamps.variance, np.maximum(light, 0.0))
    return jacobian, values - light - params[:, 3, None], weights


def _of(fit: Fit, some: Mask) -> Fit:
    return Fit(fit.params[some], fit.normal[some], fit.residual[some], fit.jacobian[some], fit.weights[some])


def _some(stamps: Stamps, some: Mask) -> Stamps:
    return replace(
        stamps,
        values=stamps.values[some],
        variance=stamps.variance[some],
        good=stamps.good[some],
        x0=stamps.x0[some],
        y0=stamps.y0[some],
    )


def _profiles(fit: Fit, x: Array, y: Array, drift: Array, image: CommonImage, stamps: Stamps) -> Profiles:
    sigmas = np.sqrt(np.maximum(np.einsum("nii->ni", covariances(fit.normal)), 0.0))
    flux = fit.params[:, 0]
    top = float(image.pixels.max())
    core = stamps.good & (fit.jacobian[:, 0] > _CORE * top)
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
        chi2=(fit.weights * fit.residual**2).sum(axis=1) / np.maximum(stamps.good.sum(axis=1) - 4.0, 1.0),
        converged=(drift < _FAR_PX) & (flux > 0) & np.isfinite(sigmas).all(axis=1),
    )
