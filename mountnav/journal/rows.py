"""Records to rows and back; nothing is lost on the way but NaN, which becomes "not known"."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from mountnav.devices import MountReading, PierSide
from mountnav.journal.records import (
    Cause,
    CommandEnd,
    CommandRecord,
    Entry,
    EntryKind,
    LookRecord,
    Outcome,
)
from mountnav.sky.coordinates import Air, Apparent, Icrs

Row = dict[str, Any]


def look_row(record: LookRecord, run_id: str) -> Row:
    """A look as a row of `tables.look`."""
    seen, covariance = record.seen, record.covariance_arcsec2
    return {
        "look_id": record.look_id,
        "telescope": record.telescope,
        "utc": record.utc,
        "solved": bool(record.solved),
        "reason": record.reason,
        "detail": record.detail,
        "seen_ra_deg": None if seen is None else seen.ra_deg,
        "seen_dec_deg": None if seen is None else seen.dec_deg,
        "covariance_east_arcsec2": None if covariance is None else covariance[0],
        "covariance_cross_arcsec2": None if covariance is None else covariance[1],
        "covariance_north_arcsec2": None if covariance is None else covariance[2],
        **_reading_row("before", record.before),
        **_reading_row("after", record.after),
        "segment_id": record.segment_id,
        "model_id": record.model_id,
        "pressure_hpa": record.air.pressure_hpa,
        "temperature_c": record.air.temperature_c,
        "relative_humidity": record.air.relative_humidity,
        "wavelength_um": record.air.wavelength_um,
        "dut1_s": record.dut1_s,
        "camera": record.camera,
        "source": record.source,
        "exposure_s": record.exposure_s,
        "mode": record.mode,
        "catalog": record.catalog,
        "pairs": int(record.pairs),
        "rms_arcsec": record.rms_arcsec,
        "false_probability": record.false_probability,
        "scale_arcsec_px": record.scale_arcsec_px,
        "rotation_deg": record.rotation_deg,
        "parity": None if record.parity is None else int(record.parity),
        "fwhm_px": record.fwhm_px,
        "limiting_mag": record.limiting_mag,
        "sky_adu": record.sky_adu,
        "measured": int(record.measured),
        "used": record.used,
        **_cause_row(record.cause, run_id),
    }


def look_of(row: Mapping[str, Any]) -> LookRecord:
    """The look of a row."""
    covariance = tuple(row[f"covariance_{name}_arcsec2"] for name in ("east", "cross", "north"))
    before, after = _reading_of("before", row), _reading_of("after", row)
    assert before is not None
    assert after is not None
    return LookRecord(
        look_id=row["look_id"],
        telescope=row["telescope"],
        utc=row["utc"],
        solved=row["solved"],
        reason=row["reason"],
        detail=row["detail"],
        seen=None if row["seen_ra_deg"] is None else Icrs(row["seen_ra_deg"], _number(row["seen_dec_deg"])),
        covariance_arcsec2=None if None in covariance else (covariance[0], covariance[1], covariance[2]),
        before=before,
        after=after,
        segment_id=row["segment_id"],
        model_id=row["model_id"],
        air=Air(
            _number(row["pressure_hpa"]),
            _number(row["temperature_c"]),
            _number(row["relative_humidity"]),
            _number(row["wavelength_um"]),
        ),
        dut1_s=_number(row["dut1_s"]),
        camera=row["camera"],
        source=row["source"],
        exposure_s=_number(row["exposure_s"]),
        mode=row["mode"],
        catalog=row["catalog"],
        pairs=row["pairs"],
        rms_arcsec=row["rms_arcsec"],
        false_probability=row["false_probability"],
        scale_arcsec_px=row["scale_arcsec_px"],
        rotation_deg=row["rotation_deg"],
        parity=row["parity"],
        fwhm_px=row["fwhm_px"],
        limiting_mag=row["limiting_mag"],
        sky_adu=row["sky_adu"],
        measured=row["measured"],
        used=row["used"],
        cause=_cause_of(row),
    )


def command_row(record: CommandRecord, run_id: str) -> Row:
    """A command as a row of `tables.command`, open."""
    return {
        "command_id": record.command_id,
        "telescope": record.telescope,
        "utc": record.utc,
        "order": record.order,
        **_place_row("to", record.place),
        "facts": dict(record.facts),
        **_reading_row("before", record.before),
        "segment_id": record.segment_id,
        **_cause_row(record.cause, run_id),
    }


def command_of(row: Mapping[str, Any]) -> CommandRecord:
    """The command of a row."""
    return CommandRecord(
        command_id=row["command_id"],
        telescope=row["telescope"],
        utc=row["utc"],
        order=row["order"],
        place=_place_of("to", row),
        facts=row["facts"],
        before=_reading_of("before", row),
        segment_id=row["segment_id"],
        cause=_cause_of(row),
    )


def end_row(end: CommandEnd) -> Row:
    """A command's end, as the columns of `tables.command` that close it."""
    return {
        "ended_utc": end.utc,
        "outcome": str(end.outcome),
        "end_detail": end.detail,
        **_reading_row("after", end.after),
        "miss_arcsec": end.miss_arcsec,
        "end_facts": dict(end.facts),
    }


