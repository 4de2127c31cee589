"""The watched folder: whole files, each once; old ones never; a folder that vanishes and comes back."""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

import pytest

from drivers.folder import watcher
from drivers.folder.watcher import FolderWatcher, NewFile


class Clock:
    """Each sleep is a turn at which a test does something to the folder; the last one ends it."""

    def __init__(self, *turns) -> None:
        self._turns = list(turns)

    async def sleep(self, seconds: float) -> None:
        if not self._turns:
            raise EndOfTestError
        self._turns.pop(0)()


class EndOfTestError(Exception):
    pass


def nothing() -> None:
    pass


async def watched(
    folder: Path, *turns, pattern: str = "*.fits", told: list[str] | None = None
) -> list[NewFile]:
    """What a watcher tells, with a turn between each two of its looks."""
    found: list[NewFile] = []
    tell = (lambda text: None) if told is None else told.append
    watching = FolderWatcher(folder, pattern, clock=Clock(*turns), tell=tell)  # type: ignore[arg-type]
    with contextlib.suppress(EndOfTestError):
        async for new in watching.files():
            found.append(new)
    return found


async def test_new_whole_files_come_once_and_old_ones_never(tmp_path: Path) -> None:
    (tmp_path / "old.fits").write_bytes(b"old")
    new = tmp_path / "new.fits"

    def written() -> None:
        new.write_bytes(b"new")
        (tmp_path / "other.txt").write_bytes(b"no frame")
        (tmp_path / "empty.fits").write_bytes(b"")

    found = await watched(tmp_path, written, nothing, nothing, nothing)
    assert [one.path for one in found] == [new]
    assert found[0].digest == hashlib.sha256(b"new").hexdigest()
    assert found[0].size_bytes == 3


async def test_however_many_files_are_there_none_is_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watcher, "NAMES_KEPT", 3)
    for number in range(10):
        (tmp_path / f"{number}.fits").write_bytes(b"old")
    assert await watched(tmp_path, nothing, nothing, nothing, nothing) == []


async def test_of_files_that_are_gone_the_latest_are_remembered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watcher, "NAMES_KEPT", 3)
    frames = [tmp_path / f"{number}.fits" for number in range(10)]
    for frame in frames:
        frame.write_bytes(b"old")
        os.utime(frame, (1e9, 1e9))

    def gone() -> None:
        for frame in frames:
            frame.unlink()

    def back() -> None:
        for frame in frames:
            frame.write_bytes(b"old")
            os.utime(frame, (1e9, 1e9))

    found = await watched(tmp_path, gone, nothing, back, nothing, nothing, nothing)
    assert len(found) == 7


async def test_a_file_that_still_grows_is_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "slow.fits"

    def grown() -> None:
        with path.open("ab") as file:
            file.write(b"x" * 100)

    found = await watched(tmp_path, grown, grown, grown, nothing, nothing)
    assert [one.size_bytes for one in found] == [300]


async def test_a_file_written_anew_comes_again(tmp_path: Path) -> None:
    path = tmp_path / "latest.fits"

    def written(content: bytes):
        def write() -> None:
            path.write_bytes(content)

        return write

    found = await watched(tmp_path, written(b"one"), nothing, written(b"second"), nothing, nothing)
    assert [one.size_bytes for one in found] == [3, 6]


async def test_the_oldest_comes_first(tmp_path: Path) -> None:
    def written() -> None:
        for number, name in enumerate(("z.fits", "a.fits", "m.fits")):
            (tmp_path / name).write_bytes(name.encode())
            os.utime(tmp_path / name, (1000 + number, 1000 + number))

    found = await watched(tmp_path, written, nothing, nothing)
    assert [one.path.name for one in found] == ["z.fits", "a.fits", "m.fits"]


async def test_folders_below_count_if_the_pattern_says_so(tmp_path: Path) -> None:
    def written() -> None:
        (tmp_path / "m31").mkdir()
        (tmp_path / "m31" / "one.fits").write_bytes(b"1")

    assert await watched(tmp_path, written, nothing, nothing) == []
    assert len(await watched(tmp_path / "x", nothing)) == 0

    def more() -> None:
        (tmp_path / "m31" / "two.fits").write_bytes(b"2")

    found = await watched(tmp_path, more, nothing, nothing, pattern="**/*.fits")
    assert [one.path.name for one in found] == ["two.fits"]


async def test_a_folder_that_vanishes_is_told_once_and_taken_up_again(tmp_path: Path) -> None:
    folder, away = tmp_path / "frames", tmp_path / "away"
    folder.mkdir()
    (folder / "old.fits").write_bytes(b"old")
    told: list[str] = []

    def meanwhile() -> None:
        (away / "meanwhile.fits").write_bytes(b"while it was away")

    found = await watched(
        folder, lambda: folder.rename(away), nothing, meanwhile, lambda: away.rename(folder), nothing,
        nothing, told=told,
    )  # fmt: skip
    assert [one.path.name for one in found] == ["meanwhile.fits"]
    assert len(told) == 2
    assert "can't be read" in told[0]
    assert "is back" in told[1]


async def test_an_unmounted_folder_that_looks_empty_makes_no_old_file_new(tmp_path: Path) -> None:
    folder, away = tmp_path / "frames", tmp_path / "away"
    folder.mkdir()
    (folder / "old.fits").write_bytes(b"old")

    def unmounted() -> None:
        folder.rename(away)
        folder.mkdir()

    def mounted() -> None:
        folder.rmdir()
        away.rename(folder)

    assert await watched(folder, unmounted, nothing, mounted, nothing, nothing) == []


async def test_a_folder_that_is_not_there_yet_is_waited_for(tmp_path: Path) -> None:
    folder = tmp_path / "later"

    def made() -> None:
        folder.mkdir()
        (folder / "old.fits").write_bytes(b"was there when it came")

    def written() -> None:
        (folder / "new.fits").write_bytes(b"new")

    found = await watched(folder, made, nothing, written, nothing, nothing)
    assert [one.path.name for one in found] == ["new.fits"]
