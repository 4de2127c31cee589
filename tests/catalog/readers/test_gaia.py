"""Gaia extracts written by astropy and pyarrow, read back: every format, unit, flag and epoch."""

from __future__ import annotations

import gzip
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io.votable import from_table
from astropy.table import MaskedColumn, Table
from astropy.time import Time
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers import open_reader
from mountnav.catalog.readers.gaia.reader import FORMATS, GaiaReader
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog
from tests.catalog.readers.read_whole import sigma_mas
from tests.short_part import one_in

UNITS = {
    "ra": u.deg,
    "dec": u.deg,
    "ref_epoch": u.yr,
    "ra_error": u.mas,
    "dec_error": u.mas,
    "pmra": u.mas / u.yr,
    "pmdec": u.mas / u.yr,
    "pmra_error": u.mas / u.yr,
    "pmdec_error": u.mas / u.yr,
    "phot_g_mean_mag": u.mag,
    "bp_rp": u.mag,
}


def gaia_table(count: int = 50, seed: int = 1) -> Table:
    """Stars as the archive gives them; every 7th has a position alone."""
    rng = np.random.default_rng(seed)
    table = Table()
    table["solution_id"] = np.full(count, 1636148068921376768)
    table["source_id"] = rng.integers(1, 2**62, count)
    table["ref_epoch"] = np.full(count, 2016.0)
    table["ra"] = rng.uniform(0, 360, count)
    table["ra_error"] = rng.uniform(0.01, 2, count).astype("f4")
    table["dec"] = np.degrees(np.arcsin(rng.uniform(-1, 1, count)))
    table["dec_error"] = rng.uniform(0.01, 2, count).astype("f4")
    alone = np.arange(count) % 7 == 3
    for name in ("pmra", "pmdec"):
        table[name] = MaskedColumn(rng.normal(0, 30, count), mask=alone)
        table[f"{name}_error"] = MaskedColumn(rng.uniform(0.01, 2, count).astype("f4"), mask=alone)
    table["astrometric_params_solved"] = np.where(alone, 3, 31).astype("i2")
    table["ruwe"] = MaskedColumn(rng.uniform(0.8, 1.8, count).astype("f4"), mask=alone)
    table["duplicated_source"] = rng.random(count) < 0.2
    table["phot_g_mean_mag"] = MaskedColumn(
        rng.uniform(3, 21, count).astype("f4"), mask=np.arange(count) % 11 == 5
    )
    table["bp_rp"] = MaskedColumn(rng.normal(1, 0.5, count).astype("f4"), mask=np.arange(count) % 5 == 1)
    table["phot_variable_flag"] = np.where(rng.random(count) < 0.3, "VARIABLE", "NOT_AVAILABLE")
    table["in_galaxy_candidates"] = rng.random(count) < 0.1
    table["non_single_star"] = (rng.random(count) < 0.1).astype("i2") * 2
    for name, unit in UNITS.items():
        table[name].unit = unit
    return table


def as_fits(table: Table, path: Path) -> Path:
    path = path.with_suffix(".fits")
    table.write(path)
    return path


def as_csv(table: Table, path: Path) -> Path:
    path = path.with_suffix(".csv")
    table.write(path, format="ascii.csv")
    return path


def as_csv_with_null(table: Table, path: Path) -> Path:
    path = path.with_name(path.name + ".csv.gz")  # as in the archive's own partition
    text = io.StringIO()
    table.write(text, format="ascii.csv", fill_values=[("0", "0")])
    lines = [line.replace(",,", ",null,").replace(",,", ",null,") for line in text.getvalue().splitlines()]
    path.write_bytes(gzip.compress(("\r\n".join(lines) + "\r\n").encode()))
    return path


def as_ecsv(table: Table, path: Path) -> Path:
    path = path.with_suffix(".ecsv")
    table.write(path)
    return path


def as_ecsv_with_commas(table: Table, path: Path) -> Path:
    path = path.with_suffix(".ecsv")
    table.write(path, delimiter=",")
    return path


