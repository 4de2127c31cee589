"""A running night with the real navigator over a simulated mount, in virtual time."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest

from mountnav.ephemeris import SkyRatesTarget
from mountnav.errors import BadFrame, JournalFailed
from mountnav.frames import Frame
from mountnav.journal.records import Entry, EntryKind
from mountnav.night.events import Act, Hold, Phase, Why, Word
from mountnav.night.memory import remembered
from mountnav.simulation.mechanics import PointingErrors
from mountnav.simulation.sky_script import Cloud, SkyScript
from mountnav.simulation.virtual_time import VirtualClock
from mountnav.sky.sphere import displaced, separation_arcsec
from tests.night.conftest import EVENING, RULES, make_night, virtually
from tests.present import present


def test_three_frames_then_one_sync() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock)
        await rig.navigator.slew(rig.up())
        assert await rig.off_arcsec() > 100.0
        answers = await rig.minutes(8)
        whys = [present(one.decision).why for one in answers]
        assert whys == [Why.CALIBRATING] * 3 + [Why.ALONE, Why.OFF] + [Why.NOT_OFF_ENOUGH] * 3
        assert rig.mount.received == ["slew", "sync"]
        assert await rig.off_arcsec() < 5.0
        assert answers[4].outcome.startswith("correction done")
        assert max(rig.wrong_syncs_arcsec()) < 2.0
        # the journal tells why: the sync's cause names the night and the look
        sync = next(one for one in rig.journal.commands if one.order == "sync")
        assert sync.cause.night_id == "east-2026-11-21"
        assert sync.cause.look_id == answers[4].look_id
        assert rig.told()[:3] == [("begin", "it is dark"), ("calibrated", "the first frames agree"),
                                  ("correct", "off, and frames agree")]  # fmt: skip
        drift = rig.session.report().drift
        assert drift is not None
        assert drift.last.total_arcsec < 2.0

    virtually(night)


@pytest.mark.long
def test_an_offset_brings_the_field_back_and_a_dither_is_no_error() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock, rules=replace(RULES, correct_by="offset"))
        target = rig.up()
        await rig.navigator.slew(target)
        await rig.minutes(6)
        assert rig.mount.received == ["slew", "slew"]
        assert separation_arcsec(rig.mechanics.truth(clock.utc()), target) < 10.0
        await rig.minutes(3)
        assert rig.mount.received == ["slew", "slew"]
        # the scheduler dithers by a relative move: seen and believed go together
        await rig.navigator.offset(90.0, 0.0)
        answers = await rig.minutes(4)
        assert {present(one.decision).why for one in answers[1:]} == {Why.NOT_OFF_ENOUGH}
        dithered = displaced(target, 90.0, 0.0)
        assert separation_arcsec(rig.mechanics.truth(clock.utc()), dithered) < 15.0

    virtually(night)


def test_a_target_that_the_sender_told_is_what_counts() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock)
        target = rig.up()
        await rig.navigator.slew(target)
        await rig.minutes(7, target=target, held=True)
        assert rig.mount.received == ["slew", "sync", "slew"]
        assert separation_arcsec(rig.mechanics.truth(clock.utc()), target) < 10.0

    virtually(night)


@pytest.mark.long
def test_false_solutions_and_satellites_correct_nothing_wrongly() -> None:
    async def night(clock: VirtualClock) -> None:
        script = SkyScript(seed=11, false_share=0.25, satellite_every=10)
        rig = await make_night(clock=clock, script=script)
        for turn in range(6):
            await rig.navigator.slew(rig.up(ha_deg=-40.0 + 10.0 * turn, dec_deg=20.0 + 5.0 * turn))
            await rig.minutes(12)
        assert len(rig.sky.false_frames) > 8
        assert rig.mount.received.count("sync") >= 1
        assert max(rig.wrong_syncs_arcsec()) < 5.0
        assert await rig.off_arcsec() < 40.0

    virtually(night)


@pytest.mark.long
def test_cloud_stops_corrections_and_is_told_once() -> None:
    async def night(clock: VirtualClock) -> None:
        script = SkyScript(seed=3, clouds=(Cloud(4.5, 16.5),))
        rig = await make_night(clock=clock, script=script)
        await rig.navigator.slew(rig.up())
        await rig.minutes(24)
        told = rig.told()
        assert told.count(("pause", "cloud")) == 1
        assert told.count(("go on", "clear again")) == 1
        assert Hold.CLOUD not in rig.session.state.holds
        assert rig.mount.received == ["slew", "sync"]

    virtually(night)


def test_a_killed_correction_is_not_doubled() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock)
        await rig.navigator.slew(rig.up())
        await rig.minutes(4)
        before = await rig.off_arcsec()
        frame = await rig.exposed()
        taking = asyncio.create_task(rig.sent(frame))
        while "sync" not in rig.mount.received:
            await clock.sleep(0.01)
        # killed right after the order went out: the rows so far are all that is left
        rows = list(rig.journal.entries)
        taking.cancel()
        await asyncio.gather(taking, return_exceptions=True)
        known = remembered(rows)
        assert known.state is not None
        assert known.state.under_way is not None
        rig.again(RULES, known)
        await rig.session.begin()
        assert rig.session.state.phase is Phase.FOLLOWING
        assert rig.session.state.corrected == 1
        assert rig.session.state.night_id == "east-2026-11-21"
        # the same frame once more is known by its content
        receipt = rig.session.frames.offer(frame.source, known.frame_ids[-1] * 2, lambda: frame, clock.utc())
        assert receipt.duplicate
        await rig.minutes(5)
        assert rig.mount.received.count("sync") == 1
        assert before > 100.0
        assert await rig.off_arcsec() < 5.0

    virtually(night)


def test_a_restart_by_day_ends_what_the_night_was_at() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock)
        await rig.navigator.slew(rig.up())
        await rig.minutes(5)
        # by day nobody watches the mount
        await rig.navigator.close()
        await clock.sleep(18 * 3600)
        rig.again(RULES, remembered(rig.journal.entries))
        await rig.session.begin()
        await rig.session.tick()
        assert rig.session.state.phase is Phase.WAITING
        await clock.sleep(7 * 3600)
        await rig.session.tick()
        assert rig.session.state.night_id == "east-2026-11-22"
        assert rig.session.state.phase is Phase.CALIBRATING

    virtually(night)


def test_unsafe_ends_an_offset_on_its_way() -> None:
    async def night(clock: VirtualClock) -> None:
        errors = PointingErrors(ih_arcsec=1600.0)
        rig = await make_night(clock=clock, errors=errors, rules=replace(RULES, correct_by="offset"))
        await rig.navigator.slew(rig.up())
        await rig.minutes(4)
        taking = asyncio.create_task(rig.sent(await rig.exposed()))
        while rig.mount.received.count("slew") < 2:
            await clock.sleep(0.01)
        await rig.session.say(Word.UNSAFE, "wind")
        answer = await taking
        assert answer.outcome.startswith("correction cancelled")
        assert "stop" in rig.mount.received
        assert rig.navigator.activity == "idle"
        answers = await rig.minutes(3)
        assert all(present(one.decision).act is Act.LEAVE for one in answers)
        assert rig.mount.received.count("slew") == 2
        await rig.session.say(Word.SAFE)
        await rig.minutes(3)
        assert rig.mount.received.count("slew") == 3

    virtually(night)


def test_a_cable_pulled_out_is_survived() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock)
        await rig.navigator.slew(rig.up())
        await rig.minutes(6)
        rig.mount.cut(60.0, "missing")
        for _ in range(4):
            await rig.session.read_mount()
            await clock.sleep(2.0)
        assert Hold.MOUNT in rig.session.state.holds
        await clock.sleep(120.0)
        await rig.session.read_mount()
        assert Hold.MOUNT not in rig.session.state.holds
        told = rig.told()
        assert ("pause", "the mount can't be reached") in told
        assert ("go on", "the mount is back") in told
        await rig.minutes(3)
        assert rig.mount.received.count("sync") == 1

    virtually(night)


def test_from_morning_to_evening() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock, rules=replace(RULES, park_at_end=True))
        while rig.told()[-1:] != [("park", "daylight")]:
            await rig.session.tick()
            await clock.sleep(600.0)
        assert rig.mount.received[-1] == "park"
        await rig.navigator.close()
        for _ in range(60):
            await rig.session.tick()
            await clock.sleep(900.0)
        assert rig.told() == [
            ("begin", "it is dark"), ("end", "daylight"), ("park", "daylight"), ("begin", "it is dark"),
        ]  # fmt: skip

    virtually(night, EVENING + timedelta(hours=10))


def test_a_park_at_the_end_that_does_not_arrive_is_told() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock, rules=replace(RULES, park_at_end=True))
        rig.mount.mechanics.stick("dec")
        while rig.told()[-1:] != [("park", "daylight")]:
            await rig.session.tick()
            await clock.sleep(600.0)
        assert not rig.mount.mechanics.parked
        (failed,) = [facts for kind, facts in rig.events if kind == "night-park-failed"]
        assert "stopped on its way to its park position" in str(failed["problem"])

    virtually(night, EVENING + timedelta(hours=10))


def test_what_is_no_frame_is_answered_and_forgotten() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock)
        await rig.navigator.slew(rig.up())
        await rig.minutes(1)

        def unreadable() -> Frame:
            raise BadFrame("cut short")

        rig.session.frames.offer("broken", "b" * 64, unreadable, clock.utc())
        answer = await rig.session.take(await rig.session.frames.next())
        assert present(answer.decision).why is Why.NOT_PLACED
        assert "cut short" in answer.detail
        timeless = replace(await rig.exposed(), mid_exposure_utc=None)
        assert present((await rig.sent(timeless, name="timeless")).decision).act is Act.LEAVE
        header = Frame(np.zeros((1, 1)), mid_exposure_utc=clock.utc())
        answer = await rig.sent(header, name="header", pixels=False)
        assert answer.decision is None
        assert rig.session.state.frames == 3
        # of before the mount was read: measured by nobody, used for nothing
        old = replace(await rig.exposed(), mid_exposure_utc=clock.utc() - timedelta(hours=2))
        answer = await rig.sent(old, name="old")
        assert answer.offset is None
        assert present(answer.decision).act is Act.LEAVE

    virtually(night)


def test_what_leaves_no_trace_is_not_done() -> None:
    class Full:
        """A journal that takes no night's decision to correct."""

        def __init__(self, journal) -> None:
            self._journal = journal

        def __getattr__(self, name):
            return getattr(self._journal, name)

        async def note(self, entry: Entry) -> None:
            if entry.kind is EntryKind.NIGHT and entry.facts["act"] == "correct":
                raise JournalFailed("the disk is full")
            await self._journal.note(entry)

    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock, journal=Full)
        await rig.navigator.slew(rig.up())
        answers = await rig.minutes(8)
        assert rig.mount.received == ["slew"]
        assert all(present(one.decision).act is Act.LEAVE for one in answers)

    virtually(night)


