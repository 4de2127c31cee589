"""Rates behind INDI: an absolute hour angle rate for what is an offset here."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.indi.codec import rates
from drivers.indi.codec.messages import State
from drivers.indi.codec.state import Property
from mountnav.devices import STARS_RATES, OffsetRates, RateSpan
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S

_SANE = st.floats(-1e4, 1e4, allow_nan=False)


def _property(name: str, perm: str = "rw", **values: Any) -> Property:
    return Property(
        device="Mount",
        name=name,
        kind="Number",
        state=State.OK,
        perm=perm,
        rule="",
        values=dict(values),
        told=datetime(2026, 1, 1, tzinfo=UTC),
        told_s=0.0,
        count=1,
        pushed=None,
    )


@given(_SANE, _SANE)
def test_what_is_said_is_told_again(ra_arcsec_s: float, dec_arcsec_s: float) -> None:
    said = rates.said(OffsetRates(ra_arcsec_s, dec_arcsec_s))
    told = rates.told(_property(rates.RATE, "rw", **said))
    assert told is not None
    assert math.isclose(told.ra_arcsec_s, ra_arcsec_s, abs_tol=1e-11)
    assert told.dec_arcsec_s == dec_arcsec_s


def test_a_star_has_the_rate_that_drivers_define() -> None:
    assert rates.said(STARS_RATES) == {
        "TRACK_RATE_RA": pytest.approx(15.041067178670204, abs=1e-14),
        "TRACK_RATE_DE": 0.0,
    }
    # as it comes over the wire, with six digits, it is below what counts as a rate
    told = rates.told(_property(rates.RATE, TRACK_RATE_RA=15.041067, TRACK_RATE_DE=0.0))
    assert told is not None
    assert abs(told.ra_arcsec_s) < 1e-6
    assert pytest.approx(SIDEREAL_ARCSEC_S, abs=3e-6) == rates.OF_A_STAR_ARCSEC_S


def test_what_goes_east_turns_the_axis_more_slowly() -> None:
    assert rates.said(OffsetRates(10.0, -3.0))["TRACK_RATE_RA"] == pytest.approx(5.041067, abs=1e-6)
    assert rates.said(OffsetRates(10.0, -3.0))["TRACK_RATE_DE"] == -3.0
    # on the ground
    assert rates.said(OffsetRates(rates.OF_A_STAR_ARCSEC_S, 0.0))["TRACK_RATE_RA"] == 0.0


def test_no_numbers_are_no_rates() -> None:
    assert rates.told(None) is None
    assert rates.told(_property(rates.RATE, TRACK_RATE_RA=math.nan, TRACK_RATE_DE=0.0)) is None
    assert rates.told(_property(rates.RATE, TRACK_RATE_RA=1.0)) is None


@pytest.mark.parametrize(
    ("before", "after", "turns"),
    [((15.0, 1.0), (20.0, 2.0), False), ((15.0, 1.0), (20.0, -1.0), True), ((15.0, 0.0), (-1.0, 0.0), True),
     ((15.0, 0.0), (15.0, -3.0), False)],
)  # fmt: skip
def test_an_axis_that_would_turn_back_is_known(
    before: tuple[float, float], after: tuple[float, float], turns: bool
) -> None:
    now = _property(rates.RATE, TRACK_RATE_RA=before[0], TRACK_RATE_DE=before[1])
    assert rates.reverses(now, {"TRACK_RATE_RA": after[0], "TRACK_RATE_DE": after[1]}) is turns


def test_only_what_a_driver_carries_out_is_offered() -> None:
    there = {
        rates.MODE: _property(rates.MODE, TRACK_SIDEREAL=True, TRACK_CUSTOM=False),
        rates.RATE: _property(rates.RATE, TRACK_RATE_RA=15.0, TRACK_RATE_DE=0.0),
    }
    assert rates.takes_offsets(there.get, rates.known("indi_simulator_telescope"))
    assert rates.takes_offsets(there.get, rates.known("indi_ioptronv3_telescope"))
    assert not rates.takes_offsets(there.get, rates.known("indi_lx200_OnStep"))
    there[rates.RATE] = _property(rates.RATE, "ro", TRACK_RATE_RA=15.0, TRACK_RATE_DE=0.0)
    assert not rates.takes_offsets(there.get, rates.known("any"))
    del there[rates.RATE]
    assert not rates.takes_offsets(there.get, rates.known("any"))


def test_speeds_belong_to_switches_in_their_order() -> None:
    there = {
        rates.SPEEDS: _property(rates.SPEEDS, "rw", **{"1x": False, "2x": True, "MAX": False}),
        **{name: _property(name) for name, _, _ in rates.MOTIONS.values()},
    }
    speeds = rates.speeds(there.get, (0.5, 2.0))
    assert speeds == {"1x": 0.5, "2x": 2.0}
    assert rates.spans(speeds)["primary"] == (RateSpan(0.5, 0.5), RateSpan(2.0, 2.0))
    del there["TELESCOPE_MOTION_NS"]
    assert rates.speeds(there.get, (0.5, 2.0)) == {}
    assert rates.spans({}) == {}
