"""Taken up after a kill: what was in flight is judged by the mount's reading, told, and never sent again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mountnav.devices import MountReading
from mountnav.errors import DeviceSilent
from mountnav.journal.records import CommandEnd, CommandRecord, EntryKind, Outcome, new_id
from mountnav.journal.restart import Likely, acknowledge, judged, take_up
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import displaced
from tests.journal.samples import at, look_of, note_of, slew_of

THERE = Apparent(120.0, 40.0, at(0))
BEFORE = Apparent(100.0, 20.0, at(0))


class StandingMount:
    """A mount that can only be read; it has nothing by which it could be moved."""

    name = "a mount"
    resolution_arcsec = 1.0

    def __init__(self, reading: MountReading | None) -> None:
        self._reading = reading

    async def reading(self) -> MountReading:
        if self._reading is None:
            raise DeviceSilent("no answer")
        return self._reading


def standing(east_arcsec: float = 0.0, place: Any = THERE, **said: object) -> StandingMount:
    where = displaced(place, east_arcsec, 0.0)
    return StandingMount(MountReading(where, at(600), **said))  # type: ignore[arg-type]


@pytest.fixture
def killed(file: Path) -> SqlJournal:
    """The journal of a run that ends without a word: it is never closed."""
    return open_journal(file)


@pytest.fixture
def after(killed: SqlJournal, file: Path) -> Iterator[SqlJournal]:
    opened = open_journal(file)
    yield opened
    opened.close()
    killed.close()


async def test_a_slew_in_flight_is_judged_told_and_closed(killed: SqlJournal, after: SqlJournal) -> None:
    command = slew_of()
    await killed.begin(command)
    restart = await take_up(after, after.reader, "east", standing(12.0))
    [taken] = restart.commands
    assert (taken.command, taken.likely) == (command, Likely.CARRIED_OUT)
    assert taken.miss_arcsec == pytest.approx(12.0, abs=0.01)
    assert restart.notice is not None
    for words in (
        "slew to apparent RA 120.0000° Dec +40.0000°",
        "sent or not",
        "12″ from there",
        "probably arrived",
    ):
        assert words in restart.notice
    [(_, end)] = after.reader.commands()
    assert end is not None
    assert (end.outcome, end.facts["likely"], end.after) == (Outcome.UNKNOWN, "carried out", restart.reading)
    assert after.reader.in_flight() == []


async def test_nothing_in_flight_asks_the_mount_nothing(killed: SqlJournal, after: SqlJournal) -> None:
    command = slew_of()
    await killed.begin(command)
    await killed.end(command.command_id, CommandEnd(at(9), Outcome.DONE))
    restart = await take_up(after, after.reader, "east", StandingMount(None))
    assert (restart.commands, restart.notice, restart.reading) == ((), None, None)


async def test_own_commands_and_other_telescopes_are_left_alone(
    killed: SqlJournal, after: SqlJournal
) -> None:
    await killed.begin(slew_of("west"))
    await after.begin(slew_of("east"))
    assert (await take_up(after, after.reader, "east", StandingMount(None))).commands == ()
    assert len(after.reader.in_flight()) == 2


async def test_a_mount_that_cannot_be_read_leaves_all_open(killed: SqlJournal, after: SqlJournal) -> None:
    await killed.begin(slew_of())
    with pytest.raises(DeviceSilent):
        await take_up(after, after.reader, "east", StandingMount(None))
    assert len(after.reader.in_flight("east")) == 1
    assert (await take_up(after, after.reader, "east", standing())).commands


@pytest.mark.long
@pytest.mark.parametrize(
    "settled_by", ["look", "sync", "home", "word", "unsolved look", "another's look", None]
)
async def test_the_notice_stays_over_restarts_until_settled(
    killed: SqlJournal, after: SqlJournal, file: Path, settled_by: str | None
) -> None:
    await killed.begin(slew_of())
    notice = (await take_up(after, after.reader, "east", standing(), utc=lambda: at(10))).notice
    assert notice is not None
    match settled_by:
        case "look":
            await after.look(look_of(seconds=20))
        case "unsolved look":
            await after.look(look_of(seconds=20, solved=False, seen=None))
        case "another's look":
            await after.look(look_of("west", seconds=20))
        case "sync" | "home":
            command = slew_of(seconds=20, order=settled_by)
            await after.begin(command)
            await after.end(command.command_id, CommandEnd(at(21), Outcome.DONE))
        case "word":
            await acknowledge(after, "east", "Maria", utc=lambda: at(20))
    await after.note(note_of("something else", seconds=30, kind=EntryKind.FAULT))
    third = open_journal(file)
    again = await take_up(third, third.reader, "east", StandingMount(None))
    assert again.notice == (None if settled_by in ("look", "sync", "home", "word") else notice)
    third.close()


async def test_killed_while_taking_up_nothing_is_forgotten(killed: SqlJournal, after: SqlJournal) -> None:
    """Killed between the notice and the closing: the next start does it again."""
    first, second = slew_of(), slew_of(seconds=1, order="stop", place=None)
    await killed.begin(first)
    await killed.begin(second)
    real = after.end
    closed: list[Any] = []

    async def killed_here(command_id: str, end: CommandEnd) -> None:
        if closed:
            raise KeyboardInterrupt
        closed.append(command_id)
        await real(command_id, end)

    after.end = killed_here  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        await take_up(after, after.reader, "east", standing())
    after.end = real  # type: ignore[method-assign]
    restart = await take_up(after, after.reader, "east", standing(slewing=True))
    assert [one.command for one in restart.commands] == [second]
    assert restart.moving
    assert after.reader.in_flight() == []


def order(kind: str, place: Apparent | Icrs | None = None, **facts: object) -> CommandRecord:
    before = MountReading(BEFORE, at(0))
    return slew_of(order=kind, place=place, facts=facts, before=before, command_id=new_id())


def read(place: Any = THERE, **said: object) -> MountReading:
    return MountReading(place, at(600), **said)  # type: ignore[arg-type]


SYNC_TO = displaced(BEFORE, 600.0, 0.0)


@pytest.mark.parametrize(
    ("command", "reading", "likely", "words"),
    [
        (order("slew", THERE), read(), Likely.CARRIED_OUT, "probably arrived"),
        (order("slew", THERE), read(BEFORE), Likely.NOT_CARRIED_OUT, "probably never moved"),
        (order("slew", THERE), read(Apparent(110.0, 30.0, at(0))), Likely.PARTLY, "stopped on the way"),
        (
            order("slew", THERE),
            read(Apparent(110.0, 30.0, at(0)), slewing=True),
            Likely.UNDER_WAY,
            "under way",
        ),
        (order("slew", displaced(BEFORE, 30.0, 0.0)), read(BEFORE), Likely.UNTOLD, "stood there before"),
        (order("sync", SYNC_TO), read(SYNC_TO), Likely.CARRIED_OUT, "probably took the sync (of 10.0′)"),
        (order("sync", SYNC_TO), read(BEFORE), Likely.NOT_CARRIED_OUT, "did not take the sync"),
        (order("sync", SYNC_TO), read(displaced(BEFORE, 300.0, 0.0)), Likely.UNTOLD, "isn't known"),
        (order("stop"), read(slewing=True), Likely.NOT_CARRIED_OUT, "STILL MOVING"),
        (order("stop"), read(slewing=False), Likely.CARRIED_OUT, "not moving"),
        (order("stop"), read(), Likely.UNTOLD, "can't say"),
        (order("park"), read(parked=True), Likely.CARRIED_OUT, "it is parked"),
        (order("park"), read(parked=False), Likely.NOT_CARRIED_OUT, "not parked"),
        (order("park"), read(slewing=True, parked=False), Likely.UNDER_WAY, "park is probably under way"),
        (order("unpark"), read(parked=False), Likely.CARRIED_OUT, "not parked"),
        (order("home"), read(at_home=True), Likely.CARRIED_OUT, "at home"),
        (order("track", on=True), read(tracking=True), Likely.CARRIED_OUT, "it tracks"),
        (order("track", on=False), read(tracking=True), Likely.NOT_CARRIED_OUT, "it tracks"),
        (order("track", on=True), read(), Likely.UNTOLD, "isn't known"),
        (order("guide", direction="n"), read(BEFORE), Likely.UNTOLD, "isn't known"),
        (order("set-clock"), read(BEFORE), Likely.UNTOLD, "isn't known"),
    ],
)
def test_judgments(command: CommandRecord, reading: MountReading, likely: Likely, words: str) -> None:
    found, said, miss_arcsec = judged(command, reading, 1.0)
    assert found is likely
    assert words in said
    assert "sent or not" in said
    assert (miss_arcsec is None) == (command.place is None)


def test_places_of_two_kinds_are_compared_as_one() -> None:
    """A mount ordered in one kind and read in another (its epoch was set again) isn't called 20′ off."""
    from mountnav.sky.chain import apparent_to_icrs

    command = replace(slew_of(), place=THERE)
    likely, _, miss_arcsec = judged(command, read(apparent_to_icrs(THERE)), 1.0)
    assert likely is Likely.CARRIED_OUT
    assert miss_arcsec == pytest.approx(0.0, abs=0.001)


