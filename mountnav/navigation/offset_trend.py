"""How an offset of the axes changes on the way of a fast pass: a line through looks, by their errors.

What a mount is off by changes as it turns: a polar axis half a degree beside the pole makes it 5″ in each
second of a satellite's pass. Between two looks that is carried on. A Kalman filter over two offsets and their
changes per second; looks know across a target's way better than along it, where their instants count.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

__all__ = ["OffsetTrend"]

TURNS_IN_DEG = 90.0
"""A change per second is another one after so much of the way, °: what bends it is the sphere. Doubled, old
looks count for more."""
WANDERS_ARCSEC = 1.0
"""Beside its line an offset wanders by so much in each degree of the way, ″: worms and flexure. Doubled, each
look counts for more."""
CARRIED_ON_S = 30.0
"""A change is carried on for so long after the last look, s. Doubled, one that was learned wrongly leads
twice as far."""


@dataclass(frozen=True, slots=True, eq=False)
class OffsetTrend:
    """Offsets of both axes at an instant, and how they change.

    Attributes
    ----------
    state : ndarray, shape (4,)
        Offsets in both axes' angles, ″, and their changes, ″/s.
    covariance : ndarray, shape (4, 4)
        Of both offsets and both rates.
    turns : bool
        Whether changes are known at all: two looks say so.
    """

    utc: datetime
    state: NDArray[np.float64]
    covariance: NDArray[np.float64]
    turns: bool = False

    @classmethod
    def begun(
        cls, utc: datetime, offsets: tuple[float, float], variances: tuple[float, float]
    ) -> OffsetTrend:
        """After a first look: it says nothing of changes."""
        return cls(utc, np.array([*offsets, 0.0, 0.0]), np.diag([*variances, 0.0, 0.0]))

    def at(self, utc: datetime) -> tuple[float, float]:
        """Both offsets then, ″."""
        seconds = self._carried_s(utc)
        lon, lat, by_lon, by_lat = (float(one) for one in self.state)
        return lon + seconds * by_lon, lat + seconds * by_lat

    def variances(self, utc: datetime) -> tuple[float, float]:
        """Of both offsets then, arcsec²."""
        later = self._moved(self._carried_s(utc), self.covariance)
        return float(later[0, 0]), float(later[1, 1])

    def seen(
        self,
        utc: datetime,
        offsets: tuple[float, float],
        covariance: NDArray[np.float64],
        *,
        change_arcsec_s: tuple[float, float],
        way_deg: float,
    ) -> OffsetTrend:
        """After a further look.

        Parameters
        ----------
        covariance : ndarray, shape (2, 2)
            Of the look's offsets.
        change_arcsec_s : (float, float)
            How fast each offset may change on such a way, one sigma.
        way_deg : float
            Since the look before.
        """
        seconds = (utc - self.utc).total_seconds()
        if seconds <= 0.0:
            return self
        most = np.square(change_arcsec_s)
        before = self.covariance.copy()
        if not self.turns:
            before[2:, 2:] = np.diag(most)
        before[2:, 2:] += np.diag(most * way_deg / TURNS_IN_DEG)
        before[:2, :2] += np.eye(2) * (WANDERS_ARCSEC * way_deg) ** 2
        thought = self._moved(seconds, before)
        state = self.state + seconds * np.array([self.state[2], self.state[3], 0.0, 0.0])
        gain = thought[:, :2] @ np.linalg.inv(thought[:2, :2] + covariance)
        state = state + gain @ (np.array(offsets) - state[:2])
        left = thought - gain @ thought[:2, :]
        return replace(self, utc=utc, state=state, covariance=0.5 * (left + left.T), turns=True)

    def _carried_s(self, utc: datetime) -> float:
        return max(-CARRIED_ON_S, min(CARRIED_ON_S, (utc - self.utc).total_seconds()))

    @staticmethod
    def _moved(seconds: float, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
        step = np.eye(4)
        step[0, 2] = step[1, 3] = seconds
        return np.asarray(step @ covariance @ step.T)
