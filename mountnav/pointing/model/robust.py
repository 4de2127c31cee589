"""Robust fitting: which points count, and how much; gross errors don't, no matter who made them.

Absolute distances first (they start anywhere), then Tukey's biweight on the on-sky distance, c = 4.685, with
the scale median/1.1774 of a Rayleigh distribution [POINTING §6]; what it gives no weight is left out, and the
rest is fitted by plain least squares, so that on data without gross errors the result is that of PMFIT.

What is left out is never more than a fifth: when more points than that disagree with a model, the model is
wrong and not the points, and the scale grows until they count.

The play of the gears is fitted beside the terms where the looks tell the sense in which the gears were
driven. It is no part of a model (nobody knows the sense of a slew to come), but left out it would be taken
for geometry: low targets are come to from above, and the west is tracked downwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mountnav.errors import ModelRefused
from mountnav.pointing.model.linear import LinearFit, Segments, ZeroPoints, solve
from mountnav.pointing.model.mechanical import Bools, Mechanical
from mountnav.pointing.model.rigorous import geometry, seen_from, tangent, wrapped
from mountnav.pointing.model.terms import ZERO_POINTS, Array, basis
from mountnav.pointing.model.visits import RAYLEIGH_MEDIAN
from mountnav.units import RAD_PER_ARCSEC

# Bound of Tukey's biweight in sigmas: 95 % efficient for normal errors [Holland & Welsch 1977]. Doubled,
# gross errors pull at the fit.
TUKEY = 4.685
MOST_LEFT_OUT = 0.2
"""Share of the points that may be gross errors: one in ten looks is, in bad nights."""
PLAY = ("play of the first axis", "play of the second axis")
"""Fitted beside the terms, and no part of a model: how far the tube trails after the gears turned round."""
_LEAST_INDEPENDENCE = 0.1
"""Share of a play's column that neither zero points nor terms explain; below, it is left out."""
_TELLING_SENSES = 4
"""So many points in each sense, at least, tell a play."""
# Least scatter, arcsec, so that perfect (simulated) points don't divide by 0.
_SMALLEST_SCALE_ARCSEC = 1e-3
_LONELY = 0.1
"""Points that keep less of their own residual tell nothing about the scale."""
# Most steps of the three stages of a robust fit. Chosen by hand; all but the first end when they have
# converged.
_STEPS_ABSOLUTE, _STEPS_BIWEIGHT, _STEPS_PLAIN = 12, 25, 12
# The fit has converged when no prediction changes by more, arcsec: far below any scatter.
_DONE_ARCSEC = 1e-4
# Share of a column that no other explains, below which a fit is refused as singular.
_SINGULAR = 1e-6
_A_HAIR = 1.0 + 1e-9
"""A residual just at the bound counts the same on every machine, whatever its last bit."""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Coefficients and zero points, and what they leave.

    Attributes
    ----------
    coefficients_arcsec : ndarray, shape (k,)
        Of the terms and plays, zero points apart.
    zero_points_arcsec : ndarray, shape (s, 2)
        Added to the axes' readings: longitude, latitude.
    residuals_arcsec : ndarray, shape (n, 2)
        Seen less predicted, exact, along ξ and η of the axes.
    columns : ndarray, shape (n, 2, k)
        The terms at the axes.
    cos_lat : ndarray, shape (n,)
        One a point.
    """

    coefficients_arcsec: Array
    zero_points_arcsec: Array
    residuals_arcsec: Array
    columns: Array
    cos_lat: Array


def state_at(m: Mechanical, names: tuple[str, ...], coefficients: Array, zero_points: Array) -> State:
    """Predict every point rigorously and compare."""
    lon = m.read_lon_rad + zero_points[m.segment, 0] * RAD_PER_ARCSEC
    lat = m.read_lat_rad + zero_points[m.segment, 1] * RAD_PER_ARCSEC
    values = dict(zip(names, coefficients.tolist(), strict=True))
    plays = {name: values.pop(name) for name in PLAY if name in values}
    told = geometry(m.kind, m.site_latitude_rad, values)
    missed = m.seen - seen_from(told, lon, lat)
    along_xi, along_eta = tangent(lon, lat)
    residuals = np.stack([np.sum(missed * along_xi, axis=1), np.sum(missed * along_eta, axis=1)], axis=1)
    residuals /= RAD_PER_ARCSEC
    columns = columns_at(m, names, lon, lat)
    for name, value in plays.items():
        residuals -= value * columns[:, :, names.index(name)]
    return State(coefficients, zero_points, residuals, columns, np.cos(lat))


def columns_at(m: Mechanical, names: tuple[str, ...], lon_rad: Array, lat_rad: Array) -> Array:
    """The terms and plays at axis angles; shape (n, 2, k)."""
    columns = np.zeros((len(m), 2, len(names)))
    terms = [name for name in names if name not in PLAY]
    at = [k for k, name in enumerate(names) if name not in PLAY]
    columns[:, :, at] = basis(m.kind, terms, lon_rad, lat_rad, m.site_latitude_rad)
    for axis, name in enumerate(PLAY):
        if name in names:
            along = np.cos(lat_rad) if axis == 0 else 1.0
            columns[:, axis, names.index(name)] = 0.5 * m.senses[:, axis] * along
    return columns


def plays_told(m: Mechanical, names: tuple[str, ...]) -> tuple[str, ...]:
    """Which plays can be fitted beside these terms: both senses in one segment, often enough."""
    segments = Segments(m.segment, len(m.segment_ids))
    state = first_state(m, ())
    lon = m.read_lon_rad + state.zero_points_arcsec[m.segment, 0] * RAD_PER_ARCSEC
    lat = m.read_lat_rad + state.zero_points_arcsec[m.segment, 1] * RAD_PER_ARCSEC
    zero_points = ZeroPoints.of(segments, state.cos_lat, np.ones(len(m)))
    found: list[str] = []
    for axis, name in enumerate(PLAY):
        sense = m.senses[:, axis]
        if min(np.sum(sense > 0.5), np.sum(sense < -0.5)) < _TELLING_SENSES:
            continue
        trial = (*found, name, *names)
        # three coordinates for each unknown: a nuisance must not eat the looks of a short run
        if 2 * (len(m) - len(np.unique(m.segment))) < 3 * len(trial):
            continue
        try:
            linear = solve(columns_at(m, trial, lon, lat), np.zeros((len(m), 2)), zero_points)
        except np.linalg.LinAlgError:
            continue
        if linear.independence[len(found)] >= _LEAST_INDEPENDENCE:
            found.append(name)
    return tuple(found)


def first_state(m: Mechanical, names: tuple[str, ...]) -> State:
    """Begin with the median zero points of each segment and no other error."""
    lon, lat = m.seen_angles
    off_lon, off_lat = wrapped(lon - m.read_lon_rad), wrapped(lat - m.read_lat_rad)
    weight = np.abs(np.cos(lat))
    zero_points = np.zeros((len(m.segment_ids), 2))
    for s in np.unique(m.segment):
        mine = m.segment == s
        # near the pole the longitude of a point says little
        turned = wrapped(off_lon[mine] - off_lon[mine][np.argmax(weight[mine])])
        middle = _weighted_median(turned, weight[mine]) + off_lon[mine][np.argmax(weight[mine])]
        zero_points[s] = middle / RAD_PER_ARCSEC, np.median(off_lat[mine]) / RAD_PER_ARCSEC
    return state_at(m, names, np.zeros(len(names)), zero_points)


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(summed, 0.5 * summed[-1])])


@dataclass(frozen=True, slots=True, eq=False)
class RobustFit:
    """A converged fit.

    Attributes
    ----------
    names : tuple of str
        Terms and plays, zero points apart.
    linear : LinearFit
        The last step: its hat matrix, covariance, condition.
    weight : ndarray, shape (n,)
        Inverse variances in 1/arcsec²; 0 for what was left out.
    used : ndarray of bool, shape (n,)
        Points that count.
    scale_arcsec : float
        Robust scatter per coordinate.
    """

    names: tuple[str, ...]
    state: State
    linear: LinearFit
    weight: Array
    used: Bools
    scale_arcsec: float

    @property
    def geometry(self) -> list[int]:
        """Which of the names are terms."""
        return [k for k, name in enumerate(self.names) if name not in PLAY]


def step(
    m: Mechanical, names: tuple[str, ...], state: State, segments: Segments, weight: Array
) -> tuple[State, LinearFit]:
    """One Gauss-Newton step with these weights."""
    try:
        linear = solve(state.columns, state.residuals_arcsec, ZeroPoints.of(segments, state.cos_lat, weight))
    except np.linalg.LinAlgError as cause:
        raise _not_independent(names) from cause
    if not np.all(np.isfinite(linear.coefficients)) or np.min(linear.independence, initial=1.0) < _SINGULAR:
        raise _not_independent(names)
    moved = state_at(
        m,
        names,
        state.coefficients_arcsec + linear.coefficients,
        state.zero_points_arcsec + linear.zero_points,
    )
    return moved, linear


def _not_independent(names: tuple[str, ...]) -> ModelRefused:
    return ModelRefused(
        f"the points can't distinguish the terms {', '.join(names)}",
        advice="take points over a wider range of both axes, or fewer terms",
    )


def distances(state: State, linear: LinearFit | None, variance: Array | None = None) -> tuple[Array, Array]:
    """On-sky distances as if each point had no part in the fit nor the fit an error of its own.

    Parameters
    ----------
    linear : LinearFit or None
        The step that led there; None at the beginning.
    variance : ndarray, shape (n,), optional
        Per coordinate; given, points that don't count are freed from the error of their prediction.

    Returns
    -------
    distance, left : ndarray, shape (n,)
        The distances, and how much of each point's own error its residual still shows.
    """
    plain = np.hypot(state.residuals_arcsec[:, 0], state.residuals_arcsec[:, 1])
    if linear is None:
        return plain, np.ones_like(plain)
    hat = 0.5 * (linear.hat[0] + linear.hat[1])
    left = np.clip(1.0 - hat, 0.0, 1.0)
    freed = plain / np.sqrt(np.maximum(left, _LONELY))
    if variance is not None:
        spread = np.mean(linear.spread, axis=1)
        share = np.where(
            np.isfinite(spread), variance / (variance + np.where(np.isfinite(spread), spread, 0)), 1
        )
        freed = np.where(hat > 0.0, freed, plain * np.sqrt(share))
    return freed, left


def scale_of(distance: Array, left: Array) -> float:
    """Scatter per coordinate, from the median distance."""
    telling = distance[left > _LONELY]
    if telling.size == 0:
        telling = distance
    return max(float(np.median(telling)) / RAYLEIGH_MEDIAN, _SMALLEST_SCALE_ARCSEC)


def variances(m: Mechanical, scale_arcsec: float) -> Array:
    """Per coordinate, arcsec²: each point's own, and what else the telescope scatters."""
    own = m.sigma_arcsec**2
    more = max(scale_arcsec**2 - float(np.median(own)), 0.0)
    return np.asarray(np.maximum(own + more, _SMALLEST_SCALE_ARCSEC**2))


