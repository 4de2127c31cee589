"""Accuracy as the paper states it: deviations of identified pairs and their indicators [S23 §4, Table 1]."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest
from mountnav.identification.photometry import NOT_COMPARABLE, fit_photometry
from mountnav.measuring.measurements import Flag
from mountnav.sky.wcs import places_at_pixels
from mountnav.solution import IdentifiedPairs, Solution
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]

_FULL_LEVERAGE = 1.0 - 1e-6
"""A pair of at least this leverage alone holds a parameter of the plate, and has no independent deviation. A
guard against division by zero: leverages of other pairs are below 0.999."""


@dataclass(frozen=True, slots=True)
class Deviations:
    """Measured minus catalog of identified pairs; each array has shape (n,).

    Attributes
    ----------
    ra_arcsec, dec_arcsec : ndarray
        Δα cos δ and Δδ [S23 eq. 24, 25].
    mag : ndarray
        Δm [S23 eq. 26]; NaN where it means nothing: see `magnitude_deviations`.
    x_px, y_px : ndarray
        Where in the frame, 0-based.
    along_x_arcsec, along_y_arcsec : ndarray
        The same deviation on the sky, along the frame's own axes: there a distortion of the camera shows,
        however the frames are turned.
    """

    ra_arcsec: Array
    dec_arcsec: Array
    mag: Array
    x_px: Array
    y_px: Array
    along_x_arcsec: Array
    along_y_arcsec: Array

    def __len__(self) -> int:
        return int(self.ra_arcsec.size)

    @property
    def modulus_arcsec(self) -> Array:
        """Δ_αδ [S23 eq. 22], shape (n,)."""
        return np.asarray(np.hypot(self.ra_arcsec, self.dec_arcsec))


@dataclass(frozen=True, slots=True)
class Indicators:
    """Indicators of one kind of deviation [S23 eq. 27-32]; NaN where there are too few values.

    Attributes
    ----------
    number : int
        How many deviations these are.
    mean, standard_deviation : float
        The latter with N - 1.
    """

    number: int
    mean: float
    standard_deviation: float
    least_modulus: float
    most_modulus: float


@dataclass(frozen=True, slots=True)
class AccuracyRow:
    """One column of the paper's Table 1: the indicators after the worst measurements were rejected.

    Attributes
    ----------
    ra, dec : Indicators
        Arcsec, of the same measurements: the worst are those of the largest Δ_αδ.
    mag : Indicators
        Here the worst are those of the largest modulus of Δm.
    """

    rejected_percent: float
    ra: Indicators
    dec: Indicators
    mag: Indicators


def deviations(
    solution: Solution,
    *,
    every: bool = False,
    leave_one_out: bool = False,
    catalog_sigma_arcsec: float = math.inf,
) -> Deviations:
    """Deviations of a solution's pairs, measured through its own WCS.

    Parameters
    ----------
    every : bool
        Also the pairs that were rejected by their deviation (K_rej), not only those in the fit.
    leave_one_out : bool
        Give each pair of the fit the deviation from a plate that was fit without it: that of a star that had
        no part in the fit, with the plate's own error in it. See `fit_factor`.
    catalog_sigma_arcsec : float
        Only pairs whose star's place the catalog states to be at least so good: where fainter stars are known
        worse than the camera measures them, their deviations are the catalog's. The plate stays as it is.
    """
    pairs = solution.identified
    ra_deg, dec_deg = places_at_pixels(solution.wcs, pairs.x_px, pairs.y_px)
    east, north = east_north_arcsec(ra_deg, dec_deg, pairs.ra_deg, pairs.dec_deg)
    along_x, along_y = _along_axes(solution)
    if leave_one_out:
        held = pairs.leverage
        # a pair that alone holds a parameter has no independent deviation
        alone = held >= _FULL_LEVERAGE
        stretch = np.where(alone, np.nan, 1.0 / (1.0 - np.where(alone, 0.0, held)))
        east, north = east * stretch, north * stretch
        along_x, along_y = along_x * stretch, along_y * stretch
    chosen = np.ones(len(pairs), dtype=bool) if every else pairs.used.copy()
    chosen &= np.isfinite(east) & np.isfinite(north)
    if math.isfinite(catalog_sigma_arcsec):
        chosen &= pairs.catalog_sigma_arcsec <= catalog_sigma_arcsec
    return Deviations(
        ra_arcsec=east[chosen],
        dec_arcsec=north[chosen],
        mag=magnitude_deviations(pairs)[chosen],
        x_px=pairs.x_px[chosen],
        y_px=pairs.y_px[chosen],
        along_x_arcsec=along_x[chosen],
        along_y_arcsec=along_y[chosen],
    )


def _along_axes(solution: Solution) -> tuple[Array, Array]:
    """Deviations in the tangential plane turned into the frame's axes, arcsec; shape (n,) each."""
    cards = solution.wcs
    matrix = np.array([[float(cards[f"CD{i}_{j}"]) for j in (1, 2)] for i in (1, 2)]) * 3600.0
    pairs = solution.identified
    px = np.linalg.solve(matrix, np.vstack((pairs.dx_arcsec, pairs.dy_arcsec)))
    scale = math.sqrt(abs(float(np.linalg.det(matrix))))
    return np.asarray(px[0] * scale), np.asarray(px[1] * scale)


