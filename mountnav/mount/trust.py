"""Whether a mount's position counts: where it was seen last; its site and clock against the settings."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Protocol, runtime_checkable

from mountnav.clock import Clock, sky_s
from mountnav.devices import ConnectReport, Mount, MountReading, from_mount
from mountnav.errors import DeviceError, DeviceRefused, Refusal
from mountnav.journal.records import CommandRecord, EntryKind
from mountnav.mount.limits_guard import LimitsGuard
from mountnav.mount.mount_state import MountState
from mountnav.mount.order_book import OrderBook
from mountnav.sky.chain import icrs_to_hour_angle
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

__all__ = [
    "ACCEPTED",
    "ADVICE",
    "APART_DEG",
    "ELSEWHERE_DEG",
    "Comparable",
    "Difference",
    "LastSeen",
    "PositionMemory",
    "SiteTimeAgreement",
    "seen_of",
    "strayed_deg",
    "why_not_to_trust",
]


ELSEWHERE_DEG = 0.5
"""So far a mount may stand from where it was left. Guide corrections, a hand at the keys, polar error and the
wire's steps stay below it, places at which mounts wake up don't. Doubled, a wake-up half a degree further
from the last target would pass."""
_WRITTEN_DEG = 0.1
"""A mount that rests so far from where it is written to stand is written down again, °. Chosen by hand: a
fifth of `ELSEWHERE_DEG`. Doubled, a next start compares with a place that is staler; halved, a mount that
drifts is written twice as often."""

_LED = 1.25
"""Rates may have been changed, and a mount be faster than it was told, since it was seen last. Chosen by
hand. Doubled, one that was moved by hand as far as it had followed counts as one that has followed."""
_MOVING = frozenset({"slew", "sync", "park", "home", "guide"})


@dataclass(frozen=True, slots=True)
class LastSeen:
    """A mount as it was seen last.

    Attributes
    ----------
    place : Icrs or None
        Where it believed to point; None if it was never read.
    trusted : bool
        Whether that counted.
    why : str
        Why not.
    """

    place: Icrs | None
    utc: datetime
    tracking: bool | None = None
    trusted: bool = True
    why: str = ""

    def facts(self) -> dict[str, object]:
        """As the journal keeps it."""
        place = self.place
        return {
            "place": None if place is None else {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg},
            "seen_utc": self.utc.isoformat(),
            "tracking": self.tracking,
            "trusted": self.trusted,
            "why": self.why,
        }

    @classmethod
    def of_facts(cls, facts: Mapping[str, Any]) -> LastSeen:
        """From that."""
        place = facts["place"]
        return cls(
            None if place is None else Icrs(float(place["ra_deg"]), float(place["dec_deg"])),
            datetime.fromisoformat(facts["seen_utc"]),
            facts["tracking"],
            bool(facts["trusted"]),
            str(facts["why"]),
        )


def seen_of(reading: MountReading, *, trusted: bool = True, why: str = "") -> LastSeen:
    """What a reading says of where the mount stands."""
    return LastSeen(from_mount(reading.place), reading.utc, reading.tracking, trusted, why)


def strayed_deg(last: LastSeen, now: MountReading, site: Site, air: Air) -> float:
    """How far a mount stands from anywhere that it may have come to by itself since it was seen last.

    It may have gone on tracking, or have rested from any moment on: then it stands on the arc between the
    place in the sky and the place above the ground. One that rested stays where it was, above the ground.

    Parameters
    ----------
    last : LastSeen
        With a place.

    Returns
    -------
    float
        Degrees; infinite if it was never read.
    """
    if last.place is None:
        return math.inf
    here = icrs_to_hour_angle(from_mount(now.place), now.utc, site, air)
    there = icrs_to_hour_angle(last.place, last.utc, site, air)
    elapsed_s = max(0.0, (now.utc - last.utc).total_seconds())
    longest = 0.0 if last.tracking is False else min(360.0, elapsed_s * SIDEREAL_DEG_S)
    ahead = half_turn_deg(here.ha_deg - there.ha_deg)
    nearest = min(
        separation_arcsec(
            HourAngle(half_turn_deg(there.ha_deg + min(max(way, 0.0), longest)), there.dec_deg, now.utc),
            HourAngle(here.ha_deg, here.dec_deg, now.utc),
        )
        for way in (ahead, ahead % 360.0)
    )
    return nearest / 3600.0


def why_not_to_trust(
    last: LastSeen,
    in_flight: Sequence[CommandRecord],
    now: MountReading,
    site: Site,
    air: Air,
    led_deg_s: float = 0.0,
) -> str | None:
    """Why a mount that is met again must not be trusted by its own word; None if nothing speaks against it.

    Parameters
    ----------
    in_flight : sequence of CommandRecord
        What was begun and never closed.
    led_deg_s : float
        How fast, at most, what went on by itself may have led it away: rates beside the stars', an axis that
        was moved.
    """
    when = f"{last.utc:%Y-%m-%d %H:%M:%S} UTC"
    if not last.trusted:
        return f"{last.why or 'it was not trusted'} (before the restart, last seen at {when})"
    if last.place is None or now.slewing:
        # on its way: the order that moved it is reported, and one that was just switched on doesn't move
        return None
    off_deg = strayed_deg(last, now, site, air)
    # how long that went on nobody knows: until a guard or this start has ended it
    led_deg = led_deg_s * max(0.0, (now.utc - last.utc).total_seconds())
    if off_deg <= ELSEWHERE_DEG + _LED * led_deg:
        return None
    moving = [command for command in in_flight if command.order in _MOVING]
    if any(_explains(command, now) for command in moving):
        return None
    after = "" if not moving else f", and not where the {moving[-1].order} in flight should have led it"
    return (
        f"it stands {off_deg:.1f}° from where it was seen last ({when}){after}: somebody or a reboot moved it"
    )


def _explains(command: CommandRecord, now: MountReading) -> bool:
    """Whether a mount stands where an order that was in flight leads."""
    if command.place is not None:
        off_arcsec = separation_arcsec(from_mount(command.place), from_mount(now.place))
        return off_arcsec <= ELSEWHERE_DEG * 3600.0
    return bool(now.parked if command.order == "park" else command.order == "home" and now.at_home)


class PositionMemory:
    """Writes down where one mount stands and whether that counts, from the moment it was taken up on."""

    def __init__(self, state: MountState, guard: LimitsGuard, book: OrderBook, clock: Clock) -> None:
        self._state = state
        self._guard = guard
        self._book = book
        self._clock = clock
        self._active = False
        self._written: LastSeen | None = None
        self._before: LastSeen | None = None
        state.on_reading(self._read)
        state.listen(self._said)

    def take_up(
        self,
        last: LastSeen | None,
        in_flight: Sequence[CommandRecord],
        now: MountReading,
        led_deg_s: float = 0.0,
    ) -> str | None:
        """Take the mount up as an earlier run left it, and write down from now on.

        Parameters
        ----------
        last : LastSeen or None
            None: nothing is known of it, and its own word counts as the settings say.
        led_deg_s : float
            As of `why_not_to_trust`.

        Returns
        -------
        str or None
            Why it isn't trusted, if that has come out now.
        """
        if self._active:
            return None
        guard = self._guard
        why = (
            None
            if last is None
            else (why_not_to_trust(last, in_flight, now, guard.site, guard.air, led_deg_s))
        )
        if why is not None:
            self._state.distrust(why)
        self._active = True
        self._read(now)
        return why

    def _read(self, reading: MountReading) -> None:
        if not self._active:
            return
        seen = seen_of(reading, trusted=self._state.trusted, why=self._state.why_untrusted)
        before, self._before = self._before, seen
        if self._is_news(reading, seen, before):
            self._write(seen)

    def _is_news(self, reading: MountReading, seen: LastSeen, before: LastSeen | None) -> bool:
        known = self._written
        if known is None or known.trusted is not seen.trusted:
            return True
        if reading.slewing or before is None or self._off_deg(before, reading) > _WRITTEN_DEG:
            # where it comes to rest counts
            return False
        return known.tracking is not seen.tracking or self._off_deg(known, reading) > _WRITTEN_DEG

    def _off_deg(self, known: LastSeen, reading: MountReading) -> float:
        return strayed_deg(known, reading, self._guard.site, self._guard.air)

    def _said(self, what: str, facts: Mapping[str, object]) -> None:
        """A position that has ceased to count is written down at once, read or not."""
        if not self._active or self._state.trusted or (self._written and not self._written.trusted):
            return
        place = None if self._before is None else self._before.place
        utc = self._clock.utc() if self._before is None else self._before.utc
        tracking = None if self._before is None else self._before.tracking
        self._write(LastSeen(place, utc, tracking, False, self._state.why_untrusted))

    def _write(self, seen: LastSeen) -> None:
        self._written = seen
        words = "its position is trusted" if seen.trusted else f"its position is not trusted: {seen.why}"
        self._book.note_now(EntryKind.STANDING, words, seen.facts())


APART_DEG = 0.25
"""So far mount and settings may be apart in latitude, longitude, or turn of the clock (60 s): little for a
limit, more than the whole minutes of arc and the seconds in which mounts keep site and time. Doubled, half a
degree at the horizon would go untold."""
_SECONDS_PER_DEG = 240.0
"""Of the clock: the sky turns by a degree in so many seconds."""
_WAY_S = 2.0
"""An answer about the clock may be so late by the machine's time, s. Chosen by hand, a slow serial exchange.
It counts only where time runs faster than the machine's."""
_SAME = 0.4
"""What was accepted is another difference when it has changed by more than this share of `APART_DEG`. Chosen
by hand. Doubled, a clock that has moved by 48 s since counts as accepted."""

