"""Index files written by astrometry.net's own programs, and Debian's thirteen, against what went into them.

`index_files/` holds what hpsplit's numbering, build-astrometry-index 0.93 and fits-flip-endian made of
`stars.csv` (500 made-up stars round RA = Dec = 0, where four HEALPix tiles of nside 2 meet)::

    build-astrometry-index -i gaia.fits -o index-5006-16.fits -P 6 -S phot_g_mean_mag -H 16 -s 2 -m 3
        -I 5006 -A ra -D dec -K -M -E        (17, 18, 19 alike; 5008 with -P 8; 5206 without -H, -s and -m)
"""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.table import Table
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers import open_reader
from mountnav.catalog.readers.astrometry_net.index_file import IndexFile, stand_in_mags
from mountnav.catalog.readers.astrometry_net.reader import IndexReader, nested_pixel
from mountnav.catalog.readers.kind import Part
from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog
from mountnav.sky.coordinates import Icrs

FILES = Path(__file__).parent / "index_files"
DEBIAN = Path("/usr/share/astrometry")
FINEST = DEBIAN / "index-tycho2-07.littleendian.fits"


def unpacked(folder: Path, *names: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).write_bytes(gzip.decompress((FILES / f"{name}.gz").read_bytes()))
    return folder


def all_stars(path: Path) -> tuple[IndexReader, CatalogColumns]:
    reader = open_reader("astrometry-net", path)
    assert isinstance(reader, IndexReader)
    chunks = [chunk for part in reader.parts() for chunk in reader.read(part)]
    columns: dict[str, Any] = {}
    for name in CatalogColumns.__dataclass_fields__:
        values = [getattr(chunk, name) for chunk in chunks]
        columns[name] = None if values[0] is None else np.concatenate(values)
    return reader, CatalogColumns(**columns)


def truth() -> Table:
    return Table.read(FILES / "stars.csv.gz", format="ascii.csv")[1:]  # the first stands at (0, 0)


def pairs(stars: CatalogColumns, table: Table) -> np.ndarray:
    """Row of the table for each star; each star is one of them, and none comes twice."""
    found = unit_vectors(stars.ra_deg, stars.dec_deg)
    given = unit_vectors(np.array(table["ra"]), np.array(table["dec"]))
    distance = np.sqrt(((found[:, :, None] - given[:, None, :]) ** 2).sum(axis=0))
    rows: np.ndarray = distance.argmin(axis=1)
    assert distance.min(axis=1).max() < 1e-9  # 0.2 mas
    assert np.unique(rows).size == rows.size
    return rows


def tiles(folder: Path) -> Path:
    return unpacked(folder, *(f"index-5006-{number}.fits" for number in (16, 17, 18, 19)))


