"""The brightness scale of a frame: zero point and color term from its own pairs, with their errors.

The catalog's magnitude of a star of flux f [ADU] and color c is modeled as

    m = -2.5 log10 f + zero point + k (c - pivot)

Pairs that would spoil it are left out beforehand, outliers on the way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import StarFlag
from mountnav.measuring.measurements import Flag
from mountnav.measuring.medians import median
from mountnav.solution import IdentifiedPairs

Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]

FEWEST_STARS = 3
"""Fewer pairs give no zero point: two agree by chance, and their scatter has no error."""
FEWEST_COLORED = 8
"""Pairs with a color; fewer hold no color term. Chosen by hand."""
LEAST_SPREAD_MAG = 0.1
"""Spread of the pairs' colors; stars that are more alike hold no color term. Chosen by hand."""
LARGEST_COLOR_TERM_SIGMA = 0.2
"""A color term with a larger error, magnitudes per magnitude, isn't taken."""
COLOR_TERM_PRIOR = 0.5
"""Expected size of a color term, magnitudes per magnitude: a camera without a filter against V has a few
tenths."""
LARGEST_COLOR_TERM = 1.0
"""No color term is larger: what is far beyond the expected size is chance."""
CLIP_SIGMAS = 3.5
"""Pairs farther off than so many of their errors are left out: one honest pair in 2,000. Halved, one in
twelve honest pairs would go, and the scatter would be stated too
small."""
LEAST_SCATTER_MAG = 0.001
"""Least scatter of a pair beyond what its errors state, magnitudes: a guard against a scatter of zero. Chosen
by hand."""
ROUNDS = 50
"""Fits at most, each with the pairs that the one before keeps. It ends when these stay the same; this only
bounds what swings between two sets."""
BISECTIONS = 60
"""Halvings of the bracket when the scatter is sought: 2^-60 of it is beyond double precision."""
STUDENT = 0.6
"""68.3 % of Student's t lie within 1 + 0.6/ν: 1.3 at ν = 2, where the scatter is hardly known."""
_MAG_PER_LN = 2.5 / math.log(10.0)
"""Magnitudes per unit of the natural logarithm of flux."""
_SIGMA_PER_MAD = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""

SPOILED = Flag.SATURATED | Flag.EDGE | Flag.NO_PEAK | Flag.BLENDED | Flag.TRAIL | Flag.BLEED
"""Measurements whose flux isn't that of one star."""
NOT_COMPARABLE = StarFlag.NO_MAGNITUDE | StarFlag.OTHER_BAND | StarFlag.VARIABLE | StarFlag.EXTENDED
"""Stars whose magnitude means nothing for a star's flux in this band."""
NOT_FOR_THE_FIT = NOT_COMPARABLE | StarFlag.DOUBTFUL | StarFlag.DOUBLE
"""Stars that have no part in the fit: these, and those whose magnitude is doubtful or that of two stars."""


@dataclass(frozen=True, slots=True)
class Photometry:
    """Zero point and color term of a frame.

    Attributes
    ----------
    zero_point_mag, zero_point_sigma_mag : float
        Magnitude of a star that gave 1 ADU and has the color `pivot_mag`.
    color_term, color_term_sigma : float
        Magnitudes per magnitude of color; 0 and NaN where the pairs don't hold one.
    pivot_mag : float
        Color that the zero point holds for: the median of the pairs. NaN if none has a color.
    color_name, band : str
        Which color, and which magnitudes; empty if unknown.
    stars : int
        How many the fit is made of.
    scatter_mag : float
        What is left beyond the errors of the fluxes: catalog, flat field, variability.
    """

    zero_point_mag: float
    zero_point_sigma_mag: float
    color_term: float
    color_term_sigma: float
    pivot_mag: float
    color_name: str
    band: str
    stars: int
    scatter_mag: float

    def magnitudes(self, flux: Array, color_mag: Array) -> Array:
        """Magnitudes of measured fluxes.

        Parameters
        ----------
        flux : ndarray, shape (n,)
            ADU.
        color_mag : ndarray, shape (n,)
            Where it is NaN, the star is taken to have the color `pivot_mag`.

        Returns
        -------
        ndarray, shape (n,)
            NaN where the flux isn't positive.
        """
        instrumental = instrumental_magnitudes(flux)
        if self.color_term == 0.0:
            return instrumental + self.zero_point_mag
        beside = np.where(np.isfinite(color_mag), color_mag - self.pivot_mag, 0.0)
        return np.asarray(instrumental + self.zero_point_mag + self.color_term * beside)


def instrumental_magnitudes(flux: Array) -> Array:
    """-2.5 log10 of fluxes, shape (n,); NaN where they aren't positive."""
    good = np.isfinite(flux) & (flux > 0)
    return np.where(good, -2.5 * np.log10(np.where(good, flux, 1.0)), np.nan)


def fit_for_photometry(pairs: IdentifiedPairs) -> Chosen:
    """Which pairs the zero point is fitted to.

    Returns
    -------
    ndarray of bool, shape (n,)
        Those in the plate's fit whose flux is that of one star, and whose star has a magnitude of its own in
        the catalog's band, isn't known to vary, isn't double, doubtful or extended.
    """
    good = pairs.used & np.isfinite(pairs.mag) & np.isfinite(pairs.flux) & (pairs.flux > 0)
    good &= (pairs.flags & int(SPOILED)) == 0
    return np.asarray(good & ((pairs.star_flags & int(NOT_FOR_THE_FIT)) == 0))


