"""UCAC4 against the catalog's own dump, against CDS's printed sample, and against damage of every kind."""

from __future__ import annotations

import math
import shutil
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers import open_reader
from mountnav.catalog.readers.ucac4.reader import STARS_IN_ZONE, Ucac4Reader, open_catalog
from mountnav.catalog.readers.ucac4.record import FAST_STARS, RECORD, Ucac4Stars, decoded
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog
from tests.catalog.readers.ucac4_files import Printed, printed_stars, record, write_zone
from tests.present import present


@pytest.fixture(scope="module")
def zone_1(shared: Path) -> Path:
    return shared / "data" / "catalogs" / "z001"


@pytest.fixture(scope="module")
def printed(shared: Path) -> list[Printed]:
    return printed_stars(shared / "data" / "catalogs" / "UCAC4_sample.txt")


def read_one(path: Path, counts: dict[int, int] | None = None) -> CatalogColumns:
    """All stars of the one zone file `path`."""
    zone = int(path.name[1:])
    listed = list(STARS_IN_ZONE)
    for number, count in (counts or {}).items():
        listed[number - 1] = count
    reader = Ucac4Reader({zone: path}, counts=listed)
    (part,) = reader.parts()
    (columns,) = reader.read(part)
    return columns


def of(*stars: Mapping[str, Any]) -> Ucac4Stars:
    return decoded(np.frombuffer(b"".join(record(**star) for star in stars), dtype=RECORD))


def columns_from(folder: Path, *stars: Mapping[str, Any], zone: int = 1) -> CatalogColumns:
    path = write_zone(folder, zone, [{"ra": 1000 + n, **star} for n, star in enumerate(stars)])
    return read_one(path, {zone: len(stars)})


# ---- the catalog's own dump


def test_all_fields_of_all_stars_are_those_of_the_catalogs_own_dump(zone_1: Path, shared: Path) -> None:
    text = (shared / "data" / "catalogs" / "z001.asc").read_text("ascii")
    dump = np.array([[int(v) for v in line.split(",")] for line in text.splitlines()])
    assert dump.shape == (206, 53)
    stars = decoded(np.fromfile(zone_1, dtype=RECORD))

    def mmag(values: np.ndarray) -> np.ndarray:
        return np.where(np.isnan(values), 20000, np.rint(values * 1000))

    def hundredths(values: np.ndarray) -> np.ndarray:
        return np.where(np.isnan(values), 99, np.rint(values * 100))

    digits = stars.matches[:, None] // 10 ** np.arange(8, -1, -1) % 10
    ours = np.column_stack(
        [
            np.rint(stars.ra_deg * 3.6e6),
            np.rint((stars.dec_deg + 90) * 3.6e6),
            mmag(stars.fit_mag),
            mmag(stars.aperture_mag),
            hundredths(stars.mag_sigma),
            stars.object_type,
            stars.double,
            stars.sigma_ra_mas,
            stars.sigma_dec_mas,
            stars.images,
            stars.images_used,
            stars.catalogs,
            np.rint((stars.epoch_ra_yr - 1900) * 100),
            np.rint((stars.epoch_dec_yr - 1900) * 100),
            np.rint(np.nan_to_num(stars.pm_ra_cosdec_mas_yr) * 10),
            np.rint(np.nan_to_num(stars.pm_dec_mas_yr) * 10),
            np.rint(stars.sigma_pm_ra_mas_yr * 10),
            np.rint(stars.sigma_pm_dec_mas_yr * 10),
            stars.twomass_key,
            mmag(stars.jhk_mag),
            stars.jhk_flags,
            hundredths(stars.jhk_sigma),
            mmag(stars.apass_mag),
            hundredths(stars.apass_sigma),
            stars.yale,
            digits,
            stars.leda,
            stars.twomass_extended,
            stars.star_id,
            stars.ucac2_zone,
            stars.ucac2_number,
        ]
    )
    star, field = np.nonzero(ours != dump)
    # the one known difference: the Yale flag of one star, 14 in the file and 4 in the dump
    assert list(zip(star.tolist(), field.tolist(), strict=True)) == [(106, 38)]
    assert (ours[106, 38], dump[106, 38]) == (14, 4)


