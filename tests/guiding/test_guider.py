"""The guider over known disturbances: what it corrects, what it leaves, tells, and survives."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.errors import BadRequest
from mountnav.guiding.actuator import Actuator
from mountnav.guiding.guider import Correction, Guider, LookFate
from tests.guiding.nights import Held, still


def test_a_drift_is_taken_away_and_told_with_its_error() -> None:
    held = Held(lambda t: (1.2 * t / 60.0, -0.5 * t / 60.0))
    held.go(120)
    assert held.rms(0, 80) < 0.35
    assert held.rms(1, 80) < 0.35
    primary, secondary = held.guider.state(0.3)
    for state, true in ((primary, 1.2 / 60.0), (secondary, -0.5 / 60.0)):
        assert 0.0 < state.rate_sigma_arcsec_s < 0.005
        assert abs(state.rate_arcsec_s - true) < 4.0 * state.rate_sigma_arcsec_s + 1e-4


@pytest.mark.long
@pytest.mark.parametrize("seed", range(12))
def test_a_mount_that_stands_still_is_hardly_disturbed(seed: int) -> None:
    held = Held(still, noise=1.0, seed=seed)
    held.go(150)
    # a look scatters by 1″: whoever corrected what looks show would put that into the sky
    assert max(held.rms(0, 150), held.rms(1, 150)) < 0.5


def test_a_mount_without_noise_that_stands_still_is_never_touched() -> None:
    held = Held(still, noise=1e-6)
    held.go(50)
    assert all(one.none for one in held.corrections)


@pytest.mark.long
@pytest.mark.parametrize("told", [True, False])
def test_a_worm_is_learned_and_fed_forward(told: bool) -> None:
    def worm(t: float) -> tuple[float, float]:
        return 12.0 * math.sin(math.tau * t / 480.0) + 2.0 * math.sin(2.0 * math.tau * t / 480.0 + 1.0), 0.0

    held = Held(worm, noise=0.4, every_s=30.0, primary=Actuator("both"), period_s=480.0 if told else None)
    held.go(150)
    assert held.guider.primary.period_s == pytest.approx(480.0, rel=0.01)
    state = held.guider.primary.state(0.4)
    assert state.amplitudes_arcsec[0] == pytest.approx(12.0, abs=0.6)
    assert state.amplitudes_arcsec[1] == pytest.approx(2.0, abs=0.6)
    # 8.5″ by itself; steps that only follow would be 2″ behind
    assert held.rms(0, 90) < 0.6
    # without a look it goes on by what it knows
    held.go(4, solved=lambda _: False)
    assert held.rms(0, 4) < 1.5


def test_rates_alone_hold_as_well() -> None:
    held = Held(lambda t: (0.03 * t, 0.0), primary=Actuator("rates", step_arcsec=0.0))
    held.go(100)
    assert held.rms(0, 60) < 0.4
    assert all(step == 0.0 for step in held.steps(0))
    assert held.corrections[-1].primary.rate_arcsec_s == pytest.approx(-0.03, abs=0.02)


def test_one_wrong_look_is_left_aside_and_moves_nothing() -> None:
    held = Held(lambda t: (0.01 * t, 0.0))
    held.go(40)
    before = len(held.corrections)
    held.go(1, wrong=400.0)
    assert held.fates[-1] is LookFate.GATED
    assert held.corrections[before].none
    held.go(10)
    assert set(held.fates[-10:]) == {LookFate.TAKEN}
    assert held.rms(0, 8) < 0.5


def test_a_real_jump_is_believed_by_the_second_look() -> None:
    held = Held(lambda t: (0.01 * t + (25.0 if t > 900.0 else 0.0), 0.0))
    held.go(80)
    assert held.fates.count(LookFate.GATED) == 1
    assert held.fates.count(LookFate.JUMP) == 1
    assert held.rms(0, 25) < 0.5


def test_two_wrong_looks_of_different_places_are_no_jump() -> None:
    held = Held(still)
    held.go(30)
    held.go(1, wrong=300.0)
    held.go(1, wrong=-200.0)
    assert held.fates[-2:] == [LookFate.GATED, LookFate.GATED]
    assert all(one.none for one in held.corrections[-2:])


def test_a_place_far_off_is_never_followed() -> None:
    held = Held(still)
    held.go(20)
    for _ in range(5):
        held.go(1, wrong=4000.0)
    assert set(held.fates[-5:]) == {LookFate.GATED}
    assert all(one.none for one in held.corrections[-5:])


@pytest.mark.long
@pytest.mark.parametrize("told", [15.0, None])
def test_play_is_learned_and_taken_up(told: float | None) -> None:
    # the drift turns round in the middle: the motor has to, too
    held = Held(
        lambda t: (0.0, 18.0 * math.sin(math.tau * t / 5400.0)), play_arcsec=15.0, told_play=told, noise=0.3
    )
    held.go(540)
    _, _, play, sigma = held.guider.secondary.gain_and_play()
    assert play == pytest.approx(15.0, abs=max(3.0 * sigma, 3.0))
    assert sigma < 4.0
    assert held.rms(1, 270) < 1.2
    steps = [step for step in held.steps(1) if step != 0.0]
    turns = sum(a * b < 0.0 for a, b in pairwise(steps))
    assert turns < 60, "a motor with play isn't turned round by noise"


@pytest.mark.parametrize("gain", [0.75, 1.25])
def test_a_guide_rate_that_is_otherwise_is_learned(gain: float) -> None:
    held = Held(lambda t: (0.05 * t, 0.0), gain=gain)
    held.go(60)
    assert held.rms(0, 40) < 0.5


@pytest.mark.long
@pytest.mark.parametrize("gain", [0.25, 2.0])
def test_an_unknown_guide_rate_is_learned_from_far(gain: float) -> None:
    held = Held(lambda t: (0.05 * t, 0.0), gain=gain, primary=Actuator(rate_known=False))
    held.go(80)
    assert held.rms(0, 40) < 0.6
    found, sigma, _, _ = held.guider.primary.gain_and_play()
    assert found == pytest.approx(gain, abs=max(4.0 * sigma, 0.1))


def test_corrections_that_go_the_wrong_way_are_named_and_end() -> None:
    held = Held(lambda t: (0.05 * t, 0.0), gain=-1.0)
    held.go(60)
    assert held.guider.fault() == ("primary", "reversed")
    assert all(one.none for one in held.corrections[-20:])
    named = next(at for at, one in enumerate(held.corrections) if at > 5 and one.none)
    assert named < 30


def test_corrections_that_do_nothing_are_named() -> None:
    held = Held(lambda t: (0.05 * t, 0.0), gain=0.0)
    held.go(60)
    assert held.guider.fault() == ("primary", "ignored")


def test_an_axis_within_its_play_is_not_called_dead() -> None:
    held = Held(lambda t: (0.0, 0.3 * math.sin(t / 200.0)), play_arcsec=30.0, told_play=None, noise=0.4)
    held.go(200)
    assert held.guider.fault() is None


def test_gaps_and_missing_looks_are_borne() -> None:
    held = Held(lambda t: (0.02 * t, 0.01 * t))
    held.go(60, solved=lambda number: number % 3 != 1)
    held.go(40, solved=lambda _: False)
    held.go(30)
    assert held.rms(0, 20) < 0.5
    held.now_s += 7200.0
    held.go(30)
    assert held.rms(0, 20) < 0.6


def test_after_a_flip_it_begins_anew_with_what_stays_true() -> None:
    def moves(t: float) -> tuple[float, float]:
        return 8.0 * math.sin(math.tau * t / 480.0), 0.01 * t

    held = Held(moves, primary=Actuator("both"), every_s=30.0)
    held.go(100)
    assert held.guider.primary.period_s == pytest.approx(480.0, rel=0.02)
    held.now_s += 200.0  # the worm has turned
    held.mechanism.made = [-held.disturbance(held.now_s)[0], -held.disturbance(held.now_s)[1]]
    held.guider.another_field(2.0)
    held.go(60)
    assert held.guider.primary.period_s == pytest.approx(480.0, rel=0.02)
    assert held.rms(0, 40) < 0.9


def test_a_dither_goes_where_it_is_wanted_and_is_no_drift() -> None:
    held = Held(lambda t: (0.02 * t, 0.0))
    held.go(50)
    rate = held.guider.state(0.3)[0].rate_arcsec_s
    held.dither(10.0, -6.0)
    held.go(12)
    assert held.rms(0, 6) < 0.6
    assert held.rms(1, 6) < 0.6
    assert held.guider.state(0.3)[0].rate_arcsec_s == pytest.approx(rate, abs=0.01)


def test_a_dither_of_a_mount_that_stands_still_goes_all_the_same() -> None:
    held = Held(still, noise=0.5)
    held.go(20)
    held.dither(0.0, 8.0)
    held.go(6)
    assert held.rms(1, 3) < 1.0


def test_a_look_that_is_not_later_is_stale() -> None:
    guider = Guider(Actuator(), Actuator())
    assert guider.look(10.0, 0.0, 0.0, 0.3).fate is LookFate.TAKEN
    assert guider.look(10.0, 0.0, 0.0, 0.3).fate is LookFate.STALE
    assert guider.look(5.0, 0.0, 0.0, 0.3).fate is LookFate.STALE


@pytest.mark.parametrize(
    "look", [(math.nan, 0.0, 0.0, 1.0), (1.0, math.inf, 0.0, 1.0), (1.0, 0.0, 0.0, -1.0)]
)
def test_numbers_that_are_none_are_refused_and_change_nothing(
    look: tuple[float, float, float, float],
) -> None:
    guider = Guider(Actuator(), Actuator())
    with pytest.raises(BadRequest):
        guider.look(*look)
    assert guider.look(1.0, 0.0, 0.0, 1.0).fate is LookFate.TAKEN


@pytest.mark.parametrize("wrong", [{"step_arcsec": -1.0}, {"most_arcsec": 0.0}, {"play_arcsec": math.nan}])
def test_an_actuator_that_makes_no_sense_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(BadRequest):
        Actuator(**wrong)  # type: ignore[arg-type]


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(0.1, 4000.0),
            st.floats(-5000.0, 5000.0),
            st.floats(-5000.0, 5000.0),
            st.floats(0.0, 50.0),
        ),
        min_size=1,
        max_size=40,
    ),
    st.sampled_from(["pulses", "rates", "both"]),
    st.sampled_from([0.0, 10.0, None]),
)
def test_whatever_looks_show_corrections_are_finite_and_bounded(
    looks: list[tuple[float, float, float, float]], kind: str, play: float | None
) -> None:
    actuator = Actuator(kind, most_arcsec=50.0, most_arcsec_s=2.0, play_arcsec=play)  # type: ignore[arg-type]
    guider = Guider(actuator, actuator, both_swing=True)
    now = 0.0
    for after_s, east, north, sigma in looks:
        now += after_s
        guider.look(now, east, north, sigma)
        done = guider.correction(now + 1.0, 20.0)
        assert isinstance(done, Correction)
        for part in (done.primary, done.secondary):
            assert math.isfinite(part.step_arcsec)
            assert abs(part.step_arcsec) <= 50.0
            assert math.isfinite(part.rate_arcsec_s)
            assert abs(part.rate_arcsec_s) <= 2.0
        guider.corrected(done, now + 1.0)
    for state in guider.state(1.0):
        assert math.isfinite(state.level_arcsec)
        assert math.isfinite(state.rate_sigma_arcsec_s)