@pytest.mark.long
@pytest.mark.parametrize("by", ["sync", "offset", "model"])
def test_half_an_hour_of_drift_is_held_within_the_rule(by: str) -> None:
    """A pole a quarter of a degree off: the field runs away by four arcseconds a minute."""

    async def night(clock: VirtualClock) -> None:
        errors = PointingErrors(ma_arcsec=900.0)
        rig = await make_night(clock=clock, errors=errors, rules=replace(RULES, correct_by=by))
        await rig.navigator.slew(rig.up())
        answers = await rig.minutes(30)
        later = [one for one in answers[8:] if one.offset is not None]
        corrected = [one for one in answers if one.outcome]
        assert all(one.outcome.startswith("correction done") for one in corrected)
        assert 2 <= len(corrected) <= 6
        if by == "sync":
            assert max(present(one.offset).total_arcsec for one in later) < 200.0
        assert len(rig.session.state.used) == len(corrected)

    virtually(night)


@pytest.mark.long
def test_a_target_that_moves_is_judged_at_mid_exposure_and_followed_by_corrections() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock, rules=replace(RULES, correct_by="offset"))
        begins = clock.utc()
        target = SkyRatesTarget(rig.up(), 0.06, 0.04, begins, begins + timedelta(minutes=30), "a comet")
        await rig.navigator.slew(target)
        answers = await rig.minutes(22, target=target)
        # 4″ a minute: a place that stood still would be 90″ behind by now
        site = rig.navigator.mount.site
        assert separation_arcsec(rig.mechanics.truth(clock.utc()), target.icrs(clock.utc(), site)) < 40.0
        assert sum(one.outcome.startswith("correction done") for one in answers) >= 2
        over = await rig.sent(
            await rig.exposed(), target=replace(target, ends_utc=begins + timedelta(seconds=1))
        )
        assert "has no place" in over.detail or "ends" in over.detail

    virtually(night)
