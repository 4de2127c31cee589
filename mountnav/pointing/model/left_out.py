"""Leave-one-out: the one figure that says how well a model points, wherever it is told.

Each visit (the looks at one target in one segment, `visits`) is predicted from the others: the geometry from
all others, the zero points from the others of its segment. That is what a slew to a fresh target meets. A
visit that is alone in its segment can't be predicted, and says nothing. The play of the gears, which a fit
may allow for, stays in: nobody knows it of a slew to come.
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
    fit : RobustFit

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
