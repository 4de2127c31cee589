"""What a recorded night's decisions hang on, read back: its state, its events, what each was judged by."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime
from typing import cast

from mountnav.errors import SyncDoubt
from mountnav.navigation.between_frames import By, Judged
from mountnav.navigation.doubts import Counts, SyncContext
from mountnav.navigation.readings_kept import Around, Meanwhile
from mountnav.night.events import CorrectionEnded, Event, FrameSeen, Said, Tick, Word
from mountnav.night.memory import plate_of, state_with
from mountnav.night.recorded import Json, offset_of, reading_of
from mountnav.night.states import NO_OFFSET, Evidence, NightState
from mountnav.pointing.model.in_force import Expected
from mountnav.sky.coordinates import Air, Site


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
    )


def judged_of(record: Json) -> Judged:
    """What a correction was judged by."""
    doubts = tuple(SyncDoubt(one) for one in record["doubts"])
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


__all__ = ["event_of", "judged_of", "meanwhile_of", "state_of"]
