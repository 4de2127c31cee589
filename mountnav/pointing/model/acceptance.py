"""Whether a new model may take the old one's place: only if it predicts better, unseen points too.

Else the old one stays, and the words say why [POINTING §7].
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from mountnav.errors import BadRequest
from mountnav.pointing.model.fit import Fit
from mountnav.pointing.model.linear import Segments, ZeroPoints, solve
from mountnav.pointing.model.mechanical import Bools, Mechanical
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.robust import TUKEY, first_state, scale_of, state_at
from mountnav.pointing.model.selection import loo_rms
from mountnav.pointing.model.terms import Array, basis

CHANCE_OF_3_SIGMA = 0.0027
LEAST_FRESH = 3
_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class Judgement:
    """Whether a model is accepted, in words and numbers.

    Attributes
    ----------
    accepted : bool
    reasons : tuple of str
        What spoke against it; what spoke for it if nothing did.
    new_loo_arcsec, old_loo_arcsec : float
        Each point predicted from the others; the old model's geometry with zero points of its own segment.
    new_held_out_arcsec, old_held_out_arcsec : float or None
        RMS of points that had no part in the fit.
    held_out : int
        How many of these could be predicted.
    fresh_chance : float or None
        Chance that a true model misses the fresh points by as much.
    """

    accepted: bool
    reasons: tuple[str, ...]
    new_loo_arcsec: float
    old_loo_arcsec: float
    new_held_out_arcsec: float | None = None
    old_held_out_arcsec: float | None = None
    held_out: int = 0
    fresh_chance: float | None = None


def predicted(
    known: Mechanical,
    used: Bools,
    asked: Mechanical | None,
    coefficients_arcsec: Mapping[str, float],
) -> Array:
    """Residuals of a geometry whose zero points are told by `known`.

    Parameters
    ----------
    known : Mechanical
        Tells the zero points of each segment.
    used : ndarray of bool
        Which of them count.
    asked : Mechanical or None
        What is predicted; None: each of `known` from the others of its segment.
    coefficients_arcsec : mapping
        Geometry terms.

    Returns
    -------
    ndarray, shape (n, 2)
        Arcsec; NaN where no point tells the zero points.
    """
    names = tuple(coefficients_arcsec)
    values = np.array([coefficients_arcsec[name] for name in names])
    segments = Segments(known.segment, len(known.segment_ids))
    state = state_at(known, names, values, first_state(known, ()).zero_points_arcsec)
    weight = used.astype(np.float64)
    for _ in range(_ROUNDS):
        linear = solve(
            state.columns[:, :, :0],
            state.residuals_arcsec,
            ZeroPoints.of(segments, state.cos_lat, weight),
        )
        state = state_at(known, names, values, state.zero_points_arcsec + linear.zero_points)
    if asked is None:
        return linear.left_out()
    told = {key for s, key in enumerate(known.segment_ids) if np.any(used & (known.segment == s))}
    zero = np.full((len(asked.segment_ids), 2), np.nan)
    for s, key in enumerate(asked.segment_ids):
        if key in told:
            zero[s] = state.zero_points_arcsec[known.segment_ids.index(key)]
    return state_at(asked, names, values, zero).residuals_arcsec


def judge(
    fitted: Fit,
    *,
    old: PointingModel | None = None,
    held_out: Mechanical | None = None,
    fresh: Mechanical | None = None,
) -> Judgement:
    """Judge a new model against the old one, or against zero points alone if there is none.

    Parameters
    ----------
    fitted : Fit
    old : PointingModel, optional
    held_out : Mechanical, optional
        Points of the same segments that had no part in the fit.
    fresh : Mechanical, optional
        3 to 5 points taken since; in a segment of the fit, or one of their own.

    Returns
    -------
    Judgement

    Raises
    ------
    BadRequest
        Fewer than three fresh points, or the old model is of another kind of mount.
    """
    m, used = fitted.observations, fitted.used
    if old is not None and old.kind != m.kind:
        raise BadRequest(f"the old model is {old.kind}, the new one {m.kind}")
    before = {} if old is None else {name: old.coefficients[name] for name in old.geometry_terms}
    after = dict(zip(fitted.geometry_terms, fitted.coefficients_arcsec[2:].tolist(), strict=True))
    called = "the zero points alone" if old is None else "the old model"
    against: list[str] = []
    old_loo = loo_rms(predicted(m, used, None, before), used)
    if not fitted.loo_arcsec < old_loo:
        against.append(
            f"points left out in turn are predicted to {fitted.loo_arcsec:.1f}″, "
            f"by {called} to {old_loo:.1f}″"
        )
    new_out = old_out = chance = None
    counted = 0
    if held_out is not None and len(held_out):
        named = _renamed(held_out, fitted)
        new_out, old_out, counted = _compared(
            predicted(m, used, named, after), predicted(m, used, named, before)
        )
        if counted and not new_out < old_out:
            against.append(f"{counted} held-out points are {new_out:.1f}″ off, with {called} {old_out:.1f}″")
    if fresh is not None:
        if len(fresh) < LEAST_FRESH:
            raise BadRequest(f"{len(fresh)} fresh points are no check", advice="take 3 to 5 of them")
        chance = _chance(fitted, _renamed(fresh, fitted), after)
        if chance < CHANCE_OF_3_SIGMA:
            against.append(
                f"{len(fresh)} fresh points miss the model by more than 3 σ (chance {chance:.1g}): "
                "did something move since, or is it fitted too closely?"
            )
    said = [f"points left out in turn are predicted to {fitted.loo_arcsec:.1f}″, before to {old_loo:.1f}″"]
    if counted:
        said.append(f"{counted} held-out points are {new_out:.1f}″ off, before {old_out:.1f}″")
    if chance is not None and fresh is not None:
        said.append(f"{len(fresh)} fresh points agree within 3 σ")
    return Judgement(
        not against,
        tuple(against or said),
        fitted.loo_arcsec,
        old_loo,
        new_out if counted else None,
        old_out if counted else None,
        counted,
        chance,
    )


def _renamed(points: Mechanical, fitted: Fit) -> Mechanical:
    """The same points in the segments as the fit joined them."""
    ids = fitted.observations.segment_ids
    into = {key: ids[s] for s, one in enumerate(fitted.segments) for key in one.segment_ids}
    names = [into.get(key, key) for key in points.segment_ids]
    unique = tuple(dict.fromkeys(names))
    number = np.array([unique.index(name) for name in names], dtype=np.int64)
    return Mechanical(
        points.kind, points.site_latitude_rad, points.seen, points.beyond, points.read_lon_rad,
        points.read_lat_rad, points.sigma_arcsec, number[points.segment], unique,
    )  # fmt: skip


def _compared(new: Array, old: Array) -> tuple[float, float, int]:
    """RMS of both over the points that one of them at least comes near to."""
    ahead, behind = np.hypot(new[:, 0], new[:, 1]), np.hypot(old[:, 0], old[:, 1])
    known = np.isfinite(ahead) & np.isfinite(behind)
    if not np.any(known):
        return math.nan, math.nan, 0
    ahead, behind = ahead[known], behind[known]
    nearer = np.minimum(ahead, behind)
    sound = nearer <= 2.0 * TUKEY * scale_of(nearer, np.ones_like(nearer))
    rms = (float(np.sqrt(np.mean(one[sound] ** 2))) for one in (ahead, behind))
    return next(rms), next(rms), int(np.sum(sound))


def _chance(fitted: Fit, fresh: Mechanical, coefficients: Mapping[str, float]) -> float:
    """Probability that a true model misses fresh points by as much."""
    m = fitted.observations
    residuals = predicted(m, fitted.used, fresh, coefficients)
    freedom = 2 * len(fresh)
    alone = ~np.isfinite(residuals[:, 0])
    if np.any(alone):
        # a segment of their own: two degrees of freedom go into its zero points
        own = fresh.chosen(alone)
        state = state_at(
            own, tuple(coefficients), np.array(list(coefficients.values())),
            first_state(own, ()).zero_points_arcsec,
        )  # fmt: skip
        for _ in range(_ROUNDS):
            linear = solve(
                state.columns[:, :, :0],
                state.residuals_arcsec,
                ZeroPoints.of(Segments(own.segment, len(own.segment_ids)), state.cos_lat, np.ones(len(own))),
            )
            state = state_at(
                own,
                tuple(coefficients),
                state.coefficients_arcsec,
                state.zero_points_arcsec + linear.zero_points,
            )
        residuals[alone] = state.residuals_arcsec
        freedom -= 2 * len(np.unique(own.segment))
    if freedom <= 0:
        raise BadRequest("the fresh points are in too many segments to check anything")
    columns = basis(m.kind, fitted.terms, fresh.read_lon_rad, fresh.read_lat_rad, fresh.site_latitude_rad)
    model = np.einsum("nck,kl,ncl->nc", columns, fitted.covariance_arcsec2, columns)
    variance = model + (fitted.scatter_arcsec**2 + fresh.sigma_arcsec**2)[:, None]
    return float(chi2.sf(np.sum(residuals**2 / variance), freedom))
