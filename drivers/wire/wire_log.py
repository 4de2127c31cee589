"""The latest messages on a wire: a ring of raw bytes with their times, always on.

Dumped as JSON lines it has the form of the recorded dialogues: ``{"t": 1.2041, "dir": "driver->mount",
"bytes": ":GR#", "hex": "3a475223", "meaning": "right ascension"}``, with a header line first.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from mountnav.clock import seconds

Way = Literal["driver->mount", "mount->driver", "event"]
"""Which way a message went; "event" is a remark of the driver's own, without bytes."""
KEPT = 4000
"""How many messages a log keeps. Chosen by hand: eight minutes of a mount that is read twice a second by two
questions each. Doubled, some hundred kilobytes more for each mount; halved, what led to a fault is gone
sooner."""


@dataclass(frozen=True, slots=True)
class WireEntry:
    """One message.

    Attributes
    ----------
    number : int
        Counts from 1; entries that the ring has dropped count too.
    t_s : float
        Since the log began, monotonic.
    data : bytes
        Empty for events.
    """

    number: int
    t_s: float
    way: Way
    data: bytes
    meaning: str

    def as_json(self) -> str:
        """One JSON line in the form of the recorded dialogues."""
        entry: dict[str, object] = {"t": round(self.t_s, 4), "dir": self.way}
        if self.way != "event":
            entry |= {"bytes": self.data.decode("latin-1"), "hex": self.data.hex()}
        return json.dumps(entry | {"meaning": self.meaning, "n": self.number})


class WireLog:
    """A ring of messages; written from any thread.

    Parameters
    ----------
    kept : int
        How many; older ones are dropped.
    monotonic : callable
        Gives seconds; by default those of the process's present, which may run fast.
    """

    def __init__(self, kept: int = KEPT, monotonic: Callable[[], float] = seconds) -> None:
        self._ring: deque[WireEntry] = deque(maxlen=kept)
        self._monotonic = monotonic
        self._began = monotonic()
        self._lock = threading.Lock()
        self._count = 0
        self._listeners: list[Callable[[WireEntry], None]] = []

    def listen(self, listener: Callable[[WireEntry], None]) -> None:
        """Call `listener` with each new entry, in the thread that notes it."""
        self._listeners.append(listener)

    @property
    def count(self) -> int:
        """Number of the newest entry; 0 while there is none."""
        return self._count

    def now_s(self) -> float:
        """Now, in seconds since the log began."""
        return self._monotonic() - self._began

    def note(self, way: Way, data: bytes = b"", meaning: str = "") -> None:
        """Add a message."""
        with self._lock:
            self._count += 1
            entry = WireEntry(self._count, self.now_s(), way, bytes(data), meaning)
            self._ring.append(entry)
            for listener in self._listeners:
                listener(entry)

    def entries(self, after: int = 0) -> list[WireEntry]:
        """Entries that are still kept, oldest first, with numbers above `after`."""
        with self._lock:
            return [entry for entry in self._ring if entry.number > after]

    def lines(self, header: Mapping[str, object] | None = None, after: int = 0) -> Iterator[str]:
        """JSON lines of `entries`, a header first if one is given."""
        if header is not None:
            yield json.dumps({"t": 0, "dir": "header", **header})
        for entry in self.entries(after):
            yield entry.as_json()
