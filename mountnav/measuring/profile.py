"""A star's sub-pixel place and shape: an elliptical bell fitted to its stamp [S23 §0.2]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.descent import PARAMETERS, ROUNDS, Fit, covariances, fit_bells, seen_amplitude
from mountnav.measuring.stamps import Stamps, cut_stamps
from mountnav.measuring.star_shape import FWHM_PER_SIGMA, Array, Bell, Shape

_FAR_DRIFT_SIGMAS = 2.5


@dataclass(frozen=True, slots=True)
class Profiles:
    """Fitted profiles, each array of shape (n,); lengths in pixels, flux in ADU.

    ``minor_fwhm_px`` and ``major_fwhm_px`` are along the ellipse's axes, the pixels' own width included;
    ``angle_deg`` is the major axis' direction from +x towards +y; ``misfit`` is the residuals' rms inside the
    core over the amplitude, ``chi2`` the reduced one of the whole stamp; ``converged`` tells whether place
    and shape are those of a star.
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
    angle_deg: Array
    misfit: Array
    chi2: Array
    converged: NDArray[np.bool_]


def fit_profiles(
    stamps: Stamps,
    x_px: Array,
    y_px: Array,
    width_px: float,
    bell: Bell,
    *,
    shape: Shape | None = None,
    rounds: int = ROUNDS,
    height: Array | None = None,
) -> Profiles:
    """Fit amplitude, place, an elliptical width and a local sky to each stamp.

    The model is a B(p u² + 2 q u v + r v²) + b with u, v relative to the place and B the frame's bell. All
    stamps go through a damped Gauss-Newton iteration together. A pixel's variance is that of the sky plus
    that of the star's own photons; with these weights the place's error is the Cramér-Rao bound of the
    model, and the reported sigmas are its inverse information matrix. Saturated pixels are left out, so that
    the wings alone place a saturated star.

    Parameters
    ----------
    stamps : Stamps
    x_px, y_px : ndarray, shape (n,)
        Where to start, pixels of the frame.
    width_px : float
        Width to start from, pixels: a Gaussian's sigma.
    bell : Bell
    shape : Shape, optional
        Known beforehand: for saturated stars and blends.
    rounds : int, optional
        At most so many.
    height : ndarray, shape (n,), optional
        Amplitudes to start from.

    Returns
    -------
    Profiles
    """
    fit = fit_bells(stamps, x_px, y_px, width_px, bell, shape=shape, rounds=rounds, height=height)
    return _profiles(fit, stamps, float(stamps.dx.max()), width_px, bell)


def _profiles(fit: Fit, stamps: Stamps, half: float, sigma: float, bell: Bell) -> Profiles:
    params, normal, residual, mask = fit.params, fit.normal, fit.residual, stamps.good
    a, x, y, p, q, r, _ = params.T
    covariance = covariances(normal)
    # where nearly all pixels are masked the matrix is singular: such a fit knows nothing, and says so
    diagonal = np.einsum("nii->ni", covariance)
    known = (diagonal[:, :3] > 0.0).all(axis=1)
    sigmas = np.where(known[:, None], np.sqrt(np.maximum(diagonal, 0.0)), half)
    mean, swing = 0.5 * (p + r), np.hypot(0.5 * (p - r), q)
    narrow = 1.0 / np.sqrt(mean + swing)
    wide = 1.0 / np.sqrt(np.maximum(mean - swing, 1e-6))
    area = bell.volume * narrow * wide
    a = seen_amplitude(params) if bell.integrated else a
    # flux = a · volume / √(pr − q²): its error takes the shape's covariance along
    slope = np.zeros_like(params)
    slope[:, 0] = area * a / np.maximum(params[:, 0], 1e-12)
    excess = np.maximum(p * r - q * q, 1e-12)
    slope[:, 3], slope[:, 5] = -0.5 * a * area * r / excess, -0.5 * a * area * p / excess
    slope[:, 4] = a * area * q / excess
    flux_variance = np.einsum("ni,nij,nj->n", slope, covariance, slope)
    known &= flux_variance > 0.0
    flux_sigma = np.where(known, np.sqrt(np.maximum(flux_variance, 0.0)), np.abs(a * area))
    u, v = stamps.dx[None, :] - x[:, None], stamps.dy[None, :] - y[:, None]
    core = mask & (p[:, None] * u * u + 2.0 * q[:, None] * u * v + r[:, None] * v * v < 4.0)
    pixels = np.maximum(core.sum(axis=1), 1)
    misfit = np.sqrt((residual**2 * core).sum(axis=1) / pixels) / np.maximum(a, 1e-12)
    drift = np.hypot(x, y)
    converged = (
        (drift < max(_FAR_DRIFT_SIGMAS * sigma, 1.5)) & (a > 0) & known & np.isfinite(sigmas).all(axis=1)
    )
    return Profiles(
        x_px=stamps.x0 + x,
        y_px=stamps.y0 + y,
        x_sigma_px=sigmas[:, 1],
        y_sigma_px=sigmas[:, 2],
        amplitude=a,
        flux=a * area,
        flux_sigma=flux_sigma,
        minor_fwhm_px=bell.fwhm_per_width * narrow,
        major_fwhm_px=bell.fwhm_per_width * wide,
        # the model's Q grows fastest along the minor axis; the major one is square to it
        angle_deg=np.degrees(0.5 * np.arctan2(-2.0 * q, r - p)),
        misfit=misfit,
        chi2=(fit.weights * residual**2).sum(axis=1) / np.maximum(mask.sum(axis=1) - PARAMETERS, 1.0),
        converged=np.asarray(converged),
    )


def inverse_widths(fits: Profiles, bell: Bell) -> tuple[Array, Array, Array]:
    """Return p, q, r of Q = p u² + 2 q u v + r v², each of shape (n,)."""
    angle = np.radians(fits.angle_deg)
    along, across = ((bell.fwhm_per_width / w) ** 2 for w in (fits.major_fwhm_px, fits.minor_fwhm_px))
    cos, sin = np.cos(angle), np.sin(angle)
    return (
        along * cos * cos + across * sin * sin,
        (along - across) * sin * cos,
        along * sin * sin + across * cos * cos,
    )


def light_on(
    fits: Profiles, which: NDArray[np.intp], x0: Array, y0: Array, stamps: Stamps, bell: Bell
) -> Array:
    """Light of fitted stars on stamps of the same form as others, shape (len(which), pixels).

    Parameters
    ----------
    fits : Profiles
    which : ndarray of int, shape (k,)
        Whose light.
    x0, y0 : ndarray, shape (k,)
        Center pixel of the stamp that it falls on.
    stamps : Stamps
        For the form alone.
    bell : Bell

    Returns
    -------
    ndarray
    """
    u = x0[:, None] + stamps.dx - fits.x_px[which, None]
    v = y0[:, None] + stamps.dy - fits.y_px[which, None]
    p, q, r = (w[which, None] for w in inverse_widths(fits, bell))
    return np.asarray(fits.amplitude[which, None] * bell.of(p * u * u + 2.0 * q * u * v + r * v * v)[0])


__all__ = [
    "FWHM_PER_SIGMA",
    "Bell",
    "Profiles",
    "cut_stamps",
    "fit_profiles",
    "inverse_widths",
    "light_on",
]