def test_zone_1_as_it_is_imported(zone_1: Path) -> None:
    columns = read_one(zone_1)
    assert columns.ra_deg.size == 206
    flags = Counter(int(f) for f in present(columns.flags))
    assert sum(n for f, n in flags.items() if f & StarFlag.NO_PROPER_MOTION) == 5
    assert np.array_equal(
        np.isnan(columns.pm_dec_mas_yr), (present(columns.flags) & int(StarFlag.NO_PROPER_MOTION)) > 0
    )
    # two unconfirmed fast stars, and three that 2MASS doesn't know, one of them among the two
    assert sum(n for f, n in flags.items() if f & StarFlag.DOUBTFUL) == 4
    assert sum(n for f, n in flags.items() if f & StarFlag.DOUBLE) == 6
    # the colors of Tycho's stars, brought to Johnson's system
    assert np.isfinite(present(columns.color_mag)).sum() == 9
    assert present(columns.color_mag)[2] == pytest.approx(0.85 * (13.182 - 10.986))


# ---- CDS's sample: what the numbers mean, by somebody else


@pytest.fixture(scope="module")
def sample(printed: list[Printed]) -> list[tuple[Printed, int]]:
    """Each printed star and its row in what is read back from zone files made of the sample."""
    in_order = sorted(printed, key=lambda star: (star.zone, star.ra_deg))
    return [(star, row) for row, star in enumerate(in_order)]


@pytest.fixture(scope="module")
def read_back(printed: list[Printed], tmp_path_factory: pytest.TempPathFactory) -> CatalogColumns:
    folder = tmp_path_factory.mktemp("sample")
    counts = Counter(star.zone for star in printed)
    parts = []
    for zone in sorted(counts):
        stars = [star.in_file_units() for star in printed if star.zone == zone]
        parts.append(read_one(write_zone(folder, zone, stars), counts))
    return CatalogColumns(
        *(np.concatenate([getattr(p, f) for p in parts]) for f in CatalogColumns.__dataclass_fields__)
    )


def test_places_and_motions_are_those_that_cds_prints(
    sample: list[tuple[Printed, int]], read_back: CatalogColumns
) -> None:
    assert len(sample) == 1000
    for star, row in sample:
        assert read_back.ra_deg[row] == pytest.approx(star.ra_deg, abs=1.5e-7)
        assert read_back.dec_deg[row] == pytest.approx(star.dec_deg, abs=1.5e-7)
        moves = read_back.pm_ra_cosdec_mas_yr[row], read_back.pm_dec_mas_yr[row]
        # two stars are printed with a motion of "+.0 +.0" and an error of 50.0: the code for "no data"
        if math.isnan(star.motion[2]) or star.motion == (0.0, 0.0, 50.0, 50.0):
            assert np.isnan(moves).all()
        else:
            assert moves == pytest.approx(star.motion[:2])


def test_errors_at_2000_are_those_that_cds_prints(
    sample: list[tuple[Printed, int]], read_back: CatalogColumns
) -> None:
    # its column "mas" is the error of the place at J2000: both coordinates, from the central epochs and with
    # the errors of the motion; without a motion it takes 50 mas/yr
    told = np.array([star.sigma_2000_mas for star, _ in sample])
    ours = np.sqrt(2.0 * read_back.error_curve[[row for _, row in sample], 0])
    # printed whole, and cut off rather than rounded, of each coordinate too as it seems
    assert (ours - told).min() > -0.6
    assert (ours - told).max() < 2.0
    assert np.median(ours / told) == pytest.approx(1.0, abs=0.01)


