"""Rates by looks: measured with honest errors; faults named where nothing else explains them, only there."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.devices import STARS_RATES, OffsetRates, PierSide
from mountnav.measuring.measurements import SkyQuality, StarImages
from mountnav.navigation.rates_measured import (
    OrderedRates,
    RateLook,
    SeenRates,
    ordered_between,
    rates_of,
    trail_of,
)
from mountnav.navigation.rates_seen import RateCorrection, RateDoubts, RateFault, RatesJudgement, judge_rates
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S, SOLAR_TO_SIDEREAL, Icrs
from mountnav.sky.sphere import turn_deg

BEGIN = datetime(2026, 11, 21, 20, 0, tzinfo=UTC)
SIGMA = 0.2
F = RateFault

STEADY = RateDoubts(worm_arcsec=1.0, play_arcsec=0.5, axis_off_rad=1e-4)
"""A mount whose worm is good, on an axis that is set up well."""

Law = Callable[[float, float, float], tuple[float, float]]
FAULTS: dict[RateFault, Law] = {
    F.IGNORED: lambda ra, dec, c: (0.0, 0.0),
    F.ONLY_RA: lambda ra, dec, c: (ra, 0.0),
    F.ONLY_DEC: lambda ra, dec, c: (0.0, dec),
    F.SIGN_RA: lambda ra, dec, c: (-ra, dec),
    F.SIGN_DEC: lambda ra, dec, c: (ra, -dec),
    F.SIGNS: lambda ra, dec, c: (-ra, -dec),
    F.FACTOR_15: lambda ra, dec, c: (ra * SIDEREAL_ARCSEC_S, dec),
    F.FACTOR_1_15: lambda ra, dec, c: (ra / SIDEREAL_ARCSEC_S, dec),
    F.FACTOR_220: lambda ra, dec, c: (ra * 220.0, dec),
    F.COS_MISSING: lambda ra, dec, c: (ra / c, dec),
    F.COS_TWICE: lambda ra, dec, c: (ra * c, dec),
    F.SWAPPED: lambda ra, dec, c: (dec, ra),
}


def looks_at(
    true: OffsetRates,
    times_s: list[float],
    *,
    dec_deg: float = 40.0,
    sigma: float = SIGMA,
    seed: int = 0,
    drift: OffsetRates = STARS_RATES,
    worm: tuple[float, float] = (0.0, 480.0),
    side: PierSide = PierSide.UNKNOWN,
) -> list[RateLook]:
    """Looks of a mount that truly keeps these rates."""
    chance = np.random.default_rng(seed)
    cosine = math.cos(math.radians(dec_deg))
    looks = []
    for t in times_s:
        periodic = worm[0] * math.sin(math.tau * t / worm[1] + seed)
        ra = (true.ra_arcsec_s + drift.ra_arcsec_s) * t + periodic + chance.normal(0.0, sigma) / cosine
        dec = (true.dec_arcsec_s + drift.dec_arcsec_s) * t + chance.normal(0.0, sigma)
        place = Icrs(turn_deg(359.999 + ra / 3600.0), dec_deg + dec / 3600.0)
        looks.append(RateLook(BEGIN + timedelta(seconds=t), place, sigma, side))
    return looks


def judged(ordered: OffsetRates, looks: list[RateLook], **given: object) -> RatesJudgement:
    sent = [OrderedRates(BEGIN - timedelta(seconds=5), ordered)]
    return judge_rates(sent, looks, **given)  # type: ignore[arg-type]


@given(
    ra=st.floats(-100.0, 100.0),
    dec=st.floats(-100.0, 100.0),
    dec_deg=st.floats(-80.0, 80.0),
    seed=st.integers(0, 10_000),
)
def test_rates_are_measured_within_their_errors(ra: float, dec: float, dec_deg: float, seed: int) -> None:
    true = OffsetRates(ra, dec)
    seen = rates_of(looks_at(true, [0.0, 20.0, 45.0, 60.0], dec_deg=dec_deg, seed=seed))
    assert seen is not None
    assert abs(seen.rates.ra_arcsec_s - ra) < 6.0 * seen.ra_sigma_arcsec_s
    assert abs(seen.rates.dec_arcsec_s - dec) < 6.0 * seen.dec_sigma_arcsec_s
    assert seen.looks == 4
    assert seen.span_s == pytest.approx(60.0)


def test_the_stated_errors_are_those_that_are_made() -> None:
    off = []
    for seed in range(400):
        seen = rates_of(looks_at(OffsetRates(0.5, -0.3), [0.0, 20.0, 40.0], seed=seed), time_sigma_s=0.0)
        assert seen is not None
        off.append((seen.rates.ra_arcsec_s - 0.5) / seen.ra_sigma_arcsec_s)
        off.append((seen.rates.dec_arcsec_s + 0.3) / seen.dec_sigma_arcsec_s)
    # three looks leave one degree of freedom, and scatter may only make the errors larger
    assert 0.6 < float(np.std(off)) < 1.1
    assert abs(float(np.mean(off))) < 0.15


def test_one_look_or_one_instant_gives_no_rates() -> None:
    looks = looks_at(OffsetRates(1.0, 1.0), [0.0, 10.0])
    assert rates_of(looks[:1]) is None
    assert rates_of([looks[0], looks[0]]) is None
    assert judge_rates([], []).verdict == "too-early"
    assert judged(OffsetRates(1.0, 1.0), looks[:1]).verdict == "too-early"


def test_rates_that_were_renewed_are_compared_with_their_average() -> None:
    # a target that speeds up, followed rightly by rates renewed each 10 s
    sent = [
        OrderedRates(BEGIN + timedelta(seconds=10.0 * n), OffsetRates(5.0 + 0.5 * n, -2.0)) for n in range(7)
    ]
    looks = []
    for t in (0.0, 13.0, 30.0, 47.0, 61.0):
        utc = BEGIN + timedelta(seconds=t)
        ra, dec = ordered_between(sent, BEGIN, utc)
        looks.append(RateLook(utc, Icrs(10.0 + ra / 3600.0, 20.0 + dec / 3600.0), SIGMA))
    judgement = judge_rates(sent, looks)
    assert judgement.measured is not None
    assert judgement.measured.rates.ra_arcsec_s == pytest.approx(
        judgement.measured.ordered.ra_arcsec_s, abs=1e-6
    )
    assert 5.5 < judgement.measured.ordered.ra_arcsec_s < 8.0
    assert judgement.verdict == "right"


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("seed", range(5))
def test_each_fault_is_named_and_its_correction_makes_it_good(fault: RateFault, seed: int) -> None:
    chance = np.random.default_rng(seed)
    dec_deg = float(chance.choice([-1.0, 1.0]) * chance.uniform(35.0, 70.0))
    cosine = math.cos(math.radians(dec_deg))
    ordered = OffsetRates(float(chance.choice([-3.0, 3.0])), float(chance.choice([-1.2, 1.2])))
    law = FAULTS[fault]
    true = OffsetRates(*law(ordered.ra_arcsec_s, ordered.dec_arcsec_s, cosine))
    at_rest = rates_of(looks_at(STARS_RATES, [-200.0, -100.0, -20.0], dec_deg=dec_deg, seed=seed + 50))
    looks = looks_at(true, [0.0, 60.0, 120.0, 200.0], dec_deg=dec_deg, seed=seed)
    judgement = judged(ordered, looks, doubts=STEADY, drift=at_rest)
    assert judgement.fault is fault, judgement.words
    if judgement.correction is None:
        assert fault in (F.IGNORED, F.ONLY_RA, F.ONLY_DEC)
        return
    sent = judgement.correction.sent(ordered, dec_deg)
    kept = law(sent.ra_arcsec_s, sent.dec_arcsec_s, cosine)
    assert kept == pytest.approx((ordered.ra_arcsec_s, ordered.dec_arcsec_s))
    again = RateCorrection.of_dict(judgement.correction.as_dict())
    assert again == judgement.correction


@pytest.mark.parametrize(
    ("factor", "fault"), [(SOLAR_TO_SIDEREAL, F.FACTOR_SIDEREAL), (1 / SOLAR_TO_SIDEREAL, F.FACTOR_SOLAR)]
)
def test_sidereal_seconds_are_told_from_seconds_where_time_and_speed_suffice(
    factor: float, fault: RateFault
) -> None:
    ordered = OffsetRates(20.0, 20.0)
    true = OffsetRates(20.0 * factor, 20.0 * factor)
    soon = judged(ordered, looks_at(true, [0.0, 20.0], dec_deg=2.0))
    assert soon.fault is None, soon.words
    looks = looks_at(true, [60.0 * n for n in range(11)], dec_deg=2.0)
    at_rest = rates_of(looks_at(STARS_RATES, [-60.0 * n for n in range(1, 9)], dec_deg=2.0))
    # an axis that may be 10′ off bends the way by as much
    assert judged(ordered, looks, drift=at_rest).fault is None
    later = judged(ordered, looks, doubts=STEADY, drift=at_rest)
    assert later.fault is fault, later.words


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(
    ra=st.floats(-60.0, 60.0),
    dec=st.floats(-60.0, 60.0),
    dec_deg=st.floats(-85.0, 85.0),
    drift_ra=st.floats(-0.08, 0.08),
    drift_dec=st.floats(-0.08, 0.08),
    worm=st.floats(0.0, 12.0),
    span=st.floats(5.0, 1800.0),
    looks=st.integers(2, 6),
    seed=st.integers(0, 2**31),
)
def test_no_fault_is_named_where_there_is_none(
    ra: float,
    dec: float,
    dec_deg: float,
    drift_ra: float,
    drift_dec: float,
    worm: float,
    span: float,
    looks: int,
    seed: int,
) -> None:
    true = OffsetRates(ra, dec)
    cosine = math.cos(math.radians(dec_deg))
    seen = looks_at(
        true,
        [span * n / (looks - 1) for n in range(looks)],
        dec_deg=dec_deg,
        seed=seed,
        drift=OffsetRates(drift_ra / cosine, drift_dec),
        worm=(worm, 480.0),
    )
    judgement = judged(true, seen)
    assert judgement.verdict in ("right", "too-early"), judgement.words
    assert judgement.correction is None


def test_a_drift_seen_before_is_taken_off() -> None:
    # 0.3″/s of drift: of a tripod that sinks, more than any that is expected
    drift = OffsetRates(0.3, -0.3)
    before = rates_of(looks_at(OffsetRates(0.0, 0.0), [0.0, 30.0, 60.0], drift=drift))
    assert before is not None
    ordered = OffsetRates(0.0, 0.5)
    looks = looks_at(ordered, [100.0, 130.0, 170.0], drift=drift)
    assert judged(ordered, looks, drift=before).verdict in ("right", "too-early")
    without = judged(ordered, looks)
    assert without.correction is None


def test_a_drift_alone_is_never_made_good_as_if_it_were_a_fault() -> None:
    # as large as the ordered rate, and against it
    looks = looks_at(OffsetRates(0.05, 0.05), [0.0, 60.0, 120.0, 600.0], drift=OffsetRates(-0.1, -0.1))
    assert judged(OffsetRates(0.05, 0.05), looks).correction is None


def test_what_no_fault_explains_is_measured_and_never_corrected() -> None:
    judgement = judged(OffsetRates(3.0, 1.0), looks_at(OffsetRates(7.7, -4.1), [0.0, 30.0, 60.0]))
    assert judgement.verdict == "unexplained"
    assert judgement.fault is F.UNEXPLAINED
    assert judgement.correction is None
    assert "unexplained, measured so" in judgement.words


def test_faults_that_look_alike_are_told_and_not_corrected() -> None:
    # of equal and opposite rates, swapped axes are the same as two wrong signs
    judgement = judged(
        OffsetRates(2.0, -2.0), looks_at(OffsetRates(-2.0, 2.0), [0.0, 30.0, 60.0], dec_deg=0.0)
    )
    assert judgement.verdict == "ambiguous"
    assert set(judgement.could_be) == {F.SIGNS, F.SWAPPED}
    assert judgement.correction is None


def test_a_coordinate_without_a_rate_says_nothing_and_is_left_as_it_is() -> None:
    judgement = judged(OffsetRates(0.0, 2.0), looks_at(OffsetRates(0.0, -2.0), [0.0, 30.0, 60.0]))
    assert judgement.fault is F.SIGN_DEC
    assert judgement.correction is not None
    assert judgement.correction.sent(OffsetRates(1.0, 2.0), 40.0) == OffsetRates(1.0, -2.0)


def test_rates_that_were_kept_before_a_slew_or_a_flip_were_lost_there() -> None:
    looks = looks_at(OffsetRates(0.0, 0.0), [0.0, 30.0, 60.0])
    ordered = OffsetRates(30.0, 10.0)
    assert judged(ordered, looks, kept_before=True, since="slew").fault is F.FORGOTTEN
    assert judged(ordered, looks, kept_before=True, since="flip").fault is F.LOST_AT_FLIP
    assert judged(ordered, looks, kept_before=False, since="flip").fault is F.IGNORED


def test_a_wrong_sign_holds_for_its_side_of_the_pier_alone() -> None:
    looks = looks_at(OffsetRates(3.0, -1.0), [0.0, 30.0, 60.0], side=PierSide.WEST)
    correction = judged(OffsetRates(3.0, 1.0), looks).correction
    assert correction is not None
    assert correction.holds(PierSide.WEST)
    assert not correction.holds(PierSide.EAST)


def test_near_the_pole_nothing_is_named() -> None:
    judgement = judged(OffsetRates(100.0, 0.0), looks_at(OffsetRates(0.0, 0.0), [0.0, 60.0], dec_deg=88.5))
    assert judgement.verdict == "too-early"


@pytest.mark.parametrize(
    "data",
    [
        {},
        {"fault": "ignored", "ra": "none", "dec": "none", "swapped": False, "side": "unknown"},
        {"fault": "sign-ra", "ra": "x220", "dec": "right", "swapped": False, "side": "unknown"},
        {"fault": "sign-ra", "ra": "reversed", "dec": "right", "swapped": False, "side": "south"},
        {"fault": "unexplained", "ra": "right", "dec": "right", "swapped": False, "side": "unknown"},
    ],
)
def test_a_correction_that_can_not_be_one_is_not_read(data: dict[str, object]) -> None:
    assert RateCorrection.of_dict(data) is None


# -- trails ------------------------------------------------------------------------------------------


def quality(
    trail_px: float, angle_deg: float, *, sigma_px: float = 1.2, ellipticity: float = 0.05
) -> SkyQuality:
    """Of stars drawn out by so much, by the second moments."""
    across = sigma_px * math.sqrt(1.0 - ellipticity)
    along = math.sqrt(sigma_px**2 / (1.0 - ellipticity) + trail_px**2 / 12.0)
    return SkyQuality(
        stars=50,
        images=StarImages.TRAILED if trail_px > 3 else StarImages.WELL_SAMPLED,
        fwhm_px=2.3548 * math.sqrt(along * across),
        ellipticity=1.0 - across / along,
        elongation_deg=angle_deg,
        sky_adu=400.0,
        noise_adu=8.0,
        sky_gradient=0.5,
        limiting_flux_adu=120.0,
        saturated_share=0.0,
    )


@given(
    length=st.floats(6.0, 60.0),
    angle=st.floats(-90.0, 89.9),
    turned=st.floats(0.0, 359.9),
    parity=st.sampled_from([-1, 1]),
)
def test_a_trail_has_the_length_and_direction_that_it_was_given(
    length: float, angle: float, turned: float, parity: int
) -> None:
    trail = trail_of(
        quality(length, angle), scale_arcsec_px=2.0, rotation_deg=turned, parity=parity, exposure_s=10.0
    )
    assert trail is not None
    assert abs(trail.length_arcsec - 2.0 * length) < 3.0 * trail.sigma_arcsec
    # +y looks along the position angle `turned`, +x to its right as the sky is seen, which is west
    expected = turned + parity * (angle - 90.0)
    apart = (trail.position_angle_deg - expected + 90.0) % 180.0 - 90.0
    assert abs(apart) < 1e-6


def test_round_stars_show_no_trail() -> None:
    trail = trail_of(quality(0.0, 0.0), scale_arcsec_px=2.0, rotation_deg=0.0, parity=1, exposure_s=10.0)
    assert trail is not None
    assert trail.length_arcsec < 2.0 * trail.sigma_arcsec


def test_one_frame_tells_an_ignored_rate_but_no_sign() -> None:
    ordered = OffsetRates(0.0, 60.0)
    drawn = trail_of(quality(300.0, 90.0), scale_arcsec_px=2.0, rotation_deg=0.0, parity=1, exposure_s=10.0)
    round_ = trail_of(quality(0.0, 0.0), scale_arcsec_px=2.0, rotation_deg=0.0, parity=1, exposure_s=10.0)
    place = Icrs(10.0, 40.0)
    kept = judged(ordered, [RateLook(BEGIN, place, SIGMA, trail=drawn)])
    # as long as it should be; by which end the tube began no trail says
    assert kept.verdict == "too-early", kept.words
    ignored = judged(ordered, [RateLook(BEGIN, place, SIGMA, trail=round_)])
    assert ignored.fault is F.IGNORED, ignored.words
    assert ignored.correction is None


def test_trails_and_centers_together_contradict_what_either_might_be() -> None:
    measured: SeenRates | None = rates_of(looks_at(OffsetRates(0.0, 0.0), [0.0, 10.0]))
    assert measured is not None
    # centers that stand, stars drawn out by 600″: nothing known does both
    drawn = trail_of(quality(300.0, 90.0), scale_arcsec_px=2.0, rotation_deg=0.0, parity=1, exposure_s=10.0)
    looks = [
        RateLook(one.utc, one.place, one.sigma_arcsec, one.side, drawn)
        for one in looks_at(OffsetRates(0.0, 0.0), [0.0, 60.0, 120.0])
    ]
    judgement = judged(OffsetRates(0.0, 60.0), looks)
    assert judgement.verdict == "unexplained", judgement.words