def as_votable(tabledata_format: str) -> Callable[[Table, Path], Path]:
    def write(table: Table, path: Path) -> Path:
        path = path.with_suffix(".vot")
        # not the writer in C: it corrupts the heap now and then [astropy issue 20419]
        from_table(table).to_xml(
            str(path), tabledata_format=tabledata_format, _debug_python_based_parser=True
        )
        return path

    return write


def as_packed_votable(table: Table, path: Path) -> Path:
    content = as_votable("binary2")(table, path).with_suffix(".vot").read_bytes()
    packed = path.with_name(path.name + "-result.vot.gz")
    packed.write_bytes(gzip.compress(content))
    return packed


def as_parquet(table: Table, path: Path) -> Path:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = path.with_suffix(".parquet")
    columns = {
        name: pa.array(np.ma.getdata(table[name]), mask=np.ma.getmaskarray(np.ma.asarray(table[name])))
        for name in table.colnames
    }
    fields = [
        pa.field(name, column.type, metadata={"unit": UNITS[name].to_string()} if name in UNITS else None)
        for name, column in columns.items()
    ]
    pq.write_table(
        pa.Table.from_arrays(list(columns.values()), schema=pa.schema(fields)), path, row_group_size=20
    )
    return path


WRITERS = {
    "fits": as_fits,
    "csv": as_csv,
    "csv with null": as_csv_with_null,
    "ecsv": as_ecsv,
    "ecsv with commas": as_ecsv_with_commas,
    "votable text": as_votable("tabledata"),
    "votable binary": as_votable("binary"),
    "votable binary2": as_votable("binary2"),
    "votable packed": as_packed_votable,
    "parquet": as_parquet,
}


def read(path: Path) -> tuple[GaiaReader, CatalogColumns]:
    reader = open_reader("gaia", path)
    assert isinstance(reader, GaiaReader)
    chunks = [chunk for part in reader.parts() for chunk in reader.read(part)]
    return reader, CatalogColumns(
        *(np.concatenate([getattr(c, name) for c in chunks]) for name in CatalogColumns.__dataclass_fields__)
    )


def filled(table: Table, name: str) -> np.ndarray:
    return np.ma.filled(np.ma.asarray(table[name]).astype(np.float64), np.nan)


@pytest.mark.parametrize("writer", WRITERS.values(), ids=WRITERS)
def test_what_is_written_is_read(writer: Callable[[Table, Path], Path], tmp_path: Path) -> None:
    table = gaia_table()
    reader, stars = read(writer(table, tmp_path / "extract"))
    assert (reader.band, reader.color_name, reader.epoch_yr) == ("G", "BP-RP", 2016.0)
    assert np.array_equal(stars.ra_deg, table["ra"])
    assert np.array_equal(stars.dec_deg, table["dec"])
    assert np.array_equal(stars.pm_ra_cosdec_mas_yr, filled(table, "pmra"), equal_nan=True)
    assert np.array_equal(stars.pm_dec_mas_yr, filled(table, "pmdec"), equal_nan=True)
    assert stars.color_mag is not None
    assert stars.flags is not None
    np.testing.assert_allclose(stars.color_mag, filled(table, "bp_rp"), rtol=1e-6)

    g = filled(table, "phot_g_mean_mag")
    np.testing.assert_allclose(stars.mag, np.where(np.isnan(g), 21.0, g), rtol=1e-6)
    alone = np.isnan(filled(table, "pmra"))
    doubtful = (filled(table, "ruwe") > 1.4) | np.array(table["duplicated_source"])
    for flag, expected in (
        (StarFlag.NO_MAGNITUDE, np.isnan(g)),
        (StarFlag.NO_PROPER_MOTION, alone),
        (StarFlag.DOUBTFUL, doubtful),
        (StarFlag.VARIABLE, np.array(table["phot_variable_flag"] == "VARIABLE")),
        (StarFlag.EXTENDED, np.array(table["in_galaxy_candidates"])),
        (StarFlag.DOUBLE, np.array(table["non_single_star"] > 0)),
    ):
        assert expected.any()
        assert np.array_equal((stars.flags & flag) > 0, expected), flag

    position = (filled(table, "ra_error") ** 2 + filled(table, "dec_error") ** 2) / 2
    np.testing.assert_allclose(sigma_mas(stars, 2016.0), np.sqrt(position), rtol=1e-5)
    motion = (filled(table, "pmra_error") ** 2 + filled(table, "pmdec_error") ** 2) / 2
    expected_later = np.sqrt(position + 100 * motion)
    np.testing.assert_allclose(sigma_mas(stars, 2026.0)[~alone], expected_later[~alone], rtol=1e-5)
    assert np.all(sigma_mas(stars, 2026.0)[alone] > 100.0)  # ten years of some 10 mas/yr


