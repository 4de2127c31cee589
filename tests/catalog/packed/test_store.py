"""Cones of a packed store against brute force with astropy's space motion."""

from __future__ import annotations

from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs
from tests.catalog.packed.packing_version_1 import pack_version_1

COUNT = 6000
EPOCH_YR = 2026.9
ROUNDING_ARCSEC = 0.003


def random_columns() -> CatalogColumns:
    rng = np.random.default_rng(20261121)
    ra = rng.uniform(0, 360, COUNT)
    dec = np.degrees(np.arcsin(rng.uniform(-1, 1, COUNT)))
    # crowd both poles and the RA seam, where cones go wrong first
    dec[:400], dec[400:800] = 90 - rng.exponential(0.5, 400), -90 + rng.exponential(0.5, 400)
    dec[0], dec[400] = 90.0, -90.0
    ra[800:1600] = rng.normal(0, 0.3, 800) % 360
    dec[800:1600] = rng.uniform(-3, 3, 800)
    pm = rng.normal(0, 50, (2, COUNT)).round(1)
    pm[:, ::50] = rng.uniform(-3200, 3200, pm[:, ::50].shape).round(1)
    pm[1, 7::600] = 10277.3
    pm[:, 3::40] = np.nan
    e, e_pm, epoch = rng.uniform(5, 150, COUNT), rng.uniform(0.5, 8, COUNT), rng.uniform(1940, 1992, COUNT)
    # no two alike, so that stars can be told apart by magnitude
    mag = np.round(-1.5 + 0.002 * rng.permutation(COUNT).astype(np.float64), 3)
    color = rng.uniform(-0.5, 3.0, COUNT).round(3)
    color[::9] = np.nan
    return CatalogColumns(
        ra,
        dec,
        pm[0],
        pm[1],
        mag,
        error_curve((e, e), (e_pm, e_pm), (epoch, epoch)),
        color,
        (rng.integers(0, 64, COUNT) << 1).astype(np.uint8),
    )


@pytest.fixture(scope="module")
def columns() -> CatalogColumns:
    return random_columns()