def inliers(
    m: Mechanical, state: State, linear: LinearFit | None, used: Bools | None = None
) -> tuple[Bools, Array, float]:
    """Which points count, the inverse variances, the scale.

    The scale is not below that of the points that count now: else a fit that bent to a few points would throw
    out the others, and its own success would be the reason.
    """
    distance, left = distances(state, linear)
    scale = scale_of(distance, left)
    if used is not None and linear is not None:
        freedom = 2.0 * np.sum(used) - np.sum((linear.hat[0] + linear.hat[1])[used])
        if freedom >= 1.0:
            scale = max(scale, float(np.sqrt(np.sum(state.residuals_arcsec[used] ** 2) / freedom)))
    variance = variances(m, scale)
    distance, left = distances(state, linear, variance)
    more = _more(distance / np.sqrt(variance), left)
    if more > 1.0:
        scale *= more
        variance = variances(m, scale)
        distance, left = distances(state, linear, variance)
    relative = distance / np.sqrt(variance)
    return relative <= TUKEY * _more(relative, left) * _A_HAIR, 1.0 / variance, scale


def _more(relative: Array, left: Array) -> float:
    """By how much the scale has to grow so that no more points are left out than may be; 1: not at all."""
    telling = relative[left > _LONELY] if np.any(left > _LONELY) else relative
    farthest = float(np.sort(telling)[math.ceil((1.0 - MOST_LEFT_OUT) * telling.size) - 1])
    return max(farthest / TUKEY, 1.0)