def east_north_arcsec(ra_deg: Array, dec_deg: Array, ra0_deg: Array, dec0_deg: Array) -> tuple[Array, Array]:
    """Small offsets of positions from others, along east and north there [S23 eq. 24, 25].

    Δα cos δ and Δδ to second order of the offset, but right at the poles and over RA 0 too.

    Parameters
    ----------
    ra_deg, dec_deg, ra0_deg, dec0_deg : ndarray, shape (n,)
        The places, and those they are seen from.

    Returns
    -------
    east, north : ndarray, shape (n,)
        Arcsec.
    """
    lon = np.radians(ra_deg - ra0_deg)
    lat, lat0 = np.radians(dec_deg), np.radians(dec0_deg)
    east = np.cos(lat) * np.sin(lon)
    north = np.sin(lat - lat0) + 2.0 * np.cos(lat) * np.sin(lat0) * np.sin(0.5 * lon) ** 2
    return east * ARCSEC_PER_RAD, north * ARCSEC_PER_RAD


def magnitude_deviations(pairs: IdentifiedPairs) -> Array:
    """Δm of each pair, m_mea by the frame's own zero point and color term [S23 eq. 26].

    Returns
    -------
    ndarray, shape (n,)
        NaN for saturated stars, for those without a flux or without a magnitude of their own in the catalog's
        band, for variable and extended ones; all NaN if fewer than three pairs hold the zero point.
    """
    photometry = fit_photometry(pairs)
    if photometry is None:
        return np.full(len(pairs), np.nan)
    comparable = (pairs.flags & int(Flag.SATURATED)) == 0
    comparable &= (pairs.star_flags & int(NOT_COMPARABLE)) == 0
    off = photometry.magnitudes(pairs.flux, pairs.color_mag) - pairs.mag
    return np.asarray(np.where(comparable & np.isfinite(off), off, np.nan))


def fit_factor(pairs: int, parameters: float) -> float:
    """By what factor the spread of a fit's own pairs falls short of their errors: sqrt(1 - p/n).

    The plate follows its pairs, in the mean over them by p/n of their variance. Pairs that had no part in the
    fit deviate by the same share more than their errors, for they see the plate's own error too.

    Parameters
    ----------
    parameters : float
        Per coordinate, as many as the pairs really determine: the sum of their leverages.
        Summed over frames if several are taken together.
    """
    return math.sqrt(1.0 - parameters / pairs) if pairs > parameters else 0.0


def pooled(parts: Sequence[Deviations]) -> Deviations:
    """Deviations of several frames as one set, in order."""

    def joined(name: str) -> Array:
        return np.concatenate([getattr(part, name) for part in parts]) if parts else np.zeros(0)

    return Deviations(*(joined(field.name) for field in fields(Deviations)))


def without_worst(modulus: Array, rejected_percent: float) -> NDArray[np.intp]:
    """Which of n values stay when the worst are rejected.

    Parameters
    ----------
    modulus : ndarray, shape (n,)
        The larger, the worse.
    rejected_percent : float
        0 <= p < 100; n·p/100 values go, rounded down.

    Returns
    -------
    ndarray of int, shape (k,)
        Ascending indices.

    Raises
    ------
    BadRequest
        The percentage is none.
    """
    if not (math.isfinite(rejected_percent) and 0.0 <= rejected_percent < 100.0):
        raise BadRequest(
            f"{rejected_percent:g} % of the measurements can't be rejected", advice="0 or more, below 100"
        )
    # the small addend keeps 5 % of 20 at 1 in binary fractions
    gone = math.floor(modulus.size * rejected_percent / 100.0 + 1e-9)
    return np.sort(np.argsort(modulus, kind="stable")[: modulus.size - gone])


def indicators(values: Array) -> Indicators:
    """Mean, standard deviation (N - 1), least and largest modulus [S23 eq. 27-32].

    Parameters
    ----------
    values : ndarray, shape (n,)
        Finite.
    """
    n = int(values.size)
    if n == 0:
        return Indicators(0, math.nan, math.nan, math.nan, math.nan)
    modulus = np.abs(values)
    return Indicators(
        number=n,
        mean=float(values.mean()),
        standard_deviation=float(values.std(ddof=1)) if n > 1 else math.nan,
        least_modulus=float(modulus.min()),
        most_modulus=float(modulus.max()),
    )


def accuracy_table(found: Deviations, rejected_percent: Sequence[float]) -> tuple[AccuracyRow, ...]:
    """Table 1 of [S23] for a set of deviations.

    Parameters
    ----------
    rejected_percent : sequence of float
        The paper has 0, 5 and 10.

    Returns
    -------
    tuple of AccuracyRow
        One for each percentage, in order.

    Raises
    ------
    BadRequest
        See `without_worst`.
    """
    mag = found.mag[np.isfinite(found.mag)]
    rows = []
    for percent in rejected_percent:
        kept = without_worst(found.modulus_arcsec, percent)
        rows.append(
            AccuracyRow(
                rejected_percent=float(percent),
                ra=indicators(found.ra_arcsec[kept]),
                dec=indicators(found.dec_arcsec[kept]),
                mag=indicators(mag[without_worst(np.abs(mag), percent)]),
            )
        )
    return tuple(rows)