@pytest.fixture(scope="module")
def stores(columns: CatalogColumns, tmp_path_factory: pytest.TempPathFactory) -> dict[str, PackedStore]:
    """The same stars in every form: version 1, and version 2 with pixels from huge to tiny."""
    folder: Path = tmp_path_factory.mktemp("packed")
    pack_version_1(columns, folder / "1.mnc", name="random", band="V", epoch_yr=2000.0)
    for nside in (1, 8, 64, 128, 512):
        path = folder / f"2-{nside}.mnc"
        pack(columns, path, name="random", band="V", epoch_yr=2000.0, nside=nside, color_name="B-V")
    return {path.stem: PackedStore(path) for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module", params=["1", "2-64", "2-512"])
def store(stores: dict[str, PackedStore], request: pytest.FixtureRequest) -> PackedStore:
    return stores[request.param]


@pytest.fixture(scope="module")
def moved(columns: CatalogColumns) -> SkyCoord:
    known = ~np.isnan(columns.pm_dec_mas_yr)
    start = SkyCoord(
        ra=columns.ra_deg * u.deg,
        dec=columns.dec_deg * u.deg,
        # without radial velocity astropy's motion is the straight line that the store takes
        distance=np.full(COUNT, 10.0) * u.pc,
        pm_ra_cosdec=np.where(known, columns.pm_ra_cosdec_mas_yr, 0.0) * u.mas / u.yr,
        pm_dec=np.where(known, columns.pm_dec_mas_yr, 0.0) * u.mas / u.yr,
        radial_velocity=np.zeros(COUNT) * u.km / u.s,
        obstime=Time(2000.0, format="jyear"),
    )
    return start.apply_space_motion(new_obstime=Time(EPOCH_YR, format="jyear"))


places = st.one_of(
    st.tuples(st.floats(0, 360), st.floats(-90, 90)),
    st.tuples(st.floats(0, 360), st.floats(88, 90)),
    st.tuples(st.floats(0, 360), st.floats(-90, -88)),
    st.tuples(st.floats(-1, 1), st.floats(-3, 3)),
)


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(place=places, radius_deg=st.floats(0.01, 40), limit=st.one_of(st.none(), st.floats(-2, 14)))
def test_cone_finds_what_brute_force_finds(
    store: PackedStore,
    columns: CatalogColumns,
    moved: SkyCoord,
    place: tuple[float, float],
    radius_deg: float,
    limit: float | None,
) -> None:
    stars = store.cone(Icrs(*place), radius_deg, epoch_yr=EPOCH_YR, mag_limit=limit)
    faintest = np.inf if limit is None else limit
    # a limit within rounding of a star's magnitude may take it or leave it
    surely_bright, perhaps_bright = columns.mag <= faintest - 1e-6, columns.mag <= faintest + 1e-6
    away = moved.separation(SkyCoord(*place, unit="deg")).deg
    slack = ROUNDING_ARCSEC / 3600
    surely = surely_bright & (away < radius_deg - slack)
    perhaps = perhaps_bright & (away < radius_deg + slack)
    assert surely.sum() <= len(stars) <= perhaps.sum()
    assert np.all(np.diff(stars.mag) >= 0)
    if len(stars):
        found = SkyCoord(stars.ra_deg, stars.dec_deg, unit="deg")
        candidates = moved[perhaps]
        nearest, distance, _ = found.match_to_catalog_sky(SkyCoord(candidates.ra, candidates.dec))
        assert distance.arcsec.max() < ROUNDING_ARCSEC
        assert np.unique(nearest).size == len(stars)
        np.testing.assert_allclose(stars.mag, columns.mag[perhaps][nearest], atol=1e-9)


def straight_line_places(columns: CatalogColumns, epoch_yr: float) -> np.ndarray:
    """Brute force without the library: a tangent to the sphere, as long as the years."""
    ra, dec = np.radians(columns.ra_deg), np.radians(columns.dec_deg)
    radial = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    east = np.array([-np.sin(ra), np.cos(ra), np.zeros(ra.size)])
    north = np.cross(radial.T, east.T).T
    mas_rad = np.pi / 180 / 3.6e6 * (epoch_yr - 2000.0)
    pm = np.nan_to_num(np.array([columns.pm_ra_cosdec_mas_yr, columns.pm_dec_mas_yr]))
    moved = radial + (east * pm[0] + north * pm[1]) * mas_rad
    unit: np.ndarray = moved / np.linalg.norm(moved, axis=0)
    return unit


@pytest.mark.long
@settings(max_examples=150, deadline=None)
@given(
    which=st.sampled_from(["1", "2-1", "2-8", "2-64", "2-128", "2-512"]),
    place=places,
    radius_deg=st.one_of(st.just(0.0), st.just(180.0), st.floats(0, 1), st.floats(0, 180)),
    limit=st.one_of(st.none(), st.floats(-6, 14), st.just(1e300), st.just(-1e300)),
    epoch_yr=st.one_of(st.just(2000.0), st.floats(1850, 2150), st.floats(-3000, 7000)),
    on_a_star=st.one_of(st.none(), st.integers(0, COUNT - 1)),
)
def test_every_form_holds_the_same_stars_at_any_epoch(
    stores: dict[str, PackedStore],
    columns: CatalogColumns,
    which: str,
    place: tuple[float, float],
    radius_deg: float,
    limit: float | None,
    epoch_yr: float,
    on_a_star: int | None,
) -> None:
    vectors = straight_line_places(columns, epoch_yr)
    if on_a_star is not None:  # fast ones among them
        x, y, z = vectors[:, on_a_star]
        place = float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arctan2(z, np.hypot(x, y))))
    a, d = np.radians(place)
    axis = np.array([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])
    away = np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(vectors.T - axis, axis=1) / 2, 0, 1)))
    faintest = np.inf if limit is None else limit
    # a limit within rounding of a star's magnitude may take it or leave it
    surely_bright, perhaps_bright = columns.mag <= faintest - 1e-6, columns.mag <= faintest + 1e-6
    # a far epoch makes much of the 0.05 mas/yr to which proper motions are rounded
    slack = (ROUNDING_ARCSEC + 1e-4 * abs(epoch_yr - 2000.0)) / 3600
    surely = set((columns.mag[surely_bright & (away < radius_deg - slack)] * 1000).round().astype(int))
    perhaps = set((columns.mag[perhaps_bright & (away < radius_deg + slack)] * 1000).round().astype(int))
    stars = stores[which].cone(Icrs(*place), radius_deg, epoch_yr=epoch_yr, mag_limit=limit)
    found = set((stars.mag * 1000).round().astype(int))
    assert len(found) == len(stars)
    assert surely <= found <= perhaps


