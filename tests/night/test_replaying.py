"""A simulated night is recorded and played again: the same decisions; other rules: differences."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadRequest
from mountnav.journal.memory import MemoryJournal
from mountnav.navigation.navigator import Navigator
from mountnav.night.daylight import night_name
from mountnav.night.events import Word
from mountnav.night.memory import remembered
from mountnav.night.recorded import Recording, read_recording, reading_of, syncs_of_night
from mountnav.night.recording import NightRecording, RecordedJournal
from mountnav.night.replaying import Replay, ReplayReport
from mountnav.night.rules import NightRules
from mountnav.night.tape import TapeMount
from mountnav.simulation.mechanics import PointingErrors
from mountnav.simulation.sky_script import Cloud, SkyScript
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from tests.night.conftest import AIR, POLICY, RULES, SITE, make_night, make_session, virtually


class NoCamera:
    """Nothing is exposed in a replay."""

    name = "no camera"

    async def open(self) -> None: ...

    async def close(self) -> None: ...

    async def abort(self) -> None: ...


def recorded_night(folder: Path, by: str = "sync") -> tuple[Recording, list[str]]:
    """A night with drift, a cloud, false solutions, an operator's pause and a restart in the middle."""

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
        await rig.session.begin()
        await rig.navigator.slew(rig.up())
        await rig.minutes(30)
        await rig.session.say(Word.PAUSE, "a visitor")
        await rig.minutes(4)
        await rig.session.say(Word.RESUME)
        recording.close()
        # the service is restarted
        recording = begun()
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


def replayed(recording: Recording, rules: NightRules) -> tuple[ReplayReport, TapeMount]:
    first = next(line.utc for line in recording.lines if line.utc is not None)
    clock = VirtualClock(first)
    tape = TapeMount(
        "tape",
        [reading_of(line.facts["reading"]) for line in recording.of("reading")],
        syncs_of_night(recording),
        clock,
    )

    def make(mount, journal: MemoryJournal, clock: VirtualClock) -> Navigator:
        return Navigator(
            name="east", mount=mount, camera=NoCamera(), catalog=embedded_catalog(), site=SITE, air=AIR,
            policy=POLICY, listen=lambda kind, data: None, journal=journal, clock=clock,
        )  # fmt: skip

    replay = Replay(recording, rules, SITE, "east", tape, make, clock)
    return run_virtually(replay.run(), clock), tape


def shown(report: ReplayReport) -> str:
    return "\n".join(f"{row.what}: {row.recorded} | {row.replayed}" for row in report.rows if not row.same)


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, list[str]]:
    return recorded_night(tmp_path_factory.mktemp("recordings"))


def test_the_same_rules_decide_the_same(night) -> None:
    recording, orders = night
    assert orders.count("sync") >= 3
    report, tape = replayed(recording, RULES)
    assert report.same, shown(report)
    assert report.frames == 46
    assert len(report.rows) > 50
    assert tape.orders.count("sync") == orders.count("sync")
    assert not report.notes


def test_other_rules_show_what_they_change(night) -> None:
    recording, _ = night
    report, tape = replayed(recording, replace(RULES, correct_when_off_by_arcsec=100.0))
    assert not report.same
    others = [row for row in report.rows if not row.same]
    assert any("correct" in row.recorded and "not off enough" in row.replayed for row in others)
    # what wasn't corrected stays in the readings: errors grow beyond those of the recorded night
    assert tape.orders.count("sync") >= 1
    report, tape = replayed(recording, replace(RULES, correct_by="nothing"))
    assert "sync" not in tape.orders
    lines = [row.replayed for row in report.rows if "nothing is to be corrected" in row.replayed]
    assert len(lines) > 10


def test_offsets_play_as_well(tmp_path: Path) -> None:
    recording, orders = recorded_night(tmp_path, "offset")
    assert orders.count("slew") >= 4
    report, _ = replayed(recording, replace(RULES, correct_by="offset"))
    assert report.same, shown(report)


def test_a_line_cut_off_by_a_crash_is_left_out(night, tmp_path: Path) -> None:
    text = night[0].path.read_text()
    cut = tmp_path / "cut.jsonl"
    cut.write_text(text[:-40])
    assert len(read_recording(cut).lines) == len(night[0].lines) - 1
    cut.write_text(text.replace('"kind"', "kind", 5))
    with pytest.raises(BadRequest, match="line 1"):
        read_recording(cut)
    cut.write_text('{"kind": "note"}\n')
    with pytest.raises(BadRequest):
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
