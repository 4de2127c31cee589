"""A camera behind a real `indiserver`, with `indi_simulator_ccd` as the camera; without stars here."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.generic.camera import GenericCamera
from drivers.indi.codec import messages
from drivers.indi.codec.exposure import Exposure
from drivers.indi.codec.messages import Blob, Changed, State
from drivers.registry import open_camera
from mountnav.clock import utc_now
from mountnav.errors import BadRequest, BadSettings, Busy, Cancelled, DeviceMissing, DeviceRefused
from tests.drivers.indi.real_server import CCD, IndiServer


@pytest.fixture
async def server(tmp_path: Path) -> AsyncIterator[IndiServer]:
    one = IndiServer(("indi_simulator_ccd",), tmp_path / "home")
    await one.start()
    try:
        yield one
    finally:
        await one.kill()


def camera_of(server: IndiServer, options: str = "") -> GenericCamera:
    camera = open_camera(f"indi://127.0.0.1:{server.port}/CCD%20Simulator?{options}".rstrip("?"))
    assert isinstance(camera, GenericCamera)
    return camera


@pytest.fixture
async def camera(server: IndiServer) -> AsyncIterator[GenericCamera]:
    one = camera_of(server)
    await one.open()
    yield one
    await one.close()


async def test_a_frame_comes_with_its_time(camera: GenericCamera) -> None:
    before = utc_now()
    frame = await camera.expose(0.4)
    after = utc_now()
    assert (frame.width_px, frame.height_px) == (1280, 1024)
    assert frame.pixels.dtype == np.uint16
    assert frame.exposure_s == pytest.approx(0.4)
    assert frame.mid_exposure_utc is not None
    half = timedelta(seconds=0.2)
    # the simulator's clock is ours: what its header says must lie between
    assert before + half - timedelta(seconds=0.1) <= frame.mid_exposure_utc <= after - half
    assert frame.source == "CCD Simulator, timed by its header"
    # "Got no stars" is what its driver says in front of each exposure here, and no refusal
    assert any(b"Got no stars" in entry.data for entry in camera.wire_log.entries())


async def test_a_compressed_file_is_the_same_image(server: IndiServer, camera: GenericCamera) -> None:
    plain = await camera.expose(0.2)
    other = server.device(CCD)
    await other.bring_up(may_connect=False, needed=("CCD_COMPRESSION",))
    await other.set_switches("CCD_COMPRESSION", {"INDI_ENABLED": True, "INDI_DISABLED": False})
    await other.client.close()
    packed = await camera.expose(0.2)
    assert any(b".fits.fz" in entry.data for entry in camera.wire_log.entries())
    assert packed.pixels.shape == plain.pixels.shape
    assert packed.pixels.dtype == plain.pixels.dtype
    assert np.median(np.float64(packed.pixels)) == pytest.approx(np.median(np.float64(plain.pixels)), abs=3.0)
    assert packed.mid_exposure_utc != plain.mid_exposure_utc


async def test_a_driver_that_is_slow_to_begin_is_waited_for(tmp_path: Path) -> None:
    """The simulator asks a program for stars within its exposure, and says that it began when it has them."""
    program = tmp_path / "bin" / "gsc"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\nsleep 1.5\n")
    program.chmod(0o755)
    path = f"{program.parent}:{os.environ['PATH']}"
    server = IndiServer(("indi_simulator_ccd",), tmp_path / "home", {"PATH": path})
    await server.start()
    try:
        camera = camera_of(server, "download_s=15")
        await camera.open()
        frame = await camera.expose(1.0)
        assert frame.exposure_s == pytest.approx(1.0)
        await camera.close()
    finally:
        await server.kill()


async def test_an_aborted_exposure_ends_and_its_file_is_nobodys(camera: GenericCamera) -> None:
    running = asyncio.create_task(camera.expose(20.0))
    async with asyncio.timeout(20.0):
        while not any(b'"Busy"' in entry.data for entry in camera.wire_log.entries()):
            await asyncio.sleep(0.01)
    with pytest.raises(Busy, match="an exposure is running"):
        await camera.expose(1.0)
    await camera.abort()
    with pytest.raises(Cancelled):
        await running
    frame = await camera.expose(0.3)
    assert frame.exposure_s == pytest.approx(0.3)


async def test_a_cancelled_exposure_is_aborted(camera: GenericCamera) -> None:
    running = asyncio.create_task(camera.expose(20.0))
    async with asyncio.timeout(20.0):
        while not any(b'"Busy"' in entry.data for entry in camera.wire_log.entries()):
            await asyncio.sleep(0.01)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert b"CCD_ABORT_EXPOSURE" in camera.wire_log.entries()[-1].data
    assert (await camera.expose(0.2)).exposure_s == pytest.approx(0.2)


@pytest.mark.long
async def test_another_programs_exposure_is_left_alone(
    server: IndiServer, camera: GenericCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.indi.camera._IDLE_WITHIN_S", 1.0)
    other = server.device(CCD)
    await other.bring_up(may_connect=False, needed=("CCD_EXPOSURE",))
    await other.ordered(
        messages.new_numbers(CCD, "CCD_EXPOSURE", {"CCD_EXPOSURE_VALUE": 30.0}), asking="CCD_EXPOSURE"
    )
    with pytest.raises(Busy, match="another program"):
        await camera.expose(0.2)
    await other.client.close()
    ours = [one.data for one in camera.wire_log.entries() if one.way == "driver->mount"]
    assert not any(b"newNumberVector" in order for order in ours)


async def test_a_part_of_the_chip_that_another_program_chose_is_given_up(
    server: IndiServer, camera: GenericCamera
) -> None:
    """And its exposure in the midst of ours ends ours, without an abort of theirs."""
    other = server.device(CCD)
    await other.bring_up(may_connect=False, needed=("CCD_FRAME",))
    part = {"X": 600.0, "Y": 0.0, "WIDTH": 200.0, "HEIGHT": 100.0}
    await other.ordered(messages.new_numbers(CCD, "CCD_FRAME", part), asking="CCD_FRAME")
    async with asyncio.timeout(60.0):
        while not any(b"CCD_FRAME" in one.data and b"600" in one.data for one in camera.wire_log.entries()):
            await asyncio.sleep(0.01)
    assert (await camera.expose(0.2)).pixels.shape == (1024, 1280)
    assert camera.done == ("the whole chip is read out",)
    running = asyncio.create_task(camera.expose(20.0))
    async with asyncio.timeout(60.0):
        while not any(b'"Busy"' in entry.data for entry in camera.wire_log.entries()[-3:]):
            await asyncio.sleep(0.01)
    await other.ordered(
        messages.new_numbers(CCD, "CCD_EXPOSURE", {"CCD_EXPOSURE_VALUE": 30.0}), asking="CCD_EXPOSURE"
    )
    with pytest.raises(DeviceRefused, match="another program"):
        await running
    await other.client.close()
    assert not any(
        b"CCD_ABORT" in one.data for one in camera.wire_log.entries() if one.way == "driver->mount"
    )


@pytest.mark.long
async def test_the_guide_chip_exposes_for_itself(server: IndiServer) -> None:
    camera = camera_of(server, "chip=CCD2&binning=2")
    await camera.open()
    frame = await camera.expose(0.3)
    assert frame.exposure_s == pytest.approx(0.3)
    assert frame.source == "CCD Simulator, timed by its header"
    ours = [one.data for one in camera.wire_log.entries() if one.way == "driver->mount"]
    assert any(b"GUIDER_EXPOSURE" in order for order in ours)
    await camera.close()


@pytest.mark.long
async def test_a_driver_that_dies_in_an_exposure_is_noticed_and_its_successor_sends_files(
    tmp_path: Path,
) -> None:
    server = IndiServer(("indi_simulator_ccd",), tmp_path / "home", restarts=5)
    await server.start()
    try:
        camera = camera_of(server)
        await camera.open()
        running = asyncio.create_task(camera.expose(30.0))
        async with asyncio.timeout(60.0):
            while not any(b'"Busy"' in entry.data for entry in camera.wire_log.entries()):
                await asyncio.sleep(0.01)
        server.kill_driver("indi_simulator_ccd")
        with pytest.raises(DeviceMissing):
            await running
        async with asyncio.timeout(60.0):
            while True:
                try:
                    assert (await camera.expose(0.2)).exposure_s == pytest.approx(0.2)
                    break
                except DeviceMissing:
                    # indiserver takes some seconds to run it again
                    await asyncio.sleep(0.2)
        await camera.close()
    finally:
        await server.kill()


@pytest.mark.long
async def test_what_was_asked_for_is_set_at_opening_and_again_after_a_loss(server: IndiServer) -> None:
    async def spoil() -> None:
        other = server.device(CCD)
        await other.bring_up(may_connect=True, needed=("UPLOAD_MODE",))
        local = {"UPLOAD_CLIENT": False, "UPLOAD_LOCAL": True, "UPLOAD_BOTH": False}
        await other.set_switches("UPLOAD_MODE", local)
        await other.client.close()

    await spoil()
    camera = camera_of(server, "binning=2&mount=EQMod%20Mount")
    await camera.open()
    wanted = ("files are sent to clients", "it listens to EQMod Mount", "binning is 2")
    assert camera.done == wanted
    assert (await camera.expose(0.2)).pixels.shape == (512, 640)
    running = asyncio.create_task(camera.expose(20.0))
    async with asyncio.timeout(20.0):
        while camera.wire_log.entries()[-1].data.count(b'"Busy"') == 0:
            await asyncio.sleep(0.01)
    await server.kill()
    with pytest.raises(DeviceMissing):
        await running
    with pytest.raises(DeviceMissing):
        await camera.expose(0.2)
    await server.start()
    await spoil()
    assert (await camera.expose(0.2)).pixels.shape == (512, 640)
    assert camera.done[0] == wanted[0]
    await camera.close()
    with pytest.raises(DeviceMissing, match="not connected"):
        await camera.expose(0.2)


@pytest.mark.parametrize("exposure_s", [0.0, -1.0, float("nan"), float("inf")])
async def test_exposures_that_make_no_sense_are_refused(exposure_s: float) -> None:
    camera = open_camera("indi://127.0.0.1:9/CCD%20Simulator")
    with pytest.raises(BadRequest):
        await camera.expose(exposure_s)


@pytest.mark.parametrize("options", ["colour=yes", "binning=0", "connect=maybe", "focal_length_mm=long"])
def test_options_that_make_no_sense_are_refused(options: str) -> None:
    with pytest.raises(BadSettings):
        open_camera(f"indi://127.0.0.1:9/CCD%20Simulator?{options}")


# -- which file is the exposure's own ------------------------------------------------------------------

NOON = datetime(2026, 11, 22, 12, 0, 0, tzinfo=UTC)


def exposure_of(exposure_s: float) -> Exposure:
    return Exposure(exposure_s, NOON, 100.0, 0)


def file() -> Changed:
    blob = Blob(".fits", 5, None, (b"c3RhcnM=",))
    return Changed(CCD, "CCD1", "BLOB", State.OK, {"CCD1": blob}, "", b"")


def test_a_file_before_its_exposure_has_begun_or_can_be_over_is_dropped() -> None:
    exposure = exposure_of(2.0)
    assert exposure.take_files(file(), NOON, 100.5) is not None
    exposure.take_state(State.BUSY, NOON, 100.5)
    assert exposure.take_files(file(), NOON, 101.5) is not None
    assert exposure.files == []
    assert exposure.take_files(file(), NOON, 102.5) is None
    assert len(exposure.files) == 1


def begun_late() -> Exposure:
    """Its driver exposed before it said that it began, as one does that is busy with something else."""
    exposure = exposure_of(2.0)
    exposure.take_state(State.BUSY, NOON, 103.0)
    return exposure


@pytest.mark.parametrize("file_first", [True, False])
def test_a_file_counts_that_came_soon_after_a_late_beginning(file_first: bool) -> None:
    exposure = begun_late()
    if file_first:
        assert exposure.take_files(file(), NOON, 103.1) is None
        exposure.settle(110.0)
        assert exposure.files == []
        exposure.take_state(State.OK, NOON, 103.2)
        exposure.settle(103.3)
        assert exposure.files == []
        exposure.settle(104.0)
    else:
        exposure.take_state(State.OK, NOON, 103.1)
        assert exposure.take_files(file(), NOON, 103.2) is None
    assert len(exposure.files) == 1
    exposure.settle(110.0)
    assert len(exposure.files) == 1


def test_a_file_in_time_goes_before_an_early_one() -> None:
    exposure = begun_late()
    exposure.take_files(file(), NOON, 103.1)
    exposure.take_state(State.OK, NOON, 105.0)
    in_time = NOON + timedelta(seconds=5.1)
    exposure.take_files(file(), in_time, 105.1)
    exposure.settle(110.0)
    assert [came for _, came in exposure.files] == [in_time]


def test_a_file_before_an_exposure_could_be_over_since_its_order_never_counts() -> None:
    exposure = exposure_of(2.0)
    exposure.take_state(State.BUSY, NOON, 101.0)
    assert exposure.take_files(file(), NOON, 101.5) is not None
    exposure.take_state(State.OK, NOON, 101.6)
    exposure.settle(110.0)
    assert exposure.files == []


def test_the_state_of_an_earlier_exposure_does_not_end_this_one() -> None:
    exposure = exposure_of(2.0)
    exposure.take_state(State.OK, NOON, 100.1)
    exposure.take_state(State.ALERT, NOON, 100.2)
    assert exposure.ended_s is None
    assert not exposure.failed
    exposure.take_state(State.BUSY, NOON, 100.3)
    exposure.take_state(State.IDLE, NOON, 101.0)
    assert exposure.ended_s == 101.0


def test_one_that_is_done_is_not_over_before_its_file_came() -> None:
    """It is packed and sent after that: seconds on a small computer, and some say idle meanwhile."""
    exposure = exposure_of(2.0)
    exposure.take_state(State.BUSY, NOON, 100.3)
    exposure.take_state(State.OK, NOON, 102.3)
    exposure.take_state(State.IDLE, NOON, 102.4)
    assert exposure.done
    assert exposure.ended_s is None
    assert exposure.take_files(file(), NOON, 125.0) is None
    assert len(exposure.files) == 1


@pytest.mark.parametrize(
    ("told_s", "other"), [(2.0, False), (2.05, False), (None, False), (1.0, True), (30.0, True)]
)
def test_a_file_that_tells_another_exposure_is_not_this_one(told_s: float | None, other: bool) -> None:
    assert exposure_of(2.0).is_of_another(told_s) is other


@pytest.mark.parametrize(
    ("header_s", "middle_s", "whose"),
    [
        (1.4, 1.4, "its header"),
        (0.3, 0.3, "its header"),
        (3.4, 3.4, "its header"),
        # an hour off, as after a change to summer time
        (3601.4, 1.5, "our clock (its header is +3599.9 s off)"),
        (None, 1.5, "our clock (its header gives no time)"),
    ],
)
def test_the_header_counts_where_our_clock_allows_it(
    header_s: float | None, middle_s: float, whose: str
) -> None:
    exposure = exposure_of(2.0)
    exposure.take_state(State.BUSY, NOON + timedelta(seconds=0.5), 100.5)
    by_header = None if header_s is None else NOON + timedelta(seconds=header_s)
    middle, said = exposure.middle(by_header, NOON + timedelta(seconds=4.0), 1.0)
    assert (middle - NOON).total_seconds() == pytest.approx(middle_s)
    assert said == whose
