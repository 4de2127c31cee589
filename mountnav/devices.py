"""What a Mount and a Camera can do, the coordinates that a mount speaks, and what its syncs come to.

Small and async; drivers fulfil these protocols. The law of a sync (`SyncLaw`) stands here since all have to
keep it: the drivers, the room `mount`, and navigation.

A sync is seen when the mount believes to be near to where it was synced. Else it has ignored the sync if it
believes what it did before, and if not, it has taken another place: half of what was sent (one coordinate of
two), or a damaged number. That is the worst of all: slews by such a belief go anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from enum import StrEnum
from typing import Literal, Protocol, runtime_checkable

from mountnav.frames import Frame
from mountnav.sky.chain import apparent_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.units import ARCSEC_PER_DEG, DEG_PER_HOUR, SECONDS_PER_HOUR

Epoch = Literal["apparent", "icrs"]


class PierSide(StrEnum):
    """On which side of the pier the tube hangs, as ASCOM counts: east looks west, the normal posture."""

    EAST = "east"
    WEST = "west"
    UNKNOWN = "unknown"

    @property
    def other(self) -> PierSide:
        """The side after a flip."""
        return _OTHER.get(self, self)


_OTHER = {PierSide.EAST: PierSide.WEST, PierSide.WEST: PierSide.EAST}


class TrackingRate(StrEnum):
    """How fast the hour angle axis follows."""

    SIDEREAL = "sidereal"
    LUNAR = "lunar"
    SOLAR = "solar"
    KING = "king"
    CUSTOM = "custom"


TRACKING_DEG_S: Mapping[TrackingRate, float] = {
    TrackingRate.SIDEREAL: SIDEREAL_DEG_S,
    TrackingRate.LUNAR: 14.511415 / ARCSEC_PER_DEG,
    TrackingRate.SOLAR: DEG_PER_HOUR / SECONDS_PER_HOUR,
    TrackingRate.KING: 15.0369 / ARCSEC_PER_DEG,
}
"""How fast the hour angle axis turns at each rate that isn't the user's own, degrees per second, as INDI and
the hand controls have them [INDI inditelescope.h]: the mean Moon, the mean Sun, and a star at the pole in
mean refraction (King). Doubled, whatever is followed is lost in a minute."""


class Direction(StrEnum):
    """Where a guide pulse moves the tube: north raises the declination, west the hour angle."""

    NORTH = "n"
    SOUTH = "s"
    EAST = "e"
    WEST = "w"


@dataclass(frozen=True, slots=True)
class OffsetRates:
    """Rates beside the sidereal one: how a target that moves among the stars is tracked.

    Both are in the mount's own kind of coordinates (`Mount.epoch`) and per second of time as clocks count it,
    not per sidereal second. Drivers alone know in which units and with which signs a protocol wants them.

    Attributes
    ----------
    ra_arcsec_s : float
        Change of the right ascension, ″/s, not times cos δ; positive where it grows (to the east).
    dec_arcsec_s : float
        Change of the declination, ″/s; positive to the north.
    """

    ra_arcsec_s: float
    dec_arcsec_s: float

    @property
    def none(self) -> bool:
        """Whether they are those of a star."""
        return self.ra_arcsec_s == 0.0 and self.dec_arcsec_s == 0.0


STARS_RATES = OffsetRates(0.0, 0.0)
"""Those of a target that doesn't move among the stars."""

MountAxis = Literal["primary", "secondary"]
"""An axis as ASCOM counts them: right ascension or azimuth, and declination or altitude."""


@dataclass(frozen=True, slots=True)
class RateSpan:
    """Speeds at which an axis can be moved on by hand, °/s, both above or at 0; the ends belong to it."""

    least_deg_s: float
    most_deg_s: float


