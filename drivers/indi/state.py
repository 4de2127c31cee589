"""What the drivers behind a server say of themselves, as values: each property with its latest claims.

Claims, not truths: "Ok" says that a driver is content, not that a mount has arrived. What is not defined is
not there: an element that was set before its property was defined, or after it was deleted, is passed over,
for drivers carry out orders to deleted properties too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from datetime import datetime

from drivers.indi.codec import Changed, Defined, Deleted, Event, Kind, State, Value


@dataclass(frozen=True, slots=True)
class Property:
    """One property as it was last told.

    Attributes
    ----------
    device, name : str
    kind : {"Text", "Number", "Switch", "Light", "BLOB"}
    state : State
        The driver's claim.
    perm, rule : str
    values : dict
        By element.
    told : datetime
        When it was last told, our clock, aware UTC.
    told_s : float
        The same, monotonic.
    count : int
        How many messages had come until then, it included.
    pushed : datetime or None
        When it last came unasked, which is when it was true; what is asked for may be old.
    """

    device: str
    name: str
    kind: Kind
    state: State
    perm: str
    rule: str
    values: dict[str, Value]
    told: datetime
    told_s: float
    count: int
    pushed: datetime | None = None

    def number(self, element: str) -> float | None:
        """A number, or None if there is no such element, or its driver doesn't know it (NaN, infinity)."""
        value = self.values.get(element)
        return value if isinstance(value, float) and math.isfinite(value) else None

    def on(self, element: str) -> bool | None:
        """Whether a switch is on, or None if there is no such element."""
        value = self.values.get(element)
        return value if isinstance(value, bool) else None

    def text(self, element: str) -> str | None:
        """A text, or None if there is no such element."""
        value = self.values.get(element)
        return value if type(value) is str else None


@dataclass(slots=True)
class Properties:
    """The properties of all devices that a connection hears of."""

    _all: dict[tuple[str, str], Property] = field(default_factory=dict)
    count: int = 0

    def __len__(self) -> int:
        """How many there are."""
        return len(self._all)

    def get(self, device: str, name: str) -> Property | None:
        """One property, or None if it is not defined."""
        return self._all.get((device, name))

    def of(self, device: str) -> dict[str, Property]:
        """All properties of a device, by name."""
        return {name: one for (owner, name), one in self._all.items() if owner == device}

    def devices(self) -> list[str]:
        """Devices that have properties."""
        return sorted({device for device, _ in self._all})

    def clear(self) -> None:
        """Forget all: the connection they came by is gone."""
        self._all.clear()

    def take(self, event: Event, utc: datetime, at_s: float) -> Property | None:
        """Take what was told in, and return the property it is about if it is there now."""
        match event:
            case Defined(device=device, name=name):
                self.count += 1
                before = self._all.get((device, name))
                now = Property(
                    device=device,
                    name=name,
                    kind=event.kind,
                    state=event.state,
                    perm=event.perm,
                    rule=event.rule,
                    values=event.values,
                    told=utc,
                    told_s=at_s,
                    count=self.count,
                    pushed=None if before is None else before.pushed,
                )
            case Changed(device=device, name=name):
                self.count += 1
                before = self._all.get((device, name))
                if before is None or before.kind != event.kind:
                    return None
                now = replace(
                    before,
                    state=before.state if event.state is None else event.state,
                    # files are for those who wait for them: they are not kept
                    values=before.values if event.kind == "BLOB" else before.values | event.values,
                    told=utc,
                    told_s=at_s,
                    count=self.count,
                    pushed=utc,
                )
            case Deleted(device=device, name=name):
                self.count += 1
                if name:
                    self._all.pop((device, name), None)
                else:
                    for key in [key for key in self._all if key[0] == device]:
                        del self._all[key]
                return None
            case _:
                self.count += 1
                return None
        self._all[device, name] = now
        return now
