"""One axis that is held: its filter, its period, whether correcting it is worth it, and its corrections."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from mountnav.guiding.actuator import Actuator, Play
from mountnav.guiding.axis_filter import AxisFilter, AxisState
from mountnav.guiding.law import NO_CORRECTION, AxisCorrection, choose, node_times
from mountnav.guiding.periods import propose_period

Array = NDArray[np.float64]

SURE_SIGMAS, SURE_MORE_SIGMAS, SURE_LOOKS = 3.0, 0.25, 30
"""An axis is corrected once the looks show with so many sigma that their forecast beats doing nothing, and no
more once they don't. Each time that the looks have doubled beyond the third number, the second is added: the
longer an axis was watched that needed nothing, the more chances luck had. Doubled, small drifts are left for
twice as long."""
UNPROVEN_SIGMAS = 3.5
"""Before that, and where it isn't so any more, only what is off by so many sigma of the forecast is
corrected. Halved, one look of ten disturbs a mount that stands still."""
LEAST_LOOKS, EARLY_LOOKS = 2, 3
"""Looks before anything is corrected; and up to so many an axis counts as unproven, whatever they show: of
few looks it can hardly be told what scatters and what moves."""
_EVIDENCE = 4.0
"""Logarithm of the odds that a new period must win by: of some fifty periods that were tried one is the best
by chance. Halved, one night in seven has a period that isn't there; it is small then."""
_BETTER = 0.0
"""The same for a better period in the place of one that was found."""
_GROWTH, _GROWTH_LATER, _SETTLED_LOOKS = 1.25, 1.8, 150
"""A period is sought each time that the looks have become more by this factor; more seldom after so many."""
_SCAN_STEPS, _SCAN_TURN, _SCAN_MOST = 8, 0.1, 0.045
"""Periods compared on either side of one that is proposed; their distance in turns over all looks, and as a
share of the period at the most. With twice the distance the best lies between two that both fit badly."""
_PHASE_RAD = 0.15
"""A period is exchanged for a better one when the two come so far apart over all looks."""
_MOST_KEPT = 600
"""Looks that a period is sought in, the newest. Doubled, the search takes four times as long."""
_MOST_STORY = 8000
"""Looks and corrections of a field that can be gone through again for another period: a night's, and 2 s of
work. After so many the period stays as it is. Doubled, a search takes 4 s of a thread."""
_FAULTY = 0.99
"""Probability from which on corrections count as ignored, or as reversed."""
_WIDEST_ARCSEC = 60.0
"""More must have been asked for, ″, before corrections of an axis with play count as ignored. Halved, an axis
with a play of 30″ is called dead."""
_PLAY_SHARE = 0.3
"""Share of the play's sigma that a turn is taken to disturb by. Halved, an axis whose play isn't known turns
round for errors that drift would undo."""
_LONGEST_OFF = 15.0
"""Intervals that an axis is taken to be off for at the most, where nothing is done. Doubled, the motor is
turned round for errors that noise alone makes."""
_YOUNG_LOOKS = 30
"""Before so many looks of a field no surprise begins the bank again: it has hardly been thinned out."""
UNPROVEN_SCATTERS, USELESS_SCATTERS, LIKELY_SIGMAS = 1.5, 4.0, 2.5
"""And only what is off by so many times what looks scatter, whatever the forecast says of its own error: what
lies within the scatter costs little, and a correction by it is luck. By the second number, unless the looks
have shown with so many sigma that the forecast is better than none. Doubled, a drift is followed later at the
beginning."""
BORNE_OUT, SMALL_ARCSEC = 0.5, 2.0
"""And of a correction smaller than this, ″, both of the last two looks must show that share, on the same
side: one look that lies apart is no drift. Of larger ones the gate of looks has judged already. Doubled, a
drift that begins is followed some looks later."""
_SCATTER_LOOKS = 30
"""Scatter is that of so many of the last looks, from one to the next. Doubled, a wind that rises counts
later."""
HARM_SIGMAS, HARM_MEMORY, HARM_LEAST = 2.5, 0.97, 10
"""Corrections do harm if what is off is more with them than it would be without, by so many sigma, of the
looks that are remembered so (some 30), and after so many at least. Then they are taken back and none are made
until looks show again that they would help. Halved, one night in ten is left alone by chance."""
_UNDONE_SCATTERS = 0.3
"""What was corrected is taken back to so much of the scatter: nearer than that nobody sees it."""
_COAST_SIGMAS = 1.0
"""Without a new look only what is off by so many sigma of the forecast is corrected."""


