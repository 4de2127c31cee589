"""Making a model and judging it: it replaces the old one only if it predicts unseen targets better.

Making: the model is fitted to all looks, and judged by targets that had no part in fits made the same way.
One target in five is left out in turn, with all its looks on both sides of a sync, and terms are selected
again without it: what is judged is the procedure that leads to the model, not only its coefficients.

Judging: otherwise the old model stays, and the message says why [POINTING §7]. Better is not enough where
chance would do: of the targets that both predict, the new model has to be nearer to more of them, and by
more, than chance brings once in twenty times.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mountnav.errors import BadRequest, ModelRefused
from mountnav.pointing.model.fit import MAX_SIGMA_ARCSEC, Fit, fit
from mountnav.pointing.model.leave_one_out import bounded_losses, loo_of_geometry, loo_rms, zeroed
from mountnav.pointing.model.mechanical import Bools, Mechanical
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.model.planning import HELD_OUT
from mountnav.pointing.model.robust import TUKEY, scale_of, state_at
from mountnav.pointing.model.terms import HIGHEST_HARMONIC, Array, basis
from mountnav.pointing.model.visits import visits

# Two-sided probability of a normal deviate beyond 3 σ.
CHANCE_OF_3_SIGMA = 0.0027
# Fewer fresh points than this can't check a model. Chosen by hand.
LEAST_FRESH = 3
CHANCE_OF_BETTER = 0.05
"""Once in so many times a model that is no better may look better."""
_LEAST_PAIRS = 6
"""With fewer targets no outcome is rarer than that."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Visits that had no part in the fits that predict them; see `making`.

    Attributes
    ----------
    new, old : ndarray, shape (p, 2)
        Residuals, arcsec; NaN where nothing predicts them.
    """

    new: Array
    old: Array


@dataclass(frozen=True, slots=True)
class Judgement:
    """Whether a model is accepted, in words and numbers.

    Attributes
    ----------
    reasons : tuple of str
        What spoke against it; what spoke for it if nothing did.
    new_loo_arcsec, old_loo_arcsec : float
        Leave-one-out RMS (`left_out`), the new one that of the fit; the old model's geometry is as it is.
    new_held_out_arcsec, old_held_out_arcsec : float or None
        RMS of visits of targets that had no part in fits with terms chosen again.
    held_out : int
        How many of these could be predicted.
    better_chance : float
        Chance that a model which is no better looks as much better.
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
    better_chance: float = 1.0
    fresh_chance: float | None = None


def predicted(
    known: Mechanical, used: Bools, asked: Mechanical, coefficients_arcsec: Mapping[str, float]
) -> Array:
    """Residuals of a geometry whose zero points are told by `known`.

    Parameters
    ----------
    known : Mechanical
        Tells the zero points of each segment; one point a visit.
    used : ndarray of bool
        Which of them count.
    asked : Mechanical
        What is predicted.
    coefficients_arcsec : mapping
        Geometry terms.

    Returns
    -------
    ndarray, shape (n, 2)
        Arcsec; NaN where no point tells the zero points.
    """
    state = zeroed(known, used, coefficients_arcsec)[0]
    told = {key for s, key in enumerate(known.segment_ids) if np.any(used & (known.segment == s))}
    zero = np.full((len(asked.segment_ids), 2), np.nan)
    for s, key in enumerate(asked.segment_ids):
        if key in told:
            zero[s] = state.zero_points_arcsec[known.segment_ids.index(key)]
    return state_at(
        asked, tuple(coefficients_arcsec), np.array(list(coefficients_arcsec.values())), zero
    ).residuals_arcsec


def held_out_by(fitted: Fit, looks: Mechanical, old: PointingModel | None) -> HeldOut:
    """Predict looks that had no part in a fit, by it and by what was there; one point a visit."""
    points = visits(_renamed(looks, fitted)).points
    new, before = (
        predicted(fitted.points, fitted.counted, points, one) for one in (_geometry(fitted), _before(old))
    )
    return HeldOut(new, before)


def _geometry(fitted: Fit) -> dict[str, float]:
    return dict(zip(fitted.geometry_terms, fitted.coefficients_arcsec[2:].tolist(), strict=True))


def _before(old: PointingModel | None) -> dict[str, float]:
    return {} if old is None else {name: old.coefficients[name] for name in old.geometry_terms}


