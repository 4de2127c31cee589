"""A star's sub-pixel place and shape: an elliptical Gaussian fitted to many stamps at once [S23 §0.2]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.background import Image

Array = NDArray[np.float64]

#: Full width at half maximum over sigma of a Gaussian.
FWHM_PER_SIGMA = 2.0 * np.sqrt(2.0 * np.log(2.0))
_ROUNDS = 12
_STILL_PX = 5e-4
_STRAGGLERS = 0.03
_PARAMETERS = 7
_NARROWEST_SIGMA_PX = 0.3
_FAR_DRIFT_SIGMAS = 2.5


@dataclass(frozen=True, slots=True)
class Stamps:
    """Round cuttings at peaks.

    Attributes
    ----------
    values, variance : ndarray, shape (n, pixels)
        Background-subtracted pixels, and the variance of the sky noise in them.
    good : ndarray of bool, shape (n, pixels)
        False for missing, saturated and outlying pixels.
    dx, dy : ndarray, shape (pixels,)
        Pixel places relative to the stamp's center.
    x0, y0 : ndarray, shape (n,)
        The center pixels' places in the frame.
    """

    values: Array
    variance: Array
    good: NDArray[np.bool_]
    dx: Array
    dy: Array
    x0: Array
    y0: Array


@dataclass(frozen=True, slots=True)
class Profiles:
    """Fitted profiles, each array of shape (n,); lengths in pixels, flux in ADU.

    ``minor_fwhm_px`` and ``major_fwhm_px`` are along the ellipse's axes; ``misfit`` is the residuals' rms
    inside the core over the amplitude; ``converged`` tells whether place and shape are those of a star.
    """

    x_px: Array
    y_px: Array
    x_sigma_px: Array
    y_sigma_px: Array
    amplitude: Array
    flux: Array
    flux_sigma: Array
    minor_fwhm_px: Array
    major_fwhm_px: Array
    misfit: Array
    converged: NDArray[np.bool_]


def cut_stamps(
    sky_free: Image, good: NDArray[np.bool_], x_px: Array, y_px: Array, noise: Array, half_px: int
) -> Stamps:
    """Cut discs of radius ``half_px`` at places; what hangs over the frame's edge is not good.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
    good : ndarray of bool, shape (height, width)
    x_px, y_px, noise : ndarray, shape (n,)
        Places, and the sky noise per pixel at them.
    half_px : int

    Returns
    -------
    Stamps
    """
    height, width = sky_free.shape
    offset = np.arange(-half_px, half_px + 1)
    dy, dx = (grid.ravel() for grid in np.meshgrid(offset, offset, indexing="ij"))
    disc = np.hypot(dx, dy) <= half_px + 0.5
    dx, dy = dx[disc], dy[disc]
    x0, y0 = np.rint(x_px).astype(int), np.rint(y_px).astype(int)
    columns, rows = x0[:, None] + dx, y0[:, None] + dy
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    flat = np.clip(rows, 0, height - 1) * width + np.clip(columns, 0, width - 1)
    return Stamps(
        values=sky_free.ravel()[flat].astype(np.float64),
        variance=np.broadcast_to((noise * noise)[:, None], flat.shape),
        good=inside & good.ravel()[flat],
        dx=dx.astype(np.float64),
        dy=dy.astype(np.float64),
        x0=x0.astype(np.float64),
        y0=y0.astype(np.float64),
    )


def fit_profiles(stamps: Stamps, x_px: Array, y_px: Array, sigma_px: float, gain_e_adu: float) -> Profiles:
    """Fit amplitude, place, an elliptical width and a local sky to each stamp.

    The model is a exp(-(p u² + 2 q u v + r v²) / 2) + b with u, v relative to the place. All stamps go
    through a damped Gauss-Newton iteration together. A pixel's variance is that of the sky plus that of the
    star's own photons, model / gain; with these weights the place's error is the Cramér-Rao bound of the
    model, and the reported sigmas are its inverse information matrix. Saturated pixels are left out, so that
    the wings alone place a saturated star.

    Parameters
    ----------
    stamps : Stamps
    x_px, y_px : ndarray, shape (n,)
        Where to start, pixels of the frame.
    sigma_px : float
        Width to start from.
    gain_e_adu : float
        Electrons per ADU.

    Returns
    -------
    Profiles
    """
    count = stamps.values.shape[0]
    dx, dy = stamps.dx[None, :], stamps.dy[None, :]
    half = float(stamps.dx.max())
    mask = stamps.good
    values = np.where(mask, stamps.values, 0.0)
    start_u, start_v = dx - (x_px - stamps.x0)[:, None], dy - (y_px - stamps.y0)[:, None]
    shape = np.exp(-0.5 * (start_u**2 + start_v**2) / sigma_px**2) * mask
    amplitude = np.maximum((values * shape).sum(axis=1) / np.maximum((shape * shape).sum(axis=1), 1e-3), 1e-9)
    inverse = 1.0 / sigma_px**2
    params = np.zeros((count, _PARAMETERS))
    params[:, 0] = amplitude
    params[:, 1], params[:, 2] = x_px - stamps.x0, y_px - stamps.y0
    params[:, 3], params[:, 5] = inverse, inverse
    damping = np.full(count, 1e-2)
    weights = _weights(params, dx, dy, mask, stamps.variance, gain_e_adu)
    widest = half * 0.8
    kept = params
    jacobian, residual = _linear(params, dx, dy, values)
    cost = (weights * residual**2).sum(axis=1)
    for turn in range(_ROUNDS):
        weighted = jacobian * weights[:, None, :]
        normal = weighted @ jacobian.transpose(0, 2, 1)
        gradient = (weighted @ residual[:, :, None])[:, :, 0]
        step = _solve(normal, gradient, damping)
        trial = _bounded(kept + step, kept, half, widest)
        trial_jacobian, trial_residual = _linear(trial, dx, dy, values)
        trial_cost = (weights * trial_residual**2).sum(axis=1)
        better = trial_cost <= cost * (1.0 + 1e-9)
        damping = np.where(better, damping * 0.2, damping * 8.0)
        kept = np.where(better[:, None], trial, kept)
        jacobian = np.where(better[:, None, None], trial_jacobian, jacobian)
        residual = np.where(better[:, None], trial_residual, residual)
        if turn in (1, 3):  # the photons' share of the variance follows the model, twice
            weights = _weights(kept, dx, dy, mask, stamps.variance, gain_e_adu)
            cost = (weights * residual**2).sum(axis=1)
        else:
            cost = np.where(better, trial_cost, cost)
        moving = np.abs(step[:, 1:3]).max(axis=1) > _STILL_PX
        if turn > 4 and np.count_nonzero(moving) <= _STRAGGLERS * count:
            break
    weights = _weights(kept, dx, dy, mask, stamps.variance, gain_e_adu)
    weighted = jacobian * weights[:, None, :]
    normal = weighted @ jacobian.transpose(0, 2, 1)
    return _profiles(kept, normal, residual, mask, stamps, half, sigma_px)


def _linear(params: Array, dx: Array, dy: Array, values: Array) -> tuple[Array, Array]:
    """Jacobian (n, 7, pixels) and residual data - model (n, pixels)."""
    a, x, y, p, q, r, b = (params[:, i, None] for i in range(_PARAMETERS))
    u, v = dx - x, dy - y
    bell = np.exp(-0.5 * (p * u * u + 2.0 * q * u * v + r * v * v))
    model = a * bell
    jacobian = np.stack(
        [
            bell,
            model * (p * u + q * v),
            model * (q * u + r * v),
            -0.5 * model * u * u,
            -model * u * v,
            -0.5 * model * v * v,
            np.ones_like(model),
        ],
        axis=1,
    )
    return jacobian, values - model - b


def _weights(
    params: Array, dx: Array, dy: Array, mask: NDArray[np.bool_], variance: Array, gain: float
) -> Array:
    a, x, y, p, q, r, _ = (params[:, i, None] for i in range(_PARAMETERS))
    u, v = dx - x, dy - y
    model = np.maximum(a, 0.0) * np.exp(-0.5 * (p * u * u + 2.0 * q * u * v + r * v * v))
    return mask / (variance + model / gain)


def _solve(normal: Array, gradient: Array, damping: Array) -> Array:
    """Solve the damped normal equations after scaling them to a unit diagonal."""
    diagonal = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-30))
    scaled = normal / (diagonal[:, :, None] * diagonal[:, None, :])
    scaled += (damping[:, None, None] + 1e-10) * np.eye(_PARAMETERS)
    return np.asarray(np.linalg.solve(scaled, (gradient / diagonal)[:, :, None])[:, :, 0] / diagonal)


def _bounded(trial: Array, before: Array, half: float, widest: float) -> Array:
    """Keep a step inside the stamp, and widths between a hot pixel's and the stamp's."""
    trial = trial.copy()
    trial[:, 0] = np.clip(trial[:, 0], 0.2 * before[:, 0], 5.0 * before[:, 0])
    trial[:, 1:3] = before[:, 1:3] + np.clip(trial[:, 1:3] - before[:, 1:3], -1.5, 1.5)
    trial[:, 1:3] = np.clip(trial[:, 1:3], -half, half)
    least, most = 1.0 / widest**2, 1.0 / _NARROWEST_SIGMA_PX**2
    for i in (3, 5):
        trial[:, i] = np.clip(trial[:, i], 0.3 * before[:, i], 3.0 * before[:, i])
        trial[:, i] = np.clip(trial[:, i], least, most)
    room = 0.97 * np.sqrt(trial[:, 3] * trial[:, 5])
    trial[:, 4] = np.clip(trial[:, 4], -room, room)
    return trial


def _profiles(
    params: Array,
    normal: Array,
    residual: Array,
    mask: NDArray[np.bool_],
    stamps: Stamps,
    half: float,
    sigma: float,
) -> Profiles:
    a, x, y, p, q, r, _ = params.T
    diagonal = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-30))
    scaled = normal / (diagonal[:, :, None] * diagonal[:, None, :]) + 1e-9 * np.eye(_PARAMETERS)
    covariance = np.linalg.inv(scaled) / (diagonal[:, :, None] * diagonal[:, None, :])
    sigmas = np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 0.0))
    mean, swing = 0.5 * (p + r), np.hypot(0.5 * (p - r), q)
    narrow = 1.0 / np.sqrt(mean + swing)
    wide = 1.0 / np.sqrt(np.maximum(mean - swing, 1e-6))
    area = 2.0 * np.pi * narrow * wide
    # flux = a · 2π / √(pr − q²): its error takes the shape's covariance along
    slope = np.zeros_like(params)
    slope[:, 0] = area
    excess = np.maximum(p * r - q * q, 1e-12)
    slope[:, 3], slope[:, 5] = -0.5 * a * area * r / excess, -0.5 * a * area * p / excess
    slope[:, 4] = a * area * q / excess
    flux_sigma = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", slope, covariance, slope), 0.0))
    u, v = stamps.dx[None, :] - x[:, None], stamps.dy[None, :] - y[:, None]
    core = mask & (p[:, None] * u * u + 2.0 * q[:, None] * u * v + r[:, None] * v * v < 4.0)
    pixels = np.maximum(core.sum(axis=1), 1)
    misfit = np.sqrt((residual**2 * core).sum(axis=1) / pixels) / np.maximum(a, 1e-12)
    drift = np.hypot(x, y)
    converged = (drift < max(_FAR_DRIFT_SIGMAS * sigma, 1.5)) & (a > 0) & np.isfinite(sigmas).all(axis=1)
    return Profiles(
        x_px=stamps.x0 + x,
        y_px=stamps.y0 + y,
        x_sigma_px=sigmas[:, 1],
        y_sigma_px=sigmas[:, 2],
        amplitude=a,
        flux=a * area,
        flux_sigma=flux_sigma,
        minor_fwhm_px=FWHM_PER_SIGMA * narrow,
        major_fwhm_px=FWHM_PER_SIGMA * wide,
        misfit=misfit,
        converged=np.asarray(converged),
    )