_MEDIAN_OF_SECOND_DIFFERENCES = 0.6745 * math.sqrt(6.0)
"""Median of the absolute second difference of three draws over the sigma of one, of a Gaussian; mathematics.
A drift, however fast, has no second difference."""


@dataclass(frozen=True, slots=True)
class _Seen:
    utc_s: float
    seen: float
    sigma: float


@dataclass(frozen=True, slots=True)
class _Moved:
    amount: float
    variance: float


@dataclass(frozen=True, slots=True)
class _Shifted:
    by: float


@dataclass(frozen=True, slots=True)
class _Jumped:
    sigma: float
    by: float


class HeldAxis:
    """Looks in, corrections out, for one axis; times are seconds from any instant.

    Parameters
    ----------
    start_sigma_arcsec : float
        How far from its target it may begin.
    swings : bool
        Whether a period is sought: an axis that follows the sky swings, one that stands doesn't.
    period_s : float, optional
        Known period of the worm.

    Attributes
    ----------
    worth_it : bool
        Whether looks have shown that their forecast beats doing nothing.
    backed_off : bool
        Whether corrections were seen to do harm: they are taken back, and none are made until it is worth it.
    """

    def __init__(
        self,
        actuator: Actuator,
        *,
        start_sigma_arcsec: float,
        swings: bool = True,
        period_s: float | None = None,
    ) -> None:
        self.actuator = actuator
        self.period_s = period_s
        self.period_told = period_s is not None
        self._start_sigma = start_sigma_arcsec
        self._swings = swings
        self._filter = self._new_filter(period_s)
        self._story: list[_Seen | _Moved | _Jumped | _Shifted] = []
        self._story_over = False
        self._without: deque[tuple[float, float, float]] = deque(maxlen=_MOST_KEPT)
        self._jumps = self._dithered = 0.0
        self._rate = 0.0
        self._rate_since_s = 0.0
        self._score = 0.0
        self._score_variance = 0.0
        self._noise = 0.0
        self._looks = 0
        self._seek_at = 10
        self._asked = self._asked_least = self._asked_most = self._last_amount = 0.0
        self._owed = False
        self.worth_it = self.backed_off = False
        self._harm = self._harm_variance = 0.0
        self._harm_looks = 0

    def _told(self, event: _Seen | _Moved | _Jumped | _Shifted) -> None:
        if not self._story_over:
            self._story.append(event)

    def _new_filter(self, period_s: float | None, *, scanned_s: Array | None = None) -> AxisFilter:
        return AxisFilter(
            Play(self.actuator),
            start_sigma_arcsec=self._start_sigma,
            period_s=period_s,
            swings=self._swings,
            scanned_s=scanned_s,
        )

    # -- time and corrections ------------------------------------------------------------------------

    def advance(self, utc_s: float) -> None:
        """Go on to an instant, with the rate that is in force."""
        self._moved_on(utc_s)
        self._filter.predict(utc_s)

    def _moved_on(self, utc_s: float) -> None:
        if self._rate != 0.0 and utc_s > self._rate_since_s:
            self._move(self._rate * (utc_s - self._rate_since_s), share_only=True)
            self._rate_since_s = utc_s

    def _move(self, amount: float, *, share_only: bool = False) -> None:
        share = self.actuator.error_share * amount
        variance = share**2 if share_only else self.actuator.disturbance_arcsec2(amount)
        self._asked += amount
        self._asked_least, self._asked_most = (
            min(self._asked_least, self._asked),
            max(self._asked_most, self._asked),
        )
        if self.actuator.play_arcsec != 0.0 and amount * self._last_amount <= 0.0:
            # how far it turns in the play before the axis follows is known to no more than this
            variance += self._filter.turn_variance_arcsec2()
        self._last_amount = amount
        self._filter.play.make(amount)
        self._filter.disturbed(variance)
        self._told(_Moved(amount, variance))

    def corrected(self, correction: AxisCorrection, utc_s: float) -> None:
        """A correction was made."""
        self._moved_on(utc_s)
        if correction.step_arcsec != 0.0:
            self._move(correction.step_arcsec)
        self._rate, self._rate_since_s = correction.rate_arcsec_s, utc_s

    def correction(self, utc_s: float, interval_s: float, *, fresh: bool = True) -> AxisCorrection:
        """The best correction at an instant, for the time until the next one.

        Parameters
        ----------
        fresh : bool
            Whether there was a look since the last one.
        """
        if self._looks < LEAST_LOOKS or self.fault() is not None:
            return NO_CORRECTION
        self._moved_on(utc_s)
        if self.backed_off and not self._owed:
            return self._taken_back(utc_s, interval_s) if fresh else NO_CORRECTION
        paths, weights = self._filter.forecast(utc_s, node_times(interval_s))
        sigmas = 0.0 if self.worth_it or self._owed else UNPROVEN_SIGMAS
        if self._looks < EARLY_LOOKS and not self._owed:
            sigmas = UNPROVEN_SIGMAS
        if not fresh:
            sigmas = max(sigmas, _COAST_SIGMAS)
        margin = 0.0 if sigmas == 0.0 else (sigmas * self._filter.forecast_sigma_arcsec(utc_s)) ** 2
        if sigmas == UNPROVEN_SIGMAS:
            borne_out = self._score > LIKELY_SIGMAS * math.sqrt(self._score_variance)
            least = UNPROVEN_SCATTERS if borne_out else USELESS_SCATTERS
            margin = max(margin, (least * max(self._scatter(), math.sqrt(self._noise))) ** 2)
        fare = 0.0 if self.actuator.play_arcsec == 0.0 else self._fare(paths, weights)
        best = choose(
            paths,
            weights,
            self._filter.play,
            interval_s,
            uncertain_arcsec2=margin,
            turn_arcsec2=fare,
            direction=self._last_amount,
        )
        if best.none:
            self._owed = False
        elif sigmas == UNPROVEN_SIGMAS:
            off = math.sqrt(best.gain_arcsec2)
            if off < SMALL_ARCSEC and self._off_twice() < BORNE_OUT * off:
                return NO_CORRECTION
        return best

    def _off_twice(self) -> float:
        """How far off both of the last two looks have it, on the same side, ″; 0 if they don't."""
        if len(self._without) < 2:
            return 0.0
        since = self._jumps + self._dithered + self._filter.made()
        before, last = self._without[-2][1] + since, self._without[-1][1] + since
        return min(abs(before), abs(last)) if before * last > 0.0 else 0.0

    def _taken_back(self, utc_s: float, interval_s: float) -> AxisCorrection:
        """What puts the axis back to where it would be without corrections."""
        _, weights = self._filter.forecast(utc_s, node_times(interval_s))
        play = self._filter.play
        paths = np.repeat(play.made[:, None], node_times(interval_s).size, axis=1)
        margin = (_UNDONE_SCATTERS * self._scatter()) ** 2
        return choose(paths, weights, play, interval_s, uncertain_arcsec2=margin)

    def _scatter(self) -> float:
        """What looks scatter by, from one to the next; 0 of too few."""
        if len(self._without) < 3:
            return 0.0
        last = [self._without[at][1] for at in range(-min(len(self._without), _SCATTER_LOOKS), 0)]
        bends = (abs(a - 2.0 * b + c) for a, b, c in zip(last, last[1:], last[2:], strict=False))
        return median(bends) / _MEDIAN_OF_SECOND_DIFFERENCES

    def _judge_harm(self, seen_arcsec: float, without: float, noise_arcsec2: float) -> None:
        """Hold what is off against what would be without any correction; the noise is in both."""
        made = seen_arcsec - without
        self._harm = HARM_MEMORY * self._harm + seen_arcsec**2 - without**2
        self._harm_variance = HARM_MEMORY**2 * self._harm_variance + 4.0 * noise_arcsec2 * made**2
        self._harm_looks += 1
        if self.backed_off:
            self.backed_off = not self.worth_it
            return
        sure = self._harm > HARM_SIGMAS * math.sqrt(self._harm_variance)
        if made != 0.0 and sure and self._harm_looks >= HARM_LEAST:
            self.backed_off, self.worth_it = True, False
            # what looks show from now on decides whether it is corrected again
            self._score = self._score_variance = self._harm = self._harm_variance = 0.0
            self._harm_looks = 0

    def _fare(self, paths: Array, weights: Array) -> float:
        """What turning the motor round costs: twice what it disturbs, for it turns back some time.

        It is set against all the time that the axis would be off for otherwise: until drift brings it back.
        """
        turn = math.sqrt(self._filter.turn_variance_arcsec2()) + _PLAY_SHARE * self.gain_and_play()[3]
        mean = weights @ paths
        off, goes = float(mean[0]), float(mean[-1] - mean[0])
        lasts = _LONGEST_OFF if off * goes >= 0.0 else min(max(abs(off / goes), 1.0), _LONGEST_OFF)
        return 2.0 * turn**2 / lasts

    # -- looks ---------------------------------------------------------------------------------------

    def expected(self, utc_s: float, sigma_arcsec: float) -> tuple[float, float]:
        """What a look at an instant should show, and with which sigma."""
        self.advance(utc_s)
        mean, variance, _ = self._filter.expected(sigma_arcsec)
        return mean, math.sqrt(variance)

    def seen(self, utc_s: float, seen_arcsec: float, sigma_arcsec: float) -> None:
        """Take in a look."""
        self.advance(utc_s)
        mean, _, noise = self._filter.expected(sigma_arcsec)
        made = self._filter.made()
        # a dither is wanted, and no drift
        forecast, without = mean - made - self._dithered, seen_arcsec - made - self._dithered
        # the noise of the look is in both squares and falls out
        self._score += without**2 - (without - forecast) ** 2
        self._score_variance += 4.0 * noise * forecast**2
        self._noise = noise
        self._filter.update(seen_arcsec, sigma_arcsec)
        self._looks += 1
        self._told(_Seen(utc_s, seen_arcsec, sigma_arcsec))
        self._without.append((utc_s, without - self._jumps, sigma_arcsec))
        more = SURE_MORE_SIGMAS * math.log2(max(self._looks / SURE_LOOKS, 1.0))
        sure = (SURE_SIGMAS + more) * math.sqrt(self._score_variance)
        self.worth_it = self._score > (0.0 if self.worth_it else sure)
        if not self._owed:
            self._judge_harm(seen_arcsec, without, max(noise, self._scatter() ** 2))
        if len(self._story) > _MOST_STORY:
            self._story.clear()
            self._story_over = True
        if self._story_over:
            return
        if self._filter.surprised and self._looks > _YOUNG_LOOKS:
            self._filter = self._replayed(self.period_s)
            self._filter.surprise = 1.0
        if self._swings and self._looks >= self._seek_at:
            growth = _GROWTH if self._looks < _SETTLED_LOOKS else _GROWTH_LATER
            self._seek_at = math.ceil(self._looks * growth)
            self._seek_period()

    def jumped(self, by_arcsec: float) -> None:
        """It has been moved by something, by about so much, as looks show."""
        sigma = max(abs(by_arcsec), 1.0)
        self._filter.jumped(sigma)
        self._told(_Jumped(sigma, by_arcsec))
        self._jumps += by_arcsec

    def another_field(self, sigma_arcsec: float) -> None:
        """After a slew or a flip: it is near its target again, what it is like by nature stays known."""
        self._rate = 0.0
        self._filter.another_field(sigma_arcsec)
        self._filter.log_evidence, self._filter.surprise = 0.0, 1.0
        # what was seen before is of other worm teeth, and of another level: it can't be replayed
        self._story.clear()
        self._story_over = False
        self._without.clear()
        self._jumps = self._dithered = 0.0
        self._looks, self._seek_at = 0, 10
        self._score = self._score_variance = 0.0
        self._harm = self._harm_variance = 0.0
        self._harm_looks, self.backed_off = 0, False
        self._asked = self._asked_least = self._asked_most = self._last_amount = 0.0
        self.worth_it = False
        self.period_told = self.period_s is not None

    def wanted_elsewhere(self, by_arcsec: float) -> None:
        """The place where it should look has moved by so much: a dither."""
        self._filter.shifted(-by_arcsec)
        self._told(_Shifted(-by_arcsec))
        self._dithered -= by_arcsec
        # it goes there whatever looks have shown of drift so far
        self._owed = True

    def _seek_period(self) -> None:
        table = np.array(self._without)
        found = propose_period(table[:, 0], table[:, 1], table[:, 2])
        if found is None:
            return
        span = float(np.ptp(table[:, 0]))
        if self.period_s is not None:
            apart = 2.0 * math.pi * span * abs(1.0 / found - 1.0 / self.period_s)
            if apart < _PHASE_RAD:
                return
        turns = span / found
        # near each other enough that the best phase of one is nearly that of the next
        steps = np.arange(-_SCAN_STEPS, _SCAN_STEPS + 1) * min(_SCAN_TURN / turns, _SCAN_MOST)
        compared_s: Array = np.asarray(found / (1.0 + steps), dtype=np.float64)
        scan = self._replayed(None, scanned_s=compared_s)
        found = scan.likely_period_s()
        bar = _BETTER if self.period_s is not None and not self.period_told else _EVIDENCE
        proposed = self._replayed(found)
        if proposed.log_evidence <= self._filter.log_evidence + bar:
            return
        if self.period_s is not None:
            # a bank that was thinned out before may fit badly by that alone
            whole = self._replayed(self.period_s)
            if proposed.log_evidence <= whole.log_evidence + bar:
                self._filter = whole
                return
        self._filter, self.period_s, self.period_told = proposed, found, False

    def _replayed(self, period_s: float | None, *, scanned_s: Array | None = None) -> AxisFilter:
        """A filter with that period that has seen all that was seen."""
        fresh = self._new_filter(period_s, scanned_s=scanned_s)
        for event in self._story:
            match event:
                case _Seen():
                    fresh.predict(event.utc_s)
                    fresh.update(event.seen, event.sigma)
                case _Moved():
                    fresh.play.make(event.amount)
                    fresh.disturbed(event.variance)
                case _Jumped():
                    fresh.jumped(event.sigma)
                case _Shifted():
                    fresh.shifted(event.by)
        if self._filter.utc_s is not None:
            fresh.predict(self._filter.utc_s)
        return fresh

    # -- what is known -------------------------------------------------------------------------------

    def state(self, sigma_arcsec: float) -> AxisState:
        """What is known now of where it is and what it does."""
        return self._filter.state(sigma_arcsec)

    def fault(self) -> str | None:
        """What is wrong with its corrections: "ignored", "reversed", or None.

        Corrections within an axis' play look like ignored ones: before that is said, more was asked for than
        any play takes up.
        """
        ignored, reversed_ = self._filter.fault()
        if reversed_ > _FAULTY:
            return "reversed"
        asked = self._asked_most - self._asked_least
        widest = (
            0.0
            if self.actuator.play_arcsec == 0.0
            else _WIDEST_ARCSEC + 2.0 * (self.actuator.play_arcsec or 0.0)
        )
        return "ignored" if ignored > _FAULTY and asked > widest else None

    def gain_and_play(self) -> tuple[float, float, float, float]:
        """Share of corrections that arrives, and its play in ″, each with its sigma."""
        return self._filter.gain_and_play()


__all__ = ["HeldAxis"]
