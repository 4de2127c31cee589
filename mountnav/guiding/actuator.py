"""What a mount's corrections are: their kind, their grain, their error, and the play of an axis.

Play (backlash) is a hysteresis: a motor that turns round moves through the play before the axis follows. With
`p` the motor's place in it, from 0 to `b`, a motion of the motor by `u` moves the axis by what of `p + u` is
outside of 0..b, and `p` is left at the end that it reached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadRequest

Array = NDArray[np.float64]

ActuatorKind = Literal["pulses", "rates", "both"]
"""How an axis is corrected: by steps, by a rate that holds until the next correction, or by both at once."""

REVERSED, IGNORED = -1.0, 0.0
"""Shares of a correction that an axis makes which are faults: it goes the other way, or not at all."""

_UNKNOWN_GAINS = (0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.15, 1.4, 1.7, 2.1)
"""Shares of a correction that an axis may make where its guide rate isn't known: it may be a tenth of the
sidereal rate or all of it. Where it is known none is learned: a share that is otherwise by a fifth makes
corrections that much too large or too small, which the next look shows; and under corrections it can hardly
be told from a drift that is larger by as much."""
_PLAYS_ARCSEC = (0.0, 1.5, 3.0, 5.0, 8.0, 12.0, 17.0, 24.0)
"""Plays that are held possible where none is declared, ″: those of ordinary declination axes."""
_PLAY_SCALE_ARCSEC = 8.0
"""Prior scale of an unknown play (exponential), ″. Doubled, reversals are avoided longer."""
_DECLARED_SPREAD = (0.5, 0.7, 0.85, 1.0, 1.15, 1.3, 1.5)
"""Shares of a declared play that are held possible: makers' figures and one's own are this good."""
_FAULT_PRIOR = 1e-3
"""Probability beforehand that an axis goes the wrong way, or doesn't go. Doubled, such a fault is named one
correction earlier at most."""


@dataclass(frozen=True, slots=True)
class Actuator:
    """One axis' corrections.

    Attributes
    ----------
    step_arcsec : float
        Grain of a correction on the sky: a smaller one isn't made, others are rounded to it. 0: none.
    error_share : float
        One sigma of what a correction misses by, as a share of it.
    error_arcsec : float
        One sigma of what each correction disturbs by, whatever its size.
    most_arcsec : float
        The largest correction at once.
    most_arcsec_s : float
        The largest rate.
    play_arcsec : float or None
        Declared play of the axis; None: not known, and learned. 0: it has none.
    rate_known : bool
        Whether the mount says at which rate it guides; else it is learned, from a factor of ten.
    """

    kind: ActuatorKind = "pulses"
    step_arcsec: float = 0.1
    error_share: float = 0.05
    error_arcsec: float = 0.0
    most_arcsec: float = 60.0
    most_arcsec_s: float = 5.0
    play_arcsec: float | None = 0.0
    rate_known: bool = True

    def __post_init__(self) -> None:
        numbers = (
            self.step_arcsec,
            self.error_share,
            self.error_arcsec,
            self.most_arcsec,
            self.most_arcsec_s,
            self.play_arcsec or 0.0,
        )
        if not all(math.isfinite(number) and number >= 0.0 for number in numbers):
            raise BadRequest("an actuator's numbers must be finite and not negative", advice=f"see {self}")
        if self.most_arcsec <= 0.0 or self.most_arcsec_s <= 0.0:
            raise BadRequest("an actuator without corrections can't hold", advice=f"see {self}")

    def rounded(self, corrections: Array) -> Array:
        """The nearest corrections that can be made, ″."""
        clipped = np.clip(corrections, -self.most_arcsec, self.most_arcsec)
        if self.step_arcsec <= 0.0:
            return clipped
        # towards nought where the bound is no whole number of steps
        most = math.floor(self.most_arcsec / self.step_arcsec + 1e-9)
        return np.clip(np.round(clipped / self.step_arcsec), -most, most) * self.step_arcsec

    def disturbance_arcsec2(self, correction_arcsec: float) -> float:
        """Variance that a correction brings with it."""
        if correction_arcsec == 0.0:
            return 0.0
        share = self.error_share * correction_arcsec
        return self.error_arcsec**2 + share**2 + self.step_arcsec**2 / 12.0


@dataclass
class Play:
    """What an axis may make of its corrections: hypotheses side by side, each with what it has made so far.

    Attributes
    ----------
    gain, width, place : ndarray, shape (m,)
        Share of a correction that arrives; play, ″; the motor's place in it.
    made : ndarray, shape (m,)
        Sum of what the axis has made of all corrections, ″.
    log_prior : ndarray, shape (m,)
        Log probability of each hypothesis before any look.
    moves : int
        How many corrections there were.
    """

    actuator: Actuator
    gain: Array = field(init=False)
    width: Array = field(init=False)
    place: Array = field(init=False)
    made: Array = field(init=False)
    log_prior: Array = field(init=False)
    moves: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        rows: list[tuple[float, float, float, float]] = []
        plays = _plays(self.actuator.play_arcsec)
        for gain in (1.0,) if self.actuator.rate_known else _UNKNOWN_GAINS:
            for play, weight in plays:
                places = (0.0, play) if play > 0.0 else (0.0,)
                rows += [(gain, play, place, weight / len(places)) for place in places]
        total = sum(row[3] for row in rows)
        rows += [(fault, 0.0, 0.0, _FAULT_PRIOR * total) for fault in (IGNORED, REVERSED)]
        table = np.array(rows)
        self.gain, self.width, self.place = table[:, 0].copy(), table[:, 1].copy(), table[:, 2].copy()
        self.made = np.zeros(len(rows))
        self.log_prior = np.log(table[:, 3] / table[:, 3].sum())

    def make(self, correction: float) -> None:
        """Take it into account that a correction was sent."""
        reached = self.place + correction
        inside = np.minimum(np.maximum(reached, 0.0), self.width)
        self.made += self.gain * (reached - inside)
        self.place = inside
        self.moves += 1


def _plays(declared: float | None) -> list[tuple[float, float]]:
    """Possible plays with their prior weights."""
    if declared is None:
        return [(play, math.exp(-play / _PLAY_SCALE_ARCSEC)) for play in _PLAYS_ARCSEC]
    if declared == 0.0:
        return [(0.0, 1.0)]
    return [(declared * share, math.exp(-0.5 * ((share - 1.0) / 0.25) ** 2)) for share in _DECLARED_SPREAD]


__all__ = ["IGNORED", "REVERSED", "Actuator", "ActuatorKind", "Play"]
