"""Drift so far, field by field: how what the mount is off changes, and where it jumped."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from mountnav.series.drift import Drift, Track, fit_drift, jumps
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset, displaced

POINTS_KEPT = 500
LEAST_JUMP_ARCSEC = 5.0


@dataclass(frozen=True, slots=True)
class DriftPoint:
    """What the mount was off at one instant: seen minus believed."""

    utc: datetime
    offset: Offset
    sigma_arcsec: float


@dataclass(frozen=True, slots=True)
class DriftSoFar:
    """Of one field and segment.

    Attributes
    ----------
    field, segment : str
    since_utc, until_utc : datetime
    frames : int
    drift : Drift or None
        How fast seen minus believed changes since the last jump; None with less than three frames.
    jumps_utc : tuple of datetime
        Frames that a jump led to.
    last : Offset
        Seen minus believed of the last frame.
    """

    field: str
    segment: str
    since_utc: datetime
    until_utc: datetime
    frames: int
    drift: Drift | None
    jumps_utc: tuple[datetime, ...]
    last: Offset


class Drifting:
    """Gathers the points of the present field and segment."""

    def __init__(self) -> None:
        self._field = self._segment = ""
        self._points: deque[DriftPoint] = deque(maxlen=POINTS_KEPT)

    def add(self, field: str, segment: str, point: DriftPoint) -> None:
        """Take a frame's point; those of another field or segment are let go."""
        if (field, segment) != (self._field, self._segment):
            self._field, self._segment = field, segment
            self._points.clear()
        self._points.append(point)

    def so_far(self) -> DriftSoFar | None:
        """Tell the drift of the present field."""
        points = sorted(self._points, key=lambda one: one.utc)
        if not points:
            return None
        track = _track(points)
        found = jumps(track, LEAST_JUMP_ARCSEC)
        start = found[-1] if found else 0
        return DriftSoFar(
            field=self._field,
            segment=self._segment,
            since_utc=points[start].utc,
            until_utc=points[-1].utc,
            frames=len(points) - start,
            drift=fit_drift(track.part(start, len(points))),
            jumps_utc=tuple(points[one].utc for one in found),
            last=points[-1].offset,
        )


def _track(points: list[DriftPoint]) -> Track:
    """Offsets as places about the origin of the sky, where east and north are what they are."""
    origin = Icrs(0.0, 0.0)
    places = [displaced(origin, one.offset.east_arcsec, one.offset.north_arcsec) for one in points]
    minutes = [(one.utc - points[0].utc).total_seconds() / 60.0 for one in points]
    sigma = np.array([max(one.sigma_arcsec, 1e-3) for one in points])
    return Track(
        minutes=np.array(minutes),
        ra_deg=np.array([one.ra_deg for one in places]),
        dec_deg=np.array([one.dec_deg for one in places]),
        sigma_arcsec=sigma,
        anchor=np.zeros(len(points), dtype=np.int64),
        anchor_sigma_arcsec=np.zeros(len(points)),
    )