def end_of(row: Mapping[str, Any]) -> CommandEnd | None:
    """The end of a command; None while it is open."""
    if row["outcome"] is None:
        return None
    return CommandEnd(
        utc=row["ended_utc"],
        outcome=Outcome(row["outcome"]),
        detail=row["end_detail"],
        after=_reading_of("after", row),
        miss_arcsec=row["miss_arcsec"],
        facts=row["end_facts"],
    )


def entry_row(record: Entry, run_id: str) -> Row:
    """An entry as a row of `tables.entry`."""
    return {
        "telescope": record.telescope,
        "utc": record.utc,
        "kind": str(record.kind),
        "what": record.what,
        "facts": dict(record.facts),
        **_cause_row(record.cause, run_id),
    }


def entry_of(row: Mapping[str, Any]) -> Entry:
    """The entry of a row; a kind of a later program's is a note."""
    known = row["kind"] in EntryKind.__members__.values()
    return Entry(
        utc=row["utc"],
        telescope=row["telescope"],
        kind=EntryKind(row["kind"]) if known else EntryKind.NOTE,
        what=row["what"],
        facts=row["facts"],
        cause=_cause_of(row),
    )


def _place_row(prefix: str, place: Apparent | Icrs | None) -> Row:
    return {
        f"{prefix}_ra_deg": None if place is None else place.ra_deg,
        f"{prefix}_dec_deg": None if place is None else place.dec_deg,
        f"{prefix}_frame": None if place is None else "apparent" if isinstance(place, Apparent) else "icrs",
        f"{prefix}_place_utc": place.utc if isinstance(place, Apparent) else None,
    }


def _place_of(prefix: str, row: Mapping[str, Any]) -> Apparent | Icrs | None:
    frame = row[f"{prefix}_frame"]
    if frame is None:
        return None
    ra_deg, dec_deg = _number(row[f"{prefix}_ra_deg"]), _number(row[f"{prefix}_dec_deg"])
    if frame == "apparent":
        utc: datetime = row[f"{prefix}_place_utc"]
        return Apparent(ra_deg, dec_deg, utc)
    return Icrs(ra_deg, dec_deg)


def _reading_row(prefix: str, reading: MountReading | None) -> Row:
    side = None if reading is None else reading.pier_side
    return {
        **_place_row(prefix, None if reading is None else reading.place),
        f"{prefix}_utc": None if reading is None else reading.utc,
        f"{prefix}_slewing": None if reading is None else reading.slewing,
        f"{prefix}_tracking": None if reading is None else reading.tracking,
        f"{prefix}_parked": None if reading is None else reading.parked,
        f"{prefix}_at_home": None if reading is None else reading.at_home,
        f"{prefix}_pier_side": None if side is None else str(side),
    }


def _reading_of(prefix: str, row: Mapping[str, Any]) -> MountReading | None:
    place = _place_of(prefix, row)
    if place is None:
        return None
    side = row[f"{prefix}_pier_side"]
    return MountReading(
        place=place,
        utc=row[f"{prefix}_utc"],
        slewing=row[f"{prefix}_slewing"],
        tracking=row[f"{prefix}_tracking"],
        parked=row[f"{prefix}_parked"],
        at_home=row[f"{prefix}_at_home"],
        pier_side=None if side is None else PierSide(side),
    )


def _cause_row(one: Cause, run_id: str) -> Row:
    return {
        "run_id": run_id,
        "cause_job_id": one.job_id,
        "cause_night_id": one.night_id,
        "cause_look_id": one.look_id,
        "why": one.why,
    }


def _cause_of(row: Mapping[str, Any]) -> Cause:
    return Cause(row["cause_job_id"], row["cause_night_id"], row["cause_look_id"], row["why"])


def _number(value: float | None) -> float:
    return math.nan if value is None else value
