"""What one axis does by itself, from looks: a bank of Kalman filters, weighed by how well they predict.

The disturbance d(t) of an axis is level + rate · t + a periodic part; the level walks (gears, flexure), the
rate walks (refraction, polar error as the sky turns), the amplitudes of the periodic part creep. A look shows

    z = d + made + noise,      noise² = sigma of the solve² + seeing²

where `made` is what the axis has made of all corrections so far. How much level and rate walk and what seeing
adds is not known: each filter of the bank holds one combination possible, and Bayes' rule weighs them by
their innovations [Magill 1965, multiple-model estimation]. So is what the axis makes of corrections (`Play`):
its hypotheses share covariances and gains, for these don't depend on what is seen.

As long as the period of an axis that swings isn't known, some of the filters hold one of a coarse series of
periods for possible, with a phase that may wander by what lies between two of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.guiding.actuator import IGNORED, REVERSED, Play

Array = NDArray[np.float64]

HARMONICS = 3
"""Harmonics of the period that are fitted: the worm's turn, its half and its third, as measured mounts show.
Doubled, a third more numbers are learned from the same looks, and each is known worse."""

_RATE_CLASSES = (
    # prior of the rate ″/s, and how its variance grows, ″²/s³
    (2e-4, 1e-11),
    (1.5e-2, 3e-9),
    (3e-2, 1e-6),
)
"""A good mount; a polar error of degrees' tenths with what turns it (″/min in hours); a mount whose rate
wanders. Chosen to span mounts by factors that the bank's weights bridge."""
_RESTLESS = (1e-1, 2e-4)
"""One more, of an axis that swings without a period that is known; ″/s and ″²/s³."""
_WALKS = (3e-7, 1e-4, 3e-3, 5e-2)
"""How the variance of the level grows, ″²/s: 0.005 to 2″ per root of a minute."""
_SEEINGS_ARCSEC = (0.0, 0.35, 0.9, 2.0)
"""What seeing and wind may add to a center beyond its stated sigma, ″."""
_COARSE_PERIODS_S = tuple(130.0 * 1.2**step for step in range(10))
"""Periods held possible before one is found, s: those of worms, 130 to 670 s. Their steps of a fifth are
bridged by the wandering phase; wider ones would leave gaps between them."""
_COARSE_AMPLITUDE_ARCSEC = 5.0
"""Prior sigma of sine and cosine of such a swing, ″."""
_COARSE_TURNS = 3.0
"""In so many turns the phase of such a swing is forgotten. Doubled, periods between two of the series are
followed worse."""
_COARSE_WALK = 1e-3
"""How the level walks beside it, ″²/s."""
_COARSE_SEEINGS_ARCSEC = (0.2, 0.8)
"""Seeing beside it, ″."""
_SCAN_WALK, _SCAN_SEEING_ARCSEC = 1e-3, 0.5
"""Walk, ″²/s, and seeing, ″, by which periods are compared with each other: those of ordinary mounts. Tenfold
walks make near periods alike; a tenth of it lets a drift that bends decide between them."""
_FORGETTING = 0.995
"""By this the weights' logarithms shrink with each look: the bank remembers some 200 looks. Doubled closeness
to 1, it takes twice as long to notice that the wind has risen."""
_AMPLITUDES_ARCSEC = (12.0, 3.0, 1.5)
"""Prior sigma of each harmonic's sine and cosine, ″."""
_SMALLER = (1.0, 0.2, 0.02)
"""Shares of these amplitudes that are held possible: mounts with a worm, good ones, and those without."""
_CREEP_TURNS = 4e3
"""In so many turns a periodic amplitude changes by its prior's sigma. Halved, it is known worse by 20 %."""
_TURN_SIGMA_ARCSEC, _TURN_SHARE = 0.3, 0.06
"""One sigma of where a motor that turns round takes its axis along, ″, and as a share of the play: half the
steps of the plays held possible. Doubled, a turn is followed by a look that counts for less."""
_DOUBT = 1e-3
"""With each look so much of the probability of gain and play returns to what was held possible beforehand.
Doubled, what has been learned of a play fades in half the time where nothing confirms it."""
_FILTERS_KEPT = 1e-3
"""A filter of the bank whose probability has been below this is given up after `_PRUNE_AFTER` looks."""
_PRUNE_AFTER = 8
"""Looks after which the bank is thinned out, and again each time. Halved, filters go by chance."""
_SURPRISED = 2.2
"""Mean square of the last innovations, in units of what was expected: above this the bank no longer fits the
night. By chance it is passed once in 10,000 looks."""
_SURPRISE_LOOKS = 20.0
"""Over so many looks it is averaged."""


