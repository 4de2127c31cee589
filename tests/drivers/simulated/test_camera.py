"""The simulated camera: waits, sees the truth of mid-exposure, can be aborted."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest

from drivers.simulated.camera import SimulatedCamera
from mountnav.catalog.stars import Stars
from mountnav.clock import utc_now
from mountnav.devices import Camera
from mountnav.errors import BadRequest, Busy, Cancelled
from mountnav.simulation.optics import SimulatedOptics
from mountnav.sky.coordinates import Icrs

OPTICS = SimulatedOptics(120, 90, 5.0)
PLACE = Icrs(30.0, 20.0)


class OneStar:
    """A catalog of one star in the middle."""

    name = "one star"

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        one: list[Any] = [np.array([v]) for v in (PLACE.ra_deg, PLACE.dec_deg, 0.1, 6.0, 0.0, 0.0)]
        return Stars(*[*one, epoch_yr, "V", self.name])


class Truth:
    """A place that passes the star at an instant; remembers when it was asked."""

    def __init__(self) -> None:
        self.asked: list[datetime] = []

    def __call__(self, utc: datetime) -> Icrs:
        self.asked.append(utc)
        return PLACE


async def test_it_sees_the_truth_of_mid_exposure() -> None:
    truth = Truth()
    camera: Camera = SimulatedCamera(truth, OPTICS, OneStar(), name="cam")
    await camera.open()
    before = utc_now()
    frame = await camera.expose(0.2)
    after = utc_now()
    assert after - before >= timedelta(seconds=0.19)
    # begin, middle and end show whether stars are trailed
    middle = frame.mid_exposure_utc
    assert middle is not None
    assert set(truth.asked) == {middle + timedelta(seconds=half) for half in (-0.1, 0.0, 0.1)}
    assert before + timedelta(seconds=0.1) <= middle <= after - timedelta(seconds=0.09)
    assert np.unravel_index(frame.pixels.argmax(), frame.pixels.shape) in {
        (44, 59),
        (44, 60),
        (45, 59),
        (45, 60),
    }
    await camera.close()


async def test_noise_depends_on_the_seed_and_the_frames_number() -> None:
    instant = datetime(2026, 11, 21, 22, tzinfo=UTC)

    async def two_frames(seed: int) -> list[np.ndarray]:
        camera = SimulatedCamera(Truth(), OPTICS, OneStar(), seed=seed, clock=lambda: instant)
        return [(await camera.expose(0.01)).pixels for _ in range(2)]

    first, again, other = await two_frames(1), await two_frames(1), await two_frames(2)
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(first[0], other[0])


async def test_abort_ends_an_exposure_at_once() -> None:
    truth = Truth()
    camera = SimulatedCamera(truth, OPTICS, OneStar(), name="cam")
    running = asyncio.create_task(camera.expose(3600.0))
    await asyncio.sleep(0)
    await camera.abort()
    with pytest.raises(Cancelled, match="cam"):
        await running
    assert truth.asked == []
    assert (await camera.expose(0.01)).exposure_s == 0.01  # and the next one works


async def test_abort_without_an_exposure_does_nothing() -> None:
    camera = SimulatedCamera(Truth(), OPTICS, OneStar())
    await camera.abort()
    assert (await camera.expose(0.01)).pixels.shape == (90, 120)


async def test_abort_while_the_frame_is_drawn() -> None:
    loop = asyncio.get_running_loop()

    def truth(utc: datetime) -> Icrs:
        asyncio.run_coroutine_threadsafe(camera.abort(), loop).result()
        return PLACE

    camera = SimulatedCamera(truth, OPTICS, OneStar())
    with pytest.raises(Cancelled):
        await camera.expose(0.01)


async def test_one_exposure_at_a_time() -> None:
    camera = SimulatedCamera(Truth(), OPTICS, OneStar())
    running = asyncio.create_task(camera.expose(3600.0))
    await asyncio.sleep(0)
    with pytest.raises(Busy):
        await camera.expose(1.0)
    await camera.close()
    with pytest.raises(Cancelled):
        await running


async def test_a_cancelled_task_frees_the_camera() -> None:
    camera = SimulatedCamera(Truth(), OPTICS, OneStar())
    running = asyncio.create_task(camera.expose(3600.0))
    await asyncio.sleep(0)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert (await camera.expose(0.01)).pixels.any()


@pytest.mark.parametrize("exposure_s", [0.0, -1.0, float("nan"), float("inf")])
async def test_an_impossible_exposure_is_refused(exposure_s: float) -> None:
    with pytest.raises(BadRequest):
        await SimulatedCamera(Truth(), OPTICS, OneStar()).expose(exposure_s)
