"""Slow trends that are told beside what is corrected: how a field turns, how two cameras bend apart."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

LEAST_POINTS = 4
"""Fewer points show no trend with an error."""
_MOST_POINTS = 2000
"""Points that are kept, the newest: a night's. Doubled, so is the memory, some 30 kB."""


@dataclass(frozen=True, slots=True)
class Trend:
    """A straight line through points.

    Attributes
    ----------
    rate_per_h, sigma_per_h : float
        Change in an hour, in the unit of the points.
    now : float
        The line's value at the last point.
    scatter : float
        Root mean square about the line.
    """

    rate_per_h: float
    sigma_per_h: float
    now: float
    scatter: float
    points: int


class TrendSeen:
    """Points of one quantity over time.

    Parameters
    ----------
    turn : float, optional
        The quantity is an angle that comes round after so much: 360.
    """

    def __init__(self, turn: float | None = None) -> None:
        self._turn = turn
        self._points: deque[tuple[float, float]] = deque(maxlen=_MOST_POINTS)

    def add(self, utc_s: float, value: float) -> None:
        """Take in a point; what is no number is left out."""
        if not (math.isfinite(utc_s) and math.isfinite(value)):
            return
        if self._turn is not None and self._points:
            value = self._points[-1][1] + math.remainder(value - self._points[-1][1], self._turn)
        self._points.append((utc_s, value))

    def clear(self) -> None:
        """Begin anew: another side of the pier, another camera."""
        self._points.clear()

    def trend(self) -> Trend | None:
        """The line through them; None for too few points, or for points of one instant."""
        if len(self._points) < LEAST_POINTS:
            return None
        table = np.array(self._points)
        hours = (table[:, 0] - table[-1, 0]) / 3600.0
        if float(np.ptp(hours)) <= 0.0:
            return None
        middle = float(hours.mean())
        spread = float(((hours - middle) ** 2).sum())
        rate = float(((hours - middle) * table[:, 1]).sum()) / spread
        level = float(table[:, 1].mean()) - rate * middle
        rest = table[:, 1] - level - rate * hours
        variance = float(rest @ rest) / (len(table) - 2)
        return Trend(rate, math.sqrt(variance / spread), level, math.sqrt(variance), len(table))


@dataclass(frozen=True, slots=True)
class Bending:
    """How the main camera's field moves against that of the camera that is guided by.

    Attributes
    ----------
    east, north : Trend
        Main camera's center minus the guiding one's, ″.
    """

    east: Trend
    north: Trend


class BendingSeen:
    """Differential flexure from pairs of frames of two cameras on one mount.

    Frames are rarely of one instant: the guiding camera's place at the main camera's mid-exposure is taken on
    the straight line between its looks before and after.
    """

    def __init__(self, apart_s: float = 300.0) -> None:
        self._apart_s = apart_s
        self._guided: deque[tuple[float, float, float]] = deque(maxlen=_MOST_POINTS)
        self._waiting: deque[tuple[float, float, float]] = deque(maxlen=64)
        self._east, self._north = TrendSeen(), TrendSeen()

    def guide_look(self, utc_s: float, east_arcsec: float, north_arcsec: float) -> None:
        """A look of the camera that is guided by, from any fixed place."""
        self._guided.append((utc_s, east_arcsec, north_arcsec))
        for point in [point for point in self._waiting if point[0] <= utc_s]:
            self._waiting.remove(point)
            self._pair(*point)

    def main_frame(self, utc_s: float, east_arcsec: float, north_arcsec: float) -> None:
        """A frame of the main camera, from the same place."""
        if self._guided and self._guided[-1][0] >= utc_s:
            self._pair(utc_s, east_arcsec, north_arcsec)
        else:
            self._waiting.append((utc_s, east_arcsec, north_arcsec))

    def _pair(self, utc_s: float, east: float, north: float) -> None:
        before = next((look for look in reversed(self._guided) if look[0] <= utc_s), None)
        after = next((look for look in self._guided if look[0] >= utc_s), None)
        if before is None or after is None or after[0] - before[0] > self._apart_s:
            return
        share = 0.0 if after[0] == before[0] else (utc_s - before[0]) / (after[0] - before[0])
        self._east.add(utc_s, east - (before[1] + share * (after[1] - before[1])))
        self._north.add(utc_s, north - (before[2] + share * (after[2] - before[2])))

    def clear(self) -> None:
        """Begin again, after a flip: both tubes bend the other way."""
        for seen in (self._guided, self._waiting, self._east, self._north):
            seen.clear()

    def bending(self) -> Bending | None:
        """What is known; None before enough pairs."""
        east, north = self._east.trend(), self._north.trend()
        return None if east is None or north is None else Bending(east, north)


__all__ = ["Bending", "BendingSeen", "Trend", "TrendSeen"]