def test_sigma_grows_with_the_years_even_without_a_proper_motion(read_back: CatalogColumns) -> None:
    c0, c1, c2 = read_back.error_curve.T
    sigma = {year: np.sqrt(c0 + c1 * (year - 2000.0) + c2 * (year - 2000.0) ** 2) for year in (2004, 2026.9)}
    assert (sigma[2026.9] > sigma[2004]).all()
    still = np.isnan(read_back.pm_dec_mas_yr)
    assert still.sum() == 21
    assert (sigma[2026.9][still] > 1100.0).all()


def test_the_last_stars_that_cds_prints_are_the_last_of_their_zones(printed: list[Printed]) -> None:
    last = {zone: max(s.number for s in printed if s.zone == zone) for zone in range(448, 455)}
    assert last == {zone: STARS_IN_ZONE[zone - 1] for zone in last}
    assert all(star.number <= STARS_IN_ZONE[star.zone - 1] for star in printed)
    assert (len(STARS_IN_ZONE), sum(STARS_IN_ZONE), STARS_IN_ZONE[0]) == (900, 113_780_093, 206)


def test_magnitudes_are_of_one_band(sample: list[tuple[Printed, int]], read_back: CatalogColumns) -> None:
    # against APASS r and color, which had no part in them
    r = np.array([star.apass_mag[3] for star, _ in sample])
    bad = int(StarFlag.NO_MAGNITUDE | StarFlag.OTHER_BAND | StarFlag.DOUBLE | StarFlag.DOUBTFUL)
    good = (present(read_back.flags) & bad == 0) & np.isfinite(r - present(read_back.color_mag))
    good &= (read_back.mag > 12) & (read_back.mag < 14)
    assert good.sum() > 140
    left = (read_back.mag - r)[good]
    line = np.polyfit(present(read_back.color_mag)[good], left, 1)
    assert np.std(left - np.polyval(line, present(read_back.color_mag)[good])) < 0.05
    assert np.median(left) == pytest.approx(0.13, abs=0.03)


def test_overexposed_stars_are_not_for_photometry(
    sample: list[tuple[Printed, int]], read_back: CatalogColumns
) -> None:
    burnt = [row for star, row in sample if star.images[1] == 0 and star.aperture_mag < 10]
    assert len(burnt) == 3
    assert (present(read_back.flags)[burnt] & int(StarFlag.OTHER_BAND)).all()
    # the images make them up to 0.9 mag too bright
    v = np.array([star.apass_mag[1] for star, row in sample if row in burnt])
    assert np.abs(read_back.mag[burnt] - v).max() < 0.35


# ---- single cases


def test_a_motion_of_zero_is_a_motion_if_it_has_an_error(tmp_path: Path) -> None:
    still, none = ({"pm_ra": 0, "pm_dec": 0, "sigma_pm_ra": s, "sigma_pm_dec": s} for s in (20, 255))
    columns = columns_from(tmp_path, still, none | {"object_type": 5})
    assert columns.pm_dec_mas_yr[0] == 0.0
    assert math.isnan(columns.pm_dec_mas_yr[1])
    assert present(columns.flags).tolist() == [0, int(StarFlag.NO_PROPER_MOTION)]


@pytest.mark.parametrize(
    ("code", "mas_yr"), [(250, 25.0), (251, 27.5), (252, 32.5), (253, 37.5), (254, 45.0)]
)
def test_codes_of_large_errors(code: int, mas_yr: float) -> None:
    stars = of({"sigma_pm_ra": code, "sigma_pm_dec": 1})
    assert stars.sigma_pm_ra_mas_yr[0] == pytest.approx(mas_yr)
    assert stars.sigma_pm_dec_mas_yr[0] == pytest.approx(0.1)