def fit_photometry(pairs: IdentifiedPairs) -> Photometry | None:
    """Zero point and color term of a frame.

    Each pair weighs by the error of its flux and by the scatter that the pairs themselves show; those beyond
    `CLIP_SIGMAS` are left out. A star without a color is taken at the pivot, with the spread of colors as its
    error.

    Returns
    -------
    Photometry or None
        None if fewer than three pairs are fit for it.
    """
    chosen = fit_for_photometry(pairs)
    if int(chosen.sum()) < FEWEST_STARS:
        return None
    flux, color = pairs.flux[chosen], pairs.color_mag[chosen]
    offset = pairs.mag[chosen] - instrumental_magnitudes(flux)
    noise = _MAG_PER_LN * np.nan_to_num(np.maximum(pairs.flux_sigma[chosen], 0.0)) / flux
    colored = np.isfinite(color)
    pivot = median(color[colored]) if colored.any() else math.nan
    beside = np.where(colored, color - pivot, 0.0)
    spread = float(beside[colored].std()) if colored.any() else 0.0
    data = _Data(offset, noise, beside, np.where(colored, 0.0, spread))
    found = None
    if int(colored.sum()) >= FEWEST_COLORED and spread >= LEAST_SPREAD_MAG:
        found = _fitted(data, with_color=True)
        kept = int((colored & found.keep).sum())
        if kept < FEWEST_COLORED or found.color_term_sigma > LARGEST_COLOR_TERM_SIGMA:
            found = None
    if found is None:
        found = _fitted(data, with_color=False)
    return Photometry(
        zero_point_mag=found.zero_point,
        zero_point_sigma_mag=found.zero_point_sigma,
        color_term=found.color_term,
        color_term_sigma=found.color_term_sigma,
        pivot_mag=pivot,
        color_name=pairs.color_name,
        band=pairs.band,
        stars=int(found.keep.sum()),
        scatter_mag=found.scatter,
    )


@dataclass(frozen=True, slots=True)
class _Data:
    """Catalog less instrumental magnitude, its noise, color less pivot, and how unsure that is."""

    offset: Array
    noise: Array
    beside: Array
    beside_sigma: Array


@dataclass(frozen=True, slots=True)
class _Fit:
    zero_point: float
    color_term: float
    zero_point_sigma: float
    color_term_sigma: float
    scatter: float
    keep: Chosen

    def residuals(self, data: _Data) -> Array:
        return np.asarray(data.offset - self.zero_point - self.color_term * data.beside)

    def known_variance(self, data: _Data) -> Array:
        return np.asarray(data.noise**2 + (self.color_term * data.beside_sigma) ** 2)


def _fitted(data: _Data, *, with_color: bool) -> _Fit:
    """Fit, scatter and clipping in turns until none changes."""
    count = data.offset.size
    middle = median(data.offset)
    mad = median(np.abs(data.offset - middle))
    # few values have too small a median deviation
    scatter = max(_SIGMA_PER_MAD * mad * count / (count - 0.8), LEAST_SCATTER_MAG)
    fit = _Fit(middle, 0.0, math.inf, math.nan, scatter, np.ones(count, dtype=bool))
    for _ in range(ROUNDS):
        keep = _near(fit, data)
        following = _weighted(fit, data, keep, with_color)
        settled = bool(np.array_equal(keep, fit.keep)) and math.isclose(
            following.zero_point, fit.zero_point, abs_tol=1e-6
        )
        fit = following
        if settled:
            break
    return fit


def _near(fit: _Fit, data: _Data) -> Chosen:
    sigma = np.sqrt(fit.known_variance(data) + fit.scatter**2)
    off = np.abs(fit.residuals(data)) / sigma
    # never fewer than are needed: then the nearest
    limit = max(CLIP_SIGMAS, float(np.partition(off, FEWEST_STARS - 1)[FEWEST_STARS - 1]))
    return np.asarray(off <= limit)


def _weighted(before: _Fit, data: _Data, keep: Chosen, with_color: bool) -> _Fit:
    weight = keep / (before.known_variance(data) + before.scatter**2)
    rows = np.column_stack((np.ones(data.offset.size), data.beside))[:, : 2 if with_color else 1]
    normal = (rows * weight[:, None]).T @ rows
    held = normal.copy()
    if with_color:
        held[1, 1] += COLOR_TERM_PRIOR**-2
    solved = np.linalg.solve(held, rows.T @ (weight * data.offset))
    # errors as the pairs alone give them, so that a term held by the prior is seen not to be held
    covariance = np.linalg.pinv(normal)
    color_term = float(np.clip(solved[1], -LARGEST_COLOR_TERM, LARGEST_COLOR_TERM)) if with_color else 0.0
    free = int(keep.sum()) - (2 if with_color else 1)
    student = 1.0 + STUDENT / max(free, 1)
    fit = _Fit(
        zero_point=float(solved[0]),
        color_term=color_term,
        zero_point_sigma=student * math.sqrt(float(covariance[0, 0])),
        color_term_sigma=student * math.sqrt(float(covariance[1, 1])) if with_color else math.nan,
        scatter=before.scatter,
        keep=keep,
    )
    left, known = fit.residuals(data)[keep] ** 2, fit.known_variance(data)[keep]
    return replace(fit, scatter=_scatter(left, known, free))


def _scatter(square: Array, known_variance: Array, free: int) -> float:
    """The scatter with which the weighted squares of residuals sum up to the degrees of freedom."""
    if float((square / (known_variance + LEAST_SCATTER_MAG**2)).sum()) <= free:
        return LEAST_SCATTER_MAG
    low, high = LEAST_SCATTER_MAG**2, float(square.sum())
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if float((square / (known_variance + middle)).sum()) > free:
            low = middle
        else:
            high = middle
    return math.sqrt(0.5 * (low + high))
