"""Choosing terms: greedy, by what leaving out each point in turn says about predicting it.

It begins with the terms that every telescope has (polar axis, collimation, non-perpendicularity, flexure),
all of them if the points tell them: they overlap, so that one left out because it is small would stand in the
others, and their sigmas wouldn't know. A further term is added when it lowers the leave-one-out RMS most, by
1.5 % at least, when its coefficient stands out of its own error by more than the best of so many trials would
by chance, and when the points can tell it from the terms before it. All candidates are tried at once: a new
column, freed from those before it, changes residuals and hat matrix by an outer product, so nothing is
refitted to try it [POINTING §6].

A point is a visit of a target, not a look: looks at one target would predict each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mountnav.errors import ModelRefused
from mountnav.pointing.model.leave_one_out import (
    bounded_losses,
    covariance_of,
    loo_arcsec,
    loo_residuals,
    loo_rms,
)
from mountnav.pointing.model.linear import LinearFit, Segments, ZeroPoints, solve
from mountnav.pointing.model.mechanical import Bools, Mechanical
from mountnav.pointing.model.robust import PLAY, RobustFit, plays_told, robust_fit, state_at
from mountnav.pointing.model.terms import (
    CORE,
    HIGHEST_HARMONIC,
    NON_PERPENDICULARITY,
    Array,
    basis,
    candidates,
)
from mountnav.units import RAD_PER_ARCSEC

# Share by which a term must lower the leave-one-out RMS to be taken (1.5 %). Chosen by hand. Doubled,
# weaker terms stay out.
MIN_GAIN = 0.015
CHANCE_OF_NOISE = 0.01
"""Chance that noise brings a further term."""
MIN_INDEPENDENCE = 0.05
"""Share of a column that other terms don't explain; below, its sigma is 20 times what it could be."""
WELL_TOLD = 0.3
"""Share of a column from which on its term, if it is nothing, may be left out without harm to the others."""
MOST_SHARED = 0.5
"""Correlation with another coefficient up to which a term that is nothing may be left out: with more of it
the other one's sigma would shrink though nothing more is known."""
LEAST_SKEW = 0.01
"""The same of the non-perpendicularity, which overlaps with collimation and zero point: taken, its sigma and
that of the collimation say so; left out, the collimation would stand for both with the sigma of one."""
FULL_SET_COSTS = 1.15
"""Mean square that is taken for having all terms that every telescope has: 7 % in the RMS."""
# Most terms of a selection, zero points apart. Chosen by hand, well above the 15 that measured mounts
# needed.
MOST_TERMS = 30


