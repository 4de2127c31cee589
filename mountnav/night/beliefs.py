"""What the mount would have believed, had a night synced otherwise: for replays by other rules."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import datetime

from mountnav.devices import Epoch, MountReading
from mountnav.navigation.kinds import for_mount
from mountnav.navigation.readings_kept import Around, Meanwhile
from mountnav.navigation.reports import Look
from mountnav.night.recorded import RecordedSync
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import half_turn_deg, turn_deg


@dataclass(slots=True)
class Beliefs:
    """Syncs that were made then and aren't now, and the other way round. By the same rules there are none.

    A slew changes nothing of this: what is seen minus what is believed is the same wherever the tube is moved
    to, and the recorded frames stay where they were.
    """

    _changes: list[RecordedSync] = field(default_factory=list)
    _told: str = ""
    _now: str = ""
    _unmade: bool = False

    @property
    def changed(self) -> bool:
        """Whether it believes otherwise than it did."""
        return bool(self._changes)

    def unmade(self, sync: RecordedSync) -> None:
        """A sync of the recorded night isn't made now."""
        self._changes.append(RecordedSync(sync.utc, -sync.ra_deg, -sync.dec_deg))
        self._unmade = True

    def made(self, utc: datetime, look: Look, *, recorded: RecordedSync | None) -> None:
        """A sync on a look is made now; the recorded night made another one in its place, or none."""
        kind: Epoch = "icrs" if isinstance(look.after.place, Icrs) else "apparent"
        seen, believed = (for_mount(one, kind, utc) for one in (look.seen, look.believed))
        if recorded is not None:
            self._changes.append(RecordedSync(utc, -recorded.ra_deg, -recorded.dec_deg))
        else:
            # zero points of its own
            self._now += "'"
        self._changes.append(
            RecordedSync(utc, half_turn_deg(seen.ra_deg - believed.ra_deg), seen.dec_deg - believed.dec_deg)
        )

    def segment(self, told: str) -> str:
        """Which zero points are in force: those of a sync that wasn't made are those of before it."""
        if told != self._told:
            self._told = told
            if not self._unmade:
                self._now = told
            self._unmade = False
        return self._now

    def of(self, meanwhile: Meanwhile) -> Meanwhile:
        """What the mount would have said round a frame."""
        around = meanwhile.around
        if not self._changes or around is None:
            return meanwhile
        moved = Around(
            self._reading(around.before),
            self._reading(around.after),
            around.moved_arcsec,
            around.slewing,
        )
        return replace(meanwhile, around=moved)

    def _reading(self, reading: MountReading) -> MountReading:
        place = reading.place
        since = [one for one in self._changes if one.utc <= reading.utc]
        ra_deg, dec_deg = sum(one.ra_deg for one in since), sum(one.dec_deg for one in since)
        if ra_deg == 0.0 and dec_deg == 0.0:
            return reading
        moved = replace(place, ra_deg=turn_deg(place.ra_deg + ra_deg), dec_deg=place.dec_deg + dec_deg)
        return replace(reading, place=moved)


__all__ = ["Beliefs"]