@pytest.mark.long
@pytest.mark.parametrize("writer", WRITERS.values(), ids=WRITERS)
def test_each_format_is_refused_when_it_is_cut(writer: Callable[[Table, Path], Path], tmp_path: Path) -> None:
    path = writer(gaia_table(30), tmp_path / "extract")
    whole = path.read_bytes()
    ends = {at + 1 for at, byte in enumerate(whole) if byte == 10}
    rng = np.random.default_rng(3)
    cuts = {*range(12), *range(len(whole) - 12, len(whole)), *rng.integers(0, len(whole), 60).tolist()}
    refused = 0
    for cut in sorted(cuts):
        if path.suffix in (".csv", ".ecsv") and cut in ends:
            continue  # a table that ends with a row: nothing in a text file tells that there were more
        if path.suffix == ".vot" and not whole[cut:].strip():
            continue
        path.write_bytes(whole[:cut])
        with pytest.raises(BadCatalog, match=r"at (unpacked )?(byte|row) \d+|has no column|told in"):
            read(path)
        refused += 1
    assert refused > 40


physical = settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@st.composite
def any_table(draw: st.DrawFn) -> Table:
    count = draw(st.integers(1, 30))

    def numbers(low: float, high: float) -> np.ndarray:
        return draw(arrays(np.float64, count, elements=st.floats(low, high, allow_subnormal=False)))

    table = Table()
    table["source_id"] = np.arange(1, count + 1) * 2**40
    table["ra"], table["dec"] = numbers(0, 360), numbers(-90, 90)
    table["ref_epoch"] = np.full(count, draw(st.sampled_from([2015.0, 2015.5, 2016.0, 2017.5])))
    table["phot_g_mean_mag"] = numbers(-1.5, 22)
    known = draw(arrays(np.bool_, count))
    table["pmra"] = MaskedColumn(numbers(-10_000, 10_000), mask=~known)
    table["pmdec"] = MaskedColumn(numbers(-10_000, 10_000), mask=~known)
    table["ra_error"], table["dec_error"] = numbers(1e-3, 100), numbers(1e-3, 100)
    table["pmra_error"], table["pmdec_error"] = numbers(1e-3, 10), numbers(1e-3, 10)
    return table


