"""An Alpaca camera against a small server of the tests' own: sizes, times, elements, and what goes wrong."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import timedelta
from typing import Any

import numpy as np
import pytest

from drivers.generic.camera import GenericCamera
from drivers.registry import open_camera
from mountnav.clock import utc_now
from mountnav.errors import (
    BadFrame,
    BadRequest,
    BadSettings,
    Busy,
    Cancelled,
    DeviceGarbled,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
)
from tests.drivers.alpaca.alpaca_server import AlpacaError, AlpacaServer, FakeCamera, Fault


class Bench:
    """A camera of ours, the server, and the camera behind it."""

    def __init__(self, camera: GenericCamera, server: AlpacaServer, fake: FakeCamera) -> None:
        self.camera, self.server, self.fake = camera, server, fake

    def fault(self, member: str, what: str, **details: Any) -> None:
        self.server.faults.append(Fault(member, what, **details))

    async def until_exposing(self) -> None:
        """It exposes, and our camera knows it: an abort before that is sent once more, to be sure."""
        async with asyncio.timeout(60.0):
            while not (self.fake.get_camerastate({}) and self.answered()):
                await asyncio.sleep(0.01)

    def answered(self) -> bool:
        said = self.camera.wire_log.entries()
        asked = [one.number for one in said if b"/startexposure" in one.data]
        return bool(asked) and any(one.number > asked[-1] and one.way == "mount->driver" for one in said)


@asynccontextmanager
async def bench(fake: FakeCamera | None = None, options: str = "", **more: Any) -> AsyncIterator[Bench]:
    fake = fake or FakeCamera()
    with AlpacaServer({"camera/0": fake}, **more) as server:
        camera = open_camera(server.url("camera/0", f"poll_s=0.02&{options}".rstrip("&")))
        assert isinstance(camera, GenericCamera)
        await camera.open()
        try:
            yield Bench(camera, server, fake)
        finally:
            await camera.close()


async def test_a_frame_comes_whole_and_with_its_time() -> None:
    async with bench() as one:
        before = utc_now()
        frame = await one.camera.expose(0.2)
        after = utc_now()
        # somebody had left a part of the chip selected
        assert one.camera.done == ()
        assert (frame.height_px, frame.width_px) == (48, 64)
        y, x = np.mgrid[:48, :64]
        assert np.array_equal(frame.pixels, (100 + x + 3 * y) % 251)
        assert frame.pixels.dtype == np.uint16
        assert frame.saturation_adu == 65535.0
        assert frame.exposure_s == pytest.approx(0.2)
        assert frame.mid_exposure_utc is not None
        half = timedelta(seconds=0.1)
        assert before + half <= frame.mid_exposure_utc <= after - half
        assert frame.source.endswith("timed by the camera's clock")
        assert one.server.orders() == ["connect", "startx", "starty", "startexposure"]


@pytest.mark.parametrize("dtype", ["int32", pytest.param("float64", marks=pytest.mark.long)])
async def test_each_kind_of_element_is_read(dtype: str) -> None:
    fake = FakeCamera()
    fake.dtype, fake.data_start = dtype, 60
    async with bench(fake) as one:
        frame = await one.camera.expose(0.02)
        assert frame.pixels.dtype == np.dtype(dtype)
        assert float(frame.pixels[2, 7]) == (100 + 7 + 3 * 2) % 251


@pytest.mark.parametrize("binary", [True, pytest.param(False, marks=pytest.mark.long)])
async def test_color_planes_become_one(binary: bool) -> None:
    fake = FakeCamera()
    fake.planes, fake.binary = 3, binary
    async with bench(fake) as one:
        frame = await one.camera.expose(0.02)
        assert frame.pixels.shape == (48, 64)
        assert float(frame.pixels[2, 7]) == pytest.approx((100 + 7 + 3 * 2) % 251 + 1.0)


async def test_a_server_that_knows_json_only_is_understood() -> None:
    fake = FakeCamera()
    fake.binary = False
    async with bench(fake, gzip=True) as one:
        frame = await one.camera.expose(0.02)
        assert frame.pixels.dtype == np.uint16
        assert int(frame.pixels[2, 7]) == (100 + 7 + 3 * 2) % 251


async def test_binning_and_gain_are_set_before_each_exposure() -> None:
    fake = FakeCamera()
    fake.gains = ["low", "high"]
    async with bench(fake, "binning=2&gain=high&focal_length_mm=800") as one:
        assert set(one.camera.done) >= {"BinX is 2", "BinY is 2", "NumX is 32", "NumY is 24", "Gain is high"}
        frame = await one.camera.expose(0.02)
        assert (frame.height_px, frame.width_px) == (24, 32)
        assert fake.values["gain"] == 1
        scale = 206.264806 * 3.76 * 2 / 800
        assert frame.hint.scale_low_arcsec_px == pytest.approx(0.9 * scale)
        assert frame.hint.scale_high_arcsec_px == pytest.approx(1.1 * scale)
        # another program takes a part of the chip in between
        fake.values |= {"binx": 1, "numx": 10}
        assert (await one.camera.expose(0.02)).pixels.shape == (24, 32)


@pytest.mark.long
async def test_a_mosaic_is_told_as_files_are() -> None:
    fake = FakeCamera(256, 256)
    fake.values["sensortype"] = 2
    noise = np.random.default_rng(1).normal(0.0, 3.0, (256, 256))
    mosaic = np.tile([[400.0, 800.0], [800.0, 300.0]], (128, 128)) + noise
    fake.pixels = lambda: mosaic.astype(np.uint16)  # type: ignore[method-assign]
    async with bench(fake) as one:
        frame = await one.camera.expose(0.02)
        assert frame.header["BAYERPAT"] == "RGGB"
        assert frame.mosaic


@pytest.mark.parametrize(
    ("off_s", "whose"),
    [(0.4, "the camera's clock"), (3600.0, r"our clock \(the camera's is \+3600.\d s off\)")],
)
@pytest.mark.long
async def test_its_clock_counts_where_ours_allows_it(off_s: float, whose: str) -> None:
    fake = FakeCamera()
    fake.clock_off = timedelta(seconds=off_s)
    async with bench(fake) as one:
        before = utc_now()
        frame = await one.camera.expose(0.1)
        assert re.search(f"timed by {whose}$", frame.source)
        assert frame.mid_exposure_utc is not None
        assert abs((frame.mid_exposure_utc - before).total_seconds()) < 60.0


@pytest.mark.long
async def test_a_camera_that_tells_no_time_is_timed_by_ours() -> None:
    fake = FakeCamera()
    fake.missing = {"lastexposurestarttime", "lastexposureduration"}
    async with bench(fake) as one:
        frame = await one.camera.expose(0.1)
        assert frame.source.endswith("our clock (the camera gives no time)")


async def test_an_abort_ends_the_exposure_here_and_there() -> None:
    async with bench() as one:
        running = asyncio.create_task(one.camera.expose(30.0))
        await one.until_exposing()
        with pytest.raises(Busy, match="an exposure is running"):
            await one.camera.expose(1.0)
        await one.camera.abort()
        with pytest.raises(Cancelled):
            await running
        assert (await one.camera.expose(0.05)).exposure_s == pytest.approx(0.05)
        assert one.fake.aborts == 1
        cancelled = asyncio.create_task(one.camera.expose(30.0))
        await one.until_exposing()
        cancelled.cancel()
        with pytest.raises(asyncio.CancelledError):
            await cancelled
        assert (await one.camera.expose(0.05)).exposure_s == pytest.approx(0.05)
        assert one.fake.aborts == 2


async def test_an_abort_that_overtakes_the_order_ends_the_exposure_all_the_same() -> None:
    async with bench() as one:
        one.fault("startexposure", "slow", seconds=0.5)
        running = asyncio.create_task(one.camera.expose(30.0))
        async with asyncio.timeout(60.0):
            while "startexposure" not in one.server.orders():
                await asyncio.sleep(0.01)
        await one.camera.abort()
        with pytest.raises(Cancelled):
            await running
        async with asyncio.timeout(60.0):
            while one.fake.aborts < 2:
                await asyncio.sleep(0.01)
        assert one.fake.get_camerastate({}) == 0


@pytest.mark.long
async def test_an_image_of_before_is_not_taken_for_this_one() -> None:
    async with bench() as one:
        first = await one.camera.expose(0.05)
        # it says "ready" of the last image, once, after the new order
        told = one.fake.get_lastexposurestarttime({})
        body = f'{{"Value": "{told}", "ErrorNumber": 0}}'
        one.fault("lastexposurestarttime", "text", body=body, times=2)
        second = await one.camera.expose(0.05)
        assert second.mid_exposure_utc != first.mid_exposure_utc


@pytest.mark.long
async def test_failures_are_told_in_the_drivers_words() -> None:
    async with bench(options="download_s=0.5") as one:
        one.fake.failure = AlpacaError(0x500, "the sensor overheated")
        with pytest.raises(DeviceRefused, match="the sensor overheated"):
            await one.camera.expose(0.02)
        one.fake.failure = None
        one.fake.put_abortexposure({})
        one.fake.image_error = AlpacaError(0x500, "the download failed")
        with pytest.raises(DeviceRefused, match="the download failed"):
            await one.camera.expose(0.02)
        one.fake.image_error = None
        one.fault("startexposure", "error", number=0x40B, body="the cooler is not ready")
        with pytest.raises(DeviceRefused, match="the cooler is not ready"):
            await one.camera.expose(0.02)
        one.fake.late_s = 60.0
        with pytest.raises(DeviceSilent, match="no image was ready"):
            await one.camera.expose(0.02)
        one.fake.late_s = 0.0
        one.fault("imagearray", "html")
        with pytest.raises(DeviceGarbled, match="a page instead"):
            await one.camera.expose(0.02)
        image = one.fake.pixels()
        one.fake.pixels = lambda: image[:-3]  # type: ignore[method-assign]
        with pytest.raises(BadFrame, match="64 × 48 pixels were to come"):
            await one.camera.expose(0.02)


async def test_a_server_that_fails_while_it_reads_out_is_asked_again() -> None:
    async with bench() as one:
        one.fault("imageready", "status", number=503, times=2)
        one.fault("imagearray", "status", number=500)
        one.fault("imagearray", "half")
        assert (await one.camera.expose(0.02)).pixels.shape == (48, 64)
        asked = [member for _, member, _ in one.server.asked]
        assert asked.count("imagearray") == 3
        assert asked.count("startexposure") == 1


async def test_an_exposure_that_is_not_ours_is_never_aborted() -> None:
    async with bench() as one:
        one.fake.put_startexposure({"Duration": "3600", "Light": "True"})
        # another program's, and the server stumbles
        one.fault("camerastate", "status", number=503)
        with pytest.raises(DeviceSilent):
            await one.camera.expose(0.02)
        running = asyncio.create_task(one.camera.expose(0.02))
        async with asyncio.timeout(60.0):
            while [member for _, member, _ in one.server.asked].count("camerastate") < 3:
                await asyncio.sleep(0.01)
        await one.camera.abort()
        with pytest.raises(Cancelled):
            await running
        await one.camera.close()
        assert one.fake.aborts == 0


async def test_an_exposure_that_the_camera_took_for_the_nearest_it_has_is_ours() -> None:
    async with bench() as one:
        ordered = one.fake.put_startexposure
        one.fake.put_startexposure = lambda form: ordered(form | {"Duration": "0.4"})  # type: ignore[method-assign]
        frame = await one.camera.expose(0.3)
        assert frame.exposure_s == pytest.approx(0.4)
        assert frame.source.endswith("the camera's clock")


async def test_an_image_that_is_ready_while_it_exposes_is_the_last_one() -> None:
    fake = FakeCamera()
    fake.missing, fake.late_s = {"lastexposurestarttime", "lastexposureduration"}, 0.2
    fake.get_imageready = lambda _: True  # type: ignore[method-assign]
    states: list[int] = []
    pixels = fake.pixels
    fake.pixels = lambda: states.append(fake.get_camerastate({})) or pixels()  # type: ignore[method-assign, func-returns-value]
    async with bench(fake) as one:
        await one.camera.expose(0.02)
        assert states == [0]


@pytest.mark.parametrize("refuses", [True, pytest.param(False, marks=pytest.mark.long)])
async def test_a_chip_that_is_read_out_in_steps_gives_nearly_all_of_itself(refuses: bool) -> None:
    fake = FakeCamera(134, 96)
    answer = fake.answer

    def stepping(verb: str, member: str, form: dict[str, str]) -> Any:
        if verb == "put" and member == "numx":
            value = int(form["NumX"])
            if refuses and value % 8:
                raise AlpacaError(0x401, "NumX must be a multiple of 8")
            form = form | {"NumX": str(value - value % 8)}
        return answer(verb, member, form)

    fake.answer = stepping  # type: ignore[method-assign]
    async with bench(fake, "binning=3") as one:
        assert "NumX is 40" in one.camera.done
        assert (await one.camera.expose(0.02)).pixels.shape == (32, 40)


@pytest.mark.long
async def test_another_programs_exposure_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.alpaca.camera._IDLE_WITHIN_S", 0.2)
    async with bench() as one:
        one.fake.put_startexposure({"Duration": "3600", "Light": "True"})
        running = asyncio.create_task(one.camera.expose(0.02))
        with pytest.raises(Busy, match="another program"):
            await running
        assert "startexposure" not in one.server.orders()
        assert one.fake.aborts == 0


@pytest.mark.long
async def test_exposures_that_it_does_not_take_are_refused() -> None:
    async with bench() as one:
        for exposure_s in (0.0, -1.0, float("nan"), float("inf"), 0.0001, 1e5):
            with pytest.raises(BadRequest):
                await one.camera.expose(exposure_s)
        assert "startexposure" not in one.server.orders()


@pytest.mark.long
async def test_a_lost_server_is_opened_again_and_set_anew() -> None:
    async with bench(options="binning=2") as one:
        running = asyncio.create_task(one.camera.expose(30.0))
        await one.until_exposing()
        one.server.stop()
        one.fake.__init__()  # type: ignore[misc]
        await one.camera.abort()
        with pytest.raises(Cancelled):
            await running
        with pytest.raises(DeviceMissing):
            await one.camera.expose(0.02)
        one.server.start()
        assert (await one.camera.expose(0.02)).pixels.shape == (24, 32)
        await one.camera.close()
        with pytest.raises(DeviceMissing, match="not connected"):
            await one.camera.expose(0.02)


@pytest.mark.parametrize(
    "options", ["colour=yes", "binning=0", "connect=maybe", "focal_length_mm=long", "epoch=icrs"]
)
def test_options_that_make_no_sense_are_refused(options: str) -> None:
    with pytest.raises(BadSettings):
        open_camera(f"alpaca+http://127.0.0.1:9/camera/0?{options}")


@pytest.mark.long
async def test_gains_that_it_does_not_have_are_refused() -> None:
    with pytest.raises(DeviceRefused, match=r"no gain 'high'.*numbers alone"):
        async with bench(options="gain=high"):
            pass