def judge(
    fitted: Fit,
    *,
    old: PointingModel | None = None,
    held_out: Mechanical | HeldOut | None = None,
    fresh: Mechanical | None = None,
) -> Judgement:
    """Judge a new model against the old one, or against zero points alone if there is none.

    Parameters
    ----------
    old : PointingModel, optional
        None: there is none yet.
    held_out : Mechanical or HeldOut, optional
        Looks of the same segments that had no part in the fit; or what fits without them made of them.
    fresh : Mechanical, optional
        3 to 5 points taken since; in a segment of the fit, or one of their own.

    Raises
    ------
    BadRequest
        Fewer than three fresh points, or the old model is of another kind of mount.
    """
    m = fitted.observations
    check_old(old, m)
    called = "the zero points alone" if old is None else "the old model"
    against: list[str] = []
    pairs = HeldOut(fitted.left_out_arcsec, loo_of_geometry(fitted.points, fitted.counted, _before(old)))
    pairs = HeldOut(pairs.new[fitted.counted], pairs.old[fitted.counted])
    old_loo = loo_rms(pairs.old, np.ones(len(pairs.old), dtype=np.bool_))
    if not fitted.loo_arcsec < old_loo:
        against.append(
            f"targets left out in turn are predicted to {fitted.loo_arcsec:.1f}″, "
            f"by {called} to {old_loo:.1f}″"
        )
    new_out = old_out = chance = None
    counted = 0
    if held_out is not None:
        out = held_out_by(fitted, held_out, old) if isinstance(held_out, Mechanical) else held_out
        new_out, old_out, counted = _compared(out.new, out.old)
        if counted and not new_out < old_out:
            against.append(f"{counted} held-out visits are {new_out:.1f}″ off, with {called} {old_out:.1f}″")
        if counted >= _LEAST_PAIRS:
            pairs = out
    by_chance = chance_of_better(pairs)
    if not against and not by_chance < CHANCE_OF_BETTER:
        against.append(f"it is no better than {called} beyond chance ({by_chance:.0%})")
    if fresh is not None:
        if len(fresh) < LEAST_FRESH:
            raise BadRequest(
                f"{len(fresh)} fresh points are too few for a check", advice="take 3 to 5 of them"
            )
        chance = _chance(fitted, _renamed(fresh, fitted))
        if chance < CHANCE_OF_3_SIGMA:
            against.append(
                f"{len(fresh)} fresh points miss the model by more than 3 σ (chance {chance:.1g}): "
                "did something move since, or is it fitted too closely?"
            )
    said = [f"targets left out in turn are predicted to {fitted.loo_arcsec:.1f}″, before to {old_loo:.1f}″"]
    if counted:
        said.append(f"{counted} held-out visits are {new_out:.1f}″ off, before {old_out:.1f}″")
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
        by_chance,
        chance,
    )


def check_old(old: PointingModel | None, m: Mechanical) -> None:
    """Refuse an old model of another kind of mount. Raises `BadRequest`."""
    if old is not None and old.kind != m.kind:
        raise BadRequest(f"the old model is {old.kind}, the new one {m.kind}")


def chance_of_better(pairs: HeldOut) -> float:
    """Chance that a model which is no better comes as much nearer to as many targets; 1 if too few tell.

    By the ranks of the differences [Wilcoxon 1945]: one gross error doesn't decide.
    """
    # a second of CPU, and all of a service's start would pay it for fits alone
    from scipy.stats import wilcoxon

    known = np.isfinite(pairs.new[:, 0]) & np.isfinite(pairs.old[:, 0])
    nearer = np.minimum(np.hypot(*pairs.new[known].T), np.hypot(*pairs.old[known].T))
    if nearer.size < _LEAST_PAIRS - 1:
        return 1.0
    new, old = bounded_losses(pairs.new, pairs.old, scale_of(nearer, np.ones_like(nearer)))
    differences = np.sqrt(old) - np.sqrt(new)
    if not np.any(differences):
        return 1.0
    return float(wilcoxon(differences, alternative="greater").pvalue)


def _renamed(points: Mechanical, fitted: Fit) -> Mechanical:
    """The same points in the segments as the fit joined them."""
    ids = fitted.observations.segment_ids
    into = {key: ids[s] for s, one in enumerate(fitted.segments) for key in one.segment_ids}
    names = [into.get(key, key) for key in points.segment_ids]
    unique = tuple(dict.fromkeys(names))
    number = np.array([unique.index(name) for name in names], dtype=np.int64)
    return replace(points, segment=number[points.segment], segment_ids=unique)


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


def _chance(fitted: Fit, fresh: Mechanical) -> float:
    """Probability that a true model misses fresh points by as much."""
    from scipy.special import chdtrc  # 0.2 s that a service does not need to start

    m, coefficients = fitted.observations, _geometry(fitted)
    residuals = predicted(fitted.points, fitted.counted, fresh, coefficients)
    freedom = 2 * len(fresh)
    alone = ~np.isfinite(residuals[:, 0])
    if np.any(alone):
        # a segment of their own: two degrees of freedom go into its zero points
        own = fresh.chosen(alone)
        residuals[alone] = zeroed(own, np.ones(len(own), dtype=np.bool_), coefficients)[0].residuals_arcsec
        freedom -= 2 * len(np.unique(own.segment))
    if freedom <= 0:
        raise BadRequest("the fresh points are in too many segments to check anything")
    columns = basis(m.kind, fitted.terms, fresh.read_lon_rad, fresh.read_lat_rad, fresh.site_latitude_rad)
    model = np.einsum("nck,kl,ncl->nc", columns, fitted.covariance_arcsec2, columns)
    variance = model + (fitted.scatter_arcsec**2 + fresh.sigma_arcsec**2)[:, None]
    return float(chdtrc(freedom, np.sum(residuals**2 / variance)))


