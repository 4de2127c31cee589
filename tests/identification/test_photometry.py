"""Zero point and color term against simulated pairs: honest errors, outliers, and stars unfit for it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mountnav.catalog.stars import StarFlag
from mountnav.identification.photometry import (
    FEWEST_COLORED,
    fit_for_photometry,
    fit_photometry,
    instrumental_magnitudes,
)
from mountnav.measuring.measurements import Flag
from mountnav.solution import IdentifiedPairs

ZERO_POINT = 21.3
MEAN_COLOR = 0.7


def made(
    rng: np.random.Generator,
    count: int,
    *,
    color_term: float = -0.2,
    spread: float = 0.35,
    scatter: float = 0.05,
    flux_error: float = 0.02,
    outliers: int = 0,
    colorless: float = 0.0,
) -> IdentifiedPairs:
    """Pairs of a frame: the zero point holds for `MEAN_COLOR`; the first `outliers` are up to 2 mag off."""
    mag, color = rng.uniform(9.0, 13.0, count), rng.normal(MEAN_COLOR, spread, count)
    seen_mag = mag + rng.normal(0.0, scatter, count) - color_term * (color - MEAN_COLOR)
    true_flux = 10.0 ** (-0.4 * (seen_mag - ZERO_POINT))
    sigma = flux_error * true_flux * rng.uniform(0.3, 2.0, count)
    flux = true_flux + rng.normal(0.0, 1.0, count) * sigma
    flux[:outliers] *= 10.0 ** (0.4 * rng.choice([-1, 1], outliers) * rng.uniform(0.5, 2.0, outliers))
    none = np.zeros(count)
    return IdentifiedPairs(
        x_px=none,
        y_px=none,
        ra_deg=none,
        dec_deg=none,
        dx_arcsec=none,
        dy_arcsec=none,
        flux=flux,
        flux_sigma=sigma,
        mag=mag,
        centroid_sigma_arcsec=none,
        catalog_sigma_arcsec=none,
        flags=np.zeros(count, dtype=np.int64),
        used=np.ones(count, dtype=bool),
        leverage=none,
        color_mag=np.where(rng.random(count) < colorless, np.nan, color),
        band="V",
        color_name="B-V",
    )


def wide(values: list[float]) -> float:
    """Robust standard deviation."""
    low, high = np.percentile(values, [15.87, 84.13])
    return float(high - low) / 2


@pytest.mark.long
@pytest.mark.parametrize(
    ("count", "outliers", "colorless", "scatter"),
    [(40, 0, 0.0, 0.05), (40, 6, 0.0, 0.05), (40, 4, 0.4, 0.05), (150, 15, 0.1, 0.02), (40, 0, 0.0, 0.0)],
)
def test_errors_are_honest(count: int, outliers: int, colorless: float, scatter: float) -> None:
    rng = np.random.default_rng(11)
    zero_pulls, color_pulls, scatters = [], [], []
    for _ in range(150):
        found = fit_photometry(made(rng, count, outliers=outliers, colorless=colorless, scatter=scatter))
        assert found is not None
        truth = ZERO_POINT - 0.2 * (found.pivot_mag - MEAN_COLOR)
        zero_pulls.append((found.zero_point_mag - truth) / found.zero_point_sigma_mag)
        color_pulls.append((found.color_term + 0.2) / found.color_term_sigma)
        scatters.append(found.scatter_mag)
    assert 0.8 < wide(zero_pulls) < 1.25
    assert 0.8 < wide(color_pulls) < 1.25
    assert abs(np.median(zero_pulls)) < 0.35
    assert abs(np.median(color_pulls)) < 0.35
    assert np.median(scatters) == pytest.approx(scatter, abs=0.012)


@pytest.mark.long
@pytest.mark.parametrize(("count", "outliers"), [(3, 0), (6, 0), (7, 1)])
def test_few_stars_without_colors(count: int, outliers: int) -> None:
    rng = np.random.default_rng(5)
    pulls = []
    for _ in range(300):
        found = fit_photometry(made(rng, count, colorless=1.0, color_term=0.0, outliers=outliers))
        assert found is not None
        assert (found.color_term, math.isnan(found.color_term_sigma), math.isnan(found.pivot_mag)) == (
            0,
            1,
            1,
        )
        pulls.append((found.zero_point_mag - ZERO_POINT) / found.zero_point_sigma_mag)
    assert 0.75 < wide(pulls) < 1.3
    assert abs(np.median(pulls)) < 0.25


def test_a_third_of_outliers_does_no_harm() -> None:
    rng = np.random.default_rng(8)
    off = []
    for _ in range(60):
        found = fit_photometry(made(rng, 60, outliers=20))
        assert found is not None
        off.append(found.zero_point_mag - ZERO_POINT + 0.2 * (found.pivot_mag - MEAN_COLOR))
        assert found.stars <= 50
    assert np.sqrt(np.mean(np.square(off))) < 0.02


@pytest.mark.parametrize(
    ("count", "spread", "flux_error", "held"),
    [
        (40, 0.35, 0.02, True),
        (40, 0.05, 0.02, False),
        (FEWEST_COLORED - 1, 0.35, 0.02, False),
        (9, 0.2, 0.3, False),
    ],
)
def test_a_color_term_only_where_the_pairs_hold_it(
    count: int, spread: float, flux_error: float, held: bool
) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        found = fit_photometry(made(rng, count, spread=spread, flux_error=flux_error))
        assert found is not None
        assert (found.color_term != 0.0) == held
        assert math.isnan(found.color_term_sigma) != held


@pytest.mark.parametrize(("given", "found_term"), [(-0.9, -0.9), (-1.2, -1.0), (1.2, 1.0), (-4.0, 0.0)])
def test_the_color_term_is_bounded(given: float, found_term: float) -> None:
    found = fit_photometry(made(np.random.default_rng(4), 60, color_term=given))
    assert found is not None
    assert found.color_term == pytest.approx(found_term, abs=0.07)


def test_magnitudes_are_those_of_the_catalog() -> None:
    pairs = made(np.random.default_rng(6), 60, scatter=0.0, flux_error=1e-4)
    found = fit_photometry(pairs)
    assert found is not None
    assert (found.stars, found.band, found.color_name) == (60, "V", "B-V")
    told = found.magnitudes(pairs.flux, pairs.color_mag)
    assert told == pytest.approx(pairs.mag, abs=0.002)
    # an unknown color is the pivot
    assert found.magnitudes(np.array([1.0]), np.array([np.nan]))[0] == pytest.approx(found.zero_point_mag)
    assert np.isnan(found.magnitudes(np.array([0.0, -5.0, np.nan]), np.full(3, 0.5))).all()
    assert instrumental_magnitudes(np.array([100.0]))[0] == -5.0


@pytest.mark.parametrize(
    "flag", [Flag.SATURATED, Flag.BLENDED, Flag.EDGE, Flag.NO_PEAK, Flag.TRAIL, Flag.BLEED]
)
def test_spoiled_measurements_have_no_say(flag: Flag) -> None:
    pairs = made(np.random.default_rng(7), 30)
    bad = np.arange(30) < 14
    flux = np.where(bad, pairs.flux * 2.0, pairs.flux)
    spoiled = replace(pairs, flux=flux, flags=np.where(bad, int(flag), 0))
    _same_as_without(spoiled, bad)


@pytest.mark.parametrize(
    "flag",
    [
        StarFlag.NO_MAGNITUDE,
        StarFlag.OTHER_BAND,
        StarFlag.VARIABLE,
        StarFlag.EXTENDED,
        StarFlag.DOUBLE,
        StarFlag.DOUBTFUL,
    ],
)
def test_stars_with_a_warning_have_no_say(flag: StarFlag) -> None:
    pairs = made(np.random.default_rng(7), 30)
    bad = np.arange(30) < 14
    mag = np.where(bad, pairs.mag - 0.8, pairs.mag)
    _same_as_without(replace(pairs, mag=mag, star_flags=np.where(bad, int(flag), 0).astype(np.uint8)), bad)


def test_rejected_pairs_and_those_without_numbers_have_no_say() -> None:
    pairs = made(np.random.default_rng(7), 30)
    bad = np.arange(30) < 14
    _same_as_without(replace(pairs, mag=pairs.mag + bad, used=~bad), bad)
    _same_as_without(replace(pairs, mag=np.where(bad, np.nan, pairs.mag)), bad)
    _same_as_without(replace(pairs, flux=np.where(bad, -1.0, pairs.flux)), bad)
    fine = int(StarFlag.NO_PROPER_MOTION)
    harmless = replace(
        pairs, star_flags=np.full(30, fine, dtype=np.uint8), flags=np.full(30, int(Flag.ELONGATED))
    )
    assert fit_for_photometry(harmless).all()


def test_two_stars_are_too_few() -> None:
    assert fit_photometry(made(np.random.default_rng(1), 2)) is None
    assert fit_photometry(made(np.random.default_rng(1), 0)) is None


def test_equal_stars_have_no_scatter() -> None:
    pairs = made(np.random.default_rng(1), 5, scatter=0.0, flux_error=0.0, color_term=0.0)
    found = fit_photometry(pairs)
    assert found is not None
    assert found.zero_point_mag == pytest.approx(ZERO_POINT)
    assert 0.0 < found.zero_point_sigma_mag < 0.001


def _same_as_without(pairs: IdentifiedPairs, bad: np.ndarray) -> None:
    """The fit must be that of the other pairs alone."""
    assert np.array_equal(fit_for_photometry(pairs), ~bad)
    names = [name for name in IdentifiedPairs.__dataclass_fields__ if name not in ("band", "color_name")]
    rest = replace(pairs, **{name: getattr(pairs, name)[~bad] for name in names})
    assert fit_photometry(pairs) == fit_photometry(rest)
