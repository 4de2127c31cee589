"""The embedded Tycho-2 against facts from elsewhere: Hipparcos, the catalog's own counts, its raw lines."""

from __future__ import annotations

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time

from mountnav.catalog.embedded import embedded_catalog, verify_embedded
from mountnav.catalog.stars import Catalog
from mountnav.sky.coordinates import Icrs

# Hipparcos main catalog (ESA SP-1200), J1991.25: RA, Dec [deg], parallax [mas], pm RA*, pm Dec [mas/yr];
# radial velocity [km/s] from SIMBAD; tolerance [arcsec] at J2000 and 2026.9. Barnard's star: Tycho-2's proper
# motion in declination is 50 mas/yr below Hipparcos's, which makes 1.77 arcsec at 2026.9, and its approach,
# which Tycho-2 doesn't tell, adds 1.25 mas/yr² × (35.65 yr)² / 2 = 0.79 arcsec. It moves 278 arcsec.
HIPPARCOS = {
    "Barnard's star": ((269.45402305, 4.66828815, 549.01, -797.84, 10326.93, -110.5), (0.6, 2.7)),
    "Sirius": ((101.28854105, -16.71314306, 379.21, -546.01, -1223.08, -5.5), (0.02, 0.02)),
}


def from_hipparcos(values: tuple[float, ...], epoch_yr: float) -> SkyCoord:
    ra, dec, parallax, pm_ra, pm_dec, velocity = values
    start = SkyCoord(
        ra=ra * u.deg,
        dec=dec * u.deg,
        distance=1000.0 / parallax * u.pc,
        pm_ra_cosdec=pm_ra * u.mas / u.yr,
        pm_dec=pm_dec * u.mas / u.yr,
        radial_velocity=velocity * u.km / u.s,
        obstime=Time(1991.25, format="jyear"),
    )
    return start.apply_space_motion(new_obstime=Time(epoch_yr, format="jyear"))


@pytest.mark.parametrize("name", HIPPARCOS)
@pytest.mark.parametrize(("epoch_yr", "which"), [(2000.0, 0), (2026.9, 1)])
def test_fast_stars_stand_where_hipparcos_puts_them(name: str, epoch_yr: float, which: int) -> None:
    values, tolerances = HIPPARCOS[name]
    truth = from_hipparcos(values, epoch_yr)
    stars = embedded_catalog().cone(Icrs(truth.ra.deg, truth.dec.deg), 10 / 3600, epoch_yr=epoch_yr)
    assert len(stars) == 1
    found = SkyCoord(stars.ra_deg[0], stars.dec_deg[0], unit="deg")
    assert found.separation(truth).arcsec < tolerances[which]


def test_61_cygni_b_stood_in_1991_where_tycho_saw_it() -> None:
    # the line of HIP 104217 in tyc2.dat: observed place at 1991.65 / 1991.75, its own motion 5.2 arcsec/yr
    stars = embedded_catalog().cone(Icrs(316.71804806, 38.73485306), 1 / 3600, epoch_yr=1991.70)
    assert len(stars) == 1
    offset = SkyCoord(stars.ra_deg[0], stars.dec_deg[0], unit="deg").separation(
        SkyCoord(316.71804806, 38.73485306, unit="deg")
    )
    assert offset.arcsec < 0.3
    assert stars.pm_ra_cosdec_mas_yr[0] == pytest.approx(4117.1, abs=1.0)


def test_61_cygni_a_has_no_proper_motion_in_tycho_2() -> None:
    # HIP 104214 is a line with flag X: its place of 1991.63 is all there is
    for epoch_yr in (1991.63, 2026.9):
        stars = embedded_catalog().cone(Icrs(316.71237222, 38.74193417), 1 / 3600, epoch_yr=epoch_yr)
        assert len(stars) == 1
        assert np.isnan(stars.pm_ra_cosdec_mas_yr[0])
        assert np.isnan(stars.pm_dec_mas_yr[0])
    assert stars.sigma_arcsec[0] > 1.0


def test_photocenter_pairs_are_one_star_with_the_light_of_both() -> None:
    # TYC 1-17-1 and 1-17-2: BT 11.318 VT 10.521 and BT 10.772 VT 10.093
    v = np.array([10.521 - 0.09 * (11.318 - 10.521), 10.093 - 0.09 * (10.772 - 10.093)])
    stars = embedded_catalog().cone(Icrs(0.05059802, 1.77144349), 3 / 3600, epoch_yr=2000.0)
    assert len(stars) == 1
    assert stars.mag[0] == pytest.approx(-2.5 * np.log10(np.sum(10 ** (-0.4 * v))), abs=0.001)


def test_it_is_a_catalog_of_the_known_size() -> None:
    catalog: Catalog = embedded_catalog()
    assert catalog.name == "Tycho-2"
    # 2,539,913 + 17,588 lines, less 13,098 photocenter lines at 6,557 places
    assert len(embedded_catalog()) == 2_550_960 == 2_539_913 + 17_588 - 13_098 + 6_557
    verify_embedded()


def test_density_is_that_of_the_sky() -> None:
    rng = np.random.default_rng(3)
    ra, dec = rng.uniform(0, 360, 400), np.degrees(np.arcsin(rng.uniform(-1, 1, 400)))
    radius_deg = float(np.sqrt(1 / np.pi))
    counts = [
        len(embedded_catalog().cone(Icrs(a, d), radius_deg, epoch_yr=2026.9, mag_limit=11.5))
        for a, d in zip(ra, dec, strict=True)
    ]
    assert 22 < np.median(counts) < 34
    assert min(counts) >= 3
    assert max(counts) < 300


def test_sigma_of_today_is_larger_than_at_the_mean_epoch() -> None:
    then, now = (embedded_catalog().cone(Icrs(120, 30), 3, epoch_yr=t) for t in (1990.0, 2026.9))
    assert np.median(then.sigma_arcsec) < 0.8 * np.median(now.sigma_arcsec)
    unknown = np.isnan(now.pm_dec_mas_yr)
    assert 0.05 < np.median(now.sigma_arcsec[~unknown]) < 0.2
    assert 0.3 < np.median(now.sigma_arcsec[unknown]) < 0.6


@pytest.mark.long
@pytest.mark.parametrize("place", [(0.0, 0.0), (359.99, -45.0), (12.0, 89.9), (200.0, -89.9), (83.8, -5.4)])
def test_small_cones_equal_the_whole_sky_cut_down(place: tuple[float, float]) -> None:
    whole = embedded_catalog().cone(Icrs(0, 0), 180.0, epoch_yr=2026.9, mag_limit=9.0)
    away = SkyCoord(whole.ra_deg, whole.dec_deg, unit="deg").separation(SkyCoord(*place, unit="deg")).deg
    for radius_deg in (0.2, 1.0, 6.0):
        cone = embedded_catalog().cone(Icrs(*place), radius_deg, epoch_yr=2026.9, mag_limit=9.0)
        np.testing.assert_array_equal(np.sort(cone.ra_deg), np.sort(whole.ra_deg[away <= radius_deg]))
