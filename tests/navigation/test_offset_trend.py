"""Offsets that change on the way of a pass: learned from noisy looks, told with errors that hold."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from mountnav.navigation.offset_trend import CARRIED_ON_S, OffsetTrend

BEGAN = datetime(2026, 11, 26, 20, 0, tzinfo=UTC)


def after(looks: int, seed: int, *, noise_arcsec: float = 3.0, along_arcsec: float = 0.0) -> np.ndarray:
    """How far off the forecast is 4 s after so many looks at offsets that change by 5 and -3″/s."""
    chance = np.random.default_rng(seed)
    way = np.array([0.8, 0.6])
    covariance = noise_arcsec**2 * np.eye(2) + along_arcsec**2 * np.outer(way, way)

    def true(seconds: float) -> np.ndarray:
        return np.array([100.0 + 5.0 * seconds, -40.0 - 3.0 * seconds])

    def seen(seconds: float) -> tuple[float, float]:
        lon, lat = true(seconds) + chance.multivariate_normal([0.0, 0.0], covariance)
        return float(lon), float(lat)

    trend = OffsetTrend.begun(BEGAN, seen(0.0), (noise_arcsec**2 + along_arcsec**2,) * 2)
    for number in range(1, looks):
        trend = trend.seen(
            BEGAN + timedelta(seconds=4.0 * number),
            seen(4.0 * number),
            covariance,
            change_arcsec_s=(5.0, 5.0),
            way_deg=0.5,
        )
    utc = BEGAN + timedelta(seconds=4.0 * looks)
    off = np.array(trend.at(utc)) - true(4.0 * looks)
    return np.array([*off, *(off / np.sqrt(trend.variances(utc)))])


@pytest.mark.parametrize("looks", [2, 3, 10])
@pytest.mark.parametrize("along_arcsec", [0.0, 10.0])
def test_what_it_tells_of_its_errors_holds(looks: int, along_arcsec: float) -> None:
    found = np.array([after(looks, seed, along_arcsec=along_arcsec) for seed in range(300)])
    scatter = found[:, 2:].std(axis=0)
    assert (scatter < 1.15).all(), "errors are larger than it tells"
    assert (scatter > 0.35).all(), "errors are much smaller than it tells"


def test_a_change_is_learned_from_two_looks_and_better_from_ten() -> None:
    two, ten = (
        np.hypot(*np.median(np.abs([after(looks, seed) for seed in range(200)]), axis=0)[:2])
        for looks in (2, 10)
    )
    assert two < 8.0  # unlearned: 4 s of 5.8″/s
    assert ten < 0.6 * two


def test_one_look_alone_tells_of_no_change() -> None:
    trend = OffsetTrend.begun(BEGAN, (10.0, 20.0), (1.0, 1.0))
    assert trend.at(BEGAN + timedelta(seconds=20.0)) == (10.0, 20.0)
    assert not trend.turns


def test_a_change_is_not_carried_on_for_ever() -> None:
    trend = OffsetTrend.begun(BEGAN, (0.0, 0.0), (1.0, 1.0)).seen(
        BEGAN + timedelta(seconds=4.0), (40.0, 0.0), np.eye(2), change_arcsec_s=(10.0, 10.0), way_deg=1.0
    )
    most = trend.at(BEGAN + timedelta(seconds=4.0 + CARRIED_ON_S))
    assert trend.at(BEGAN + timedelta(hours=1.0)) == most
    assert most[0] == pytest.approx(40.0 + 10.0 * CARRIED_ON_S, rel=0.1)


def test_looks_out_of_order_change_nothing() -> None:
    trend = OffsetTrend.begun(BEGAN, (0.0, 0.0), (1.0, 1.0))
    assert trend.seen(BEGAN, (9.0, 9.0), np.eye(2), change_arcsec_s=(1.0, 1.0), way_deg=0.1) is trend