class Skill(StrEnum):
    """What a mount can do besides reading, slew, sync and stop."""

    PARK = "park"
    UNPARK = "unpark"
    HOME = "home"
    FIND_HOME = "find-home"
    """Its home is found by a sensor: after that its position can be trusted."""
    SET_PARK = "set-park"
    TRACK = "track"
    TRACKING_RATES = "tracking-rates"
    GUIDE = "guide"
    PIER_SIDE = "pier-side"
    DESTINATION_SIDE = "destination-side"
    CLOCK = "clock"
    SET_CLOCK = "set-clock"
    SITE = "site"
    SET_SITE = "set-site"
    OFFSET_RATES = "offset-rates"
    """It tracks at rates beside the sidereal one in right ascension and declination: `TakesOffsetRates`."""
    MOVE_AXIS = "move-axis"
    """Its axes can be moved on at a speed until they are told to end: `MovesAxes`."""


@dataclass(frozen=True, slots=True)
class MountReading:
    """What the mount says of itself at `utc` (instant between question and answer).

    `place` is in the mount's own kind of coordinates: `Apparent` for JNow mounts, `Icrs` for J2000 mounts.
    Everything after it is None where the mount was not asked or doesn't report it.
    """

    place: Apparent | Icrs
    utc: datetime
    slewing: bool | None = None
    tracking: bool | None = None
    parked: bool | None = None
    at_home: bool | None = None
    pier_side: PierSide | None = None

    @property
    def side(self) -> PierSide:
        """On which side of the pier it says that the tube hangs; unknown where it was not asked, too."""
        return self.pier_side or PierSide.UNKNOWN


class SlewOutcome(StrEnum):
    """How a slew ended."""

    ARRIVED = "arrived"
    STALLED = "stalled"
    STOPPED = "stopped"


class SlewState(StrEnum):
    """What the last order to move has come to, at any moment."""

    NONE = "none"
    ACCEPTED = "accepted"
    UNDER_WAY = "under way"
    ARRIVED = "arrived"
    STALLED = "stalled"
    STOPPED = "stopped"
    REFUSED = "refused"
    LOST = "lost"
    """The mount can't be read any more: whether it still moves is not known."""


class SyncOutcome(StrEnum):
    """What a sync came to, by read-back. A refused one raises `DeviceRefused`."""

    SEEN = "accepted and seen in the read-back"
    LATE = "accepted and applied late"
    IGNORED = "accepted and ignored"
    """It believes what it did before."""
    ELSEWHERE = "accepted, and took another place"
    """Half of what it was sent, or something else: its position counts no more."""

    @property
    def seen(self) -> bool:
        """Whether the mount believes now to be where it was synced."""
        return self in (SyncOutcome.SEEN, SyncOutcome.LATE)


@dataclass(frozen=True, slots=True)
class SyncResult:
    """A sync and what its read-back showed.

    Attributes
    ----------
    read_back : MountReading
        The last one.
    miss_arcsec : float
        Between it and the place that was synced.
    after_s : float
        How long after the order it was taken.
    """

    outcome: SyncOutcome
    read_back: MountReading
    miss_arcsec: float
    after_s: float


@dataclass(frozen=True, slots=True)
class ConnectReport:
    """What connecting found, and how it compares with what we know. Nothing was set unless it says so.

    Attributes
    ----------
    identity : str
        What the mount calls itself: product, firmware, dialect.
    epoch : {"apparent", "icrs"}
        Kind of coordinates it is taken to speak.
    clock_off_s : float or None
        The mount's clock minus ours.
    site_off_arcsec : float or None
        Its place on Earth from ours, on the sphere.
    latitude_off_deg, longitude_off_deg : float or None
        Its minus ours; longitudes east.
    trusted : bool
        Whether its position counts.
    problems : tuple of str
        What an operator should know, in words with numbers.
    done : tuple of str
        What was set because the configuration says so.
    found : ConnectReport or None
        The same before anything was set; None if nothing was.
    """

    identity: str
    epoch: Epoch
    clock_off_s: float | None = None
    site_off_arcsec: float | None = None
    latitude_off_deg: float | None = None
    longitude_off_deg: float | None = None
    trusted: bool = True
    problems: tuple[str, ...] = ()
    done: tuple[str, ...] = ()
    found: ConnectReport | None = None


