"""What the drivers behind a server say of themselves, as values: each property with its latest claims.

Claims, not truths: "Ok" says that a driver is content, not that a mount has arrived. What is not defined is
not there: a property that was set before it was defined, or after it was deleted, is passed over, for drivers
carry out orders to deleted properties too; so is an element that its property doesn't have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from datetime import datetime

from drivers.indi.codec import Changed, Defined, Deleted, Event, Kind, State, Value

_EACH_BYTES = 300
"""What a property or an element takes in memory besides its texts, about."""


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

    @property
    def size_bytes(self) -> int:
        """What it takes in memory, about."""
        texts = (self.device, self.name, self.perm, self.rule, *self.values)
        told = sum(len(value) for value in self.values.values() if isinstance(value, str))
        return _EACH_BYTES * (1 + len(self.values)) + sum(map(len, texts)) + told


@dataclass(slots=True)
class Properties:
    """The properties of all devices that a connection hears of."""

    _by_device: dict[str, dict[str, Property]] = field(default_factory=dict)
    count: int = 0
    size_bytes: int = 0
    """What all of them take in memory, about."""
    _properties: int = 0

    def __len__(self) -> int:
        """How many there are."""
        return self._properties

    def get(self, device: str, name: str) -> Property | None:
        """One property, or None if it is not defined."""
        return self._by_device.get(device, {}).get(name)

    def of(self, device: str) -> dict[str, Property]:
        """All properties of a device, by name."""
        return dict(self._by_device.get(device, {}))

    def devices(self) -> list[str]:
        """Devices that have properties."""
        return sorted(self._by_device)

    def clear(self) -> None:
        """Forget all: the connection they came by is gone."""
        self._by_device.clear()
        self._properties = self.size_bytes = 0

    def take(self, event: Event, utc: datetime, at_s: float) -> Property | None:
        """Take what was told in, and return the property it is about if it is there now."""
        match event:
            case Defined(device=device, name=name):
                self.count += 1
                before = self.get(device, name)
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
                before = self.get(device, name)
                if before is None or before.kind != event.kind:
                    return None
                now = replace(
                    before,
                    state=before.state if event.state is None else event.state,
                    # files are for those who wait for them: they are not kept
                    values=before.values
                    if event.kind == "BLOB"
                    else before.values
                    | {one: to for one, to in event.values.items() if one in before.values},
                    told=utc,
                    told_s=at_s,
                    count=self.count,
                    pushed=utc,
                )
            case Deleted(device=device, name=name):
                self.count += 1
                self._forget(device, name)
                return None
            case _:
                self.count += 1
                return None
        self._keep(now, before)
        return now

    def _keep(self, now: Property, before: Property | None) -> None:
        self._by_device.setdefault(now.device, {})[now.name] = now
        self._properties += before is None
        self.size_bytes += now.size_bytes - (0 if before is None else before.size_bytes)

    def _forget(self, device: str, name: str) -> None:
        """Forget one, or with an empty name the whole device."""
        own = self._by_device.get(device, {})
        for gone in [name] if name else list(own):
            one = own.pop(gone, None)
            if one is not None:
                self._properties -= 1
                self.size_bytes -= one.size_bytes
        if not own:
            self._by_device.pop(device, None)
