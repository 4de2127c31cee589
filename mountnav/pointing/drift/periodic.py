"""Periodic error from a long stretch: Lomb-Scargle with significance, and the aliases that there may be.

It is told only where it can be: three turns observed, four looks a turn, and noise that would make such a
peak less than once in a thousand series.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from mountnav.pointing.drift.stretches import Looks, sky_cosine
from mountnav.pointing.drift.values import PeriodicError
from mountnav.series.drift import Array

# Fewer looks than this show no period: six numbers are fitted (amplitude, phase, period, line). Chosen by
# hand.
LEAST_LOOKS = 16
# So many turns of the worm a stretch must hold. Chosen by hand: the straight line takes up slower swings.
LEAST_TURNS = 3.0
# Looks a turn at least; Nyquist's limit is 2, and 4 keeps clear of its aliases. Chosen.
LOOKS_A_TURN = 4.0
# A peak must be less probable than this from noise alone (Baluev's formula). Chosen by hand: one wrong
# period in a thousand stretches.
FALSE_ALARM = 1e-3
# Range of periods that are searched, s. Chosen to hold the worm periods of mounts (some 2 to 20 minutes)
# and the gears before them.
SHORTEST_S, LONGEST_S = 20.0, 3600.0
# An alias is reported when its peak has at least this share of the best one's power. Chosen by hand.
_ALIAS_SHARE = 0.8
# Aliases shorter than this, s, are not reported: no worm turns that fast. Chosen by hand.
_SHORTEST_WORM_S = 60.0


def periodic_error(looks: Looks, *, worm_period_s: float | None = None) -> tuple[PeriodicError | None, str]:
    """Look for a swing of the hour angle axis in one stretch; None, and why, if none is seen.

    Parameters
    ----------
    looks : Looks
        Without jumps; offsets east are made those of the axis by dividing by cos δ.
    worm_period_s : float, optional
        Known period: the search still is free, and tells whether it found it.
    """
    from astropy.timeseries import LombScargle

    n = looks.seconds.size
    if n < LEAST_LOOKS:
        return None, f"{n} looks in the longest stretch, {LEAST_LOOKS} are needed"
    span = float(np.ptp(looks.seconds))
    steps = np.diff(looks.seconds)
    step = float(np.median(steps))
    longest = min(span / LEAST_TURNS, LONGEST_S)
    shortest = max(LOOKS_A_TURN * step, SHORTEST_S)
    if longest < 1.2 * shortest:
        return None, (
            f"{span / 60.0:.0f} minutes with a look each {step:.0f} s show no period: it takes "
            f"{LEAST_TURNS:.0f} turns and {LOOKS_A_TURN:.0f} looks a turn"
        )
    cosine = sky_cosine(looks.dec_deg)
    # west positive, as the hour angle grows
    angle = -looks.east / cosine
    time = looks.seconds - float(looks.seconds.mean())
    angle = angle - np.polynomial.polynomial.polyval(time, np.polynomial.polynomial.polyfit(time, angle, 1))
    sigma = np.maximum(looks.sigma / cosine, 1e-3)
    search = LombScargle(time, angle, sigma)
    frequencies = np.arange(1.0 / longest, 1.0 / shortest, 0.1 / span)
    power = np.asarray(search.power(frequencies))
    best = _refined(search, float(frequencies[int(np.argmax(power))]), 0.1 / span)
    top = float(search.power(best))
    false_alarm = float(
        search.false_alarm_probability(
            top, method="baluev", minimum_frequency=1.0 / longest, maximum_frequency=1.0 / shortest
        )
    )
    if not false_alarm < FALSE_ALARM:
        return None, (
            f"no period stands out between {shortest:.0f} and {longest:.0f} s (noise alone makes such a peak "
            f"with probability {min(max(false_alarm, 0.0), 1.0):.2f})"
        )
    amplitude, amplitude_sigma, rms = _swing(time, angle, best)
    # [Montgomery & O'Donoghue 1999]
    frequency_sigma = math.sqrt(6.0 / n) * rms / (math.pi * span * max(amplitude, 1e-9))
    period = 1.0 / best
    return (
        PeriodicError(
            period_s=period,
            period_sigma_s=frequency_sigma * period**2,
            amplitude_arcsec=amplitude,
            amplitude_sigma_arcsec=amplitude_sigma,
            false_alarm=min(max(false_alarm, 0.0), 1.0),
            aliases_s=_aliases(search, best, step, span, top),
            is_worm=_is_worm(period, frequency_sigma * period**2, worm_period_s),
        ),
        "",
    )


class _Search(Protocol):
    def power(self, frequency: Array) -> Array: ...


def _refined(search: _Search, frequency: float, width: float) -> float:
    for _ in range(3):
        grid = frequency + np.linspace(-width, width, 21)
        frequency = float(grid[int(np.argmax(search.power(grid)))])
        width /= 8.0
    return frequency


def _swing(time: Array, angle: Array, frequency: float) -> tuple[float, float, float]:
    """Amplitude, its sigma and the scatter left, with a straight line fitted along."""
    phase = 2.0 * math.pi * frequency * time
    columns = np.column_stack((np.ones_like(time), time, np.sin(phase), np.cos(phase)))
    got = np.linalg.lstsq(columns, angle, rcond=None)[0]
    left = angle - columns @ got
    rms = math.sqrt(float(left @ left) / max(time.size - 6, 1))
    return float(math.hypot(got[2], got[3])), rms * math.sqrt(2.0 / time.size), rms


def _aliases(search: _Search, best: float, step: float, span: float, top: float) -> tuple[float, ...]:
    """Periods that even sampling can't tell from the one found: their peaks are as high."""
    found = []
    for turns in (1, 2):
        for sign in (1.0, -1.0):
            frequency = abs(turns / step + sign * best)
            if not 1.0 / LONGEST_S < frequency < 1.0 / _SHORTEST_WORM_S:
                continue
            grid = frequency + np.linspace(-2.0 / span, 2.0 / span, 81)
            if float(np.max(search.power(grid))) > _ALIAS_SHARE * top:
                found.append(1.0 / frequency)
    return tuple(sorted(found, reverse=True))


def _is_worm(period: float, sigma: float, worm_period_s: float | None) -> bool | None:
    if worm_period_s is None:
        return None
    return abs(period - worm_period_s) < max(4.0 * sigma, 0.02 * worm_period_s)