class Mount(Protocol):
    """A mount: reading, slew, sync, stop. All raise `DeviceError`s; none swallows an outcome."""

    @property
    def name(self) -> str:
        """Name and address, for messages."""
        ...

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates this mount speaks."""
        ...

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step of a commanded or reported place."""
        ...

    async def open(self) -> None:
        """Connect and identify. Never moves, never syncs, never sets time or site."""
        ...

    async def close(self) -> None:
        """Release the line."""
        ...

    async def reading(self) -> MountReading:
        """Where the mount believes it points, now."""
        ...

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        """Go there; return when at rest (arrived, stalled or stopped). `DeviceRefused` when it says no."""
        ...

    async def sync(self, place: Apparent | Icrs) -> SyncResult:
        """Tell the mount that it points there, once, and read back. `DeviceRefused` when it says no."""
        ...

    async def stop(self) -> None:
        """Stop all motion now. Own path: never queued behind another exchange."""
        ...


@runtime_checkable
class Trusts(Protocol):
    """A mount that knows whether its own position counts; an untrusted one refuses to slew or park."""

    @property
    def trusted(self) -> bool:
        """False after power-up, reboot or a lost link, until a sync was seen or its home was found."""
        ...

    def trust(self) -> None:
        """An operator's word that the position is right."""
        ...


@runtime_checkable
class Announces(Protocol):
    """A mount that announces what happens to its link and its position."""

    def listen(self, listener: Callable[[str, Mapping[str, object]], None]) -> None:
        """Tell `listener(what, facts)` of each: `link-silent`, `link-lost`, `link-back`, `untrusted`, ..."""
        ...


@runtime_checkable
class Skilled(Protocol):
    """A mount with skills; what it lacks raises `DeviceRefused` for `Refusal.UNSUPPORTED`."""

    @property
    def skills(self) -> frozenset[Skill]:
        """What it can do, known after `open`."""
        ...

    async def park(self) -> SlewOutcome:
        """Go to its park position and stay; return when it says it is parked."""
        ...

    async def unpark(self) -> None:
        """Be ready to move again; return when it says so."""
        ...

    async def home(self) -> SlewOutcome:
        """Go to (or find) its home; return when there."""
        ...

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Follow the sky, or rest; return when the mount says so."""
        ...

    async def guide(self, direction: Direction, duration_s: float) -> None:
        """Move at the guide rate for a moment; return when that is over."""
        ...


@runtime_checkable
class TakesOffsetRates(Protocol):
    """A mount with `Skill.OFFSET_RATES`."""

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """The largest rates that it takes, both positive; None where it doesn't say. Known after `open`."""
        ...

    async def set_offset_rates(self, rates: OffsetRates) -> None:
        """Track at these rates beside the sidereal one; return when the mount says so, where it can.

        `STARS_RATES` ends them: it tracks as for a star. A slew, a stop, a park and a restart of the mount
        may end them too, as families differ.

        Raises
        ------
        DeviceRefused
            It can't, or it said no; it tracks as before.
        DeviceError
            Which rates it has isn't known.
        """
        ...

    async def offset_rates(self) -> OffsetRates | None:
        """At which rates it says to track beside the sidereal one; None where it doesn't say."""
        ...


@runtime_checkable
class MovesAxes(Protocol):
    """A mount with `Skill.MOVE_AXIS`."""

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """At which speeds each axis can be moved, ascending; known after `open`."""
        ...

    async def move_axis(self, axis: MountAxis, rate_deg_s: float) -> None:
        """Move an axis on at a speed until told otherwise; 0 ends it, and tracking goes on if it was on.

        It comes on top of tracking. Positive moves the tube to greater right ascension (azimuth) with the
        primary axis, to greater declination (altitude) with the secondary one, on either side of the pier.

        Raises
        ------
        DeviceRefused, BadRequest, DeviceError
        """
        ...


@dataclass(frozen=True, slots=True)
class RotatorReading:
    """What a rotator says of itself.

    Attributes
    ----------
    mechanical_deg : float
        Angle of its mechanism, from its own zero; grows as `Rotator.reverse` says. It may lie outside 0..360
        where it counts turns.
    utc : datetime
        Aware, between question and answer.
    moving : bool or None
        None where it doesn't say.
    """

    mechanical_deg: float
    utc: datetime
    moving: bool | None = None


