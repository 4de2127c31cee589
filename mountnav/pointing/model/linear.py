"""Weighted least squares on the sky with two zero points a segment, and what leaving a point out does.

The zero points never enter a matrix: within a segment the longitude zero moves ξ by cos(lat), the latitude
zero moves η by 1, and the two don't mix, so both are projected out of everything first (Frisch-Waugh). Two
hundred segments cost no more than one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mountnav.pointing.model.mechanical import Numbers
from mountnav.pointing.model.terms import Array

_ALONE = 1e-6
"""A point without which the rest doesn't determine its own prediction: nothing is known by leaving it out."""


class Segments:
    """Sums over segments; points may come in any order.

    Parameters
    ----------
    segment : ndarray of int, shape (n,)
        Number of the segment of each point, from 0.
    count : int
        How many segments there are; some may be empty.
    """

    def __init__(self, segment: Numbers, count: int) -> None:
        self.segment = segment
        self.count = count
        self._order = np.argsort(segment, kind="stable")
        self._present, self._starts = np.unique(segment[self._order], return_index=True)

    def sums(self, values: Array) -> Array:
        """Sum values of shape (n, ...) over segments; shape (count, ...)."""
        total = np.zeros((self.count, *values.shape[1:]))
        total[self._present] = np.add.reduceat(values[self._order], self._starts, axis=0)
        return total


@dataclass(frozen=True, slots=True, eq=False)
class ZeroPoints:
    """What projects the zero points out, for given weights.

    Attributes
    ----------
    cos_lat, weight : ndarray, shape (n,)
        One a point.
    lon_sum, lat_sum : ndarray, shape (s,)
        Weights of the two zero points of each segment; 0 where no point tells.
    """

    segments: Segments
    cos_lat: Array
    weight: Array
    lon_sum: Array
    lat_sum: Array

    @classmethod
    def of(cls, segments: Segments, cos_lat: Array, weight: Array) -> ZeroPoints:
        """Prepare the projection."""
        sums = segments.sums(np.stack([weight * cos_lat**2, weight], axis=1))
        return cls(segments, cos_lat, weight, sums[:, 0], sums[:, 1])

    def means(self, values: Array) -> Array:
        """Zero points that fit values of shape (n, 2, m) best; shape (s, 2, m)."""
        lon = self.segments.sums((self.weight * self.cos_lat)[:, None] * values[:, 0])
        lat = self.segments.sums(self.weight[:, None] * values[:, 1])
        return np.stack([_shares(lon, self.lon_sum), _shares(lat, self.lat_sum)], axis=1)

    def without(self, values: Array) -> Array:
        """Values of shape (n, 2, m) less what zero points explain."""
        mean = self.means(values)[self.segments.segment]
        return np.stack(
            [values[:, 0] - self.cos_lat[:, None] * mean[:, 0], values[:, 1] - mean[:, 1]], axis=1
        )

    def leverage(self) -> tuple[Array, Array]:
        """What of the hat matrix is the zero points': its ξξ and ηη; ξη is 0."""
        lon, lat = self.lon_sum[self.segments.segment], self.lat_sum[self.segments.segment]
        return _shares(self.weight * self.cos_lat**2, lon), _shares(self.weight, lat)


def _shares(above: Array, below: Array) -> Array:
    below = below.reshape(below.shape + (1,) * (above.ndim - below.ndim))
    return np.divide(above, below, out=np.zeros_like(above), where=np.broadcast_to(below > 0.0, above.shape))


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """A linear fit: coefficients, what they leave, and the hat matrix' blocks.

    Attributes
    ----------
    coefficients : ndarray, shape (k,)
        One a column.
    zero_points : ndarray, shape (s, 2)
        Angles of the axes in the units of the residuals; 0 where no point tells.
    residuals : ndarray, shape (n, 2)
        In the two directions on the sky.
    unit_covariance : ndarray, shape (k, k)
        For weights that are inverse variances.
    zero_points_of_terms : ndarray, shape (s, 2, k)
        How the zero points follow the coefficients, with the sign turned.
    hat : (ndarray, ndarray, ndarray), shape (n,) each
        ξξ, ηη and ξη of each point's 2 × 2 block.
    spread : ndarray, shape (n, 2)
        Variance of the prediction at each point, for weights that are inverse variances; infinite where the
        points that count tell nothing.
    condition : float
        Of the columns, scaled to the same length before the zero points were taken out.
    independence : ndarray, shape (k,)
        Share of each column's length that neither zero points nor other columns explain.
    """

    coefficients: Array
    zero_points: Array
    residuals: Array
    unit_covariance: Array
    zero_points_of_terms: Array
    hat: tuple[Array, Array, Array]
    spread: Array
    condition: float
    independence: Array

    def left_out(self) -> Array:
        """Residuals of each point against a fit without it; NaN where the rest can't predict it."""
        return left_out(self.residuals, *self.hat)


