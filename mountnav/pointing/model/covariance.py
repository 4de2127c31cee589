"""How well coefficients are known: from the scatter of visits, and from what leaving out a target does."""

from __future__ import annotations

import numpy as np

from mountnav.pointing.model.linear import Segments, ZeroPoints
from mountnav.pointing.model.mechanical import Mechanical
from mountnav.pointing.model.robust import RobustFit
from mountnav.pointing.model.terms import Array


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