ADVICE = (
    "correct the mount (order set-site-time), or correct [site] and this machine's clock and start again; "
    "or, if the difference is intended, let a user with the role configure accept it (order accept-site-time)"
)
ACCEPTED = "site-time-accepted"
"""What the facts of such a journal entry say under `about`."""


def _clock_apart_deg() -> float:
    """As a turn of the sky; where time runs faster, the way of an answer takes more of it."""
    return max(APART_DEG, sky_s(_WAY_S) / _SECONDS_PER_DEG)


@runtime_checkable
class Comparable(Protocol):
    """A mount whose site and clock can be asked for again, and set to ours."""

    async def compare(self) -> ConnectReport:
        """Ask again."""
        ...

    async def set_site_and_time(self) -> ConnectReport:
        """Set both to ours, as far as it takes them."""
        ...


@dataclass(frozen=True, slots=True)
class Difference:
    """The mount's site and clock minus ours; None where it doesn't report that.

    Attributes
    ----------
    clock_deg : float or None
        As a turn of the sky: 15° an hour.
    """

    latitude_deg: float | None = None
    longitude_deg: float | None = None
    clock_deg: float | None = None

    @classmethod
    def of(cls, report: ConnectReport) -> Difference:
        """What connecting has found."""
        off_s = report.clock_off_s
        return cls(
            report.latitude_off_deg,
            report.longitude_off_deg,
            None if off_s is None else off_s / _SECONDS_PER_DEG,
        )

    @property
    def words(self) -> str | None:
        """What contradicts; None if nothing does."""
        told = []
        if self.latitude_deg is not None and abs(self.latitude_deg) > APART_DEG:
            told.append(f"its latitude is {self.latitude_deg:+.3f}° from ours")
        if self.longitude_deg is not None and abs(self.longitude_deg) > APART_DEG:
            told.append(f"its longitude is {self.longitude_deg:+.3f}° (east) from ours")
        if self.clock_deg is not None and abs(self.clock_deg) > _clock_apart_deg():
            off_s = self.clock_deg * _SECONDS_PER_DEG
            told.append(f"its clock is {abs(off_s):.0f} s {'ahead of' if off_s > 0 else 'behind'} ours")
        return " and ".join(told) or None

    @property
    def turn_deg(self) -> float:
        """By how much the mount takes the sky to be turned further than we do, east positive."""
        return half_turn_deg((self.longitude_deg or 0.0) + (self.clock_deg or 0.0))

    def same(self, other: Difference) -> bool:
        """Whether it is the difference that was accepted."""
        pairs = (
            (self.latitude_deg, other.latitude_deg, APART_DEG),
            (self.longitude_deg, other.longitude_deg, APART_DEG),
            (self.clock_deg, other.clock_deg, _clock_apart_deg()),
        )
        return all(
            (a is None and b is None)
            or (a is not None and b is not None and abs(half_turn_deg(a - b)) <= _SAME * apart)
            for a, b, apart in pairs
        )

    def moved_from(self, before: Difference) -> str | None:
        """What was changed by setting it from `before`, in words; None if next to nothing was."""
        if before == Difference():
            return "which it didn't tell before"
        turned_deg = half_turn_deg(self.turn_deg - before.turn_deg)
        tilted_deg = (self.latitude_deg or 0.0) - (before.latitude_deg or 0.0)
        if max(abs(turned_deg), abs(tilted_deg)) <= _clock_apart_deg():
            return None
        return f"which turned its sky by {turned_deg:+.1f}° and tilted it by {tilted_deg:+.1f}°"

    def facts(self) -> dict[str, object]:
        """For the journal."""
        return {
            "latitude_deg": self.latitude_deg,
            "longitude_deg": self.longitude_deg,
            "clock_deg": self.clock_deg,
        }


