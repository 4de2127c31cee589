"""Accuracy indicators against formulas from elsewhere: statistics, astropy, fits made without a pair."""

from __future__ import annotations

import math
import statistics
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadRequest
from mountnav.identification.accuracy import (
    Deviations,
    accuracy_table,
    deviations,
    east_north_arcsec,
    fit_factor,
    indicators,
    magnitude_deviations,
    pooled,
    without_worst,
)
from mountnav.identification.plate import NAMES, Plate, fit_plate, powers
from mountnav.identification.wcs import wcs_cards
from mountnav.measuring.measurements import Flag
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic_inverse
from mountnav.solution import IdentifiedPairs, Solution

WIDTH, HEIGHT, SCALE = 1200, 900, 3.0
FIELD = Icrs(120.0, 35.0)
values = hnp.arrays(
    np.float64, st.integers(2, 60), elements=st.floats(-1e3, 1e3, allow_nan=False).map(lambda v: round(v, 6))
)


def plate_about(center: Icrs, degree: int, turn_deg: float = 25.0) -> Plate:
    """Make a camera turned by `turn_deg`, bent a little where the degree allows it."""
    unit = WIDTH / 2
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    rng = np.random.default_rng(degree)
    xi, eta = (rng.normal(0.0, 2.0, len(powers(degree))) for _ in range(2))
    xi[:3], eta[:3] = np.array([0, -c, s]) * SCALE * unit, np.array([0, s, c]) * SCALE * unit
    return Plate(center, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, unit, degree, 1, xi, eta)


def sigma_arcsec(pairs: IdentifiedPairs) -> np.ndarray:
    return np.hypot(pairs.centroid_sigma_arcsec, pairs.catalog_sigma_arcsec)


def hat_diagonal(u: np.ndarray, v: np.ndarray, sigma: np.ndarray, degree: int) -> np.ndarray:
    """Of an ordinary weighted fit; a similarity is w = a + b·z in complex numbers."""
    rows = (
        np.column_stack([u**i * v**j for i, j in powers(degree)])
        if degree
        else np.column_stack((np.ones(u.size), u + 1j * v))
    )
    q, _ = np.linalg.qr(rows / sigma[:, None])
    summed: np.ndarray = (np.abs(q) ** 2).sum(axis=1)
    return summed


def made_solution(
    degree: int = 3, *, n: int = 60, outliers: int = 0, center: Icrs = FIELD, noise: float = 0.1
) -> Solution:
    """Pairs strewn over a frame, off by `noise`, and the plate that they really give."""
    rng = np.random.default_rng(7 + degree)
    true = plate_about(center, degree)
    x, y = rng.uniform(0, WIDTH - 1, n), rng.uniform(0, HEIGHT - 1, n)
    xi, eta = true.tangential(x, y)
    xi, eta = xi - rng.normal(0.0, noise, n), eta - rng.normal(0.0, noise, n)
    if outliers:
        xi[-outliers:] += 5.0
    rad = 180 * 3600 / math.pi
    ra, dec = gnomonic_inverse(xi / rad, eta / rad, center.ra_deg, center.dec_deg)
    mag = rng.uniform(8.0, 12.0, n)
    pairs = IdentifiedPairs(
        x_px=x,
        y_px=y,
        ra_deg=ra,
        dec_deg=dec,
        dx_arcsec=np.zeros(n),
        dy_arcsec=np.zeros(n),
        flux=10 ** (0.4 * (20.0 - mag + rng.normal(0.0, 0.05, n))),
        flux_sigma=np.ones(n),
        mag=mag,
        centroid_sigma_arcsec=rng.uniform(0.01, 0.2, n),
        catalog_sigma_arcsec=rng.uniform(0.02, 0.3, n),
        flags=np.zeros(n, dtype=np.int64),
        used=np.arange(n) < n - outliers,
        leverage=np.zeros(n),
    )
    used = pairs.used
    sigma = sigma_arcsec(pairs)[used]
    plate = true
    for _ in range(5):  # until the tangent point is where the fit has the center: the cards hold no constant
        plate = plate.moved_to(plate.center())
        xi, eta = plate.project(ra, dec)
        plate = fit_plate(plate, x[used], y[used], xi[used], eta[used], sigma, degree)
    fit_xi, fit_eta = plate.tangential(x, y)
    held = np.zeros(n)
    held[used] = hat_diagonal((x[used] - x.mean()) / WIDTH, (y[used] - y.mean()) / WIDTH, sigma, degree)
    pairs = replace(pairs, dx_arcsec=fit_xi - xi, dy_arcsec=fit_eta - eta, leverage=held)
    cards = wcs_cards(plate, width_px=WIDTH, height_px=HEIGHT)
    return Solution(
        center=plate.center(),
        center_sigma_arcsec=0.01,
        scale_arcsec_px=SCALE,
        rotation_deg=plate.rotation_deg(),
        parity=1,
        rms_arcsec=0.1,
        pairs=int(used.sum()),
        rejected=outliers,
        false_probability=0.0,
        mode=f"full/{NAMES[degree]}",
        wcs=cards,
        center_covariance_arcsec2=np.eye(2),
        identified=pairs,
    )


