"""Where the tube looks between looks: what was ordered is added, drifts are learned, jumps teach nothing."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mountnav.devices import OffsetRates
from mountnav.navigation.rates_measured import OrderedRates
from mountnav.navigation.tube_estimate import MOST_DRIFT_ARCSEC_S, TubeEstimate
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec

BEGIN = datetime(2026, 11, 21, 20, 0, tzinfo=UTC)
PLACE = Icrs(359.9999, 35.0)


def after(seconds: float) -> datetime:
    return BEGIN + timedelta(seconds=seconds)


@given(ra=st.floats(-20.0, 20.0), dec=st.floats(-20.0, 20.0), seconds=st.floats(0.0, 600.0))
def test_ordered_rates_are_added(ra: float, dec: float, seconds: float) -> None:
    ordered = [OrderedRates(BEGIN, OffsetRates(ra, dec))]
    at = TubeEstimate.of(PLACE, BEGIN, 0.2).at(after(seconds), ordered)
    expected = Icrs((PLACE.ra_deg + ra * seconds / 3600.0) % 360.0, PLACE.dec_deg + dec * seconds / 3600.0)
    assert isinstance(at, Icrs)
    assert separation_arcsec(at, expected) < 1e-4


def test_a_drift_is_learned_by_looks_and_foretold() -> None:
    noise = np.random.default_rng(1)
    tube = TubeEstimate.of(PLACE, BEGIN, 0.2)
    for n in range(1, 12):
        seen = displaced(
            PLACE, 0.05 * 60.0 * n + noise.normal(0, 0.2), -0.03 * 60.0 * n + noise.normal(0, 0.2)
        )
        tube = tube.seen(seen, after(60.0 * n), 0.2, [])
    east, north = tube.drift_arcsec_s
    assert abs(east - 0.05) < 0.01
    assert abs(north + 0.03) < 0.01
    ahead = tube.at(after(60.0 * 12), [])
    assert isinstance(ahead, Icrs)
    assert separation_arcsec(ahead, displaced(PLACE, 36.0, -21.6)) < 1.0


def test_a_jump_moves_the_place_and_teaches_no_drift() -> None:
    tube = TubeEstimate.of(PLACE, BEGIN, 0.2).seen(PLACE, after(60.0), 0.2, [])
    jumped = displaced(PLACE, 300.0, 0.0)
    tube = tube.seen(jumped, after(120.0), 0.2, [])
    at = tube.at(after(120.0), [])
    assert isinstance(at, Icrs)
    assert separation_arcsec(at, jumped) < 1.0
    assert abs(tube.drift_arcsec_s[0]) < 0.05


@given(off=st.floats(-1e5, 1e5), sigma=st.floats(0.01, 50.0), seconds=st.floats(1.0, 3600.0))
def test_no_look_makes_a_drift_that_no_mount_has(off: float, sigma: float, seconds: float) -> None:
    tube = TubeEstimate.of(PLACE, BEGIN, 0.2)
    for n in range(1, 6):
        tube = tube.seen(displaced(PLACE, off * n, 0.0), after(seconds * n), sigma, [])
        assert abs(tube.drift_arcsec_s[0]) <= MOST_DRIFT_ARCSEC_S
        assert tube.east.position2 >= 0.0
        assert tube.east.drift2 >= -1e-12