class Rotator(Protocol):
    """A field rotator: reads and turns its mechanism; where the sky's north is only solves show."""

    @property
    def name(self) -> str:
        """Name and address, for messages."""
        ...

    @property
    def step_deg(self) -> float:
        """Its coarsest step."""
        ...

    async def open(self) -> None:
        """Connect and identify. Never turns it, never syncs it."""
        ...

    async def close(self) -> None:
        """Release the line."""
        ...

    async def reading(self) -> RotatorReading:
        """At which angle it stands."""
        ...

    async def turn(
        self, mechanical_deg: float, *, seen: Callable[[RotatorReading], None] | None = None
    ) -> RotatorReading:
        """Turn to an angle of its mechanism; return when it rests there. `DeviceRefused` when it says no.

        Parameters
        ----------
        seen : callable, optional
            Told of each reading on the way; what it raises stops the rotator, and is passed on.
        """
        ...

    async def stop(self) -> None:
        """Stop it now."""
        ...


def skills_of(mount: Mount) -> frozenset[Skill]:
    """What a mount can do besides; nothing, if its driver is no `Skilled` one."""
    skills: frozenset[Skill] = getattr(mount, "skills", frozenset())
    return skills


class Camera(Protocol):
    """A camera: expose, abort."""

    @property
    def name(self) -> str:
        """Name, for messages."""
        ...

    async def open(self) -> None:
        """Get ready."""
        ...

    async def close(self) -> None:
        """Release."""
        ...

    async def expose(self, exposure_s: float) -> Frame:
        """Take one frame; `mid_exposure_utc` must be set."""
        ...

    async def abort(self) -> None:
        """End a running exposure; the pending `expose` raises `Cancelled`."""
        ...


def for_mount(place: Icrs, epoch: Epoch, utc: datetime) -> Apparent | Icrs:
    """`place` as a mount of `epoch` wants it: no refraction, apparent of date or ICRS [POINTING §3.4]."""
    return place if epoch == "icrs" else icrs_to_apparent(place, utc)


def from_mount(place: Apparent | Icrs) -> Icrs:
    """A mount's reading as ICRS."""
    return place if isinstance(place, Icrs) else apparent_to_icrs(place)


FREE_ARCSEC = 5.0
"""So far (and by its step) the reading of a mount that stands may wander, ″. Doubled, a half of a sync of 10″
passes for nothing."""
_SHARE = 0.25
"""So much of a sync's way is left to the mount, so that a small one that was ignored still shows. Doubled, a
sync of which the mount took one coordinate of two (0.7 of the way is left) comes near to passing."""
_STEPS = 1.5
"""Both coordinates of a reading may be at the edge of a step at once: √2 of a step, rounded up. Doubled, a
half of a sync of a mount with coarse steps passes for ignored."""


@dataclass(frozen=True, slots=True)
class SyncLaw:
    """By what readings one sync is judged: the only place that says when it was seen.

    Each caller has a cap of its own on `near_arcsec`: a driver what its wire and its mount keep to
    (`Timing.near_arcsec`, `MountBehavior.near_arcsec`), navigation its policy's
    (`SyncPolicy.read_back_arcsec`); the room `mount`, which only reads for drivers that don't, has none.

    Attributes
    ----------
    near_arcsec : float
        A sync is seen when the mount believes to be so near to where it was synced.
    resolution_arcsec : float
        The mount's step.
    """

    near_arcsec: float
    resolution_arcsec: float

    @classmethod
    def of(cls, way_arcsec: float, resolution_arcsec: float, most_arcsec: float = math.inf) -> SyncLaw:
        """The law for a sync over `way_arcsec`, from what the mount believed to what it is sent.

        Parameters
        ----------
        resolution_arcsec : float
            The mount's step.
        most_arcsec : float
            The cap on `near_arcsec`, unless the step is coarser.
        """
        near_arcsec = max(min(_SHARE * way_arcsec, most_arcsec), resolution_arcsec + FREE_ARCSEC)
        return cls(near_arcsec, resolution_arcsec)

    def seen(self, miss_arcsec: float) -> bool:
        """Whether a mount that believes to be so far from where it was synced has taken the sync."""
        return miss_arcsec <= self.near_arcsec

    def unseen(
        self, before: MountReading, after: MountReading, rates: Collection[OffsetRates] = ()
    ) -> SyncOutcome:
        """What became of a sync that isn't seen: ignored, or another place taken.

        Parameters
        ----------
        before : MountReading
            The last one before the sync.
        rates : collection of OffsetRates
            As of `moved_arcsec`.
        """
        moved = moved_arcsec(before, after, rates) > _STEPS * self.resolution_arcsec + FREE_ARCSEC
        return SyncOutcome.ELSEWHERE if moved else SyncOutcome.IGNORED

    def outcome(
        self,
        miss_arcsec: float,
        before: MountReading,
        after: MountReading,
        rates: Collection[OffsetRates] = (),
    ) -> SyncOutcome:
        """What a sync has come to by the reading `after`: seen, ignored, or another place taken."""
        return SyncOutcome.SEEN if self.seen(miss_arcsec) else self.unseen(before, after, rates)


