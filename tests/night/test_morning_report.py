"""What became of a night is counted from its journal, and told alike in every form."""

from __future__ import annotations

import json
import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadRequest
from mountnav.journal.job_rows import JobRow
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import Cause, CommandEnd, EntryKind, Outcome
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.night.morning_report import MorningReport, night_of, report_of
from mountnav.night.report_pages import as_html, as_markdown
from mountnav.sky.coordinates import Site
from tests.journal.samples import NIGHT, at, look_of, note_of, slew_of

SITE = Site(47.0, 11.0)
SINCE, UNTIL = night_of("2026-11-21", SITE)


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[SqlJournal]:
    opened = open_journal(tmp_path / "journal.sqlite")
    yield opened
    opened.close()


def _read(journal: SqlJournal, telescope: str = "east") -> MorningReport:
    return report_of(JournalReader(journal.url), telescope, SINCE, UNTIL)


def _centering(seconds: float, outcome: str, errors: list[float], **facts: object) -> object:
    tries = [{"error_arcsec": error, "elapsed_s": 30.0 * (n + 1)} for n, error in enumerate(errors)]
    told: dict[str, object] = {
        "target_ra_deg": 83.633,
        "target_dec_deg": -5.391,
        "tries": tries,
        "outcome": outcome,
    }
    if outcome == "centered":
        told |= {
            "error_before_arcsec": errors[0],
            "error_after_arcsec": errors[-1],
            "elapsed_s": 30.0 * len(errors),
        }
    return note_of("centering", seconds=seconds, kind=EntryKind.CENTERING, facts=told | facts)


async def _a_night(journal: SqlJournal) -> None:
    """Four targets, one of them not reached; clouds; a lost link; a sync that the mount ignored."""
    for number in range(4):
        command = slew_of(seconds=600.0 * number)
        await journal.begin(command)
        await journal.end(command.command_id, CommandEnd(at(600.0 * number + 20.0), Outcome.DONE))
        await journal.look(look_of(seconds=600.0 * number + 40.0, fwhm_px=3.0, scale_arcsec_px=2.0))
        await journal.look(look_of(seconds=600.0 * number + 60.0, fwhm_px=3.2, scale_arcsec_px=2.0))
    for number in range(5):
        reason = "cloud, dew or defocus" if number else "out of time"
        await journal.look(look_of(seconds=4000.0 + number, solved=False, reason=reason, seen=None))
    for seconds, errors in ((70.0, [400.0, 6.0]), (670.0, [380.0, 9.0]), (1270.0, [420.0, 30.0, 3.0])):
        await journal.note(_centering(seconds, "centered", errors))  # type: ignore[arg-type]
    await journal.note(_centering(1900.0, "target-not-reached", [500.0, 490.0]))  # type: ignore[arg-type]
    for end in ("committed", "committed", "ignored by the mount"):
        await journal.note(note_of("sync", kind=EntryKind.SYNC, seconds=80.0, facts={"outcome": end}))
    for seconds, what in ((2000.0, "link-lost"), (2300.0, "link-back")):
        facts = {"why": "no answer for 6 s"} if what == "link-lost" else {}
        await journal.note(note_of(what, kind=EntryKind.LINK, seconds=seconds, facts=facts))
    for number in range(3):
        why = f"<b>altitude {number}.0°</b> | below 15°"
        facts = {"order": "slew", "why": why}
        await journal.note(
            note_of("slew refused", kind=EntryKind.REFUSAL, seconds=2400.0 + number, facts=facts)
        )
    await journal.begin(slew_of(seconds=4100.0))
    # of another telescope, and of another night
    await journal.look(look_of("west"))
    await journal.look(look_of(seconds=200_000.0))


async def test_a_night_is_counted_as_it_was(journal: SqlJournal) -> None:
    await _a_night(journal)
    report = _read(journal)
    assert (report.looks, report.solved) == (13, 8)
    assert report.unsolved == {"out of time": 1, "cloud, dew or defocus": 4}
    assert report.fwhm_arcsec == pytest.approx(6.2)
    assert (report.centered, len(report.centerings)) == (3, 4)
    assert report.error_before_arcsec == pytest.approx(410.0)
    assert report.error_after_arcsec == pytest.approx(6.0)
    assert report.slewed == 4
    assert report.slewing_s == pytest.approx(80.0)
    assert report.centering_s == pytest.approx(60 + 60 + 90 + 60)
    assert report.lost_s == pytest.approx(300.0 + 60.0)
    assert report.syncs == {"committed": 2, "ignored by the mount": 1}
    assert report.open_commands == 1
    refusals = [one for one in report.troubles if one.kind == "refusal"]
    assert [(one.times, one.first_utc) for one in refusals] == [(3, at(2400.0))]
    assert [(since, until) for since, until in report.pauses] == [(at(1860.0), at(4000.0))]
    advice = " ".join(report.advice)
    for words in (
        "5 of 13 looks",
        "cloud",
        "did not take 1 sync",
        "link was lost 1 time",
        "1 of 4 targets",
    ):
        assert words in advice


def _job(kind: str, state: str, seconds: float, **more: object) -> JobRow:
    problem = {"type": "urn:mountnav:problem:device-missing", "detail": "the port is taken"}
    row = JobRow(
        job_id=f"{kind}-{seconds:.0f}",
        telescope="east",
        kind=kind,
        state=state,
        phase="ended",
        request={"kind": kind, "target": {"kind": "icrs", "ra_deg": 10.0, "dec_deg": 20.0}},
        created_utc=at(seconds),
        request_sha256="",
        started_utc=at(seconds),
        finished_utc=at(seconds + 30.0),
        problem=problem if state == "failed" else None,
    )
    return replace(row, **more)  # type: ignore[arg-type]


