"""Deblending: each star fitted without its neighbors' light; unresolved doubles fitted as two [S23 §0.2]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mountnav.measuring.background import Image
from mountnav.measuring.cutouts import Cutouts, make_cutouts
from mountnav.measuring.least_squares import Fit, Pixels, covariances, fit_psfs
from mountnav.measuring.measurements import TYPICAL_SNR
from mountnav.measuring.psf import Psf, Reals, ShapePrior
from mountnav.measuring.psf_fitting import Profiles, fit_profiles, inverse_widths, light_on

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_SWEEPS = 5
"""How often each star is fitted with the others' light, as fitted last, taken off. At 10 or at 2, fluxes of a
painted crowd move by less than 3 % of their scatter: close pairs converge in three or four."""
_SWEEP_ROUNDS = 4
"""Gauss-Newton steps within a sweep: the neighbors move again after it, so more is wasted. Doubled or halved,
no figure of the crowded frames changes by 3 %."""
_LAST_SWEEP_ROUNDS = 7
"""Steps in the last sweep, to convergence. Halved, one source in 1026 of A01 ends elongated."""
_SHAPE_SLACK = 0.1
"""One-sigma share by which a star may differ from the typical p, q, r where its own can't be measured: the
field's own change of the images is of this order. Doubled, fluxes of a painted crowd scatter by 5 % more."""
_FEWEST_STARS = 5
"""Clean stars below which no typical shape is stated. Doubled or halved, nothing changed on the frames that
were tried."""
_REACH_HALVES = 2.5
"""Neighbors are sought within this many half sides of a cutout: two cutouts touch at 2, wings reach a little
farther. Doubled, nothing changes; halved, fluxes of a painted crowd scatter by 14 % more."""
_LEAST_LIGHT = 0.5
"""A neighbor counts where its light on the cutout exceeds this share of the noise per pixel. Doubled, fluxes
of a painted crowd scatter by 3 % more; halved, only time is spent."""
_CLOSE_FWHM = 2.2
"""Pairs closer than this many FWHM are held to the typical shape by `_CLOSE_SLACK`: the shapes of their parts
can't be measured. Halved, 3 of 732 stars of a painted crowd are lost and 7 more come out elongated."""
_CLOSE_SLACK = 0.01
"""That one-sigma share for close pairs. Doubled or halved, two sources in 1026 of A01 change their flags."""
_PIXELS_AT_ONCE = 60_000
"""Pixels of all cutouts that are fitted together, so that they stay in the processor's cache. It changes
nothing but time."""


def typical_shape(fits: Profiles, usable: NDArray[np.bool_], fwhm_px: float, psf: Psf) -> ShapePrior | None:
    """Return the median shape of the clean bright fits; None where there are too few, or too unlike ones.

    Parameters
    ----------
    usable : ndarray of bool, shape (n,)
        Not saturated, not at the edge.
    fwhm_px : float
        About how wide the stars are.

    Returns
    -------
    ShapePrior or None
        None: too few stars show it.
    """
    width = np.sqrt(fits.minor_fwhm_px * fits.major_fwhm_px)
    clean = usable & fits.converged & (fits.flux > TYPICAL_SNR * fits.flux_sigma) & (fits.misfit < 0.2)
    clean &= (width > 0.6 * fwhm_px) & (width < 1.7 * fwhm_px)
    if clean.sum() < _FEWEST_STARS:
        return None
    p, q, r = (float(np.median(w[clean])) for w in inverse_widths(fits, psf))
    # medians one by one: of stars drawn out in many ways they may be no ellipse's
    return ShapePrior(p, q, r, _SHAPE_SLACK) if p * r > q * q else None


