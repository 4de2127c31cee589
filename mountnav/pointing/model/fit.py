"""Fitting a pointing model: coefficients with their errors, what it leaves, and what was there without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from mountnav.errors import ModelRefused
from mountnav.pointing.model.leave_one_out import covariance_of, loo_residuals, loo_rms, variance_factor
from mountnav.pointing.model.linear import Segments, ZeroPoints
from mountnav.pointing.model.mechanical import Bools, Mechanical
from mountnav.pointing.model.robust import RobustFit, first_state, plays_told, robust_fit, state_at
from mountnav.pointing.model.selection import SelectionStep, select
from mountnav.pointing.model.terms import CORE, HIGHEST_HARMONIC, ZERO_POINTS, Array, term
from mountnav.pointing.model.visits import Visits, visits

MAX_SIGMA_ARCSEC = 300.0
"""A coefficient less certain than this predicts nothing."""
# Share of a column that no other explains, below which a term is dropped from a fit. Chosen by hand: its
# sigma would be 100 times what it could be.
_LEAST_INDEPENDENCE = 0.01
_JOINED_WITHIN = 9.21
"""χ² of two zero points: segments that differ by more have only a chance of 1 % to be the same."""
_HARD_TO_PART = 0.95
"""Correlation of two coefficients from which on only their sum is well known."""


@dataclass(frozen=True, slots=True)
class Quality:
    """Distances on the sky between seen and predicted, of the points that count.

    Attributes
    ----------
    sky_rms_arcsec : float or None
        sqrt(Σ(ξ²+η²)/(n-k)), k the number of all unknowns, zero points of all segments included: PMFIT's and
        TPOINT's definition. None where there are as many unknowns as points, as in a night of many syncs: it
        isn't known then.
    population_rms_arcsec : float
        sqrt(Σ(ξ²+η²)/n): smaller, and what many programs tell.
    """

    sky_rms_arcsec: float | None
    population_rms_arcsec: float
    percent_90_arcsec: float
    max_arcsec: float


@dataclass(frozen=True, slots=True)
class SegmentZero:
    """The zero points of one segment.

    Attributes
    ----------
    segment_ids : tuple of str
        More than one where their zero points agree.
    points : int
        That count.
    first_arcsec, second_arcsec : float or None
        IH, ID or IA, IE; None where no point counts.
    sigma_first_arcsec, sigma_second_arcsec : float or None
        One sigma; None: not known.
    """

    segment_ids: tuple[str, ...]
    points: int
    first_arcsec: float | None
    second_arcsec: float | None
    sigma_first_arcsec: float | None
    sigma_second_arcsec: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted model and how good it is.

    Attributes
    ----------
    observations : Mechanical
        With the segments as they were fitted.
    terms : tuple of str
        Zero points first.
    coefficients_arcsec, sigma_arcsec : ndarray, shape (k,)
        The zero points are those of the last segment. The sigmas are per coordinate, from the scatter of
        visits: sqrt of Σ(ξ²+η²)/(2n-k) where each look is a visit; PMFIT prints them √2 larger.
    covariance_arcsec2 : ndarray, shape (k, k)
        Of the coefficients, in the order of the terms.
    condition : float
        Of the scaled columns.
    residuals_arcsec : ndarray, shape (n, 2)
        Of looks: seen less predicted along ξ and η of the axes.
    used : ndarray of bool, shape (n,)
        Which looks count.
    points : Mechanical
        What was fitted: looks at one target in one segment are one (`visits`).
    counted : ndarray of bool, shape (p,)
        Which points count.
    after, before : Quality
        With the model, and with zero points alone.
    left_out_arcsec : ndarray, shape (p, 2)
        Each point predicted from the others (`left_out`).
    loo_arcsec : float
        RMS distance of those that count: the one figure of that name.
    scatter_arcsec : float
        Per coordinate, of single visits against a true model: what the model's sigma doesn't hold.
    steps : tuple of SelectionStep
        How the terms were chosen; empty if they were given.
    notes : tuple of str
        What somebody who judges it should know.
    """

    observations: Mechanical
    terms: tuple[str, ...]
    coefficients_arcsec: Array
    sigma_arcsec: Array
    covariance_arcsec2: Array
    condition: float
    residuals_arcsec: Array
    used: Bools
    points: Mechanical
    counted: Bools
    after: Quality
    before: Quality
    left_out_arcsec: Array
    loo_arcsec: float
    scatter_arcsec: float
    segments: tuple[SegmentZero, ...]
    steps: tuple[SelectionStep, ...]
    notes: tuple[str, ...]

    @property
    def geometry_terms(self) -> tuple[str, ...]:
        """Without the zero points."""
        return self.terms[2:]

    @property
    def correlation(self) -> Array:
        """Of the coefficients; shape (k, k)."""
        root = np.sqrt(np.diag(self.covariance_arcsec2))
        return np.asarray(self.covariance_arcsec2 / np.outer(root, root))