@dataclass(frozen=True, slots=True)
class SelectionStep:
    """One term more, or one less.

    Attributes
    ----------
    loo_arcsec : float
        Leave-one-out RMS afterwards.
    """

    term: str
    added: bool
    loo_arcsec: float


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Chosen terms, and the way to them.

    Attributes
    ----------
    terms : tuple of str
        Without zero points.
    refused : tuple of (str, str)
        Terms of every telescope that were not taken, and why.
    fit : RobustFit
        Of the chosen terms.
    """

    terms: tuple[str, ...]
    steps: tuple[SelectionStep, ...]
    refused: tuple[tuple[str, str], ...]
    fit: RobustFit


@dataclass(slots=True, eq=False)
class _Trial:
    """What is common to all candidates at one stage."""

    m: Mechanical
    chosen: tuple[str, ...]
    linear: LinearFit
    used: Bools
    weight: Array
    zero_points: ZeroPoints
    columns: Array

    @property
    def loo_arcsec(self) -> float:
        return loo_rms(self.linear.left_out(), self.used)

    def predictable(self) -> int:
        return int(np.sum(np.isfinite(self.linear.left_out()[self.used, 0])))

    def with_each(self, more: Array) -> tuple[Array, Array, Array]:
        """Leave-one-out RMS, coefficient over sigma, and independence, for each of m further columns.

        Parameters
        ----------
        more : ndarray, shape (n, 2, m)
            The further columns.
        """
        n, _, m = more.shape
        root = np.sqrt(self.weight)[:, None, None]
        free = (root * self.zero_points.without(more)).reshape(2 * n, m)
        if self.chosen:
            inner = (root * self.zero_points.without(self.columns)).reshape(2 * n, -1)
            q = np.linalg.qr(inner)[0]
            free = free - q @ (q.T @ free)
            free = free - q @ (q.T @ free)
        length = np.sqrt(np.sum(free**2, axis=0))
        whole = np.sqrt(np.sum((root * more) ** 2, axis=(0, 1)))
        independence = np.divide(length, whole, out=np.zeros(m), where=whole > 0.0)
        unit = np.divide(free, length, out=np.zeros_like(free), where=length > 1e-9 * whole)
        left = (root * self.linear.residuals[:, :, None]).reshape(2 * n)
        amount = unit.T @ left
        weighted = (left[:, None] - unit * amount).reshape(n, 2, m)
        parts = unit.reshape(n, 2, m)
        residuals = np.divide(weighted, root, out=np.zeros_like(weighted), where=root > 0.0)[self.used]
        xi, eta = parts[self.used, 0], parts[self.used, 1]
        hat_xi, hat_eta, hat_mixed = (one[self.used, None] for one in self.linear.hat)
        a, b, c = 1.0 - hat_xi - xi**2, 1.0 - hat_eta - eta**2, hat_mixed + xi * eta
        determinant = a * b - c * c
        known = (determinant > 1e-6) & (a > 1e-6) & (b > 1e-6)
        safe = np.where(known, determinant, 1.0)
        out_xi = (b * residuals[:, 0] + c * residuals[:, 1]) / safe
        out_eta = (c * residuals[:, 0] + a * residuals[:, 1]) / safe
        count = np.sum(known, axis=0)
        total = np.sum(np.where(known, out_xi**2 + out_eta**2, 0.0), axis=0)
        loo = np.sqrt(np.divide(total, count, out=np.full(m, np.inf), where=count > 0))
        # a term that makes points unpredictable only hides them
        loo = np.where(count < self.predictable(), np.inf, loo)
        freedom = max(2 * int(np.sum(self.used)) - self.unknowns() - 1, 1)
        variance = np.maximum(np.sum(weighted**2, axis=(0, 1)) / freedom, 1e-30)
        return loo, np.abs(amount) / np.sqrt(variance), independence

    def unknowns(self) -> int:
        return len(self.chosen) + 2 * len(np.unique(self.m.segment[self.used]))


class _Search:
    """A selection under way: exact after each term, linear in between."""

    def __init__(self, m: Mechanical, start: RobustFit) -> None:
        self.m = m
        self.segments = Segments(m.segment, len(m.segment_ids))
        self.steps: list[SelectionStep] = []
        self.fit = start
        self.trial = self._look(start)
        loo = loo_arcsec(m, start)
        self.steps += [SelectionStep(name, True, loo) for name in start.names if name not in PLAY]

    def _look(self, fit: RobustFit) -> _Trial:
        zero_points = ZeroPoints.of(self.segments, fit.state.cos_lat, fit.weight)
        # the exact prediction is near enough for the linear step to be nearly 0
        linear = solve(fit.state.columns, fit.state.residuals_arcsec, zero_points)
        return _Trial(self.m, fit.names, linear, fit.used, fit.weight, zero_points, fit.state.columns)

    def fitted(self, names: tuple[str, ...]) -> RobustFit:
        """Fit on from what is known; terms that were not there begin at 0."""
        known = dict(zip(self.fit.names, self.fit.state.coefficients_arcsec.tolist(), strict=True))
        begun = np.array([known.get(name, 0.0) for name in names])
        start = state_at(self.m, names, begun, self.fit.state.zero_points_arcsec)
        return robust_fit(self.m, names, start=start, biweight_steps=1, plain_steps=2)

    def take(self, fit: RobustFit, term: str, added: bool) -> None:
        """Go over to this fit; which points count was judged again."""
        self.fit = fit
        self.trial = self._look(self.fit)
        self.steps.append(SelectionStep(term, added, loo_arcsec(self.m, fit)))

    def columns(self, names: Sequence[str]) -> Array:
        zero_points = self.fit.state.zero_points_arcsec[self.m.segment] * RAD_PER_ARCSEC
        lon, lat = self.m.read_lon_rad + zero_points[:, 0], self.m.read_lat_rad + zero_points[:, 1]
        return basis(self.m.kind, names, lon, lat, self.m.site_latitude_rad)

    def grow(self, names: Sequence[str], min_gain: float, most: int) -> None:
        """Add the best of these terms until none is worth it."""
        waiting = [name for name in names if name not in self.fit.names]
        while waiting and len(self.fit.names) < most:
            # so much the best of m coefficients of pure noise stands out
            least_signal = math.sqrt(2.0 * math.log(max(len(waiting), 2)))
            count = len(waiting)
            loo, signal, independence = self.trial.with_each(self.columns(waiting))
            loo = np.where((independence >= MIN_INDEPENDENCE) & (signal >= least_signal), loo, np.inf)
            best = int(np.argmin(loo))
            if not loo[best] < (1.0 - min_gain) * self.trial.loo_arcsec:
                return
            name = waiting.pop(best)
            fit = self.fitted((*self.fit.names, name))
            if self.stands_out(fit, count):
                self.take(fit, name, True)

    def stands_out(self, fit: RobustFit, count: int) -> bool:
        """Whether the last coefficient is beyond what the best of so many is by chance.

        Asked where targets are known: errors there are common to the visits of a target, and depend on where
        a slew came from, so that chance looks like geometry more often than it ought to.
        """
        from scipy.special import ndtri  # 0.2 s that a service does not need to start

        if self.m.target is None:
            return True
        sigma = math.sqrt(covariance_of(self.m, fit)[-1, -1])
        least = -float(ndtri(0.5 * CHANCE_OF_NOISE / count))
        return abs(float(fit.state.coefficients_arcsec[-1])) >= least * sigma

    def complete(self, name: str, least_independence: float) -> None:
        """Take a term that every telescope has, if the points tell it and are hardly predicted worse."""
        if name in self.fit.names:
            return
        try:
            fit = self.fitted((*self.fit.names, name))
        except ModelRefused:
            return
        told = fit.linear.independence[-1]
        if told >= least_independence and loss_ratio(self.m, fit, self.fit) <= FULL_SET_COSTS:
            self.take(fit, name, True)

    def tells_apart(self, name: str) -> bool:
        """Whether the points tell a term from the zero points and the core, whatever is in the fit by now."""
        columns = self.columns([*CORE[self.m.kind], name])
        try:
            linear = solve(columns, np.zeros(columns.shape[:2]), self.trial.zero_points)
        except np.linalg.LinAlgError:
            return False
        return bool(linear.independence[-1] >= WELL_TOLD)

    def prune(self) -> None:
        """Take away terms without which the points are predicted as well.

        Of those that every telescope has only such as are nothing, and are told apart from all others.
        """
        every = (*CORE[self.m.kind], NON_PERPENDICULARITY[self.m.kind])
        while self.fit.names:
            best, worst = self.trial.loo_arcsec, ""
            for k, name in enumerate(self.fit.names):
                if name in PLAY or (name in every and not self._nothing(k)):
                    continue
                if (less := self._without(name)) <= best:
                    best, worst = less, name
            if not worst:
                return
            self.take(self.fitted(tuple(name for name in self.fit.names if name != worst)), worst, False)

    def _nothing(self, k: int) -> bool:
        """Whether a coefficient is within its error of 0, and its term well told."""
        linear, weighted = self.fit.linear, self.fit.weight[:, None] * self.fit.state.residuals_arcsec**2
        freedom = max(2 * int(np.sum(self.fit.used)) - self.trial.unknowns(), 1)
        sigma = math.sqrt(float(np.sum(weighted)) / freedom * linear.unit_covariance[k, k])
        value = abs(float(self.fit.state.coefficients_arcsec[k]))
        root = np.sqrt(np.diag(linear.unit_covariance))
        shared = np.abs(linear.unit_covariance[k] / (root * root[k]))
        alone = float(np.max(np.delete(shared, k), initial=0.0)) <= MOST_SHARED
        return value < sigma and alone and bool(linear.independence[k] >= WELL_TOLD)

    def _without(self, name: str) -> float:
        kept = [k for k, one in enumerate(self.fit.names) if one != name]
        state = self.fit.state
        # what the term explains goes back into the residuals
        gone = self.fit.names.index(name)
        values = state.residuals_arcsec + state.columns[:, :, gone] * state.coefficients_arcsec[gone]
        linear = solve(state.columns[:, :, kept], values, self.trial.zero_points)
        return loo_rms(linear.left_out(), self.fit.used)


def loss_ratio(m: Mechanical, one: RobustFit, other: RobustFit) -> float:
    """How much worse one fit predicts points than another, as a ratio of bounded mean squares."""
    scale = min(one.scale_arcsec, other.scale_arcsec)
    first, second = bounded_losses(loo_residuals(m, one), loo_residuals(m, other), scale)
    if not first.size:
        return math.inf
    return float(np.mean(first) / max(float(np.mean(second)), 1e-12))


def select(
    m: Mechanical,
    *,
    min_gain: float = MIN_GAIN,
    highest_harmonic: int = HIGHEST_HARMONIC,
    most_terms: int = MOST_TERMS,
    among: Sequence[str] | None = None,
) -> Selection:
    """Choose terms for observations.

    Parameters
    ----------
    m : Mechanical
        One point a visit (`visits.visits`).
    min_gain : float
        Share by which a term must lower the leave-one-out RMS.
    most_terms : int
        Zero points not counted; never more than a third of what the points can tell.
    among : sequence of str, optional
        Candidates besides the core and the non-perpendicularity; those of `terms.candidates` if not given.

    Raises
    ------
    ModelRefused
        Not even zero points can be fitted.
    """
    names = tuple(among) if among is not None else candidates(m.kind, highest_harmonic)
    start, refused = _core(m)
    search = _Search(m, start)
    most = min(most_terms, (2 * int(np.sum(start.used)) - 2 * len(np.unique(m.segment))) // 3)
    skew = NON_PERPENDICULARITY[m.kind]
    leans = CORE[m.kind][2] in start.names
    early: tuple[str, ...] = ()
    if m.target is not None:
        if leans:
            search.complete(skew, LEAST_SKEW)
    elif search.tells_apart(skew):
        early = (skew,)
    search.grow([*early, *CORE[m.kind], *names], min_gain, most)
    search.grow([skew], min_gain, most)
    if leans and skew not in search.fit.names:
        refused = (
            *refused,
            (skew, f"the points can't distinguish it from {CORE[m.kind][2]}, which stands for both"),
        )
    search.prune()
    if search.steps and not search.steps[-1].added:
        search.grow([*CORE[m.kind], *names, skew], min_gain, most)
    final = robust_fit(m, search.fit.names, start=search.fit.state)
    chosen = tuple(name for name in final.names if name not in PLAY)
    return Selection(chosen, tuple(search.steps), refused, final)


def _core(m: Mechanical) -> tuple[RobustFit, tuple[tuple[str, str], ...]]:
    """Begin with as much of the core as the points can tell apart and are predicted better by."""
    order = CORE[m.kind]
    plays = plays_told(m, order)
    best = robust_fit(m, plays)
    refused: list[tuple[str, str]] = []
    # polar axis first, as pairs: one of them alone is worth little [POINTING §6]
    for more in (order, order[:3], order[:2]):
        try:
            fit = robust_fit(m, (*plays, *more))
        except ModelRefused as cause:
            refused.append((", ".join(more), cause.what))
            continue
        told = fit.linear.independence[fit.geometry]
        weakest = int(np.argmin(told))
        if told[weakest] < MIN_INDEPENDENCE:
            refused.append((more[weakest], "the points can't distinguish it from the other terms"))
        elif not loss_ratio(m, fit, best) < 1.0:
            loo = loo_arcsec(m, fit)
            refused.append((", ".join(more), f"left out, points are predicted to {loo:.1f}″ with it"))
        else:
            return fit, tuple(refused)
    return best, tuple(refused)
