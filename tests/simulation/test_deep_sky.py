"""The invented sky: always the same, as full as it should be, and moving; what its catalogs state of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.star_counts import density_deg2
from mountnav.catalog.stars import StarFlag, Stars
from mountnav.simulation.deep_sky import EPOCH_YR, DeepSky
from mountnav.simulation.sky_kinds import KINDS
from mountnav.sky.coordinates import Icrs
from tests.simulation.sky_stores import whole_sky, write_store

ARCSEC = 180 * 3600 / np.pi
PLACE = Icrs(100.0, 20.0)
PLACES = [PLACE, Icrs(0.01, -45.0), Icrs(40.0, 89.9), Icrs(310.0, -89.95), Icrs(266.4, -15.0)]


def tree(stars: Stars) -> cKDTree:
    return cKDTree(unit_vectors(stars.ra_deg, stars.dec_deg).T)


def apart_arcsec(stars: Stars, others: Stars) -> tuple[np.ndarray, np.ndarray]:
    """How far the nearest of the others is from each star, and which it is."""
    chord, which = map(np.asarray, tree(others).query(unit_vectors(stars.ra_deg, stars.dec_deg).T))
    return chord * ARCSEC, which


def offset_mas(stars: Stars, others: Stars) -> np.ndarray:
    """East and north of each star from the other of the same row; shape (n, 2)."""
    east = (stars.ra_deg - others.ra_deg + 180) % 360 - 180
    return np.column_stack(
        [east * np.cos(np.radians(stars.dec_deg)), stars.dec_deg - others.dec_deg]
    ) * 3.6e6  # fmt: skip


@pytest.mark.parametrize("center", PLACES)
def test_a_star_is_the_same_in_every_cone(center):
    sky = DeepSky(3, faintest_mag=19.0)
    wide = sky.cone(center, 0.4, epoch_yr=2026.9)
    narrow = DeepSky(3, faintest_mag=19.0).cone(center, 0.15, epoch_yr=2026.9)
    gap, which = apart_arcsec(narrow, wide)
    assert gap.max() < 1e-6
    assert np.array_equal(narrow.mag, wide.mag[which])
    seen = unit_vectors(wide.ra_deg, wide.dec_deg) - unit_vectors(center.ra_deg, center.dec_deg)[:, None]
    inside = np.linalg.norm(seen, axis=0) <= 2 * np.sin(np.radians(0.15) / 2)
    assert np.count_nonzero(inside) == len(narrow)
    assert (np.diff(wide.mag) >= 0).all()


def test_a_shallower_sky_is_the_bright_end_of_the_deeper_one():
    deep = DeepSky(3, faintest_mag=21.0).cone(PLACE, 0.3, epoch_yr=2020.0)
    shallow = DeepSky(3, faintest_mag=17.0).cone(PLACE, 0.3, epoch_yr=2020.0)
    limited = DeepSky(3, faintest_mag=21.0).cone(PLACE, 0.3, epoch_yr=2020.0, mag_limit=17.0)
    bright = deep.mag <= 17.0
    for one in (shallow, limited):
        assert np.array_equal(one.mag, deep.mag[bright])
        assert np.array_equal(one.ra_deg, deep.ra_deg[bright])


def test_another_seed_is_another_sky():
    one, other = (DeepSky(seed, faintest_mag=19).cone(PLACE, 0.2, epoch_yr=2020.0) for seed in (3, 4))
    gap, _ = apart_arcsec(one, other)
    assert np.median(gap) > 5.0


@pytest.mark.parametrize("center", [PLACE, Icrs(192.0, 27.0), Icrs(40.0, 89.0)])
def test_it_is_as_full_as_the_galaxy(center):
    stars = DeepSky(3, faintest_mag=20.0).cone(center, 1.0, epoch_yr=EPOCH_YR)
    for mag in (13.0, 16.0, 18.0, 20.0):
        promised = float(density_deg2(center.ra_deg, center.dec_deg, mag)) * np.pi
        # a twelfth are companions; Tycho-2's stars cluster where they like
        assert np.count_nonzero(stars.mag <= mag) == pytest.approx(
            1.04 * promised, rel=0.3 if mag < 14 else 0.1
        )


def test_stars_move_as_they_say():
    sky = DeepSky(3, faintest_mag=19.0)
    before, after = (sky.cone(PLACE, 0.2, epoch_yr=year) for year in (2016.0, 2026.0))
    gap, which = apart_arcsec(before, after)
    inside = gap < 20.0
    moved = offset_mas(after.only(which), before)
    told = np.column_stack([before.pm_ra_cosdec_mas_yr, before.pm_dec_mas_yr]) * 10.0
    slow = inside & (np.hypot(*told.T) < 500)
    assert np.abs(moved - told)[slow & (gap < 0.4)].max() < 0.5
    assert 2.0 < np.median(np.hypot(*told.T) / 10.0) < 15.0


def test_there_are_close_pairs():
    stars = DeepSky(3, faintest_mag=20.0).cone(Icrs(192.0, 27.0), 0.7, epoch_yr=2020.0)
    chord, _ = tree(stars).query(unit_vectors(stars.ra_deg, stars.dec_deg).T, k=2)
    close = np.mean(np.asarray(chord)[:, 1] * ARCSEC < 8.0)
    assert 0.06 < close < 0.2


@pytest.mark.long
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_catalog_errs_as_it_states(kind):
    sky = DeepSky(3, faintest_mag=21.0)
    catalog = sky.as_catalog(kind)
    truth = sky.cone(PLACE, 0.6, epoch_yr=2026.9)
    stated = catalog.cone(PLACE, 0.55, epoch_yr=2026.9)
    gap, which = apart_arcsec(stated, truth)
    good = (stated.flags & int(StarFlag.DOUBLE | StarFlag.DOUBTFUL)) == 0
    if kind != "usno-b1":
        good &= np.isfinite(stated.pm_dec_mas_yr)
    in_sigmas = offset_mas(stated, truth.only(which))[good] / 1000 / stated.sigma_arcsec[good][:, None]
    spread = 1.4826 * np.median(np.abs(in_sigmas), axis=0)
    # the plates' places lack the motion of 47 years, of which the stated error is a guess
    assert spread == pytest.approx([1.0, 1.0], abs=0.35 if kind == "usno-b1" else 0.12)
    missing = 1.0 - np.mean(
        apart_arcsec(truth.only(truth.mag < KINDS[kind].faintest_mag - 1.0), stated)[0] < 2.0
    )
    assert missing < 0.25
    assert stated.mag.max() <= KINDS[kind].faintest_mag + 0.3
    assert np.mean(gap > 3.0) == pytest.approx(KINDS[kind].false_share, abs=0.01)


def test_what_a_catalog_does_not_resolve_is_one_star_between_the_two():
    sky = DeepSky(3, faintest_mag=19.0)
    rows = sky.rows(PLACE, 0.3)
    second = np.flatnonzero(
        (rows.parent >= 0) & (rows.separation_arcsec > 1.0) & (rows.separation_arcsec < 2.0)
    )
    chord = unit_vectors(rows.ra_deg, rows.dec_deg) - unit_vectors(PLACE.ra_deg, PLACE.dec_deg)[:, None]
    second = second[np.linalg.norm(chord, axis=0)[second] < np.radians(0.45)]
    assert second.size > 5
    plates = sky.as_catalog("usno-b1").cone(PLACE, 0.5, epoch_yr=EPOCH_YR)
    merged = plates.only((plates.flags & int(StarFlag.DOUBLE)) > 0)
    gaia = sky.as_catalog("gaia").cone(PLACE, 0.5, epoch_yr=EPOCH_YR)
    a = unit_vectors(rows.ra_deg[second], rows.dec_deg[second])
    apart_gaia = np.asarray(tree(gaia).query(a.T)[0]) * ARCSEC
    near = rows.v_mag[second] < 18.5
    assert np.mean(apart_gaia[near] < 0.05) > 0.9
    first = rows.parent[second]
    between = tree(merged).query(unit_vectors(rows.ra_deg[first], rows.dec_deg[first]).T)[0] * ARCSEC
    assert np.mean(between < 1.6) > 0.8


@pytest.mark.long
def test_a_packed_store_holds_what_the_catalog_states(tmp_path):
    catalog = DeepSky(3, faintest_mag=20.0).as_catalog("gaia")
    cones = [(place, 0.3) for place in PLACES[:4]] + [(Icrs(100.1, 20.1), 0.3)]
    write_store(tmp_path / "deep.mnc", catalog, cones)
    store = PackedStore(tmp_path / "deep.mnc")
    for center, radius in cones:
        told = catalog.cone(center, radius, epoch_yr=2026.9)
        held = store.cone(center, radius, epoch_yr=2026.9)
        # steps of the file: 0.15 mas in place, 1 mmag
        assert abs(len(told) - len(held)) <= 2
        gap, which = apart_arcsec(held, told)
        assert np.percentile(gap, 99.5) < 0.003
        assert np.abs(held.mag - told.mag[which]).max() < 0.02
        assert (held.color_name, held.band) == ("BP-RP", "G")
        assert np.abs(held.color_mag - told.color_mag[which]).max() < 0.1
        assert held.sigma_arcsec == pytest.approx(told.sigma_arcsec[which], rel=0.2, abs=1e-4)


def test_the_pieces_of_the_whole_sky_fit_together():
    catalog = DeepSky(3, faintest_mag=12.5).as_catalog("ucac4")
    corner = Icrs(45.0, 41.81)  # where pixels of that size meet
    near = []
    for _, columns in whole_sky(catalog, [15, 26, 37, 48]):
        seen = unit_vectors(columns.ra_deg, columns.dec_deg).T @ unit_vectors(corner.ra_deg, corner.dec_deg)
        near.append(columns.mag[seen > np.cos(np.radians(1.0))])
    told = catalog.cone(corner, 1.0, epoch_yr=2000.0)
    assert np.sort(np.concatenate(near)) == pytest.approx(told.mag)
    assert min(part.size for part in near) > 10


def test_an_unknown_kind_is_none():
    with pytest.raises(KeyError):
        DeepSky(1).as_catalog("gsc")
