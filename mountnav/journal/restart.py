"""After a restart: what was in flight, where the mount stands now, what that tells. Repeats nothing.

A command that was begun and not closed may have been sent or not: the process ended in between. The mount is
read, the command closed as unknown with that reading and a judgment in words, and an operator is told until a
look, a sync, or his own word settles it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Protocol

from mountnav.devices import MountReading
from mountnav.journal.guesses import Likely, judged, named
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import CommandEnd, CommandRecord, Entry, EntryKind, Journal, Outcome
from mountnav.journal.wanted import COMMAND, LOOK, Wanted
from mountnav.sky.coordinates import utc_now

RESTART, ACKNOWLEDGED = "restart", "restart-acknowledged"
"""What the facts of such entries say under `about`."""


class Readable(Protocol):
    """What is asked of a mount here: where it stands."""

    @property
    def name(self) -> str:
        """Name and address."""
        ...

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step of a reported place."""
        ...

    async def reading(self) -> MountReading:
        """Where the mount believes it points."""
        ...


@dataclass(frozen=True, slots=True)
class TakenUp:
    """A command that was in flight.

    Attributes
    ----------
    command : CommandRecord
    likely : Likely
        What the mount's reading says became of it.
    words : str
        The same for people, with numbers.
    miss_arcsec : float or None
        Between the reading and the ordered place.
    """

    command: CommandRecord
    likely: Likely
    words: str
    miss_arcsec: float | None


@dataclass(frozen=True, slots=True)
class Restart:
    """What was found when a telescope was taken up again.

    Attributes
    ----------
    telescope : str
    utc : datetime
    commands : tuple of TakenUp
        Those that were in flight; now closed as unknown.
    reading : MountReading or None
        Where the mount stands; None when nothing had to be asked.
    notice : str or None
        What an operator should know until it is settled; also of an earlier restart that never was.
    """

    telescope: str
    utc: datetime
    commands: tuple[TakenUp, ...] = ()
    reading: MountReading | None = None
    notice: str | None = None
    moving: bool = field(default=False)
    """The mount says it is moving: the last order is still being carried out, or somebody else moves it."""


async def take_up(
    journal: Journal,
    reader: JournalReader,
    telescope: str,
    mount: Readable,
    *,
    run_id: str | None = None,
    utc: Callable[[], datetime] = utc_now,
) -> Restart:
    """Take a telescope up again: close what was in flight, tell what isn't known. Sends nothing that moves.

    Call it when the telescope's link is first up. If it raises, nothing was lost: call it again.

    Parameters
    ----------
    journal : Journal
    reader : JournalReader
        Of the same journal.
    telescope : str
    mount : Readable
    run_id : str, optional
        This run of the service, whose own commands are under way; the journal's if it has one.
    utc : callable, optional
        The clock.

    Returns
    -------
    Restart

    Raises
    ------
    DeviceError
        The mount can't be read: what was in flight stays open.
    JournalFailed
    """
    own = run_id if run_id is not None else getattr(journal, "run_id", None)
    open_ones = await asyncio.to_thread(reader.in_flight, telescope, but_run=own)
    if not open_ones:
        notice = await asyncio.to_thread(_unsettled, reader, telescope)
        return Restart(telescope, utc(), notice=notice)
    reading = await mount.reading()
    taken = []
    for number, command in enumerate(open_ones):
        later = open_ones[number + 1 :]
        likely, words, miss_arcsec = judged(command, reading, mount.resolution_arcsec, overtaken=bool(later))
        taken.append(TakenUp(command, likely, words, miss_arcsec))
    now = utc()
    notice = _notice(taken)
    # the notice first: killed between the two, the next start closes what is left and tells once more
    await journal.note(
        Entry(
            now,
            telescope,
            EntryKind.FAULT,
            notice,
            {
                "about": RESTART,
                "commands": [
                    {"command_id": one.command.command_id, "order": one.command.order, "likely": one.likely}
                    for one in taken
                ],
            },
        )
    )
    for one in taken:
        end = CommandEnd(
            now,
            Outcome.UNKNOWN,
            one.words,
            reading,
            one.miss_arcsec,
            {"likely": one.likely, "closed_by": RESTART},
        )
        await journal.end(one.command.command_id, end)
    return Restart(telescope, now, tuple(taken), reading, notice, bool(reading.slewing))


async def acknowledge(
    journal: Journal, telescope: str, who: str = "an operator", utc: Callable[[], datetime] = utc_now
) -> None:
    """Write down that an operator has seen the notice: it isn't shown any more. Raises `JournalFailed`."""
    what = f"{who} has taken note of what was in flight at the restart"
    await journal.note(Entry(utc(), telescope, EntryKind.NOTE, what, {"about": ACKNOWLEDGED}))


def settles(kind: str, outcome: str | bool | None = None) -> bool:
    """Whether a later look or command makes the notice needless.

    A solved look tells where the tube points, a sync that was seen or a home that was found what the mount
    believes.
    """
    if kind == LOOK:
        return bool(outcome)
    return kind in ("sync", "home") and outcome == Outcome.DONE


def _unsettled(reader: JournalReader, telescope: str) -> str | None:
    """The notice of an earlier restart that nothing has settled since."""
    faults = Wanted(telescope=telescope, kinds=frozenset({EntryKind.FAULT}))
    told = next(
        (
            one
            for one in reader.entries(faults, limit=100, newest_first=True)
            if one.facts.get("about") == RESTART
        ),
        None,
    )
    if told is None:
        return None
    since = Wanted(telescope=telescope, since=told.utc, kinds=frozenset({LOOK}), outcome="solved")
    if reader.looks(since, limit=1):
        return None
    done = Wanted(telescope=telescope, since=told.utc, kinds=frozenset({COMMAND}), outcome=str(Outcome.DONE))
    if any(settles(command.order, Outcome.DONE) for command, _ in reader.commands(done)):
        return None
    notes = Wanted(telescope=telescope, since=told.utc, kinds=frozenset({EntryKind.NOTE}))
    if any(one.facts.get("about") == ACKNOWLEDGED for one in reader.entries(notes)):
        return None
    return told.what


def _notice(taken: list[TakenUp]) -> str:
    if len(taken) == 1:
        return f"the service was killed with {named(taken[0].command)} in flight: {taken[0].words}"
    told = "; ".join(f"{named(one.command)}: {one.words}" for one in taken)
    return f"the service was killed with {len(taken)} commands in flight: {told}"
