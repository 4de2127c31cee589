"""The erring catalog: errors of the stated size, fixed to the star, whoever asks for it."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from scipy import stats

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Stars
from mountnav.identification.accuracy import east_north_arcsec
from mountnav.simulation.catalog_errors import ErringCatalog
from mountnav.sky.coordinates import Icrs

YEAR = 2013.5


def errors(center: Icrs, radius_deg: float, epoch_yr: float = YEAR, **how) -> tuple[Stars, np.ndarray]:
    """Stars as in the catalog, and their errors in units of sigma, shape (2, n)."""
    stars = embedded_catalog().cone(center, radius_deg, epoch_yr=epoch_yr)
    true = ErringCatalog(embedded_catalog(), **how).displaced(stars)
    off = east_north_arcsec(true.ra_deg, true.dec_deg, stars.ra_deg, stars.dec_deg)
    return stars, np.vstack(off) / stars.sigma_arcsec


def test_errors_are_gaussian_of_the_stated_size() -> None:
    _, scaled = errors(Icrs(300.0, 35.0), 6.0, seed=4)
    east, north = scaled
    assert east.size > 10_000
    for one in (east, north):
        assert stats.kstest(one, "norm").pvalue > 0.001
    assert abs(np.corrcoef(east, north)[0, 1]) < 0.03
    # neighbors in brightness and neighbors on the sky have nothing in common
    assert abs(np.corrcoef(east[1:], east[:-1])[0, 1]) < 0.03


@pytest.mark.parametrize("center", [Icrs(40.0, 12.0), Icrs(0.05, -60.0), Icrs(200.0, 89.8)])
def test_an_error_belongs_to_the_star_in_every_cone(center: Icrs) -> None:
    sky = ErringCatalog(embedded_catalog(), seed=9)
    wide = sky.cone(center, 1.5, epoch_yr=YEAR)
    narrow = sky.cone(center, 0.7, epoch_yr=YEAR)
    places = set(zip(wide.ra_deg.tolist(), wide.dec_deg.tolist(), strict=True))
    assert len(narrow) > 20
    assert all(place in places for place in zip(narrow.ra_deg.tolist(), narrow.dec_deg.tolist(), strict=True))


def test_the_same_star_errs_alike_in_other_years() -> None:
    center = Icrs(150.0, -30.0)
    then, before = errors(center, 2.0, 1995.0, seed=2)
    now, after = errors(center, 2.0, 2026.0, seed=2)
    brightness = {mag: i for i, mag in enumerate(now.mag) if np.sum(now.mag == mag) == 1}
    both = [(i, brightness[mag]) for i, mag in enumerate(then.mag) if mag in brightness]
    first, second = (np.array(one) for one in zip(*both, strict=True))
    near = np.hypot(then.ra_deg[first] - now.ra_deg[second], then.dec_deg[first] - now.dec_deg[second]) < 0.01
    assert near.sum() > 100
    assert before[:, first[near]] == pytest.approx(after[:, second[near]], abs=1e-3)


def test_another_seed_is_another_sky_and_the_factor_stretches() -> None:
    center = Icrs(80.0, 20.0)
    _, one = errors(center, 2.0, seed=1)
    _, other = errors(center, 2.0, seed=2)
    _, twice = errors(center, 2.0, seed=1, factor=2.0)
    assert abs(np.corrcoef(one[0], other[0])[0, 1]) < 0.1
    assert twice == pytest.approx(2.0 * one, abs=1e-3)


def test_the_cone_is_cut_by_the_true_places_brightest_first() -> None:
    # errors of several arcseconds, so that a few stars cross the border each way
    center, radius_deg, crossed = Icrs(300.0, 35.0), 3.0, np.zeros(2, dtype=int)
    middle = SkyCoord(center.ra_deg, center.dec_deg, unit="deg")

    def inside(some: Stars) -> np.ndarray:
        near: np.ndarray = (
            middle.separation(SkyCoord(some.ra_deg, some.dec_deg, unit="deg")).deg <= radius_deg
        )
        return near

    nominal = embedded_catalog().cone(center, radius_deg + 0.1, epoch_yr=YEAR, mag_limit=11.0)
    for seed in range(16):
        sky = ErringCatalog(embedded_catalog(), seed=seed, factor=60.0)
        stars, true = sky.cone(center, radius_deg, epoch_yr=YEAR, mag_limit=11.0), sky.displaced(nominal)
        assert stars.ra_deg.tolist() == true.ra_deg[inside(true)].tolist()
        assert stars.mag.tolist() == sorted(stars.mag.tolist())
        assert "erring" in sky.name
        assert stars.source == sky.name
        was, now = inside(nominal), inside(true)
        crossed += (np.sum(now & ~was), np.sum(was & ~now))
    assert np.all(crossed > 0)
