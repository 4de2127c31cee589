"""The rules of a night as a table of states and events, and what holds whatever happens."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.night.events import (
    Act,
    CorrectionEnded,
    Decision,
    FrameSeen,
    Hold,
    NightState,
    Phase,
    PlateSeen,
    Said,
    Tick,
    Why,
    Word,
)
from mountnav.night.memory import state_of, state_record
from mountnav.night.rules import NightRules, decide
from mountnav.sky.sphere import Offset

START = datetime(2026, 11, 21, 20, tzinfo=UTC)
NIGHT = "east-2026-11-21"
PLATE = PlateSeen(2.0, 12.0, 1, (640, 480))
RULES = NightRules(correct_by="sync")
FOLLOWING = NightState(
    phase=Phase.FOLLOWING, night_id=NIGHT, was_dark=True, plate=PLATE, field="f", segment="s"
)


def at(seconds: float) -> datetime:
    return START + timedelta(seconds=seconds)


def frame(number: int, east: float = 60.0, north: float = 0.0, **changes) -> FrameSeen:
    """Frame of minute `number`, 10 s long, looked at 12 s after its middle, 2 s after it came."""
    middle = at(60.0 * number)
    usual = FrameSeen(
        utc=middle + timedelta(seconds=12),
        frame_id=f"frame{number}",
        arrived_utc=middle + timedelta(seconds=10),
        mid_utc=middle,
        begun_utc=middle - timedelta(seconds=5),
        placed=True,
        plate=PLATE,
        error=Offset(east, north),
        sigma_arcsec=0.2,
        field="f",
        segment="s",
    )
    return replace(usual, **changes)


def played(events, state: NightState = FOLLOWING, rules: NightRules = RULES):
    """All decisions, and the state in the end."""
    told: list[Decision] = []
    for event in events:
        state, decisions = decide(state, event, rules)
        told += decisions
    return told, state


def acts(told: list[Decision]) -> list[tuple[Act, Why]]:
    return [(one.act, one.why) for one in told]


def test_two_frames_that_agree_are_corrected_by() -> None:
    told, state = played([frame(0), frame(1)])
    assert acts(told) == [(Act.LEAVE, Why.ALONE), (Act.CORRECT, Why.OFF)]
    assert told[1].error == Offset(60.0, 0.0)
    assert told[1].facts["frames"] == ["frame0", "frame1"]
    assert state.under_way == "frame1"


SECOND_FRAME = [
    ("a satellite's false place comes alone", frame(1, east=-400.0), Why.ALONE),
    ("of another field", frame(1, field="g"), Why.ALONE),
    ("after the mount was synced by somebody else", frame(1, segment="t"), Why.ALONE),
    ("long after the first", frame(20), Why.ALONE),
    ("older than the first", frame(-1), Why.ALONE),
    ("the same frame", frame(0), Why.ALONE),
    ("not off enough", frame(1, east=29.0), Why.NOT_OFF_ENOUGH),
    ("off by its own error", frame(1, east=40.0, sigma_arcsec=5.0), Why.NOT_OFF_ENOUGH),
    ("cloud", frame(1, placed=False, error=None, plate=None), Why.NOT_PLACED),
    ("taken in motion", frame(1, doubts=("mount-moved",)), Why.DOUBTED),
    ("no readings round it", frame(1, error=None), Why.NO_READING),
    ("no time of exposure", frame(1, mid_utc=None, begun_utc=None), Why.NO_READING),
    ("another camera", frame(1, plate=replace(PLATE, scale_arcsec_px=2.2)), Why.PLATE_DIFFERS),
    ("mirrored", frame(1, plate=replace(PLATE, parity=-1)), Why.PLATE_DIFFERS),
    ("turned", frame(1, plate=replace(PLATE, rotation_deg=30.0)), Why.PLATE_DIFFERS),
    ("the mount moves", frame(1, moving=True), Why.MOVING),
    ("solved too late", frame(1, utc=at(60 + 21)), Why.NOT_QUIET),
]  # fmt: skip


@pytest.mark.parametrize(
    ("second", "why"), [row[1:] for row in SECOND_FRAME], ids=[row[0] for row in SECOND_FRAME]
)
def test_what_stands_against_a_correction(second: FrameSeen, why: Why) -> None:
    told, state = played([frame(0), second])
    assert acts(told)[-1] == (Act.LEAVE, why)
    assert state.under_way is None
    assert not state.used


def test_the_other_side_of_the_pier_is_the_same_camera() -> None:
    turned = replace(PLATE, rotation_deg=192.0)
    told, _ = played([frame(0, plate=turned), frame(1, plate=turned)])
    assert told[-1].act is Act.CORRECT


def test_too_far_off_is_for_a_person() -> None:
    told, _ = played([frame(0, east=1900.0), frame(1, east=1900.0), frame(2, east=1900.0)])
    assert {one.why for one in told} == {Why.TOO_FAR_OFF}


def test_a_night_that_only_measures() -> None:
    told, _ = played([frame(0), frame(1)], rules=NightRules())
    assert {one.why for one in told} == {Why.ONLY_MEASURED}


def test_never_while_the_scheduler_exposes() -> None:
    busy = Said(at(50), Word.BUSY, until=at(500))
    told, state = played([frame(0), busy, frame(1)])
    assert acts(told)[-1] == (Act.LEAVE, Why.EXPOSING)
    # it says that it is free: then also long after the frame came
    told, _ = played([Said(at(100), Word.FREE), frame(2, utc=at(170))], state)
    assert acts(told)[-1] == (Act.CORRECT, Why.OFF)
    # whoever waits for the answer exposes nothing
    told, _ = played([frame(2, utc=at(170), held=True)], state)
    assert acts(told)[-1] == (Act.CORRECT, Why.OFF)
    # a scheduler that died is not waited for
    told, _ = played([frame(9)], state)
    assert acts(told)[-1] == (Act.CORRECT, Why.OFF)


def test_after_a_correction_only_new_frames_count() -> None:
    told, state = played([frame(0), frame(1)])
    assert acts(played([frame(2)], state)[0]) == [(Act.LEAVE, Why.UNDER_WAY)]
    done = CorrectionEnded(at(118), "frame1", "done")
    _, state = played([done], state)
    told, state = played([frame(2), frame(3), frame(4)], state)
    assert acts(told) == [
        (Act.LEAVE, Why.OLDER_THAN_CORRECTION),
        (Act.LEAVE, Why.ALONE),
        (Act.CORRECT, Why.OFF),
    ]
    # the frame of the first correction comes again
    _, state = played([CorrectionEnded(at(260), "frame4", "done")], state)
    assert acts(played([replace(frame(9), frame_id="frame1")], state)[0]) == [(Act.LEAVE, Why.USED)]


def test_what_an_offset_put_there_is_meant_to_be_there() -> None:
    rules = replace(RULES, correct_by="offset")
    _, state = played([frame(0), frame(1)], rules=rules)
    _, state = played([CorrectionEnded(at(80), "frame1", "done", Offset(60.0, 0.0))], state, rules)
    told, state = played([frame(2), frame(3)], state, rules)
    assert {one.why for one in told} == {Why.NOT_OFF_ENOUGH}
    told, _ = played([frame(4, east=110.0), frame(5, east=110.0)], state, rules)
    assert told[-1].error == Offset(50.0, 0.0)
    # the sender tells where its center was meant to be: nothing is to be guessed
    told, _ = played([frame(4, of_target=True), frame(5, of_target=True)], state, rules)
    assert told[-1].error == Offset(60.0, 0.0)
    # another target: the scheduler's own slew has taken the offset back
    told, _ = played([frame(6, field="g"), frame(7, field="g")], state, rules)
    assert told[-1].error == Offset(60.0, 0.0)


def test_caps_per_hour_and_night() -> None:
    rules = replace(RULES, max_corrections_per_hour=2, max_corrections_per_night=3)
    told, state = [], FOLLOWING
    for number in range(150):
        more, state = played([frame(number)], state, rules)
        told += more
        if state.under_way:
            _, state = played([CorrectionEnded(frame(number).utc, state.under_way, "done")], state, rules)
    corrected = [one for one in told if one.act is Act.CORRECT]
    assert len(corrected) == 3
    assert {Why.ENOUGH_THIS_HOUR, Why.ENOUGH_TONIGHT} <= {one.why for one in told}


def test_three_frames_open_a_session() -> None:
    dark = Tick(at(0), -15.0, NIGHT)
    told, state = played([dark], NightState())
    assert acts(told) == [(Act.BEGIN, Why.DARK)]
    other = replace(PLATE, scale_arcsec_px=2.1)
    told, state = played(
        [
            frame(0, fully=True),
            frame(1, fully=True, plate=other),  # one of them is wrong: both don't count
            frame(2, fully=True),
            frame(3),  # by shift alone
            frame(4, fully=True),
        ],
        state,
    )
    assert {one.why for one in told} == {Why.CALIBRATING}
    assert state.phase is Phase.CALIBRATING
    told, state = played([frame(5, fully=True)], state)
    assert acts(told) == [(Act.CALIBRATED, Why.PLATES_AGREE), (Act.LEAVE, Why.CALIBRATING)]
    assert state.plate == PLATE
    # nothing of the calibration counts as evidence
    told, _ = played([frame(6), frame(7)], state)
    assert acts(told) == [(Act.LEAVE, Why.ALONE), (Act.CORRECT, Why.OFF)]


def test_from_dusk_to_dawn_and_the_next_night() -> None:
    rules = replace(RULES, park_at_end=True)
    told, state = played(
        [Tick(at(0), -5.0, NIGHT), Tick(at(10), -11.9, NIGHT), Tick(at(20), -12.1, NIGHT)],
        NightState(),
        rules,
    )
    assert acts(told) == [(Act.BEGIN, Why.DARK)]
    told, state = played([Tick(at(30), -11.0, NIGHT), Tick(at(40), -9.9, NIGHT)], state, rules)
    assert acts(told) == [(Act.END, Why.DAYLIGHT), (Act.PARK, Why.DAYLIGHT)]
    told, state = played([Tick(at(86400), -13.0, "east-2026-11-22")], state, rules)
    assert acts(told) == [(Act.BEGIN, Why.DARK)]
    assert state.night_id == "east-2026-11-22"


def test_stopped_stays_stopped_until_the_next_night() -> None:
    told, state = played([Said(at(0), Word.STOP, "snow")])
    assert acts(told) == [(Act.END, Why.ORDERED)]
    told, state = played([Tick(at(10), -30.0, NIGHT), frame(1)], state)
    assert acts(told) == [(Act.LEAVE, Why.NOT_RUNNING)]
    told, _ = played([Tick(at(86400), -30.0, "east-2026-11-22")], state)
    assert acts(told) == [(Act.BEGIN, Why.DARK)]
    told, state = played([Said(at(20), Word.START, night_id=NIGHT)], state)
    assert acts(told) == [(Act.BEGIN, Why.ORDERED)]


def test_an_operator_may_begin_by_day() -> None:
    told, state = played([Said(at(0), Word.START, night_id=NIGHT)], NightState())
    told, state = played([Tick(at(10), +40.0, NIGHT)], state)
    assert not told
    told, state = played([Tick(at(20), -13.0, NIGHT), Tick(at(30), -9.0, NIGHT)], state)
    assert acts(told) == [(Act.END, Why.DAYLIGHT)]


@pytest.mark.parametrize("word", [Word.UNSAFE, Word.PAUSE, Word.MOUNT_LOST, Word.STOP])
def test_trouble_ends_a_correction_under_way(word: Word) -> None:
    told, state = played([frame(0), frame(1), Said(at(73), word, "rain")])
    assert told[-2].act is Act.HALT
    assert told[-2].frame_id == "frame1"
    _, state = played([CorrectionEnded(at(74), "frame1", "cancelled")], state)
    told, _ = played([frame(2), frame(3), frame(4)], state)
    assert all(one.act is Act.LEAVE for one in told)


def test_unsafe_parks_once_if_so_ruled() -> None:
    rules = replace(RULES, when_unsafe="park")
    told, state = played([Said(at(0), Word.UNSAFE, "rain"), Said(at(5), Word.UNSAFE, "rain")], rules=rules)
    assert acts(told) == [(Act.PAUSE, Why.UNSAFE), (Act.PARK, Why.UNSAFE)]
    told, state = played([Said(at(60), Word.SAFE), frame(2), frame(3)], state, rules)
    assert acts(told) == [(Act.GO_ON, Why.SAFE), (Act.LEAVE, Why.ALONE), (Act.CORRECT, Why.OFF)]


def test_it_is_safe_when_nobody_says_otherwise_any_more() -> None:
    rules = replace(RULES, when_unsafe="park")
    words = [Said(at(0), Word.UNSAFE, "rain", by="a roof"), Said(at(1), Word.UNSAFE, "wind")]
    told, state = played(words, rules=rules)
    assert acts(told) == [(Act.PAUSE, Why.UNSAFE), (Act.PARK, Why.UNSAFE)]
    assert state.unsafe_why == "wind; rain"
    # one takes back nothing of the other's, also after a restart
    back = state_of(state_record(state))
    assert back == state
    told, back = played(
        [Said(at(2), Word.SAFE, by="a roof"), Said(at(3), Word.SAFE, by="a third")], back, rules
    )
    assert not told
    assert (back.holds, back.unsafe_why) == ({Hold.UNSAFE}, "wind")
    told, back = played([Said(at(4), Word.SAFE)], back, rules)
    assert acts(told) == [(Act.GO_ON, Why.SAFE)]
    assert (back.holds, back.unsafe) == (frozenset(), ())


def night_tick(seconds: float) -> Tick:
    return Tick(at(seconds), -40.0, NIGHT)


def until(seconds: float, word: Word = Word.SAFE, *, by: str = "", for_s: float = 60.0) -> Said:
    """Somebody's word that holds for so long."""
    return Said(at(seconds), word, "", at(seconds + for_s), by=by)


