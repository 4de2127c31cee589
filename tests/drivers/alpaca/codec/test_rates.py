"""Units, signs and spans of Alpaca's rates."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.alpaca.codec import rates
from drivers.alpaca.codec.base import Malformed
from mountnav.devices import PierSide, RateSpan

_SANE = st.floats(-1e4, 1e4, allow_nan=False)


@given(_SANE, _SANE)
def test_what_is_said_is_told_again(ra_arcsec_s: float, dec_arcsec_s: float) -> None:
    told = rates.told_rates(rates.said_ra_rate(ra_arcsec_s), dec_arcsec_s)
    assert math.isclose(told.ra_arcsec_s, ra_arcsec_s, rel_tol=1e-12, abs_tol=1e-12)
    assert told.dec_arcsec_s == dec_arcsec_s


def test_a_right_ascension_rate_is_in_seconds_per_sidereal_second() -> None:
    # 15″ per SI second are one second of right ascension, in the time of 1.0027379 sidereal seconds
    assert rates.said_ra_rate(15.0) == pytest.approx(0.9972695677, rel=3e-9)
    assert rates.told_rates(1.0, 0.0).ra_arcsec_s == pytest.approx(15.0 / 0.9972695677, rel=3e-9)
    # a place that rests on the ground moves east among the stars by one sidereal second in each
    assert rates.told_rates(1.0, 0.0).ra_arcsec_s == pytest.approx(15.041067, abs=2e-6)


@pytest.mark.parametrize("bad", [None, "1", True, math.nan, math.inf, 1e7, [1.0]])
def test_what_is_no_rate_is_malformed(bad: object) -> None:
    with pytest.raises(Malformed):
        rates.told_rates(bad, 0.0)
    with pytest.raises(Malformed):
        rates.told_rates(0.0, bad)


def test_spans_are_ordered_and_joined() -> None:
    said = [
        {"Minimum": 3.0, "Maximum": 3.0},
        {"maximum": 2.0, "minimum": 0.5},
        {"Minimum": 0.0, "Maximum": 0.0},
        {"Minimum": 1.0, "Maximum": 2.5},
    ]
    assert rates.spans(said) == (RateSpan(0.5, 2.5), RateSpan(3.0, 3.0))
    assert rates.spans([]) == ()


@pytest.mark.parametrize(
    "bad",
    [
        None,
        {},
        [1.0],
        [{"Minimum": 1.0}],
        [{"Minimum": 2.0, "Maximum": 1.0}],
        [{"Minimum": -1.0, "Maximum": 1.0}],
        [{"Minimum": 0.0, "Maximum": math.nan}],
        [{"Minimum": 0.0, "Maximum": 1e9}],
        [{"Minimum": 0.0, "Maximum": 1.0}] * 65,
    ],
)
def test_what_are_no_spans_is_malformed(bad: object) -> None:
    with pytest.raises(Malformed):
        rates.spans(bad)


@given(st.lists(st.tuples(st.floats(0.0, 10.0), st.floats(0.0, 10.0)), max_size=8))
def test_spans_never_overlap_and_cover_what_was_said(pairs: list[tuple[float, float]]) -> None:
    said = [{"Minimum": min(pair), "Maximum": max(pair)} for pair in pairs]
    read = rates.spans(said)
    assert all(one.most_deg_s < other.least_deg_s for one, other in itertools.pairwise(read))
    for pair in pairs:
        if max(pair) > 0.0:
            assert any(one.least_deg_s <= min(pair) and max(pair) <= one.most_deg_s for one in read)


def test_usual_signs() -> None:
    assert rates.usual_sign("primary", PierSide.EAST, alt_az=False) == -1.0
    assert rates.usual_sign("primary", PierSide.EAST, alt_az=True) == 1.0
    assert rates.usual_sign("secondary", PierSide.WEST, alt_az=False) == -1.0
    assert rates.usual_sign("secondary", None, alt_az=False) == 1.0
