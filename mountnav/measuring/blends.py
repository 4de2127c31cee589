"""Stars that stand in each other's light: each is fitted with the others' light taken off [S23 §0.2]."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mountnav.measuring.background import Image
from mountnav.measuring.profile import Profiles, fit_profiles, inverse_widths, light_on
from mountnav.measuring.stamps import cut_stamps
from mountnav.measuring.star_shape import Bell, Shape

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_SWEEPS = 5
_ROUNDS = 4
_LAST_ROUNDS = 7
_SLACK = 0.1
_CLEAR = 15.0
_FEWEST_STARS = 5
_REACH_HALVES = 2.5
_LEAST_LIGHT = 0.5
_CLOSE_FWHM = 2.2
_CLOSE_SLACK = 0.01
_PIXELS_AT_ONCE = 60_000


def typical_shape(fits: Profiles, usable: NDArray[np.bool_], fwhm_px: float, bell: Bell) -> Shape | None:
    """Return the median shape of the clean bright fits; None where there are too few, or too unlike ones.

    Parameters
    ----------
    fits : Profiles
    usable : ndarray of bool, shape (n,)
        Not saturated, not at the edge.
    fwhm_px : float
        About how wide the stars are.
    bell : Bell

    Returns
    -------
    Shape or None
    """
    width = np.sqrt(fits.minor_fwhm_px * fits.major_fwhm_px)
    clean = usable & fits.converged & (fits.flux > _CLEAR * fits.flux_sigma) & (fits.misfit < 0.2)
    clean &= (width > 0.6 * fwhm_px) & (width < 1.7 * fwhm_px)
    if clean.sum() < _FEWEST_STARS:
        return None
    p, q, r = (float(np.median(w[clean])) for w in inverse_widths(fits, bell))
    # medians one by one: of stars drawn out in many ways they may be no ellipse's
    return Shape(p, q, r, _SLACK) if p * r > q * q else None


def untangle(
    sky_free: Image,
    good: NDArray[np.bool_],
    fits: Profiles,
    x_px: Array,
    y_px: Array,
    noise: Array,
    half_px: int,
    fixed: NDArray[np.bool_],
    bell: Bell,
    shape: Shape,
) -> tuple[Profiles, NDArray[np.bool_]]:
    """Fit the stars that have others within their stamps anew, the others' light taken off, several times.

    A blend's parts hardly tell their own shapes, so that of the typical star is expected of them.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
    good : ndarray of bool, shape (height, width)
    fits : Profiles
        Of each peak by itself.
    x_px, y_px, noise : ndarray, shape (n,)
        The peaks, and the noise per pixel at them.
    half_px : int
        Half side of a stamp.
    fixed : ndarray of bool, shape (n,)
        Stars to leave as they are (saturated ones); their light is taken off the others.
    bell : Bell
    shape : Shape
        Of the typical star.

    Returns
    -------
    fits : Profiles
    anew : ndarray of bool, shape (n,)
        Which were fitted anew.
    """
    pairs = _pairs(fits, x_px, y_px, noise, fixed, half_px, bell)
    anew = np.zeros(x_px.size, dtype=bool)
    if pairs.size == 0:
        return fits, anew
    anew[pairs[:, 0]] = True
    fwhm = bell.fwhm_per_width * (shape.p * shape.r - shape.q**2) ** -0.25
    apart = np.hypot(x_px[pairs[:, 0]] - x_px[pairs[:, 1]], y_px[pairs[:, 0]] - y_px[pairs[:, 1]])
    slack = np.full(x_px.size, shape.slack)
    slack[pairs[apart < _CLOSE_FWHM * fwhm, 0]] = _CLOSE_SLACK
    columns = {name: getattr(fits, name).copy() for name in Profiles.__dataclass_fields__}
    # at first close ones are expected to sit on their peaks: what each fit made of a blend is no good start
    some = np.flatnonzero(anew & (slack == _CLOSE_SLACK))
    columns["x_px"][some], columns["y_px"][some] = x_px[some], y_px[some]
    columns["minor_fwhm_px"][some], columns["major_fwhm_px"][some] = fwhm, fwhm
    for sweep in range(_SWEEPS):
        rounds = _ROUNDS if sweep < _SWEEPS - 1 else _LAST_ROUNDS
        now = Profiles(**columns)
        # only close ones need many sweeps: the rest hardly move
        late = sweep >= _SWEEPS - 2
        parts = _handfuls(pairs if late else pairs[slack[pairs[:, 0]] == _CLOSE_SLACK], half_px)
        results = [
            _sweep(sky_free, good, now, part, x_px, y_px, noise, half_px, bell, shape, slack, rounds)
            for part in parts
        ]
        for members, result in results:
            for name, column in columns.items():
                column[members] = getattr(result, name)
    return Profiles(**columns), anew


def _pairs(
    fits: Profiles, x: Array, y: Array, noise: Array, fixed: NDArray[np.bool_], half_px: int, bell: Bell
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
    # light of the disturber where it is brightest on the star's stamp
    width = np.sqrt(fits.minor_fwhm_px * fits.major_fwhm_px)[other]
    distance = np.maximum(np.hypot(x[star] - x[other], y[star] - y[other]) - half_px, 0.0)
    light = fits.amplitude[other] * bell.of((distance * bell.fwhm_per_width / width) ** 2)[0]
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
    bell: Bell,
    shape: Shape,
    slack: Array,
    rounds: int,
) -> tuple[Indices, Profiles]:
    """Fit the first of each pair anew, with the others' light as last fitted taken off."""
    members, place = np.unique(pairs[:, 0], return_inverse=True)
    stamps = cut_stamps(sky_free, good, x[members], y[members], noise[members], half_px)
    light = light_on(fits, pairs[:, 1], stamps.x0[place], stamps.y0[place], stamps, bell)
    first = np.flatnonzero(np.r_[True, np.diff(place) > 0])
    light = np.add.reduceat(light, first, axis=0)
    # the disturbers' photons are noise as well
    stamps = replace(stamps, values=stamps.values - light, variance=bell.variance(stamps.variance, light))
    start_x = np.clip(fits.x_px[members], stamps.x0 - half_px, stamps.x0 + half_px)
    start_y = np.clip(fits.y_px[members], stamps.y0 - half_px, stamps.y0 + half_px)
    width = float((shape.p * shape.r - shape.q**2) ** -0.25)
    shape = replace(shape, slack=slack[members])
    return members, fit_profiles(stamps, start_x, start_y, width, bell, shape=shape, rounds=rounds)