def deblend(
    sky_free: Image,
    good: NDArray[np.bool_],
    fits: Profiles,
    x_px: Array,
    y_px: Array,
    noise: Array,
    half_px: int,
    fixed: NDArray[np.bool_],
    psf: Psf,
    shape: ShapePrior,
) -> tuple[Profiles, NDArray[np.bool_]]:
    """Fit the stars that have others within their cutouts again, the others' light taken off, several times.

    The shapes of a blend's parts can hardly be measured, so the typical star's is the prior.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    good : ndarray of bool, shape (height, width)
        Pixels that may be used.
    fits : Profiles
        Of each peak by itself.
    x_px, y_px, noise : ndarray, shape (n,)
        The peaks, and the noise per pixel at them.
    half_px : int
        Half side of a cutout.
    fixed : ndarray of bool, shape (n,)
        Stars to leave as they are (saturated ones); their light is taken off the others.
    shape : ShapePrior
        Of the typical star.

    Returns
    -------
    again : ndarray of bool, shape (n,)
        Which were fitted again.
    """
    pairs = _pairs(fits, x_px, y_px, noise, fixed, half_px, psf)
    refitted = np.zeros(x_px.size, dtype=bool)
    if pairs.size == 0:
        return fits, refitted
    refitted[pairs[:, 0]] = True
    fwhm = psf.fwhm_per_width * (shape.p * shape.r - shape.q**2) ** -0.25
    apart = np.hypot(x_px[pairs[:, 0]] - x_px[pairs[:, 1]], y_px[pairs[:, 0]] - y_px[pairs[:, 1]])
    slack = np.full(x_px.size, shape.slack)
    slack[pairs[apart < _CLOSE_FWHM * fwhm, 0]] = _CLOSE_SLACK
    fits = fits.copied()
    # at first close ones are expected to sit on their peaks: what each fit made of a blend is no good start
    some = np.flatnonzero(refitted & (slack == _CLOSE_SLACK))
    fits.x_px[some], fits.y_px[some] = x_px[some], y_px[some]
    fits.minor_fwhm_px[some], fits.major_fwhm_px[some] = fwhm, fwhm
    for sweep in range(_SWEEPS):
        rounds = _SWEEP_ROUNDS if sweep < _SWEEPS - 1 else _LAST_SWEEP_ROUNDS
        # only close ones need many sweeps: the rest hardly move
        late = sweep >= _SWEEPS - 2
        parts = _handfuls(pairs if late else pairs[slack[pairs[:, 0]] == _CLOSE_SLACK], half_px)
        results = [
            _sweep(sky_free, good, fits, part, x_px, y_px, noise, half_px, psf, shape, slack, rounds)
            for part in parts
        ]
        for members, result in results:
            fits.put(members, result)
    return fits, refitted


def _pairs(
    fits: Profiles, x: Array, y: Array, noise: Array, fixed: NDArray[np.bool_], half_px: int, psf: Psf
) -> NDArray[np.intp]:
    """Pairs (star, disturber), sorted by star, of those near and bright enough to matter."""
    if x.size < 2:
        return np.zeros((0, 2), dtype=np.intp)
    near = KDTree(np.stack([x, y], axis=1)).query_pairs(_REACH_HALVES * half_px, output_type="ndarray")
    both = np.concatenate([near, near[:, ::-1]])
    star, other = both[:, 0], both[:, 1]
    real = (fits.flux > 3.0 * fits.flux_sigma) & (fits.amplitude > 0) & np.isfinite(fits.flux)
    both = both[real[star] & real[other] & ~fixed[star]]
    star, other = both[:, 0], both[:, 1]
    # light of the disturber where it is brightest on the star's cutout
    width = np.sqrt(fits.minor_fwhm_px * fits.major_fwhm_px)[other]
    distance = np.maximum(np.hypot(x[star] - x[other], y[star] - y[other]) - half_px, 0.0)
    light = fits.amplitude[other] * psf.of((distance * psf.fwhm_per_width / width) ** 2)[0]
    both = both[light > _LEAST_LIGHT * noise[star]]
    return np.asarray(both[np.argsort(both[:, 0], kind="stable")], dtype=np.intp)


