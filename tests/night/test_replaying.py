"""A simulated night is recorded and played again: the same decisions; other rules: differences."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest

from mountnav.errors import BadRequest
from mountnav.navigation.equipment import sync_rules
from mountnav.navigation.frames_seen import FramesSeen
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.night.daylight import night_name
from mountnav.night.events import FrameSeen, NightState, Tick, Word
from mountnav.night.memory import STATE_EVERY, EventsKept, remembered
from mountnav.night.recording import (
    VERSION,
    NightRecording,
    RecordedJournal,
    Recording,
    as_json,
    read_recording,
)
from mountnav.night.replay_inputs import event_of, state_of
from mountnav.night.replaying import Replay, ReplayReport
from mountnav.night.rules import NightRules, decide
from mountnav.simulation.mechanics import PointingErrors
from mountnav.simulation.sky_script import Cloud, SkyScript
from mountnav.simulation.virtual_time import VirtualClock
from tests.night.conftest import EVENING, POLICY, RULES, SITE, NightRig, make_night, make_session, virtually

SYNC = SyncPolicy(max_per_night=4)
"""What comes after the fourth sync is refused."""


async def rain(rig: NightRig) -> None:
    """Say that it rains as soon as something is corrected, and a minute later that it is over."""
    while rig.session.state.under_way is None:
        await rig.clock.sleep(0.001)
    await rig.session.say(Word.UNSAFE, "rain")
    await rig.clock.sleep(60.0)
    await rig.session.say(Word.SAFE)


def recorded_night(folder: Path, by: str = "sync") -> tuple[Recording, list[str]]:
    """A night with drift, cloud, false solutions, a pause, a nudge under an exposure, rain, and a restart."""

    async def night(clock: VirtualClock):
        def begun() -> NightRecording:
            return NightRecording(folder, {"telescope": "east"}, lambda utc: night_name("east", utc, SITE))

        recording = begun()
        script = SkyScript(seed=5, clouds=(Cloud(16.0, 24.0),), false_share=0.1)
        rules = replace(RULES, correct_by=by)
        rig = await make_night(
            clock=clock,
            rules=rules,
            script=script,
            errors=PointingErrors(ih_arcsec=200.0, ma_arcsec=900.0),
            recorder=recording,
            journal=lambda rows: RecordedJournal(rows, lambda *line: recording.keep(*line)),
        )
        rig.navigator.guard.policy = sync_rules(SYNC, POLICY)
        await rig.session.begin()
        await rig.navigator.slew(rig.up())
        await rig.minutes(30)
        await rig.session.say(Word.PAUSE, "a visitor")
        await rig.minutes(4)
        await rig.session.say(Word.RESUME)
        # somebody nudges it while the scheduler exposes
        exposing = asyncio.ensure_future(rig.exposed())
        await clock.sleep(5.0)
        await rig.navigator.offset(45.0, 0.0)
        await rig.sent(await exposing)
        # a clutch slips, and it rains while that is being corrected
        rig.mechanics.errors = replace(rig.mechanics.errors, ih_arcsec=500.0)
        rained = asyncio.ensure_future(rain(rig))
        await rig.minutes(6)
        await rained
        recording.close()
        # the service is restarted, and has seen no frame of its camera
        recording = begun()
        rig.navigator._equipment.frames = FramesSeen()
        rig.session = make_session(
            rig.navigator, rules, rig.sky, clock, RecordedJournal(rig.journal, recording.keep),
            remembered(rig.journal.entries), recording,
        )  # fmt: skip
        await rig.session.read_mount()
        await rig.session.begin()
        await rig.navigator.slew(rig.up(ha_deg=-50.0))
        await rig.minutes(12)
        recording.close()
        assert not recording.problem
        return rig.mount.received

    orders = virtually(night)
    (path,) = folder.glob("*.jsonl")
    assert path.name == "east-2026-11-21.jsonl"
    return read_recording(path), orders


def replayed(recording: Recording, rules: NightRules, sync: SyncPolicy = SYNC) -> ReplayReport:
    """Played again; by other rules, or by those of then."""
    others = (rules, sync) not in ((RULES, SYNC), (replace(RULES, correct_by="offset"), SYNC))
    replay = Replay(recording, rules, SITE, "east", sync_rules(sync, POLICY), other_rules=others)
    return asyncio.run(replay.run())


def shown(report: ReplayReport) -> str:
    return "\n".join(f"{row.what}: {row.recorded} | {row.replayed}" for row in report.rows if not row.same)


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, list[str]]:
    return recorded_night(tmp_path_factory.mktemp("recordings"))


@pytest.mark.long
def test_the_same_rules_decide_the_same(night) -> None:
    recording, orders = night
    assert orders.count("sync") == 4
    report = replayed(recording, RULES)
    assert report.same, shown(report)
    assert report.not_judged == 0
    assert not report.notes
    assert report.frames > 50
    told = [row.recorded for row in report.rows]
    # nothing that a night goes through is left out
    for words in (
        "; done",
        "; cancelled",
        "; refused (too-many-syncs)",
        "mount-moved",
        "cloud",
        "not safe",
        "restarted",
    ):
        assert any(words in one for one in told), (words, told)


@pytest.mark.long
def test_what_the_rules_were_told_is_made_again_to_the_last_digit(night) -> None:
    """Frames are compared again with the recorded readings; nothing is taken from the recorded comparison."""
    recording, _ = night
    heard: list[tuple[FrameSeen, Any]] = []

    class Listening(Replay):
        def _of_now(self, event):
            now = super()._of_now(event)
            if isinstance(event, FrameSeen):
                heard.append((event, now))
            return now

    replay = Listening(recording, RULES, SITE, "east", sync_rules(SYNC, POLICY))
    assert asyncio.run(replay.run()).same
    assert sum(then.error is not None for then, _ in heard) > 30
    for then, now in heard:
        assert then == now


@pytest.mark.long
def test_other_rules_show_what_they_change(night) -> None:
    recording, _ = night
    report = replayed(recording, replace(RULES, correct_when_off_by_arcsec=100.0))
    others = [row for row in report.rows if not row.same]
    assert any("correct" in row.recorded and "not off enough" in row.replayed for row in others)
    report = replayed(recording, replace(RULES, correct_by="nothing"))
    lines = [row.replayed for row in report.rows if "nothing is to be corrected" in row.replayed]
    # what wasn't corrected stays in the readings
    assert len(lines) > 10
    report = replayed(recording, RULES, SyncPolicy())
    (refused,) = {row.recorded.rpartition("; ")[2] for row in report.rows if "refused" in row.recorded}
    assert refused == "refused (too-many-syncs)"
    assert any("refused" in row.recorded and row.replayed.endswith("; done") for row in report.rows)
    assert any("were not made then" in note for note in report.notes)


@pytest.mark.long
def test_offsets_play_as_well(tmp_path: Path) -> None:
    recording, orders = recorded_night(tmp_path, "offset")
    assert orders.count("slew") >= 4
    report = replayed(recording, replace(RULES, correct_by="offset"))
    assert report.same, shown(report)


@pytest.mark.long
def test_a_lost_line_is_no_difference_but_not_judged(night, tmp_path: Path) -> None:
    """As after a disk that was full for a while: what hangs on it is counted, and never told as the same."""
    texts = night[0].path.read_text().splitlines(keepends=True)
    events = [at for at, text in enumerate(texts) if '"CorrectionEnded"' in text]
    cut = tmp_path / "cut.jsonl"
    cut.write_text("".join(texts[: events[0]] + texts[events[0] + 1 :]))
    report = replayed(read_recording(cut), RULES)
    assert report.same, shown(report)
    assert report.not_judged > 0
    assert len(report.rows) + report.not_judged == len(replayed(night[0], RULES).rows)
    assert any("gap" in note for note in report.notes)
    # without any state nothing can be said, and that is not "the same"
    cut.write_text("".join(text for text in texts if '"kind": "state"' not in text))
    report = replayed(read_recording(cut), RULES)
    assert not report.rows
    assert not report.same


def test_the_state_is_told_again_and_again(tmp_path: Path) -> None:
    """So that a replay can go on after a gap; and each night's file begins with it."""
    recording = NightRecording(tmp_path, {}, lambda utc: night_name("east", utc, SITE))
    kept = EventsKept(recording, lambda utc: night_name("east", utc, SITE))
    for step in [*range(STATE_EVERY + 10), 24 * 720]:
        utc = EVENING + timedelta(seconds=5 * step)
        kept.keep(NightState(), Tick(utc, -20.0, night_name("east", utc, SITE)), ())
    recording.close()
    first, second = (read_recording(path) for path in sorted(tmp_path.glob("*.jsonl")))
    assert len(list(first.of("state"))) == 2
    assert [line.kind for line in second.lines] == ["header", "state", "event"]