def quality(residuals_arcsec: Array, unknowns: int) -> Quality:
    """Sum up residuals of shape (n, 2) that `unknowns` coefficients were fitted to."""
    distance = np.hypot(residuals_arcsec[:, 0], residuals_arcsec[:, 1])
    total, n = float(np.sum(distance**2)), len(distance)
    return Quality(
        float(np.sqrt(total / (n - unknowns))) if n > unknowns else None,
        float(np.sqrt(total / n)),
        float(np.quantile(distance, 0.9)),
        float(np.max(distance)),
    )


def fit(
    m: Mechanical,
    terms: Sequence[str] | Literal["auto"] = "auto",
    *,
    highest_harmonic: int = HIGHEST_HARMONIC,
    max_sigma_arcsec: float = MAX_SIGMA_ARCSEC,
    join_segments: bool = True,
) -> Fit:
    """Fit a pointing model: robustly, on the sky, with zero points of its own for each segment.

    Parameters
    ----------
    terms : sequence of str or "auto"
        TPOINT names, zero points as you like; "auto" chooses (`selection.select`).
    highest_harmonic : int
        Of an automatic choice.
    max_sigma_arcsec : float
        A coefficient that is less certain is refused, whatever the number of points.
    join_segments : bool
        Take segments together whose zero points agree within their errors, as those before and after a flip
        do on most mounts, if the points are predicted no worse by that.

    Raises
    ------
    ModelRefused
        The points don't determine the terms: too few, too near each other, or too many unknowns.
    BadRequest
        An unknown term.
    """
    best = _fitted(m, terms, highest_harmonic)
    if join_segments and len(np.unique(m.segment)) > 1:
        best = _joined(best, terms, highest_harmonic)
    result = _result(best)
    if isinstance(terms, str):
        while too_much := _untold(best, result, max_sigma_arcsec):
            name, why = too_much
            kept = [one for one in result.geometry_terms if one != name]
            less = _fitted(best.visits.looks, kept, highest_harmonic)
            notes = (*best.notes, f"{name} not taken: {why.what}")
            best = replace(less, names=best.names, steps=best.steps, notes=notes)
            result = _result(best)
    elif too_much := _untold(best, result, max_sigma_arcsec):
        raise too_much[1]
    return result


def _untold(best: _Fitted, result: Fit, max_sigma_arcsec: float) -> tuple[str, ModelRefused] | None:
    """The first term that the points don't determine, and what to say of it."""
    for k, name in enumerate(result.terms[2:], start=2):
        if best.fit.linear.independence[best.fit.geometry[k - 2]] < _LEAST_INDEPENDENCE:
            return name, ModelRefused(
                f"the points can't distinguish {name} from the other terms "
                f"(condition {result.condition:.0f})",
                advice=f"leave out {name}, or take points over a wider range of both axes and on both sides",
            )
        if not result.sigma_arcsec[k] <= max_sigma_arcsec:
            return name, ModelRefused(
                f"{name} = {result.coefficients_arcsec[k]:.0f}″ ± {result.sigma_arcsec[k]:.0f}″: "
                f"too uncertain, at most ± {max_sigma_arcsec:.0f}″ are",
                advice=f"leave out {name}, or take more points over a wider range of both axes",
            )
    return None


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    visits: Visits
    fit: RobustFit
    steps: tuple[SelectionStep, ...]
    notes: tuple[str, ...]
    names: dict[int, tuple[str, ...]]

    @property
    def points(self) -> Mechanical:
        return self.visits.points


def _fitted(m: Mechanical, terms: Sequence[str] | Literal["auto"], highest_harmonic: int) -> _Fitted:
    names: dict[int, tuple[str, ...]] = {index: (key,) for index, key in enumerate(m.segment_ids)}
    if isinstance(terms, str):
        made = _visits(m, CORE[m.kind])
        chosen = select(made.points, highest_harmonic=highest_harmonic)
        notes = tuple(f"{name} not taken: {why}" for name, why in chosen.refused)
        return _Fitted(made, chosen.fit, chosen.steps, notes, names)
    for name in terms:
        term(m.kind, name)
    geometry = tuple(dict.fromkeys(name for name in terms if name not in ZERO_POINTS[m.kind]))
    made = _visits(m, geometry)
    plays = plays_told(made.points, geometry)
    return _Fitted(made, robust_fit(made.points, (*plays, *geometry)), (), (), names)