def test_the_fastest_stars_have_the_motion_of_the_table(tmp_path: Path) -> None:
    # Barnard's star, and a star that the table doesn't know
    barnard = {"pm_ra": -7986, "pm_dec": 32767, "star_id": 201050}
    unknown = {"pm_ra": 32767, "pm_dec": 0, "star_id": 5}
    columns = columns_from(tmp_path, barnard, unknown)
    assert columns.pm_ra_cosdec_mas_yr[0] == pytest.approx(-798.6)
    assert columns.pm_dec_mas_yr[0] == pytest.approx(10328.1)
    assert math.isnan(columns.pm_ra_cosdec_mas_yr[1])
    assert present(columns.flags)[1] & StarFlag.NO_PROPER_MOTION
    # a sigma that tells: 25 years on it may be anywhere within minutes of arc
    assert np.sqrt(columns.error_curve[1] @ [1.0, 25.0, 625.0]) > 75_000
    assert len(FAST_STARS) == 25
    assert all(max(abs(a), abs(b)) > 32766 for a, b in FAST_STARS.values())


@pytest.mark.parametrize(
    ("changed", "flags"),
    [
        ({}, 0),
        ({"twomass_key": 0}, StarFlag.DOUBTFUL),
        ({"twomass_key": 0, "matches": 300_000_000}, 0),
        ({"object_type": 2}, StarFlag.DOUBTFUL),
        ({"object_type": 8}, StarFlag.DOUBTFUL),
        ({"object_type": 9}, StarFlag.DOUBTFUL),
        ({"object_type": 3}, 0),
        ({"double": 34}, StarFlag.DOUBLE),
        ({"leda": 2}, StarFlag.EXTENDED),
        ({"twomass_extended": 9}, StarFlag.EXTENDED),
        ({"yale": 14}, StarFlag.EXTENDED),
        ({"yale": 34}, 0),
        ({"object_type": 1}, StarFlag.OTHER_BAND),
        ({"aperture_mag": 20000}, StarFlag.STAND_IN),
        ({"aperture_mag": 20000, "fit_mag": 20000}, StarFlag.OTHER_BAND),
        (
            {
                "aperture_mag": 20000,
                "fit_mag": 20000,
                "jhk_mag": (20000,) * 3,
                "apass_mag": (20000,) * 5,
                "apass_sigma": (99,) * 5,
            },
            StarFlag.NO_MAGNITUDE,
        ),
    ],
)
def test_warnings(tmp_path: Path, changed: dict[str, Any], flags: int) -> None:
    columns = columns_from(tmp_path, changed)
    assert present(columns.flags).tolist() == [int(flags)]
    assert 11.5 < columns.mag[0] < 12.5 or flags == StarFlag.NO_MAGNITUDE


def test_colors_are_of_one_system(tmp_path: Path) -> None:
    tycho = {"matches": 300_000_000, "apass_sigma": (99,) * 5}
    mixed = {"matches": 300_000_000, "apass_sigma": (3, 99, 99, 99, 99)}
    columns = columns_from(tmp_path, {}, tycho, mixed, {"apass_sigma": (-30, 4, 2, 3, 5)})
    assert present(columns.color_mag)[0] == pytest.approx(0.7)
    assert present(columns.color_mag)[1] == pytest.approx(0.7 * 0.85)
    assert np.isnan(present(columns.color_mag)[2:]).all()


# ---- any values, written from the table of the format

mags = st.integers(-1500, 20000)
star = st.fixed_dictionaries(
    {
        "ra": st.integers(0, 1_295_999_999),
        "spd": st.integers(719_000_000 - 719_000_000 % 720_000, 719_279_999),
        "fit_mag": mags,
        "aperture_mag": mags,
        "mag_sigma": st.integers(0, 99),
        "object_type": st.integers(0, 9),
        "double": st.integers(0, 36),
        "sigma_ra": st.integers(1, 255),
        "sigma_dec": st.integers(1, 255),
        "images": st.integers(0, 255),
        "images_used": st.integers(0, 255),
        "catalogs": st.integers(0, 255),
        "epoch_ra": st.integers(0, 11000),
        "epoch_dec": st.integers(0, 11000),
        "pm_ra": st.integers(-32766, 32766),
        "pm_dec": st.integers(-32766, 32766),
        "sigma_pm_ra": st.integers(0, 250),
        "sigma_pm_dec": st.integers(0, 250),
        "twomass_key": st.integers(0, 2**32 - 1),
        "jhk_mag": st.tuples(mags, mags, mags),
        "apass_mag": st.tuples(mags, mags, mags, mags, mags),
        "apass_sigma": st.tuples(*[st.integers(-90, 99)] * 5),
        "yale": st.integers(0, 37),
        "matches": st.integers(0, 999_999_999),
        "leda": st.integers(0, 255),
        "star_id": st.integers(400_000, 2**32 - 1),
        "ucac2_zone": st.integers(0, 65535),
        "ucac2_number": st.integers(0, 2**32 - 1),
    }
)


