"""Cameras behind INDI whose drivers speak in another order or time than most."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import timedelta
from typing import Any

import pytest

from drivers.generic.camera import GenericCamera
from drivers.registry import open_camera
from mountnav.errors import Busy, Cancelled, DeviceMissing, DeviceRefused, DeviceSilent
from tests.drivers.indi.odd_camera import OddCamera, Step


@asynccontextmanager
async def bench(options: str = "", **odd: Any) -> AsyncIterator[tuple[GenericCamera, OddCamera]]:
    async with OddCamera(**odd) as there:
        camera = open_camera(there.url(options))
        assert isinstance(camera, GenericCamera)
        await camera.open()
        try:
            yield camera, there
        finally:
            await camera.close()


async def heard(camera: GenericCamera, words: bytes) -> None:
    async with asyncio.timeout(60.0):
        while not any(words in one.data for one in camera.wire_log.entries() if one.way == "mount->driver"):
            await asyncio.sleep(0.005)


async def noted(camera: GenericCamera, words: str, times: int = 1) -> None:
    async with asyncio.timeout(60.0):
        while sum(words in (one.meaning or "") for one in camera.wire_log.entries()) < times:
            await asyncio.sleep(0.005)


@pytest.mark.parametrize(
    "steps",
    [
        ["busy", "expose", "ok", "file"],
        # in a thread, whose Busy is said in between or not at all
        ["expose", "ok", "file"],
        pytest.param(["expose", "file", "ok"], marks=pytest.mark.long),
        ["busy", "expose", "idle", "busy", "file", "ok"],
    ],
    ids=lambda steps: "-".join(map(str, steps)),
)
async def test_a_file_counts_in_whatever_order_it_is_spoken_of(steps: list[Step]) -> None:
    async with bench("download_s=60", steps=steps) as (camera, _):
        for _ in range(2):
            frame = await camera.expose(0.1)
            assert frame.exposure_s == pytest.approx(0.1)
            assert frame.source == "Odd CCD, timed by its header"


async def test_one_that_says_that_it_began_when_it_was_done_is_believed_by_its_header(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As a driver does that exposes in a thread: it is busy for ever, by what it says."""
    monkeypatch.setattr("drivers.indi.codec.exposure._UNSAID_S", 0.1)
    monkeypatch.setattr("drivers.indi.camera._IDLE_WITHIN_S", 0.1)
    async with bench(steps=["expose", "file", "ok", "busy"]) as (camera, there):
        for _ in range(2):
            assert (await camera.expose(0.1)).source == "Odd CCD, timed by its header"
        there.steps = ["busy", "expose", "file", "ok"]
        assert (await camera.expose(0.1)).exposure_s == pytest.approx(0.1)


