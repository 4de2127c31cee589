"""The model of star counts against Tycho-2's own, the whole sky's, and the published formula."""

from __future__ import annotations

import timeit

import numpy as np
import pytest
from astropy.coordinates import SkyCoord

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.star_counts import density_deg2, galactic, mag_reaching
from mountnav.sky.coordinates import Icrs

SKY_DEG2 = 4.0 * np.pi * np.degrees(1.0) ** 2


def even_places(n: int, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    chance = np.random.default_rng(seed)
    return chance.uniform(0, 360, n), np.degrees(np.arcsin(chance.uniform(-1, 1, n)))


@pytest.fixture(scope="module")
def tycho():
    stars = embedded_catalog().cone(Icrs(0.0, 0.0), 180.0, epoch_yr=2000.0, mag_limit=11.5)
    return np.abs(galactic(stars.ra_deg, stars.dec_deg)[1]), stars.mag


def test_galactic_coordinates_are_those_of_astropy():
    ra, dec = even_places(200)
    ra, dec = np.append(ra, [0.0, 192.85948, 266.405]), np.append(dec, [90.0, 27.12825, -28.936])
    theirs = SkyCoord(ra, dec, unit="deg").galactic
    l_deg, b_deg = galactic(ra, dec)
    apart = SkyCoord(l_deg, b_deg, unit="deg", frame="galactic").separation(theirs)
    assert apart.arcsec.max() < 0.1
    assert ((l_deg >= 0) & (l_deg < 360)).all()


@pytest.mark.long
@pytest.mark.parametrize(("low", "high"), [(0, 5), (5, 10), (10, 20), (20, 30), (30, 45), (45, 60), (60, 90)])
@pytest.mark.parametrize("mag", [7.0, 9.0, 11.0, 11.5])
def test_in_every_belt_there_are_as_many_stars_as_tycho_has(tycho, low, high, mag):
    b_deg, mags = tycho
    ra, dec = even_places(60_000)
    latitude = np.abs(galactic(ra, dec)[1])
    inside = (latitude >= low) & (latitude < high)
    promised = density_deg2(ra[inside], dec[inside], mag).sum() / latitude.size * SKY_DEG2
    found = np.count_nonzero((b_deg >= low) & (b_deg < high) & (mags <= mag))
    assert promised / found == pytest.approx(1.0, abs=0.08)


# to V = 16.4 UCAC4 with Tycho-2, by its own magnitude between V and R [hnsky.org, star counts]; V < 18 from a
# polynomial of all-sky counts [NASA, Space Math], V < 20 between that and Gaia's
@pytest.mark.parametrize(
    ("mag", "stars", "off"),
    [(13.4, 7.35e6, 0.1), (14.4, 17.2e6, 0.1), (15.4, 39.4e6, 0.1), (16.4, 88.9e6, 0.1), (18.0, 236e6, 0.15),
     (20.0, 800e6, 0.2)],
)  # fmt: skip
def test_the_whole_sky_has_as_many_stars_as_the_deep_catalogs(mag, stars, off):
    ra, dec = even_places(40_000)
    assert density_deg2(ra, dec, mag).mean() * SKY_DEG2 / stars == pytest.approx(1.0, abs=off)


def test_far_from_the_plane_faint_stars_are_those_of_the_published_model():
    # equation B1 worked out by hand with its constants for b = 90° and V = 20
    disk = 925 * 10 ** (0.035 * 4.25) / (1 + 10 ** (-0.132 * 4.25)) ** 3
    spheroid = 1050 * 10 ** (0.087 * 2.5) / (1 + 10 ** (-0.18 * 2.5)) ** 2.5
    pole = SkyCoord(0, 90, unit="deg", frame="galactic").icrs
    assert density_deg2(pole.ra.deg, pole.dec.deg, 20.0) == pytest.approx(disk + spheroid, rel=1e-6)


def test_counts_rise_with_magnitude_everywhere():
    ra, dec = even_places(500)
    grid = np.arange(2.0, 22.01, 0.05)
    assert (np.diff(density_deg2(ra[:, None], dec[:, None], grid), axis=1) > 0).all()


def test_the_magnitude_that_reaches_a_density_has_that_density():
    ra, dec = even_places(300)
    for wanted in (3.0, 100.0, 1200.0):
        mag = mag_reaching(ra, dec, wanted)
        assert density_deg2(ra, dec, mag) == pytest.approx(wanted, rel=0.02)
    assert mag_reaching(10.0, 20.0, 1e9) == 22.0
    assert mag_reaching(10.0, 20.0, 1e-9) == 2.0
    assert mag_reaching(ra, dec, np.linspace(1, 1e4, 300)).shape == (300,)


def test_one_place_costs_less_than_a_cone_query():
    store = embedded_catalog()
    one = min(timeit.repeat(lambda: mag_reaching(10.0, 20.0, 1000.0), number=50, repeat=3))
    cone = min(timeit.repeat(lambda: store.cone(Icrs(10, 20), 1.0, epoch_yr=2026.9), number=50, repeat=3))
    assert one < 3 * cone
