"""What went over a wire lately: a ring of raw messages with their instants, always on.

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
KEPT = 4000


@dataclass(frozen=True, slots=True)
class WireEntry:
    """One message.

    Attributes
    ----------
    number : int
        Counts from 1, also past what the ring has dropped.
    t_s : float
        Since the log was begun, monotonic.
    way : {"driver->mount", "mount->driver", "event"}
    data : bytes
        Empty for events.
    meaning : str
    """

    number: int
    t_s: float
    way: Way
    data: bytes
    meaning: str

    def as_json(self) -> str:
        """One line, as the recorded dialogues have it."""
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
        Seconds; those of the present.
    """

    def __init__(self, kept: int = KEPT, monotonic: Callable[[], float] = seconds) -> None:
        self._ring: deque[WireEntry] = deque(maxlen=kept)
        self._monotonic = monotonic
        self._began = monotonic()
        self._lock = threading.Lock()
        self._count = 0
        self._listeners: list[Callable[[WireEntry], None]] = []

    def listen(self, listener: Callable[[WireEntry], None]) -> None:
        """Tell of each message as it is kept, in the thread that notes it."""
        self._listeners.append(listener)

    @property
    def count(self) -> int:
        """Number of the newest entry; 0 at first."""
        return self._count

    def now_s(self) -> float:
        """The present instant on the log's own clock."""
        return self._monotonic() - self._began

    def note(self, way: Way, data: bytes = b"", meaning: str = "") -> None:
        """Keep a message."""
        with self._lock:
            self._count += 1
            entry = WireEntry(self._count, self.now_s(), way, bytes(data), meaning)
            self._ring.append(entry)
            for listener in self._listeners:
                listener(entry)

    def entries(self, after: int = 0) -> list[WireEntry]:
        """Entries that are still there, oldest first, with numbers above `after`."""
        with self._lock:
            return [entry for entry in self._ring if entry.number > after]

    def lines(self, header: Mapping[str, object] | None = None, after: int = 0) -> Iterator[str]:
        """JSON lines of `entries`, a header first if one is given."""
        if header is not None:
            yield json.dumps({"t": 0, "dir": "header", **header})
        for entry in self.entries(after):
            yield entry.as_json()
