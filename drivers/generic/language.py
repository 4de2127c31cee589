"""What a family of mounts must be able to say; `drivers.generic` makes a whole mount of it.

A language owns its link, knows the order of commands that make a reading or an order, and the meaning of the
answers. It does not follow slews, classify syncs, repeat stops, judge readings, watch the link or decide
whether a position counts: that is the same for all families and stands in `drivers.generic`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol

from drivers.wire.wire_log import WireLog
from mountnav.devices import Direction, Epoch, MountReading, PierSide, Skill, TrackingRate
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
        What an operator should know of it.
    doubt : str
        Why its position doesn't count for the present; empty where nothing speaks against it.
    """

    text: str
    problems: tuple[str, ...] = ()
    doubt: str = ""


@dataclass(frozen=True, slots=True)
class Readout:
    """One look at the mount, not yet judged.

    Attributes
    ----------
    place : Apparent or Icrs
        Of the kind that the language's `epoch` says.
    utc : datetime
        Aware UTC, in the middle between question and answer.
    span_s : float
        How long the questions for the place took together: a moving mount went on meanwhile.
    slewing, tracking, parked, at_home : bool or None
        None where it can't tell.
    pier_side : PierSide or None
    fresh : bool
        It shows that the mount has been switched on and knows nothing: not aligned, not initialized.
    doubtful : bool
        Something went wrong on the way to it (an answer asked again).
    failed : str
        What it says went wrong with the last order to move, if it says so; kept until the next one.
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
        """What is published of it."""
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
        Its answer did not come or made no sense: whether it was taken up must be seen in the readings.
    """

    wire: bool = True
    lost: DeviceError | None = None


Wanted = Callable[[], bool]
"""Asked right before an order goes out; False when a stop has come meanwhile."""


class Language(Protocol):
    """What a family can say. Each method may raise `DeviceSilent`, `DeviceGarbled` or `DeviceMissing`.

    Orders raise `DeviceRefused` with a reason when the mount says no; then nothing moves and nothing changed.
    """

    @property
    def device(self) -> str:
        """Address, for messages."""
        ...

    @property
    def log(self) -> WireLog:
        """All that went over its wire lately."""
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
        """Kind of coordinates its family speaks by itself: another setting is worth a word at connecting."""
        ...

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step of a commanded or reported place, known after `open`."""
        ...

    @property
    def skills(self) -> frozenset[Skill]:
        """What it can do, known after `open`."""
        ...

    @property
    def tracking_rates(self) -> frozenset[TrackingRate]:
        """At which rates it can be told to follow, known after `open`; none where it can't be told."""
        ...

    @property
    def guide_rates_deg_s(self) -> tuple[float, float] | None:
        """How fast a pulse moves in right ascension and in declination, if it told that at `open`."""
        ...

    @property
    def silent_refusals(self) -> bool:
        """Whether it answers a slew it won't do like one it will: then nothing moving means refused."""
        ...

    def unanswered_s(self) -> float:
        """Since when a question has been waiting for its first good answer; 0 when none is."""
        ...

    async def open(self) -> Identity:
        """Open the link and find out who is there. Moves, syncs and sets nothing. Reopening is the same."""
        ...

    async def close(self) -> None:
        """Release the link; closing twice is fine."""
        ...

    async def lost(self) -> str:
        """Wait until the open link is lost, and tell why."""
        ...

    async def readout(self) -> Readout:
        """Look at the mount."""
        ...

    async def send_slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a slew, tracking afterwards."""
        ...

    async def next_leg(self, place: Apparent | Icrs, wanted: Wanted) -> bool:
        """At rest, not there yet: order what remains, or say False when there is nothing more to do."""
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
        """Take the present place for the park position."""
        ...

    async def send_tracking(self, on: bool, rate: TrackingRate) -> None:
        """Order tracking."""
        ...

    async def send_guide(self, direction: Direction, duration_s: float, wanted: Wanted) -> Sent:
        """Order a guide pulse that the mount times itself, or time it (and end it in every case)."""
        ...

    async def guiding(self) -> bool | None:
        """Whether a guide pulse still runs, by the mount's own word; None where it has none for that."""
        ...

    async def read_clock(self) -> datetime | None:
        """Its clock, aware UTC, corrected for the way; None if it has none."""
        ...

    async def write_clock(self, utc: datetime) -> None:
        """Set its clock (and the zone, if it needs one, to UTC)."""
        ...

    async def read_site(self) -> Site | None:
        """Where it believes to stand, longitude east; None if it doesn't know."""
        ...

    async def write_site(self, site: Site) -> None:
        """Tell it where it stands."""
        ...

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """On which side it would look at a place; None if it can't tell."""
        ...


class Unskilled:
    """Answers of a language for all it can't do; a family's language is made on top of it."""

    _why = "its protocol has no such command"

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
        """None: it can't tell."""
        return None

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
