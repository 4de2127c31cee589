"""Frames that somebody else exposes, compared with what the mount said then; and what looks leave behind."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from datetime import timedelta

import pytest

from mountnav.devices import MountReading
from mountnav.errors import BadFrame, BadRequest, Busy, SyncDoubt, SyncRefused
from mountnav.frames import Frame, Hint
from mountnav.navigation.reading_history import ReadingHistory
from mountnav.navigation.reports import Correction, FrameLook
from mountnav.sky.coordinates import Icrs
from mountnav.sky.iers import earth_orientation
from mountnav.sky.sphere import displaced, separation_arcsec
from mountnav.solving.settings import SolveSettings
from tests.navigation.virtual_rig import AIR, START, VirtualRig, in_virtual_time


async def exposed(rig: VirtualRig, exposure_s: float = 30.0) -> Frame:
    """A science frame, with the mount glanced at before and after, as a night does."""
    await rig.navigator.read_mount()
    frame = await rig.camera.expose(exposure_s)
    await rig.navigator.read_mount()
    return frame


async def identified(rig: VirtualRig, frame: Frame, scale_by: float = 1.0) -> FrameLook:
    assert frame.mid_exposure_utc is not None
    believed = rig.navigator.believed(frame.mid_exposure_utc)
    verdict = rig.sky.verdict(frame, Hint(center=believed, radius_deg=2.0), SolveSettings())
    if scale_by != 1.0:
        assert verdict.solution is not None
        scale = scale_by * verdict.solution.scale_arcsec_px
        verdict = replace(verdict, solution=replace(verdict.solution, scale_arcsec_px=scale))
    return await rig.navigator.frame(frame, verdict)


def test_a_frame_from_outside_becomes_a_look_and_corrects() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-20.0, 30.0)
        await rig.navigator.slew(target)
        for by in ("sync", "offset"):
            frame = await exposed(rig)
            found = await identified(rig, frame)
            assert found.look is not None
            # the first frame of all has none before it that proves it new; the one after it agrees
            assert found.doubts == ((SyncDoubt.NOT_FRESH,) if by == "sync" else ())
            assert separation_arcsec(found.look.seen, rig.mechanics.truth(frame.mid_exposure_utc)) < 1.0
            record = rig.journal.looks[-1]
            assert record.look_id == found.look.look_id
            assert record.used == "night"
            again = await identified(rig, await exposed(rig))
            assert again.look is not None
            done = await rig.navigator.correct(again.look, by=by, target=target, key="M 31")
            assert rig.off_arcsec(target) < 10.0
            assert done.moved is not None
            assert done.moved_arcsec == pytest.approx(done.moved.total_arcsec)
            assert done.by is (Correction.SYNC if by == "sync" else Correction.OFFSET)
            await rig.navigator.offset(200.0, -100.0)

    in_virtual_time(work)


def test_a_frame_from_before_the_last_move_corrects_nothing() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-20.0, 30.0)
        await rig.navigator.slew(target)
        old = await exposed(rig)
        await rig.navigator.offset(300.0, 0.0)
        found = await identified(rig, old)
        assert SyncDoubt.OLDER_THAN_MOVE in found.doubts
        assert found.look is not None
        sent = list(rig.mount.received)
        with pytest.raises(SyncRefused):
            await rig.navigator.correct(found.look, by="offset", target=target)
        assert rig.mount.received == sent

    in_virtual_time(work)


def test_a_frame_in_motion_is_doubted() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.slew(rig.up(-20.0, 30.0))
        await rig.navigator.read_mount()
        exposing = asyncio.ensure_future(rig.camera.expose(20.0))
        await rig.clock.sleep(2.0)
        await rig.navigator.offset(1500.0, 0.0)
        found = await identified(rig, await exposing)
        assert SyncDoubt.MOVED in found.doubts

    in_virtual_time(work)


def test_a_frame_that_nobody_read_the_mount_round_is_no_look() -> None:
    async def work(rig: VirtualRig) -> None:
        frame = await rig.camera.expose(5.0)
        assert frame.mid_exposure_utc is not None
        hours_ago = frame.mid_exposure_utc - timedelta(hours=3)
        early = replace(frame, mid_exposure_utc=hours_ago)
        verdict = rig.sky.verdict(frame, Hint(center=rig.mechanics.truth(), radius_deg=2.0), SolveSettings())
        found = await rig.navigator.frame(early, verdict)
        assert found.look is None
        assert "not read" in found.why
        assert rig.navigator.believed(hours_ago) is None
        assert rig.journal.looks[-1].reason == "not-read"
        with pytest.raises(BadFrame):
            await rig.navigator.frame(replace(frame, mid_exposure_utc=None), verdict)

    in_virtual_time(work)


def test_an_offset_without_a_target_and_a_second_work_are_refused() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.slew(rig.up(-20.0, 30.0))
        for _ in range(2):
            found = await identified(rig, await exposed(rig))
        assert found.look is not None
        with pytest.raises(BadRequest):
            await rig.navigator.correct(found.look, by="offset", target=None)
        running = asyncio.ensure_future(rig.navigator.center(rig.up(10.0, 20.0)))
        await rig.clock.sleep(1.0)
        with pytest.raises(Busy):
            await rig.navigator.correct(found.look, by="offset", target=rig.up(0.0, 0.0))
        assert rig.navigator.activity == "centering"
        await rig.navigator.read_mount()
        await running

    in_virtual_time(work)


def test_a_look_leaves_all_its_absolute_values() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.slew(rig.up(-20.0, 30.0))
        look = await rig.navigator.look()
        record = rig.journal.looks[-1]
        assert record.look_id == look.look_id == record.cause.look_id
        assert record.solved
        assert record.utc == look.mid_exposure_utc
        assert record.seen == look.seen
        matrix = look.solution.center_covariance_arcsec2
        assert record.covariance_arcsec2 == (matrix[0, 0], matrix[0, 1], matrix[1, 1])
        assert (record.before, record.after) == (look.before, look.after)
        assert record.segment_id == rig.navigator.mount.segment_id == look.segment_id
        assert record.air == AIR
        assert record.dut1_s == earth_orientation(record.utc).dut1_s
        assert record.camera == "truth camera"
        assert record.exposure_s == 5.0
        assert record.scale_arcsec_px == look.solution.scale_arcsec_px
        assert record.rotation_deg == look.solution.rotation_deg
        assert record.pairs == look.solution.pairs
        assert record.used == "look"
        assert record.cause.why == "looking"

    in_virtual_time(work)


def test_readings_are_kept_for_a_while_and_found_round_an_exposure() -> None:
    kept = ReadingHistory(keep=timedelta(minutes=10))
    here = Icrs(10.0, 20.0)

    def reading(after_s: float, north_arcsec: float = 0.0, slewing: bool | None = None) -> MountReading:
        return MountReading(displaced(here, 0.0, north_arcsec), START + timedelta(seconds=after_s), slewing)

    for second in range(0, 100, 10):
        kept.add(reading(second))
    kept.add(reading(50))
    assert len(kept) == 10
    within = timedelta(seconds=30)
    around = kept.around(START + timedelta(seconds=33), START + timedelta(seconds=55), within)
    assert around is not None
    assert (around.before, around.after) == (reading(30), reading(60))
    assert around.moved_arcsec == 0.0
    kept.add(reading(100, 40.0, slewing=True))
    kept.add(reading(110))
    around = kept.around(START + timedelta(seconds=91), START + timedelta(seconds=105), within)
    assert around is not None
    assert around.moved_arcsec == pytest.approx(40.0, abs=1e-6)
    assert around.slewing
    assert kept.around(START + timedelta(seconds=108), START + timedelta(seconds=120), within) is None
    assert kept.around(START - timedelta(seconds=9), START + timedelta(seconds=5), within) is None
    kept.add(reading(900))
    assert len(kept) == 1
    assert kept.around(START + timedelta(seconds=100), START + timedelta(seconds=880), within) is None


def test_frames_of_another_camera_poison_nothing_that_is_known_of_the_one_that_looks() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-20.0, 30.0)
        await rig.navigator.center(target)
        for _ in range(4):
            await rig.navigator.look()
        before = rig.navigator.learned.normal
        assert before is not None
        for _ in range(12):
            frame = await exposed(rig)
            # a science camera: other pixels, at another angle
            found = await identified(rig, frame, scale_by=1.2)
            assert found.look is not None
        assert rig.navigator.learned.normal == before
        report = await rig.navigator.center(rig.up(-40.0, 35.0))
        assert rig.off_arcsec(report.target) < 31.0

    in_virtual_time(work)