def test_tiles_with_margins_give_each_star_once(tmp_path: Path) -> None:
    reader, stars = all_stars(tiles(tmp_path / "index"))
    table = truth()
    rows = pairs(stars, table)
    assert rows.size == len(table) == 499
    held = sum(IndexReader([file]).parts()[0].size_bytes // 17 for file in reader._files.values())
    assert held > 500  # so there were stars that two files have

    assert np.array_equal(stars.ra_deg, table["ra"][rows])  # the columns beside the tree have all digits
    assert np.array_equal(stars.dec_deg, table["dec"][rows])
    np.testing.assert_allclose(stars.mag, table["phot_g_mean_mag"][rows], atol=1e-6)
    assert stars.color_mag is not None
    assert stars.flags is not None
    color = table["phot_bp_mean_mag"] - table["phot_rp_mean_mag"]
    np.testing.assert_allclose(stars.color_mag, color[rows], atol=1e-5)
    unknown = np.array((table["pmra"] == 0) & (table["pmdec"] == 0))[rows]
    assert 0 < unknown.sum() < 30
    assert np.array_equal(np.isnan(stars.pm_dec_mas_yr), unknown)
    assert np.array_equal((stars.flags & StarFlag.NO_PROPER_MOTION) > 0, unknown)
    np.testing.assert_allclose(stars.pm_ra_cosdec_mas_yr[~unknown], table["pmra"][rows][~unknown], rtol=1e-6)
    # (20 years)² × mean of both errors of the motion
    late, ref = 2035.5 - 2000.0, 2015.5 - 2000.0
    grown = stars.error_curve @ [0, late - ref, late**2 - ref**2]
    errors = (table["pmra_error"] ** 2 + table["pmdec_error"] ** 2)[rows] / 2
    extra = stars.error_curve @ [0, 1, 2 * ref]  # the curve is lowest at 2015.5
    np.testing.assert_allclose(extra, 0, atol=1e-6 * np.abs(stars.error_curve[:, 1]).max())
    np.testing.assert_allclose(grown[~unknown], 400 * errors[~unknown], rtol=1e-4)
    assert (reader.name, reader.band, reader.epoch_yr, reader.color_name) == (
        "Gaia DR2 (index files)",
        "G",
        2015.5,
        "BP-RP",
    )
    assert "8% of the sky" in reader.made_from


def test_of_two_scales_the_finer_one_is_read(tmp_path: Path) -> None:
    folder = unpacked(tiles(tmp_path / "index"), "index-5008-17.fits")
    assert [part.name for part in open_reader("astrometry-net", folder).parts()] == [
        f"index-5006-{number}.fits" for number in (16, 17, 18, 19)
    ]
    (folder / "index-5006-17.fits").unlink()
    reader, stars = all_stars(folder)  # where the finer one isn't, the coarser one is taken
    assert "index-5008-17.fits" in [part.name for part in reader.parts()]
    assert pairs(stars, truth()).size > 490


def test_other_series_are_left_aside_and_told(tmp_path: Path) -> None:
    folder = unpacked(tiles(tmp_path / "index"), "index-5206-mag.fits")
    (folder / "readme.txt").write_text("no index")
    reader = open_reader("astrometry-net", folder)
    told = {"Gaia DR2 (index files)": 1, "Gaia DR2 and Tycho-2 (index files)": 4}[reader.name]
    assert f"{told} files of other series left aside" in reader.made_from


def test_the_larger_5200_version(tmp_path: Path) -> None:
    reader, stars = all_stars(unpacked(tmp_path / "index", "index-5206-heavy.fits"))
    table = truth()
    rows = pairs(stars, table)
    assert rows.size == 499
    from_tycho = (rows + 1) % 5 == 0  # as it was made
    assert stars.flags is not None
    for flag in (StarFlag.DOUBTFUL, StarFlag.OTHER_BAND):
        assert np.array_equal((stars.flags & flag) > 0, from_tycho)
    assert np.all(np.isnan(stars.pm_dec_mas_yr[from_tycho]))
    np.testing.assert_allclose(stars.mag, table["phot_g_mean_mag"][rows], atol=1e-6)
    t = 15.5
    gaia = np.sqrt(stars.error_curve[~from_tycho] @ [1, t, t * t])
    np.testing.assert_allclose(gaia, np.sqrt((0.05**2 + 0.07**2) / 2), rtol=1e-3)
    # nobody knows where Tycho-2's stars stand by 24 years of motion
    assert np.all(np.sqrt(stars.error_curve[from_tycho] @ [1, t, t * t]) > 24 * 10)
    assert reader.name == "Gaia DR2 and Tycho-2 (index files)"


def test_without_columns_magnitudes_stand_in(tmp_path: Path) -> None:
    folder = unpacked(tmp_path / "index", "index-5206-mag.fits")
    path = folder / "index-5206-mag.fits"
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b"XTENSION", 0, content.index(b"TAGALONG"))])
    _, stars = all_stars(folder)
    assert pairs(stars, truth()).size == 499
    assert stars.flags is not None
    assert np.all(stars.flags == StarFlag.NO_MAGNITUDE | StarFlag.NO_PROPER_MOTION)
    assert stars.color_mag is None
    rows = pairs(stars, truth())
    # the order within a sweep is the real one, so the brightest sweep's stars go with their magnitudes
    real = np.array(truth()["phot_g_mean_mag"])[rows]
    assert np.corrcoef(stars.mag, real)[0, 1] > 0.5