def test_a_monitor_that_is_not_heard_of_again_means_unsafe() -> None:
    rules = replace(RULES, when_unsafe="park")
    told, state = played([until(0), until(50), night_tick(105)], rules=rules)
    assert (told, state.safe_until) == ([], at(110))
    told, silent = played([night_tick(115), night_tick(120)], state, rules)
    assert acts(told) == [(Act.PAUSE, Why.UNSAFE), (Act.PARK, Why.UNSAFE)]
    assert "which held for 60 s" in silent.unsafe_why
    told, state = played([until(130)], silent, rules)
    assert acts(told) == [(Act.GO_ON, Why.SAFE)]
    # one without an end holds for ever, as before
    told, state = played([Said(at(140), Word.SAFE), night_tick(9000)], state, rules)
    assert (told, state.safe_until) == ([], None)


def test_a_monitors_time_is_of_its_own_word_alone() -> None:
    _, state = played(
        [until(0), Said(at(10), Word.SAFE, by="a roof"), Said(at(11), Word.UNSAFE, by="a roof")]
    )
    assert state.safe_until == at(60)
    _, state = played([night_tick(61)], state)
    assert [by for by, _ in state.unsafe] == ["", "a roof"]
    # once it has said "unsafe" itself there is nothing to wait for
    _, state = played([until(0), Said(at(10), Word.UNSAFE, "rain")])
    assert state.safe_until is None
    assert state.unsafe_why == "rain"


