"""Where a mount may be by its own rates: all of its way, nothing beside it, and both after a change."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.generic.drift import Drift
from mountnav.devices import STARS_RATES, OffsetRates, moved_on
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec

NOW = datetime(2026, 11, 21, 22, tzinfo=UTC)
RATE = st.floats(-5000.0, 5000.0)
PLACES = st.builds(Icrs, st.floats(0.0, 359.99), st.floats(-80.0, 80.0))


def drift_at(*rates: OffsetRates) -> Drift:
    drift = Drift(clock=lambda: NOW)
    for one in rates:
        drift.going_out(one)
        drift.settled(one)
    return drift


@given(PLACES, RATE, RATE, st.floats(0.01, 5.0), st.floats(0.0, 1.0))
def test_all_of_its_way_is_within_reach(
    place: Icrs, ra_arcsec_s: float, dec_arcsec_s: float, seconds: float, share: float
) -> None:
    rates = OffsetRates(ra_arcsec_s, dec_arcsec_s)
    drift = drift_at(rates)
    drift.read(NOW + timedelta(seconds=1.0))
    after = moved_on(place, rates, share * seconds)
    way = separation_arcsec(place, moved_on(place, rates, seconds))  # type: ignore[type-var]
    # the way along a parallel is no great circle: bent by less than a hundredth of it
    assert drift.beyond_arcsec(place, after, seconds) <= 1e-3 + 0.01 * way


@given(PLACES, st.floats(-100.0, 100.0), st.floats(-100.0, 100.0), st.floats(50.0, 5000.0), st.booleans())
def test_what_lies_beside_its_way_counts(
    place: Icrs, ra_arcsec_s: float, dec_arcsec_s: float, off_arcsec: float, north: bool
) -> None:
    rates = OffsetRates(ra_arcsec_s, dec_arcsec_s)
    drift = drift_at(rates)
    drift.read(NOW + timedelta(seconds=1.0))
    seconds = 1.0
    way = separation_arcsec(place, moved_on(place, rates, seconds))  # type: ignore[type-var]
    after = displaced(place, 0.0 if north else off_arcsec, off_arcsec if north else 0.0)
    beyond = drift.beyond_arcsec(place, after, seconds)
    assert beyond >= off_arcsec - way - 1.0
    assert beyond <= off_arcsec + 1.0


def test_without_rates_a_distance_is_a_distance() -> None:
    here, there = Icrs(10.0, 20.0), Icrs(10.0, 20.01)
    assert Drift().beyond_arcsec(here, there, 100.0) == pytest.approx(36.0, abs=1e-6)


def test_after_a_change_both_rates_may_have_been_in_force() -> None:
    east, north = OffsetRates(100.0, 0.0), OffsetRates(0.0, 100.0)
    drift = drift_at(east, north)
    corner = displaced(Icrs(10.0, 0.0), 50.0, 50.0)
    assert drift.beyond_arcsec(Icrs(10.0, 0.0), corner, 1.0) == 0.0
    drift.read(NOW + timedelta(seconds=1.0))
    assert drift.may == (north,)
    assert drift.beyond_arcsec(Icrs(10.0, 0.0), corner, 1.0) == pytest.approx(50.0, abs=0.1)


def test_what_is_known_and_whose_it_is() -> None:
    drift = Drift(clock=lambda: NOW)
    assert drift.known is None
    assert not drift.to_end
    rates = OffsetRates(1.0, 0.0)
    drift.found(rates)
    assert drift.to_end
    assert not drift.ours
    drift.going_out(rates)
    assert drift.known is None
    assert drift.ours
    drift.settled(rates)
    drift.read(NOW - timedelta(seconds=1.0))
    assert drift.to_end
    drift.unknown()
    assert drift.known is None
    assert drift.ours
    drift.going_out(STARS_RATES)
    assert drift.ours, "whether it has ended them isn't known yet"
    drift.settled(STARS_RATES)
    assert not drift.ours
    assert not drift.to_end


def test_of_many_changes_the_fastest_is_kept() -> None:
    drift = Drift(clock=lambda: NOW)
    for rate in (5000.0, 1.0, 2.0, 3.0):
        drift.going_out(OffsetRates(rate, 0.0))
    assert max(one.ra_arcsec_s for one in drift.may) == 5000.0
