"""What is drawn straight between full hours, against ERFA's own series at the instant."""

import random

import erfa
import numpy as np
import pytest

from mountnav.sky.slow_parts import slow_parts

ARCSEC = np.radians(1.0 / 3600.0)


@pytest.mark.parametrize("year", [1972, 1990, 2026, 2063, 2099])
def test_it_is_what_the_series_give(year: int) -> None:
    chance = random.Random(year)
    for _ in range(60):
        tt1, tt2 = 2451544.5 + (year - 2000) * 365.25, chance.uniform(0.0, 365.0)
        got = slow_parts(tt1, tt2)
        heliocentric, barycentric = erfa.epv00(tt1, tt2)
        matrix = erfa.pnm06a(tt1, tt2)
        # an element of a rotation's matrix is off by no more than the rotation
        assert np.abs(got.matrix - matrix).max() < 2e-5 * ARCSEC
        s_rad = erfa.s06(tt1, tt2, *erfa.bpn2xy(matrix))
        assert abs(got.s_rad - s_rad) < 1e-7 * ARCSEC
        # 1.2e-5″ of aberration; of the way 20 km, of which no star's parallax tells
        assert np.abs(got.barycentric["v"] - barycentric["v"]).max() < 1e-8
        assert np.abs(got.barycentric["p"] - barycentric["p"]).max() < 1.3e-7
        assert np.abs(got.heliocentric - heliocentric["p"]).max() < 1.3e-7


def test_it_goes_on_without_a_step_over_a_full_hour() -> None:
    hour = 10.0 / 24.0
    before, after = (slow_parts(2461366.5, hour + off) for off in (-1e-9, 1e-9))
    assert np.abs(before.matrix - after.matrix).max() < 1e-6 * ARCSEC
    assert np.abs(before.barycentric["v"] - after.barycentric["v"]).max() < 1e-9


def test_the_split_of_the_date_does_not_matter() -> None:
    one, other = slow_parts(2461366.5, 0.3), slow_parts(2461367.0, -0.2)
    assert np.abs(one.matrix - other.matrix).max() < 1e-6 * ARCSEC