def test_a_monitors_time_outlives_a_restart_and_the_beginning_of_a_night() -> None:
    _, state = played([until(0)])
    back = state_of(state_record(state))
    assert back == replace(state, safe_until=None)
    _, back = played([Said(at(500), Word.RESTARTED)], back)
    assert back.safe_until == at(560)
    told, _ = played([night_tick(561)], back)
    assert acts(told) == [(Act.PAUSE, Why.UNSAFE)]
    # by day too
    waiting, _ = decide(NightState(), until(0), RULES)
    again, _ = decide(state_of(state_record(waiting)), Said(at(500), Word.RESTARTED), RULES)
    assert again.safe_until == at(560)
    begun, _ = decide(again, Said(at(510), Word.START, night_id="n"), RULES)
    assert begun.safe_until == at(560)


def test_what_an_older_version_wrote_of_safety_is_read() -> None:
    _, state = played([Said(at(0), Word.UNSAFE, "rain")])
    record = state_record(state)
    del record["unsafe"]
    assert state_of(record | {"unsafe_why": "rain"}) == state
    assert state_of(record | {"unsafe_why": "", "holds": []}).unsafe == ()


def test_cloud_is_told_once_and_forgets_what_was_known() -> None:
    cloudy = [frame(n, placed=False, error=None, plate=None) for n in range(1, 8)]
    told, state = played([frame(0), *cloudy])
    assert acts(told).count((Act.PAUSE, Why.CLOUD)) == 1
    told, _ = played([frame(8), frame(9)], state)
    assert acts(told) == [(Act.GO_ON, Why.CLEAR), (Act.LEAVE, Why.ALONE), (Act.CORRECT, Why.OFF)]


