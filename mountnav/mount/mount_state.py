"""What is known of a mount: its readings, whether they count, its segment; and who listens.

A segment is the time in which the mount's zero points stay what they are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime

from mountnav.clock import Clock
from mountnav.devices import Announces, Mount, MountReading, PierSide, Trusts
from mountnav.journal.records import EntryKind, new_id
from mountnav.mount.order_book import OrderBook

SegmentListener = Callable[[str, str], None]

SEEN_LATE = "a sync was seen, late"
"""Why a segment begins when a sync shows that had seemed to be ignored."""


class Segments:
    """The segment a mount is in.

    Attributes
    ----------
    side_of_last_sync : PierSide or None
        On which the tube hung when this segment's zero points were synced; None if they weren't.
    side : PierSide or None
        On which it hung in the last reading that reported it.
    """

    def __init__(self) -> None:
        self.segment_id = new_id()
        self.side_of_last_sync: PierSide | None = None
        self.side: PierSide | None = None
        self._listeners: list[SegmentListener] = []

    def listen(self, listener: SegmentListener) -> None:
        """Tell `listener(segment_id, why)` of each new segment."""
        self._listeners.append(listener)

    def begin(self, why: str, synced_on: PierSide | None = None) -> dict[str, object]:
        """Begin a new segment.

        Parameters
        ----------
        synced_on : PierSide, optional
            On which side the tube hung, if it was a sync.

        Returns
        -------
        dict
            For the journal.
        """
        before, self.segment_id = self.segment_id, new_id()
        self.side_of_last_sync = synced_on
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


Listener = Callable[[str, Mapping[str, object]], None]


class MountState:
    """What is known of one mount, and who listens.

    Parameters
    ----------
    mount : Mount
        Read, and listened to if it announces anything.

    Attributes
    ----------
    last_motion_utc : datetime or None
        End of the last order that moved the mount or gave it other zero points, or may have.
    """

    def __init__(self, mount: Mount, book: OrderBook, clock: Clock) -> None:
        self._mount = mount
        self._book = book
        self._clock = clock
        self.segments = Segments()
        self.last_motion_utc: datetime | None = None
        self._distrusted = ""
        self._why = ""
        self._listeners: list[Listener] = []
        self._reading_listeners: list[Callable[[MountReading], None]] = []
        if isinstance(mount, Announces):
            mount.listen(self._mount_said)

    # -- where it is -------------------------------------------------------------------------------

    async def reading(self) -> MountReading:
        """Where the mount believes it points; a change of sides is written down."""
        reading = await self._mount.reading()
        changed = self.segments.seen_on(reading.pier_side)
        if changed is not None:
            self._book.note_now(EntryKind.SEGMENT, "the tube is on the other side of the pier", changed)
        for listener in self._reading_listeners:
            listener(reading)
        return reading

    def moved(self) -> None:
        """An order that moves it, or may have, has ended now."""
        self.last_motion_utc = self._clock.utc()

    def new_segment(self, why: str, synced_on: PierSide | None = None) -> None:
        """Begin a new segment, and write that down."""
        self._book.note_now(EntryKind.SEGMENT, why, self.segments.begin(why, synced_on))

    # -- whether that counts -----------------------------------------------------------------------

    @property
    def trusted(self) -> bool:
        """Whether its own position counts."""
        return not self._distrusted and (not isinstance(self._mount, Trusts) or self._mount.trusted)

    @property
    def why_untrusted(self) -> str:
        """Why it doesn't, as it was reported last; empty while it does."""
        return "" if self.trusted else self._distrusted or self._why

    def trust(self, why: str = "trusted by an operator") -> None:
        """Let the position count from now on: an operator's word, or what the sky has shown."""
        self._book.note_now(EntryKind.DECISION, why, {"was_trusted": self.trusted})
        self._distrusted = ""
        if isinstance(self._mount, Trusts):
            self._mount.trust()

    def distrust(self, why: str) -> None:
        """Let its position not count until a sync is seen, its home is found, or an operator says so."""
        if not self._distrusted:
            self._mount_said("untrusted", {"why": why})
        self._distrusted = why

    def regained(self) -> None:
        """A sync was seen or its home was found: what spoke against its position is over."""
        self._distrusted = ""

    # -- who listens -------------------------------------------------------------------------------

    def listen(self, listener: Listener) -> None:
        """Call `listener(what, facts)` on events of the link, the position, and the limits."""
        self._listeners.append(listener)

    def on_reading(self, listener: Callable[[MountReading], None]) -> None:
        """Call `listener` with each reading, for whatever purpose it was taken."""
        self._reading_listeners.append(listener)

    def tell(self, what: str, facts: Mapping[str, object]) -> None:
        """Call all listeners."""
        for listener in self._listeners:
            listener(what, facts)

    def _mount_said(self, what: str, facts: Mapping[str, object]) -> None:
        """Write down what the mount announces, and pass it on."""
        kind = EntryKind.LINK if what.startswith("link") or what == "connected" else EntryKind.FAULT
        self._book.note_now(kind, what, facts)
        if what == "untrusted":
            self._why = str(facts.get("why") or "")
        if what in ("untrusted", "sync-late"):
            why = f"untrusted: {facts.get('why')}" if what == "untrusted" else SEEN_LATE
            side = (self.segments.side or PierSide.UNKNOWN) if what == "sync-late" else None
            self.new_segment(why, side)
            if what == "sync-late":
                self.regained()
            self.moved()
        self.tell(what, facts)
