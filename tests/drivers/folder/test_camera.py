"""FolderCamera against real files in a real folder."""

from __future__ import annotations

import asyncio
import threading
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from drivers.folder.camera import FolderCamera
from mountnav.errors import BadFrame, Busy, Cancelled, DeviceMissing, DeviceSilent
from mountnav.frames import Frame


def fits_bytes(tmp_path: Path, *, timed: bool = True) -> bytes:
    card = fits.PrimaryHDU(np.arange(64 * 48, dtype=np.uint16).reshape(48, 64))
    if timed:
        card.header["DATE-OBS"] = "2026-11-21T20:00:00"
        card.header["EXPTIME"] = 10.0
    path = tmp_path / "made"
    card.writeto(path, overwrite=True)
    return path.read_bytes()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "frames"
    made.mkdir()
    return made


class Watching(FolderCamera):
    """Tells when it has looked into the folder."""

    def __init__(self, folder: Path, timeout_s: float) -> None:
        super().__init__(folder, timeout_s=timeout_s, poll_s=0.02)
        self.looked = threading.Event()

    def _files(self) -> dict[Path, tuple[int, int, int]]:
        found = super()._files()
        self.looked.set()
        return found


def watching(folder: Path, timeout_s: float = 20.0) -> Watching:
    return Watching(folder, timeout_s)


async def asked(camera: Watching) -> asyncio.Task[Frame]:
    """Begin an exposure and return when the camera has seen what is there."""
    camera.looked.clear()
    task = asyncio.create_task(camera.expose(0.0))
    await asyncio.to_thread(camera.looked.wait)
    return task


async def test_next_new_file_is_the_frame(folder: Path, tmp_path: Path) -> None:
    data = fits_bytes(tmp_path)
    (folder / "old.fits").write_bytes(data)
    camera = watching(folder)
    await camera.open()
    task = await asked(camera)
    (folder / "new.fits").write_bytes(data)
    frame = await task
    assert frame.source == "new.fits"
    assert frame.mid_exposure_utc == datetime(2026, 11, 21, 20, 0, 5, tzinfo=UTC)


async def test_a_file_written_slowly_counts_when_it_is_whole(folder: Path, tmp_path: Path) -> None:
    data = fits_bytes(tmp_path)
    task = await asked(watching(folder))
    with (folder / "slow.fits").open("wb") as out:
        for start in range(0, len(data), len(data) // 4 + 1):
            out.write(data[start : start + len(data) // 4 + 1])
            out.flush()
            await asyncio.sleep(0.06)
    assert (await task).width_px == 64


async def test_a_file_written_anew_counts(folder: Path, tmp_path: Path) -> None:
    data = fits_bytes(tmp_path)
    (folder / "latest.fits").write_bytes(data)
    task = await asked(watching(folder))
    (folder / "latest.fits").write_bytes(data)
    assert (await task).source == "latest.fits"


async def test_nothing_comes(folder: Path, tmp_path: Path) -> None:
    (folder / "old.fits").write_bytes(fits_bytes(tmp_path))
    with pytest.raises(DeviceSilent, match="capture program") as silent:
        await watching(folder, timeout_s=0.2).expose(0.0)
    assert "the newest there, old.fits, was written 0 s before" in silent.value.what


async def test_abort(folder: Path) -> None:
    camera = watching(folder)
    task = await asked(camera)
    with pytest.raises(Busy):
        await camera.expose(0.0)
    await camera.abort()
    with pytest.raises(Cancelled):
        await task


@pytest.mark.parametrize("content", ["garbage", "untimed"])
async def test_a_file_of_no_use_is_told_at_the_end(folder: Path, tmp_path: Path, content: str) -> None:
    data = b"no image at all" if content == "garbage" else fits_bytes(tmp_path, timed=False)
    task = await asked(watching(folder, timeout_s=0.5))
    (folder / "bad.fits").write_bytes(data)
    with pytest.raises(BadFrame):
        await task


async def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(DeviceMissing):
        await watching(tmp_path / "none").open()


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        ("garbage", "bad.fits came and can't be used"),
        ("untimed", "no time of exposure"),
        ("empty", "is empty"),
    ],
)
async def test_the_cause_is_told(folder: Path, tmp_path: Path, content: str, cause: str) -> None:
    data = {"garbage": b"no image at all", "untimed": fits_bytes(tmp_path, timed=False), "empty": b""}[
        content
    ]
    task = await asked(watching(folder, timeout_s=0.4))
    (folder / "bad.fits").write_bytes(data)
    with pytest.raises((BadFrame, DeviceSilent)) as told:
        await task
    assert cause in told.value.what


async def test_a_file_of_another_pattern_is_named(folder: Path) -> None:
    task = await asked(watching(folder, timeout_s=0.4))
    (folder / "look.cr2").write_bytes(b"raw")
    with pytest.raises(DeviceSilent, match=r"look\.cr2 came, which is none of \*\.fit\*"):
        await task


async def test_a_file_that_came_before_it_was_asked_for_is_named(folder: Path, tmp_path: Path) -> None:
    camera = watching(folder, timeout_s=0.3)
    with pytest.raises(DeviceSilent):
        await camera.expose(0.0)
    (folder / "early.fits").write_bytes(fits_bytes(tmp_path))
    with pytest.raises(DeviceSilent, match=r"early\.fits came before the exposure was asked for"):
        await camera.expose(0.0)


async def test_an_old_frame_is_remembered_when_no_other_comes(folder: Path, tmp_path: Path) -> None:
    camera = watching(folder, timeout_s=0.4)
    task = await asked(camera)
    (folder / "old.fits").write_bytes(fits_bytes(tmp_path))
    # it is given: who compares it with the mount's readings refuses it, and asks for another one
    assert (await task).source == "old.fits"
    with pytest.raises(
        DeviceSilent, match=r"old\.fits, was exposed \d+ s before it was asked for, by its DATE-OBS"
    ):
        await camera.expose(0.0)


async def test_a_file_that_is_never_whole_is_named(folder: Path) -> None:
    task = await asked(watching(folder, timeout_s=0.6))
    with (folder / "endless.fits").open("wb", buffering=0) as out:
        while not task.done():
            out.write(b"x" * 100)
            await asyncio.sleep(0.005)
    with pytest.raises(DeviceSilent, match=r"endless\.fits came and was still being written"):
        await task
