"""The PSF of a frame learned from its bright stars, and fitted to one cutout a source [S23 §0.2]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.cutouts import Cutouts
from mountnav.measuring.least_squares import PARAMETERS, ROUNDS, Fit, covariances, fit_psfs, seen_amplitude
from mountnav.measuring.psf import MOST_WING, Array, Psf, ShapePrior

_WINGS = (0.0, 0.15, 0.3, 0.45)
"""Wings that are tried; the best lies on a parabola through three of them. Typical seeing has 0.3 (a Moffat
exponent of 3.3). Doubled or halved, fluxes of painted Moffat stars scatter by 5 to 7 % more."""
_WING_PRIOR = 0.1
"""One-sigma width of the prior on the wings: where the frame can't decide, they stay Gaussian. At one sigma
it weighs as much as a rise of −2 ln likelihood by 1. Doubled or halved, no figure changed by 3 %."""
_FEWEST_FOR_PSF = 5
"""Stars below which nothing is learned of wings, gain and misfit."""
_BINS = 14
"""Bins of equal number, by the light in the pixel, in which the residuals' variance is compared with the
noise law. Doubled or halved, one source in 481 changes."""
_LEAST_PER_BIN = 25
"""Pixels in a bin at least: its median of χ² is then sure to 38 %. Doubled or halved, nothing changed on the
frames that were tried."""
_MEDIAN_CHI2 = 0.4549
"""Median of χ² with one degree of freedom."""
_GAIN_SIGMAS = 4.0
"""The gain is learned only if the photons' share stands out by so many of its own sigmas. Chosen by hand."""
_GAIN_CONTRADICTION = 2.0
"""A gain from the header is overruled only if the measured one differs by this factor: cards are wrong in
kind (per binned pixel, in another mode), not by percents."""
_MISFIT_SIGMAS = 2.0
"""A misfit below so many of its own sigmas counts as none. Chosen by hand."""
_MOST_LAW_ERROR = 0.4
"""Natural logarithm of the residuals' variance over the law's, in the worst fifth of the bins, up to which
photons may explain it: 0.4 is a factor of 1.5. Above, the residuals are the wings' misfit and tell no gain.
Chosen by hand."""
_MOST_MISFIT = 0.1
"""Largest misfit that goes into the errors, as a share of the light in the pixel: beyond it the fit is poor,
and flagged as such."""
_BLEND_CHI2_RATIO = 3.0
"""A star whose χ² is more than this many times the usual one is a blend and says nothing of the wings."""


def learn_psf(
    cutouts: Cutouts,
    x_px: Array,
    y_px: Array,
    width_px: float,
    gain_e_adu: float,
    *,
    integrated: bool,
    card: bool,
) -> Psf:
    """Find the wings, the gain and the misfit that the cutouts of a frame's bright stars show.

    The wing is the one whose fits leave the least χ². Then the squared residuals, freed from what the fit
    took up itself (the leverage), are compared with the light in the pixel: sky noise at none, photons in
    proportion, and what the profile doesn't explain as its square.

    Parameters
    ----------
    cutouts : Cutouts
        Of unsaturated stars well above the noise; some may be blends or worse.
    x_px, y_px : ndarray, shape (n,)
        Where to start, pixels of the frame.
    width_px : float
        A Gaussian's sigma to start from.
    gain_e_adu : float
        What else is known of the gain.
    integrated : bool
        Integrate over the pixels.
    card : bool
        The gain is from the header: only a clear contradiction overrules it.
    """
    psf = Psf(0.0, gain_e_adu, 0.0, integrated)
    if x_px.size < _FEWEST_FOR_PSF:
        return psf
    first = fit_psfs(cutouts, x_px, y_px, width_px, psf)
    alike = _alike(first, width_px)
    if alike.sum() < _FEWEST_FOR_PSF:
        return psf
    cutouts, x_px, y_px = cutouts.part(alike), x_px[alike], y_px[alike]
    fits = [fit_psfs(cutouts, x_px, y_px, width_px, replace(psf, wing=wing)) for wing in _WINGS]
    # the same weights for all: a fatter PSF must not win by believing in more noise
    chi2 = np.stack([(fits[1].weights * fit.residual**2).sum(axis=1) for fit in fits])
    best = chi2.min(axis=0)
    # a star without a good pixel has a χ² of 0, whose logarithm would count for more than all others
    known = np.isfinite(best) & (best > 0.0)
    if known.sum() < _FEWEST_FOR_PSF:
        return psf
    # a blend's χ² says nothing of wings
    usual = known & (best <= _BLEND_CHI2_RATIO * np.median(best[known]))
    # each star by the logarithm of its own χ²: stars count alike however bright they are
    unlikely = cutouts.values.shape[1] * np.log(chi2[:, usual]).sum(axis=1)
    wing = _lowest(unlikely + (np.array(_WINGS) / _WING_PRIOR) ** 2)
    psf = replace(psf, wing=wing)
    for _ in range(2):
        fit = fit_psfs(cutouts, x_px, y_px, width_px, psf)
        psf = with_noise_law(psf, fit, cutouts, gain_e_adu, card=card)
    return psf