def moved_arcsec(before: MountReading, after: MountReading, rates: Collection[OffsetRates] = ()) -> float:
    """By how much the belief of a mount that isn't moved has changed, the turn of the sky left out.

    Whether it follows the sky is taken from its place: what it reports of that may be wrong as well.

    Parameters
    ----------
    rates : collection of OffsetRates
        At which it may track beside the sidereal one: the way that it goes at any of them is left out too.
    """
    return _apart_arcsec(_turned(before.place, before.utc, after, rates), after.place)


def miss_arcsec(
    place: Apparent | Icrs, told_utc: datetime, after: MountReading, rates: Collection[OffsetRates] = ()
) -> float:
    """How far a mount believes to be from where it was synced at `told_utc`, the turn of the sky left out.

    Parameters
    ----------
    rates : collection of OffsetRates
        As of `moved_arcsec`.
    """
    return _apart_arcsec(_turned(place, told_utc, after, rates), after.place)


def rates_of(mount: object) -> tuple[OffsetRates, ...]:
    """The rates at which a mount moves by itself while it is read, as far as anybody knows of any."""
    known: OffsetRates | None = getattr(mount, "rates_known", None)
    if known is None:
        known = getattr(getattr(mount, "offset_rates_in_force", None), "rates", None)
    return () if known is None or known.none else (known,)


def moved_on(place: Apparent | Icrs, rates: OffsetRates, seconds: float) -> Apparent | Icrs:
    """Where a mount that was at `place` is after some time, tracking at rates beside the sidereal one.

    At a pole it stays: no axis goes through it by tracking.
    """
    dec_deg = place.dec_deg + rates.dec_arcsec_s * seconds / 3600.0
    return replace(
        place,
        ra_deg=(place.ra_deg + rates.ra_arcsec_s * seconds / 3600.0) % 360.0,
        dec_deg=max(-90.0, min(90.0, dec_deg)),
    )


def offset_speed_arcsec_s(rates: OffsetRates, dec_deg: float) -> float:
    """How fast a mount at a declination moves among the stars at some rates, ″/s on the sphere."""
    return math.hypot(rates.ra_arcsec_s * math.cos(math.radians(dec_deg)), rates.dec_arcsec_s)


def _turned(
    place: Apparent | Icrs, utc: datetime, after: MountReading, rates: Collection[OffsetRates]
) -> Apparent | Icrs:
    """Where one that believed `place` at `utc` is at `after`: there, as the sky turned if it rests, or on."""
    seconds = (after.utc - utc).total_seconds()
    # the right ascension of a mount that rests grows so fast
    turned = replace(place, ra_deg=(place.ra_deg + SIDEREAL_DEG_S * seconds) % 360.0)
    on = (moved_on(place, one, seconds) for one in rates)
    return min(place, turned, *on, key=lambda candidate: _apart_arcsec(candidate, after.place))


def _apart_arcsec(one: Apparent | Icrs, two: Apparent | Icrs) -> float:
    return separation_arcsec(Icrs(one.ra_deg, one.dec_deg), Icrs(two.ra_deg, two.dec_deg))