def beside_stars(ra_arcsec_s: float, telescope: str = "east") -> CommandRecord:
    facts = {"ra_arcsec_s": ra_arcsec_s, "dec_arcsec_s": 0.0}
    return CommandRecord(new_id(), telescope, at(9), "offset-rates", "segment", facts=facts)


async def test_the_latest_orders_of_a_kind_are_found_with_their_ends(
    killed: SqlJournal, after: SqlJournal
) -> None:
    first, second = beside_stars(1.0), beside_stars(2.0)
    await killed.begin(first)
    await killed.end(first.command_id, CommandEnd(at(9), Outcome.DONE))
    await killed.begin(second)
    await killed.begin(slew_of())
    await killed.begin(beside_stars(3.0, "west"))
    await after.begin(beside_stars(4.0))
    found = after.reader.latest_of("offset-rates", "east", but_run=after.run_id, limit=5)
    assert [(one.facts["ra_arcsec_s"], end is not None) for one, end in found] == [(2.0, False), (1.0, True)]
    assert len(after.reader.latest_of("offset-rates", "east", but_run=after.run_id)) == 1
    assert after.reader.latest_of("move-axis", "east") == []


async def test_rates_in_flight_are_told_as_ended_by_this_start(killed: SqlJournal, after: SqlJournal) -> None:
    await killed.begin(beside_stars(1.0))
    restart = await take_up(after, after.reader, "east", standing())
    assert restart.notice is not None
    assert "offset rates of +1″/s in RA and +0″/s in Dec" in restart.notice
    assert "this start has ended it" in restart.notice
