"""Error classes of large catalogs: counted in cells, and what each star's sigma becomes by it."""

from __future__ import annotations

import numpy as np
import pytest

from mountnav.catalog.packed.error_classes import CELLS, ErrorCells, cells, classify, error_curve

YEARS = (1995.0, 2015.0, 2026.9, 2045.0)


def like_ucac4(count: int, seed: int = 1) -> np.ndarray:
    """Errors, their growth and epochs as UCAC4 has them, with monsters among them."""
    rng = np.random.default_rng(seed)
    bright = rng.random(count) < 0.2
    e = np.where(bright, rng.lognormal(2.8, 0.4, count), rng.lognormal(4.0, 0.5, count)).clip(5, 255)
    e_pm = np.where(bright, rng.lognormal(0.4, 0.5, count), rng.lognormal(1.6, 0.4, count)).clip(0.1, 50)
    epoch = np.where(bright, rng.uniform(1950, 1998, count), rng.uniform(1980, 2003, count))
    e[:5], e_pm[:5] = 20_000.0, 900.0
    e[5:10], e_pm[5:10], epoch[5:10] = 0.02, 0.02, 2016.0
    return error_curve((e, e), (e_pm, e_pm), (epoch, epoch))


def sigma(classes: np.ndarray, year: float) -> np.ndarray:
    s, epoch, s_pm = classes.astype(np.float64).T
    found: np.ndarray = np.hypot(s, (year - epoch) * s_pm)
    return found


def ratios(curve: np.ndarray, code: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """Sigma by class over own sigma, shape (years, n)."""
    own = [np.sqrt(curve @ np.array([1.0, y - 2000.0, (y - 2000.0) ** 2])) for y in YEARS]
    return np.array([sigma(classes, y)[code] / o for y, o in zip(YEARS, own, strict=True)])


def by_cells(curve: np.ndarray, blocks: int) -> tuple[np.ndarray, np.ndarray]:
    counted = ErrorCells.empty()
    pieces = np.array_split(curve.astype(np.float32), blocks)
    for piece in pieces:
        counted.add(piece)
    classes = counted.classified()
    code = np.concatenate([classes.assign(piece) for piece in pieces])
    return code, classes.parameters()


@pytest.fixture(scope="module")
def curve() -> np.ndarray:
    return like_ucac4(60_000)


def test_no_sigma_is_badly_understated(curve: np.ndarray) -> None:
    ratio = ratios(curve, *by_cells(curve, 3))
    assert ratio.min() > 0.6
    assert ratio.max() < 1.9
    assert np.all(np.abs(np.median(ratio, axis=1) - 1.0) < 0.02)
    assert np.percentile(ratio, 1) > 0.85
    assert np.percentile(ratio, 99) < 1.25


@pytest.mark.long
def test_cells_do_about_as_well_as_all_stars_at_once(curve: np.ndarray) -> None:
    scatter = np.log(ratios(curve, *by_cells(curve, 1))).std()
    assert scatter < 1.3 * np.log(ratios(curve, *classify(curve))).std()


@pytest.mark.long
def test_blocks_change_nothing(curve: np.ndarray) -> None:
    code, classes = by_cells(curve, 1)
    for blocks in (2, 17):
        again, same = by_cells(curve, blocks)
        np.testing.assert_array_equal(again, code)
        np.testing.assert_array_equal(same, classes)


def test_one_kind_of_error_is_one_class() -> None:
    one = np.full(50, 30.0)
    code, classes = by_cells(error_curve((one, one), (one * 0, one * 0), (one + 1970, one + 1970)), 2)
    assert classes.shape == (1, 3)
    assert not code.any()
    assert classes[0, 0] == pytest.approx(30.0, rel=1e-3)


def test_impossible_errors_find_a_cell() -> None:
    curve = np.array([[1e-30, 0, 0], [1e30, 0, 0], [1.0, -1e20, 1e-3], [1.0, 1e25, 1e30]], dtype=np.float32)
    found = cells(curve)
    assert np.all((found >= 0) & (found < CELLS))