@pytest.mark.long
@settings(deadline=None, max_examples=60)
@given(st.lists(star, min_size=1, max_size=6))
def test_what_is_written_is_read_back(
    tmp_path_factory: pytest.TempPathFactory, stars: list[dict[str, Any]]
) -> None:
    stars = sorted(stars, key=lambda s: s["ra"])
    zone = 719_000_000 // 720_000 + 1 - 99
    spd = [s["spd"] - 99 * 720_000 for s in stars]
    stars = [s | {"spd": value} for s, value in zip(stars, spd, strict=True)]
    path = write_zone(tmp_path_factory.mktemp("any"), zone, stars)
    columns = read_one(path, {zone: len(stars)})
    full = decoded(np.fromfile(path, dtype=RECORD))
    for n, s in enumerate(stars):
        assert columns.ra_deg[n] * 3.6e6 == pytest.approx(s["ra"], abs=1e-5)
        assert (columns.dec_deg[n] + 90) * 3.6e6 == pytest.approx(s["spd"], abs=1e-4)
        assert columns.pm_ra_cosdec_mas_yr[n] == pytest.approx(0.1 * s["pm_ra"])
        assert columns.pm_dec_mas_yr[n] == pytest.approx(0.1 * s["pm_dec"])
        t = 2020.0
        variance = 0.5 * sum(
            s[f"sigma_{c}"] ** 2 + (0.1 * s[f"sigma_pm_{c}"] * (t - 1900.0 - 0.01 * s[f"epoch_{c}"])) ** 2
            for c in ("ra", "dec")
        )
        assert columns.error_curve[n] @ [1.0, 20.0, 400.0] == pytest.approx(variance, rel=1e-9)
        for name in ("images", "images_used", "twomass_key", "yale", "matches", "star_id", "ucac2_number"):
            assert getattr(full, name)[n] == s[name]
        assert np.isfinite([columns.mag[n], *columns.error_curve[n]]).all()
        given_mags = [m for m in (s["aperture_mag"], s["fit_mag"]) if m < 20000]
        told = present(columns.flags)[n] & int(StarFlag.NO_MAGNITUDE | StarFlag.OTHER_BAND)
        if given_mags and not told:
            assert columns.mag[n] == pytest.approx(0.001 * given_mags[0])


# ---- damage


@pytest.mark.long
def test_every_truncation_is_refused(zone_1: Path, tmp_path: Path) -> None:
    cut = tmp_path / "z001"
    shutil.copy(zone_1, cut)
    cut.chmod(0o644)
    with cut.open("r+b") as file:
        for length in range(16068 - 1, -1, -1):
            file.truncate(length)
            with pytest.raises(BadCatalog) as refused:
                read_one(cut)
            offset = length // 78 * 78
            assert f"at byte {offset}:" in refused.value.what


def test_a_longer_file_is_refused(zone_1: Path, tmp_path: Path) -> None:
    longer = tmp_path / "z001"
    whole = zone_1.read_bytes()
    longer.write_bytes(whole + whole[-78:])
    with pytest.raises(BadCatalog, match="at byte 16068: expected 206 stars in zone 1, found 207"):
        read_one(longer)


