"""Old frames that come as new ones: no slew is answered by the sky of before it, and the camera is named."""

from __future__ import annotations

from datetime import timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.simulated.truth_camera import TruthCamera
from mountnav.errors import CameraStale, SyncDoubt
from mountnav.journal.records import EntryKind
from mountnav.navigation.frames_seen import fingerprint
from mountnav.sky.sphere import separation_arcsec
from tests.navigation.virtual_rig import VirtualRig, in_virtual_time


def _ail(rig: VirtualRig, habit: str) -> TruthCamera:
    camera = rig.camera
    camera._habit, camera._ails_from = habit, camera.frames  # type: ignore[assignment]
    return camera


def test_a_frozen_camera_syncs_nothing_and_is_named() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.center(rig.up(-20.0, 30.0))
        camera = _ail(rig, "frozen")
        await rig.navigator.look()  # the frame that it stays with
        sent = rig.mount.received.count("sync")
        with pytest.raises(CameraStale, match="pixel for pixel"):
            await rig.navigator.center(rig.up(-40.0, 40.0))
        assert rig.mount.received.count("sync") == sent
        assert rig.told("camera-stale")
        assert any("camera" in one.what for one in rig.entries(EntryKind.FAULT))
        camera.mend()
        report = await rig.navigator.center(rig.up(-40.0, 40.0))
        assert rig.off_arcsec(report.target) < 31.0

    in_virtual_time(work)


def test_a_camera_one_frame_behind_centers_nothing_wrongly_and_is_named() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.look()
        camera = _ail(rig, "one-behind")
        for number in range(4):
            target = rig.up(-20.0 - 15.0 * number, 30.0)
            try:
                await rig.navigator.center(target)
            except CameraStale:
                break
            assert rig.off_arcsec(target) < 31.0
        else:
            pytest.fail("it was never named")
        assert rig.told("camera-stale")[-1]["times"] == 2
        # the old frames stand in the journal as what they are, and no model learns from them
        assert any(one.solved and one.reason == str(SyncDoubt.NOT_FRESH) for one in rig.journal.looks)
        camera.mend()
        target = rig.up(-25.0, 35.0)
        await rig.navigator.center(target)
        assert rig.off_arcsec(target) < 31.0

    in_virtual_time(work)


def test_a_sync_that_is_ordered_after_a_slew_takes_no_frame_from_before_it() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.center(rig.up(-20.0, 30.0))
        _ail(rig, "one-behind")
        await rig.navigator.offset(900.0, 600.0)
        found = (await rig.navigator.sync()).look
        truth = rig.mechanics.truth(found.mid_exposure_utc)
        assert separation_arcsec(found.seen, truth) < 5.0

    in_virtual_time(work)


def test_a_frame_sent_twice_is_no_old_frame_but_one_with_another_time_is() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.look()
        frames = rig.navigator._equipment.frames
        frame = await rig.navigator.camera.expose(5.0)
        from dataclasses import replace

        from mountnav.navigation.reports import camera_of

        seen, print_ = frames.of(camera_of(frame)), fingerprint(frame.pixels)
        assert not seen.repeats(frame, print_)
        assert not seen.repeats(frame, print_)
        assert frame.mid_exposure_utc is not None
        later = replace(frame, mid_exposure_utc=frame.mid_exposure_utc + timedelta(seconds=60.0))
        assert seen.repeats(later, print_)
        # a cap on the tube: one value all over says nothing
        flat = replace(frame, pixels=np.full((40, 60), 65535, dtype=np.uint16))
        again = replace(later, pixels=flat.pixels)
        assert not seen.repeats(flat, fingerprint(flat.pixels))
        assert not seen.repeats(again, fingerprint(again.pixels))

    in_virtual_time(work)


@given(st.integers(0, 11), st.integers(0, 14))
def test_one_pixel_makes_another_fingerprint(row: int, column: int) -> None:
    pixels = np.arange(180, dtype=np.uint16).reshape(12, 15)
    other = pixels.copy()
    other[row, column] += 1
    assert fingerprint(pixels) != fingerprint(other)
    assert fingerprint(pixels) == fingerprint(pixels[:, :].copy(order="F"))
    assert fingerprint(pixels) != fingerprint(pixels.reshape(15, 12))
