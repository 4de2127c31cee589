"""Exports read back by others: csv, pyarrow, astropy."""

from __future__ import annotations

import csv
import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from astropy import units
from astropy.io import fits
from astropy.table import Table as AstropyTable
from astropy.time import Time

from mountnav.errors import BadRequest
from mountnav.journal.exporting import TABLES, columns_of, export
from mountnav.journal.reading import JournalReader, Wanted
from mountnav.journal.records import CommandEnd, Outcome
from mountnav.journal.sql_journal import SqlJournal
from tests.journal.samples import at, look_of, note_of, slew_of

COUNT = 7


@pytest.fixture
async def reader(journal: SqlJournal) -> JournalReader:
    for number in range(COUNT):
        solved = number != 3
        await journal.look(look_of(seconds=number, solved=solved, seen=look_of().seen if solved else None))
        command = slew_of(seconds=number, facts={"way": "″", "deep": [1, None]})
        await journal.begin(command)
        if number != 3:
            end = CommandEnd(at(number + 1), Outcome.DONE, '12″ off, said "yes",\nthen no', None, 12.5)
            await journal.end(command.command_id, end)
        await journal.note(note_of(f"note ″ {number}", seconds=number))
    return journal.reader


def test_csv(reader: JournalReader, tmp_path: Path) -> None:
    assert export(reader, "commands", tmp_path / "out.csv") == COUNT
    with (tmp_path / "out.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == COUNT
    assert "to_ra_deg [deg]" in rows[0]
    assert datetime.fromisoformat(rows[2]["utc [UTC]"]) == at(2)
    assert float(rows[2]["miss_arcsec [arcsec]"]) == 12.5
    assert json.loads(rows[2]["facts"]) == {"way": "″", "deep": [1, None]}
    assert rows[2]["end_detail"] == '12″ off, said "yes",\nthen no'
    assert (rows[3]["outcome"], rows[3]["miss_arcsec [arcsec]"]) == ("", "")


def test_parquet(reader: JournalReader, tmp_path: Path) -> None:
    assert export(reader, "looks", tmp_path / "out.parquet", Wanted(telescope="east")) == COUNT
    table = pq.read_table(tmp_path / "out.parquet")
    assert table.schema.field("seen_ra_deg").metadata == {b"unit": b"deg"}
    assert table.column("utc").to_pylist() == [at(number) for number in range(COUNT)]
    assert table.column("seen_ra_deg").to_pylist() == [120.01] * 3 + [None] + [120.01] * 3
    assert table.column("solved").to_pylist() == [True] * 3 + [False] + [True] * 3


@pytest.mark.long
def test_fits(reader: JournalReader, tmp_path: Path) -> None:
    assert export(reader, "looks", tmp_path / "out.fits") == COUNT
    with fits.open(tmp_path / "out.fits") as hdus:
        hdus.verify("exception")
        assert hdus[1].header["TIMESYS"] == "UTC"
        rows = hdus[1].data
        assert hdus[1].columns["rms_arcsec"].unit == "arcsec"
        assert np.isnan(rows["seen_ra_deg"]).tolist() == [number == 3 for number in range(COUNT)]
        # the days are those of another's calendar
        days = Time([at(number) for number in range(COUNT)], scale="utc").mjd
        assert np.abs(rows["utc_mjd"] - days).max() * 86400 < 1e-5
        assert rows["utc"][0] == "2026-11-22T03:12:45.123456Z"
    read = AstropyTable.read(tmp_path / "out.fits")
    assert read["seen_dec_deg"].unit == units.deg


@pytest.mark.long
@pytest.mark.parametrize("what", TABLES)
@pytest.mark.parametrize("ending", [".csv", ".parquet", ".fits"])
def test_all_tables_in_all_kinds_also_empty(
    reader: JournalReader, tmp_path: Path, what: str, ending: str
) -> None:
    path = tmp_path / f"out{ending}"
    assert export(reader, what, path, Wanted(telescope="east")) == COUNT
    assert export(reader, what, path, Wanted(telescope="nowhere")) == 0
    if ending == ".parquet":
        assert pq.read_table(path).num_rows == 0
    elif ending == ".fits":
        with fits.open(path) as hdus:
            assert len(hdus[1].data) == 0
    assert [one.name for one in tmp_path.iterdir() if one.is_file()] == [path.name]


def test_every_quantity_has_a_unit_that_astropy_knows() -> None:
    without = {"relative_humidity", "false_probability"}
    for table in TABLES.values():
        for column in columns_of(table):
            if column.kind == "number":
                assert (column.unit == "") == (column.name in without), column.name
            if column.unit not in ("", "UTC"):
                units.Unit(column.unit, format=None if column.unit == "deg_C" else "fits")


def test_exports_that_make_no_sense(reader: JournalReader, tmp_path: Path) -> None:
    for what, name in (("looks", "out.xls"), ("looks", "out"), ("stars", "out.csv")):
        with pytest.raises(BadRequest):
            export(reader, what, tmp_path / name)
    before = tmp_path / "kept.csv"
    before.write_text("precious")
    with pytest.raises(BadRequest):
        export(reader, "stars", before)
    assert before.read_text() == "precious"