@pytest.mark.long
@given(values)
def test_indicators_are_those_of_the_statistics_module(array: np.ndarray) -> None:
    exact = [Fraction(float(v)) for v in array]
    got = indicators(array)
    assert got.number == len(exact)
    assert got.mean == pytest.approx(float(statistics.mean(exact)), abs=1e-9)
    assert got.standard_deviation == pytest.approx(math.sqrt(statistics.variance(exact)), abs=1e-9)
    assert got.least_modulus == min(abs(float(v)) for v in exact)
    assert got.most_modulus == max(abs(float(v)) for v in exact)


def test_indicators_of_nothing_and_of_one() -> None:
    assert indicators(np.zeros(0)).number == 0
    assert math.isnan(indicators(np.zeros(0)).mean)
    one = indicators(np.array([-2.0]))
    assert (one.mean, one.least_modulus, one.most_modulus) == (-2.0, 2.0, 2.0)
    assert math.isnan(one.standard_deviation)


@pytest.mark.long
@given(values.map(np.abs), st.floats(0, 99.9))
def test_the_worst_go_and_no_others(modulus: np.ndarray, percent: float) -> None:
    kept = without_worst(modulus, percent)
    gone = np.setdiff1d(np.arange(modulus.size), kept)
    assert kept.size + gone.size == modulus.size
    assert abs(gone.size - modulus.size * percent / 100) < 1
    assert gone.size <= modulus.size * percent / 100 + 1e-6
    if gone.size:
        assert modulus[gone].min() >= modulus[kept].max()


@pytest.mark.parametrize(
    ("n", "percent", "gone"), [(20, 5, 1), (19, 5, 0), (100, 10, 10), (60, 5, 3), (30, 10, 3)]
)
def test_shares_that_come_out_even_are_not_lost_to_binary_fractions(
    n: int, percent: float, gone: int
) -> None:
    assert n - without_worst(np.arange(float(n)), percent).size == gone


@pytest.mark.parametrize("percent", [-1.0, 100.0, math.nan, math.inf])
def test_impossible_shares_are_refused(percent: float) -> None:
    with pytest.raises(BadRequest):
        without_worst(np.ones(3), percent)