class SiteTimeAgreement:
    """The contradiction between one mount and the settings, if there is one.

    Parameters
    ----------
    mount : Mount
        Its ``report`` is what connecting has found; one that has none contradicts nothing.
    state : MountState
        Tells of the link, and those who listen.
    guard : LimitsGuard
        Only asked for the Sun.
    """

    def __init__(self, mount: Mount, state: MountState, book: OrderBook, guard: LimitsGuard) -> None:
        self._mount = mount
        self._guard = guard
        self._state = state
        self._book = book
        self._accepted: Difference | None = None
        self._told: str | None = None
        self._contradicted: Difference | None = None
        self.turned_deg: float | None = None
        """By how much less the mount takes the sky to be turned since it was set right; None once the sky has
        shown that this was right, and where nothing was set."""
        state.listen(self._said)

    @property
    def difference(self) -> Difference | None:
        """The mount's minus ours, as it was asked for last."""
        report = getattr(self._mount, "report", None)
        return Difference.of(report) if isinstance(report, ConnectReport) else None

    @property
    def contradiction(self) -> str | None:
        """What contradicts and was not accepted, in words; None if nothing does."""
        difference = self.difference
        if difference is None or (words := difference.words) is None:
            return None
        return None if self._accepted is not None and self._accepted.same(difference) else words

    async def require(self, order: str) -> None:
        """Refuse an order that would be judged by the wrong sky; the mount is asked once more before.

        Raises
        ------
        DeviceRefused
        """
        if self.contradiction is not None and isinstance(self._mount, Comparable):
            # somebody may have set it right at its hand control
            with contextlib.suppress(DeviceError):
                await self._mount.compare()
            self._look()
        if (words := self.contradiction) is not None:
            raise self.refusal(order, words)

    def refusal(self, order: str, words: str) -> DeviceRefused:
        """The refusal of such an order."""
        return DeviceRefused(
            f"the {order} refused: mount and settings contradict each other: {words}",
            device=self._mount.name,
            advice=ADVICE,
            reason=Refusal.SITE_OR_TIME,
        )

    async def set_right(self) -> ConnectReport:
        """Set the mount's site and clock to ours. Raises `DeviceError`."""
        if not isinstance(self._mount, Comparable):
            raise DeviceRefused(
                "its site and time can't be set", device=self._mount.name, reason=Refusal.UNSUPPORTED
            )
        # ordered once more it is the word of one who knows that ours are right
        self.turned_deg = None
        before = self.difference or Difference()
        try:
            reading = await self._state.reading()
        except DeviceError:
            reading = None
        try:
            report = await self._mount.set_site_and_time()
        except DeviceRefused:
            raise  # nothing was sent
        except DeviceError as error:
            self._state.distrust(f"its site and clock were being set, how far isn't known: {error.what}")
            raise
        self._look()
        self._turned(before, Difference.of(report), reading)
        return report

    async def opened(self) -> None:
        """Let its position count as after `set_right`, if connecting has set its site or clock to ours."""
        report = getattr(self._mount, "report", None)
        if not isinstance(report, ConnectReport) or report.found is None:
            return
        before, now = Difference.of(report.found), Difference.of(report)
        if before.words is not None and now.words is None:
            self.turned_deg = half_turn_deg(before.turn_deg - now.turn_deg)
        try:
            reading = await self._state.reading()
        except DeviceError:
            reading = None
        self._turned(before, now, reading)

    def _turned(self, before: Difference, now: Difference, reading: MountReading | None) -> None:
        """Let its position not count where nobody has seen what it means by the site and clock it has now."""
        changed = now.moved_from(before)
        by_its_axes = (
            reading is not None
            and bool(reading.parked or reading.at_home)
            and self._guard.sun_is_down(reading.utc, half_turn_deg(now.turn_deg - before.turn_deg))
        )
        if changed is not None and not by_its_axes:
            # one mount keeps its place among the stars, another one the angles of its axes: nobody has seen
            # which of both is right. At home and at its park position the axes show it; but if it is our
            # clock that is wrong, the Sun is elsewhere
            self._state.distrust(f"its site and clock were set to ours, {changed}")

    def accept(self) -> str | None:
        """One who may configure has seen the contradiction and wants it so, until it changes.

        Returns
        -------
        str or None
            What was accepted; None if nothing contradicts.
        """
        words, difference = self.contradiction, self.difference
        if words is None or difference is None:
            return None
        self._accepted = difference
        facts = {"about": ACCEPTED, "difference": difference.facts()}
        self._book.note_now(EntryKind.SETTINGS, f"accepted by an operator: {words}", facts)
        self._look()
        return words

    def restore(self, facts: Mapping[str, Any]) -> None:
        """Take over from the journal what was accepted; what has changed since is another difference."""
        self._accepted = Difference(**facts["difference"])
        self._look()

    def _said(self, what: str, _: Mapping[str, object]) -> None:
        if what in ("connected", "link-back"):
            self._look()

    def _look(self) -> None:
        """Tell what contradicts now, and when it no longer does."""
        difference = self.difference
        accepted = self._accepted
        if accepted is not None and difference is not None and not accepted.same(difference):
            # not only for as long as it lasts: who accepted one difference has not accepted the next one
            self._accepted = None
            told = {"about": ACCEPTED, "difference": None}
            self._book.note_now(EntryKind.SETTINGS, "what was accepted of site and clock has changed", told)
        words = self.contradiction
        if difference is not None and self._contradicted is not None and difference.words is None:
            self.turned_deg = half_turn_deg(self._contradicted.turn_deg - difference.turn_deg)
        self._contradicted = difference if difference is not None and difference.words is not None else None
        if words == self._told:
            return
        before, self._told = self._told, words
        if words is not None:
            facts: dict[str, object] = {"why": words, "advice": ADVICE}
            self._book.note_now(EntryKind.FAULT, f"mount and settings contradict each other: {words}", facts)
            self._state.tell("contradiction", facts)
        else:
            resolved: dict[str, object] = {"was": before}
            self._book.note_now(EntryKind.FAULT, "mount and settings contradict each other no more", resolved)
            self._state.tell("contradiction-over", resolved)