async def test_orders_that_never_came_to_the_mount_are_told(journal: SqlJournal) -> None:
    """No device, or the service was killed: no centering wrote its end, yet the target was ordered."""
    reached = note_of(
        "centering",
        seconds=60.0,
        kind=EntryKind.CENTERING,
        facts={"outcome": "centered"},
        cause=Cause("center-0"),
    )
    await journal.note(reached)
    refused = note_of(
        "home refused", seconds=500.0, kind=EntryKind.REFUSAL, facts={}, cause=Cause("home-500")
    )
    await journal.note(refused)
    for row in (
        _job("center", "succeeded", 0.0),
        _job("center", "failed", 100.0),
        _job("center", "running", 200.0, finished_utc=None),
        _job("park", "failed", 300.0),
        _job("park", "cancelled", 400.0),
        _job("home", "failed", 500.0),
        _job("center", "failed", 600.0, telescope="west"),
    ):
        await journal.save_job(row)
    report = _read(journal)
    assert [one.outcome for one in report.centerings] == ["centered", "device-missing"]
    assert (report.centerings[1].ra_deg, report.centerings[1].elapsed_s) == (10.0, 30.0)
    assert report.lost_s == pytest.approx(30.0)
    assert [(one.kind, one.what) for one in report.troubles] == [
        ("job", "the order park failed: the port is taken"),
        ("refusal", "home refused"),
    ]
    assert "device-missing" in " ".join(report.advice)


async def test_time_is_lost_once(journal: SqlJournal) -> None:
    """A lost link makes the centering fail as well."""
    await journal.note(note_of("link-lost", kind=EntryKind.LINK, seconds=100.0, facts={}))
    await journal.note(_centering(160.0, "device-missing", [500.0, 490.0, 480.0]))  # type: ignore[arg-type]
    await journal.note(note_of("link-back", kind=EntryKind.LINK, seconds=400.0, facts={}))
    assert _read(journal).lost_s == pytest.approx(330.0)


async def test_starts_of_the_service_are_counted_however_long_ago(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    open_journal(path).close()
    with closing(sqlite3.connect(path)) as connection:
        for number in range(130):
            utc = at(0.0) + timedelta(hours=6 * number)
            row = (f"run-{number}", utc.replace(tzinfo=None).isoformat(" "), "1", "dome", 1, "", "")
            connection.execute(
                "INSERT INTO run (run_id, started_utc, version, host, pid, settings_sha256, settings) "
                "VALUES (?, ?, ?, ?, ?, ?, ?)",
                row,
            )
        connection.commit()
    assert report_of(JournalReader(path), "east", SINCE, UNTIL).runs == 2


async def test_a_night_without_anything_is_told_as_one(journal: SqlJournal) -> None:
    report = _read(journal)
    assert report.first_utc is None
    assert (report.looks, report.error_before_arcsec, report.fwhm_arcsec) == (0, None, None)
    assert report.advice == ()
    assert "nothing was done" in as_markdown(report)
    assert "nothing was done" in as_html(report)


async def test_all_forms_tell_the_same_and_no_words_of_a_device_are_markup(journal: SqlJournal) -> None:
    await _a_night(journal)
    report = _read(journal)
    told = json.loads(json.dumps(report.as_dict(), allow_nan=False))
    html, markdown = as_html(report), as_markdown(report)
    page = ElementTree.fromstring(html.replace("<!doctype html>\n", "").replace(
        '<meta charset="utf-8">', "").replace(
        '<meta name="viewport" content="width=device-width, initial-scale=1">', ""))  # fmt: skip
    words = " ".join(page.itertext())
    assert "<b>altitude" not in html
    assert "<b>altitude 0.0°</b> | below 15°" in words
    rows = [line for line in markdown.splitlines() if "below 15" in line]
    assert len(re.findall(r"(?<!\\)\|", rows[0])) == 5
    for form in (words, markdown):
        assert f"{told['centered']} of {told['targets']}" in form
        for one in report.advice:
            assert one in form
    assert not re.search(r"<script|https?:", html)


@given(
    days=st.integers(0, 20_000),
    longitude_deg=st.floats(-180.0, 180.0),
    second=st.integers(0, 86_399),
)
def test_each_instant_belongs_to_one_night(days: int, longitude_deg: float, second: int) -> None:
    site = Site(0.0, longitude_deg)
    date = (datetime(1990, 1, 1, tzinfo=UTC) + timedelta(days=days)).date()
    since, until = night_of(date.isoformat(), site)
    assert until - since == timedelta(days=1)
    instant = since + timedelta(seconds=second)
    # as the Sun has it, it is after noon of that date and before noon of the next
    local = instant + timedelta(hours=longitude_deg / 15.0)
    assert (local - timedelta(hours=12) + timedelta(milliseconds=1)).date() == date


@pytest.mark.parametrize("date", ["", "tonight", "2026-13-01", "2026-11-25T00:00", "26-11-25"])
def test_what_is_no_date_is_no_night(date: str) -> None:
    with pytest.raises(BadRequest, match="is not a night"):
        night_of(date, SITE)


def test_the_samples_lie_in_that_night() -> None:
    assert SINCE <= NIGHT < UNTIL