@pytest.mark.long
@settings(deadline=None, max_examples=150)
@given(st.integers(0, 16067), st.integers(1, 255))
def test_a_changed_byte_never_crashes(
    shared: Path, tmp_path_factory: pytest.TempPathFactory, at: int, change: int
) -> None:
    damaged = bytearray((shared / "data" / "catalogs" / "z001").read_bytes())
    damaged[at] ^= change
    path = tmp_path_factory.mktemp("damaged") / "z001"
    path.write_bytes(damaged)
    try:
        columns = read_one(path)
        refused = False
    except BadCatalog:
        refused = True
    if refused:
        # only a place can be seen to be wrong; other bytes make other stars
        assert at % 78 < 8
        return
    assert columns.ra_deg.size == 206
    assert np.isfinite(columns.mag).all()
    assert (columns.error_curve[:, 0] > 0).all()
    assert (np.abs(columns.dec_deg) <= 90).all()


def test_swapped_bytes_are_named(tmp_path: Path, zone_1: Path) -> None:
    swapped = np.fromfile(zone_1, dtype=RECORD).byteswap()
    path = tmp_path / "z001"
    swapped.tofile(path)
    with pytest.raises(BadCatalog, match=r"at byte [04]: .*bytes are swapped") as refused:
        read_one(path)
    assert "swapped" in (refused.value.advice or "")


def test_another_zone_s_file_is_refused(tmp_path: Path, zone_1: Path) -> None:
    path = tmp_path / "z003"
    shutil.copy(zone_1, path)
    with pytest.raises(BadCatalog, match="at byte 4: expected a south polar distance of 1380000"):
        read_one(path, {3: 206})


def test_stars_out_of_order_are_refused(tmp_path: Path, zone_1: Path) -> None:
    records = np.fromfile(zone_1, dtype=RECORD)
    records[[7, 8]] = records[[8, 7]]
    path = tmp_path / "z001"
    records.tofile(path)
    with pytest.raises(BadCatalog, match=f"at byte {8 * 78}: .*the file is sorted"):
        read_one(path)


# ---- the folder


def test_zones_are_found_where_they_lie(tmp_path: Path, zone_1: Path) -> None:
    below = tmp_path / "disk" / "U4B"
    below.mkdir(parents=True)
    shutil.copy(zone_1, below / "Z001")
    (below / "readme_u4.txt").write_text("not a zone")
    for place in (tmp_path, tmp_path / "disk", below, below / "Z001"):
        reader = open_reader("ucac4", place)
        assert [(part.name, part.size_bytes) for part in reader.parts()] == [("z001", 16068)]
        assert "1 of 900 zone files (1)" in reader.made_from
        assert sum(chunk.ra_deg.size for part in reader.parts() for chunk in reader.read(part)) == 206
    assert (reader.name, reader.band, reader.color_name, reader.epoch_yr) == ("UCAC4", "UCAC", "B-V", 2000.0)


def test_missing_zones_are_told(tmp_path: Path) -> None:
    for zone in range(1, 901):
        if zone not in (5, 17, 18, 19):
            (tmp_path / f"z{zone:03d}").touch()
    assert "896 of 900 zone files (missing: 5, 17-19)" in open_catalog(tmp_path).made_from


def test_no_zones_and_zones_twice_are_refused(tmp_path: Path, zone_1: Path) -> None:
    (tmp_path / "z901").touch()
    with pytest.raises(BadCatalog, match="no zone files of UCAC4"):
        open_catalog(tmp_path)
    for side in ("one", "two"):
        (tmp_path / side).mkdir()
        shutil.copy(zone_1, tmp_path / side / "z001")
    with pytest.raises(BadCatalog, match="there twice"):
        open_catalog(tmp_path)


def test_each_zone_tells_its_declinations(shared):
    reader = open_catalog(shared / "data" / "catalogs" / "z001")
    part = reader.parts()[0]
    low, high = reader.dec_range_deg(part)
    stars = next(iter(reader.read(part)))
    assert (low, high) == (-90.0, -89.8)
    assert np.all((stars.dec_deg >= low) & (stars.dec_deg <= high))
