"""Plans of following: by what, how often rates are renewed, what is left, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.devices import OffsetRates
from mountnav.errors import DeviceRefused
from mountnav.navigation.follow_plan import (
    LONGEST_S,
    SHORTEST_S,
    FollowBy,
    Means,
    mount_rates,
    plan_follow,
)
from mountnav.sky.coordinates import Icrs

BEGIN = datetime(2026, 11, 21, 20, 0, tzinfo=UTC)
END = BEGIN + timedelta(minutes=20)
ALL = Means(True, None, 7200.0, 0.1, (0.00209, 0.00209), 8.0, "a mount")


def bending(ra: float, dec: float, ra_s: float = 0.0, dec_s: float = 0.0):
    """A path with these rates at the beginning, changing evenly."""

    def path(utc: datetime) -> Icrs:
        t = (utc - BEGIN).total_seconds()
        return Icrs(
            100.0 + (ra * t + 0.5 * ra_s * t * t) / 3600.0, 10.0 + (dec * t + 0.5 * dec_s * t * t) / 3600.0
        )

    return path


@given(ra=st.floats(-50.0, 50.0), dec=st.floats(-20.0, 20.0))
def test_rates_of_a_path_are_those_that_it_was_made_with(ra: float, dec: float) -> None:
    found = mount_rates(bending(ra, dec), BEGIN, "icrs", 10.0)
    assert found.ra_arcsec_s == pytest.approx(ra, abs=1e-6)
    assert found.dec_arcsec_s == pytest.approx(dec, abs=1e-6)


def test_even_rates_are_renewed_seldom_and_bent_ones_often() -> None:
    even = plan_follow(bending(1.0, 1.0), BEGIN, END, "icrs", ALL, 5.0)
    bent = plan_follow(bending(1.0, 1.0, 0.0, 0.01), BEGIN, END, "icrs", ALL, 5.0)
    assert (even.by, bent.by) == (FollowBy.RATES, FollowBy.RATES)
    assert even.renew_s == LONGEST_S
    assert SHORTEST_S <= bent.renew_s < 25.0
    # what constant rates leave of a parabola
    assert bent.bends_arcsec_s2 == pytest.approx(0.01, rel=0.1)
    assert bent.left_arcsec <= 0.1 * 5.0 * 1.01
    assert bent.fastest.dec_arcsec_s == pytest.approx(13.0, rel=0.02)


def test_a_pass_that_bends_faster_than_rates_can_be_renewed_is_refused() -> None:
    slow = replace(ALL, order_s=20.0, guide_deg_s=None)
    with pytest.raises(DeviceRefused, match="renewed each"):
        plan_follow(bending(10.0, 0.0, 5.0, 0.0), BEGIN, BEGIN + timedelta(seconds=60), "icrs", slow, 5.0)


@pytest.mark.parametrize(
    ("means", "ra", "by"),
    [
        (ALL, 1.0, FollowBy.RATES),
        (replace(ALL, takes_rates=False), 1.0, FollowBy.PULSES),
        (replace(ALL, most=OffsetRates(0.5, 0.5)), 1.0, FollowBy.PULSES),
        (replace(ALL, takes_rates=False, guide_deg_s=None), 1.0, FollowBy.SLEWS),
    ],
)
def test_the_best_means_that_suffice_are_taken(means: Means, ra: float, by: FollowBy) -> None:
    plan = plan_follow(bending(ra, 0.0), BEGIN, END, "icrs", means, 5.0)
    assert plan.by is by
    assert f"{plan.left_arcsec:.2g}″" in plan.words


@pytest.mark.parametrize(
    "means",
    [
        replace(ALL, takes_rates=False),
        replace(ALL, most=OffsetRates(10.0, 10.0)),
        replace(ALL, most_arcsec_s=20.0),
    ],
)
def test_what_no_means_suffice_for_is_refused_with_the_numbers(means: Means) -> None:
    with pytest.raises(DeviceRefused) as refused:
        plan_follow(bending(40.0, 0.0), BEGIN, END, "icrs", means, 5.0)
    assert f"{40.0 * math.cos(math.radians(10.0)):.4g}″/s" in refused.value.what
    assert "nothing was moved" in (refused.value.advice or "")


def test_fast_targets_are_told_from_slow_ones() -> None:
    assert not plan_follow(bending(50.0, 0.0), BEGIN, END, "icrs", ALL, 5.0).fast
    assert plan_follow(bending(100.0, 0.0), BEGIN, END, "icrs", ALL, 5.0).fast


def test_small_slews_promise_no_less_than_the_mounts_steps_allow() -> None:
    coarse = replace(ALL, takes_rates=False, guide_deg_s=None, step_arcsec=15.0)
    plan = plan_follow(bending(0.05, 0.02), BEGIN, END, "icrs", coarse, 5.0)
    assert plan.by is FollowBy.SLEWS
    assert plan.left_arcsec >= 7.5 + 0.05 * 8.0
    assert "7.5″ of it by the mount's steps" in plan.words
    fine = plan_follow(bending(0.05, 0.02), BEGIN, END, "icrs", replace(coarse, step_arcsec=0.0), 5.0)
    assert fine.left_arcsec == pytest.approx(plan.left_arcsec - 7.5)
    assert "steps" not in fine.words