def test_a_state_and_an_event_come_back_as_they_were(night) -> None:
    """Each recorded state is that to which the events before it lead."""
    recording, _ = night
    state = NightState()
    states = 0
    for line in recording.of("state", "event"):
        if line.kind == "state":
            told = state_of(line.facts["state"])
            assert as_json(told) == json.loads(json.dumps(line.facts["state"]))
            states += 1
            state = told
        else:
            event = event_of(line.facts["event"])
            assert as_json(event) == json.loads(json.dumps(line.facts["event"]))
            state, _ = decide(state, event, RULES)
    assert states == 2


def test_a_line_cut_off_by_a_crash_is_left_out(night, tmp_path: Path) -> None:
    text = night[0].path.read_text()
    # also where the service went on in the same file
    again = NightRecording(tmp_path, {"telescope": "east"}, lambda utc: "night")
    (tmp_path / "night.jsonl").write_text(text[:-40])
    again.keep("reading", night[0].lines[-1].utc, {})
    again.close()
    assert len(read_recording(tmp_path / "night.jsonl").lines) == len(night[0].lines) + 1
    cut = tmp_path / "cut.jsonl"
    cut.write_text(text[:-40])
    assert len(read_recording(cut).lines) == len(night[0].lines) - 1
    cut.write_text(text.replace('"kind"', "kind", 5))
    with pytest.raises(BadRequest, match="line 1"):
        read_recording(cut)
    cut.write_text('{"kind": "note"}\n')
    with pytest.raises(BadRequest):
        read_recording(cut)
    cut.write_text(text.replace(f'"version": {VERSION}', '"version": 1'))
    with pytest.raises(BadRequest, match="line 1: a recording of version 1"):
        read_recording(cut)


def test_a_full_disk_stops_the_recording_and_not_the_night(tmp_path: Path) -> None:
    (tmp_path / "in-the-way").write_text("a file where the folder should be")

    async def night(clock: VirtualClock) -> None:
        recording = NightRecording(tmp_path / "in-the-way", {}, lambda utc: "night")
        rig = await make_night(clock=clock, recorder=recording)
        await rig.navigator.slew(rig.up())
        await rig.minutes(6)
        recording.close()
        assert "can't be written" in recording.problem
        assert rig.mount.received == ["slew", "sync"]

    virtually(night)
