"""Fitting a pointing model: coefficients with their errors, what it leaves, and what was there without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from mountnav.errors import ModelRefused
from mountnav.pointing.model.linear import Segments, ZeroPoints
from mountnav.pointing.model.mechanical import Bools, Mechanical
from mountnav.pointing.model.robust import RobustFit, robust_fit
from mountnav.pointing.model.selection import SelectionStep, loo_rms, select
from mountnav.pointing.model.terms import HIGHEST_HARMONIC, ZERO_POINTS, Array, term

MAX_SIGMA_ARCSEC = 300.0
"""A coefficient less certain than this predicts nothing."""
_LEAST_INDEPENDENCE = 0.01
_JOINED_WITHIN = 9.21
"""χ² of two zero points: segments that differ by more have only a chance of 1 % to be the same."""


@dataclass(frozen=True, slots=True)
class Quality:
    """Distances on the sky between seen and predicted, of the points that count.

    Attributes
    ----------
    sky_rms_arcsec : float
        sqrt(Σ(ξ²+η²)/(n-k)), k the number of all unknowns, zero points of all segments included: PMFIT's and
        TPOINT's definition.
    population_rms_arcsec : float
        sqrt(Σ(ξ²+η²)/n): smaller, and what many programs tell.
    percent_90_arcsec, max_arcsec : float
    """

    sky_rms_arcsec: float
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
        The zero points are those of the last segment. The sigmas are per coordinate: sqrt of
        Σ(ξ²+η²)/(2n-k); PMFIT prints them √2 larger.
    covariance_arcsec2 : ndarray, shape (k, k)
    condition : float
        Of the scaled columns.
    residuals_arcsec : ndarray, shape (n, 2)
        Seen less predicted along ξ and η of the axes.
    used : ndarray of bool, shape (n,)
    after, before : Quality
        With the model, and with zero points alone.
    loo_arcsec : float
        RMS distance of points predicted from the others.
    scatter_arcsec : float
        Per coordinate, of points that were predicted from the others: what the model's sigma doesn't hold.
    segments : tuple of SegmentZero
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
    after: Quality
    before: Quality
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
        float(np.sqrt(total / (n - unknowns))) if n > unknowns else float("nan"),
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
    m : Mechanical
    terms : sequence of str or "auto"
        TPOINT names, zero points as you like; "auto" chooses (`selection.select`).
    highest_harmonic : int
        Of an automatic choice.
    max_sigma_arcsec : float
        A coefficient that is less certain is refused, whatever the number of points.
    join_segments : bool
        Take segments together whose zero points agree within their errors, as those before and after a flip
        do on most mounts, if the points are predicted no worse by that.

    Returns
    -------
    Fit

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
    for k, name in enumerate(result.terms[2:], start=2):
        if best.fit.linear.independence[k - 2] < _LEAST_INDEPENDENCE:
            raise ModelRefused(
                f"the points can't tell {name} from the other terms (condition {result.condition:.0f})",
                advice=f"leave out {name}, or take points over a wider range of both axes and on both sides",
            )
        if not result.sigma_arcsec[k] <= max_sigma_arcsec:
            raise ModelRefused(
                f"{name} = {result.coefficients_arcsec[k]:.0f}″ ± {result.sigma_arcsec[k]:.0f}″: "
                f"too uncertain, at most ± {max_sigma_arcsec:.0f}″ are",
                advice=f"leave out {name}, or take more points over a wider range of both axes",
            )
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    m: Mechanical
    fit: RobustFit
    steps: tuple[SelectionStep, ...]
    notes: tuple[str, ...]
    names: dict[int, tuple[str, ...]]

    @property
    def loo_arcsec(self) -> float:
        return loo_rms(self.fit.linear.left_out(), self.fit.used)


def _fitted(m: Mechanical, terms: Sequence[str] | Literal["auto"], highest_harmonic: int) -> _Fitted:
    names: dict[int, tuple[str, ...]] = {index: (key,) for index, key in enumerate(m.segment_ids)}
    if isinstance(terms, str):
        chosen = select(m, highest_harmonic=highest_harmonic)
        notes = tuple(f"{name} not taken: {why}" for name, why in chosen.refused)
        return _Fitted(m, chosen.fit, chosen.steps, notes, names)
    for name in terms:
        term(m.kind, name)
    geometry = tuple(dict.fromkeys(name for name in terms if name not in ZERO_POINTS[m.kind]))
    return _Fitted(m, robust_fit(m, geometry), (), (), names)


def _joined(before: _Fitted, terms: Sequence[str] | Literal["auto"], highest_harmonic: int) -> _Fitted:
    """Take together neighbors in time whose zero points agree; what was fitted before, if that is worse."""
    m, linear = before.m, before.fit.linear
    zero_points = ZeroPoints.of(
        Segments(m.segment, len(m.segment_ids)), before.fit.state.cos_lat, before.fit.weight
    )
    factor = _variance_factor(before.fit)
    known = [s for s in range(len(m.segment_ids)) if zero_points.lat_sum[s] > 0.0]
    group = {s: {s} for s in known}
    for a, b in pairwise(known):
        off = before.fit.state.zero_points_arcsec[a] - before.fit.state.zero_points_arcsec[b]
        way = linear.zero_points_of_terms[a] - linear.zero_points_of_terms[b]
        sums = np.stack([zero_points.lon_sum, zero_points.lat_sum], axis=1)
        covariance = factor * (np.diag(1.0 / sums[a] + 1.0 / sums[b]) + way @ linear.unit_covariance @ way.T)
        if float(off @ np.linalg.solve(covariance, off)) < _JOINED_WITHIN:
            group[b] = group[a] = group[a] | group[b]
            for s in group[a]:
                group[s] = group[a]
    parts = sorted({min(members): tuple(sorted(members)) for members in group.values()}.values())
    if len(parts) == len(known):
        return before
    number = np.zeros(len(m.segment_ids), dtype=np.int64)
    for index, members in enumerate(parts):
        number[list(members)] = index
    lost = [s for s in range(len(m.segment_ids)) if s not in group]
    for index, s in enumerate(lost, start=len(parts)):
        number[s] = index
    names = {index: tuple(m.segment_ids[s] for s in members) for index, members in enumerate(parts)}
    names |= {index: (m.segment_ids[s],) for index, s in enumerate(lost, start=len(parts))}
    joined = replace(
        m, segment=number[m.segment], segment_ids=tuple(names[index][-1] for index in sorted(names))
    )
    after = _fitted(joined, terms, highest_harmonic)
    same = before.fit.used & after.fit.used
    was, now = loo_rms(before.fit.linear.left_out(), same), loo_rms(after.fit.linear.left_out(), same)
    worse = now > 1.005 * was or np.sum(after.fit.used) < np.sum(before.fit.used)
    return before if worse else replace(after, names=names)


def _variance_factor(fitted: RobustFit) -> float:
    """What the inverse variances have to be divided by to fit the residuals."""
    used = fitted.used
    squared = np.sum(fitted.state.residuals_arcsec[used] ** 2, axis=1)
    freedom = 2.0 * np.sum(used) - np.sum((fitted.linear.hat[0] + fitted.linear.hat[1])[used])
    return float(np.sum(fitted.weight[used] * squared) / max(freedom, 1.0))


def _result(best: _Fitted) -> Fit:
    m, fitted, linear = best.m, best.fit, best.fit.linear
    zero_points = ZeroPoints.of(Segments(m.segment, len(m.segment_ids)), fitted.state.cos_lat, fitted.weight)
    factor = _variance_factor(fitted)
    sign = np.array([-1.0, 1.0]) if m.kind == "altaz" else np.ones(2)
    geometry = factor * linear.unit_covariance
    segments: list[SegmentZero] = []
    last: tuple[Array, Array, Array] | None = None
    for s in range(len(m.segment_ids)):
        points = int(np.sum(fitted.used & (m.segment == s)))
        if not points:
            segments.append(SegmentZero(best.names[s], 0, None, None, None, None))
            continue
        way = linear.zero_points_of_terms[s]
        own = factor * np.array([1.0 / zero_points.lon_sum[s], 1.0 / zero_points.lat_sum[s]])
        both = sign[:, None] * (np.diag(own) + way @ geometry @ way.T) * sign
        mixed = -sign[:, None] * (way @ geometry)
        value = sign * fitted.state.zero_points_arcsec[s]
        sigma = np.sqrt(np.diag(both))
        segments.append(SegmentZero(best.names[s], points, *(float(one) for one in (*value, *sigma))))
        last = value, both, mixed
    assert last is not None
    value, both, mixed = last
    used, residuals = fitted.used, fitted.state.residuals_arcsec
    told = sum(1 for one in segments if one.points)
    zero_only = robust_fit(m, (), fixed=used).state.residuals_arcsec
    covariance = np.block([[both, mixed], [mixed.T, geometry]])
    out = linear.left_out()[used]
    out = out[np.isfinite(out[:, 0])]
    notes = list(best.notes)
    rejected = len(m) - int(np.sum(used))
    if rejected > 0.2 * len(m):
        notes.append(f"{rejected} of {len(m)} points are left out as gross errors: look at them")
    if len(out) < 0.8 * np.sum(used):
        notes.append(f"only {len(out)} of {int(np.sum(used))} points can be predicted from the others")
    return Fit(
        observations=m,
        terms=(*ZERO_POINTS[m.kind], *fitted.names),
        coefficients_arcsec=np.concatenate([value, fitted.state.coefficients_arcsec]),
        sigma_arcsec=np.sqrt(np.diag(covariance)),
        covariance_arcsec2=covariance,
        condition=linear.condition,
        residuals_arcsec=residuals,
        used=used,
        after=quality(residuals[used], len(fitted.names) + 2 * told),
        before=quality(zero_only[used], 2 * told),
        loo_arcsec=best.loo_arcsec,
        scatter_arcsec=float(np.sqrt(np.mean(out**2))) if len(out) else float(np.sqrt(factor)),
        segments=tuple(segments),
        steps=best.steps,
        notes=tuple(notes),
    )
