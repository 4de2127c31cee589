"""ASTAP's star databases: real bytes from the author's notes, round trips, and damage that is refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.importing.order import KnowsDeclinations
from mountnav.catalog.readers import open_reader
from mountnav.catalog.readers.astap.layout import all_labels, area_of
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog
from mountnav.sky.coordinates import Icrs
from tests.catalog.readers.astap_files import (
    CELLS_290,
    CELLS_1476,
    D50_TEXT,
    V50_TEXT,
    Star,
    body,
    head,
    label,
    raw_place,
    write_areas,
)
from tests.catalog.readers.read_whole import read_all, sigma_mas

# the beginning of g17_1801.290 and its text as documented in HNSKY's hns_U290.pas: Polaris and delta UMi
G17_POLE = bytes(
    [255, 255, 255, 254, 38, 248, 251, 26, 19, 244, 255, 255, 255, 251, 60, 188, 15, 187, 74, 37]
)
SIZES = (5, 6, 7, 9, 10, 11)
places = st.tuples(
    st.floats(0, 360, exclude_max=True), st.floats(-90, 90), st.integers(-16, 230), st.integers(-127, 127)
)


def test_real_bytes_of_the_polar_file_are_polaris_and_delta_ursae_minoris(tmp_path: Path) -> None:
    (tmp_path / "g17_1801.290").write_bytes(head("GAIA DR2, Epoch=2022. Magnitude is BP", 5) + G17_POLE)
    stars = read_all("astap", tmp_path)
    # as computed in the notes, in radians
    assert np.radians(stars.ra_deg) == pytest.approx([0.66229324858915306, 4.5911793053194119], abs=1e-14)
    assert np.radians(stars.dec_deg[0]) == pytest.approx(1.5579529812355912, abs=1e-14)
    assert list(stars.mag) == [2.2, 4.4]
    # delta UMi moves 55 mas/yr: its place is Tycho-2's of about 2022, and neither that of 2000 nor of 2016
    found = SkyCoord(stars.ra_deg[1], stars.dec_deg[1], unit="deg")
    apart = {}
    for year in (2000.0, 2016.0, 2022.0):
        near = embedded_catalog().cone(Icrs(found.ra.deg, found.dec.deg), 5 / 3600, epoch_yr=year)
        assert len(near) == 1
        apart[year] = found.separation(SkyCoord(near.ra_deg[0], near.dec_deg[0], unit="deg")).arcsec
    assert apart[2022.0] < 0.05
    assert apart[2016.0] > 0.3
    assert apart[2000.0] > 1.1


def test_the_documented_bytes_of_sirius_are_sirius(tmp_path: Path) -> None:
    # C3 06 48, D7 39 E8 in ASTAP's comments, an old database of J2000; here with the mark they would have
    records = bytes([255, 255, 255, 0xE8 ^ 0x80, 6, 0xC3, 0x06, 0x48, 0xD7, 0x39])
    (tmp_path / f"g17_{label(101.287, -16.716, 290)}.290").write_bytes(head("Epoch=2000", 5) + records)
    stars = read_all("astap", tmp_path)
    near = embedded_catalog().cone(Icrs(101.287155, -16.716116), 5 / 3600, epoch_yr=2000.0)
    found = SkyCoord(stars.ra_deg[0], stars.dec_deg[0], unit="deg")
    assert found.separation(SkyCoord(near.ra_deg[0], near.dec_deg[0], unit="deg")).arcsec < 0.1
    assert stars.mag[0] == -1.0


def test_the_first_star_of_gaia_is_in_the_file_its_author_says() -> None:
    # a comment in the program that makes the databases: "will be stored in file 1909.1476"
    assert label(44.99615537864534, 0.005615226341865997, 1476) == "1909"
    area = area_of(Path("d50_1909.1476"))
    assert area is not None
    assert not area.outside(np.array([44.99615537864534]), np.array([0.005615226341865997]), 0.0)[0]


@pytest.mark.parametrize(("areas", "cells"), [(290, CELLS_290), (1476, CELLS_1476)])
def test_the_areas_cover_the_sky_once(areas: int, cells: tuple[int, ...]) -> None:
    labels = all_labels(areas)
    assert len(labels) == len(set(labels)) == areas == sum(cells)
    rng = np.random.default_rng(1)
    ra, dec = rng.uniform(0, 360, 300), np.degrees(np.arcsin(rng.uniform(-1, 1, 300)))
    inside = np.zeros(300, dtype=int)
    for name in labels:
        area = area_of(Path(f"d50_{name}.{areas}"))
        assert area is not None
        within = ~area.outside(ra, dec, 0.0)
        inside += within
        assert all(label(ra[i], dec[i], areas) == name for i in np.flatnonzero(within))
    assert np.all(inside == 1)


def test_names_of_areas_that_do_not_exist_are_no_names() -> None:
    for name in (
        "d50_0102.1476",
        "d50_3701.1476",
        "d50_0001.290",
        "d50_0205.290",
        "d50_0101.001",
        "0101.290",
    ):
        assert area_of(Path(name)) is None


@pytest.mark.long
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("areas", [290, 1476])
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(given_stars=st.lists(places, min_size=1, max_size=30))
def test_every_star_comes_back(
    tmp_path_factory: pytest.TempPathFactory, size: int, areas: int, given_stars: list[tuple[Any, ...]]
) -> None:
    folder = tmp_path_factory.mktemp("round")
    stars = [Star(*values) for values in given_stars]
    write_areas(folder, stars, size=size, areas=areas)
    read = read_all("astap", folder)
    expected = sorted((*raw_place(star), star.tenths, star.color) for star in stars)
    color = np.zeros(read.mag.size) if read.color_mag is None else np.rint(read.color_mag * 10)
    got = sorted(
        zip(
            np.rint(read.ra_deg / 360.0 * 0xFFFFFF).astype(int),
            np.rint(read.dec_deg / 90.0 * 0x7FFFFF).astype(int),
            np.rint(read.mag * 10).astype(int),
            color.astype(int),
            strict=True,
        )
    )
    if size != 6:
        expected = [(*star[:3], 0) for star in expected]
    assert sorted(got) == sorted(expected)
    assert np.all(read.flags == StarFlag.NO_PROPER_MOTION)
    assert np.all(np.isnan(read.pm_ra_cosdec_mas_yr) & np.isnan(read.pm_dec_mas_yr))


def test_the_head_tells_epoch_band_and_color(tmp_path: Path) -> None:
    star = Star(10.0, 3.0, 100, 42)
    v17 = "GAIA eDR3, stars up to V magnitude 17.0, Epoch=2025. + 82 Tycho2 stars. Magnitude is V,"
    d05, d50 = D50_TEXT.replace("5000", "500"), D50_TEXT
    b_v = "GAIA DR3, Epoch=2025. Magnitude is V, B-V info included."
    red = "GAIA DR3, Epoch=2025. Magnitude transformed to Johnson-Cousins R."
    infrared = "GAIA DR3, Epoch=2025.5. Magnitude transformed to Cousins Ic."
    cases = [
        ("d50", d50, 5, None, 2025.0, "BP", ""),  # byte 108 is the P
        ("d05", d05, 5, None, 2025.0, "BP", ""),
        ("v50", V50_TEXT, 6, 1, 2025.0, "V", "BP-RP"),
        ("v50", b_v, 6, 2, 2025.0, "V", "B-V"),
        ("v17", v17, 6, 170, 2025.0, "V", "BP-RP"),
        ("r50", red, 5, None, 2025.0, "R", ""),
        ("i50", infrared, 5, None, 2025.5, "I", ""),
        ("g05", "Gaia DR3", 5, None, 2012.5, "BP", ""),
        ("g17", "The embedded catalog of mountnav", 5, None, 2012.5, "unknown", ""),
    ]
    for number, (database, text, size, version, epoch, band, color_name) in enumerate(cases):
        folder = tmp_path / str(number)
        folder.mkdir()
        write_areas(folder, [star], database=database, text=text, size=size, version=version)
        reader = open_reader("astap", folder)
        assert (reader.epoch_yr, reader.band, reader.color_name) == (epoch, band, color_name), text
        assert reader.name == f"ASTAP {database.upper()}"
        assert "1 of 1476 areas (missing: 0101, 0201, 0202, 0203, 0301, ...)" in reader.made_from
        assert ("gives no epoch" in reader.made_from) == (epoch == 2012.5)
        color = read_all("astap", folder).color_mag
        if color_name:
            assert color is not None
            assert color[0] == pytest.approx(42 / 50 if color_name == "B-V" else 4.2)
        else:
            assert color is None


def test_an_impossible_epoch_is_refused(tmp_path: Path) -> None:
    write_areas(tmp_path, [Star(10.0, 3.0, 100)], text=D50_TEXT.replace("2025", "7025"))
    with pytest.raises(BadCatalog, match="at byte 43: expected an epoch of 1950 to 2100, found 7025"):
        open_reader("astap", tmp_path)


def test_an_unknown_color_is_no_number(tmp_path: Path) -> None:
    write_areas(tmp_path, [Star(10.0, 3.0, 100, -128)], text=V50_TEXT, size=6, version=1)
    color = read_all("astap", tmp_path).color_mag
    assert color is not None
    assert np.isnan(color[0])


def test_sigma_is_the_rounding_at_the_epoch_and_grows_by_what_such_stars_move(tmp_path: Path) -> None:
    write_areas(tmp_path, [Star(10.0, 3.0, 95), Star(10.1, 3.0, 125)])
    stars = read_all("astap", tmp_path)
    assert sigma_mas(stars, 2025.0) == pytest.approx(np.sqrt((22.25**2 + 11.15**2) / 2), abs=0.2)
    # 68 % of the stars of magnitude 9.5 move less than 13.9 mas/yr in a coordinate, of 12.5 less than 10.5
    assert sigma_mas(stars, 2035.0) == pytest.approx(np.hypot([139.0, 105.0], 17.6), abs=0.5)


def test_an_untold_epoch_widens_sigma(tmp_path: Path) -> None:
    write_areas(tmp_path, [Star(10.0, 3.0, 95)], text="Gaia DR3")
    assert sigma_mas(read_all("astap", tmp_path), 2012.5) == pytest.approx(np.hypot(8 * 13.9, 17.6), abs=0.5)


def test_a_star_at_360_degrees_in_an_old_database_is_a_star(tmp_path: Path) -> None:
    # area 1120 of the 290: before 2021 some faint stars stood at 0xFFFFFF instead of 0 (HNSKY's own note)
    first = Star(359.9, 20.0, 160)
    _, dec = raw_place(Star(0.0, 20.0, 160))
    odd = b"\xff\xff\xff" + (dec & 0xFFFF).to_bytes(2, "little")
    assert odd[4] - 16 < 160
    path = tmp_path / f"g17_{label(359.9, 20.0, 290)}.290"
    path.write_bytes(head("Gaia DR2 Epoch=2022", 5) + body([first], 5) + odd)
    stars = read_all("astap", tmp_path)
    assert stars.ra_deg[1] == pytest.approx(360.0)
    assert stars.dec_deg[1] == pytest.approx(20.0, abs=2e-5)


def whole_file() -> bytes:
    rng = np.random.default_rng(3)
    uniform = rng.uniform(0, 1, (40, 3))
    stars = [Star(97.5 + 3 * x, 30.0 + 0.6 * y, 90 + int(60 * t)) for x, y, t in uniform]
    assert {label(star.ra_deg, star.dec_deg, 1476) for star in stars} == {NAME[4:8]}
    return head(D50_TEXT, 5) + body(stars, 5)


NAME = f"d50_{label(101.0, 30.2, 1476)}.1476"


@pytest.mark.long
def test_every_cut_that_can_be_seen_is_refused(tmp_path: Path) -> None:
    content = whole_file()
    path = tmp_path / NAME
    path.write_bytes(content)
    total = read_all("astap", tmp_path).mag.size
    seen_whole = 0
    for length in range(len(content)):
        path.write_bytes(content[:length])
        if length <= 110 or (length - 110) % 5 or content[length - 5 : length - 2] == b"\xff\xff\xff":
            with pytest.raises(BadCatalog, match="at byte"):
                read_all("astap", tmp_path)
        else:  # between two stars nothing tells that there were more
            assert read_all("astap", tmp_path).mag.size < total
            seen_whole += 1
    assert seen_whole == total - 1


def test_swapped_bytes_are_refused(tmp_path: Path) -> None:
    content = whole_file()
    for width in (2, 4):
        swapped = np.frombuffer(content[: len(content) // 4 * 4], dtype=f"u{width}").byteswap().tobytes()
        (tmp_path / NAME).write_bytes(swapped)
        with pytest.raises(BadCatalog, match="at byte"):
            read_all("astap", tmp_path)


def test_a_byte_lost_or_doubled_is_refused(tmp_path: Path) -> None:
    content = whole_file()
    path = tmp_path / NAME
    for at in range(110, len(content), 7):
        path.write_bytes(content[:at] + content[at + 1 :])
        with pytest.raises(BadCatalog, match="at byte"):
            read_all("astap", tmp_path)
        # five bytes lost in the middle keep the length sound: the places no longer are
        path.write_bytes(content[:at] + content[at + 2 :] + b"\0\0")
        with pytest.raises(BadCatalog, match="at byte"):
            read_all("astap", tmp_path)


@pytest.mark.parametrize("bit", range(8))
def test_a_flipped_bit_in_upper_byte_or_magnitude_is_refused_with_its_offset(
    tmp_path: Path, bit: int
) -> None:
    # two stars, two marks: 14.0 then 14.1; the declination's upper byte says some 0.7 degrees
    stars = [Star(101.0, 30.0, 140), Star(101.5, 30.4, 141)]
    content = bytearray(head(D50_TEXT, 5) + body(stars, 5))
    path = tmp_path / NAME
    content[113] ^= 1 << bit
    path.write_bytes(bytes(content))
    if bit >= 3:  # lesser ones may stay within the area
        with pytest.raises(BadCatalog, match=r"at byte 115: expected a star of area"):
            read_all("astap", tmp_path)


def test_a_magnitude_that_goes_back_is_refused(tmp_path: Path) -> None:
    content = head(D50_TEXT, 5) + body([Star(101.0, 30.0, 140)], 5) + body([Star(101.0, 30.1, 120)], 5)
    (tmp_path / NAME).write_bytes(content)
    with pytest.raises(
        BadCatalog, match=r"at byte 120: expected a magnitude not brighter than 14\.0.*found 12\.0"
    ):
        read_all("astap", tmp_path)


def test_a_star_outside_its_area_is_refused(tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(
        head(D50_TEXT, 5) + body([Star(101.0, 30.0, 140), Star(200.0, 30.0, 140)], 5)
    )
    with pytest.raises(
        BadCatalog, match=r"at byte 120: expected a star of area .*found RA 200\.0000, Dec 30\.0000"
    ):
        read_all("astap", tmp_path)


def test_a_renamed_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "d50_1909.1476").write_bytes(whole_file())
    with pytest.raises(BadCatalog, match="expected a star of area 1909"):
        read_all("astap", tmp_path)


@pytest.mark.parametrize(
    ("at", "value", "expected"),
    [
        (109, 8, "length of a record"),
        (109, 0xA6, "length of a record"),
        (5, 0x80, "readable text"),
        (110, 7, "a mark"),
    ],
)
def test_a_head_that_is_none_is_refused(tmp_path: Path, at: int, value: int, expected: str) -> None:
    content = bytearray(whole_file())
    content[at] = value
    (tmp_path / NAME).write_bytes(bytes(content))
    with pytest.raises(BadCatalog, match=f"at byte {at}: expected .*{expected}"):
        read_all("astap", tmp_path)


def test_two_databases_in_a_folder_are_refused_by_name(tmp_path: Path) -> None:
    write_areas(tmp_path, [Star(10.0, 3.0, 100)])
    write_areas(tmp_path, [Star(10.0, 3.0, 100)], database="g05", areas=290)
    with pytest.raises(BadCatalog, match=r"d50 \(\.1476\), g05 \(\.290\)"):
        open_reader("astap", tmp_path)
    # one file is one file
    assert len(open_reader("astap", tmp_path / f"d50_{label(10.0, 3.0, 1476)}.1476").parts()) == 1


def test_two_editions_in_a_folder_are_refused(tmp_path: Path) -> None:
    write_areas(tmp_path, [Star(10.0, 3.0, 100)])
    write_areas(tmp_path, [Star(100.0, 3.0, 100)], text=D50_TEXT.replace("2025", "2030"))
    with pytest.raises(BadCatalog, match="mixes two editions"):
        open_reader("astap", tmp_path)


def test_other_folders_are_refused_with_advice(tmp_path: Path) -> None:
    with pytest.raises(BadCatalog, match="no area files"):
        open_reader("astap", tmp_path)
    (tmp_path / "w08_0101.001").write_bytes(b"\0" * 200)
    with pytest.raises(BadCatalog, match="wide-field"):
        open_reader("astap", tmp_path)


def test_parts_are_the_files_south_to_north(tmp_path: Path) -> None:
    written = write_areas(
        tmp_path, [Star(float(x), float(y), 100) for x in range(0, 360, 40) for y in (-80, 0, 80)]
    )
    parts = open_reader("astap", tmp_path).parts()
    assert [part.name for part in parts] == [path.name for path in written]
    assert [part.size_bytes for part in parts] == [path.stat().st_size for path in written]


def test_parts_tell_their_declinations(tmp_path: Path) -> None:
    write_areas(tmp_path, [Star(10.0, -89.0, 100), Star(10.0, 3.0, 100), Star(20.0, 87.0, 100)])
    reader = open_reader("astap", tmp_path)
    assert isinstance(reader, KnowsDeclinations)
    for part in reader.parts():
        low, high = reader.dec_range_deg(part)
        assert high - low < 5.2
        assert all(np.all((chunk.dec_deg > low) & (chunk.dec_deg < high)) for chunk in reader.read(part))


@pytest.mark.long
@settings(max_examples=150, deadline=None)
@given(at=st.integers(0, 109 + 5 * 40), value=st.integers(0, 255))
def test_a_changed_byte_is_refused_or_moves_few_stars(
    tmp_path_factory: pytest.TempPathFactory, at: int, value: int
) -> None:
    folder = tmp_path_factory.mktemp("changed")
    content = bytearray(whole_file())
    (folder / NAME).write_bytes(bytes(content))
    before = read_all("astap", folder)
    content[at] = value
    (folder / NAME).write_bytes(bytes(content))
    try:
        after = read_all("astap", folder)
    except BadCatalog as error:
        told = re.search(r"at byte (\d+)", str(error))
        assert told
        assert int(told[1]) <= len(content)
        return
    # a mark more or less is a star less or more; then its neighbors' magnitudes and declinations are others
    assert abs(after.mag.size - before.mag.size) <= 1
    area = area_of(folder / NAME)
    assert area is not None
    assert not np.any(area.outside(after.ra_deg, after.dec_deg, 61 / 3600))