@settings(deadline=None, max_examples=60)
@given(
    st.floats(0, 360, exclude_max=True),
    st.one_of(st.floats(-90, 90), st.sampled_from([89.9999, -89.9999, 0.0])),
    st.floats(0, 360),
    st.floats(0.001, 5.0),
)
def test_offsets_hold_everywhere(ra: float, dec: float, angle_deg: float, length_arcsec: float) -> None:
    # walked in space, along the great circle: nothing there knows of poles and seams
    lon, lat, angle = (math.radians(v) for v in (ra, dec, angle_deg))
    length = math.radians(length_arcsec / 3600)
    here = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    north = np.array([-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)])
    along = math.sin(angle) * east + math.cos(angle) * north
    x, y, z = math.cos(length) * here + math.sin(length) * along
    there = (math.degrees(math.atan2(y, x)) % 360, math.degrees(math.atan2(z, math.hypot(x, y))))
    got = east_north_arcsec(*(np.array([v]) for v in (*there, ra, dec)))
    assert got[0][0] == pytest.approx(length_arcsec * math.sin(angle), abs=1e-8)
    assert got[1][0] == pytest.approx(length_arcsec * math.cos(angle), abs=1e-8)


def test_away_from_the_poles_they_are_the_papers_formulas() -> None:
    ra, dec = np.array([10.0001, 359.9999]), np.array([40.0001, -20.0])
    ra0, dec0 = np.array([10.0, 0.0001]), np.array([40.0, -20.0002])
    east, north = east_north_arcsec(ra, dec, ra0, dec0)
    plain = np.array([0.0001, -0.0002]) * 3600 * np.cos(np.radians(dec0))
    assert east == pytest.approx(plain, abs=1e-5)
    assert north == pytest.approx([0.36, 0.72], abs=1e-5)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("center", [Icrs(120.0, 35.0), Icrs(0.01, -89.9), Icrs(359.99, 0.0)])
def test_deviations_are_those_of_astropys_wcs(degree: int, center: Icrs) -> None:
    solution = made_solution(degree, center=center)
    pairs, found = solution.identified, deviations(solution)
    cards = {name: value for name, value in solution.wcs.items() if not name.startswith("IMAGE")}
    cards |= {"NAXIS": 2, "NAXIS1": WIDTH, "NAXIS2": HEIGHT}
    places = WCS(cards).all_pix2world(pairs.x_px, pairs.y_px, 0)
    measured, star = SkyCoord(*places, unit="deg"), SkyCoord(pairs.ra_deg, pairs.dec_deg, unit="deg")
    length, angle = star.separation(measured).arcsec, star.position_angle(measured).rad
    assert found.modulus_arcsec == pytest.approx(length, abs=1e-6)
    assert found.ra_arcsec == pytest.approx(length * np.sin(angle), abs=1e-6)
    assert found.dec_arcsec == pytest.approx(length * np.cos(angle), abs=1e-6)
    # along the frame's axes it is the same deviation, turned
    assert np.hypot(found.along_x_arcsec, found.along_y_arcsec) == pytest.approx(length, rel=2e-3)


def test_along_the_frames_axes() -> None:
    solution = made_solution(0)
    east = replace(
        solution.identified, dx_arcsec=np.full(60, 1.0), dy_arcsec=np.zeros(60)
    )  # to the east, in a frame whose +y stands 25° east of north
    found = deviations(replace(solution, identified=east))
    assert found.along_x_arcsec == pytest.approx(np.full(60, -math.cos(math.radians(25))), abs=1e-3)
    assert found.along_y_arcsec == pytest.approx(np.full(60, math.sin(math.radians(25))), abs=1e-3)


def test_rejected_pairs_are_left_out_unless_asked_for() -> None:
    solution = made_solution(3, outliers=4)
    assert len(deviations(solution)) == 56
    every = deviations(solution, every=True)
    assert len(every) == 60
    assert every.modulus_arcsec[-4:].min() > 3.0 > deviations(solution).modulus_arcsec.max()