@dataclass(frozen=True, slots=True)
class AxisState:
    """What is known of an axis at an instant.

    Attributes
    ----------
    level_arcsec, level_sigma_arcsec : float
        Where the axis is beside its target now, corrections included.
    rate_arcsec_s, rate_sigma_arcsec_s : float
        Drift without the periodic part.
    noise_arcsec : float
        What a look of the last one's sigma scatters by, seeing included.
    walk_arcsec : float
        One sigma of how far the level walks in a minute.
    amplitudes_arcsec : tuple of float
        Of each harmonic; empty without a period.
    """

    level_arcsec: float
    level_sigma_arcsec: float
    rate_arcsec_s: float
    rate_sigma_arcsec_s: float
    noise_arcsec: float
    walk_arcsec: float
    amplitudes_arcsec: tuple[float, ...]
    amplitude_sigma_arcsec: float


class AxisFilter:
    """The bank of one axis.

    Parameters
    ----------
    play : Play
        What the axis makes of corrections.
    start_sigma_arcsec : float
        How far from the target it may begin.
    period_s : float or None
        Of the periodic part; None: not known, or there is none.
    swings : bool
        Whether a periodic part is held possible where no period is known.
    scanned_s : ndarray, optional
        Periods to be compared with each other: a filter for each, and all its evidence kept.
    """

    def __init__(
        self,
        play: Play,
        *,
        start_sigma_arcsec: float,
        period_s: float | None = None,
        swings: bool = True,
        scanned_s: Array | None = None,
    ) -> None:
        self.play = play
        self._forgetting = _FORGETTING if scanned_s is None else 1.0
        self.period_s = period_s
        self.utc_s: float | None = None
        self.log_evidence = 0.0
        self.surprise = 1.0
        classes = _RATE_CLASSES if period_s is not None or not swings else (*_RATE_CLASSES, _RESTLESS)
        shares = _SMALLER if period_s is not None else (0.0,)
        grid = [
            (c, w, s, math.inf, share)
            for c in classes
            for w in _WALKS
            for s in _SEEINGS_ARCSEC
            for share in shares
        ]
        harmonics = HARMONICS if period_s is not None else 1 if swings else 0
        if period_s is None and swings:
            grid += [
                (_RATE_CLASSES[1], _COARSE_WALK, s, p, 1.0)
                for p in _COARSE_PERIODS_S
                for s in _COARSE_SEEINGS_ARCSEC
            ]
        if scanned_s is not None:
            grid = [(_RATE_CLASSES[1], _SCAN_WALK, _SCAN_SEEING_ARCSEC, float(p), 1.0) for p in scanned_s]
            harmonics = HARMONICS
        h, n = len(grid), 2 + 2 * harmonics
        self._harmonics = harmonics
        self._rate_walk = np.array([row[0][1] for row in grid])
        self._walk = np.array([row[1] for row in grid])
        self._seeing2 = np.array([row[2] ** 2 for row in grid])
        coarse = np.array([row[3] for row in grid])
        share = np.array([row[4] for row in grid])
        self._turn_rate = (
            np.full(h, 2.0 * math.pi / period_s) if period_s is not None else 2.0 * math.pi / coarse
        )
        self._covariance = np.zeros((h, n, n))
        self._covariance[:, 0, 0] = start_sigma_arcsec**2
        self._covariance[:, 1, 1] = [row[0][0] ** 2 for row in grid]
        self._creep = np.zeros((h, harmonics))
        for j in range(harmonics):
            at = 2 + 2 * j
            if period_s is not None or scanned_s is not None:
                power = (share * _AMPLITUDES_ARCSEC[j]) ** 2
                self._creep[:, j] = power / (_CREEP_TURNS * (2.0 * math.pi / self._turn_rate))
            else:
                power = (share * _COARSE_AMPLITUDE_ARCSEC) ** 2
                self._creep[:, j] = 2.0 * power / (_COARSE_TURNS * coarse)
            self._covariance[:, at, at] = self._covariance[:, at + 1, at + 1] = power
            # it begins near the target, wherever in its swing: the level undoes that
            self._covariance[:, 0, 0] += power
            self._covariance[:, 0, at] -= power
            self._covariance[:, at, 0] -= power
        self._mean = np.zeros((h, play.gain.size, n))
        self._log_weight = np.tile(play.log_prior, (h, 1)) - math.log(h)
        self._weight = np.exp(self._log_weight)
        self._row = np.array([1.0, 0.0] + [1.0, 0.0] * harmonics)
        # where the variances of sines and cosines stand in a matrix that is read row by row
        self._swing_at = np.arange(2, n) * (n + 1)
        self._creep = np.repeat(self._creep, 2, axis=1)
        self._at_look: tuple[int, Array, Array, Array, float, float] | None = None
        self._added = 0.0
        self._updates = 0

    # -- time ----------------------------------------------------------------------------------------

    def predict(self, utc_s: float) -> None:
        """Go on to an instant; one before the last is taken for it."""
        if self.utc_s is None:
            self.utc_s = utc_s
            return
        dt = utc_s - self.utc_s
        if dt <= 0.0:
            return
        self.utc_s = utc_s
        self._at_look = None
        n = self._row.size
        # all filters with one period go on alike
        turns = self._turn_rate if self.period_s is None else self._turn_rate[:1]
        F = np.zeros((turns.size if self._harmonics else 1, n, n))
        F[:, 0, 0] = F[:, 1, 1] = 1.0
        F[:, 0, 1] = dt
        for j in range(self._harmonics):
            turn = (j + 1) * dt * turns
            cosine, sine = np.cos(turn), np.sin(turn)
            at = 2 + 2 * j
            F[:, at, at] = F[:, at + 1, at + 1] = cosine
            F[:, at, at + 1], F[:, at + 1, at] = sine, -sine
        turned = F.transpose(0, 2, 1)
        self._mean = self._mean @ turned
        P = F @ self._covariance @ turned
        P[:, 0, 0] += self._walk * dt + self._rate_walk * dt**3 / 3.0 + self._added
        bend = self._rate_walk * dt**2 / 2.0
        P[:, 0, 1] += bend
        P[:, 1, 0] += bend
        P[:, 1, 1] += self._rate_walk * dt
        if self._harmonics:
            P.reshape(P.shape[0], -1)[:, self._swing_at] += self._creep * dt
        self._added = 0.0
        self._covariance = P

    def disturbed(self, variance_arcsec2: float) -> None:
        """The level may have moved by so much more: a correction's own error."""
        self._added += variance_arcsec2

    def shifted(self, by_arcsec: float) -> None:
        """The zero of what is seen has moved: a dither."""
        self._at_look = None
        self._mean[:, :, 0] += by_arcsec

    def jumped(self, sigma_arcsec: float) -> None:
        """The axis has been moved by something: its level isn't known any more, the rest is."""
        self._at_look = None
        self._covariance[:, 0, 0] += sigma_arcsec**2

    def another_field(self, sigma_arcsec: float) -> None:
        """After a slew or a flip: level, rate and the worm's place are others; noise and amplitudes stay."""
        self._at_look = None
        rates = np.maximum((self._weight * self._mean[:, :, 1] ** 2).sum(), 2.5e-7)
        self._covariance[:, 0, :] = self._covariance[:, :, 0] = 0.0
        self._covariance[:, 0, 0] = sigma_arcsec**2
        self._covariance[:, 1, :] = self._covariance[:, :, 1] = 0.0
        self._covariance[:, 1, 1] = 2.0 * rates
        mean = np.einsum("hm,hmn->n", self._weight, self._mean)
        self._mean[:] = 0.0
        # what was corrected before belongs to the other field
        self.play.made[:] = 0.0
        for j in range(self._harmonics):
            at = 2 + 2 * j
            swing = 0.5 * (float(mean[at]) ** 2 + float(mean[at + 1]) ** 2)
            power = swing + self._covariance[:, at, at]
            self._covariance[:, at : at + 2, :] = 0.0
            self._covariance[:, :, at : at + 2] = 0.0
            self._covariance[:, at, at] = self._covariance[:, at + 1, at + 1] = power
            self._covariance[:, 0, 0] += power
            self._covariance[:, 0, at] -= power
            self._covariance[:, at, 0] -= power

    # -- looks ---------------------------------------------------------------------------------------

    def _looked(self) -> tuple[int, Array, Array, Array, float, float]:
        """What the filters have at the present instant: five things, once for all who ask.

        Gain before it is divided, variance, where the axis is, the mean of that, the variance between them.
        """
        known = self._at_look
        if known is not None and known[0] == self.play.moves:
            return known
        PH = self._covariance @ self._row
        x = self._mean @ self._row + self.play.made
        w = self._weight
        mean = float((w * x).sum())
        across = float((w * (x - mean) ** 2).sum())
        self._at_look = (self.play.moves, PH, PH @ self._row, x, mean, across)
        return self._at_look

    def expected(self, sigma_arcsec: float) -> tuple[float, float, float]:
        """Mean and variance of what a look would show now, and how much of that is its own noise."""
        _, _, P, _, mean, across = self._looked()
        of_h = self._weight.sum(axis=1)
        noise = float(of_h @ self._seeing2) + sigma_arcsec**2
        return mean, float(of_h @ P) + noise + across, noise

    def update(self, seen_arcsec: float, sigma_arcsec: float) -> None:
        """Take in a look at the present instant."""
        _, PH, P, x, expected, across = self._looked()
        self._at_look = None
        S = P + (sigma_arcsec**2 + 1e-9) + self._seeing2
        innovation = seen_arcsec - x
        variance = float(self._weight.sum(axis=1) @ S) + across
        square = min((seen_arcsec - expected) ** 2 / variance, 25.0)
        self.surprise += (square - self.surprise) / _SURPRISE_LOOKS
        joint = self._log_weight - 0.5 * (np.log(2.0 * math.pi * S)[:, None] + innovation**2 / S[:, None])
        gain = PH / S[:, None]
        self._mean = self._mean + innovation[:, :, None] * gain[:, None, :]
        self._covariance = self._covariance - gain[:, :, None] * PH[:, None, :]
        top = float(joint.max())
        weight = np.exp(joint - top)
        total = float(weight.sum())
        # what was held possible before sums up to one
        self.log_evidence += top + math.log(total)
        # what wind and gears do changes with the hours, and old evidence of it fades; play and gain stay
        of_m = weight.sum(axis=0) / total
        fading = self._forgetting * (joint - joint.max(axis=0))
        fading -= np.log(np.exp(fading).sum(axis=0))
        # none of these is ever out of the question: what walks and drifts may imitate them for a while
        of_m = np.log((1.0 - _DOUBT) * of_m + _DOUBT * np.exp(self.play.log_prior))
        self._log_weight = of_m + fading
        self._weight = np.exp(self._log_weight)
        self._updates += 1
        if self._forgetting < 1.0 and self._updates % _PRUNE_AFTER == 0:
            self._prune_filters()

    def _prune_filters(self) -> None:
        kept = self._weight.sum(axis=1) >= _FILTERS_KEPT
        self._mean, self._covariance = self._mean[kept], self._covariance[kept]
        self._rate_walk, self._walk = self._rate_walk[kept], self._walk[kept]
        self._seeing2, self._turn_rate = self._seeing2[kept], self._turn_rate[kept]
        self._creep = self._creep[kept]
        self._renormalized(self._log_weight[kept])

    def _renormalized(self, log_weight: Array) -> None:
        weight = np.exp(log_weight - log_weight.max())
        total = float(weight.sum())
        self._log_weight = log_weight - log_weight.max() - math.log(total)
        self._weight = weight / total

    def likely_period_s(self) -> float:
        """The best of the periods that were scanned, between the grid's steps by a parabola."""
        weight = np.log(np.maximum(self._weight.sum(axis=1), 1e-300))
        at = int(np.argmax(weight))
        rate = self._turn_rate
        if not 0 < at < weight.size - 1:
            return float(2.0 * math.pi / rate[at])
        bend = weight[at - 1] - 2.0 * weight[at] + weight[at + 1]
        shift = 0.0 if bend >= 0.0 else 0.5 * (weight[at - 1] - weight[at + 1]) / bend
        return float(2.0 * math.pi / (rate[at] + shift * 0.5 * (rate[at + 1] - rate[at - 1])))

    @property
    def surprised(self) -> bool:
        """Whether the night has become another one than the bank holds possible."""
        return self.surprise > _SURPRISED

    # -- what follows --------------------------------------------------------------------------------

    def forecast(self, utc_s: float, ahead_s: Array) -> tuple[Array, Array]:
        """Where the axis will be beside its target if nothing more is corrected.

        Parameters
        ----------
        utc_s : float
            From when on.
        ahead_s : ndarray, shape (k,)
            From the filter's instant.

        Returns
        -------
        ndarray, shape (m, k)
            Per hypothesis of `Play`.
        ndarray, shape (m,)
            Their weights.
        """
        w = self._weight
        of_m = w.sum(axis=0)
        at_s = ahead_s + max(utc_s - (self.utc_s if self.utc_s is not None else utc_s), 0.0)
        turn = self._turn_rate[:, None] * at_s
        rows = np.empty((w.shape[0], self._row.size, at_s.size))
        rows[:, 0], rows[:, 1] = 1.0, at_s
        for j in range(self._harmonics):
            rows[:, 2 + 2 * j] = np.cos((j + 1) * turn)
            rows[:, 3 + 2 * j] = np.sin((j + 1) * turn)
        paths = self._mean @ rows
        mean = np.einsum("hm,hmk->mk", w, paths) / np.maximum(of_m, 1e-300)[:, None]
        return mean + self.play.made[:, None], of_m

    def made(self) -> float:
        """What all corrections have come to, ″."""
        return float(self._weight.sum(axis=0) @ self.play.made)

    def turn_variance_arcsec2(self) -> float:
        """How uncertain it is where a motor that turns round takes its axis along."""
        of_m = self._weight.sum(axis=0)
        play = float(of_m @ self.play.width)
        return (_TURN_SIGMA_ARCSEC + _TURN_SHARE * play) ** 2

    def forecast_sigma_arcsec(self, utc_s: float) -> float:
        """About one sigma of where the axis is at an instant."""
        of_h = self._weight.sum(axis=1)
        dt = max(utc_s - (self.utc_s if self.utc_s is not None else utc_s), 0.0)
        P = self._covariance
        variance = (P @ self._row) @ self._row + 2.0 * P[:, 0, 1] * dt + P[:, 1, 1] * dt**2
        variance = variance + self._walk * dt + self._rate_walk * dt**3 / 3.0
        return math.sqrt(max(float(of_h @ variance), 0.0))

    def fault(self) -> tuple[float, float]:
        """Probabilities that corrections are ignored, and that they go the wrong way."""
        of_m = self._weight.sum(axis=0)
        return float(of_m[self.play.gain == IGNORED].sum()), float(of_m[self.play.gain == REVERSED].sum())

    def gain_and_play(self) -> tuple[float, float, float, float]:
        """Share of corrections that arrives, and the play in ″, each with its sigma."""
        of_m = self._weight.sum(axis=0)
        gain = float(of_m @ self.play.gain)
        play = float(of_m @ self.play.width)
        return (
            gain,
            math.sqrt(float(of_m @ (self.play.gain - gain) ** 2)),
            play,
            math.sqrt(float(of_m @ (self.play.width - play) ** 2)),
        )

    def state(self, sigma_arcsec: float) -> AxisState:
        """What is known at the last look."""
        _, _, P, _, level, between = self._looked()
        w = self._weight
        of_h = w.sum(axis=1)
        mean = np.einsum("hm,hmn->n", w, self._mean)
        within = np.einsum("h,hnn->n", of_h, self._covariance)
        across = np.einsum("hm,hmn->n", w, (self._mean - mean) ** 2)
        sigmas = np.sqrt(np.maximum(within + across, 0.0))
        amplitudes: tuple[float, ...] = ()
        if self.period_s is not None:
            amplitudes = tuple(
                math.hypot(float(mean[2 + 2 * j]), float(mean[3 + 2 * j])) for j in range(self._harmonics)
            )
        return AxisState(
            level_arcsec=level,
            level_sigma_arcsec=math.sqrt(max(float(of_h @ P) + between, 0.0)),
            rate_arcsec_s=float(mean[1]),
            rate_sigma_arcsec_s=float(sigmas[1]),
            noise_arcsec=math.sqrt(sigma_arcsec**2 + float(of_h @ self._seeing2)),
            walk_arcsec=math.sqrt(60.0 * float(of_h @ self._walk)),
            amplitudes_arcsec=amplitudes,
            amplitude_sigma_arcsec=float(sigmas[2]) if amplitudes else 0.0,
        )


__all__ = ["HARMONICS", "AxisFilter", "AxisState"]
