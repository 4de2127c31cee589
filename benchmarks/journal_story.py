"""Whether a journal alone tells the whole story of a simulated night: rules, each with what it misses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Protocol

from benchmarks.worlds import World
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import CommandEnd, CommandRecord, Entry, EntryKind, Outcome

_ORDERS = ("slew", "sync", "park", "unpark", "home", "track", "guide")


class Ordered(Protocol):
    """A target of the schedule, as far as its story goes."""

    name: str
    at: datetime
    ended: datetime | None
    said: str


def untold(file: Path, world: World, targets: Sequence[Ordered], received: Sequence[str]) -> list[str]:
    """What the journal doesn't tell, or tells wrongly.

    Parameters
    ----------
    file : Path
    world : World
        What happened in truth: its script.
    targets : sequence
        What was ordered, and how it ended for whoever ordered it.
    received : sequence of str
        Every order that reached the mount, in its order.
    """
    reader = JournalReader(file)
    commands, entries, looks = reader.commands(), reader.entries(), reader.looks()
    missing = [f"the journal: {what}" for what in _commands(commands, received)]
    missing += [f"the journal: {what}" for what in _incidents(entries, commands, world, targets)]
    missing += [f"the journal: {what}" for what in _targets(entries, targets)]
    causes = {look.cause.job_id for look in looks} | {one.cause.night_id for one in looks}
    if None in causes and len(causes) == 1:
        missing.append("the journal: no look tells what it was taken for")
    if any(look.solved and look.seen is None for look in looks):
        missing.append("the journal: a solved look without its place")
    if any(not look.segment_id for look in looks):
        missing.append("the journal: a look without its segment")
    return missing


def _commands(
    commands: Sequence[tuple[CommandRecord, CommandEnd | None]], received: Sequence[str]
) -> Iterator[str]:
    """Each command is closed, and what the mount received is what was written."""
    for command, end in commands:
        if end is None:
            yield f"the {command.order} of {command.utc:%H:%M:%S} was never closed"
    written = Counter(
        command.order for command, end in commands if end is not None and end.outcome is not Outcome.NOT_SENT
    )
    known = Counter(
        command.order
        for command, end in commands
        if end is not None
        and end.outcome in (Outcome.DONE, Outcome.LATE, Outcome.IGNORED, Outcome.ELSEWHERE, Outcome.STALLED)
    )
    got = Counter(received)
    for order in _ORDERS:
        if got[order] > written[order]:
            yield f"{got[order]} times {order} reached the mount, {written[order]} were written down"
        if got[order] < known[order]:
            yield f"{known[order]} times {order} is said to have been done, the mount got {got[order]}"


def _incidents(
    entries: Sequence[Entry],
    commands: Sequence[tuple[CommandRecord, CommandEnd | None]],
    world: World,
    targets: Sequence[Ordered],
) -> Iterator[str]:
    """What happened to the mount stands in the journal, within a minute of its end."""
    told = (EntryKind.FAULT, EntryKind.LINK, EntryKind.SEGMENT)
    for incident in world.script.incidents:
        at = world.start + timedelta(minutes=incident.at_min)
        until = at + timedelta(seconds=incident.for_s + 60.0)
        if at > max(target.at for target in targets):
            continue
        if incident.what == "silence" and incident.for_s < 1.5:
            continue
        near = [entry for entry in entries if at <= entry.utc <= until and entry.kind in told]
        failed = [
            command
            for command, end in commands
            if end is not None and at <= end.utc <= until and end.outcome is Outcome.UNKNOWN
        ]
        if not near and not failed:
            yield f"nothing tells of the {incident.what} at {at:%H:%M:%S}"
        if incident.what == "reboot" and not any(entry.kind is EntryKind.SEGMENT for entry in near):
            yield f"no new segment after the reboot at {at:%H:%M:%S}"


def _targets(entries: Sequence[Entry], targets: Sequence[Ordered]) -> Iterator[str]:
    """How each target ended stands there, with the numbers of its last look if it was centered."""
    ends = (EntryKind.CENTERING, EntryKind.REFUSAL, EntryKind.FAULT)
    for target in targets:
        if target.ended is None:
            continue
        of_it = [one for one in entries if one.cause.job_id == target.name and one.kind in ends]
        if not of_it:
            yield f"nothing tells how {target.name} ended ({target.said[:80]})"
        elif target.said == "centered" and not any(
            one.kind is EntryKind.CENTERING and "centered" in f"{one.what} {one.facts}" for one in of_it
        ):
            yield f"{target.name} was centered, and the journal doesn't say so"
