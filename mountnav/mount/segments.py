"""Segments: how long the mount's zero points stay what they are, and what ended each.

A sync that was seen (or may have been), a home that was found, a reboot, a lost link begin a new one. A flip
doesn't: both sides of the pier share one mechanical model [POINTING §5]. But a one-point sync made before a
flip says nothing of the other side; so the side of the last sync is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from mountnav.devices import PierSide
from mountnav.journal.records import new_id

SegmentListener = Callable[[str, str], None]

SEEN_LATE = "a sync was seen, late"
"""Why a segment begins when a sync shows that had seemed to be ignored."""


class Segments:
    """The segment a mount is in.

    Attributes
    ----------
    segment_id : str
    since_utc : datetime or None
        None for the first one: when it began is not known.
    why : str
        What began it.
    side_of_last_sync : PierSide or None
        On which the tube hung when this segment's zero points were synced; None if they weren't.
    side : PierSide or None
        On which it hung in the last reading that told.
    """

    def __init__(self) -> None:
        self.segment_id = new_id()
        self.since_utc: datetime | None = None
        self.why = "the service began to use the mount"
        self.side_of_last_sync: PierSide | None = None
        self.side: PierSide | None = None
        self._listeners: list[SegmentListener] = []

    def listen(self, listener: SegmentListener) -> None:
        """Tell `listener(segment_id, why)` of each new segment."""
        self._listeners.append(listener)

    def begin(self, why: str, utc: datetime, synced_on: PierSide | None = None) -> dict[str, object]:
        """Begin a new segment.

        Parameters
        ----------
        why : str
        utc : datetime
        synced_on : PierSide, optional
            On which side the tube hung, if it was a sync.

        Returns
        -------
        dict
            For the journal.
        """
        before, self.segment_id = self.segment_id, new_id()
        self.since_utc, self.why, self.side_of_last_sync = utc, why, synced_on
        for listener in self._listeners:
            listener(self.segment_id, why)
        return {
            "segment_id": self.segment_id,
            "before": before,
            "why": why,
            "side": None if synced_on is None else str(synced_on),
        }

    def seen_on(self, side: PierSide | None) -> dict[str, object] | None:
        """Take note of the side in a reading; what there is to write down if it has changed, else None."""
        if side is None or side is PierSide.UNKNOWN:
            return None
        before, self.side = self.side, side
        if before is None or before is side:
            return None
        synced = self.side_of_last_sync
        return {
            "segment_id": self.segment_id,
            "side": str(side),
            "before": str(before),
            "sync_counts_here": synced is None or synced is side,
        }
