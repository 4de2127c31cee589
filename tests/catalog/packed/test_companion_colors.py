"""Colors beside a packed file: found by themselves, another file's refused, damage told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.companion_colors import write_companion
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.errors import BadCatalog
from mountnav.sky.coordinates import Icrs
from tests.catalog.packed.packing_version_1 import order_of_version_1, pack_version_1

COUNT = 300


def columns(seed: int) -> CatalogColumns:
    rng = np.random.default_rng(seed)
    e = np.full(COUNT, 30.0)
    color = rng.uniform(-0.9, 4.0, COUNT)
    color[:3] = np.nan, -1.5, 4.5
    return CatalogColumns(
        rng.uniform(0, 360, COUNT),
        rng.uniform(-90, 90, COUNT),
        e * 0,
        e * 0,
        0.01 * np.arange(COUNT, dtype=np.float64)[rng.permutation(COUNT)],
        error_curve((e, e), (e / 10, e / 10), (e + 1960, e + 1960)),
        color,
    )


@pytest.fixture
def colored(tmp_path: Path) -> Path:
    path, stars = tmp_path / "few.mnc", columns(1)
    header = pack_version_1(stars, path, name="few", band="V", epoch_yr=2000.0, nside=4)
    order, _ = order_of_version_1(stars, 4)
    assert stars.color_mag is not None
    write_companion(path, header, stars.color_mag[order], color_name="B-V", zero_mag=-1.0, step_mag=0.02)
    return path


def test_each_star_has_its_own_color(colored: Path) -> None:
    stars = PackedStore(colored).cone(Icrs(0, 0), 180, epoch_yr=2000.0)
    truth = columns(1)
    assert truth.color_mag is not None
    expected = truth.color_mag[np.argsort(truth.mag)]
    expected[(expected < -1.01) | (expected > 4.09)] = np.nan
    assert stars.color_name == "B-V"
    np.testing.assert_allclose(stars.color_mag, expected, atol=0.0101)
    assert np.isnan(stars.color_mag).sum() == 3
    PackedStore(colored).verify()


def test_colors_of_another_file_are_refused(colored: Path) -> None:
    pack_version_1(columns(2), colored, name="few", band="V", epoch_yr=2000.0, nside=4)
    with pytest.raises(BadCatalog, match="at byte 16: expected colors of the 300 stars"):
        PackedStore(colored)


def test_every_cut_is_refused(colored: Path) -> None:
    path = colored.with_suffix(".colors")
    content = path.read_bytes()
    for keep in [*range(0, 320, 7), len(content) - 1]:
        path.write_bytes(content[:keep])
        with pytest.raises(BadCatalog, match=r"few.colors: at byte \d+: expected .*, found "):
            PackedStore(colored)
    path.write_bytes(content + b"x")
    with pytest.raises(BadCatalog, match=f"at byte {len(content)}: expected {len(content)} bytes in all"):
        PackedStore(colored)


def test_a_flipped_bit_is_found(colored: Path) -> None:
    path = colored.with_suffix(".colors")
    content = path.read_bytes()
    for at in range(0, len(content), 3):
        flipped = bytearray(content)
        flipped[at] ^= 1 << at % 8
        path.write_bytes(flipped)
        if at < len(content) - COUNT:
            with pytest.raises(BadCatalog, match=r"few.colors: at byte \d+"):
                PackedStore(colored)
        else:
            store = PackedStore(colored)
            with pytest.raises(
                BadCatalog, match=f"at byte {len(content) - COUNT}: expected colors of sha256"
            ):
                store.verify()


def test_embedded_stars_have_the_colors_that_hipparcos_measured() -> None:
    # place, V and B-V in the Hipparcos catalog (ESA SP-1200)
    known = {
        "Rigel": (78.6345, -8.2016, 0.18, -0.03),
        "Aldebaran": (68.9802, 16.5093, 0.87, 1.538),
        "61 Cygni B": (316.7303, 38.7420, 5.95, 1.309),
        "HD 209458": (330.7949, 18.8843, 7.65, 0.594),
        "tau Ceti": (26.0170, -15.9375, 3.49, 0.727),
        "mu Cephei": (325.8769, 58.7800, 4.23, 2.242),
        "Barnard's star": (269.4521, 4.6934, 9.54, 1.570),
    }
    for name, (ra, dec, v, b_v) in known.items():
        stars = embedded_catalog().cone(Icrs(ra, dec), 30 / 3600, epoch_yr=2000.0)
        at = int(np.argmin(abs(stars.mag - v)))
        assert stars.color_mag[at] == pytest.approx(b_v, abs=0.16), name
    assert stars.color_name == "B-V"


def test_light_of_a_photocenter_pair_makes_its_color() -> None:
    # TYC 1-17-1 and 1-17-2: BT 11.318 VT 10.521 and BT 10.772 VT 10.093
    bt, vt = np.array([11.318, 10.772]), np.array([10.521, 10.093])
    v = vt - 0.09 * (bt - vt)
    b = v + 0.85 * (bt - vt)
    both = -2.5 * np.log10(np.sum(10 ** (-0.4 * np.array([b, v])), axis=1))
    stars = embedded_catalog().cone(Icrs(0.05059802, 1.77144349), 3 / 3600, epoch_yr=2000.0)
    assert stars.color_mag[0] == pytest.approx(both[0] - both[1], abs=0.011)


def test_nearly_all_embedded_stars_have_a_color() -> None:
    stars = embedded_catalog().cone(Icrs(120, 30), 20, epoch_yr=2026.9)
    assert np.isnan(stars.color_mag).mean() < 0.004
    assert 0.4 < np.nanmedian(stars.color_mag) < 0.8