def _handfuls(pairs: NDArray[np.intp], half_px: int) -> list[NDArray[np.intp]]:
    """Split the pairs between stars, so that each part fits the processor's cache."""
    share = max(1, _PIXELS_AT_ONCE // (2 * half_px + 1) ** 2)
    if pairs.size == 0:
        return []
    first = np.flatnonzero(np.r_[True, np.diff(pairs[:, 0]) > 0])
    return np.split(pairs, first[share::share])


def _sweep(
    sky_free: Image,
    good: NDArray[np.bool_],
    fits: Profiles,
    pairs: NDArray[np.intp],
    x: Array,
    y: Array,
    noise: Array,
    half_px: int,
    psf: Psf,
    shape: ShapePrior,
    slack: Array,
    rounds: int,
) -> tuple[Indices, Profiles]:
    """Fit the first of each pair again, with the others' light as last fitted taken off."""
    members, member = np.unique(pairs[:, 0], return_inverse=True)
    cutouts = make_cutouts(sky_free, good, x[members], y[members], noise[members], half_px)
    light = light_on(fits, pairs[:, 1], cutouts.x0[member], cutouts.y0[member], cutouts, psf)
    first = np.flatnonzero(np.r_[True, np.diff(member) > 0])
    light = np.add.reduceat(light, first, axis=0)
    # the disturbers' photons are noise as well
    cutouts = replace(cutouts, values=cutouts.values - light, variance=psf.variance(cutouts.variance, light))
    start_x = np.clip(fits.x_px[members], cutouts.x0 - half_px, cutouts.x0 + half_px)
    start_y = np.clip(fits.y_px[members], cutouts.y0 - half_px, cutouts.y0 + half_px)
    width = float((shape.p * shape.r - shape.q**2) ** -0.25)
    shape = replace(shape, slack=slack[members])
    return members, fit_profiles(cutouts, start_x, start_y, width, psf, shape=shape, rounds=rounds)


Mask = NDArray[np.bool_]

_DOUBLE_SNR = 40.0
"""Flux over its error from which a source may be tried as two: fainter ones can't be decided. Doubled, 9 of
the 732 painted stars found in a crowd are lost; halved, three more pairs are split in A01."""
_POOR_CHI2 = 1.5
"""Reduced χ² that makes a source a candidate for two stars, and the ratio to the frame's usual one. Doubled,
4 of 732 painted stars are lost; halved, too many look odd and none is split."""
_LONG_RATIO = 1.13
"""Major axis over the typical star's that makes a source a candidate: two equal stars 0.45 FWHM apart are
that long. At half of it every star is odd and none is split."""
_BROAD_RATIO = 1.25
"""Minor axis over the typical star's above which a long source is no pair but something wide, a galaxy.
Doubled or halved, nothing changed on the frames that were tried."""
_NARROW_RATIO = 0.8
"""Minor axis over the typical star's below which a source is a hot pixel or a track and no candidate. At 0.6
or 0.9 nothing changed on the frames that were tried."""
_MOST_ODD_SHARE = 0.3
"""If more than this share of the clear stars look double it is the optics' doing, and none is split. Halved,
no pair of a painted crowd is split (9 of 732 stars lost)."""
_MOST_TRIED = 100
"""No more sources than this are tried, the brightest: bounds the time. Doubled or halved, nothing changed on
the frames that were tried."""
_ROUNDS = 15
"""Gauss-Newton steps of a fit of two stars. Doubled or halved, no figure changes by 3 %."""
_LEAST_GAIN = 30.0
"""χ² that the second star has to save at least: with three more parameters chance saves 16 once in a
thousand, and misfits of real images save more. Doubled or halved, nothing changed on the frames that were
tried."""
_LEAST_GAINED_SHARE = 0.5
"""And the share of the excess χ² that it has to explain. At 1, 6 of 732 stars of a painted crowd are lost;
halved, nothing changes."""
_LEAST_RATIO = 0.05
"""Fainter over brighter amplitude below which a second star isn't believed: wings that the PSF doesn't have
look like one. Doubled, 4 of 732 painted stars are lost; halved, 3 more are found in the painted crowd, and
lone stars with odd wings would be split."""
_NEAREST_FWHM = 0.5
"""Pairs closer than this many FWHM aren't believed: elongated optics look like them. Doubled, one pair of A01
is lost; halved, nothing changes."""
_FARTHEST_FWHM = 2.2
"""Nor pairs wider than this, which the search for peaks separates. Halved, 9 of 732 painted stars are
lost."""
_STARTS = ((0.35, 1.0), (0.35, -1.0), (0.8, 1.0))
"""Starts of a fit of two: ratio of the fluxes, and on which side of the center the fainter lies. Equal stars
need one start, unequal ones both sides. Other ratios changed nothing on the frames that were tried."""
_EXPLAINED = 0.9
"""A start that explains this share of the excess χ² ends the search for better ones. It saves time only."""
_SINGLE_SLACK = 0.02
"""One-sigma share of p, q, r to which the fit of a single star is held while its residual is searched for a
second one: left free it would swallow both. Doubled or halved, no figure changes by 3 %."""
_SOURCES_AT_ONCE = 60
"""Sources that are tried together, so that they stay in the processor's cache. It changes nothing but
time."""
_STILL_PX = 1e-3
"""A fit of two whose positions move by less than this, px, has converged: a tenth of the best error of such a
pair. Doubled or halved, no figure changes by 3 %."""
_COST_ROUNDING = 1e-6
"""Relative rise of χ² that is rounding in single precision and no step in the wrong direction."""


@dataclass(frozen=True, slots=True)
class Doubles:
    """Sources that turned out to be two; each array has shape (k,).

    ``which`` are their indices; ``bright`` and ``faint`` the two stars as measured together.
    """

    which: NDArray[np.intp]
    bright: Profiles
    faint: Profiles


def find_doubles(
    sky_free: Image,
    good: Mask,
    fits: Profiles,
    usable: Mask,
    noise: Array,
    half_px: int,
    psf: Psf,
    shape: ShapePrior,
) -> Doubles | None:
    """Try the sources that are too long, or fitted too badly, as two stars.

    Where a large share of the stars is like that it is the optics' doing, and none is split.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    good : ndarray of bool, shape (height, width)
        Pixels that may be used.
    fits : Profiles
        Each source by itself.
    usable : ndarray of bool, shape (n,)
        Whole stars that stand clear of other peaks.
    noise : ndarray, shape (n,)
        Per pixel.
    half_px : int
        Half side of one star's cutout.
    shape : ShapePrior
        Of the typical star.

    Returns
    -------
    Doubles or None
        None: there are none.
    """
    minor, major = _axes(psf, shape)
    clear = usable & fits.converged & (fits.flux > _DOUBLE_SNR * fits.flux_sigma)
    clear &= fits.minor_fwhm_px > _NARROW_RATIO * minor  # no hot pixels, no tracks
    slack = 4.0 * fits.flux_sigma / np.maximum(np.abs(fits.flux), 1e-12)
    long = (fits.major_fwhm_px > (_LONG_RATIO + slack) * major) & (fits.minor_fwhm_px < _BROAD_RATIO * minor)
    usual = float(np.median(fits.chi2[clear])) if clear.any() else 1.0
    odd = clear & (long | (fits.chi2 > max(_POOR_CHI2, _POOR_CHI2 * usual)))
    which = np.flatnonzero(odd)[:_MOST_TRIED]
    if which.size == 0 or odd.sum() > max(1.0, _MOST_ODD_SHARE * clear.sum()):
        return None
    found = [
        _tried(sky_free, good, fits, some, long, noise, half_px, psf, shape)
        for some in np.split(which, np.arange(_SOURCES_AT_ONCE, which.size, _SOURCES_AT_ONCE))
    ]
    parts = [pair for pair in found if pair is not None]
    if not parts:
        return None
    return Doubles(
        np.concatenate([part.which for part in parts]),
        Profiles.joined([part.bright for part in parts]),
        Profiles.joined([part.faint for part in parts]),
    )


def _axes(psf: Psf, shape: ShapePrior) -> tuple[float, float]:
    """FWHM of the typical star along its minor and major axis."""
    mean, swing = 0.5 * (shape.p + shape.r), np.hypot(0.5 * (shape.p - shape.r), shape.q)
    return float(psf.fwhm_per_width / np.sqrt(mean + swing)), float(
        psf.fwhm_per_width / np.sqrt(mean - swing)
    )


def _tried(
    sky_free: Image,
    good: Mask,
    fits: Profiles,
    which: NDArray[np.intp],
    long: Mask,
    noise: Array,
    half_px: int,
    psf: Psf,
    shape: ShapePrior,
) -> Doubles | None:
    minor, major = _axes(psf, shape)
    x, y = fits.x_px[which], fits.y_px[which]
    wide_px = half_px + int(np.ceil(np.sqrt(minor * major)))
    cutouts = make_cutouts(sky_free, good, x, y, noise[which], wide_px)
    width = float(np.sqrt(minor * major)) / psf.fwhm_per_width
    # held to the typical shape it stays on the brighter star, and leaves the other where it is
    single = fit_psfs(cutouts, x, y, width, psf, shape=replace(shape, slack=_SINGLE_SLACK))
    free = fit_psfs(cutouts, x, y, width, psf)
    weights: Reals = free.weights
    alone = (weights * single.residual**2).sum(axis=1)
    alone = np.minimum(alone, (weights * free.residual**2).sum(axis=1))
    params, cost = _two(
        cutouts, single, weights, alone, fits, which, long[which], np.sqrt(minor * major), psf, shape
    )
    a1, x1, y1, a2, x2, y2, _ = params.T
    apart = np.hypot(x1 - x2, y1 - y2) / np.sqrt(minor * major)
    gained, freedom = alone - cost, cutouts.good.sum(axis=1) - 7.0
    ratio = np.minimum(a1, a2) / np.maximum(np.maximum(a1, a2), 1e-12)
    sure = (gained > _LEAST_GAIN) & (gained > _LEAST_GAINED_SHARE * (alone - freedom))
    sure &= (ratio > _LEAST_RATIO) & (apart > _NEAREST_FWHM) & (apart < _FARTHEST_FWHM)
    if not sure.any():
        return None
    # once more with the noise of both stars' own photons
    weights = _weights_of(params, cutouts, psf, shape)
    params, _ = _descended(params, cutouts, weights, psf, shape)
    jacobian, _ = _linear(params, cutouts, psf, shape)
    normal = (jacobian * weights[:, None, :]) @ jacobian.transpose(0, 2, 1)
    covariance = covariances(normal.astype(np.float64))
    sigmas = np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 0.0))[sure]
    chi2 = (cost / np.maximum(freedom, 1.0))[sure]
    params, x0, y0 = params[sure], cutouts.x0[sure], cutouts.y0[sure]
    swapped = params[:, 3] > params[:, 0]
    order = np.where(swapped[:, None], [3, 4, 5, 0, 1, 2, 6], [0, 1, 2, 3, 4, 5, 6])
    params, sigmas = np.take_along_axis(params, order, axis=1), np.take_along_axis(sigmas, order, axis=1)
    area = psf.volume / np.sqrt(shape.p * shape.r - shape.q**2)
    angle = float(np.degrees(0.5 * np.arctan2(-2.0 * shape.q, shape.r - shape.p)))
    ones = np.ones(params.shape[0])

    def star(first: int) -> Profiles:
        a, x, y = (params[:, first + i] for i in range(3))
        return Profiles(
            x_px=x0 + x,
            y_px=y0 + y,
            x_sigma_px=sigmas[:, first + 1],
            y_sigma_px=sigmas[:, first + 2],
            amplitude=a,
            flux=a * area,
            flux_sigma=sigmas[:, first] * area,
            minor_fwhm_px=minor * ones,
            major_fwhm_px=major * ones,
            angle_deg=angle * ones,
            misfit=fits.misfit[which[sure]] * np.sqrt(chi2 / np.maximum(fits.chi2[which[sure]], 1e-9)),
            chi2=chi2,
            converged=np.ones(params.shape[0], dtype=bool),
        )

    return Doubles(which[sure], star(0), star(3))


