"""Gaia extracts in pieces: folders, ranges of large files, stars that come twice, an import that goes on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table, vstack
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.readers import open_reader
from mountnav.catalog.readers.gaia import csv_file, fits_file, parquet_file
from mountnav.catalog.readers.gaia.reader import GaiaReader, Repeats
from mountnav.errors import BadCatalog


def some_stars(count: int, first: int = 1) -> Table:
    rng = np.random.default_rng(first)
    table = Table()
    table["source_id"] = np.arange(first, first + count, dtype=np.int64) * 35184372088832 + 17
    table["ra"] = rng.uniform(0, 360, count)
    table["dec"] = rng.uniform(-90, 90, count)
    table["ref_epoch"] = np.full(count, 2016.0)
    table["pmra"], table["pmdec"] = rng.normal(0, 10, (2, count))
    table["phot_g_mean_mag"] = rng.uniform(5, 20, count)
    return table


def places(reader: GaiaReader, names: list[str] | None = None) -> list[float]:
    """Right ascensions in the order in which they are read."""
    read = []
    for part in reader.parts():
        if names is None or part.name in names:
            for chunk in reader.read(part):
                read += chunk.ra_deg.tolist()
    return read


def opened(path: Path) -> GaiaReader:
    reader = open_reader("gaia", path)
    assert isinstance(reader, GaiaReader)
    return reader


@pytest.mark.parametrize("suffix", [".csv", ".ecsv", ".fits", ".parquet"])
def test_a_large_file_is_read_in_parts(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = some_stars(500)
    path = tmp_path / f"extract{suffix}"
    if suffix == ".parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {name: np.array(table[name]) for name in table.colnames}
        pq.write_table(pa.table(columns), path, row_group_size=30)
    else:
        table.write(path, format="ascii.csv" if suffix == ".csv" else None)
    monkeypatch.setattr(csv_file, "_PIECE_BYTES", 9973)
    monkeypatch.setattr(csv_file, "_BLOCK_BYTES", 1009)
    monkeypatch.setattr(fits_file, "_PIECE_BYTES", 5000)
    monkeypatch.setattr(fits_file, "LARGEST_CHUNK", 7)
    monkeypatch.setattr(parquet_file, "_PIECE_ROWS", 100)
    monkeypatch.setattr(parquet_file, "LARGEST_CHUNK", 11)
    reader = opened(path)
    parts = reader.parts()
    assert len(parts) >= 5
    assert len({part.name for part in parts}) == len(parts)
    assert places(reader) == table["ra"].tolist()
    # a second run has the same parts, and each can be read alone
    again = opened(path)
    assert again.parts() == parts
    assert places(again, [parts[3].name]) == [
        ra for chunk in reader.read(parts[3]) for ra in chunk.ra_deg.tolist()
    ]
    head = len(path.read_bytes()) - sum(part.size_bytes for part in parts)
    assert 0 <= head < 16_000  # headers are no part


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(piece=st.integers(60, 3000), block=st.integers(50, 500))
def test_wherever_a_text_is_divided_no_line_is_lost(
    tmp_path_factory: pytest.TempPathFactory, piece: int, block: int
) -> None:
    table = some_stars(40)
    path = tmp_path_factory.mktemp("divided") / "extract.csv"
    table.write(path, format="ascii.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(csv_file, "_PIECE_BYTES", piece)
        patch.setattr(csv_file, "_BLOCK_BYTES", block)
        assert places(opened(path)) == table["ra"].tolist()


@pytest.mark.long
def test_a_part_that_begins_with_a_line_has_that_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = some_stars(25)
    path = tmp_path / "extract.csv"
    table.write(path, format="ascii.csv")
    lengths = [len(line) for line in path.read_bytes().splitlines(keepends=True)][1:]
    for piece in np.cumsum(lengths):
        for off in (-1, 0, 1):
            monkeypatch.setattr(csv_file, "_PIECE_BYTES", int(piece) + off)
            assert places(opened(path)) == table["ra"].tolist()


def test_a_folder_is_read_in_the_order_of_names(tmp_path: Path) -> None:
    first, second, third = (some_stars(20, first) for first in (1, 101, 201))
    second.write(tmp_path / "b.fits")
    third.write(tmp_path / "c.vot", format="votable", tabledata_format="binary2")
    first.write(tmp_path / "A.csv", format="ascii.csv")
    (tmp_path / "readme.txt").write_text("from the archive")
    (tmp_path / "d.fits").mkdir()
    reader = opened(tmp_path)
    assert [part.name for part in reader.parts()] == ["A.csv", "b.fits", "c.vot"]
    assert places(reader) == vstack([first, second, third])["ra"].tolist()
    assert reader.made_from == "Gaia extract, 3 files, A.csv to c.vot (ESA/Gaia/DPAC)"


def test_overlapping_extracts_give_each_star_once(tmp_path: Path) -> None:
    whole = some_stars(100)
    for name, rows in (("1", slice(0, 40)), ("2", slice(30, 70)), ("3", slice(20, 100))):
        whole[rows].write(tmp_path / f"cone{name}.csv", format="ascii.csv")
    reader = opened(tmp_path)
    assert places(reader) == whole["ra"].tolist()
    for part in reversed(reader.parts()):  # asked again in any order, it gives the same
        expected = {"1": slice(0, 40), "2": slice(40, 70), "3": slice(70, 100)}[part.name[4]]
        assert places(reader, [part.name]) == whole["ra"][expected].tolist()
    # an import that goes on hasn't read the parts before
    assert places(opened(tmp_path), ["cone3.csv"]) == whole["ra"][70:].tolist()


def test_a_star_twice_in_a_file_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = some_stars(60)
    vstack([whole, whole[10:30], whole[5:6], whole[5:6]]).write(tmp_path / "joined.fits")
    monkeypatch.setattr(fits_file, "LARGEST_CHUNK", 16)
    assert places(opened(tmp_path)) == whole["ra"].tolist()


def test_stars_without_an_identifier_all_count(tmp_path: Path) -> None:
    table = some_stars(30)
    table["source_id"][::2] = 0
    table.write(tmp_path / "a.fits")
    table.write(tmp_path / "b.fits")
    assert len(places(opened(tmp_path))) == 30 + 15
    table.remove_column("source_id")
    table.write(tmp_path / "b.fits", overwrite=True)
    assert len(places(opened(tmp_path))) == 60


def test_identifiers_that_a_spreadsheet_rounded_are_none(tmp_path: Path) -> None:
    table = some_stars(30)
    table["source_id"] = [f"{number:.5e}" for number in table["source_id"]]
    for name in ("a.csv", "b.csv"):
        table.write(tmp_path / name, format="ascii.csv")
    assert len(places(opened(tmp_path))) == 60


def test_the_archives_own_files_are_not_compared(tmp_path: Path) -> None:
    for name in ("GaiaSource_000000-003111.csv", "GaiaSource_003112-005263.csv"):
        some_stars(20).write(tmp_path / name, format="ascii.csv")
    assert len(places(opened(tmp_path))) == 40


@given(
    chunks=st.lists(st.lists(st.integers(0, 30), max_size=12), min_size=1, max_size=25),
    split=st.integers(1, 5),
)
def test_the_first_time_is_told_as_by_a_set(chunks: list[list[int]], split: int) -> None:
    repeats, seen = Repeats(), set()
    asked = []
    for number, chunk in enumerate(chunks):
        ids = np.array(chunk, dtype=np.int64)
        expected = []
        for value in chunk:
            expected.append(value <= 0 or value not in seen)
            seen.add(value)
        part, at = divmod(number, split)
        assert repeats.first_time(ids, part, at).tolist() == expected
        asked.append((ids, part, at, expected))
    for ids, part, at, expected in reversed(asked):
        assert repeats.first_time(ids, part, at).tolist() == expected


def test_a_bad_file_in_a_folder_is_told_before_anything_is_read(tmp_path: Path) -> None:
    some_stars(20).write(tmp_path / "a.fits")
    some_stars(20)["ra", "dec"].write(tmp_path / "b.fits")
    with pytest.raises(BadCatalog, match=r"b\.fits: has no column phot_g_mean_mag"):
        opened(tmp_path)