def test_colors_and_flags_are_those_of_the_star(
    stores: dict[str, PackedStore], columns: CatalogColumns
) -> None:
    order = np.argsort(columns.mag)
    still = np.where(np.isnan(columns.pm_dec_mas_yr), StarFlag.NO_PROPER_MOTION, 0)[order]
    assert columns.color_mag is not None
    assert columns.flags is not None
    for which, store in stores.items():
        stars = store.cone(Icrs(0, 0), 180.0, epoch_yr=EPOCH_YR)
        if which == "1":
            assert np.isnan(stars.color_mag).all()
            assert stars.color_name == ""
            assert columns.flags is not None
            np.testing.assert_array_equal(stars.flags, still)
            continue
        np.testing.assert_allclose(stars.color_mag, columns.color_mag[order], atol=0.0006)
        assert stars.color_name == "B-V"
        np.testing.assert_array_equal(stars.flags, columns.flags[order] | still)


def test_whole_sky_holds_every_star_and_its_motion(
    store: PackedStore, columns: CatalogColumns, moved: SkyCoord
) -> None:
    stars = store.cone(Icrs(0, 0), 180.0, epoch_yr=EPOCH_YR)
    assert len(stars) == COUNT
    found = SkyCoord(stars.ra_deg, stars.dec_deg, unit="deg")
    nearest, _, _ = found.match_to_catalog_sky(SkyCoord(moved.ra, moved.dec))
    unknown = np.isnan(columns.pm_dec_mas_yr[nearest])
    np.testing.assert_array_equal(np.isnan(stars.pm_dec_mas_yr), unknown)
    np.testing.assert_array_equal(np.isnan(stars.pm_ra_cosdec_mas_yr), unknown)
    # within 0.01 degrees of a pole the directions east and north are a matter of rounding
    sure = ~unknown & (abs(stars.dec_deg) < 89.99)
    np.testing.assert_allclose(
        stars.pm_ra_cosdec_mas_yr[sure], moved.pm_ra_cosdec.to_value(u.mas / u.yr)[nearest][sure], atol=0.02
    )
    np.testing.assert_allclose(
        stars.pm_dec_mas_yr[sure], moved.pm_dec.to_value(u.mas / u.yr)[nearest][sure], atol=0.02
    )


def test_sigma_grows_with_the_years_as_the_catalog_says(store: PackedStore, columns: CatalogColumns) -> None:
    for year in (2000.0, 2026.9, 2040.0):
        stars = store.cone(Icrs(0, 0), 180.0, epoch_yr=year)
        t = year - 2000.0
        own = np.sqrt(columns.error_curve @ np.array([1.0, t, t * t])) / 1000.0
        ratio = stars.sigma_arcsec / own[np.argsort(columns.mag)]
        assert 0.97 < np.median(ratio) < 1.03
        assert np.mean((ratio > 0.85) & (ratio < 1.15)) > 0.95


@pytest.mark.parametrize(
    ("center", "radius_deg", "epoch_yr", "mag_limit"),
    [
        (Icrs(0, 91), 1, 2026, None),
        (Icrs(float("nan"), 0), 1, 2026, None),
        (Icrs(0, 0), -1, 2026, None),
        (Icrs(0, 0), 181, 2026, None),
        (Icrs(0, 0), 1, float("inf"), None),
        (Icrs(0, 0), 1, 2026, float("nan")),
    ],
)
def test_senseless_cones_are_refused(
    store: PackedStore, center: Icrs, radius_deg: float, epoch_yr: float, mag_limit: float | None
) -> None:
    with pytest.raises(BadRequest):
        store.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)


def test_an_empty_cone_is_an_answer(store: PackedStore) -> None:
    assert len(store.cone(Icrs(123.0, 45.0), 0.0, epoch_yr=2026.9)) == 0
    assert len(store.cone(Icrs(123.0, 45.0), 10.0, epoch_yr=2026.9, mag_limit=-10.0)) == 0