def robust_fit(
    m: Mechanical,
    names: tuple[str, ...],
    *,
    start: State | None = None,
    fixed: Bools | None = None,
    biweight_steps: int = _STEPS_BIWEIGHT,
    plain_steps: int = _STEPS_PLAIN,
) -> RobustFit:
    """Fit terms and zero points.

    Parameters
    ----------
    names : tuple of str
        Without zero points.
    start : State, optional
        Where to begin; given, the stage of absolute distances is left out.
    fixed : ndarray of bool, optional
        Use exactly these points.
    biweight_steps, plain_steps : int
        At most so many.

    Raises
    ------
    ModelRefused
        Too few points, or they can't tell the terms apart.
    """
    if any(name in ZERO_POINTS[m.kind] for name in names):
        raise ValueError("zero points are fitted to each segment by themselves")
    segments = Segments(m.segment, len(m.segment_ids))
    _enough(np.ones(len(m), dtype=np.bool_) if fixed is None else fixed, m, names)
    state = first_state(m, names) if start is None else start
    linear: LinearFit | None = None
    if fixed is None:
        if start is None:
            for _ in range(_STEPS_ABSOLUTE):
                distance, left = distances(state, linear)
                floor = max(0.1 * scale_of(distance, left), _SMALLEST_SCALE_ARCSEC)
                state, linear = step(m, names, state, segments, 1.0 / np.maximum(distance, floor))
        for _ in range(biweight_steps):
            distance, left = distances(state, linear)
            variance = variances(m, scale_of(distance, left))
            relative = distance / np.sqrt(variance)
            scale = scale_of(relative, left)
            u = relative / (TUKEY * scale * _more(relative / scale, left))
            weight = np.where(u < 1.0, (1.0 - u**2) ** 2, 0.0) / variance
            before = state
            _enough(weight > 0.0, m, names)
            state, linear = step(m, names, state, segments, weight)
            if _change_arcsec(before, state) < 1e-2:
                break
    used, inverse, scale = inliers(m, state, linear)
    for _ in range(plain_steps):
        if fixed is not None:
            used = fixed
        _enough(used, m, names)
        before, count = state, used
        state, linear = step(m, names, state, segments, np.where(used, inverse, 0.0))
        used, inverse, scale = inliers(m, state, linear, used)
        if _change_arcsec(before, state) < _DONE_ARCSEC and (
            fixed is not None or bool(np.all(used == count))
        ):
            break
    used = count if fixed is None else fixed
    assert linear is not None
    return RobustFit(names, state, linear, np.where(used, inverse, 0.0), used, scale)


def _change_arcsec(before: State, after: State) -> float:
    moved = np.abs(after.residuals_arcsec - before.residuals_arcsec)
    return float(np.max(moved, initial=0.0))


def _enough(used: Bools, m: Mechanical, names: tuple[str, ...]) -> None:
    points, segments = int(np.sum(used)), len(np.unique(m.segment[used]))
    unknowns = len(names) + 2 * segments
    if 2 * points <= unknowns:
        raise ModelRefused(
            f"{points} usable points in {segments} segment(s) can't tell {unknowns} unknowns",
            advice="take more points, or fewer terms; each sync between points costs one of them",
        )
