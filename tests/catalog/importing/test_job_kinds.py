"""Each kind of catalog goes through an import, and every star of its files is found in the packed one."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from mountnav.catalog.credits import credit_of
from mountnav.catalog.importing.job import import_catalog
from mountnav.catalog.importing.order import ImportOrder, ImportProgress
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.readers import CATALOGS, open_reader
from mountnav.catalog.stars import StarFlag
from mountnav.sky.coordinates import Icrs
from tests.catalog.readers import astap_files, siril_files
from tests.catalog.readers.ucac4_zones import write_zones
from tests.conftest import shared_folder

STEP_ARCSEC = 1e-3


def ucac4(folder: Path) -> Path:
    return write_zones(folder, (1, 900))


def usno_b1(folder: Path) -> Path:
    sample = shared_folder() / "data" / "catalogs" / "usnob_b0000.cat"
    (folder / "b0000.cat").write_bytes(sample.read_bytes())
    return folder


def gaia(folder: Path) -> Path:
    """Two extracts that overlap by 40 stars."""
    rng, count = np.random.default_rng(3), 300
    table = Table(
        {
            "source_id": np.arange(1, count + 1) * 10_000,
            "ra": rng.uniform(0, 360, count),
            "dec": rng.uniform(-90, 90, count),
            "ref_epoch": np.full(count, 2016.0),
            "pmra": rng.normal(0, 20, count),
            "pmdec": rng.normal(0, 20, count),
            "ra_error": rng.uniform(0.02, 1, count),
            "dec_error": rng.uniform(0.02, 1, count),
            "pmra_error": rng.uniform(0.02, 1, count),
            "pmdec_error": rng.uniform(0.02, 1, count),
            "phot_g_mean_mag": rng.uniform(8, 20, count),
            "bp_rp": rng.uniform(0, 3, count),
        }
    )
    table[:170].write(folder / "north.csv", format="ascii.csv")
    table[130:].write(folder / "south.fits")
    return folder


def astrometry_net(folder: Path) -> Path:
    for name in ("index-5006-16.fits", "index-5006-17.fits"):
        packed = Path(__file__).parents[1] / "readers" / "index_files" / f"{name}.gz"
        (folder / name).write_bytes(gzip.decompress(packed.read_bytes()))
    return folder


def astap(folder: Path) -> Path:
    rng = np.random.default_rng(4)
    stars = [
        astap_files.Star(float(ra), float(dec), int(tenths))
        for ra, dec, tenths in zip(
            rng.uniform(0, 360, 200), rng.uniform(-90, 90, 200), rng.integers(60, 190, 200), strict=True
        )
    ]
    astap_files.write_areas(folder, stars)
    return folder


def siril(folder: Path) -> Path:
    rng = np.random.default_rng(5)
    stars = [
        siril_files.Star(float(ra), float(dec), int(motion), int(motion) - 3, 5000, float(mag))
        for ra, dec, motion, mag in zip(
            rng.uniform(0, 360, 200),
            rng.uniform(-89, 89, 200),
            rng.integers(4, 50, 200),
            rng.uniform(6, 18, 200).round(3),
            strict=True,
        )
    ]
    return siril_files.write_whole(folder / "siril_cat_healpix8_astro.dat", stars, 8)


def gaia_bright(folder: Path) -> Path:
    rng = np.random.default_rng(6)
    sides = (rng.uniform(0, 360, 100), rng.uniform(-89, 89, 100), rng.uniform(4, 9, 100))
    rows = [
        struct.pack("<qddfff", 10**9 + number, ra, dec, mag, mag + 0.3, mag - 0.4)
        for number, (ra, dec, mag) in enumerate(zip(*sides, strict=True))
    ]
    path = folder / "gaia_merged.bin"
    path.write_bytes(b"GDR3" + struct.pack("<IQ", 1, len(rows)) + b"".join(rows))
    return path


SOURCES: dict[str, Callable[[Path], Path]] = {
    "ucac4": ucac4,
    "usno-b1": usno_b1,
    "gaia": gaia,
    "gaia-bright": gaia_bright,
    "astrometry-net": astrometry_net,
    "astap": astap,
    "siril": siril,
}


MARKS = {"usno-b1": pytest.mark.shared, "gaia-bright": pytest.mark.long}
"""The last one holds all of Tycho-2."""


@pytest.mark.long
@pytest.mark.parametrize("kind", [pytest.param(one, marks=MARKS.get(one, ())) for one in CATALOGS])
def test_every_star_of_the_files_is_in_the_packed_one(
    kind: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if kind == "usno-b1":
        request.getfixturevalue("shared")
    folder = tmp_path / "source"
    folder.mkdir()
    source = SOURCES[kind](folder)
    imported = import_catalog(ImportOrder(kind, source, "one", tmp_path))
    store, reader = PackedStore(imported.path), open_reader(kind, source)
    assert store.header.name == reader.name
    assert store.header.band == reader.band
    assert store.header.epoch_yr == reader.epoch_yr
    assert store.color_name == reader.color_name
    assert credit_of(store.header.made_from) is CATALOGS[kind].credit
    count = 0
    for part in reader.parts():
        for stars in reader.read(part):
            count += stars.ra_deg.size
            for row in range(0, stars.ra_deg.size, 1 + stars.ra_deg.size // 40):
                place = Icrs(float(stars.ra_deg[row]) % 360.0, float(stars.dec_deg[row]))
                found = store.cone(place, STEP_ARCSEC / 3600.0, epoch_yr=reader.epoch_yr)
                near = np.flatnonzero(np.abs(found.mag - stars.mag[row]) < 0.0011)
                assert near.size, (kind, place)
                still = bool(found.flags[near[0]] & StarFlag.NO_PROPER_MOTION)
                assert still == bool(np.isnan(stars.pm_dec_mas_yr[row]))
                if stars.flags is not None:
                    kept = int(found.flags[near[0]]) & ~StarFlag.NO_PROPER_MOTION
                    assert kept == int(stars.flags[row]) & ~StarFlag.NO_PROPER_MOTION
    assert len(store) == count > 50


def test_every_kind_is_tried_here_and_has_a_credit() -> None:
    assert list(SOURCES) == list(CATALOGS)


def test_overlapping_extracts_give_no_star_twice_even_if_interrupted_between(tmp_path: Path) -> None:
    folder = tmp_path / "source"
    folder.mkdir()
    source = gaia(folder)
    whole = import_catalog(ImportOrder("gaia", source, "whole", tmp_path))
    assert whole.header.count == 300

    def interrupt(progress: ImportProgress) -> None:
        if progress.parts_done == 1:
            raise KeyboardInterrupt

    order = ImportOrder("gaia", source, "again", tmp_path)
    with pytest.raises(KeyboardInterrupt):
        import_catalog(order, tell=interrupt)
    again = import_catalog(order)
    assert again.resumed == 1
    assert again.path.read_bytes() == whole.path.read_bytes()
