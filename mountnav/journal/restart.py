"""After a restart: what was in flight, where the mount stands now, and what that tells. Repeats nothing.

A command that was begun and not closed may have been sent or not: the process ended in between. The mount is
read, the command is closed as unknown with that reading and a judgment in words, and the operator is warned
until a look, a sync, or a word of theirs settles it. The judgment compares where the mount stands with where
the command would have brought it: it is a guess and is called one.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Protocol

from mountnav.clock import utc_now
from mountnav.devices import MountReading, from_mount
from mountnav.journal.reading import COMMAND, LOOK, JournalReader, Wanted
from mountnav.journal.records import CommandEnd, CommandRecord, Entry, EntryKind, Journal, Outcome
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec

NEAR_ARCSEC = 120.0
"""A mount this near to a place is taken to stand there; or three of its steps, if that is more."""


class Likely(StrEnum):
    """What the mount's reading says."""

    CARRIED_OUT = "carried out"
    UNDER_WAY = "under way"
    NOT_CARRIED_OUT = "not carried out"
    PARTLY = "partly carried out"
    UNTOLD = "can't be told"


Judgment = tuple[Likely, str, float | None]


def named(command: CommandRecord) -> str:
    """A command in words."""
    if command.order in ("offset-rates", "move-axis"):
        return _moved(command)
    what = {"set-clock": "an order to set the clock", "set-site": "an order to set the site"}.get(
        command.order
    )
    if what is None:
        article = "an" if command.order[0] in "aeiou" else "a"
        what = f"{article} {command.order}"
    if command.place is None:
        return what
    kind = "apparent " if isinstance(command.place, Apparent) else ""
    return f"{what} to {kind}RA {command.place.ra_deg:.4f}° Dec {command.place.dec_deg:+.4f}°"


def _moved(command: CommandRecord) -> str:
    """An order of what goes on by itself, with its numbers as far as they are known."""
    facts = command.facts
    if command.order == "move-axis":
        rate, axis = facts.get("rate_deg_s"), facts.get("axis")
        if not isinstance(rate, int | float) or axis is None:
            return "a move-axis"
        return f"an end of the {axis} axis" if rate == 0 else f"the {axis} axis moved on at {rate:+.4g}°/s"
    ra, dec = facts.get("ra_arcsec_s"), facts.get("dec_arcsec_s")
    if not isinstance(ra, int | float) or not isinstance(dec, int | float):
        return "an order of offset rates"
    if ra == 0 and dec == 0:
        return "an end of the offset rates"
    return f"offset rates of {ra:+.4g}″/s in RA and {dec:+.4g}″/s in Dec"


def judged(
    command: CommandRecord, now: MountReading, resolution_arcsec: float, *, overtaken: bool = False
) -> Judgment:
    """Judge what became of a command.

    Parameters
    ----------
    command : CommandRecord
        Begun, and not closed.
    now : MountReading
        Where the mount stands.
    overtaken : bool
        Whether other commands in flight came behind it: then the reading tells little of this one.

    Returns
    -------
    miss_arcsec : float or None
        Between the reading and the ordered place.
    """
    sent = f"sent or not at {command.utc:%H:%M:%S} UTC; "
    stands = f"the mount now stands at {_shown(now.place)}"
    near = max(NEAR_ARCSEC, 3.0 * resolution_arcsec)
    miss = None if command.place is None else _apart(now.place, command.place)
    if overtaken and miss is None:
        return Likely.UNTOLD, f"{sent}{stands}; another order was in flight behind it", None
    if miss is not None:
        likely, words = _of_a_place(command, now, miss, near)
        return likely, f"{sent}{stands}, {_arc(miss)} from there: {words}", miss
    likely, words = _of_a_state(command, now, near)
    return likely, f"{sent}{stands}: {words}", None


