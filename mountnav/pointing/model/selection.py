"""Choosing terms: greedy, by what leaving out each point in turn says about predicting it.

A term is added when it lowers the leave-one-out RMS most, by 1.5 % at least, when its coefficient stands out
of its own error by more than the best of so many trials would by chance, and when the points can tell it from
the terms before it. All candidates are tried at once: a new column, freed from those before it, changes
residuals and hat matrix by an outer product, so nothing is refitted to try it [POINTING §6].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mountnav.errors import ModelRefused
from mountnav.pointing.model.linear import LinearFit, Segments, ZeroPoints, solve
from mountnav.pointing.model.mechanical import Bools, Mechanical
from mountnav.pointing.model.rigorous import ARCSEC
from mountnav.pointing.model.robust import RobustFit, robust_fit, state_at
from mountnav.pointing.model.terms import (
    CORE,
    HIGHEST_HARMONIC,
    NON_PERPENDICULARITY,
    Array,
    basis,
    candidates,
)

MIN_GAIN = 0.015
MIN_INDEPENDENCE = 0.05
"""Share of a column that other terms don't explain; below, its sigma is 20 times what it could be."""
WELL_TOLD = 0.3
"""So much of the non-perpendicularity's column left beside zero points and core, and it is a term like any
other: so it is with looks from both sides of a pier. Alt-azimuth mounts leave a tenth of it, and less."""
MOST_TERMS = 30


@dataclass(frozen=True, slots=True)
class SelectionStep:
    """One term more, or one less.

    Attributes
    ----------
    term : str
    added : bool
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
    steps : tuple of SelectionStep
    refused : tuple of (str, str)
        Core terms that were not taken, and why.
    fit : RobustFit
        Of the chosen terms.
    """

    terms: tuple[str, ...]
    steps: tuple[SelectionStep, ...]
    refused: tuple[tuple[str, str], ...]
    fit: RobustFit


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

    def take(self, names: tuple[str, ...], term: str, added: bool) -> None:
        """Go over to these terms; which points count is judged anew."""
        self.fit = self.fitted(names)
        self.trial = self._look(self.fit)
        self.steps.append(SelectionStep(term, added, self.trial.loo_arcsec))

    def columns(self, names: Sequence[str]) -> Array:
        zero_points = self.fit.state.zero_points_arcsec[self.m.segment] * ARCSEC
        lon, lat = self.m.read_lon_rad + zero_points[:, 0], self.m.read_lat_rad + zero_points[:, 1]
        return basis(self.m.kind, names, lon, lat, self.m.site_latitude_rad)

    def grow(self, names: Sequence[str], min_gain: float, most: int) -> None:
        """Add the best of these terms until none is worth it."""
        waiting = [name for name in names if name not in self.fit.names]
        # the best of m coefficients of pure noise stands out by this much
        least_signal = math.sqrt(2.0 * math.log(max(len(waiting), 2)))
        while waiting and len(self.fit.names) < most:
            loo, signal, independence = self.trial.with_each(self.columns(waiting))
            loo = np.where((independence >= MIN_INDEPENDENCE) & (signal >= least_signal), loo, np.inf)
            best = int(np.argmin(loo))
            if not loo[best] < (1.0 - min_gain) * self.trial.loo_arcsec:
                return
            name = waiting.pop(best)
            self.take((*self.fit.names, name), name, True)

    def tells_apart(self, name: str) -> bool:
        """Whether the points tell a term from the zero points and the core, whatever is in the fit by now."""
        columns = self.columns([*CORE[self.m.kind], name])
        try:
            linear = solve(columns, np.zeros(columns.shape[:2]), self.trial.zero_points)
        except np.linalg.LinAlgError:
            return False
        return bool(linear.independence[-1] >= WELL_TOLD)

    def prune(self) -> None:
        """Take away terms without which the points are predicted as well."""
        while self.fit.names:
            best, worst = self.trial.loo_arcsec, ""
            for name in self.fit.names:
                if (less := self._without(name)) <= best:
                    best, worst = less, name
            if not worst:
                return
            self.take(tuple(name for name in self.fit.names if name != worst), worst, False)

    def _without(self, name: str) -> float:
        kept = [k for k, one in enumerate(self.fit.names) if one != name]
        state = self.fit.state
        # what the term explains goes back into the residuals
        gone = self.fit.names.index(name)
        values = state.residuals_arcsec + state.columns[:, :, gone] * state.coefficients_arcsec[gone]
        linear = solve(state.columns[:, :, kept], values, self.trial.zero_points)
        return loo_rms(linear.left_out(), self.fit.used)


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
    min_gain : float
        Share by which a term must lower the leave-one-out RMS.
    highest_harmonic : int
    most_terms : int
        Zero points not counted; never more than a third of what the points can tell.
    among : sequence of str, optional
        Candidates besides the core and the non-perpendicularity; those of `terms.candidates` if not given.

    Returns
    -------
    Selection

    Raises
    ------
    ModelRefused
        Not even zero points can be fitted.
    """
    names = tuple(among) if among is not None else candidates(m.kind, highest_harmonic)
    start, refused = _core(m)
    search = _Search(m, start)
    for name in start.names:
        search.steps.append(SelectionStep(name, True, search.trial.loo_arcsec))
    most = min(most_terms, (2 * int(np.sum(start.used)) - 2 * len(np.unique(m.segment))) // 3)
    skew = NON_PERPENDICULARITY[m.kind]
    early = (skew,) if search.tells_apart(skew) else ()
    search.grow([*early, *CORE[m.kind], *names], min_gain, most)
    search.grow([skew], min_gain, most)
    search.prune()
    if search.steps and not search.steps[-1].added:
        search.grow([*CORE[m.kind], *names, skew], min_gain, most)
    chosen = search.fit.names
    final = robust_fit(m, chosen, start=search.fit.state)
    return Selection(chosen, tuple(search.steps), refused, final)


def _core(m: Mechanical) -> tuple[RobustFit, tuple[tuple[str, str], ...]]:
    """Begin with as much of the core as the points can tell apart and are predicted better by."""
    best = robust_fit(m, ())
    best_loo = loo_rms(best.linear.left_out(), best.used)
    refused: list[tuple[str, str]] = []
    order = CORE[m.kind]
    # polar axis first, as pairs: one of them alone is worth little [POINTING §6]
    for more in (order, order[:3], order[:2]):
        try:
            fit = robust_fit(m, more)
        except ModelRefused as cause:
            refused.append((", ".join(more), cause.what))
            continue
        loo = loo_rms(fit.linear.left_out(), fit.used)
        weakest = int(np.argmin(fit.linear.independence))
        if fit.linear.independence[weakest] < MIN_INDEPENDENCE:
            refused.append((more[weakest], "the points can't tell it from the other terms"))
        elif not loo < best_loo:
            refused.append((", ".join(more), f"left out, points are predicted to {loo:.1f}″ with it"))
        else:
            return fit, tuple(refused)
    return best, tuple(refused)
