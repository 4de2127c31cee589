"""What the drivers behind a server say: properties with their latest values, and readings from them.

Claims, not truths: "Ok" says that a driver is content, not that a mount has arrived. What is not defined is
not there: a property that was set before it was defined, or after it was deleted, is passed over, for drivers
carry out orders to deleted properties too; so is an element that its property doesn't have.

Functions of the device's properties, each None where the driver has no such property or doesn't know.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

from drivers.indi.codec.messages import Changed, Defined, Deleted, Event, Kind, State, Value
from mountnav.devices import Epoch, PierSide, Skill
from mountnav.sky.coordinates import Apparent, Icrs, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

_EACH_BYTES = 300
"""What a property or an element takes in memory besides its texts, about."""


@dataclass(frozen=True, slots=True)
class Property:
    """One property as its driver last sent it.

    Attributes
    ----------
    state : State
        The driver's claim.
    values : dict
        By element.
    told : datetime
        When its driver last sent it, our clock, aware UTC.
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
    """The properties of all devices that a connection receives news of."""

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
        """Take what was sent, and return the property it is about if it is there now."""
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
                    | {name: value for name, value in event.values.items() if name in before.values},
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
            forgotten = own.pop(gone, None)
            if forgotten is not None:
                self._properties -= 1
                self.size_bytes -= forgotten.size_bytes
        if not own:
            self._by_device.pop(device, None)


Get = Callable[[str], Property | None]
COORDINATES: dict[Epoch, str] = {"apparent": "EQUATORIAL_EOD_COORD", "icrs": "EQUATORIAL_COORD"}
LONGEST_POLL_S = 2.0
"""A driver's polling period is not taken for longer than this, or readings of a mount that polls once a
minute would never be confirmed. Chosen by hand."""
USUAL_POLL_S = 1.0
"""The polling period of a driver that does not say it: INDI's default, 1000 ms."""
_FARTHEST_DEC_DEG = 95.0
"""Declinations beyond this are nonsense. More than 90, since a driver may extrapolate over the pole; chosen
by hand."""


def skills(get: Get) -> frozenset[Skill]:
    """What a mount can do, by the properties that its driver has."""
    park, home, option = get("TELESCOPE_PARK"), get("TELESCOPE_HOME"), get("TELESCOPE_PARK_OPTION")
    clock, site = get("TIME_UTC"), get("GEOGRAPHIC_COORD")
    pulses = get("TELESCOPE_TIMED_GUIDE_NS"), get("TELESCOPE_TIMED_GUIDE_WE")
    there = {
        Skill.PARK: _has(park, "PARK"),
        Skill.UNPARK: _has(park, "UNPARK"),
        Skill.SET_PARK: _has(option, "PARK_CURRENT"),
        Skill.HOME: _has(home, "GO") or _has(home, "FIND"),
        Skill.FIND_HOME: _has(home, "FIND") and not _has(home, "GO"),
        Skill.TRACK: _has(get("TELESCOPE_TRACK_STATE"), "TRACK_ON"),
        Skill.TRACKING_RATES: get("TELESCOPE_TRACK_MODE") is not None,
        Skill.GUIDE: None not in pulses,
        Skill.PIER_SIDE: get("TELESCOPE_PIER_SIDE") is not None,
        Skill.CLOCK: clock is not None,
        Skill.SET_CLOCK: writable(clock),
        Skill.SITE: site is not None,
        Skill.SET_SITE: writable(site),
    }
    return frozenset(skill for skill, can in there.items() if can)


def _has(one: Property | None, switch: str) -> bool:
    return one is not None and one.on(switch) is not None


def writable(one: Property | None) -> bool:
    """Whether a property is there and takes orders."""
    return one is not None and "w" in one.perm


def place(coordinates: Property, epoch: Epoch, utc: datetime) -> Apparent | Icrs | None:
    """Read a place; None if it is none.

    Some drivers count right ascensions on beyond 24 h or below 0, and EQMod declinations on past the pole:
    90.3° is 89.7° on the other side.
    """
    ra_h, dec_deg = coordinates.number("RA"), coordinates.number("DEC")
    if ra_h is None or dec_deg is None or not (-24.0 <= ra_h < 48.0 and abs(dec_deg) <= _FARTHEST_DEC_DEG):
        return None
    ra_deg = ra_h * 15.0
    if abs(dec_deg) > 90.0:
        ra_deg, dec_deg = ra_deg + 180.0, math.copysign(180.0, dec_deg) - dec_deg
    ra_deg %= 360.0
    return Icrs(ra_deg, dec_deg) if epoch == "icrs" else Apparent(ra_deg, dec_deg, utc)


