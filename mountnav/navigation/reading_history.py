"""The last readings of the mount, so that a frame exposed by another program can be compared with them."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from datetime import datetime, timedelta

from mountnav.devices import MountReading, from_mount
from mountnav.sky.sphere import separation_arcsec


@dataclass(frozen=True, slots=True)
class Around:
    """The readings round an exposure.

    Attributes
    ----------
    before, after : MountReading
        The last one before its start, the first one after its end.
    moved_arcsec : float
        The furthest that any reading from `before` to `after` is from `before`.
    slewing : bool
        Whether one of them says that it was slewing.
    """

    before: MountReading
    after: MountReading
    moved_arcsec: float
    slewing: bool


@dataclass(frozen=True, slots=True)
class Meanwhile:
    """What was known of the mount and of the camera when a frame from outside was compared.

    Attributes
    ----------
    around : Around or None
        The readings round its exposure; None where there are none near enough.
    allowed_arcsec : float
        How far they may wander.
    moved_utc : datetime or None
        End of the mount's last order to move.
    not_fresh : str
        Why the camera's frames before it don't prove that this one shows the sky of now; empty if they do.
    tolerance_arcsec : float
        How far off the telescope may be.
    """

    around: Around | None
    allowed_arcsec: float
    moved_utc: datetime | None
    segment_id: str
    model_id: str | None
    not_fresh: str = ""
    tolerance_arcsec: float = math.inf


class ReadingHistory:
    """Readings of the last while, oldest first.

    Parameters
    ----------
    keep : timedelta
        How long.
    most : int
        How many at most.
    """

    def __init__(self, keep: timedelta = timedelta(minutes=30), most: int = 4000) -> None:
        self._keep = keep
        self._readings: deque[MountReading] = deque(maxlen=most)

    def __len__(self) -> int:
        return len(self._readings)

    def add(self, reading: MountReading) -> None:
        """Keep one; one that is no later than the last is left out."""
        kept = self._readings
        if kept and reading.utc <= kept[-1].utc:
            return
        kept.append(reading)
        while kept and reading.utc - kept[0].utc > self._keep:
            kept.popleft()

    @property
    def latest(self) -> MountReading | None:
        """The last one."""
        return self._readings[-1] if self._readings else None

    def around(self, start: datetime, end: datetime, within: timedelta) -> Around | None:
        """The readings round an exposure.

        Parameters
        ----------
        start, end : datetime
            Of the exposure.
        within : timedelta
            How long before its start and after its end a reading may be.

        Returns
        -------
        Around or None
            None when there is none on one side, or only ones too long before or after.
        """
        before = after = None
        between: list[MountReading] = []
        for reading in self._readings:
            if reading.utc <= start:
                before, between = reading, []
            elif reading.utc < end:
                between.append(reading)
            else:
                after = reading
                break
        if before is None or after is None or start - before.utc > within or after.utc - end > within:
            return None
        here = from_mount(before.place)
        others = [*between, after]
        moved = max(separation_arcsec(from_mount(reading.place), here) for reading in others)
        return Around(before, after, moved, any(reading.slewing is True for reading in (before, *others)))


__all__ = ["Around", "Meanwhile", "ReadingHistory"]