def left_out(residuals: Array, hat_xi: Array, hat_eta: Array, hat_mixed: Array) -> Array:
    """Solve (I - H) e' = e for each point's 2 × 2 block; NaN where it can't be.

    Parameters
    ----------
    residuals : ndarray, shape (n, 2)
        Of the fit to all points.
    hat_xi, hat_eta, hat_mixed : ndarray, shape (n,)
        The hat matrix' block of each point.
    """
    a, b, c = 1.0 - hat_xi, 1.0 - hat_eta, hat_mixed
    determinant = a * b - c * c
    with np.errstate(divide="ignore", invalid="ignore"):
        xi = (b * residuals[:, 0] + c * residuals[:, 1]) / determinant
        eta = (c * residuals[:, 0] + a * residuals[:, 1]) / determinant
    known = (determinant > _ALONE) & (a > _ALONE) & (b > _ALONE)
    return np.where(known[:, None], np.stack([xi, eta], axis=1), np.nan)


def solve(columns: Array, values: Array, zero_points: ZeroPoints) -> LinearFit:
    """Fit values by columns and zero points.

    Parameters
    ----------
    columns : ndarray, shape (n, 2, k)
        k may be 0.
    values : ndarray, shape (n, 2)
        What the columns shall explain.
    zero_points : ZeroPoints
        With the weights.

    Raises
    ------
    numpy.linalg.LinAlgError
        Columns are not independent of each other and the zero points at all.
    """
    n, _, k = columns.shape
    root = np.sqrt(zero_points.weight)[:, None, None]
    inner = zero_points.without(columns)
    rest = zero_points.without(values[:, :, None])
    weighted = (root * inner).reshape(2 * n, k)
    q, r = np.linalg.qr(weighted)
    coefficients = np.linalg.solve(r, q.T @ (root * rest).reshape(2 * n)) if k else np.zeros(0)
    inverse = np.linalg.inv(r) if k else np.zeros((0, 0))
    lengths = np.sqrt(np.sum((root * columns) ** 2, axis=(0, 1)))
    scaled = r / np.where(lengths > 0.0, lengths, 1.0)
    singular = np.linalg.svd(scaled, compute_uv=False) if k else np.ones(1)
    covariance = inverse @ inverse.T
    own = q.reshape(n, 2, k)
    lever_lon, lever_lat = zero_points.leverage()
    remaining = values - columns @ coefficients
    means = zero_points.means(remaining[:, :, None])[:, :, 0]
    rows = inner @ inverse
    with np.errstate(divide="ignore"):
        spread_lon = zero_points.cos_lat**2 / zero_points.lon_sum[zero_points.segments.segment]
        spread_lat = 1.0 / zero_points.lat_sum[zero_points.segments.segment]
    return LinearFit(
        coefficients=coefficients,
        zero_points=means,
        residuals=zero_points.without(remaining[:, :, None])[:, :, 0],
        unit_covariance=covariance,
        zero_points_of_terms=zero_points.means(columns),
        hat=(
            lever_lon + np.sum(own[:, 0] ** 2, axis=1),
            lever_lat + np.sum(own[:, 1] ** 2, axis=1),
            np.sum(own[:, 0] * own[:, 1], axis=1),
        ),
        spread=np.stack([spread_lon, spread_lat], axis=1) + np.sum(rows**2, axis=2),
        condition=float(singular[0] / singular[-1]) if singular[-1] > 0.0 else np.inf,
        independence=np.array(1.0 / (np.sqrt(np.diag(covariance)) * lengths)) if k else np.zeros(0),
    )
