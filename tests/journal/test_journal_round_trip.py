"""Records come back from the database as they went in: SQLite, and PostgreSQL."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mountnav.devices import MountReading, PierSide
from mountnav.journal.database import plain_json, plain_text
from mountnav.journal.reading import JournalReader, Wanted
from mountnav.journal.records import (
    Cause,
    CommandEnd,
    CommandRecord,
    Entry,
    EntryKind,
    LookRecord,
    Outcome,
    new_id,
)
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.sky.coordinates import Air, Apparent, Icrs
from tests.journal.samples import look_of

# years for which databases, drivers and calendars agree; zones other than UTC must not matter
utcs = st.datetimes(
    datetime(1900, 1, 1),
    datetime(2200, 1, 1),
    timezones=st.sampled_from(
        [UTC, timezone(timedelta(hours=5, minutes=45)), timezone(-timedelta(hours=11))]
    ),
)
degrees = st.floats(-360, 720, allow_nan=False)
numbers = st.floats(allow_nan=False, allow_infinity=False)
maybe = st.none() | numbers
words = st.text(max_size=40)
counts = st.integers(0, 2**31 - 1)
places = st.builds(Icrs, degrees, degrees) | st.builds(Apparent, degrees, degrees, utcs)
truths = st.none() | st.booleans()
readings = st.builds(
    MountReading, places, utcs, truths, truths, truths, truths, st.none() | st.sampled_from(PierSide)
)
causes = st.builds(Cause, st.none() | words, st.none() | words, st.none() | words, words)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | numbers | words,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=8,
)
facts = st.dictionaries(words, json_values, max_size=4)
looks = st.builds(
    LookRecord,
    look_id=st.builds(new_id),
    telescope=words,
    utc=utcs,
    solved=st.booleans(),
    before=readings,
    after=readings,
    segment_id=words,
    air=st.builds(Air, numbers, numbers, numbers, numbers),
    reason=words,
    detail=words,
    seen=st.none() | st.builds(Icrs, degrees, degrees),
    covariance_arcsec2=st.none() | st.tuples(numbers, numbers, numbers),
    model_id=st.none() | words,
    dut1_s=numbers,
    camera=words,
    source=words,
    exposure_s=numbers,
    mode=words,
    catalog=words,
    pairs=counts,
    rms_arcsec=maybe,
    false_probability=maybe,
    scale_arcsec_px=maybe,
    rotation_deg=maybe,
    parity=st.none() | st.sampled_from([1, -1]),
    fwhm_px=maybe,
    limiting_mag=maybe,
    sky_adu=maybe,
    measured=counts,
    used=words,
    cause=causes,
)
commands = st.builds(
    CommandRecord,
    command_id=st.builds(new_id),
    telescope=words,
    utc=utcs,
    order=st.sampled_from(["slew", "sync", "stop", "park", "set-clock"]),
    segment_id=words,
    place=st.none() | places,
    facts=facts,
    before=st.none() | readings,
    cause=causes,
)
ends = st.builds(CommandEnd, utcs, st.sampled_from(Outcome), words, st.none() | readings, maybe, facts)
entries = st.builds(Entry, utcs, words, st.sampled_from(EntryKind), words, facts, causes)


def as_kept(value: object) -> object:
    """What is promised of a value: text without NUL and lone surrogates, instants as the same instant."""
    if isinstance(value, str):
        return plain_text(value)
    if isinstance(value, datetime):
        return value.astimezone(UTC)
    if isinstance(value, dict):
        return plain_json(value)
    if isinstance(value, tuple):
        return tuple(as_kept(one) for one in value)
    if is_dataclass(value):
        return {one.name: as_kept(getattr(value, one.name)) for one in fields(value)} | {"": type(value)}
    return value


async def _round_trip(
    journal: SqlJournal, look: LookRecord, command: CommandRecord, end: CommandEnd | None, entry: Entry
) -> None:
    await journal.look(look)
    await journal.begin(command)
    if end is not None:
        await journal.end(command.command_id, end)
    await journal.note(entry)
    reader = journal.reader
    mine = Wanted(run_id=journal.run_id)
    assert as_kept(reader.lines(Wanted(text=look.look_id))[0].record) == as_kept(look)
    [line] = reader.lines(Wanted(text=command.command_id))
    assert as_kept(line.record) == as_kept(command)
    assert as_kept(line.end) == as_kept(end)
    assert as_kept(entry) in [as_kept(one) for one in reader.entries(mine)]


@pytest.fixture(scope="module")
def one_journal(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SqlJournal]:
    opened = open_journal(tmp_path_factory.mktemp("journal") / "journal.sqlite", fsync="never")
    yield opened
    opened.close()


@pytest.mark.long
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(look=looks, command=commands, end=st.none() | ends, entry=entries)
def test_records_come_back_from_sqlite(
    one_journal: SqlJournal, look: LookRecord, command: CommandRecord, end: CommandEnd | None, entry: Entry
) -> None:
    asyncio.run(_round_trip(one_journal, look, command, end, entry))


@pytest.fixture(scope="module")
def shared_journal(postgresql: str) -> Iterator[SqlJournal]:
    opened = open_journal(postgresql)
    yield opened
    opened.close()


@pytest.mark.long
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(look=looks, command=commands, end=st.none() | ends, entry=entries)
def test_records_come_back_from_postgresql(
    shared_journal: SqlJournal, look: LookRecord, command: CommandRecord, end: CommandEnd | None, entry: Entry
) -> None:
    asyncio.run(_round_trip(shared_journal, look, command, end, entry))


def test_a_writing_thread_and_none_write_the_same(file: Path) -> None:
    written = look_of()
    for inline in (False, True):
        where = file.with_name(f"{inline}.sqlite")
        journal = open_journal(where, inline=inline)
        asyncio.run(journal.look(written))
        journal.close()
        assert JournalReader(where).looks() == [written]


def test_what_is_no_number_is_not_known(file: Path) -> None:
    journal = open_journal(file, inline=True)
    odd = look_of(rms_arcsec=math.nan, scale_arcsec_px=math.inf, covariance_arcsec2=(math.inf, 0.0, 1.0))
    asyncio.run(journal.look(odd))
    [found] = journal.reader.looks()
    assert (found.rms_arcsec, found.scale_arcsec_px, found.covariance_arcsec2) == (None, None, None)
    journal.close()


def test_any_fact_can_be_written() -> None:
    import numpy as np

    deep: object = "x"
    for _ in range(100):
        deep = [deep]
    odd = {
        1: np.float64(1.5),
        "array": np.arange(3),
        "enum": Outcome.DONE,
        "when": datetime(2026, 1, 1, tzinfo=UTC),
        "set": {1},
        "object": object,
        "nan": math.nan,
        "deep": deep,
        "half": "\ud800\0",
    }
    plain = plain_json(odd)
    assert isinstance(plain, dict)
    deep_text = plain.pop("deep")
    assert plain == {
        "1": 1.5,
        "array": [0, 1, 2],
        "enum": "done",
        "when": "2026-01-01T00:00:00+00:00",
        "set": [1],
        "object": "<class 'object'>",
        "nan": None,
        "half": "\ufffd\ufffd",
    }
    assert deep_text is not None