def test_stars_that_the_catalog_knows_worse_are_left_out_if_asked() -> None:
    solution = made_solution(2, outliers=4)
    sigma = np.where(np.arange(60) % 3 == 0, 0.02, 0.1)
    solution = replace(solution, identified=replace(solution.identified, catalog_sigma_arcsec=sigma))
    whole, few = deviations(solution), deviations(solution, catalog_sigma_arcsec=0.02)
    good = sigma[solution.identified.used] <= 0.02
    assert 0 < len(few) < len(whole)
    assert np.array_equal(few.ra_arcsec, whole.ra_arcsec[good])
    assert len(deviations(solution, catalog_sigma_arcsec=0.01)) == 0


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_leave_one_out_is_what_a_fit_without_the_pair_gives(degree: int) -> None:
    solution = made_solution(degree, n=40, outliers=2)
    pairs, cards = solution.identified, solution.wcs
    center = Icrs(float(cards["CRVAL1"]), float(cards["CRVAL2"]))
    like = replace(plate_about(center, degree), tangent=center)
    xi, eta = like.project(pairs.ra_deg, pairs.dec_deg)
    sigma = sigma_arcsec(pairs)
    found = deviations(solution, every=True, leave_one_out=True)
    for one in (0, 5, 17):
        rest = np.flatnonzero(pairs.used & (np.arange(len(pairs)) != one))
        fit = fit_plate(like, pairs.x_px[rest], pairs.y_px[rest], xi[rest], eta[rest], sigma[rest], degree)
        got = fit.tangential(pairs.x_px[[one]], pairs.y_px[[one]])
        length = math.hypot(got[0][0] - xi[one], got[1][0] - eta[one])
        assert found.modulus_arcsec[one] == pytest.approx(length, rel=1e-4)
    # those not in the fit are independent as they are
    plain = deviations(solution, every=True)
    assert found.modulus_arcsec[-2:] == pytest.approx(plain.modulus_arcsec[-2:])


def test_a_pair_that_alone_holds_a_parameter_has_no_independent_deviation() -> None:
    solution = made_solution(1, n=3)
    assert len(deviations(solution)) == 3
    assert len(deviations(solution, leave_one_out=True)) == 0


def test_the_fits_own_deviations_fall_short_by_the_stated_factor() -> None:
    # over many draws: the mean square of residuals is (1 - p/n) sigma² for equal weights
    n, p = 40, 10
    rng = np.random.default_rng(3)
    like = plate_about(Icrs(10.0, 10.0), 3)
    x, y = rng.uniform(0, WIDTH, n), rng.uniform(0, HEIGHT, n)
    squares = []
    for _ in range(200):
        xi, eta = rng.normal(0.0, 1.0, (2, n))
        got = fit_plate(like, x, y, xi, eta, np.ones(n), 3).tangential(x, y)
        squares.append(np.mean((got[0] - xi) ** 2))
    assert math.sqrt(np.mean(squares)) == pytest.approx(fit_factor(n, p), rel=0.02)
    assert fit_factor(10, 10) == 0.0


def test_magnitudes_go_by_the_frames_own_zero_point() -> None:
    pairs = made_solution(1).identified
    got = magnitude_deviations(pairs)
    assert np.median(got) == pytest.approx(0.0, abs=0.01)
    assert got.std() == pytest.approx(0.05, rel=0.3)
    # another exposure, another gain: nothing changes
    louder = replace(pairs, flux=pairs.flux * 37.0, flux_sigma=pairs.flux_sigma * 37.0)
    assert magnitude_deviations(louder) == pytest.approx(got)
    # measured minus catalog: a star that is too faint in the frame has a positive deviation
    dimmed = pairs.flux.copy()
    dimmed[3] /= 10.0
    assert magnitude_deviations(replace(pairs, flux=dimmed))[3] == pytest.approx(got[3] + 2.5, abs=0.02)


def test_colors_are_taken_out_of_the_deviations() -> None:
    pairs = made_solution(1).identified
    color = np.random.default_rng(2).uniform(0.0, 1.6, len(pairs))
    # a camera that sees red stars brighter than the catalog's band does
    seen = replace(pairs, color_mag=color, flux=pairs.flux * 10 ** (0.4 * 0.3 * color))
    plain = magnitude_deviations(replace(seen, color_mag=np.full(60, np.nan)))
    with_colors = magnitude_deviations(seen)
    assert plain.std() > 0.13
    assert with_colors.std() == pytest.approx(magnitude_deviations(pairs).std(), rel=0.1)


