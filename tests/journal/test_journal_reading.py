"""Reading: filters, pages, the story in the order of time, observations, thinning."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from mountnav.clock import utc_now
from mountnav.devices import MountReading, PierSide
from mountnav.errors import BadRequest
from mountnav.journal.observations import observation_of, observations
from mountnav.journal.reading import KINDS, JournalReader, Line, Mark, Wanted, instant
from mountnav.journal.records import Cause, CommandEnd, Entry, EntryKind, Outcome
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.journal.upkeep import Thinning
from mountnav.journal.wording import as_json, in_words
from mountnav.journal.writer import Piece
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from tests.journal.samples import NIGHT, at, look_of, note_of, slew_of


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Iterator[JournalReader]:
    """120 lines of two telescopes; many of them at the same instants."""
    journal = open_journal(tmp_path_factory.mktemp("told") / "journal.sqlite", inline=True, fsync="never")
    asyncio.run(_tell(journal))
    yield journal.reader
    journal.close()


async def _tell(journal: SqlJournal) -> None:
    chance = random.Random(3)
    for number in range(40):
        telescope = chance.choice(["east", "west"])
        second = number // 4
        cause = Cause("job-1" if number % 2 else None, "night-1" if number % 5 == 0 else None, None, "")
        await journal.look(look_of(telescope, second, solved=number % 3 > 0, cause=cause))
        command = slew_of(telescope, second, cause=cause)
        await journal.begin(command)
        if number % 4:
            outcome = Outcome.DONE if number % 8 else Outcome.REFUSED
            await journal.end(command.command_id, CommandEnd(at(second + 1), outcome, "said so"))
        kind = EntryKind.FAULT if number % 10 == 0 else EntryKind.NOTE
        await journal.note(note_of(f"Note %{number}_", telescope, second, kind=kind, cause=cause))


@pytest.mark.long
@pytest.mark.parametrize("newest_first", [False, True])
@pytest.mark.parametrize("page", [2, 7, 1000])
def test_pages_are_the_whole_story_once(told: JournalReader, page: int, newest_first: bool) -> None:
    wanted = Wanted(since=NIGHT, until=at(1000))
    whole = told.lines(wanted, limit=10_000, newest_first=newest_first)
    assert len(whole) == 120
    assert [line.mark for line in whole] == sorted((line.mark for line in whole), reverse=newest_first)
    found: list[Line] = []
    mark: Mark | None = None
    while lines := told.lines(wanted, after=mark, limit=page, newest_first=newest_first):
        found += lines
        mark = Mark.decoded(lines[-1].mark.encoded())
    assert found == whole
    if not newest_first:
        assert list(told.story(wanted, page=page)) == whole


@pytest.mark.long
@pytest.mark.parametrize(
    ("wanted", "passes"),
    [
        (Wanted(telescope="east"), lambda line: line.record.telescope == "east"),
        (Wanted(kinds=frozenset({"look"})), lambda line: line.kind == "look"),
        (Wanted(kinds=frozenset({"fault", "command"})), lambda line: line.kind in ("fault", "command")),
        (Wanted(since=at(3)), lambda line: line.utc >= at(3)),
        (Wanted(since=at(3), until=at(5)), lambda line: at(3) <= line.utc < at(5)),
        (Wanted(job_id="job-1"), lambda line: line.record.cause.job_id == "job-1"),
        (Wanted(night_id="night-1"), lambda line: line.record.cause.night_id == "night-1"),
        (Wanted(outcome="done"), lambda line: line.end is not None and line.end.outcome == "done"),
        (Wanted(outcome="open"), lambda line: line.kind == "command" and line.end is None),
        (Wanted(outcome="unsolved"), lambda line: line.kind == "look" and not line.record.solved),
        (Wanted(text="NOTE %1"), lambda line: line.kind in ("note", "fault") and "%1" in line.record.what),
        (Wanted(text="said SO"), lambda line: line.end is not None),
        (Wanted(outcome="done", kinds=frozenset({"look"})), lambda line: False),
    ],
)
def test_filters(told: JournalReader, wanted: Wanted, passes: Callable[[Line], bool]) -> None:
    whole = told.lines(Wanted(), limit=10_000)
    found = told.lines(wanted, limit=10_000)
    assert found == [line for line in whole if passes(line)]
    parts = len(told.looks(wanted)) + len(told.commands(wanted)) + len(told.entries(wanted))
    assert parts == len(found)


async def test_following_sees_each_line_once(journal: SqlJournal) -> None:
    reader = journal.reader
    newest = reader.newest()
    assert reader.written_after(newest) == ([], newest)
    # its instant is long ago: it is new all the same
    await journal.note(note_of("late", seconds=-5000))
    await journal.look(look_of(seconds=-5000))
    lines, newest = reader.written_after(newest)
    assert [line.kind for line in lines] == ["note", "look"]
    assert reader.written_after(newest)[0] == []


def test_every_line_has_words_and_json(told: JournalReader) -> None:
    import json

    for line in told.lines(limit=10_000):
        assert len(in_words(line)) > 5
        found = json.loads(json.dumps(as_json(line), allow_nan=False))
        assert found["kind"] in KINDS
        assert datetime.fromisoformat(found["utc"]) == line.utc


async def test_a_lost_link_says_why(journal: SqlJournal) -> None:
    await journal.note(Entry(at(0), "east", EntryKind.LINK, "link-lost", {"why": "no such device"}))
    await journal.note(Entry(at(1), "east", EntryKind.LINK, "link-back", {"after_s": 2.0}))
    words = [in_words(line) for line in journal.reader.lines(limit=10) if line.kind == "link"]
    assert sorted(words) == ["link-back", "link-lost: no such device"]


async def test_a_reason_that_stands_in_the_words_is_not_told_twice(journal: SqlJournal) -> None:
    why = "its clock is 600 s ahead of ours"
    what = f"mount and settings contradict each other: {why}"
    await journal.note(Entry(at(0), "east", EntryKind.FAULT, what, {"why": why}))
    assert [in_words(line) for line in journal.reader.lines(limit=10) if line.kind == "fault"] == [what]


@pytest.mark.parametrize("text", ["", "!", "bm9uc2Vuc2U", "W10", "WzEsIDIsIDNd", "a" * 200, "″"])
def test_cursors_that_are_none(text: str) -> None:
    with pytest.raises(BadRequest):
        Mark.decoded(text)


def test_instants_of_people() -> None:
    now = datetime(2026, 11, 22, 3, tzinfo=UTC)
    assert instant("2h", now) == now - timedelta(hours=2)
    assert instant("1.5 d", now) == now - timedelta(days=1.5)
    assert instant("2026-11-21", now) == datetime(2026, 11, 21, tzinfo=UTC)
    assert instant("2026-11-21T22:00+02:00", now) == datetime(2026, 11, 21, 20, tzinfo=UTC)
    for odd in ("yesterday", "", "2 parsecs", "0001-01-01T00:00+14:00"):
        with pytest.raises(BadRequest):
            instant(odd, now)
    assert instant("99999999999 d", now).year == 1000


def test_filters_that_are_none() -> None:
    for odd in ({"kinds": frozenset({"x"})}, {"outcome": "x"}, {"since": datetime(1, 1, 1, tzinfo=UTC)}):
        with pytest.raises(BadRequest):
            Wanted(**odd)


async def test_looks_as_observations(journal: SqlJournal, file: Path) -> None:
    place = Apparent(120.0, 89.9, at(0))
    moved = displaced(place, 40.0, 0.0)  # 6.4° of right ascension: the middle must be taken on the sphere
    before = MountReading(place, at(-3), pier_side=PierSide.EAST)
    after = MountReading(moved, at(1), pier_side=PierSide.EAST)
    await journal.look(look_of(before=before, after=after, model_id="m", parity=-1, rotation_deg=3.0))
    slewing = MountReading(place, at(1), slewing=True)
    far = MountReading(displaced(place, 300.0, 0.0), at(1))
    oddities: tuple[dict[str, Any], ...] = (
        {"after": slewing},
        {"after": far},
        {"solved": False},
        {"seen": None},
    )
    for odd in oddities:
        await journal.look(look_of(seconds=50, **({"before": before, "after": after} | odd)))
    [one] = observations(file, "east")
    assert observations(str(file), "east", since=at(0.1)) == []
    assert observations(JournalReader(file), "west") == []
    assert isinstance(one.reading, Apparent)
    assert one.reading.utc == at(0)
    # three quarters of the time have gone by
    assert separation_arcsec(place, one.reading) == pytest.approx(30.0, abs=0.01)
    assert separation_arcsec(one.reading, moved) == pytest.approx(10.0, abs=0.01)
    assert one.sigma_arcsec == pytest.approx(math.sqrt((0.04 + 0.09) / 2))
    assert (one.side, one.model_id, one.parity, one.rotation_deg) == (PierSide.EAST, "m", -1, 3.0)
    assert (one.seen, one.segment_id, one.air.pressure_hpa) == (Icrs(120.01, 40.01), "segment", 1010.0)


async def test_observations_know_from_which_side_the_axes_came(journal: SqlJournal, file: Path) -> None:
    """A slew to smaller right ascension turns the hour angle axis west: +1."""
    for number, (ra_deg, dec_deg, outcome, side) in enumerate(
        [
            (90.0, 50.0, Outcome.DONE, PierSide.WEST),
            (130.0, 50.0, Outcome.DONE, PierSide.WEST),
            (90.0, 50.0, Outcome.STALLED, PierSide.WEST),
            (90.0, 50.0, Outcome.DONE, PierSide.EAST),
        ]
    ):
        second = 100.0 * number
        start = MountReading(Apparent(120.0, 50.0, at(second)), at(second), pier_side=PierSide.WEST)
        command = slew_of(seconds=second, place=Apparent(ra_deg, dec_deg, at(second)), before=start)
        await journal.begin(command)
        end = MountReading(Apparent(ra_deg, dec_deg, at(second)), at(second + 9), pier_side=side)
        await journal.end(command.command_id, CommandEnd(at(second + 9), outcome, after=end))
        await journal.look(look_of(seconds=second + 20))
    assert [one.from_side for one in observations(file, "east")] == [(1, 0), (-1, 0), (0, 0), (0, 0)]


def test_a_look_without_a_covariance_has_a_sigma() -> None:
    by_stars = observation_of(look_of(covariance_arcsec2=None, rms_arcsec=0.6, pairs=9))
    assert by_stars is not None
    assert by_stars.sigma_arcsec == pytest.approx(0.2)
    unknown = observation_of(look_of(covariance_arcsec2=None, rms_arcsec=None))
    assert unknown is not None
    assert unknown.sigma_arcsec > 0.5


def test_old_looks_go_and_commands_stay(file: Path) -> None:
    journal = open_journal(file, inline=True)
    old = (utc_now() - timedelta(days=50) - NIGHT).total_seconds()

    async def write() -> None:
        for second in (old, (utc_now() - NIGHT).total_seconds()):
            await journal.look(look_of(seconds=second))
            await journal.begin(slew_of(seconds=second))
            await journal.note(note_of("a fault", seconds=second, kind=EntryKind.FAULT))
            await journal.note(note_of("passing", seconds=second))
        for telescope, what in (("east", "first"), ("east", "last"), ("west", "only")):
            standing = note_of(what, telescope=telescope, seconds=old, kind=EntryKind.STANDING)
            await journal.note(standing)
        for _ in range(120):
            await journal.note(note_of("more", seconds=0.0 - old))

    asyncio.run(write())
    thinning = Thinning(keep_days=30)
    steps = []
    for _ in range(5):
        journal._writer.put(Piece(lambda connection: steps.append(thinning.step(connection))))
    assert steps[0] is True
    assert steps[-1] is False
    reader = journal.reader
    assert len(reader.looks()) == 1
    assert len(reader.commands()) == 2
    assert [one.what for one in reader.entries(Wanted(kinds=frozenset({EntryKind.FAULT})))] == ["a fault"] * 2
    assert len(reader.entries(Wanted(text="passing"))) == 1
    # however old, what the next start compares a mount with stays
    standing = reader.entries(Wanted(kinds=frozenset({EntryKind.STANDING})))
    assert sorted(one.what for one in standing) == ["last", "only"]
    journal.close()


def test_the_last_entry_is_the_one_that_was_written_last(file: Path) -> None:
    """A clock that was an hour ahead for a while must not bring an older word back."""
    journal = open_journal(file, inline=True, fsync="never")

    async def write() -> None:
        await journal.note(note_of("trusted", seconds=3600.0, kind=EntryKind.STANDING))
        await journal.note(note_of("not trusted", seconds=30.0, kind=EntryKind.STANDING))
        await journal.note(note_of("another kind", seconds=7200.0, kind=EntryKind.FAULT))

    asyncio.run(write())
    last = journal.reader.last_entry(EntryKind.STANDING, "east")
    assert last is not None
    assert last.what == "not trusted"
    assert journal.reader.last_entry(EntryKind.STANDING, "west") is None
    journal.close()


@pytest.mark.long
def test_a_file_that_is_too_big_loses_its_oldest_looks(file: Path) -> None:
    journal = open_journal(file, inline=True, fsync="never")

    async def write() -> None:
        for number in range(900):
            await journal.look(look_of(seconds=number))

    asyncio.run(write())
    thinning = Thinning(max_size_mb=0.3)
    steps = [True]
    while steps[-1]:
        journal._writer.put(Piece(lambda connection: steps.append(thinning.step(connection))))
    left = journal.reader.looks()
    assert 0 < len(left) < 900
    assert left[-1].utc == at(899)
    journal.close()


async def test_the_writers_thread_thins_by_itself(file: Path) -> None:
    first = open_journal(file)
    await first.look(look_of())  # of this November: no test that runs later may find it young
    await asyncio.to_thread(first.close)
    journal = open_journal(file, keep_days=0.0001)
    async with asyncio.timeout(60):
        while journal.reader.looks():
            await asyncio.sleep(0.01)
    await asyncio.to_thread(journal.close)