def _two(
    cutouts: Cutouts,
    single: Fit,
    weights: Reals,
    alone: Array,
    fits: Profiles,
    which: NDArray[np.intp],
    long: Mask,
    fwhm: float,
    psf: Psf,
    shape: ShapePrior,
) -> tuple[Array, Array]:
    """Fit two stars to each cutout from several starts along the long axis; return the best and its χ²."""
    angle = np.radians(fits.angle_deg[which])
    along_x, along_y = np.cos(angle), np.sin(angle)
    excess = np.maximum(fits.major_fwhm_px[which] ** 2 - fwhm**2, 0.05 * fwhm**2) / (8.0 * np.log(2.0))
    x, y = fits.x_px[which] - cutouts.x0, fits.y_px[which] - cutouts.y0
    height = fits.amplitude[which]
    best, lowest = np.zeros((which.size, 7)), np.full(which.size, np.inf)
    todo = np.ones(which.size, dtype=bool)
    # first guess: the second star is where the single one leaves most, held to the typical shape or not
    u, v = cutouts.dx - x[:, None], cutouts.dy - y[:, None]
    there = height[:, None] * psf.of(shape.p * u * u + 2.0 * shape.q * u * v + shape.r * v * v)[0]
    for residual in (single.residual, cutouts.values - there):
        some = np.flatnonzero(todo)
        if some.size == 0:
            break
        left = np.where(cutouts.good[some], residual[some], 0.0) * np.sqrt(weights[some])
        left[np.hypot(u[some], v[some]) < 0.8 * fwhm] = 0.0
        most = left.argmax(axis=1)
        rest = np.maximum(residual[some, most], 0.05 * height[some])
        start = np.stack(
            [height[some], x[some], y[some], rest, cutouts.dx[most], cutouts.dy[most], np.zeros(some.size)],
            axis=1,
        )
        _improve(best, lowest, some, start, cutouts, weights, psf, shape)
        todo = alone - lowest < _EXPLAINED * (alone - cutouts.good.sum(axis=1))
    # else along the axis of those that are long
    todo &= long
    for ratio, sign in _STARTS:
        some = np.flatnonzero(todo)
        if some.size == 0:
            break
        # two points of this ratio have the variance ratio / (1 + ratio)² · distance²
        distance = np.clip((1.0 + ratio) * np.sqrt(excess / ratio), 0.7 * fwhm, 1.8 * fwhm)
        near, far = sign * distance * ratio / (1.0 + ratio), -sign * distance / (1.0 + ratio)
        height = fits.amplitude[which] * fits.major_fwhm_px[which] / fwhm / (1.0 + ratio)
        start = np.stack(
            [
                height,
                x + near * along_x,
                y + near * along_y,
                ratio * height,
                x + far * along_x,
                y + far * along_y,
                np.zeros_like(height),
            ],
            axis=1,
        )[some]
        _improve(best, lowest, some, start, cutouts, weights, psf, shape)
    return best, lowest