def _of_a_place(command: CommandRecord, now: MountReading, miss: float, near: float) -> tuple[Likely, str]:
    came = None if command.before is None else _apart(now.place, command.before.place)
    if command.order == "sync":
        return _of_a_sync(command, miss, came)
    if now.slewing:
        return Likely.UNDER_WAY, "it says it is moving, the slew is probably under way"
    if miss <= near:
        if came is not None and came <= near:
            return Likely.UNTOLD, "it stood there before, so this doesn't tell whether it moved"
        return Likely.CARRIED_OUT, "it probably arrived"
    if came is not None and came <= near:
        return Likely.NOT_CARRIED_OUT, f"and {_arc(came)} from where it was: it probably never moved"
    return Likely.PARTLY, "it stopped on the way, drifted since, or somebody else moved it"


def _of_a_sync(command: CommandRecord, miss: float, came: float | None) -> tuple[Likely, str]:
    """A sync changes what the mount says at once, so the nearer of the two places tells; if they differ."""
    advice = "look, before its position is trusted"
    if came is None or command.before is None or command.place is None:
        return Likely.UNTOLD, f"whether it took the sync isn't known: {advice}"
    size = _apart(command.before.place, command.place)
    if miss < 0.25 * size:
        return Likely.CARRIED_OUT, f"it probably took the sync (of {_arc(size)}): {advice}"
    if came < 0.25 * size:
        return Likely.NOT_CARRIED_OUT, f"it probably did not take the sync (of {_arc(size)}): {advice}"
    return Likely.UNTOLD, f"whether it took the sync (of {_arc(size)}) isn't known: {advice}"


def _of_a_state(command: CommandRecord, now: MountReading, near: float) -> tuple[Likely, str]:
    """Orders without a place, by what the mount says of itself."""
    order = command.order
    if order in ("park", "home") and now.slewing:
        return Likely.UNDER_WAY, f"it says it is moving, the {order} is probably under way"
    if order == "stop":
        if now.slewing is None:
            return Likely.UNTOLD, "it can't say whether it moves: look at it"
        if now.slewing:
            return Likely.NOT_CARRIED_OUT, "it says it is STILL MOVING: stop it again"
        return Likely.CARRIED_OUT, "it says it is not moving"
    if order == "track":
        wanted, said = command.facts.get("on"), now.tracking
        if not isinstance(wanted, bool) or said is None:
            return Likely.UNTOLD, "whether it tracks as ordered isn't known"
        words = "it tracks" if said else "it does not track"
        return (Likely.CARRIED_OUT if said is wanted else Likely.NOT_CARRIED_OUT), words
    told = {
        "park": (now.parked, True, "it says it is parked", "it says it is not parked"),
        "unpark": (now.parked, False, "it says it is not parked", "it says it is parked"),
        "home": (now.at_home, True, "it says it is at home", "it says it is not at home"),
    }.get(order)
    if told is not None and told[0] is not None:
        state, wanted_state, yes, no = told
        return (Likely.CARRIED_OUT, yes) if state is wanted_state else (Likely.NOT_CARRIED_OUT, no)
    if order in ("offset-rates", "move-axis"):
        # `CheckedMount.take_up` has ended it before this is asked
        return Likely.UNTOLD, "whether it was carried out isn't known; if it was, this start has ended it"
    if command.before is not None and (moved := _apart(now.place, command.before.place)) > near:
        return Likely.UNTOLD, f"{_arc(moved)} from where it was when it was ordered"
    return Likely.UNTOLD, "whether it was carried out isn't known"


def _apart(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    """Distance on the sky, whatever kinds and dates the two places are of."""
    return separation_arcsec(from_mount(a), from_mount(b))


def _shown(place: Apparent | Icrs) -> str:
    return f"RA {place.ra_deg:.4f}° Dec {place.dec_deg:+.4f}°"


def _arc(arcsec: float) -> str:
    if arcsec < 120:
        return f"{arcsec:.0f}″"
    return f"{arcsec / 60:.1f}′" if arcsec < 7200 else f"{arcsec / 3600:.1f}°"


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
    reader : JournalReader
        Of the same journal.
    run_id : str, optional
        This run of the service, whose own commands are under way; the journal's if it has one.
    utc : callable, optional
        The clock.

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
