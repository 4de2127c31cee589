"""What a family of mounts must be able to say; `drivers.generic.mount` makes a whole mount of it.

A language owns its link, knows the order of commands that make a reading or an order, and the meaning of the
answers. It does not follow slews, classify syncs, repeat stops, filter readings, watch the link or decide
whether a position is trusted: that is the same for all families and stands in `drivers.generic`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol

from drivers.wire.wire_log import WireLog
from mountnav.devices import (
    Direction,
    Epoch,
    MountAxis,
    MountReading,
    OffsetRates,
    PierSide,
    RateSpan,
    Skill,
    TrackingRate,
)
from mountnav.errors import DeviceError, DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent, Icrs, Site


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answered.

    Attributes
    ----------
    text : str
        In words: product, firmware, dialect.
    problems : tuple of str
        What an operator should know about it.
    doubt : str
        Why its position can't be trusted at first; empty where nothing speaks against it.
    """

    text: str
    problems: tuple[str, ...] = ()
    doubt: str = ""


@dataclass(frozen=True, slots=True)
class Readout:
    """One reading of the mount, not yet filtered.

    Attributes
    ----------
    place : Apparent or Icrs
        Of the kind that the language's `epoch` says.
    utc : datetime
        Aware UTC, in the middle between question and answer.
    span_s : float
        How long the questions for the position took together: a moving mount went on meanwhile.
    slewing, tracking, parked, at_home : bool or None
        None where the mount doesn't report it.
    fresh : bool
        The mount shows that it was just switched on and knows nothing: not aligned, not initialized.
    doubtful : bool
        An answer had to be asked again.
    failed : str
        What the mount reports as wrong with the last order to move; kept until the next one.
    """

    place: Apparent | Icrs
    utc: datetime
    span_s: float = 0.0
    slewing: bool | None = None
    tracking: bool | None = None
    parked: bool | None = None
    at_home: bool | None = None
    pier_side: PierSide | None = None
    fresh: bool = False
    doubtful: bool = False
    failed: str = ""

    @property
    def reading(self) -> MountReading:
        """The part that is published."""
        return MountReading(
            self.place,
            self.utc,
            self.slewing,
            self.tracking,
            self.parked,
            self.at_home,
            self.pier_side,
        )


@dataclass(frozen=True, slots=True)
class Sent:
    """What became of an order that is sent once.

    Attributes
    ----------
    wire : bool
        Whether it went out; False when it was no longer wanted.
    lost : DeviceError or None
        Its answer did not come or made no sense: only the readings show whether the order was accepted.
    """

    wire: bool = True
    lost: DeviceError | None = None


Wanted = Callable[[], bool]
"""Called right before an order goes out; False when a stop has come meanwhile."""


