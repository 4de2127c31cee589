"""A slew, a look and a note, as tests write them."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from mountnav.devices import MountReading, PierSide
from mountnav.journal.records import Cause, CommandRecord, Entry, EntryKind, LookRecord, new_id
from mountnav.sky.coordinates import Air, Apparent, Icrs

NIGHT = datetime(2026, 11, 22, 3, 12, 45, 123456, tzinfo=UTC)


def at(seconds: float) -> datetime:
    return NIGHT + timedelta(seconds=seconds)


def slew_of(telescope: str = "east", seconds: float = 0.0, **other: object) -> CommandRecord:
    values: dict[str, object] = {
        "command_id": new_id(),
        "telescope": telescope,
        "utc": at(seconds),
        "order": "slew",
        "segment_id": "segment",
        "place": Apparent(120.0, 40.0, at(seconds)),
        "before": MountReading(Apparent(100.0, 20.0, at(seconds)), at(seconds)),
    }
    return CommandRecord(**(values | other))  # type: ignore[arg-type]


def look_of(telescope: str = "east", seconds: float = 0.0, **other: object) -> LookRecord:
    reading = MountReading(Apparent(120.0, 40.0, at(seconds)), at(seconds - 2.0), tracking=True)
    values: dict[str, object] = {
        "look_id": new_id(),
        "telescope": telescope,
        "utc": at(seconds),
        "solved": True,
        "before": reading,
        "after": MountReading(Apparent(120.0, 40.0, at(seconds)), at(seconds + 2.0), pier_side=PierSide.WEST),
        "segment_id": "segment",
        "air": Air(1010.0),
        "seen": Icrs(120.01, 40.01),
        "covariance_arcsec2": (0.04, 0.01, 0.09),
        "pairs": 42,
        "rms_arcsec": 0.4,
    }
    return LookRecord(**(values | other))  # type: ignore[arg-type]


def note_of(what: str, telescope: str = "east", seconds: float = 0.0, **other: object) -> Entry:
    values: dict[str, object] = {
        "utc": at(seconds),
        "telescope": telescope,
        "kind": EntryKind.NOTE,
        "what": what,
        "cause": Cause(),
    }
    return Entry(**(values | other))  # type: ignore[arg-type]
