"""Where a mount was seen last and whether that counted: written down, and what the next start makes of it.

A service that is killed, or loses its power together with the mount, must not trust afterwards what it had no
reason to trust before, nor a mount that stands elsewhere than it was left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from mountnav.clock import Clock
from mountnav.devices import MountReading
from mountnav.journal.records import CommandRecord, EntryKind
from mountnav.mount.guarding import Guard
from mountnav.mount.standing import Standing
from mountnav.mount.written_orders import OrderBook
from mountnav.navigation.kinds import from_mount
from mountnav.sky.chain import icrs_to_hour_angle
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

ELSEWHERE_DEG = 0.5
"""So far a mount may stand from where it was left. Guide corrections, a hand at the keys, polar error and the
wire's steps stay below it, places at which mounts wake up don't. Doubled, a wake-up half a degree further
from the last target would pass."""
_WRITTEN_DEG = 0.1
"""A mount that rests so far from where it is written to stand is written down anew."""

_MOVING = frozenset({"slew", "sync", "park", "home", "guide"})


@dataclass(frozen=True, slots=True)
class LastSeen:
    """A mount as it was seen last.

    Attributes
    ----------
    place : Icrs or None
        Where it believed to point; None if it was never read.
    utc : datetime
    tracking : bool or None
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
    """What a reading tells."""
    return LastSeen(from_mount(reading.place), reading.utc, reading.tracking, trusted, why)


def strayed_deg(last: LastSeen, now: MountReading, site: Site, air: Air) -> float:
    """How far a mount stands from anywhere that it may have come to by itself since it was seen last.

    It may have gone on tracking, or have rested from any moment on: then it stands on the arc between the
    place in the sky and the place above the ground. One that rested stays where it was, above the ground.

    Parameters
    ----------
    last : LastSeen
        With a place.
    now : MountReading
    site, air : Site, Air

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
    last: LastSeen, in_flight: Sequence[CommandRecord], now: MountReading, site: Site, air: Air
) -> str | None:
    """Why a mount that is met again must not be trusted by its own word; None if nothing speaks against it.

    Parameters
    ----------
    last : LastSeen
    in_flight : sequence of CommandRecord
        What was begun and never closed.
    now : MountReading
    site, air : Site, Air
    """
    when = f"{last.utc:%Y-%m-%d %H:%M:%S} UTC"
    if not last.trusted:
        return f"{last.why or 'it was not trusted'} (before the restart, last seen at {when})"
    if last.place is None or now.slewing:
        # on its way: what ordered that is told of, and a mount that was switched on just now doesn't move
        return None
    off_deg = strayed_deg(last, now, site, air)
    if off_deg <= ELSEWHERE_DEG:
        return None
    moving = [one for one in in_flight if one.order in _MOVING]
    if any(_explains(one, now) for one in moving):
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


class Memory:
    """Writes down where one mount stands and whether that counts, from the moment it was taken up on.

    Parameters
    ----------
    standing : Standing
    guard : Guard
    book : OrderBook
    clock : Clock
    """

    def __init__(self, standing: Standing, guard: Guard, book: OrderBook, clock: Clock) -> None:
        self._standing = standing
        self._guard = guard
        self._book = book
        self._clock = clock
        self._active = False
        self._written: LastSeen | None = None
        self._before: LastSeen | None = None
        standing.on_reading(self._read)
        standing.listen(self._said)

    def take_up(
        self, last: LastSeen | None, in_flight: Sequence[CommandRecord], now: MountReading
    ) -> str | None:
        """Take the mount up as an earlier run left it, and write down from now on.

        Parameters
        ----------
        last : LastSeen or None
            None: nothing is known of it, and its own word counts as the settings say.
        in_flight : sequence of CommandRecord
        now : MountReading

        Returns
        -------
        str or None
            Why it isn't trusted, if that has come out now.
        """
        if self._active:
            return None
        guard = self._guard
        why = None if last is None else why_not_to_trust(last, in_flight, now, guard.site, guard.air)
        if why is not None:
            self._standing.distrust(why)
        self._active = True
        self._read(now)
        return why

    def _read(self, reading: MountReading) -> None:
        if not self._active:
            return
        seen = seen_of(reading, trusted=self._standing.trusted, why=self._standing.why_untrusted)
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
        if not self._active or self._standing.trusted or (self._written and not self._written.trusted):
            return
        place = None if self._before is None else self._before.place
        utc = self._clock.utc() if self._before is None else self._before.utc
        tracking = None if self._before is None else self._before.tracking
        self._write(LastSeen(place, utc, tracking, False, self._standing.why_untrusted))

    def _write(self, seen: LastSeen) -> None:
        self._written = seen
        words = "its position counts" if seen.trusted else f"its position doesn't count: {seen.why}"
        self._book.note_now(EntryKind.STANDING, words, seen.facts())


__all__ = ["ELSEWHERE_DEG", "LastSeen", "Memory", "seen_of", "strayed_deg", "why_not_to_trust"]