def _improve(
    best: Array,
    lowest: Array,
    some: NDArray[np.intp],
    start: Array,
    cutouts: Cutouts,
    weights: Reals,
    psf: Psf,
    shape: ShapePrior,
) -> None:
    """Fit some of the cutouts from another start; keep, in place, what is better than before."""
    part = replace(cutouts, values=cutouts.values[some], good=cutouts.good[some])
    params, cost = _descended(start, part, weights[some], psf, shape)
    better = cost < lowest[some]
    best[some[better]], lowest[some[better]] = params[better], cost[better]


def _descended(
    start: Array, cutouts: Cutouts, weights: Reals, psf: Psf, shape: ShapePrior
) -> tuple[Array, Array]:
    """Damped Gauss-Newton over (height, x, y) of both stars and the sky."""
    kept = start
    damping = np.full(start.shape[0], 1e-2)
    jacobian, residual = _linear(kept, cutouts, psf, shape)
    cost = (weights * residual**2).sum(axis=1)
    for _ in range(_ROUNDS):
        weighted = jacobian * weights[:, None, :]
        normal = (weighted @ jacobian.transpose(0, 2, 1)).astype(np.float64)
        diagonal = np.sqrt(np.maximum(np.einsum("nii->ni", normal), 1e-30))
        scaled = normal / (diagonal[:, :, None] * diagonal[:, None, :])
        scaled += (damping[:, None, None] + 1e-9) * np.eye(7)
        gradient = (weighted @ residual[:, :, None])[:, :, 0].astype(np.float64) / diagonal
        step = np.linalg.solve(scaled, gradient[:, :, None])[:, :, 0] / diagonal
        xy = [1, 2, 4, 5]
        step[:, xy] = np.clip(step[:, xy], -1.0, 1.0)
        trial = kept + step
        trial[:, [0, 3]] = np.maximum(trial[:, [0, 3]], 0.1 * np.abs(kept[:, [0, 3]]))
        trial_jacobian, trial_residual = _linear(trial, cutouts, psf, shape)
        trial_cost = (weights * trial_residual**2).sum(axis=1)
        worse = ~(trial_cost <= cost * (1.0 + _COST_ROUNDING))
        damping = np.where(worse, damping * 8.0, damping * 0.2)
        trial[worse], trial_cost[worse] = kept[worse], cost[worse]
        trial_jacobian[worse], trial_residual[worse] = jacobian[worse], residual[worse]
        kept, cost, jacobian, residual = trial, trial_cost, trial_jacobian, trial_residual
        if (np.abs(step[:, xy]).max(axis=1) < _STILL_PX).mean() > 0.95:
            break
    return kept, np.asarray(cost)


