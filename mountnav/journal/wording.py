"""A line of the journal in words, and as a JSON object: what people and programs are shown."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from mountnav.journal.database import plain_json
from mountnav.journal.reading import Line
from mountnav.journal.records import CommandRecord, EntryKind, LookRecord
from mountnav.journal.restart import named
from mountnav.journal.rows import command_row, end_row, entry_row, look_row


def in_words(line: Line) -> str:
    """What happened, in one sentence."""
    record = line.record
    if isinstance(record, LookRecord):
        if record.seen is None:
            return f"not solved: {record.reason}{f' ({record.detail})' if record.detail else ''}"
        rms = "" if record.rms_arcsec is None else f", rms {record.rms_arcsec:.2f}″"
        place = f"RA {record.seen.ra_deg:.4f}° Dec {record.seen.dec_deg:+.4f}°"
        return f"seen at {place}: {record.pairs} stars{rms}{f', for {record.used}' if record.used else ''}"
    if isinstance(record, CommandRecord):
        words = named(record)
        if line.end is None:
            return f"{words}: open"
        miss = "" if line.end.miss_arcsec is None else f", {line.end.miss_arcsec:.0f}″ off"
        return f"{words}: {line.end.outcome}{miss}{f' ({line.end.detail})' if line.end.detail else ''}"
    why = record.facts.get("why")
    # what a mount tells unasked is a bare name, such as link-lost
    of_mount = record.kind in (EntryKind.LINK, EntryKind.FAULT)
    untold = isinstance(why, str) and why not in record.what
    return f"{record.what}: {why}" if of_mount and why and untold else record.what


def as_json(line: Line) -> dict[str, Any]:
    """All columns of a line as JSON values, with `kind` and `words` in front; instants are ISO 8601, UTC."""
    record = line.record
    if isinstance(record, LookRecord):
        row = look_row(record, line.run_id)
    elif isinstance(record, CommandRecord):
        row = command_row(record, line.run_id)
        if line.end is not None:
            row |= end_row(line.end)
    else:
        row = entry_row(record, line.run_id)
    told = {"utc": row.pop("utc"), "telescope": row.pop("telescope"), "kind": line.kind}
    row.pop("kind", None)
    plain = {name: _plain(value) for name, value in (told | {"words": in_words(line)} | row).items()}
    return {name: value for name, value in plain.items() if value is not None}


def _plain(value: object) -> object:
    return value.isoformat() if isinstance(value, datetime) else plain_json(value)
