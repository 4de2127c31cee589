"""USNO-B1.0 against UCAC4 on real stars, against any values written from its table, and against damage."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers import open_reader
from mountnav.catalog.readers.ucac4.reader import open_catalog as open_ucac4
from mountnav.catalog.readers.usno_b1.reader import UsnoB1Reader, open_catalog
from mountnav.catalog.readers.usno_b1.record import RECORD, decoded
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog
from tests.catalog.readers.usno_b1_files import NOT_SEEN, PLAIN, SEEN, accelerator, record, write_zone
from tests.present import present


@pytest.fixture(scope="module")
def zone_0(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("000") / "b0000.cat"
    shutil.copy(shared / "data" / "catalogs" / "usnob_b0000.cat", path)
    path.chmod(0o644)
    return path


def read_one(path: Path) -> CatalogColumns:
    """All stars of the one zone file `path`."""
    reader = UsnoB1Reader({int(path.name[1:5]): path})
    (part,) = reader.parts()
    (columns,) = reader.read(part)
    return columns


def unit_vectors(columns: CatalogColumns) -> np.ndarray:
    ra, dec = np.radians(columns.ra_deg), np.radians(columns.dec_deg)
    return np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


# ---- real stars

Matched = tuple[CatalogColumns, CatalogColumns, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def matched(zone_0: Path, shared: Path) -> Matched:
    """Both catalogs, and the pairs of UCAC4 and USNO-B1.0 stars within 2 arcsec."""
    here = read_one(zone_0)
    reader = open_ucac4(shared / "data" / "catalogs" / "z001")
    (there,) = reader.read(reader.parts()[0])
    apart = np.linalg.norm(unit_vectors(there)[:, None] - unit_vectors(here)[None], axis=2)
    nearest = apart.argmin(axis=1)
    pairs = np.flatnonzero(np.degrees(apart.min(axis=1)) * 3600 < 2.0)
    return there, here, pairs, nearest[pairs]


def test_the_stars_are_those_of_ucac4(matched: Matched) -> None:
    there, here, ours, theirs = matched
    assert here.ra_deg.size == 322
    inside = there.dec_deg < here.dec_deg.max()
    assert inside.sum() == 48
    assert inside[ours].sum() == 44
    good = (present(there.flags)[ours] & int(StarFlag.OTHER_BAND | StarFlag.NO_MAGNITUDE)) == 0
    left = (there.mag[ours] - here.mag[theirs])[good]
    assert np.median(left) == pytest.approx(0.29, abs=0.03)
    assert 1.4826 * np.median(np.abs(left - np.median(left))) < 0.2


def test_stated_errors_cover_the_distance_to_ucac4(matched: Matched) -> None:
    there, here, ours, theirs = matched
    known = np.isfinite(there.pm_dec_mas_yr[ours])
    north = ((there.dec_deg[ours] - here.dec_deg[theirs]) * 3.6e6)[known]
    sigma = np.sqrt(there.error_curve[ours, 0] + here.error_curve[theirs, 0])[known]
    pull = north / sigma
    assert 0.7 < 1.4826 * np.median(np.abs(pull - np.median(pull))) < 1.3


def test_few_real_stars_are_taken_for_galaxies(matched: Matched) -> None:
    _, here, _, theirs = matched
    assert ((present(here.flags)[theirs] & int(StarFlag.EXTENDED)) > 0).sum() <= 2


def test_stars_without_motion(zone_0: Path) -> None:
    columns = read_one(zone_0)
    still = np.isnan(columns.pm_dec_mas_yr)
    assert still.sum() == 177
    assert np.array_equal(still, (present(columns.flags) & int(StarFlag.NO_PROPER_MOTION)) > 0)
    c0, c1, c2 = columns.error_curve.T
    sigma_mas = np.sqrt(c0 + c1 * 27.0 + c2 * 27.0**2)
    assert sigma_mas[still].min() > 400
    assert (sigma_mas > np.sqrt(c0)).all()


# ---- any values, written from the table of the format

observation = st.one_of(
    st.just(NOT_SEEN),
    st.fixed_dictionaries(
        {
            "G": st.integers(0, 19),
            "S": st.integers(0, 9),
            "F": st.integers(1, 937),
            "m": st.integers(1, 9999),
            "C": st.integers(0, 9),
            "r": st.integers(0, 9999),
            "R": st.integers(0, 9999),
        }
    ),
)
star = st.fixed_dictionaries(
    {
        "ra": st.integers(0, 129_599_999),
        "spd": st.integers(1500 * 36000, 1501 * 36000 - 1),
        "i": st.integers(0, 1),
        "P": st.integers(0, 9),
        "S": st.integers(0, 9999),
        "A": st.integers(0, 9999),
        "j": st.integers(0, 1),
        "M": st.integers(2, 5),
        "R": st.integers(0, 9),
        "Q": st.integers(0, 9),
        "y": st.integers(0, 999),
        "x": st.integers(1, 999),
        "k": st.integers(0, 1),
        "e": st.integers(0, 999),
        "v": st.integers(0, 999),
        "u": st.integers(0, 999),
    }
)
seen_star = st.tuples(star, st.tuples(*[observation] * 5))


@pytest.mark.long
@settings(deadline=None, max_examples=60)
@given(st.lists(seen_star, min_size=1, max_size=5))
def test_what_is_written_is_read_back(tmp_path_factory: pytest.TempPathFactory, stars: list[Any]) -> None:
    stars = sorted(stars, key=lambda one: one[0]["ra"])
    path = write_zone(tmp_path_factory.mktemp("any"), 1500, [record(*one) for one in stars])
    columns, full = read_one(path), decoded(np.fromfile(path, dtype=RECORD))
    for n, (s, seen) in enumerate(stars):
        assert columns.ra_deg[n] * 360_000 == pytest.approx(s["ra"], abs=1e-6)
        assert (columns.dec_deg[n] + 90) * 360_000 == pytest.approx(s["spd"], abs=1e-5)
        assert columns.pm_ra_cosdec_mas_yr[n] == pytest.approx(2.0 * (s["A"] - 5000), abs=1e-9)
        assert columns.pm_dec_mas_yr[n] == pytest.approx(2.0 * (s["S"] - 5000), abs=1e-9)
        years = 2020.0 - (1950.0 + 0.1 * s["e"])
        variance = sum(
            s[place] ** 2 + 200.0**2 + (max(s[motion], 4.0) * years) ** 2
            for place, motion in (("u", "x"), ("v", "y"))
        )
        assert columns.error_curve[n] @ [1.0, 20.0, 400.0] == pytest.approx(0.5 * variance, rel=1e-9)
        assert bool(present(columns.flags)[n] & StarFlag.DOUBTFUL) == bool(s["j"])
        m = [0.01 * one["m"] if one["F"] else math.nan for one in seen]
        red = m[3] if seen[3]["F"] else m[1]
        if not math.isnan(red):
            assert columns.mag[n] == pytest.approx(red)
            assert not present(columns.flags)[n] & int(StarFlag.NO_MAGNITUDE | StarFlag.OTHER_BAND)
        assert math.isnan(present(columns.color_mag)[n]) == (
            math.isnan(red) or (math.isnan(m[0]) and math.isnan(m[2]))
        )
        told = (full.pm_probability[n], full.sigma_fit_ra_mas[n], full.sigma_fit_dec_mas[n])
        assert told == pytest.approx((0.1 * s["P"], 100 * s["Q"], 100 * s["R"]))
        assert (full.in_motion_catalog[n], full.ys4[n], full.detections[n]) == (s["i"], s["k"], s["M"])
        assert full.mag[n] == pytest.approx(m, nan_ok=True)
        for k, one in enumerate(seen):
            assert (full.field[n, k], full.survey[n, k], full.star_galaxy[n, k]) == (
                one["F"],
                one["S"],
                one["G"],
            )
            assert full.residual_ra_arcsec[n, k] == pytest.approx(0.01 * (one.get("R", 4990) - 5000))
            assert full.residual_dec_arcsec[n, k] == pytest.approx(0.01 * (one.get("r", 5010) - 5000))


# ---- single cases


def columns_of(folder: Path, *records: bytes) -> CatalogColumns:
    return read_one(write_zone(folder, 0, records))


def test_magnitudes_and_colors(tmp_path: Path) -> None:
    def seen(mag: int) -> dict[str, int]:
        return {**SEEN, "m": mag}

    columns = columns_of(
        tmp_path,
        record({}, (seen(1700), seen(1510), seen(1650), seen(1500), seen(1450))),
        record({}, (seen(1700), seen(1510), NOT_SEEN, seen(1500), NOT_SEEN)),
        record({}, (seen(1700), seen(1510), seen(1650), NOT_SEEN, NOT_SEEN)),
        record({}, (NOT_SEEN, NOT_SEEN, seen(1650), NOT_SEEN, NOT_SEEN)),
        record({}, (NOT_SEEN, NOT_SEEN, NOT_SEEN, NOT_SEEN, seen(1450))),
        record({}, (NOT_SEEN,) * 5),
    )
    assert columns.mag == pytest.approx([15.0, 15.0, 15.1, 15.6, 15.0, 21.0])
    assert present(columns.color_mag)[:3] == pytest.approx([1.5, 2.0, 1.9])
    assert np.isnan(present(columns.color_mag)[3:]).all()
    other, none = int(StarFlag.OTHER_BAND), int(StarFlag.NO_MAGNITUDE)
    assert present(columns.flags).tolist() == [0, 0, 0, other, other, none]


@pytest.mark.parametrize(
    ("estimates", "extended"),
    [
        ((1, 2, 1, 0, 0), True),
        ((1, 2, 9, 0, 0), False),
        ((0, 0, 0, 0, 0), False),
        ((1, 19, 19, 0, 19), False),
        ((3, 3, 3, 3, 3), False),
    ],
)
def test_galaxies(tmp_path: Path, estimates: tuple[int, ...], extended: bool) -> None:
    columns = columns_of(tmp_path, record({}, [{**SEEN, "G": g} for g in estimates]))
    assert bool(present(columns.flags)[0] & StarFlag.EXTENDED) == extended


def test_tycho_stars_and_rejects_are_left_out_and_counted(tmp_path: Path) -> None:
    # Tycho-2's records have another layout: here their digits mean nothing, and their place may be another's
    tycho = record({"ra": 5, "spd": 700_000, "M": 0, "k": 3})
    path = write_zone(tmp_path, 0, [record({}), tycho, record({"M": 1}), tycho, record({"ra": 2000})])
    reader = open_catalog(tmp_path)
    (columns,) = reader.read(reader.parts()[0])
    assert columns.ra_deg.size == 2
    assert (reader.tycho_records, reader.rejects) == (2, 1)
    assert [note.split(" left")[0] for note in reader.notes()] == ["2 Tycho-2 stars", "1 objects"]
    assert path.name in [part.path.name for part in reader.parts()]


# ---- damage


@pytest.mark.long
def test_every_truncation_within_a_record_is_refused(zone_0: Path, tmp_path: Path) -> None:
    cut = tmp_path / "b0000.cat"
    cut.write_bytes(zone_0.read_bytes()[: 60 * 80])
    with cut.open("r+b") as file:
        for length in range(60 * 80 - 1, -1, -1):
            if length % 80 == 0 and length:
                continue
            file.truncate(length)
            with pytest.raises(BadCatalog, match=f"at byte {length // 80 * 80}:"):
                read_one(cut)


def test_truncation_between_records_shows_by_the_accelerator(zone_0: Path, tmp_path: Path) -> None:
    whole = zone_0.read_bytes()
    right_ascensions = np.frombuffer(whole, dtype=RECORD)["ra"].tolist()
    (tmp_path / "b0000.acc").write_bytes(accelerator(right_ascensions))
    path = tmp_path / "b0000.cat"
    path.write_bytes(whole)
    assert read_one(path).ra_deg.size == 322
    for count in (1, 100, 321):
        path.write_bytes(whole[: count * 80])
        with pytest.raises(BadCatalog, match=f"at byte {count * 80}: expected 322 records by b0000.acc"):
            read_one(path)
    (tmp_path / "b0000.acc").write_text("nonsense\n")
    with pytest.raises(BadCatalog, match="an accelerator file has 96 lines"):
        read_one(path)


def test_an_accelerator_line_has_thirty_bytes() -> None:
    lines = accelerator([0, 1, 129_599_999]).splitlines(keepends=True)
    assert {len(line) for line in lines} == {30}


@pytest.mark.long
@settings(deadline=None, max_examples=150)
@given(st.integers(0, 25759), st.integers(1, 255))
def test_a_changed_byte_never_crashes(
    zone_0: Path, tmp_path_factory: pytest.TempPathFactory, at: int, change: int
) -> None:
    damaged = bytearray(zone_0.read_bytes())
    damaged[at] ^= change
    path = tmp_path_factory.mktemp("damaged") / "b0000.cat"
    path.write_bytes(damaged)
    try:
        columns = read_one(path)
    except BadCatalog:
        return
    assert columns.ra_deg.size in (321, 322)
    assert np.isfinite(columns.mag).all()
    assert np.isfinite(columns.error_curve).all()


@pytest.mark.parametrize(
    "changed",
    [{"i": 2}, {"j": 3}, {"k": 2}, {"M": 6}],
)
def test_digits_that_no_record_has_are_refused(tmp_path: Path, changed: dict[str, int]) -> None:
    with pytest.raises(BadCatalog, match=r"at byte 80: expected a record of USNO-B1\.0"):
        columns_of(tmp_path, record({}), record(changed))


def test_swapped_bytes_are_named(tmp_path: Path, zone_0: Path) -> None:
    path = tmp_path / "b0000.cat"
    np.fromfile(zone_0, dtype=RECORD).byteswap().tofile(path)
    with pytest.raises(BadCatalog, match=r"at byte [04]: .*bytes are swapped"):
        read_one(path)


def test_other_zones_and_disorder_are_refused(tmp_path: Path, zone_0: Path) -> None:
    path = tmp_path / "b0002.cat"
    shutil.copy(zone_0, path)
    with pytest.raises(BadCatalog, match="at byte 4: expected a south polar distance of 66000 to 114000"):
        read_one(path)
    with pytest.raises(BadCatalog, match=r"at byte 80: .*the file is sorted"):
        columns_of(tmp_path, record({"ra": 2000}), record({"ra": 1999}))


# ---- the folder


def test_zones_are_found_where_they_lie(tmp_path: Path, zone_0: Path) -> None:
    below = tmp_path / "USNOB10" / "000"
    below.mkdir(parents=True)
    shutil.copy(zone_0, below / "B0000.CAT")
    for place in (tmp_path, tmp_path / "USNOB10", below, below / "B0000.CAT"):
        reader = open_reader("usno-b1", place)
        assert [(part.name, part.size_bytes) for part in reader.parts()] == [("b0000", 25760)]
        assert "1 of 1800 zone files (0)" in reader.made_from
        assert "without its Tycho-2 stars" in reader.made_from
    assert (reader.name, reader.band, reader.color_name) == ("USNO-B1.0", "R", "B-R")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(BadCatalog, match=r"no zone files of USNO-B1\.0"):
        open_catalog(empty)


def test_the_plain_star_is_plain(tmp_path: Path) -> None:
    columns = columns_of(tmp_path, record({}))
    assert present(columns.flags).tolist() == [0]
    assert columns.ra_deg[0] == pytest.approx(PLAIN["ra"] / 360_000)


def test_each_zone_tells_its_declinations(shared, tmp_path):
    path = tmp_path / "b0000.cat"
    path.write_bytes((shared / "data" / "catalogs" / "usnob_b0000.cat").read_bytes())
    reader = open_catalog(path)
    part = reader.parts()[0]
    low, high = reader.dec_range_deg(part)
    stars = next(iter(reader.read(part)))
    assert (low, high) == (-90.0, -89.9)
    assert np.all((stars.dec_deg >= low) & (stars.dec_deg <= high))


@pytest.mark.parametrize("name", ["usnob_b0000.cat", "usno-b1_b0000.cat", "B0000.CAT", "USNOB1.b0000.cat"])
def test_zone_files_are_known_by_the_names_that_copies_have(name, zone_0, tmp_path):
    shutil.copy(zone_0, tmp_path / name)
    [part] = open_catalog(tmp_path).parts()
    assert (part.name, part.path.name) == ("b0000", name)
    assert open_catalog(tmp_path / name).parts() == [part]