def _visits(m: Mechanical, names: tuple[str, ...]) -> Visits:
    """Gather the looks; how they scatter within a visit is told by what a first fit leaves."""
    made = visits(m)
    if len(np.unique(made.of)) == len(m) and len(np.unique(_whose(m), axis=0)) == len(m):
        return made
    try:
        first = robust_fit(made.points, names).state
    except ModelRefused:
        first, names = first_state(made.points, ()), ()
    return visits(m, state_at(m, names, first.coefficients_arcsec, first.zero_points_arcsec).residuals_arcsec)


def _whose(m: Mechanical) -> Array:
    return np.stack([m.segment, m.targets], axis=1).astype(np.float64)


def _joined(before: _Fitted, terms: Sequence[str] | Literal["auto"], highest_harmonic: int) -> _Fitted:
    """Take together neighbors in time whose zero points agree; what was fitted before, if that is worse.

    Only where more neighbors agree than not: of forty syncs some agree by chance, and are syncs all the same.
    """
    m, linear = before.points, before.fit.linear
    zero_points = ZeroPoints.of(
        Segments(m.segment, len(m.segment_ids)), before.fit.state.cos_lat, before.fit.weight
    )
    unit = linear.unit_covariance * variance_factor(before.fit)
    factor = variance_factor(before.fit)
    known = [s for s in range(len(m.segment_ids)) if zero_points.lat_sum[s] > 0.0]
    group = {s: {s} for s in known}
    agreed = 0
    for a, b in pairwise(known):
        off = before.fit.state.zero_points_arcsec[a] - before.fit.state.zero_points_arcsec[b]
        way = linear.zero_points_of_terms[a] - linear.zero_points_of_terms[b]
        sums = np.stack([zero_points.lon_sum, zero_points.lat_sum], axis=1)
        covariance = factor * np.diag(1.0 / sums[a] + 1.0 / sums[b]) + way @ unit @ way.T
        if float(off @ np.linalg.solve(covariance, off)) < _JOINED_WITHIN:
            agreed += 1
            group[b] = group[a] = group[a] | group[b]
            for s in group[a]:
                group[s] = group[a]
    parts = sorted({min(members): tuple(sorted(members)) for members in group.values()}.values())
    if len(parts) == len(known) or agreed <= (len(known) - 1) // 2:
        return before
    number = np.zeros(len(m.segment_ids), dtype=np.int64)
    for index, members in enumerate(parts):
        number[list(members)] = index
    lost = [s for s in range(len(m.segment_ids)) if s not in group]
    for index, s in enumerate(lost, start=len(parts)):
        number[s] = index
    names = {index: tuple(m.segment_ids[s] for s in members) for index, members in enumerate(parts)}
    names |= {index: (m.segment_ids[s],) for index, s in enumerate(lost, start=len(parts))}
    looks = before.visits.looks
    joined = replace(
        looks, segment=number[looks.segment], segment_ids=tuple(names[index][-1] for index in sorted(names))
    )
    after = _fitted(joined, terms, highest_harmonic)
    worse = _loss_of_looks(after, before) > 1.01 or np.sum(_used(after)) < np.sum(_used(before))
    return before if worse else replace(after, names=names)


def _used(one: _Fitted) -> Bools:
    return one.visits.told(one.fit.used)


def _loss_of_looks(one: _Fitted, other: _Fitted) -> float:
    """How much worse one fit predicts the looks that both count and predict, as a ratio of mean squares."""
    first, second = (loo_residuals(each.points, each.fit)[each.visits.of] for each in (one, other))
    both = _used(one) & _used(other) & np.isfinite(first[:, 0]) & np.isfinite(second[:, 0])
    if not np.any(both):
        return float("inf")
    return float(np.sum(first[both] ** 2) / max(float(np.sum(second[both] ** 2)), 1e-12))