def test_a_restart_doubles_nothing() -> None:
    _, state = played([frame(0), frame(1)])
    back = state_of(state_record(state))
    assert back.under_way == "frame1"
    told, back = played([Said(at(100), Word.RESTARTED)], back)
    assert acts(told) == [(Act.GO_ON, Why.RESTARTED)]
    assert back.under_way is None
    assert back.corrected == 1
    told, _ = played([frame(1), frame(2), frame(3)], back)
    assert acts(told) == [(Act.LEAVE, Why.USED), (Act.LEAVE, Why.ALONE), (Act.CORRECT, Why.OFF)]


def test_a_restart_keeps_holds_and_caps() -> None:
    rules = replace(RULES, max_corrections_per_hour=1)
    _, state = played([frame(0), frame(1), CorrectionEnded(at(75), "frame1", "done")], rules=rules)
    _, state = played([Said(at(80), Word.UNSAFE, "wind")], state, rules)
    _, back = played([Said(at(100), Word.RESTARTED)], state_of(state_record(state)), rules)
    assert Hold.UNSAFE in back.holds
    _, back = played([Said(at(110), Word.SAFE)], back, rules)
    told, _ = played([frame(3), frame(4)], back, rules)
    assert acts(told)[-1] == (Act.LEAVE, Why.ENOUGH_THIS_HOUR)


