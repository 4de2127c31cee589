"""Leave-one-out: how well a model predicts, and how well its coefficients are known.

Leave-one-out is the one figure that says how well a model points, wherever such a figure is shown. Each visit
(the looks at one target in one segment, `visits`) is predicted from the others: the geometry from all others,
the zero points from the others of its segment. That is the situation of a slew to a new target. A visit that
is alone in its segment can't be predicted and doesn't count. The play of the gears, which a fit may allow
for, stays in the error: for a slew to come it isn't known.

Coefficients: their covariance is from the scatter of visits, and from what leaving out a target changes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mountnav.pointing.model.linear import LinearFit, Segments, ZeroPoints, left_out, solve
from mountnav.pointing.model.mechanical import Bools, Mechanical
from mountnav.pointing.model.robust import PLAY, TUKEY, RobustFit, State, first_state, state_at
from mountnav.pointing.model.terms import Array


def loo_residuals(m: Mechanical, fit: RobustFit) -> Array:
    """Residuals of each point against a fit without it; of points that don't count, against the fit.

    Parameters
    ----------
    m : Mechanical
        The points of the fit.

    Returns
    -------
    ndarray, shape (n, 2)
        Arcsec along ξ and η; NaN where the others can't predict it.
    """
    linear, state = fit.linear, fit.state
    out = left_out(state.residuals_arcsec, *linear.hat)
    plays = [k for k, name in enumerate(fit.names) if name in PLAY]
    if plays:
        zero_points = ZeroPoints.of(Segments(m.segment, len(m.segment_ids)), state.cos_lat, fit.weight)
        play = state.columns[:, :, plays] @ state.coefficients_arcsec[plays]
        lever_lon, lever_lat = zero_points.leverage()
        freed = zero_points.without(play[:, :, None])[:, :, 0]
        out = out + left_out(freed, lever_lon, lever_lat, np.zeros_like(lever_lon))
    return np.asarray(np.where(np.all(np.isfinite(linear.spread), axis=1)[:, None], out, np.nan))


def loo_rms(residuals: Array, used: Bools) -> float:
    """RMS on-sky distance of the points that count, each predicted from the others; infinite if none can be.

    Parameters
    ----------
    residuals : ndarray, shape (n, 2)
        Of points left out; NaN where the others predict nothing.
    used : ndarray of bool, shape (n,)
        Points that count.
    """
    squared = np.sum(residuals[used] ** 2, axis=1)
    squared = squared[np.isfinite(squared)]
    return float(np.sqrt(np.mean(squared))) if squared.size else math.inf


def loo_arcsec(m: Mechanical, fit: RobustFit) -> float:
    """Leave-one-out RMS of a fit; infinite if no point can be predicted from others."""
    return loo_rms(loo_residuals(m, fit), fit.used)


def bounded_losses(one: Array, other: Array, scale_arcsec: float) -> tuple[Array, Array]:
    """Squared distances of the points that both predict, gross errors at the same price for both.

    Without that a fit would be the better the more points it leaves out.

    Parameters
    ----------
    one, other : ndarray, shape (n, 2)
        Residuals of the same points, left out.
    scale_arcsec : float
        Scatter per coordinate of the better one.
    """
    known = np.isfinite(one[:, 0]) & np.isfinite(other[:, 0])
    most = 2.0 * (TUKEY * scale_arcsec) ** 2
    first, second = (np.minimum(np.sum(each[known] ** 2, axis=1), most) for each in (one, other))
    return first, second


_ROUNDS = 8
"""Of the zero points of a given geometry: each takes off three digits."""


def zeroed(m: Mechanical, used: Bools, coefficients_arcsec: Mapping[str, float]) -> tuple[State, LinearFit]:
    """Give a geometry the zero points that suit points best.

    Parameters
    ----------
    m : Mechanical
        One point a visit.
    used : ndarray of bool, shape (n,)
        Points that count.
    coefficients_arcsec : mapping
        Geometry terms.
    """
    names = tuple(coefficients_arcsec)
    values = np.array([coefficients_arcsec[name] for name in names])
    segments = Segments(m.segment, len(m.segment_ids))
    state = state_at(m, names, values, first_state(m, ()).zero_points_arcsec)
    for _ in range(_ROUNDS):
        zero_points = ZeroPoints.of(segments, state.cos_lat, used.astype(np.float64))
        linear = solve(state.columns[:, :, :0], state.residuals_arcsec, zero_points)
        state = state_at(m, names, values, state.zero_points_arcsec + linear.zero_points)
    return state, linear


def loo_of_geometry(m: Mechanical, used: Bools, coefficients_arcsec: Mapping[str, float]) -> Array:
    """As `loo_residuals`, of a geometry that had not to be fitted: an old model's, or none at all."""
    linear = zeroed(m, used, coefficients_arcsec)[1]
    return np.asarray(
        np.where(np.all(np.isfinite(linear.spread), axis=1)[:, None], linear.left_out(), np.nan)
    )


def variance_factor(fitted: RobustFit) -> float:
    """What the inverse variances have to be divided by to fit the residuals."""
    used = fitted.used
    squared = np.sum(fitted.state.residuals_arcsec[used] ** 2, axis=1)
    freedom = 2.0 * np.sum(used) - np.sum((fitted.linear.hat[0] + fitted.linear.hat[1])[used])
    return float(np.sum(fitted.weight[used] * squared) / max(freedom, 1.0))


def covariance_of(m: Mechanical, fitted: RobustFit) -> Array:
    """Of coefficients, plays included; arcsec².

    Least squares take the errors of all points for independent and alike. In a night they aren't: the two
    visits of one target, on either side of a sync, share what is wrong there, and axes err differently. So
    each sigma is at least that of the jackknife over targets, which asks for nothing but that targets are
    independent [MacKinnon and White 1985, HC3; over targets as clusters]. Points of which nobody knows the
    target are taken as they are.
    """
    linear, state = fitted.linear, fitted.state
    plain = variance_factor(fitted) * linear.unit_covariance
    if m.target is None or not len(fitted.names):
        return np.asarray(plain)
    zero_points = ZeroPoints.of(Segments(m.segment, len(m.segment_ids)), state.cos_lat, fitted.weight)
    out = linear.left_out()
    out = np.where((fitted.used & np.isfinite(out[:, 0]))[:, None], out, 0.0)
    scores = fitted.weight[:, None] * np.einsum("nck,nc->nk", zero_points.without(state.columns), out)
    target = np.unique(m.target, return_inverse=True)[1].reshape(-1)
    sums = np.zeros((int(np.max(target)) + 1, scores.shape[1]))
    np.add.at(sums, target, scores)
    moved = sums @ linear.unit_covariance
    wider = np.sqrt(np.maximum(np.sum(moved**2, axis=0) / np.diag(plain), 1.0))
    return np.asarray(plain * np.outer(wider, wider))
