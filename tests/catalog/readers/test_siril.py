"""Siril's Gaia catalog: records of the real file, round trips, and damage that is refused."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.importing.order import KnowsDeclinations
from mountnav.catalog.readers import open_reader
from mountnav.catalog.readers.siril import layout
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog
from mountnav.sky.coordinates import Icrs
from tests.catalog.readers.read_whole import read_all, sigma_mas
from tests.catalog.readers.siril_files import SCALE, Star, head, pixel_of, whole, write_whole

# pixel of level 8: RA, Dec, proper motions, temperature, G of its first star, as the makers' own test of
# siril_cat_healpix8_astro.dat prints them
REAL = {
    0: (44.996154906692055, 0.005615204575292396, 11, -4, 5052, 17.641),
    65000: (62.40505985096332, 85.26288984588481, 3, -15, 0, 10.158),
    175000: (182.20992992734998, 44.65138996236556, 27, -10, 3334, 18.325),
    205000: (303.43395997930037, 12.363286899571905, -7, -9, 5532, 14.23),
    265000: (353.3237599736656, -28.941506850040287, 10, -33, 4561, 18.794),
    285000: (31.999036870896365, -0.8845328543728835, 2, -18, 6046, 11.893),
    405000: (165.57631984612732, -16.62471386446837, -45, 13, 3314, 18.751),
    525000: (21.369869849351172, -83.7653999793182, 13, -3, 5512, 15.892),
    530000: (78.38390985428538, -67.1760899327584, 0, 0, 0, 15.728),
    590000: (112.5428848865176, -87.0739099975088, -3, 7, 4849, 16.265),
    700000: (189.13139996544055, -36.39301994647506, -24, -5, 6461, 10.498),
    755000: (295.17055998331426, -55.475886843854504, -15, -94, 0, 16.253),
    785000: (306.92391992869034, -9.877279964218511, -7, -22, 5514, 15.274),
}
stars = st.builds(
    Star,
    st.floats(0, 360, exclude_max=True),
    st.floats(-90, 90),
    st.integers(-10400, 10400),
    st.integers(-10400, 10400),
    st.integers(0, 65535),
    st.floats(0.001, 22.0),
)


def real_stars() -> list[Star]:
    # half a step up: the printed values are those of whole steps, and the writer cuts off
    return [
        Star(ra + 0.5 / SCALE, dec + np.copysign(0.5 / SCALE, dec), *rest)  # type: ignore[arg-type]
        for ra, dec, *rest in REAL.values()
    ]


def test_records_of_the_real_file_come_back_from_their_pixels(tmp_path: Path) -> None:
    path = write_whole(tmp_path / "siril_cat_healpix8_astro.dat", real_stars(), 8)
    reader = open_reader("siril", path)
    assert (reader.name, reader.band, reader.epoch_yr) == ("Siril Gaia DR3", "G", 2016.0)
    assert reader.color_name == ""
    read = read_all("siril", path)
    truth = np.array(list(REAL.values()))
    assert np.array_equal([pixel_of(Star(*row[:2]), 8) for row in truth], list(REAL))
    assert np.allclose(read.ra_deg, truth[:, 0], rtol=0, atol=1e-12)
    assert np.allclose(read.dec_deg, truth[:, 1], rtol=0, atol=1e-12)
    known = (truth[:, 2:4] != 0).any(axis=1)
    assert np.array_equal(read.pm_ra_cosdec_mas_yr[known], truth[known, 2])
    assert np.array_equal(read.pm_dec_mas_yr[known], truth[known, 3])
    assert np.all(np.isnan(read.pm_dec_mas_yr[~known]))
    assert np.array_equal(read.flags == StarFlag.NO_PROPER_MOTION, ~known)
    assert np.allclose(read.mag, truth[:, 5], rtol=0, atol=1e-9)


@pytest.mark.parametrize("pixel", [65000, 700000])
def test_real_records_stand_where_tycho_2_has_them_in_2016(pixel: int) -> None:
    ra, dec, pm_ra, pm_dec, _, mag = REAL[pixel]
    here = SkyCoord(ra, dec, unit="deg")
    apart = {}
    for year in (2000.0, 2016.0):
        near = embedded_catalog().cone(Icrs(ra, dec), 3 / 3600, epoch_yr=year)
        assert len(near) == 1
        apart[year] = here.separation(SkyCoord(near.ra_deg[0], near.dec_deg[0], unit="deg")).arcsec
    assert apart[2016.0] < 0.1 < 0.25 < apart[2000.0]
    assert near.pm_ra_cosdec_mas_yr[0] == pytest.approx(pm_ra, abs=1.5)
    assert near.pm_dec_mas_yr[0] == pytest.approx(pm_dec, abs=5)
    assert near.mag[0] == pytest.approx(mag, abs=0.3)


def test_real_coordinates_are_32_bit_floats_cut_off_so_sigma_says_so(tmp_path: Path) -> None:
    for ra, dec, *_ in REAL.values():
        for value in (ra, dec):
            nearest = np.float32(value + np.copysign(0.5 / SCALE, value))
            decimals = [float(str(np.nextafter(nearest, np.float32(way)))) for way in (-1e9, nearest, 1e9)]
            assert any(int(decimal * SCALE) == round(value * SCALE) for decimal in decimals)
    bright = [Star(ra, 0.0, 5, 5, 0, 12.0) for ra in (300.0, 150.0, 10.0)]
    write_whole(tmp_path / "a.dat", bright, 2)
    by_ra = sigma_mas(read_all("siril", tmp_path / "a.dat"), 2016.0)
    # 110 mas / sqrt(12) in RA beyond 256 degrees, half beyond 128, 4.1 at 10 with the cutting off
    expected = {300.0: 31.9 / np.sqrt(2), 150.0: 16.0 / np.sqrt(2), 10.0: 1.18 / np.sqrt(2)}
    order = [round(ra) for ra in read_all("siril", tmp_path / "a.dat").ra_deg]
    assert by_ra == pytest.approx([expected[ra] for ra in order], rel=0.02)


def test_sigma_grows_with_what_was_cut_off_the_proper_motion(tmp_path: Path) -> None:
    write_whole(tmp_path / "a.dat", [Star(10.0, 1.0, 5, 5, 0, 12.0), Star(11.0, 1.0, 0, 0, 0, 12.5)], 1)
    read = read_all("siril", tmp_path / "a.dat")
    grown = np.sqrt(sigma_mas(read, 2026.0) ** 2 - sigma_mas(read, 2016.0) ** 2)
    # 0.58 mas/yr; and where there may be none, as Tycho-2's stars of that magnitude move
    assert grown == pytest.approx([5.8, 105.0], rel=0.01)


def test_a_star_without_magnitude_is_faint_and_says_so(tmp_path: Path) -> None:
    write_whole(tmp_path / "a.dat", [Star(10.0, 1.0, 5, 5, 0, 0.0)], 1)
    read = read_all("siril", tmp_path / "a.dat")
    assert read.mag[0] == 21.0
    assert read.flags is not None
    assert read.flags[0] == StarFlag.NO_MAGNITUDE


@settings(max_examples=40, deadline=None)
@given(given_stars=st.lists(stars, min_size=1, max_size=40), level=st.integers(1, 4))
def test_every_star_comes_back(
    tmp_path_factory: pytest.TempPathFactory, given_stars: list[Star], level: int
) -> None:
    path = write_whole(tmp_path_factory.mktemp("round") / "a.dat", given_stars, level)
    read = read_all("siril", path)
    pm = np.nan_to_num([read.pm_ra_cosdec_mas_yr, read.pm_dec_mas_yr])
    got = zip(
        np.rint(read.ra_deg * SCALE).astype(int),
        np.rint(read.dec_deg * SCALE).astype(int),
        *pm.astype(int),
        np.rint(read.mag * 1000).astype(int),
        strict=True,
    )
    expected = []
    for star in given_stars:
        ra, dec, pm_ra, pm_dec, _, mag = star.raw()
        expected.append((ra, dec, pm_ra, pm_dec, mag or 21000))
    assert sorted(got) == sorted(expected)


def test_parts_go_through_the_pixels_once_and_are_the_same_at_every_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mountnav.catalog.readers.siril import reader as catalog

    monkeypatch.setattr(catalog, "_LARGEST_PART", 30)
    rng = np.random.default_rng(2)
    many = [
        Star(float(ra), float(np.degrees(np.arcsin(z))), 1, 1)
        for ra, z in zip(rng.uniform(0, 360, 500), rng.uniform(-1, 1, 500), strict=True)
    ]
    crowd = [Star(45.0 + x / 1000, 41.0, 2, 2) for x in range(70)]  # one pixel of more stars than a part has
    path = write_whole(tmp_path / "a.dat", many + crowd, 3)
    parts = open_reader("siril", path).parts()
    assert len(parts) == len({part.name for part in parts}) > 570 // 40
    assert sum(part.size_bytes for part in parts) == 570 * 16
    assert [part.name for part in open_reader("siril", path).parts()] == [part.name for part in parts]
    assert read_all("siril", path).mag.size == 570
    reader = open_reader("siril", path)
    assert isinstance(reader, KnowsDeclinations)
    narrowest = 180.0
    for part in parts:
        low, high = reader.dec_range_deg(part)
        narrowest = min(narrowest, high - low)
        assert all(np.all((chunk.dec_deg > low) & (chunk.dec_deg < high)) for chunk in reader.read(part))
    assert narrowest < 50.0


def test_chunks_make_one_catalog(tmp_path: Path) -> None:
    near = [Star(10.0, 3.0), Star(200.0, -60.0), Star(300.0, 70.0)]
    for star in near:
        chunk = (1, pixel_of(star, 1))
        (tmp_path / f"siril_cat1_healpix3_astro_{chunk[1]}.dat").write_bytes(whole([star], 3, chunk=chunk))
    reader = open_reader("siril", tmp_path)
    assert "3 stars in 3 of 48 chunks" in reader.made_from
    assert sorted(read_all("siril", tmp_path).ra_deg) == pytest.approx([10.0, 200.0, 300.0], abs=1e-6)
    (tmp_path / "again.dat").write_bytes(whole([near[0]], 3, chunk=(1, pixel_of(near[0], 1))))
    with pytest.raises(BadCatalog, match="don't belong to one catalog"):
        open_reader("siril", tmp_path)


def test_a_chunk_and_a_whole_file_do_not_belong_together(tmp_path: Path) -> None:
    star = Star(10.0, 3.0)
    write_whole(tmp_path / "a.dat", [star], 3)
    (tmp_path / "b.dat").write_bytes(whole([star], 3, chunk=(1, pixel_of(star, 1))))
    with pytest.raises(BadCatalog, match="don't belong to one catalog"):
        open_reader("siril", tmp_path)


def sound() -> bytes:
    rng = np.random.default_rng(7)
    return whole(
        [
            Star(float(ra), float(np.degrees(np.arcsin(z))), int(p), int(q), 5000, 15.5)
            for ra, z, p, q in zip(
                rng.uniform(0, 360, 40), rng.uniform(-1, 1, 40), *rng.integers(-30, 30, (2, 40)), strict=True
            )
        ],
        1,
    )


@pytest.mark.long
def test_every_cut_is_refused(tmp_path: Path) -> None:
    content = sound()
    path = tmp_path / "a.dat"
    path.write_bytes(content)
    assert read_all("siril", path).mag.size == 40
    for length in range(len(content)):
        path.write_bytes(content[:length])
        with pytest.raises(BadCatalog, match=rf"at byte {length}: expected"):
            read_all("siril", path)
    path.write_bytes(content + b"\0")
    with pytest.raises(BadCatalog, match=rf"at byte {len(content)}: expected 40 stars"):
        read_all("siril", path)


@pytest.mark.parametrize("width", [2, 4])
def test_swapped_bytes_are_refused(tmp_path: Path, width: int) -> None:
    content = sound()
    path = tmp_path / "a.dat"
    for start in (0, 128, 128 + 48 * 4):  # the whole file, index and stars, stars alone
        swapped = np.frombuffer(content[start:], dtype=f"u{width}").byteswap().tobytes()
        path.write_bytes(content[:start] + swapped)
        with pytest.raises(BadCatalog, match="at byte"):
            read_all("siril", path)


def test_an_index_that_goes_back_is_refused_at_its_offset(tmp_path: Path) -> None:
    content = bytearray(sound())
    struct.pack_into("<I", content, 128 + 4 * 20, 0)
    (tmp_path / "a.dat").write_bytes(bytes(content))
    with pytest.raises(BadCatalog, match=r"at byte 208: expected a count of at least \d+.*found 0"):
        read_all("siril", tmp_path / "a.dat")


def test_an_index_that_gives_a_star_to_the_next_pixel_but_one_is_refused(tmp_path: Path) -> None:
    content = bytearray(sound())
    counts = struct.unpack_from("<48I", content, 128)
    # all stars of the first pixels are said to lie at the other end of the sky
    struct.pack_into("<48I", content, 128, *([0] * 40), *counts[40:])
    (tmp_path / "a.dat").write_bytes(bytes(content))
    with pytest.raises(BadCatalog, match=r"at byte 320: expected a star of pixel 40"):
        read_all("siril", tmp_path / "a.dat")


@pytest.mark.parametrize(
    ("field", "form", "value", "expected"),
    [
        (0, "<i", -5, "a right ascension"),
        (4, "<i", int(91 * SCALE), "a declination"),
        (8, "<h", 15000, "a proper motion"),
        (10, "<h", -15000, "a proper motion"),
        (14, "<h", 30000, "a magnitude"),
        (14, "<h", -2500, "a magnitude"),
    ],
)
def test_numbers_out_of_range_are_refused_at_their_offset(
    tmp_path: Path, field: int, form: str, value: int, expected: str
) -> None:
    content = bytearray(sound())
    at = 128 + 4 * 48 + 16 * 7 + field
    struct.pack_into(form, content, at, value)
    (tmp_path / "a.dat").write_bytes(bytes(content))
    with pytest.raises(BadCatalog, match=f"at byte {at}: expected {expected}.*found {value}"):
        read_all("siril", tmp_path / "a.dat")


@pytest.mark.parametrize(
    ("at", "value", "expected"),
    [
        (3, 0xA5, "readable title"),
        (48, 8, "release of Gaia"),
        (49, 0, "HEALPix level"),
        (49, 165, "HEALPix level"),
        (50, 4, "kind of catalog"),
        (51, 7, r"0 \(whole sky\) or 1"),
    ],
)
def test_a_head_that_is_none_is_refused(tmp_path: Path, at: int, value: int, expected: str) -> None:
    content = bytearray(sound())
    content[at] = value
    (tmp_path / "a.dat").write_bytes(bytes(content))
    with pytest.raises(BadCatalog, match=f"at byte {at}: expected .*{expected}"):
        read_all("siril", tmp_path / "a.dat")


def test_chunks_that_contradict_themselves_are_refused(tmp_path: Path) -> None:
    good = whole([Star(10.0, 3.0)], 3, chunk=(1, pixel_of(Star(10.0, 3.0), 1)))
    wrong = {52: "a level of at most 3", 53: "a pixel below 48", 57: "first pixel", 61: "last pixel"}
    for at, expected in wrong.items():
        content = bytearray(good)
        content[at] ^= 0x40
        (tmp_path / "a.dat").write_bytes(bytes(content))
        with pytest.raises(BadCatalog, match=f"at byte {at}: expected .*{expected}"):
            read_all("siril", tmp_path / "a.dat")


@pytest.mark.parametrize(("kind", "what"), [(2, "sampled spectra"), (3, "continuous spectra")])
def test_spectra_are_refused_with_advice(tmp_path: Path, kind: int, what: str) -> None:
    path = tmp_path / "siril_cat1_healpix8_xpsamp_14.dat"
    path.write_bytes(head(8, kind=kind, chunk=(1, 14)) + bytes(1000))
    for given_path in (path, tmp_path):
        with pytest.raises(BadCatalog, match=f"{what}.*siril_cat_healpix8_astro.dat"):
            open_reader("siril", given_path)


def test_a_packed_file_is_to_be_unpacked_first(tmp_path: Path) -> None:
    path = tmp_path / "siril_cat_healpix8_astro.dat.bz2"
    path.write_bytes(b"BZh91AY&SY" + bytes(200))
    for given_path in (path, tmp_path):
        with pytest.raises(BadCatalog, match=r"bunzip2 --keep siril_cat_healpix8_astro\.dat\.bz2"):
            open_reader("siril", given_path)


def test_a_folder_without_any_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadCatalog, match="no file of Siril's"):
        open_reader("siril", tmp_path)


def test_the_size_of_the_file_that_is_distributed_is_as_the_layout_says() -> None:
    stars_in_it, rest = divmod(1_521_132_640 - 128 - 12 * 4**8 * layout.COUNT.itemsize, layout.STAR.itemsize)
    assert rest == 0
    assert 127 * 12 * 4**8 > stars_in_it > 90_000_000  # at most 127 to a pixel


@pytest.mark.long
@settings(max_examples=150, deadline=None)
@given(at=st.integers(0, 128 + 48 * 4 + 40 * 16 - 1), value=st.integers(0, 255))
def test_a_changed_byte_is_refused_or_changes_one_star(
    tmp_path_factory: pytest.TempPathFactory, at: int, value: int
) -> None:
    path = tmp_path_factory.mktemp("changed") / "a.dat"
    content = bytearray(sound())
    path.write_bytes(bytes(content))
    before = read_all("siril", path)
    content[at] = value
    path.write_bytes(bytes(content))
    try:
        after = read_all("siril", path)
    except BadCatalog as error:
        told = re.search(r"at byte (\d+)|catalog of .* spectra", str(error))
        assert told
        assert told[1] is None or int(told[1]) <= len(content)
        return
    same = (after.ra_deg == before.ra_deg) & (after.dec_deg == before.dec_deg) & (after.mag == before.mag)
    assert np.count_nonzero(~same) <= 1