EVENTS = st.lists(
    st.one_of(
        st.builds(
            frame,
            st.integers(0, 40),
            st.sampled_from([0.0, 20.0, 60.0, 63.0, -400.0, 3000.0]),
            moving=st.booleans(),
            doubts=st.sampled_from([(), (), ("frame-older-than-the-last-move",)]),
            held=st.booleans(),
            fully=st.booleans(),
            field=st.sampled_from(["f", "f", "g"]),
            segment=st.sampled_from(["s", "s", "t"]),
            placed=st.sampled_from([True, True, True, False]),
        ),
        st.builds(Said, st.just(START), st.sampled_from(list(Word)), until=st.just(at(600)),
                  night_id=st.just(NIGHT)),
        st.builds(Tick, st.just(START), st.floats(-30, 30), st.sampled_from([NIGHT, "east-2026-11-22"])),
        st.builds(CorrectionEnded, st.just(START), st.sampled_from([f"frame{n}" for n in range(41)]),
                  st.sampled_from(["done", "failed"]), st.sampled_from([None, Offset(60.0, 0.0)])),
    ),
    max_size=60,
)  # fmt: skip


@pytest.mark.long
@given(EVENTS, st.sampled_from(["nothing", "sync", "offset"]))
def test_whatever_happens(events, by: str) -> None:
    """Never in motion, never twice by one frame, never beyond the caps, never by one frame alone."""
    rules = NightRules(correct_by=by, max_corrections_per_hour=3, max_corrections_per_night=5)
    state = FOLLOWING
    corrected: list[tuple[str, str]] = []
    for event in events:
        before = state
        state, decisions = decide(state, event, rules)
        assert len([one for one in decisions if one.act is Act.CORRECT]) <= 1
        if isinstance(event, FrameSeen):
            assert sum(one.act in (Act.CORRECT, Act.LEAVE) for one in decisions) == 1
        for one in decisions:
            if one.act is not Act.CORRECT:
                continue
            assert isinstance(event, FrameSeen)
            assert by != "nothing"
            assert not event.moving
            assert not event.doubts
            assert not before.holds - {Hold.CLOUD}
            assert before.phase is Phase.FOLLOWING
            assert before.under_way is None
            assert one.error is not None
            frames = one.facts["frames"]
            assert isinstance(frames, list | tuple)
            assert 30.0 <= one.error.total_arcsec <= rules.max_correction_arcsec
            assert event.held or before.busy_until is None or event.utc >= before.busy_until
            assert len(set(frames)) >= 2
            corrected.append((state.night_id, one.frame_id))
        assert state_of(state_record(state)).used == state.used[-50:]
    assert len(set(corrected)) == len(corrected)
    for night in {name for name, _ in corrected}:
        assert sum(name == night for name, _ in corrected) <= 5