# Fewest visits that a model is made from, if nothing else is asked for. Chosen by hand: 16 numbers, for two
# zero points and the four core terms.
MIN_POINTS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A model, and whether it may be used.

    Attributes
    ----------
    fit : Fit
        Of all looks.
    judged : Judgement
        Of it, and of fits made the same way by targets that they had not seen.
    """

    fit: Fit
    judged: Judgement


def make(
    m: Mechanical,
    *,
    terms: Sequence[str] | Literal["auto"] = "auto",
    highest_harmonic: int = HIGHEST_HARMONIC,
    max_sigma_arcsec: float = MAX_SIGMA_ARCSEC,
    min_points: int = MIN_POINTS,
    old: PointingModel | None = None,
    held_out: Mechanical | None = None,
    fresh: Mechanical | None = None,
    seed: int = 0,
) -> Made:
    """Make a model of observations and judge it.

    Parameters
    ----------
    terms, highest_harmonic, max_sigma_arcsec
        See `fit.fit`.
    min_points : int
        Fewer make no model.
    old : PointingModel, optional
        That it has to be better than.
    held_out : Mechanical, optional
        Looks to judge by, set apart when they were taken; if there are none, the targets of `m` in turn.
    fresh : Mechanical, optional
        Taken since; fewer than three are left out of account.
    seed : int
        Of the parts that are held out in turn.

    Raises
    ------
    ModelRefused
        Too few points, or they don't determine the terms.
    """
    if len(m) < min_points:
        raise ModelRefused(
            f"{len(m)} points are too few for a model", advice=f"at least {min_points}: take more looks"
        )
    check_old(old, m)

    def fitted(looks: Mechanical, names: Sequence[str] | Literal["auto"]) -> Fit:
        return fit(looks, names, highest_harmonic=highest_harmonic, max_sigma_arcsec=max_sigma_arcsec)

    enough = fresh if fresh is not None and len(fresh) >= LEAST_FRESH else None
    if held_out is not None and len(held_out):
        first = fitted(m, terms)
        final = fitted(together(m, held_out), first.geometry_terms)
        return Made(final, judge(final, old=old, held_out=held_out_by(first, held_out, old), fresh=enough))
    final = fitted(m, terms)
    out = held_out_in_turn(m, lambda looks: fitted(looks, terms), old, min_points=min_points, seed=seed)
    return Made(final, judge(final, old=old, held_out=out, fresh=enough))


def held_out_in_turn(
    m: Mechanical,
    fitted: Callable[[Mechanical], Fit],
    old: PointingModel | None,
    *,
    min_points: int = MIN_POINTS,
    seed: int = 0,
) -> HeldOut | None:
    """Predict each target by a fit that it had no part in; None if too few looks would be left for the fits.

    Parameters
    ----------
    fitted : callable
        Makes the fit of a part of the looks; where it refuses, what was there predicts.
    old : PointingModel or None
        None: there is none yet.
    min_points : int
        Of a fit.
    seed : int
        Of the parts.
    """
    targets = np.unique(m.targets)
    parts = round(1.0 / HELD_OUT)
    part_of = np.random.default_rng(seed).permutation(len(targets)) % parts
    part = part_of[np.searchsorted(targets, m.targets)]
    counts = np.bincount(part, minlength=parts)
    if len(m) - int(np.max(counts)) < min_points:
        return None
    found: list[HeldOut] = []
    for one in range(parts):
        known, asked = m.chosen(part != one), m.chosen(part == one)
        if not len(asked):
            continue
        try:
            found.append(held_out_by(fitted(known), asked, old))
        except ModelRefused:
            continue
    if not found:
        return None
    return HeldOut(np.concatenate([one.new for one in found]), np.concatenate([one.old for one in found]))


def together(one: Mechanical, other: Mechanical) -> Mechanical:
    """Both observations of one telescope, segments of the same name as one."""
    ids = tuple(dict.fromkeys((*one.segment_ids, *other.segment_ids)))
    number = np.array([ids.index(key) for key in other.segment_ids], dtype=np.int64)
    first = np.array([ids.index(key) for key in one.segment_ids], dtype=np.int64)
    after = other.targets + (int(np.max(one.targets)) + 1 if len(one) else 0)
    return replace(
        one,
        seen=np.concatenate([one.seen, other.seen]),
        beyond=np.concatenate([one.beyond, other.beyond]),
        read_lon_rad=np.concatenate([one.read_lon_rad, other.read_lon_rad]),
        read_lat_rad=np.concatenate([one.read_lat_rad, other.read_lat_rad]),
        sigma_arcsec=np.concatenate([one.sigma_arcsec, other.sigma_arcsec]),
        segment=np.concatenate([first[one.segment], number[other.segment]]),
        segment_ids=ids,
        target=np.concatenate([one.targets, after]),
        sense=np.concatenate([one.senses, other.senses]),
    )