def test_stand_in_magnitudes_follow_the_counts() -> None:
    sweeps = [1000, 900, 800, 700, 600, 500, 400, 300, 200, 100]
    fine, coarse = stand_in_mags(5500, sweeps, 1760), stand_in_mags(5500, sweeps, 156)
    assert 16 < fine[-3:].min() <= fine[-3:].max() < 19  # 9,000 stars in a square degree
    assert 10 < coarse[-3:].min() <= coarse[-3:].max() < 13.5
    assert np.all(np.diff(fine[: 256 * 1000 // 5500]) > 0)
    assert np.all(np.diff(stand_in_mags(5500, [], 1760)) >= 0)


def test_both_byte_orders_give_the_same_stars(tmp_path: Path) -> None:
    _, little = all_stars(unpacked(tmp_path / "little", "index-5206-mag.fits"))
    _, big = all_stars(unpacked(tmp_path / "big", "index-5206-big-endian.fits"))
    for name in ("ra_deg", "dec_deg", "mag", "error_curve", "flags"):
        assert np.array_equal(getattr(little, name), getattr(big, name))
    pairs(little, truth())


@pytest.mark.parametrize("claim", [b"01:02:03:04", b"03:04:01:02", b"           "])
def test_bytes_in_another_order_than_told_are_refused(tmp_path: Path, claim: bytes) -> None:
    path = unpacked(tmp_path / "index", "index-5206-mag.fits") / "index-5206-mag.fits"
    path.write_bytes(path.read_bytes().replace(b"04:03:02:01", claim))
    with pytest.raises(BadCatalog, match=r"at byte \d+: expected"):
        all_stars(path)


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_cut_file_is_refused(tmp_path_factory: pytest.TempPathFactory, share: float) -> None:
    whole = gzip.decompress((FILES / "index-5206-heavy.fits.gz").read_bytes())
    path = tmp_path_factory.mktemp("cut") / "index-5206-heavy.fits"
    cut = int(share * len(whole))
    path.write_bytes(whole[:cut])
    before_columns = whole.rindex(b"XTENSION", 0, whole.index(b"TAGALONG"))
    if cut == before_columns:  # nothing tells this from a file without columns
        return
    with pytest.raises(BadCatalog, match=r"at byte|has no star tree"):
        all_stars(path)


@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_flipped_bits_in_the_star_tree_are_refused_with_their_byte(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    whole = bytearray(gzip.decompress((FILES / "index-5206-mag.fits.gz").read_bytes()))
    table = whole.index(b"kdtree_data_stars")
    first = whole.index(b"END" + b" " * 77, table)
    first += -first % 2880
    star = data.draw(st.integers(0, 499))
    axis = data.draw(st.integers(0, 2))
    value = int.from_bytes(whole[first + 12 * star + 4 * axis :][:4], "little")
    bit = data.draw(st.integers(24, 30))  # a step of 0.008 and more: 0.4° and more
    at = first + 12 * star + 4 * axis
    whole[at : at + 4] = (value ^ 1 << bit).to_bytes(4, "little")
    path = tmp_path_factory.mktemp("flip") / "index.fits"
    path.write_bytes(whole)
    before, after = (-1 + v / (2**31 - 0.5) for v in (value, value ^ 1 << bit))
    if abs(before**2 - after**2) < 3e-6:
        return  # it moves the star along the sphere
    with pytest.raises(BadCatalog, match=rf"at byte {first + 12 * star}: expected a unit vector"):
        all_stars(path)


def test_columns_of_other_stars_are_refused(tmp_path: Path) -> None:
    path = tiles(tmp_path / "index") / "index-5006-16.fits"
    content = bytearray(path.read_bytes())
    table = content.index(b"TAGALONG")
    first = content.index(b"END" + b" " * 77, table)
    first += -first % 2880
    row = 8 + 7 * 4 + 16 + 4
    content[first : first + row], content[first + row : first + 2 * row] = (
        content[first + row : first + 2 * row],
        content[first : first + row],
    )
    path.write_bytes(content)
    with pytest.raises(BadCatalog, match=r"at star \d: expected the same place"):
        all_stars(path)


def test_an_unknown_series_must_tell_its_epoch(tmp_path: Path) -> None:
    def renumbered(name: str, old: bytes) -> Path:
        path = unpacked(tmp_path / "index", name) / name
        path.write_bytes(
            path.read_bytes().replace(b"INDEXID =                 " + old, b"INDEXID =                    9")
        )
        return path

    path = renumbered("index-5206-mag.fits", b"5206")
    with pytest.raises(BadCatalog, match="no known series"):
        all_stars(path)
    reader, stars = all_stars(renumbered("index-5006-16.fits", b"5006"))
    assert reader.epoch_yr == 2015.5
    assert stars.ra_deg.size > 90


def test_what_is_no_index_file_is_refused(tmp_path: Path) -> None:
    Table({"ra": [1.0]}).write(tmp_path / "table.fits")
    with pytest.raises(BadCatalog, match="no star tree"):
        open_reader("astrometry-net", tmp_path / "table.fits")
    with pytest.raises(BadCatalog, match="no index file"):
        open_reader("astrometry-net", tmp_path)
    (tmp_path / "text.fits").write_text("nothing of the kind")
    with pytest.raises(BadCatalog, match="at byte 0: expected a FITS file"):
        open_reader("astrometry-net", tmp_path / "text.fits")


@given(order=st.integers(0, 5), data=st.data())
def test_pixel_numbers_are_brought_to_nested(order: int, data: st.DataObject) -> None:
    nside = 2**order
    base, x, y = (data.draw(st.integers(0, top)) for top in (11, nside - 1, nside - 1))
    bits = sum((x >> b & 1) << 2 * b | (y >> b & 1) << 2 * b + 1 for b in range(6))
    assert nested_pixel((base * nside + x) * nside + y, nside) == base * nside**2 + bits


@pytest.mark.long
@pytest.mark.skipif(not FINEST.exists(), reason="it comes with astrometry-data-tycho2-07-littleendian")
def test_debians_index_files_are_tycho_2() -> None:
    reader = open_reader("astrometry-net", DEBIAN)
    parts = reader.parts()
    assert [part.name for part in parts] == [FINEST.name]
    assert (reader.band, reader.epoch_yr, reader.color_name) == ("VT", 2000.0, "")
    chunk = next(iter(reader.read(Part(parts[0].name, parts[0].path, 0))))
    assert chunk.flags is not None
    assert np.all(chunk.flags == StarFlag.NO_PROPER_MOTION)
    some = np.linspace(0, chunk.ra_deg.size - 1, 400).astype(int)
    distances, deviations = [], []
    for row in some:
        near = embedded_catalog().cone(
            Icrs(float(chunk.ra_deg[row]), float(chunk.dec_deg[row])), 1 / 3600, epoch_yr=2000.0
        )
        here = unit_vectors(chunk.ra_deg[row], chunk.dec_deg[row])
        away = np.sqrt(((unit_vectors(near.ra_deg, near.dec_deg).T - here) ** 2).sum(axis=1))
        if away.size:
            distances.append(np.degrees(away.min()) * 3600)
            deviations.append(chunk.mag[row] - near.mag[away.argmin()])
    assert len(distances) > 390  # the others moved much since 1991 and have no motion in Tycho-2
    assert np.median(distances) < 0.015  # what 32-bit floating-point degrees leave
    assert 0.0 < np.median(deviations) < 0.12  # VT - V
    guessed = IndexFile(parts[0].path).stand_in_mags(0, chunk.ra_deg.size)  # no bogus star in this chunk
    off = np.abs(guessed[: chunk.mag.size] - chunk.mag)
    assert np.median(off) < 1.0
    assert not np.any((chunk.ra_deg < 1e-6) & (np.abs(chunk.dec_deg) < 1e-6))