def _alike(fit: Fit, width_px: float) -> NDArray[np.bool_]:
    """Which fits are about as wide as the typical one: no hot pixels, no smudges."""
    p, q, r = fit.params[:, 3], fit.params[:, 4], fit.params[:, 5]
    width = np.maximum(p * r - q * q, 1e-12) ** -0.25
    plausible = (width > 0.6 * width_px) & (width < 1.7 * width_px)
    if not plausible.any():
        return plausible
    typical = float(np.median(width[plausible]))
    return np.asarray((width > 0.75 * typical) & (width < 1.4 * typical))


def _lowest(total: Array) -> float:
    """Where the parabola through the lowest value and its neighbors is lowest."""
    wings = np.array(_WINGS)
    i = int(np.clip(total.argmin(), 1, wings.size - 2))
    before, here, after = total[i - 1 : i + 2]
    bend = before - 2.0 * here + after
    step = 0.5 * (before - after) / bend if bend > 0 else float(np.sign(before - after))
    return float(np.clip(wings[i] + np.clip(step, -1.5, 1.5) * (wings[1] - wings[0]), 0.0, MOST_WING))


def with_noise_law(psf: Psf, fit: Fit, cutouts: Cutouts, gain: float, *, card: bool) -> Psf:
    """Learn gain and misfit from the residuals; what they don't determine stays."""
    light = fit.params[:, 0, None] * fit.jacobian[:, 0]
    covariance = covariances(fit.normal)
    leverage = fit.weights * np.einsum(
        "nip,nij,njp->np", fit.jacobian, covariance, fit.jacobian, optimize=True
    )
    use = cutouts.good & (light > 0.3 * np.sqrt(cutouts.variance)) & (leverage < 0.8)
    if use.sum() < 4 * _LEAST_PER_BIN:
        return psf
    square = fit.residual[use] ** 2 / (1.0 - leverage[use])
    light, sky = light[use], cutouts.variance[use]
    order = np.argsort(light)
    # the median of χ² of one degree is 0.4549, and sure to about 1.9 times the root of 1 / n
    count = min(_BINS, order.size // _LEAST_PER_BIN)
    level = _medians(square[order], count) / _MEDIAN_CHI2
    sure = 1.9 * level / np.sqrt(_part_sizes(order.size, count))
    middle = _medians(light[order], count)
    ground = _medians(sky[order], count)
    table = np.stack([middle, middle**2], axis=1) / sure[:, None]
    right = (level - ground) / sure
    if not (np.isfinite(table).all() and np.isfinite(right).all()):
        return psf
    per_photon, misfit2 = nonnegative_pair(table, right)
    spread = np.linalg.pinv(table.T @ table)
    clear = per_photon > _GAIN_SIGMAS * np.sqrt(spread[0, 0])
    # photons are a law for faint and bright pixels alike; wings that no PSF fits are not
    law = ground + per_photon * middle + misfit2 * middle**2
    off = np.abs(np.log(level / np.maximum(law, 1e-30)))
    clear &= float(np.percentile(off, 80.0)) < _MOST_LAW_ERROR
    if clear and (not card or not 1.0 / _GAIN_CONTRADICTION < per_photon * gain < _GAIN_CONTRADICTION):
        gain = 1.0 / per_photon
    else:
        misfit2 = float((table[:, 1] @ (right - table[:, 0] / gain)) / (table[:, 1] @ table[:, 1]))
    if misfit2 < _MISFIT_SIGMAS / np.sqrt(table[:, 1] @ table[:, 1]):
        misfit2 = 0.0
    return replace(psf, gain_e_adu=float(gain), misfit=float(min(np.sqrt(misfit2), _MOST_MISFIT)))


def _part_sizes(size: int, count: int) -> Array:
    """How many values each of `count` parts has, as equal as can be: those of `np.array_split`."""
    return np.where(np.arange(count) < size % count, size // count + 1, size // count).astype(np.float64)


def _medians(values: Array, count: int) -> Array:
    """Median of each of `count` parts; the first ones have one value more where they can't be equal."""
    longer, least = values.size % count, values.size // count
    split = longer * (least + 1)
    first, rest = values[:split].reshape(longer, least + 1), values[split:].reshape(count - longer, least)
    return np.concatenate([np.median(part, axis=1) for part in (first, rest) if len(part)])


def nonnegative_pair(table: Array, right: Array) -> tuple[float, float]:
    """Least squares of two unknowns neither of which may be negative.

    Two unknowns leave four cases, so that scipy.optimize, expensive to import, isn't needed.

    Parameters
    ----------
    table : ndarray, shape (n, 2)
        A column an unknown.
    right : ndarray, shape (n,)
        What the columns shall sum to.

    Returns
    -------
    tuple of two floats
        The same as `scipy.optimize.nnls` finds.
    """
    free = np.linalg.lstsq(table, right, rcond=None)[0]
    if bool((free >= 0.0).all()):
        return float(free[0]), float(free[1])
    # the best lies on an edge: one unknown is zero, and the other one's parabola ends at zero
    square, slope = (table**2).sum(axis=0), table.T @ right
    alone = np.where((slope > 0.0) & (square > 0.0), slope / np.where(square > 0.0, square, 1.0), 0.0)
    gain = alone * slope
    return (float(alone[0]), 0.0) if gain[0] >= gain[1] else (0.0, float(alone[1]))


_FAR_DRIFT_SIGMAS = 2.5
"""A fit that ended farther from its start than so many of its own sigmas (and than 1.5 px) is no fit of that
peak."""


@dataclass(frozen=True, slots=True)
class Profiles:
    """Fitted profiles, each array of shape (n,); lengths in pixels, flux in ADU.

    ``minor_fwhm_px`` and ``major_fwhm_px`` are along the ellipse's axes, the pixels' own width included;
    ``angle_deg`` is the major axis' direction from +x towards +y; ``misfit`` is the residuals' rms inside the
    core over the amplitude, ``chi2`` the reduced one of the whole cutout; ``converged`` tells whether
    position and shape are those of a star.
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

    @classmethod
    def zeros(cls, count: int) -> Profiles:
        """Profiles of so many sources, to be filled by `put`."""
        numbers = {name: np.zeros(count) for name in cls.__dataclass_fields__ if name != "converged"}
        return cls(**numbers, converged=np.zeros(count, dtype=bool))

    @classmethod
    def joined(cls, parts: Sequence[Profiles]) -> Profiles:
        """Several ones after each other."""
        names = cls.__dataclass_fields__
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    def copied(self) -> Profiles:
        """A copy whose arrays can be changed."""
        return Profiles(**{name: getattr(self, name).copy() for name in Profiles.__dataclass_fields__})

    def put(self, which: NDArray[np.intp], part: Profiles) -> None:
        """Overwrite those of the sources ``which``, in place."""
        for name in Profiles.__dataclass_fields__:
            getattr(self, name)[which] = getattr(part, name)


def fit_profiles(
    cutouts: Cutouts,
    x_px: Array,
    y_px: Array,
    width_px: float,
    psf: Psf,
    *,
    shape: ShapePrior | None = None,
    rounds: int = ROUNDS,
    height: Array | None = None,
) -> Profiles:
    """Fit amplitude, position, an elliptical width and a local sky to each cutout.

    The model is a B(p u² + 2 q u v + r v²) + b with u, v relative to the position and B the frame's PSF. All
    cutouts go through a damped Gauss-Newton iteration together. A pixel's variance is that of the sky plus
    that of the star's own photons; with these weights the position's error is the Cramér-Rao bound of the
    model, and the reported sigmas are its inverse information matrix. Saturated pixels are left out, so that
    the wings alone fix the position of a saturated star.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        Where to start, pixels of the frame.
    width_px : float
        Width to start from, pixels: a Gaussian's sigma.
    shape : ShapePrior, optional
        Known beforehand: for saturated stars and blends.
    rounds : int, optional
        At most so many.
    height : ndarray, shape (n,), optional
        Amplitudes to start from.
    """
    fit = fit_psfs(cutouts, x_px, y_px, width_px, psf, shape=shape, rounds=rounds, height=height)
    return _profiles(fit, cutouts, float(cutouts.dx.max()), width_px, psf)


def _profiles(fit: Fit, cutouts: Cutouts, half: float, sigma: float, psf: Psf) -> Profiles:
    params, normal, residual, mask = fit.params, fit.normal, fit.residual, cutouts.good
    a, x, y, p, q, r, _ = params.T
    covariance = covariances(normal)
    # where nearly all pixels are masked the matrix is singular: such a fit knows nothing, and says so
    diagonal = np.einsum("nii->ni", covariance)
    known = (diagonal[:, :3] > 0.0).all(axis=1)
    sigmas = np.where(known[:, None], np.sqrt(np.maximum(diagonal, 0.0)), half)
    mean, swing = 0.5 * (p + r), np.hypot(0.5 * (p - r), q)
    narrow = 1.0 / np.sqrt(mean + swing)
    wide = 1.0 / np.sqrt(np.maximum(mean - swing, 1e-6))
    area = psf.volume * narrow * wide
    a = seen_amplitude(params) if psf.integrated else a
    # flux = a · volume / √(pr − q²): its error takes the shape's covariance along
    slope = np.zeros_like(params)
    slope[:, 0] = area * a / np.maximum(params[:, 0], 1e-12)
    excess = np.maximum(p * r - q * q, 1e-12)
    slope[:, 3], slope[:, 5] = -0.5 * a * area * r / excess, -0.5 * a * area * p / excess
    slope[:, 4] = a * area * q / excess
    flux_variance = np.einsum("ni,nij,nj->n", slope, covariance, slope)
    known &= flux_variance > 0.0
    flux_sigma = np.where(known, np.sqrt(np.maximum(flux_variance, 0.0)), np.abs(a * area))
    u, v = cutouts.dx[None, :] - x[:, None], cutouts.dy[None, :] - y[:, None]
    core = mask & (p[:, None] * u * u + 2.0 * q[:, None] * u * v + r[:, None] * v * v < 4.0)
    pixels = np.maximum(core.sum(axis=1), 1)
    misfit = np.sqrt((residual**2 * core).sum(axis=1) / pixels) / np.maximum(a, 1e-12)
    drift = np.hypot(x, y)
    converged = (
        (drift < max(_FAR_DRIFT_SIGMAS * sigma, 1.5)) & (a > 0) & known & np.isfinite(sigmas).all(axis=1)
    )
    return Profiles(
        x_px=cutouts.x0 + x,
        y_px=cutouts.y0 + y,
        x_sigma_px=sigmas[:, 1],
        y_sigma_px=sigmas[:, 2],
        amplitude=a,
        flux=a * area,
        flux_sigma=flux_sigma,
        minor_fwhm_px=psf.fwhm_per_width * narrow,
        major_fwhm_px=psf.fwhm_per_width * wide,
        # the model's Q grows fastest along the minor axis; the major one is square to it
        angle_deg=np.degrees(0.5 * np.arctan2(-2.0 * q, r - p)),
        misfit=misfit,
        chi2=(fit.weights * residual**2).sum(axis=1) / np.maximum(mask.sum(axis=1) - PARAMETERS, 1.0),
        converged=np.asarray(converged),
    )


def inverse_widths(fits: Profiles, psf: Psf) -> tuple[Array, Array, Array]:
    """Return p, q, r of Q = p u² + 2 q u v + r v², each of shape (n,)."""
    angle = np.radians(fits.angle_deg)
    along, across = ((psf.fwhm_per_width / w) ** 2 for w in (fits.major_fwhm_px, fits.minor_fwhm_px))
    cos, sin = np.cos(angle), np.sin(angle)
    return (
        along * cos * cos + across * sin * sin,
        (along - across) * sin * cos,
        along * sin * sin + across * cos * cos,
    )


def light_on(
    fits: Profiles, which: NDArray[np.intp], x0: Array, y0: Array, cutouts: Cutouts, psf: Psf
) -> Array:
    """Light of fitted stars on cutouts of the same form as others, shape (len(which), pixels).

    Parameters
    ----------
    which : ndarray of int, shape (k,)
        Whose light.
    x0, y0 : ndarray, shape (k,)
        Center pixel of the cutout that it falls on.
    cutouts : Cutouts
        For the form alone.
    """
    u = x0[:, None] + cutouts.dx - fits.x_px[which, None]
    v = y0[:, None] + cutouts.dy - fits.y_px[which, None]
    p, q, r = (w[which, None] for w in inverse_widths(fits, psf))
    return np.asarray(fits.amplitude[which, None] * psf.of(p * u * u + 2.0 * q * u * v + r * v * v)[0])
