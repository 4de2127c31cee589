"""What a replay decides from: a recorded night's state, events and contexts, and the mount's beliefs."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import cast

from mountnav.devices import Epoch, MountReading, for_mount
from mountnav.errors import SyncDoubt
from mountnav.navigation.outside_frames import By, Judged
from mountnav.navigation.reading_history import Around, Meanwhile
from mountnav.navigation.reports import Look
from mountnav.navigation.vetoes import Counts, SyncContext
from mountnav.night.events import (
    NO_OFFSET,
    CorrectionEnded,
    Event,
    Evidence,
    FrameSeen,
    NightState,
    Said,
    Tick,
    Word,
)
from mountnav.night.memory import plate_of, state_with
from mountnav.night.recording import Json, RecordedSync, offset_of, reading_of
from mountnav.pointing.model.in_force import Expected
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.sphere import half_turn_deg, turn_deg

__all__ = ["Beliefs", "event_of", "judged_of", "meanwhile_of", "state_of"]


def state_of(record: Json) -> NightState:
    """A night's state, whole; the journal's (`mountnav.night.memory.state_of`) holds less."""
    evidence = record["evidence"]
    return replace(
        state_with(record, offset_of(record["applied"]) or NO_OFFSET),
        evidence=None if evidence is None else _evidence(evidence),
        busy_until=_instant(record["busy_until"]),
        # not in recordings of before 2026-11-24
        safe_until=_instant(record.get("safe_until")),
        free=bool(record["free"]),
    )


def event_of(record: Json) -> Event:
    """An event."""
    utc = datetime.fromisoformat(record["utc"])
    match record["is"]:
        case "Tick":
            return Tick(utc, float(record["sun_altitude_deg"]), str(record["night_id"]))
        case "Said":
            return Said(
                utc,
                Word(record["word"]),
                str(record["why"]),
                _instant(record["until"]),
                str(record["night_id"]),
                str(record.get("by", "")),
            )
        case "FrameSeen":
            return _frame_seen(utc, record)
        case _:
            return CorrectionEnded(
                utc,
                str(record["frame_id"]),
                str(record["outcome"]),
                offset_of(record["meant"]),
                tuple(record["doubts"]),
            )


def meanwhile_of(record: Json) -> Meanwhile:
    """What a frame was compared by."""
    around = record["around"]
    model_id = record["model_id"]
    return Meanwhile(
        around=None if around is None else _around(around),
        allowed_arcsec=float(record["allowed_arcsec"]),
        moved_utc=_instant(record["moved_utc"]),
        segment_id=str(record["segment_id"]),
        model_id=None if model_id is None else str(model_id),
        not_fresh=str(record["not_fresh"]),
        tolerance_arcsec=_or_infinite(record["tolerance_arcsec"]),
    )


def _or_infinite(value: float | None) -> float:
    return math.inf if value is None else float(value)


def judged_of(record: Json) -> Judged:
    """What a correction was judged by."""
    doubts = tuple(SyncDoubt(doubt) for doubt in record["doubts"])
    return Judged(cast("By", record["by"]), _context(record["context"]), doubts)


def _context(record: Json) -> SyncContext:
    site, air, counts, expected = (record[name] for name in ("site", "air", "counts", "expected"))
    return SyncContext(
        now=datetime.fromisoformat(record["now"]),
        site=Site(*(float(site[name]) for name in ("latitude_deg", "longitude_deg", "height_m"))),
        air=Air(
            *(
                float(air[name])
                for name in ("pressure_hpa", "temperature_c", "relative_humidity", "wavelength_um")
            )
        ),
        resolution_arcsec=float(record["resolution_arcsec"]),
        last_moved_utc=_instant(record["last_moved_utc"]),
        expected=None if expected is None else _expected(expected),
        lost=bool(record["lost"]),
        polar=bool(record["polar"]),
        trusted=bool(record["trusted"]),
        modeled=bool(record["modeled"]),
        expected_by=str(record["expected_by"]),
        departures={SyncDoubt(kind): str(words) for kind, words in record["departures"].items()},
        counts=Counts(int(counts["tonight"]), int(counts["on_target"])),
    )


def _expected(record: Json) -> Expected:
    sigma = record["sigma_arcsec"]
    return Expected(offset_of(record["offset"]) or NO_OFFSET, math.inf if sigma is None else float(sigma))


def _around(record: Json) -> Around:
    return Around(
        reading_of(record["before"]),
        reading_of(record["after"]),
        float(record["moved_arcsec"]),
        bool(record["slewing"]),
    )


def _frame_seen(utc: datetime, record: Json) -> FrameSeen:
    plate, sigma = record["plate"], record["sigma_arcsec"]
    return FrameSeen(
        utc=utc,
        frame_id=str(record["frame_id"]),
        arrived_utc=datetime.fromisoformat(record["arrived_utc"]),
        mid_utc=_instant(record["mid_utc"]),
        begun_utc=_instant(record["begun_utc"]),
        held=bool(record["held"]),
        placed=bool(record["placed"]),
        fully=bool(record["fully"]),
        plate=None if plate is None else plate_of(plate),
        error=offset_of(record["error"]),
        of_target=bool(record["of_target"]),
        sigma_arcsec=math.nan if sigma is None else float(sigma),
        doubts=tuple(record["doubts"]),
        moving=bool(record["moving"]),
        field=str(record["field"]),
        segment=str(record["segment"]),
        detail=str(record["detail"]),
    )


def _evidence(record: Json) -> Evidence:
    return Evidence(
        tuple(record["frame_ids"]),
        datetime.fromisoformat(record["utc"]),
        offset_of(record["error"]) or NO_OFFSET,
        str(record["segment"]),
        str(record["field"]),
    )


def _instant(text: str | None) -> datetime | None:
    return None if text is None else datetime.fromisoformat(text)


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
        seen, believed = (for_mount(place, kind, utc) for place in (look.seen, look.believed))
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
        """What the mount's readings round a frame would have been."""
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
        since = [change for change in self._changes if change.utc <= reading.utc]
        ra_deg, dec_deg = sum(change.ra_deg for change in since), sum(change.dec_deg for change in since)
        if ra_deg == 0.0 and dec_deg == 0.0:
            return reading
        moved = replace(place, ra_deg=turn_deg(place.ra_deg + ra_deg), dec_deg=place.dec_deg + dec_deg)
        return replace(reading, place=moved)