@pytest.mark.parametrize("odd", [{"timed": False}, {"clock_off": timedelta(hours=1)}], ids=str)
async def test_one_before_its_beginning_without_a_time_that_fits_is_nobodys(
    odd: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.indi.codec.exposure._UNSAID_S", 0.1)
    async with bench(steps=["expose", "file", "busy"], **odd) as (camera, _):
        running = asyncio.create_task(camera.expose(0.1))
        await noted(camera, "dropped a file: it came before its driver said that it began")
        await camera.abort()
        with pytest.raises(Cancelled):
            await running


async def test_an_exposure_that_brings_no_file_in_time_is_ended() -> None:
    async with bench("download_s=0.1", steps=["busy"]) as (camera, there):
        with pytest.raises(DeviceSilent, match="no file came"):
            await camera.expose(0.05)
        async with asyncio.timeout(60.0):
            while there.orders()[-1] != "CCD_ABORT_EXPOSURE":
                await asyncio.sleep(0.005)


async def test_a_file_of_before_the_order_is_dropped_where_the_clocks_agree() -> None:
    """The last one's, packed long after it was done, or aborted and sent all the same."""
    async with bench() as (camera, there):
        await camera.expose(0.1)
        there.steps = ["busy", "expose", "old file", 0.05, "file", "ok"]
        frame = await camera.expose(0.1)
        assert frame.source == "Odd CCD, timed by its header"
        await noted(camera, "before this exposure was ordered")
        # a clock that was set back costs one exposure and not the night
        there.clock_off, there.steps = timedelta(seconds=-30.0), ["busy", "expose", "file", "ok"]
        running = asyncio.create_task(camera.expose(0.1))
        await noted(camera, "before this exposure was ordered", times=2)
        await camera.abort()
        with pytest.raises(Cancelled):
            await running
        assert "our clock (its header is -30." in (await camera.expose(0.1)).source


async def test_a_refusal_that_comes_late_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.indi.camera._NO_FILE_S", 0.1)
    async with bench(steps=[0.3, "alert"]) as (camera, there):
        with pytest.raises(DeviceRefused, match="the exposure was ended"):
            await camera.expose(0.1)
        # one of before, and then it begins
        there.steps = [0.1, "alert", "busy", "expose", "file", "ok"]
        assert (await camera.expose(0.1)).exposure_s == pytest.approx(0.1)


@pytest.mark.parametrize("chip", ["CCD1", "CCD2"])
async def test_the_whole_chip_is_read_out_again_after_another_program_chose_a_part(chip: str) -> None:
    """The middle of a part is not where the telescope points."""
    async with bench(f"chip={chip}", chip=chip, frame=[40.0, 0.0, 20.0, 10.0]) as (camera, there):
        assert camera.done == ("the whole chip is read out",)
        there.frame = [0.0, 30.0, 64.0, 18.0]
        there.set_numbers("GUIDER_FRAME" if chip == "CCD2" else "CCD_FRAME", "Ok", Y=30.0, HEIGHT=18.0)
        await heard(camera, b"HEIGHT'>18.0")
        frame = await camera.expose(0.05)
        assert frame.pixels.shape == (48, 64)


async def test_one_that_keeps_a_part_of_its_chip_is_refused() -> None:
    with pytest.raises(DeviceRefused, match=r"reads out .* and not all 64 × 48 pixels"):
        async with bench(frame=[40.0, 0.0, 20.0, 10.0], stubborn=True):
            pass


async def test_a_driver_that_was_started_anew_without_a_word_is_connected_again() -> None:
    """As one behind a second server, which tells its properties again and no end of the old ones."""
    async with bench(steps=["busy", 60.0]) as (camera, there):
        running = asyncio.create_task(camera.expose(20.0))
        await heard(camera, b"Busy")
        there.begin_anew()
        with pytest.raises(DeviceMissing, match="driver"):
            await running
        there.steps = ["busy", "expose", "file", "ok"]
        asked = there.blobs
        assert (await camera.expose(0.05)).exposure_s == pytest.approx(0.05)
        assert there.blobs > asked


async def test_another_programs_order_ends_ours_and_theirs_is_left_alone() -> None:
    async with bench(steps=["busy", 60.0]) as (camera, there):
        running = asyncio.create_task(camera.expose(20.0))
        await heard(camera, b"Busy")
        there.overtake()
        with pytest.raises(DeviceRefused, match="ended by another program"):
            await running
        assert "CCD_ABORT_EXPOSURE" not in there.orders()


async def test_an_abort_before_ours_is_ordered_is_not_sent_to_another_programs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drivers.indi.camera._IDLE_WITHIN_S", 0.2)
    async with bench() as (camera, there):
        there.set_numbers("CCD_EXPOSURE", "Busy", CCD_EXPOSURE_VALUE=30.0)
        await heard(camera, b"Busy")
        running = asyncio.create_task(camera.expose(0.05))
        await asyncio.sleep(0)
        await camera.abort()
        there.set_numbers("CCD_EXPOSURE", "Busy", CCD_EXPOSURE_VALUE=29.0)
        with pytest.raises(Cancelled):
            await running
        with pytest.raises(Busy, match="another program"):
            await camera.expose(0.05)
        assert there.orders() == []


async def test_an_abort_waits_for_no_driver_that_answers_nothing() -> None:
    async with bench(steps=[]) as (camera, there):
        there.mute = True
        running = asyncio.create_task(camera.expose(20.0))
        async with asyncio.timeout(60.0):
            while "CCD_EXPOSURE" not in there.orders():
                await asyncio.sleep(0.005)
        await camera.abort()
        with pytest.raises(Cancelled):
            await running
        async with asyncio.timeout(60.0):
            while there.orders()[-1] != "CCD_ABORT_EXPOSURE":
                await asyncio.sleep(0.005)


async def test_a_definition_that_crosses_the_order_to_connect_is_no_answer_to_it() -> None:
    async with bench(connected=False, stale=True) as (camera, there):
        assert there.orders().count("CONNECTION") == 1
        assert (await camera.expose(0.05)).exposure_s == pytest.approx(0.05)
