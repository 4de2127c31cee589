"""How long after a slew the tube comes to rest: from looks that follow each slew.

A look outside the noise of the later ones says "longer than this", the first one after which all stay within
it "no longer than that". Without the instants at which slews ended nothing is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from mountnav.pointing.drift.stretches import Looks
from mountnav.pointing.drift.values import Settling
from mountnav.series.drift import Drift

LATEST_S = 600.0
_WITHIN_SIGMAS = 3.5
_REST_LOOKS = 3


def settling(
    stretches: Sequence[tuple[Looks, Drift | None]], slew_ends: Sequence[datetime]
) -> tuple[Settling | None, str]:
    """Measure the settle time.

    Parameters
    ----------
    stretches : sequence of (Looks, Drift or None)
    slew_ends : sequence of datetime
        When slews arrived.

    Returns
    -------
    Settling or None, and why not
    """
    if not slew_ends:
        return None, "the ends of slews aren't known"
    lower, upper, both = [], [], []
    for looks, _ in stretches:
        before = [one for one in slew_ends if one <= looks.observations[0].utc]
        if not before:
            continue
        since = (looks.observations[0].utc - max(before)).total_seconds()
        if since > LATEST_S:
            continue
        limits = _limits(looks, since)
        if limits is None:
            continue
        low, high = limits
        upper.append(high)
        if low is not None:
            lower.append(low)
            both.append((low, high))
    if not upper:
        return None, f"no slew was followed by {_REST_LOOKS + 1} looks, the first within {LATEST_S:.0f} s"
    typical = sigma = None
    if both:
        middles = np.array([0.5 * (low + high) for low, high in both])
        widths = np.array([(high - low) / np.sqrt(12.0) for low, high in both])
        typical = float(np.median(middles))
        sigma = float(np.sqrt(np.mean(widths**2) + np.var(middles)) / np.sqrt(len(both)))
    return (
        Settling(
            least_s=max(lower) if lower else None,
            most_s=max(upper),
            typical_s=typical,
            sigma_s=sigma,
            slews=len(upper),
        ),
        "",
    )


def _limits(looks: Looks, since_s: float) -> tuple[float | None, float] | None:
    """Longer than, no longer than (s after the slew); the place of rest is that of the later looks."""
    n = looks.seconds.size
    if n < _REST_LOOKS + 1:
        return None
    rest = slice(max(n // 2, 1), n)
    if n - rest.start < _REST_LOOKS:
        rest = slice(n - _REST_LOOKS, n)
    off = np.zeros(n)
    for values in (looks.east, looks.north):
        line = np.polynomial.polynomial.polyfit(
            looks.seconds[rest], values[rest], 1 if n - rest.start >= 4 else 0
        )
        left = values - np.polynomial.polynomial.polyval(looks.seconds, line)
        spread = float(np.std(left[rest], ddof=min(2, n - rest.start - 1)))
        # the line is less sure where it is carried on to
        reach = 1.0 + np.abs(looks.seconds - looks.seconds[rest].mean()) / max(
            np.ptp(looks.seconds[rest]), 1.0
        )
        off = np.maximum(off, np.abs(left) / (np.maximum(looks.sigma, spread) * reach))
    outside = np.flatnonzero(off > _WITHIN_SIGMAS)
    outside = outside[outside < rest.start]
    if outside.size == 0:
        return None, since_s
    last = int(outside[-1])
    return since_s + float(looks.seconds[last]), since_s + float(looks.seconds[last + 1])