def _result(best: _Fitted) -> Fit:
    points, looks, fitted, linear = best.points, best.visits.looks, best.fit, best.fit.linear
    zero_points = ZeroPoints.of(
        Segments(points.segment, len(points.segment_ids)), fitted.state.cos_lat, fitted.weight
    )
    factor = variance_factor(fitted)
    sign = np.array([-1.0, 1.0]) if points.kind == "altaz" else np.ones(2)
    whole = covariance_of(points, fitted)
    used = _used(best)
    at = fitted.geometry
    segments: list[SegmentZero] = []
    last: tuple[Array, Array, Array] | None = None
    for s in range(len(points.segment_ids)):
        mine = fitted.used & (points.segment == s)
        if not np.any(mine):
            segments.append(SegmentZero(best.names[s], 0, None, None, None, None))
            continue
        way = linear.zero_points_of_terms[s]
        own = factor * np.array([1.0 / zero_points.lon_sum[s], 1.0 / zero_points.lat_sum[s]])
        both = sign[:, None] * (np.diag(own) + way @ whole @ way.T) * sign
        mixed = (-sign[:, None] * (way @ whole))[:, at]
        value = sign * fitted.state.zero_points_arcsec[s]
        sigma = np.sqrt(np.diag(both))
        count = int(np.sum(used & (looks.segment == s)))
        segments.append(SegmentZero(best.names[s], count, *(float(one) for one in (*value, *sigma))))
        last = value, both, mixed
    assert last is not None
    value, both, mixed = last
    names = tuple(fitted.names[k] for k in at)
    coefficients = fitted.state.coefficients_arcsec[at]
    # of looks, and without the plays: as the model predicts them
    residuals = state_at(looks, names, coefficients, fitted.state.zero_points_arcsec).residuals_arcsec
    told = sum(1 for one in segments if one.points)
    zero_only = robust_fit(looks, (), fixed=used).state.residuals_arcsec
    covariance = np.block([[both, mixed], [mixed.T, whole[np.ix_(at, at)]]])
    out = loo_residuals(points, fitted)
    known = fitted.used & np.isfinite(out[:, 0])
    hat = 0.5 * (linear.hat[0] + linear.hat[1])
    # a visit left out is off by its own scatter and by that of those which predict it
    single = np.sum(out[known] ** 2 * (1.0 - hat[known])[:, None], axis=1)
    notes = list(best.notes)
    notes += _hard_to_part((*ZERO_POINTS[points.kind], *names), covariance)
    notes += [
        f"{fitted.names[k]}: {abs(fitted.state.coefficients_arcsec[k]):.0f}″ ± {np.sqrt(whole[k, k]):.0f}″, "
        "allowed for and no part of the model"
        for k in range(len(fitted.names))
        if k not in at and abs(fitted.state.coefficients_arcsec[k]) > 3.0 * np.sqrt(whole[k, k])
    ]
    rejected = len(looks) - int(np.sum(used))
    if rejected > 0.2 * len(looks):
        notes.append(f"{rejected} of {len(looks)} points are left out as gross errors: look at them")
    if np.sum(known) < 0.8 * np.sum(fitted.used):
        notes.append(
            f"only {int(np.sum(known))} of {int(np.sum(fitted.used))} visits can be predicted from the others"
        )
    return Fit(
        observations=looks,
        terms=(*ZERO_POINTS[points.kind], *names),
        coefficients_arcsec=np.concatenate([value, coefficients]),
        sigma_arcsec=np.sqrt(np.diag(covariance)),
        covariance_arcsec2=covariance,
        condition=linear.condition,
        residuals_arcsec=residuals,
        used=used,
        points=points,
        counted=fitted.used,
        after=quality(residuals[used], len(names) + 2 * told),
        before=quality(zero_only[used], 2 * told),
        left_out_arcsec=out,
        loo_arcsec=loo_rms(out, fitted.used),
        scatter_arcsec=float(np.sqrt(0.5 * np.mean(single))) if len(single) else float(np.sqrt(factor)),
        segments=tuple(segments),
        steps=best.steps,
        notes=tuple(notes),
    )


def _hard_to_part(names: tuple[str, ...], covariance: Array) -> list[str]:
    """Tell the pairs of terms of which only the sum is well known."""
    root = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = covariance / np.outer(root, root)
    return [
        f"{names[i]} (± {root[i]:.0f}″) and {names[k]} (± {root[k]:.0f}″) can hardly be told apart here "
        f"(correlation {correlation[i, k]:+.2f}): together they are known much better"
        for k in range(2, len(names))
        for i in range(k)
        if abs(correlation[i, k]) > _HARD_TO_PART
    ]