def apart_arcsec(coordinates: Property | None, other: Apparent | Icrs | None) -> float:
    """How far coordinates lie from a place of their kind; infinite if one of them is none."""
    if coordinates is None or other is None:
        return math.inf
    here = place(coordinates, "icrs", datetime.min)
    if here is None:
        return math.inf
    return separation_arcsec(Icrs(here.ra_deg, here.dec_deg), Icrs(other.ra_deg, other.dec_deg))


def is_real(coordinates: Property | None) -> bool:
    """Whether coordinates can be a place: zeros are what drivers define before they have read one."""
    return coordinates is not None and (coordinates.number("RA"), coordinates.number("DEC")) != (0.0, 0.0)


def slewing(coordinates: Property, get: Get) -> bool:
    """Whether it moves by an order: to coordinates, to park, home, or as long as a button is held."""
    orders = (coordinates, get("TELESCOPE_PARK"), get("TELESCOPE_HOME"))
    if any(order is not None and order.state is State.BUSY for order in orders):
        return True
    buttons = (get("TELESCOPE_MOTION_NS"), get("TELESCOPE_MOTION_WE"))
    return any(button is not None and True in button.values.values() for button in buttons)


def tracking(get: Get) -> bool | None:
    """Whether it follows the sky."""
    state = get("TELESCOPE_TRACK_STATE")
    return None if state is None else state.on("TRACK_ON")


def parked(get: Get) -> bool | None:
    """Whether it is parked; on the way there it is not."""
    park = get("TELESCOPE_PARK")
    return None if park is None else park.on("PARK") is True and park.state is not State.BUSY


def at_home(get: Get, homed: bool) -> bool | None:
    """Whether it is at home: only at the end of a homing does a driver say so, and its Ok stays for ever.

    Parameters
    ----------
    homed : bool
        Whether homing was the last order to move.
    """
    home = get("TELESCOPE_HOME")
    if home is None:
        return None
    if home.state is State.BUSY:
        return False
    return True if homed and home.state is State.OK else None


def pier_side(get: Get) -> PierSide | None:
    """On which side the tube hangs: INDI counts as ASCOM does, east looks west."""
    side = get("TELESCOPE_PIER_SIDE")
    if side is None:
        return None
    west, east = side.on("PIER_WEST") is True, side.on("PIER_EAST") is True
    if west == east:
        return PierSide.UNKNOWN
    return PierSide.WEST if west else PierSide.EAST


def poll_s(get: Get) -> float:
    """How often its driver reads the mount; never taken for longer than two seconds."""
    period = get("POLLING_PERIOD")
    told_ms = None if period is None else period.number("PERIOD_MS")
    return USUAL_POLL_S if not told_ms else min(max(told_ms / 1000.0, 0.05), LONGEST_POLL_S)


def clock(get: Get, now: datetime) -> datetime | None:
    """Its clock now, if its driver ever sent it unasked: what it sends when asked may be hours old."""
    time = get("TIME_UTC")
    if time is None or time.pushed is None or time.state is State.ALERT:
        return None
    try:
        told = datetime.fromisoformat((time.text("UTC") or "").strip().rstrip("Z"))
        return told.replace(tzinfo=UTC) + (now - time.pushed)
    except (ValueError, OverflowError):
        return None


def site(get: Get) -> Site | None:
    """Where its driver believes to stand; INDI counts longitudes from 0 to 360 east."""
    told = get("GEOGRAPHIC_COORD")
    if told is None:
        return None
    latitude_deg, longitude_deg = told.number("LAT"), told.number("LONG")
    if latitude_deg is None or longitude_deg is None or not abs(latitude_deg) <= 90.0:
        return None
    if (latitude_deg, longitude_deg) == (0.0, 0.0) and told.state is State.IDLE:
        # never sent
        return None
    return Site(latitude_deg, half_turn_deg(longitude_deg), told.number("ELEV") or 0.0)
