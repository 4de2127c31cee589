"""Targets by rates: where they go, when they end, and what is refused."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.ephemeris import HorizonRatesTarget, SkyRatesTarget, sky_rates
from mountnav.errors import BadRequest
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs
from tests.ephemeris.samples import SITE

BEGIN = datetime(2026, 11, 26, 20, tzinfo=UTC)
AIR = Air(pressure_hpa=830.0)


@given(
    st.floats(0.0, 359.9),
    st.floats(-80.0, 80.0),
    st.floats(-30.0, 30.0),
    st.floats(-3.0, 3.0),
    st.floats(0, 3600),
)
def test_it_moves_by_its_rates(
    ra: float, dec: float, ra_rate: float, dec_rate: float, later_s: float
) -> None:
    target = SkyRatesTarget(Icrs(ra, dec), ra_rate, dec_rate, BEGIN, BEGIN + timedelta(hours=1))
    utc = BEGIN + timedelta(seconds=later_s)
    place = target.icrs(utc, SITE)
    elapsed_s = (utc - BEGIN).total_seconds()
    turned = (place.ra_deg - ra) - ra_rate * elapsed_s / 3600.0
    assert abs((turned + 180.0) % 360.0 - 180.0) < 1e-9
    assert place.dec_deg == pytest.approx(dec + dec_rate * elapsed_s / 3600.0)
    rates = sky_rates(target, utc, SITE)
    assert rates.ra_arcsec_s == pytest.approx(ra_rate, abs=1e-6)
    assert rates.dec_arcsec_s == pytest.approx(dec_rate, abs=1e-6)


def test_over_the_horizon_it_keeps_its_rates() -> None:
    target = HorizonRatesTarget(100.0, 40.0, 30.0, -10.0, BEGIN, BEGIN + timedelta(minutes=30), AIR)
    for minutes in (0, 11, 30):
        utc = BEGIN + timedelta(minutes=minutes)
        seen = icrs_to_observed(target.icrs(utc, SITE), utc, SITE, AIR)
        assert seen.az_deg == pytest.approx(100.0 + 30.0 * minutes / 60.0, abs=1e-5)
        assert seen.alt_deg == pytest.approx(40.0 - 10.0 * minutes / 60.0, abs=1e-5)


def test_what_stands_still_over_the_horizon_moves_with_the_sky() -> None:
    target = HorizonRatesTarget(180.0, 40.0, 0.0, 0.0, BEGIN, BEGIN + timedelta(minutes=30), AIR)
    rates = sky_rates(target, BEGIN + timedelta(minutes=5), SITE)
    assert rates.ra_arcsec_s == pytest.approx(15.041, abs=0.01)


@pytest.mark.parametrize("before", [-1, 1])
def test_it_has_no_place_outside_of_its_span(before: int) -> None:
    target = SkyRatesTarget(Icrs(10.0, 20.0), 1.0, 1.0, BEGIN, BEGIN + timedelta(hours=1))
    utc = BEGIN - timedelta(seconds=1) if before < 0 else BEGIN + timedelta(hours=1, seconds=1)
    with pytest.raises(BadRequest, match="begins at" if before < 0 else "ends at"):
        target.icrs(utc, SITE)
    with pytest.raises(BadRequest, match="time zone"):
        target.icrs(datetime(2026, 11, 26, 20, 30), SITE)


@pytest.mark.parametrize(
    ("dec", "dec_rate", "hours", "says"),
    [
        (89.0, 2.0, 1, "over the pole"),
        (-89.0, -2.0, 1, "over the pole"),
        (0.0, 40_000.0, 1, "no telescope"),
        (0.0, float("nan"), 1, "no telescope"),
        (0.0, 0.0, 0, "can't end"),
        (0.0, 0.0, -1, "can't end"),
        (0.0, 0.0, 49, "too long"),
    ],
)
def test_what_leads_nowhere_is_refused(dec: float, dec_rate: float, hours: int, says: str) -> None:
    with pytest.raises(BadRequest, match=says):
        SkyRatesTarget(Icrs(10.0, dec), 0.0, dec_rate, BEGIN, BEGIN + timedelta(hours=hours))
