"""Looks of the journal as pointing observations: what models, doctor and drift report are made from."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterable
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import TypeVar

from mountnav.devices import MountReading, PierSide
from mountnav.journal.reading import COMMAND, LOOK, JournalReader, Wanted
from mountnav.journal.records import CommandEnd, CommandRecord, LookRecord, Outcome
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import displaced, half_turn_deg, offset_arcsec, separation_arcsec

MAX_MOTION_ARCSEC = 120.0
"""Readings round an exposure farther apart than this are no reading of one place."""
UNKNOWN_SIGMA_ARCSEC = 2.0
"""Taken for a solution that tells no error."""
_LOOK_BACK = timedelta(hours=24)
# An axis that a slew moves by less, degrees (30″), tells no sense of turning. Chosen by hand; doubled,
# small corrections of half an arcminute to one count for nothing in the play of the gears.
_STILL_DEG = 30.0 / 3600.0

Kind = TypeVar("Kind", Apparent, Icrs)


def observations(
    journal: str | Path | JournalReader,
    telescope: str,
    since: datetime | None = None,
    until: datetime | None = None,
) -> list[PointingObservation]:
    """Solved looks of a telescope, in the order of time.

    Looks during which the mount slewed, or moved more than 120″, are left out.

    Parameters
    ----------
    journal : str, Path or JournalReader
        Its file, its URL, or a reader.
    since, until : datetime, optional
        From (included) and to (not included).

    Returns
    -------
    list of PointingObservation
        Readings raw, in the mount's own kind of coordinates, moved to mid-exposure on the great circle.

    Raises
    ------
    BadSettings, JournalFailed, Unknown
        There is no such journal, or it can't be read.
    """
    reader = journal if isinstance(journal, JournalReader) else JournalReader(journal)
    wanted = Wanted(telescope=telescope, kinds=frozenset({LOOK}), since=since, until=until, outcome="solved")
    looks = reader.looks(wanted)
    if not looks:
        return []
    orders = Wanted(
        telescope=telescope,
        kinds=frozenset({COMMAND}),
        since=looks[0].utc - _LOOK_BACK,
        until=until,
    )
    motions = _Motions(reader.commands(orders))
    found = (observation_of(look) for look in looks)
    return [replace(one, from_side=motions.before(one.utc)) for one in found if one is not None]


def observation_of(look: LookRecord) -> PointingObservation | None:
    """A solved look as an observation; None for one that can't be used."""
    seen = look.seen
    if not look.solved or look.reason or seen is None or look.before.slewing or look.after.slewing:
        return None
    reading = reading_at(look.before, look.after, look.utc)
    if reading is None:
        return None
    return PointingObservation(
        utc=look.utc,
        seen=seen,
        sigma_arcsec=_sigma(look),
        reading=reading,
        side=look.after.pier_side or look.before.pier_side or PierSide.UNKNOWN,
        segment_id=look.segment_id,
        air=look.air,
        rotation_deg=look.rotation_deg,
        scale_arcsec_px=look.scale_arcsec_px,
        parity=look.parity,
        model_id=look.model_id,
        look_id=look.look_id,
    )


def reading_at(before: MountReading, after: MountReading, utc: datetime) -> Apparent | Icrs | None:
    """The mount's reading at an instant between two readings; None if it moved, or their kinds differ.

    On the great circle between the two places, in proportion to time; their middle where their instants don't
    enclose it.
    """
    first, second = before.place, after.place
    if isinstance(first, Apparent) and isinstance(second, Apparent):
        return _between(replace(first, utc=utc), replace(second, utc=utc), _share(before, after, utc))
    if isinstance(first, Icrs) and isinstance(second, Icrs):
        return _between(first, second, _share(before, after, utc))
    return None


def _between(first: Kind, second: Kind, share: float) -> Kind | None:
    # NaN compares false: a reading that is none is left out too
    if not separation_arcsec(first, second) <= MAX_MOTION_ARCSEC:
        return None
    way = offset_arcsec(second, first)
    return displaced(first, share * way.east_arcsec, share * way.north_arcsec)


def _share(before: MountReading, after: MountReading, utc: datetime) -> float:
    span_s = (after.utc - before.utc).total_seconds()
    gone_s = (utc - before.utc).total_seconds()
    return gone_s / span_s if span_s > 0 and 0 <= gone_s <= span_s else 0.5


def _sigma(look: LookRecord) -> float:
    """One sigma per coordinate: the mean of the covariance's two variances, else by rms and stars."""
    if look.covariance_arcsec2 is not None:
        east, _, north = look.covariance_arcsec2
        variance = 0.5 * (east + north)
        if math.isfinite(variance) and variance > 0:
            return math.sqrt(variance)
    if look.rms_arcsec is not None and look.pairs > 0 and look.rms_arcsec > 0:
        return look.rms_arcsec / math.sqrt(look.pairs)
    return UNKNOWN_SIGMA_ARCSEC


class _Motions:
    """In which sense the axes moved last, by slews that were carried out."""

    def __init__(self, commands: Iterable[tuple[CommandRecord, CommandEnd | None]]) -> None:
        self._utcs: list[datetime] = []
        self._senses: list[tuple[int, int]] = []
        for command, end in commands:
            if command.order in ("slew", "park", "home", "guide"):
                self._utcs.append(command.utc)
                self._senses.append(_senses(command, end))

    def before(self, utc: datetime) -> tuple[int, int]:
        at = bisect.bisect_right(self._utcs, utc)
        return self._senses[at - 1] if at else (0, 0)


def _senses(command: CommandRecord, end: CommandEnd | None) -> tuple[int, int]:
    """Sense of a slew per axis; nothing is told of one that flipped, ended otherwise, or hardly moved."""
    before, place = command.before, command.place
    if command.order != "slew" or before is None or place is None or type(before.place) is not type(place):
        return 0, 0
    if end is None or end.outcome is not Outcome.DONE:
        return 0, 0
    sides = {before.pier_side, None if end.after is None else end.after.pier_side}
    if {PierSide.EAST, PierSide.WEST} <= sides:
        return 0, 0
    ra_deg = half_turn_deg(place.ra_deg - before.place.ra_deg)
    dec_deg = place.dec_deg - before.place.dec_deg
    return _sense(-ra_deg), _sense(dec_deg)


def _sense(moved_deg: float) -> int:
    return 0 if abs(moved_deg) < _STILL_DEG else 1 if moved_deg > 0 else -1
