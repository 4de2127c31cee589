"""Limits: who is refused, with what words, and when the sky lets them in."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.errors import BadRequest, BadSettings, OutsideLimits
from mountnav.pointing.limits import Limits
from mountnav.sky.chain import icrs_to_observed, observed_to_icrs
from mountnav.sky.coordinates import Air, Icrs, Observed, Site

SITE = Site(48.93, 22.27, 700.0)
AIR = Air(930.0, 5.0, 0.7)
UTC0 = datetime(2026, 11, 21, 22, tzinfo=UTC)


def test_a_target_well_up_passes() -> None:
    Limits(15.0).check(observed_to_icrs(Observed(120.0, 50.0, UTC0), SITE, AIR), UTC0, SITE, AIR)


def test_the_limit_is_of_the_observed_altitude() -> None:
    just_below = observed_to_icrs(Observed(120.0, 14.999, UTC0), SITE, AIR)
    just_above = observed_to_icrs(Observed(120.0, 15.001, UTC0), SITE, AIR)
    Limits(15.0).check(just_above, UTC0, SITE, AIR)
    with pytest.raises(OutsideLimits):
        Limits(15.0).check(just_below, UTC0, SITE, AIR)
    with pytest.raises(OutsideLimits):
        Limits(15.0).check(just_above, UTC0, SITE, Air())  # 3′ of refraction had lifted it


def test_the_refusal_says_where_what_and_when() -> None:
    target = observed_to_icrs(Observed(95.0, 5.0, UTC0), SITE, AIR)
    with pytest.raises(OutsideLimits) as refusal:
        Limits(15.0).check(target, UTC0, SITE, AIR)
    text = str(refusal.value)
    assert "altitude 5.00°" in text
    assert "azimuth 95.00°" in text
    assert "15°" in text
    when = datetime.fromisoformat(re.findall(r"\d{4}-\d\d-\d\dT[\d:]+Z", text)[0])
    assert UTC0 < when < UTC0 + timedelta(hours=3)
    Limits(15.0).check(target, when, SITE, AIR)


def test_what_never_rises_is_said_to_never_rise() -> None:
    with pytest.raises(OutsideLimits, match="24 hours"):
        Limits(15.0).check(Icrs(80.0, -70.0), UTC0, SITE, AIR)


def test_too_near_the_zenith() -> None:
    limits = Limits(15.0, max_altitude_deg=85.0)
    target = observed_to_icrs(Observed(180.0, 88.0, UTC0), SITE, AIR)
    with pytest.raises(OutsideLimits, match="above the limit of 85°"):
        limits.check(target, UTC0, SITE, AIR)
    when = limits.next_allowed(target, UTC0, SITE, AIR)
    assert when is not None
    assert UTC0 < when < UTC0 + timedelta(hours=1)
    limits.check(target, when, SITE, AIR)


@settings(max_examples=25)
@given(
    st.builds(Icrs, st.floats(0.0, 360.0, exclude_max=True), st.floats(-90.0, 90.0)),
    st.builds(Site, st.floats(-75.0, 75.0), st.floats(-180.0, 180.0)),
    st.sampled_from([Limits(15.0), Limits(30.0, 60.0), Limits(-5.0, 70.0)]),
)
def test_the_next_time_is_right(target: Icrs, site: Site, limits: Limits) -> None:
    def allowed(at: datetime) -> bool:
        return limits.allow(icrs_to_observed(target, at, site, AIR).alt_deg)

    when = limits.next_allowed(target, UTC0, site, AIR)
    end = UTC0 + timedelta(days=1) if when is None else when - timedelta(seconds=3)
    # nothing earlier was allowed, looked at every half hour and just before
    looks = [UTC0 + timedelta(minutes=30 * i) for i in range(48)]
    if when is None:
        # what culminates within a hundredth of a degree of the limit may go either way
        wider = Limits(limits.min_altitude_deg + 0.01, limits.max_altitude_deg - 0.01)
        assert not any(wider.allow(icrs_to_observed(target, at, site, AIR).alt_deg) for at in looks)
        return
    assert allowed(when)
    if when > UTC0:
        assert not any(allowed(at) for at in [*looks, end] if UTC0 <= at <= end)


def test_no_sky_between_the_limits() -> None:
    for low_deg, high_deg in [(80.0, 20.0), (-91.0, 90.0), (0.0, 91.0), (float("nan"), 90.0)]:
        with pytest.raises(BadSettings, match="no sky"):
            Limits(low_deg, high_deg)


def test_a_naive_instant_is_refused() -> None:
    with pytest.raises(BadRequest):
        Limits(15.0).check(Icrs(0.0, 0.0), datetime(2026, 11, 21), SITE, AIR)