class Language(Protocol):
    """What a family can say. Each method may raise `DeviceSilent`, `DeviceGarbled` or `DeviceMissing`.

    Orders raise `DeviceRefused` with a reason when the mount refuses; then nothing moves and nothing changed.
    """

    @property
    def device(self) -> str:
        """Address, for messages."""
        ...

    @property
    def log(self) -> WireLog:
        """The latest messages on its wire."""
        ...

    @property
    def usable(self) -> bool:
        """Whether its link is open and not lost."""
        ...

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates it is set to speak."""
        ...

    @property
    def usual_epoch(self) -> Epoch:
        """Kind of coordinates that its family speaks by default; another one is reported at connecting."""
        ...

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step of a commanded or reported position; known after `open`."""
        ...

    @property
    def skills(self) -> frozenset[Skill]:
        """What it can do; known after `open`."""
        ...

    @property
    def tracking_rates(self) -> frozenset[TrackingRate]:
        """At which rates it can track; known after `open`, empty where tracking can't be ordered."""
        ...

    @property
    def guide_rates_deg_s(self) -> tuple[float, float] | None:
        """Guide speed in right ascension and in declination, if the mount reported it at `open`."""
        ...

    @property
    def silent_refusals(self) -> bool:
        """Whether it answers an impossible slew like a possible one: nothing moves, then it was refused."""
        ...

    def unanswered_s(self) -> float:
        """How long a question has been waiting for its first good answer; 0 when none is waiting."""
        ...

    async def open(self) -> Identity:
        """Open the link, or open it again, and identify the mount. Moves, syncs and sets nothing."""
        ...

    async def close(self) -> None:
        """Release the link; closing twice is fine."""
        ...

    async def lost(self) -> str:
        """Wait until the open link is lost, and return why."""
        ...

    async def readout(self) -> Readout:
        """Read the mount once."""
        ...

    async def send_slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a slew, tracking afterwards."""
        ...

    async def next_leg(self, place: Apparent | Icrs, wanted: Wanted) -> bool:
        """At rest beside the target: order the rest of the way; False when nothing is left to do."""
        ...

    async def send_sync(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a sync."""
        ...

    async def send_stop(self, again: int) -> None:
        """Stop all motion, past every other exchange; `again` counts the repetitions from 0."""
        ...

    async def send_park(self, wanted: Wanted) -> Sent:
        """Order parking."""
        ...

    async def send_unpark(self) -> None:
        """Order unparking."""
        ...

    async def send_home(self, wanted: Wanted) -> Sent:
        """Order homing."""
        ...

    async def send_set_park(self) -> None:
        """Take the present position as the park position."""
        ...

    async def send_tracking(self, on: bool, rate: TrackingRate) -> None:
        """Order tracking."""
        ...

    async def send_guide(self, direction: Direction, duration_s: float, wanted: Wanted) -> Sent:
        """Order a guide pulse: timed by the mount, or timed here and ended in every case."""
        ...

    async def guiding(self) -> bool | None:
        """Whether the mount reports a guide pulse as running; None where it can't."""
        ...

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """The largest rates beside the sidereal one, both positive; None where the protocol has no bound."""
        ...

    @property
    def offset_step_arcsec_s(self) -> float:
        """Coarsest step to which it rounds such rates, ″/s; 0 where the protocol carries any number."""
        ...

    async def send_offset_rates(self, rates: OffsetRates) -> None:
        """Order tracking at rates beside the sidereal one, in the protocol's own units and signs."""
        ...

    def rounded_rates(self, rates: OffsetRates) -> OffsetRates:
        """What is left of such rates when the protocol has rounded them."""
        ...

    async def read_offset_rates(self) -> OffsetRates | None:
        """The rates that the mount says it tracks at beside the sidereal one; None where it can't."""
        ...

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """At which speeds its axes can be moved on by hand; empty where they can't."""
        ...

    def direction_unsure(self, axis: MountAxis) -> bool:
        """Whether which way an axis will go is a guess that the next readings can prove or refute."""
        ...

    def direction_seen(self, axis: MountAxis, *, rightly: bool) -> None:
        """An axis whose direction was a guess went as it was ordered, or the other way."""
        ...

    async def send_move_axis(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        """Order an axis to move on at a speed beside tracking; 0 ends it."""
        ...

    async def read_clock(self) -> datetime | None:
        """Its clock, aware UTC, corrected for the transfer time; None if it has none."""
        ...

    async def write_clock(self, utc: datetime) -> None:
        """Set its clock (and the zone, if it needs one, to UTC)."""
        ...

    async def read_site(self) -> Site | None:
        """The site that it is set to, longitude east; None if it has none."""
        ...

    async def write_site(self, site: Site) -> None:
        """Set its site."""
        ...

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """The side of the pier after a slew to a position; None if it can't say."""
        ...


class Unskilled:
    """A language without any optional skill; a family's language inherits and overrides what it can do."""

    _why = "its protocol has no such command"
    """The reason that a refusal gives; a family may override it."""

    @property
    def device(self) -> str:
        """Address, for messages."""
        raise NotImplementedError

    def _unsupported(self, what: str) -> DeviceRefused:
        return DeviceRefused(f"can't {what}: {self._why}", device=self.device, reason=Refusal.UNSUPPORTED)

    @property
    def guide_rates_deg_s(self) -> tuple[float, float] | None:
        """None."""
        return None

    @property
    def silent_refusals(self) -> bool:
        """No."""
        return False

    async def next_leg(self, place: Apparent | Icrs, wanted: Wanted) -> bool:
        """Nothing more to do."""
        return False

    async def send_park(self, wanted: Wanted) -> Sent:
        """Refused."""
        raise self._unsupported("park")

    async def send_unpark(self) -> None:
        """Refused."""
        raise self._unsupported("unpark")

    async def send_home(self, wanted: Wanted) -> Sent:
        """Refused."""
        raise self._unsupported("home")

    async def send_set_park(self) -> None:
        """Refused."""
        raise self._unsupported("set a park position")

    async def send_tracking(self, on: bool, rate: TrackingRate) -> None:
        """Refused."""
        raise self._unsupported("switch tracking")

    async def send_guide(self, direction: Direction, duration_s: float, wanted: Wanted) -> Sent:
        """Refused."""
        raise self._unsupported("guide")

    async def guiding(self) -> bool | None:
        """None: it can't say."""
        return None

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """None."""
        return None

    @property
    def offset_step_arcsec_s(self) -> float:
        """0: none."""
        return 0.0

    async def send_offset_rates(self, rates: OffsetRates) -> None:
        """Refused."""
        raise self._unsupported("track at offset rates")

    def rounded_rates(self, rates: OffsetRates) -> OffsetRates:
        """The same: none are rounded, or the mount says to what."""
        return rates

    async def read_offset_rates(self) -> OffsetRates | None:
        """None."""
        return None

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """None of them."""
        return {}

    def direction_unsure(self, axis: MountAxis) -> bool:
        """No."""
        return False

    def direction_seen(self, axis: MountAxis, *, rightly: bool) -> None:
        """Nothing to learn."""

    async def send_move_axis(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        """Refused."""
        raise self._unsupported("move an axis")

    async def read_clock(self) -> datetime | None:
        """None."""
        return None

    async def write_clock(self, utc: datetime) -> None:
        """Refused."""
        raise self._unsupported("take a time")

    async def read_site(self) -> Site | None:
        """None."""
        return None

    async def write_site(self, site: Site) -> None:
        """Refused."""
        raise self._unsupported("take a site")

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """None."""
        return None