def test_pairs_out_of_the_fit_have_no_say_in_the_zero_point() -> None:
    pairs = made_solution(1, outliers=25).identified
    wrong = np.where(pairs.used, pairs.flux, pairs.flux / 5.0)  # other stars than they are taken for
    got = magnitude_deviations(replace(pairs, flux=wrong))
    assert np.median(got[pairs.used]) == pytest.approx(0.0, abs=0.02)
    assert np.median(got[~pairs.used]) == pytest.approx(2.5 * math.log10(5.0), abs=0.05)


def test_saturated_and_nameless_stars_have_no_magnitude_deviation() -> None:
    pairs = made_solution(1).identified
    flags, mag, flux = pairs.flags.copy(), pairs.mag.copy(), pairs.flux.copy()
    flags[0], flags[1], mag[2], flux[3] = (
        int(Flag.SATURATED | Flag.ELONGATED),
        int(Flag.ELONGATED),
        math.nan,
        -1.0,
    )
    flux[0] *= 1e3
    got = magnitude_deviations(replace(pairs, flags=flags, mag=mag, flux=flux))
    assert np.flatnonzero(np.isnan(got)).tolist() == [0, 2, 3]
    # nor have those whose catalog magnitude is none of this band, or of no star
    for flag in (StarFlag.NO_MAGNITUDE, StarFlag.OTHER_BAND, StarFlag.VARIABLE, StarFlag.EXTENDED):
        warned = np.where(np.arange(60) == 7, int(flag), 0).astype(np.uint8)
        assert np.flatnonzero(np.isnan(magnitude_deviations(replace(pairs, star_flags=warned)))).tolist() == [
            7
        ]
    few = replace(pairs, flags=np.where(np.arange(60) < 58, int(Flag.SATURATED), 0))
    assert np.isnan(magnitude_deviations(few)).all()


def test_the_table_rejects_by_position_and_by_magnitude_apart() -> None:
    n = 40
    rng = np.random.default_rng(1)
    ra, dec, mag, x, y = rng.normal(0.0, 0.1, (5, n))
    ra[4], dec[9], mag[20], mag[30] = 9.0, -8.0, 5.0, math.nan
    found = Deviations(ra, dec, mag, x, y, ra, dec)
    none, five = accuracy_table(found, (0.0, 5.0))
    assert (none.rejected_percent, none.ra.number, none.dec.number, none.mag.number) == (0.0, 40, 40, 39)
    assert (none.ra.most_modulus, none.dec.most_modulus, none.mag.most_modulus) == (9.0, 8.0, 5.0)
    kept = np.delete(np.arange(n), [4, 9])
    assert five.ra == indicators(ra[kept])
    assert five.dec == indicators(dec[kept])
    assert five.mag == indicators(np.delete(mag, [20, 30]))


@pytest.mark.long
@given(st.lists(st.integers(0, 8), min_size=1, max_size=5), st.randoms(use_true_random=False))
def test_frames_taken_together_are_one_set_in_any_order(sizes: list[int], chance) -> None:
    rng = np.random.default_rng(sum(sizes))
    parts = [Deviations(*rng.normal(size=(7, n))) for n in sizes]
    shuffled = parts.copy()
    chance.shuffle(shuffled)
    assert len(pooled(parts)) == sum(sizes)
    for one, other in zip(*(accuracy_table(pooled(p), (0, 10)) for p in (parts, shuffled)), strict=True):
        for a, b in ((one.ra, other.ra), (one.dec, other.dec), (one.mag, other.mag)):
            assert (a.number, a.mean) == pytest.approx((b.number, b.mean), nan_ok=True)
            assert a.standard_deviation == pytest.approx(b.standard_deviation, nan_ok=True)
