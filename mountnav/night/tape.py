"""A mount that answers as recorded: readings from a tape, orders carried out in mind alone; no port."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from mountnav.clock import Clock
from mountnav.errors import DeviceError, DeviceRefused, DeviceSilent
from mountnav.navigation.devices import (
    Direction,
    Epoch,
    MountReading,
    Skill,
    SlewOutcome,
    SyncOutcome,
    SyncResult,
    TrackingRate,
)
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import half_turn_deg, separation_arcsec, turn_deg

SAME_PLACE_ARCSEC = 20.0
SAME_TIME_S = 120.0
AFTER_A_SYNC = timedelta(seconds=2)


@dataclass(frozen=True, slots=True)
class RecordedSync:
    """A sync of the recorded night: what it changed of the mount's belief.

    Attributes
    ----------
    begun_utc, utc : datetime
        It was sent; from then on the readings are sure to show it.
    place : Apparent or Icrs
        What was sent.
    ra_deg, dec_deg : float
        Belief after minus before, in the mount's own coordinates.
    outcome : SyncOutcome or None
        None: the mount said no.
    """

    begun_utc: datetime
    utc: datetime
    place: Apparent | Icrs
    ra_deg: float
    dec_deg: float
    outcome: SyncOutcome | None = SyncOutcome.SEEN


class TapeMount:
    """A `mountnav.navigation.devices.Mount` made of what was recorded.

    Readings are those of the tape, but for syncs: those that the recorded night decided on are taken off
    (`recorded`), and those that are sent now are put on, so that a night by other rules is played rightly
    too. A slew arrives at once and changes nothing: what is seen minus what is believed is the same wherever
    the tube is moved to, and the recorded frames stay where they were.

    Parameters
    ----------
    name : str
    readings : sequence of MountReading
        In the order of time.
    recorded : sequence of RecordedSync
        Of the recorded night's own corrections.
    clock : Clock
    epoch : {"apparent", "icrs"}
    resolution_arcsec : float
    skills : frozenset of Skill
    ask : callable, optional
        Asks the real driver over a recorded wire; where it has no answer, the tape of readings has.

    Attributes
    ----------
    orders : list of str
        What was ordered.
    unanswered : int
        Readings for which the recorded wire had no answer.
    """

    def __init__(
        self,
        name: str,
        readings: Sequence[MountReading],
        recorded: Sequence[RecordedSync],
        clock: Clock,
        *,
        epoch: Epoch = "apparent",
        resolution_arcsec: float = 1.0,
        skills: frozenset[Skill] = frozenset(),
        ask: Callable[[], Awaitable[MountReading]] | None = None,
    ) -> None:
        self._name = name
        self._readings = list(readings)
        self._times = [one.utc for one in readings]
        self._recorded = list(recorded)
        self._clock = clock
        self._epoch: Epoch = epoch
        self._resolution_arcsec = resolution_arcsec
        self._skills = skills
        self._ask = ask
        self._own: list[RecordedSync] = []
        self._there: Apparent | Icrs | None = None
        self._there_until: datetime | None = None
        self.orders: list[str] = []
        self.unanswered = 0

    @property
    def name(self) -> str:
        """For messages."""
        return self._name

    @property
    def epoch(self) -> Epoch:
        """As recorded."""
        return self._epoch

    @property
    def resolution_arcsec(self) -> float:
        """As recorded."""
        return self._resolution_arcsec

    @property
    def skills(self) -> frozenset[Skill]:
        """As recorded."""
        return self._skills

    async def open(self) -> None:
        """Nothing to open."""

    async def close(self) -> None:
        """Nothing to close."""

    async def reading(self) -> MountReading:
        """What it said at this time.

        Raises
        ------
        DeviceSilent
            The tape has none at all.
        """
        now = self._clock.utc()
        if self._there is not None and self._there_until is not None and now < self._there_until:
            return replace(self._on_tape(now), place=self._there, utc=now, slewing=False)
        syncing = next((one for one in self._recorded if one.begun_utc <= now < one.utc), None)
        said = None
        if syncing is not None:
            # somewhere in there the belief jumped: as long as it isn't sure when, it didn't
            said = self._on_tape(syncing.begun_utc)
        elif not any(one.utc <= now < one.utc + AFTER_A_SYNC for one in self._recorded):
            # right after a sync one answer of a reading may be of before it
            said = await self._asked()
        said = self._on_tape(now) if said is None else said
        ra_deg = dec_deg = 0.0
        for sign, syncs in ((-1.0, self._recorded), (1.0, self._own)):
            for one in syncs:
                if one.utc <= now:
                    ra_deg, dec_deg = ra_deg + sign * one.ra_deg, dec_deg + sign * one.dec_deg
        return replace(said, place=_moved(said.place, ra_deg, dec_deg), utc=now)

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        """Arrive at once; the next recorded reading tells again where the tube is."""
        self.orders.append("slew")
        self._there, self._there_until = place, self._next_utc()
        return SlewOutcome.ARRIVED

    async def sync(self, place: Apparent | Icrs) -> SyncResult:
        """Believe it; or answer as the mount did, where it was told the same at that time.

        Raises
        ------
        DeviceRefused
            The mount said no then.
        """
        self.orders.append("sync")
        before = await self.reading()
        now = self._clock.utc()
        then = self._same_then(place, now)
        if then is not None and then.outcome is None:
            raise DeviceRefused("the sync was refused in the recording", device=self._name)
        if then is not None:
            own = replace(then, begun_utc=now, utc=now)
        else:
            ra_deg = half_turn_deg(place.ra_deg - before.place.ra_deg)
            dec_deg = place.dec_deg - before.place.dec_deg
            own = RecordedSync(now, now, place, ra_deg, dec_deg)
        self._own.append(own)
        after = await self.reading()
        miss = float(apart_arcsec(after.place, place))
        return SyncResult(own.outcome or SyncOutcome.SEEN, after, miss, 0.0)

    def _same_then(self, place: Apparent | Icrs, now: datetime) -> RecordedSync | None:
        """The recorded sync that is this one."""
        for one in self._recorded:
            near = abs((one.begun_utc - now).total_seconds()) <= SAME_TIME_S
            if near and apart_arcsec(one.place, place) <= SAME_PLACE_ARCSEC:
                return one
        return None

    async def stop(self) -> None:
        """Stand."""
        self.orders.append("stop")

    async def park(self) -> SlewOutcome:
        """Be parked."""
        self.orders.append("park")
        return SlewOutcome.ARRIVED

    async def unpark(self) -> None:
        """Be ready."""
        self.orders.append("unpark")

    async def home(self) -> SlewOutcome:
        """Be at home."""
        self.orders.append("home")
        return SlewOutcome.ARRIVED

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Follow, or rest."""
        self.orders.append("track")

    async def guide(self, direction: Direction, duration_s: float) -> None:
        """Move."""
        self.orders.append("guide")

    async def _asked(self) -> MountReading | None:
        if self._ask is None:
            return None
        try:
            return await self._ask()
        except DeviceError:
            self.unanswered += 1
            return None

    def _on_tape(self, now: datetime) -> MountReading:
        """Between the two readings round this time, on the straight way from one to the other."""
        after = bisect_right(self._times, now)
        if not self._readings:
            raise DeviceSilent("the recording has no readings", device=self._name)
        if after == 0:
            return self._readings[0]
        before = self._readings[after - 1]
        if after == len(self._readings):
            return before
        then = self._readings[after]
        span_s = (then.utc - before.utc).total_seconds()
        share = (now - before.utc).total_seconds() / span_s if span_s > 0 else 0.0
        ra_deg = share * half_turn_deg(then.place.ra_deg - before.place.ra_deg)
        dec_deg = share * (then.place.dec_deg - before.place.dec_deg)
        # a sync of the recorded night jumps: readings before it are those before it
        jumps = any(before.utc < one.utc and one.begun_utc <= then.utc for one in self._recorded)
        return before if jumps else replace(before, place=_moved(before.place, ra_deg, dec_deg))

    def _next_utc(self) -> datetime | None:
        after = bisect_right(self._times, self._clock.utc())
        return self._times[after] if after < len(self._times) else None


def _moved(place: Apparent | Icrs, ra_deg: float, dec_deg: float) -> Apparent | Icrs:
    if ra_deg == 0.0 and dec_deg == 0.0:
        return place
    return replace(place, ra_deg=turn_deg(place.ra_deg + ra_deg), dec_deg=place.dec_deg + dec_deg)


def apart_arcsec(one: Apparent | Icrs, other: Apparent | Icrs) -> float:
    """Distance of two places of a mount's coordinates; an instant more or less changes nothing."""
    return separation_arcsec(Icrs(one.ra_deg, one.dec_deg), Icrs(other.ra_deg, other.dec_deg))