def _weights_of(params: Array, cutouts: Cutouts, psf: Psf, shape: ShapePrior) -> Reals:
    jacobian, _ = _linear(params, cutouts, psf, shape)
    light = params[:, 0, None] * jacobian[:, 0] + params[:, 3, None] * jacobian[:, 3]
    return np.asarray(cutouts.good / psf.variance(cutouts.variance, np.maximum(light, 0.0)), dtype=np.float32)


def _linear(params: Array, cutouts: Cutouts, psf: Psf, shape: ShapePrior) -> tuple[Pixels, Pixels]:
    count, pixels = cutouts.values.shape
    jacobian = np.empty((count, 7, pixels), dtype=np.float32)
    dx, dy = cutouts.dx.astype(np.float32), cutouts.dy.astype(np.float32)
    small = params.astype(np.float32)
    residual = cutouts.values.astype(np.float32) - small[:, 6, None]
    p, q, r = np.float32(shape.p), np.float32(shape.q), np.float32(shape.r)
    for first in (0, 3):
        height, x, y = (small[:, first + i, None] for i in range(3))
        u, v = dx - x, dy - y
        along_x, along_y = p * u + q * v, q * u + r * v
        value, slope = psf.of(along_x * u + along_y * v)
        slope = height * slope
        jacobian[:, first] = value
        np.multiply(slope, along_x, out=jacobian[:, first + 1])
        np.multiply(slope, along_y, out=jacobian[:, first + 2])
        residual -= height * value
    jacobian[:, 6] = 1.0
    residual[~cutouts.good] = 0.0
    return jacobian, residual