@pytest.mark.long
@pytest.mark.parametrize("writer", one_in(2, WRITERS.values()), ids=WRITERS)
@given(table=any_table())
@physical
def test_any_possible_values_come_back(
    writer: Callable[[Table, Path], Path], table: Table, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = writer(table, tmp_path_factory.mktemp("any") / "extract")
    reader, stars = read(path)
    assert reader.epoch_yr == table["ref_epoch"][0]
    np.testing.assert_array_equal(stars.ra_deg, table["ra"])
    np.testing.assert_array_equal(stars.dec_deg, table["dec"])
    np.testing.assert_array_equal(stars.mag, table["phot_g_mean_mag"])
    np.testing.assert_array_equal(stars.pm_ra_cosdec_mas_yr, filled(table, "pmra"))
    np.testing.assert_array_equal(stars.pm_dec_mas_yr, filled(table, "pmdec"))
    expected = np.sqrt((filled(table, "ra_error") ** 2 + filled(table, "dec_error") ** 2) / 2)
    # a difference of large numbers where the error of the motion is large: 1e-12 of it
    np.testing.assert_allclose(sigma_mas(stars, reader.epoch_yr), expected, rtol=1e-3, atol=2e-3)


def test_vizier_names(tmp_path: Path) -> None:
    table = gaia_table()
    names = {
        "source_id": "Source",
        "ra": "RA_ICRS",
        "dec": "DE_ICRS",
        "ra_error": "e_RA_ICRS",
        "dec_error": "e_DE_ICRS",
        "pmra": "pmRA",
        "pmdec": "pmDE",
        "pmra_error": "e_pmRA",
        "pmdec_error": "e_pmDE",
        "phot_g_mean_mag": "Gmag",
        "bp_rp": "BP-RP",
        "ruwe": "RUWE",
    }
    viziers = table[list(names)]
    viziers["duplicated_source"] = np.array(table["duplicated_source"]).astype("i2")
    viziers.rename_columns(list(names), list(names.values()))
    viziers.rename_column("duplicated_source", "Dup")
    viziers["RA_ICRS"].description = "Right ascension (ICRS) at Ep=2016.0 (ra)"
    reader, stars = read(as_votable("tabledata")(viziers, tmp_path / "asu"))
    _, archives = read(as_fits(table, tmp_path / "archive"))
    assert reader.epoch_yr == 2016.0
    for name in ("ra_deg", "dec_deg", "pm_dec_mas_yr", "mag", "error_curve", "color_mag"):
        np.testing.assert_array_equal(getattr(stars, name), getattr(archives, name))
    assert stars.flags is not None
    assert (stars.flags & StarFlag.DOUBTFUL).any()


def test_viziers_text_table_with_units_and_rule(tmp_path: Path) -> None:
    path = tmp_path / "asu.tsv"
    path.write_text(
        "#\n#   VizieR Astronomical Server\n#Name: I/355/gaiadr3\n\n"
        "RA_ICRS\tDE_ICRS\tSource\tGmag\tpmRA\tpmDE\n"
        "deg\tdeg\t \tmag\tmas/yr\tmas/yr\n"
        "---------------\t---------------\t---\t---------\t---------\t---------\n"
        "045.00432028915\t+00.02104802840\t1234\t17.641426\t   1.1515\t  -2.0000\n"
        "000.00000000001\t-89.99999999999\t1235\t 7.641426\t         \t         \n"
    )
    reader, stars = read(path)
    assert reader.epoch_yr == 2016.0
    assert stars.ra_deg.tolist() == [45.00432028915, 1e-11]
    assert stars.dec_deg.tolist() == [0.02104802840, -89.99999999999]
    assert np.isnan(stars.pm_dec_mas_yr).tolist() == [False, True]
    path.write_text(path.read_text().replace("\tmas/yr", "\tarcsec/yr"))
    with pytest.raises(BadCatalog, match="'pmRA' is in 'arcsec/yr', expected 'mas/yr'"):
        read(path)


def test_mixed_epochs_are_moved_to_the_first_one(tmp_path: Path) -> None:
    table = gaia_table(40)
    table["ref_epoch"] = np.where(np.arange(40) % 2, 2015.5, 2016.0)
    table["pmra"] *= 50
    table["pmdec"] *= 50
    reader, stars = read(as_fits(table, tmp_path / "mixed"))
    assert reader.epoch_yr == 2016.0
    old = (table["ref_epoch"] == 2015.5) & ~np.isnan(filled(table, "pmra"))
    before = SkyCoord(
        np.array(table["ra"])[old] * u.deg,
        np.array(table["dec"])[old] * u.deg,
        pm_ra_cosdec=filled(table, "pmra")[old] * u.mas / u.yr,
        pm_dec=filled(table, "pmdec")[old] * u.mas / u.yr,
        distance=np.full(int(old.sum()), 10.0) * u.pc,
        obstime=Time(2015.5, format="jyear", scale="tcb"),
    )
    after = before.apply_space_motion(new_obstime=Time(2016.0, format="jyear", scale="tcb"))
    here = SkyCoord(stars.ra_deg[old] * u.deg, stars.dec_deg[old] * u.deg)
    assert here.separation(after).mas.max() < 0.01
    assert here.separation(before).mas.max() > 100
    assert np.array_equal(stars.ra_deg[~old], np.array(table["ra"])[~old])
    # the errors go on from each star's own epoch
    np.testing.assert_allclose(
        sigma_mas(stars, 2015.5)[old],
        np.sqrt((filled(table, "ra_error") ** 2 + filled(table, "dec_error") ** 2) / 2)[old],
        rtol=1e-5,
    )


def test_a_table_that_does_not_tell_its_epoch_is_refused(tmp_path: Path) -> None:
    table = gaia_table()
    table.remove_column("ref_epoch")
    for number, writer in enumerate(WRITERS.values()):
        with pytest.raises(BadCatalog, match=r"the epoch of its positions.*add ref_epoch"):
            read(writer(table, tmp_path / f"extract{number}"))
    table["designation"] = [f"Gaia DR2 {number}" for number in table["source_id"]]
    reader, _ = read(as_csv(table, tmp_path / "named"))
    assert reader.epoch_yr == 2015.5
    table["designation"][7] = "Gaia DR3 4295806720"
    _, mixed = read(as_csv(table, tmp_path / "both"))
    assert mixed.ra_deg[7] != table["ra"][7]  # moved by half a year
    table["designation"][9] = "HIP 4711"
    with pytest.raises(BadCatalog, match=r"at byte \d+: expected a designation that names the release"):
        read(as_csv(table, tmp_path / "foreign"))


def test_the_release_may_be_told_in_words(tmp_path: Path) -> None:
    table = gaia_table()
    table.remove_column("ref_epoch")
    table.meta["QUERY"] = "SELECT * FROM gaiadr3.gaia_source"
    assert read(as_fits(table, tmp_path / "a"))[0].epoch_yr == 2016.0
    assert read(as_ecsv(table, tmp_path / "b"))[0].epoch_yr == 2016.0
    table.meta["NOTE"] = "compared with gaiadr2.gaia_source"
    with pytest.raises(BadCatalog, match=r"several epochs, 2015.5, 2016.0"):
        read(as_fits(table, tmp_path / "c"))


def test_the_coordinate_system_of_a_votable_tells_the_epoch(tmp_path: Path) -> None:
    table = gaia_table()
    table.remove_column("ref_epoch")
    path = as_votable("tabledata")(table, tmp_path / "extract")
    plain = path.read_text()
    for label, expected in (("J2015.5", 2015.5), ("2016.0", 2016.0)):
        told = plain.replace("<TABLE", f'<COOSYS ID="s" system="ICRS" epoch="{label}"/><TABLE', 1)
        path.write_text(told.replace('<FIELD ID="ra"', '<FIELD ID="ra" ref="s"', 1))
        assert 'ref="s"' in path.read_text()
        assert read(path)[0].epoch_yr == expected
    for label in ("J2000", "2000.0", ""):  # an equinox, as a rule
        told = plain.replace("<TABLE", f'<COOSYS ID="s" system="ICRS" epoch="{label}"/><TABLE', 1)
        path.write_text(told.replace('<FIELD ID="ra"', '<FIELD ID="ra" ref="s"', 1))
        with pytest.raises(BadCatalog, match="the epoch of its positions"):
            read(path)


@pytest.mark.parametrize(("column", "unit"), [("ra", u.hourangle), ("dec", u.rad), ("pmra", u.arcsec / u.yr)])
@pytest.mark.parametrize(
    "writer",
    [as_fits, as_ecsv, as_votable("binary"), as_parquet],
    ids=["fits", "ecsv", "votable", "parquet"],
)
def test_other_units_are_refused(
    writer: Callable[[Table, Path], Path], column: str, unit: u.UnitBase, tmp_path: Path
) -> None:
    if unit is u.hourangle and writer is not as_ecsv:
        unit = u.h  # what the others can write
    table = gaia_table()
    table[column].unit = unit
    path = tmp_path / "extract"
    if writer is as_parquet:
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(UNITS, column, unit)
            path = as_parquet(table, tmp_path / "other")
    else:
        path = writer(table, path)
    with pytest.raises(BadCatalog, match=f"column '{column}' is in .*, expected"):
        read(path)


@pytest.mark.long
@pytest.mark.parametrize(
    ("column", "value", "expected"),
    [
        ("ra", np.nan, "a right ascension of 0 to 360 degrees, found none"),
        ("ra", 360.5, "a right ascension"),
        ("ra", -0.1, "a right ascension"),
        ("dec", 90.0001, "a declination"),
        ("dec", np.nan, "a declination of -90 to 90 degrees, found none"),
        ("ref_epoch", 2457389.0, "a ref_epoch"),
        ("ref_epoch", np.nan, "a ref_epoch"),
        ("pmra", 30_000.0, "a proper motion"),
        ("phot_g_mean_mag", 99.0, "a magnitude"),
        ("ra_error", np.inf, "a ra_error of at most"),
        ("dec_error", 1e25, "a dec_error of at most"),
        ("pmra_error", 1e22, "a pmra_error of at most"),
    ],
)
@pytest.mark.parametrize(
    "writer",
    [as_fits, as_csv, as_votable("tabledata"), as_parquet],
    ids=["fits", "csv", "votable", "parquet"],
)
def test_impossible_values_are_refused_with_their_row(
    writer: Callable[[Table, Path], Path], column: str, value: float, expected: str, tmp_path: Path
) -> None:
    table = gaia_table()
    table[column][18] = value
    path = writer(table, tmp_path / "extract")
    with pytest.raises(BadCatalog, match=rf"at (byte|row) \d+: expected {expected}") as refused:
        read(path)
    at = int(str(refused.value).split(" at ")[1].split()[1].rstrip(":"))
    if path.suffix == ".csv":
        assert at == len("".join(path.read_text().splitlines(keepends=True)[:19]))
    elif path.suffix == ".fits":
        assert "row 19 of the table" in str(refused.value)
    else:
        assert at == 18


def test_broken_rows_of_text_are_refused_with_their_byte(tmp_path: Path) -> None:
    path = as_csv(gaia_table(), tmp_path / "extract")
    lines = path.read_text().splitlines(keepends=True)
    before = len("".join(lines[:31]))
    for broken, expected in (
        (lines[31].partition(",")[2], "22 cells, found 21|cells, found"),
        (lines[31].replace("\n", ",1\n"), "cells, found"),
        ("<html>503 Service Unavailable</html>\n", "cells, found 1"),
        (
            lines[31].replace("2016.0,", "2016.0,12:30:45.6", 1).replace("45.6", "45.6,", 1),
            "cells|a number as",
        ),
    ):
        path.write_text("".join([*lines[:31], broken, *lines[32:]]))
        with pytest.raises(BadCatalog, match=rf"at byte {before}: expected .*({expected})"):
            read(path)
    cells = lines[31].split(",")
    cells[3] = "12:30:45.6"
    path.write_text("".join([*lines[:31], ",".join(cells), *lines[32:]]))
    with pytest.raises(BadCatalog, match=rf"at byte {before}: expected a number as ra, found '12:30:45.6'"):
        read(path)


def test_saved_answers_of_failed_queries_are_refused(tmp_path: Path) -> None:
    path = as_votable("tabledata")(gaia_table(), tmp_path / "extract")
    text = path.read_text()

    def saved(before: str, after: str) -> Path:
        path.write_text(text.replace("<TABLE", before + "<TABLE", 1).replace("</TABLE>", "</TABLE>" + after))
        return path

    assert read(saved('<INFO name="QUERY_STATUS" value="OK"/>', ""))[1].mag.size == 50
    with pytest.raises(BadCatalog, match="a server's error: timed out"):
        read(saved('<INFO name="QUERY_STATUS" value="ERROR">timed out</INFO>', ""))
    with pytest.raises(BadCatalog, match=r"isn't whole.*raise the limit"):
        read(saved("", '<INFO name="QUERY_STATUS" value="OVERFLOW"/>'))
    with pytest.raises(BadCatalog, match="isn't whole"):
        read(saved("", '<INFO name="Warning" value="truncated result (maxtup=50)"/>'))
    path.write_text(text.replace("<TABLE", '<TABLE nrows="51"', 1).replace(' nrows="50"', ""))
    with pytest.raises(BadCatalog, match="at row 50: expected 51 rows"):
        read(path)
    for none in ("²", "1" * 5000):  # digits to some, no number to `int`
        path.write_text(text.replace("<TABLE", f'<TABLE nrows="{none}"', 1).replace(' nrows="50"', ""))
        with pytest.raises(BadCatalog, match="expected a VOTable that can be read"):
            read(path)


def test_without_errors_typical_ones_stand_in(tmp_path: Path) -> None:
    table = gaia_table()["source_id", "ra", "dec", "ref_epoch", "phot_g_mean_mag", "pmra", "pmdec"]
    _, stars = read(as_csv(table, tmp_path / "short"))
    g = filled(table, "phot_g_mean_mag")
    known = ~np.isnan(filled(table, "pmra")) & ~np.isnan(g)
    bright, faint = known & (g < 12), known & (g > 19.5)
    assert np.all(sigma_mas(stars, 2026.0)[bright] < 1.0)
    assert np.all(sigma_mas(stars, 2026.0)[faint] > 5.0)
    assert stars.color_mag is not None
    assert np.all(np.isnan(stars.color_mag))


def test_colors_from_the_two_magnitudes(tmp_path: Path) -> None:
    table = gaia_table()
    table.remove_column("bp_rp")
    table["phot_bp_mean_mag"] = np.full(50, 15.5)
    table["phot_rp_mean_mag"] = np.full(50, 14.25)
    assert np.all(read(as_fits(table, tmp_path / "extract"))[1].color_mag == 1.25)


def test_missing_and_doubled_columns_are_refused(tmp_path: Path) -> None:
    table = gaia_table()["ra", "dec", "ref_epoch"]
    with pytest.raises(
        BadCatalog, match="has no column phot_g_mean_mag or gmag; there are: ra, dec, ref_epoch"
    ):
        read(as_csv(table, tmp_path / "few"))
    path = as_csv(gaia_table(), tmp_path / "twice")
    path.write_text(path.read_text().replace("solution_id,", "RA,", 1))
    with pytest.raises(BadCatalog, match="two columns 'ra'"):
        read(path)


def test_unknown_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadCatalog, match="holds none of the files"):
        open_reader("gaia", tmp_path)
    for name in ("table.dat", "table.fits.gz"):
        (tmp_path / name).write_bytes(b"")
        with pytest.raises(BadCatalog, match="not of a format that can be read"):
            open_reader("gaia", tmp_path / name)
    for suffix in FORMATS:
        path = tmp_path / f"garbage{suffix}"
        for garbage in (b"", b"\0" * 5000, b"<html>not found</html>\n", gzip.compress(b"\xff" * 300)):
            path.write_bytes(garbage)
            with pytest.raises(BadCatalog):
                open_reader("gaia", path)


def test_an_extract_without_stars_is_refused(tmp_path: Path) -> None:
    for number, writer in enumerate(WRITERS.values()):
        with pytest.raises(BadCatalog, match="holds no stars"):
            read(writer(gaia_table()[:0], tmp_path / f"empty{number}"))
